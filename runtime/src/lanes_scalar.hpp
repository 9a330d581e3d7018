// Lanes of a machine without vector registers: Branches are one branch, whose code runs for one after the other.
#ifndef AMINN_SRC_LANES_SCALAR_HPP
#define AMINN_SRC_LANES_SCALAR_HPP

#if AMINN_CORTEX_M && AMINN_N_SLIDE && AMINN_N_BRANCH != 3
#include "slide_rows_cortex_m.hpp"
#elif AMINN_CORTEX_M
#include "rows_cortex_m.hpp"
#else
#include "rows_plain.hpp"
#endif

namespace aminn {
inline namespace AMINN_CORE {

using TendonRow = Row;
using ContactRow = Row;
using SlideRow = Components<float, 2 * kBranch>;
using Branches = float;
constexpr int kSideBySide = 1;
static_assert(kBranch + 1 <= kMotion, "a row holds a number of each tendon, and one more");
static_assert(3 + 1 <= kMotion, "a row holds the three dimensions of a contact, and one more");

AMINN_INLINE void load_slides(SlideRow &to, const float *p)
{
    __builtin_memcpy(&to, p, sizeof to);
}
AMINN_INLINE Branches broadcast(float x)
{
    return x;
}
AMINN_INLINE Branches gather(const float *p, int, int)
{
    return *p;
}
AMINN_INLINE void scatter(Branches x, float *p, int, int)
{
    *p = x;
}
AMINN_INLINE float branch_of(Branches x, int)
{
    return x;
}
// the numbers of a branch of the group, in `room` unless they lie side by side anyway
AMINN_INLINE const float *three_of(const Branches x[3], int, float[3])
{
    return x;
}
// to = sum_i c[i] rows[i]
template <class AnyRow>
AMINN_INLINE void combine_by(AnyRow &to, const AnyRow rows[kMotion], const Row &c)
{
    combine(to, rows, kMotion, c.v);
}
// the sum of so many products
template <int kCount>
AMINN_INLINE Branches dot_of(const Branches *a, const Branches *b)
{
    if constexpr (kCount == 3) { // once for all
        return dot3(a, b);
    } else {
        Branches sum = a[0] * b[0];
        for (int i = 1; i < kCount; ++i) {
            sum = add_product(sum, a[i], b[i]);
        }
        return sum;
    }
}

// Rows whose columns' inner products are asked for one after the other.
template <int kCount>
class WeightedRows {
  public:
    WeightedRows(const Row *rows, const float *weight) : weight_(weight), rows_(rows)
    {
    }
    AMINN_INLINE void products_of(int j, Row &to) const
    {
        inner_products(to, rows_, kCount, weight_, rows_, j);
    }
    // of the first n rows' column j with all columns of others
    template <class Other>
    AMINN_INLINE void products_with(const Other *rows, int n, int j, Other &to) const
    {
        inner_products(to, rows, n, weight_, rows_, j);
    }

  private:
    const float *weight_;
    const Row *rows_;
};

// the upper half of to = the inner products of the rows' columns; numbers of the lower half have no meaning
template <int kColumns, int kCount, class AnyRow>
AMINN_FUNCTION void squares(AnyRow *to, const AnyRow *rows, const float *weight)
{
#if AMINN_CORTEX_M
    if constexpr (kColumns == kMotion) {
        six_squares(to, rows, kCount, weight);
        return;
    }
#endif
    for (int j = 0; j < kColumns; ++j) {
        scale(to[j], weight[0] * rows[0][j], rows[0]);
        for (int r = 1; r < kCount; ++r) {
            add_scaled(to[j], weight[r] * rows[r][j], rows[r]);
        }
    }
}

// to[i] = component i of each branch's row, then of the last row
AMINN_INLINE void transpose(const Row branches[kBranch], const Row &last, TendonRow to[kMotion])
{
    for (int i = 0; i < kMotion; ++i) {
        to[i] = {{in_column<0>(branches, last, i), in_column<1>(branches, last, i), in_column<2>(branches, last, i),
                  in_column<3>(branches, last, i), in_column<4>(branches, last, i), in_column<5>(branches, last, i)}};
    }
}

// to = what stands behind the branches' columns
AMINN_INLINE void take_last(const TendonRow rows[kMotion], Row &to)
{
    for (int i = 0; i < kMotion; ++i) {
        to.v[i] = rows[i][kBranch];
    }
}

// out[r] = the sum of the products of the components of each of the rows and z
AMINN_INLINE void dots(const Row *rows, int n, const Row &z, float *out)
{
    for (int r = 0; r < n; ++r) {
        out[r] = dot(rows[r], z);
    }
}

} // namespace AMINN_CORE
} // namespace aminn

#endif
