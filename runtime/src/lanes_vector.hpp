#ifndef AMINN_SRC_LANES_VECTOR_HPP
#define AMINN_SRC_LANES_VECTOR_HPP

#include "components.hpp"
#include "rows_vector.hpp"

namespace aminn {
inline namespace AMINN_CORE {

#if defined(__AVX__)
using Branches = RegisterOf<kBranch>::Type;
#else
using Branches = Float4; // a fifth branch is a group of its own
#endif
constexpr int kInRegister = sizeof(Branches) / sizeof(float);
constexpr int kSideBySide = kBranch < kInRegister ? kBranch : kInRegister; // branches in one Branches
constexpr bool kOneGroup = kBranch == kSideBySide;

using ContactRow = Components<Branches, kGated ? 4 : 3>;

// of(k) in each place k
template <class Of>
AMINN_INLINE Branches each(const Of &of)
{
    Branches to;
    if constexpr (kInRegister == 4) {
        set(to, of(0), of(1), of(2), of(3), 0.0F, 0.0F, 0.0F, 0.0F);
    } else {
        set(to, of(0), of(1), of(2), of(3), of(4), of(5), of(6), of(7));
    }
    return to;
}
AMINN_INLINE Branches broadcast(float x)
{
    Branches to;
    spread(to, x);
    return to;
}
AMINN_INLINE Branches root(Branches x)
{
    return each([&x](int k) AMINN_ALWAYS { return root(x[k]); });
}
AMINN_INLINE Branches exponential(Branches x)
{
    return one_exponential(x);
}
// of n branches each its own number, where there is none the first one's
AMINN_INLINE Branches gather(const float *p, int stride, int n)
{
    return each([=](int k) AMINN_ALWAYS {
        const bool there = k < kSideBySide && (kOneGroup || k < n);
        return p[there ? k * stride : 0];
    });
}
AMINN_INLINE void scatter(Branches x, float *p, int stride, int n)
{
    AMINN_UNROLL_ROWS
    for (int k = 0; k < kSideBySide; ++k) {
        if (kOneGroup || k < n) {
            p[k * stride] = x[k];
        }
    }
}
AMINN_INLINE float branch_of(Branches x, int k)
{
    return x[k];
}
// the numbers of a branch of the group, in `room` unless they lie side by side anyway
AMINN_INLINE const float *three_of(const Branches x[3], int k, float room[3])
{
    room[0] = x[0][k];
    room[1] = x[1][k];
    room[2] = x[2][k];
    return room;
}
// to = sum_i c[i] rows[i]
template <class AnyRow>
AMINN_INLINE void combine_by(AnyRow &to, const AnyRow rows[kMotion], const Row &c)
{
    weighted_sum(to, rows, kMotion, [&c](int i) { return c[i]; });
}
AMINN_INLINE Branches add_product(Branches a, Branches b, Branches c)
{
    return a + b * c;
}
AMINN_INLINE Branches subtract_product(Branches a, Branches b, Branches c)
{
    return a - b * c;
}
// the sum of so many products
template <int kCount>
AMINN_INLINE Branches dot_of(const Branches *a, const Branches *b)
{
    Branches sum = a[0] * b[0];
    AMINN_UNROLL_ROWS
    for (int i = 1; i < kCount; ++i) {
        sum = sum + a[i] * b[i];
    }
    return sum;
}

// Rows whose columns' inner products are asked for one after the other: they lie weighted in memory, from where a component
// is loaded into all places of a register.
template <int kCount, class AnyRow = Row>
class WeightedRows {
  public:
    WeightedRows(const AnyRow *rows, const float *weight) : rows_(rows)
    {
        for (int r = 0; r < kCount; ++r) {
            const auto row = weight[r] * rows[r].v;
            __builtin_memcpy(weighted_[r], &row, sizeof row);
        }
    }
    AMINN_INLINE void products_of(int j, AnyRow &to) const
    {
        weighted_sum(to, rows_, kCount, [this, j](int r) { return weighted_[r][j]; });
    }
    // of the first n rows' column j with all columns of others
    template <class Other>
    AMINN_INLINE void products_with(const Other *rows, int n, int j, Other &to) const
    {
        weighted_sum(to, rows, n, [this, j](int r) { return weighted_[r][j]; });
    }
    // one after the other
    AMINN_INLINE void add_products_of(int r, int j, AnyRow &to) const
    {
        if (r == 0) {
            scale(to, weighted_[0][j], rows_[0]);
        } else {
            add_scaled(to, weighted_[r][j], rows_[r]);
        }
    }

  private:
    float weighted_[kCount][sizeof(AnyRow) / sizeof(float)];
    const AnyRow *rows_;
};

// the upper half of to = the inner products of the rows' columns; numbers of the lower half have no meaning
template <int kColumns, int kCount, class AnyRow>
AMINN_INLINE void squares(AnyRow *to, const AnyRow *rows, const float *weight)
{
    const WeightedRows<kCount, AnyRow> weighted(rows, weight);
    AMINN_UNROLL_ROWS
    for (int r = 0; r < kCount; ++r) {
        AMINN_UNROLL_ROWS
        for (int j = 0; j < kColumns; ++j) {
            weighted.add_products_of(r, j, to[j]);
        }
    }
}

// to[i] = component i of each branch's row, then of the last row
AMINN_INLINE void transpose(const Row branches[kBranch], const Row &last, TendonRow to[kMotion])
{
    AMINN_UNROLL_ROWS
    for (int i = 0; i < kMotion; ++i) {
        set(to[i].v, in_column<0>(branches, last, i), in_column<1>(branches, last, i), in_column<2>(branches, last, i),
            in_column<3>(branches, last, i), in_column<4>(branches, last, i), in_column<5>(branches, last, i), 0.0F,
            0.0F);
    }
}

// to = what stands behind the branches' columns
AMINN_INLINE void take_last(const TendonRow rows[kMotion], Row &to)
{
    float last[kMotion];
    AMINN_UNROLL_ROWS
    for (int i = 0; i < kMotion; ++i) {
        last[i] = rows[i][kBranch];
    }
    load_row(to, last);
}

// components of a (0 to 7) and b (8 to 15)
template <int... i>
AMINN_INLINE void pick(Float8 &to, const Float8 &a, const Float8 &b)
{
    set(to, (i < 8 ? a[i % 8] : b[i % 8])...);
}

// out[r] = the sum of the products of the components of each of the rows and z, n at most 8
AMINN_INLINE void dots(const Row *rows, int n, const Row &z, float *out)
{
    // four at a time: pairs of components, then pairs of pairs
    AMINN_UNROLL_ROWS
    for (int r = 0; r < n; r += 4) {
        Float8 product[4];
        Float8 pair[2];
        Float8 first;
        Float8 second;
        AMINN_UNROLL_ROWS
        for (int i = 0; i < 4; ++i) {
            product[i] = rows[r + i < n ? r + i : r].v * z.v;
        }
        AMINN_UNROLL_ROWS
        for (int i = 0; i < 2; ++i) { // a01 a23 b01 b23 | a45 - b45 -, and of c and d
            pick<0, 2, 8, 10, 4, 6, 12, 14>(first, product[2 * i], product[2 * i + 1]);
            pick<1, 3, 9, 11, 5, 7, 13, 15>(second, product[2 * i], product[2 * i + 1]);
            pair[i] = first + second;
        }
        pick<0, 2, 8, 10, 4, 6, 12, 14>(first, pair[0], pair[1]); // a01 b01 c01 d01 | a45 b45 c45 d45
        pick<1, 3, 9, 11, 5, 7, 13, 15>(second, pair[0], pair[1]);
        for (int i = 0; i < 4 && r + i < n; ++i) {
            out[r + i] = (first[i] + second[i]) + first[4 + i];
        }
    }
}

} // namespace AMINN_CORE
} // namespace aminn

#endif
