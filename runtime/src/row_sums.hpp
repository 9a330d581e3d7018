// Sums over rows, of operations on a row that the machine has.
#ifndef AMINN_SRC_ROW_SUMS_HPP
#define AMINN_SRC_ROW_SUMS_HPP

#include "core.hpp"

namespace aminn {
inline namespace AMINN_CORE {

template <class AnyRow>
AMINN_INLINE void clear_rows(AnyRow *rows, int n)
{
    for (int r = 0; r < n; ++r) {
        clear(rows[r]);
    }
}
// to = sum_r c(r) rows[r]: the sum over even r plus that over odd r, for half the rounding errors and half the wait. n > 1.
template <class AnyRow, class Coefficient>
AMINN_INLINE void weighted_sum(AnyRow &to, const AnyRow *rows, int n, const Coefficient &c)
{
    AnyRow odd;
    scale(to, c(0), rows[0]);
    scale(odd, c(1), rows[1]);
    AMINN_UNROLL_ROWS
    for (int r = 2; r < n; ++r) {
        add_scaled(r % 2 == 0 ? to : odd, c(r), rows[r]);
    }
    add(to, odd);
}
// to = sum_r c[r] rows[r]
template <class AnyRow>
AMINN_INLINE void combine(AnyRow &to, const AnyRow *rows, int n, const float *c)
{
    weighted_sum(to, rows, n, [c](int r) { return c[r]; });
}
// of column j of q with all columns of the rows: to = sum_r (weight[r] q[r][j]) rows[r]
template <class AnyRow, class Number, class Other>
AMINN_INLINE void inner_products(AnyRow &to, const AnyRow *rows, int n, const Number *weight, const Other *q, int j)
{
    weighted_sum(to, rows, n, [=](int r) { return weight[r] * q[r][j]; });
}
// rows[r] -= q[r][j] factor
template <class AnyRow, class Other>
AMINN_INLINE void eliminate(AnyRow *rows, int n, const Other *q, int j, const AnyRow &factor)
{
    AMINN_UNROLL_ROWS
    for (int r = 0; r < n; ++r) {
        subtract_scaled(rows[r], q[r][j], factor);
    }
}
// the sum of the products of the components
template <class AnyRow>
AMINN_FUNCTION float dot(const AnyRow &a, const AnyRow &b)
{
    AnyRow p = a;
    multiply(p, b);
    return ((p[0] + p[1]) + (p[2] + p[3])) + (p[4] + p[5]);
}
// to = sum_r weight[r] rows[r]^2, component by component
template <class AnyRow>
AMINN_FUNCTION void sum_of_squares(AnyRow &to, const AnyRow *rows, int n, const float *weight)
{
    clear(to);
    AMINN_UNROLL_ROWS
    for (int r = 0; r < n; ++r) {
        AnyRow square = rows[r];
        multiply(square, rows[r]);
        add_scaled(to, weight[r], square);
    }
}

} // namespace AMINN_CORE
} // namespace aminn

#endif
