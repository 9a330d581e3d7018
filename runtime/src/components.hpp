// A row of numbers as an array: of floats where there are no vector registers, of vectors where there are.
#ifndef AMINN_SRC_COMPONENTS_HPP
#define AMINN_SRC_COMPONENTS_HPP

#include "vector3.hpp"

namespace aminn {
inline namespace AMINN_CORE {

constexpr float kOnesAndZeros[9] = {1.0F, 1.0F, 1.0F, 1.0F, 1.0F, 1.0F, 0.0F, 0.0F, 0.0F};
constexpr const float *kOnes = kOnesAndZeros;          // 6
constexpr const float *kThreeOnes = kOnesAndZeros + 3; // and three zeros

// Numbers side by side, each in a place of its own: floats, or Branches.
template <class Number, int kCount>
struct Components {
    Number v[kCount];
    AMINN_INLINE const Number &operator[](int i) const
    {
        return v[i];
    }
};

template <class Number, int kCount>
AMINN_FUNCTION void load_row(Components<Number, kCount> &a, const Number *p)
{
    for (int i = 0; i < kCount; ++i) { // each as it was stored
        a.v[i] = p[i];
    }
}
template <class Number, int kCount>
AMINN_FUNCTION void scale(Components<Number, kCount> &a, Number s, const Components<Number, kCount> &c)
{
    for (int i = 0; i < kCount; ++i) {
        a.v[i] = s * c.v[i];
    }
}
template <class Number, int kCount>
AMINN_FUNCTION void add_scaled(Components<Number, kCount> &a, Number s, const Components<Number, kCount> &c)
{
    for (int i = 0; i < kCount; ++i) {
        a.v[i] = a.v[i] + s * c.v[i];
    }
}
template <class Number, int kCount>
AMINN_FUNCTION void subtract_scaled(Components<Number, kCount> &a, Number s, const Components<Number, kCount> &c)
{
    for (int i = 0; i < kCount; ++i) {
        a.v[i] = a.v[i] - s * c.v[i];
    }
}
template <class Number, int kCount>
AMINN_FUNCTION void add(Components<Number, kCount> &a, const Components<Number, kCount> &b)
{
    for (int i = 0; i < kCount; ++i) {
        a.v[i] = a.v[i] + b.v[i];
    }
}
template <class Number, int kCount>
AMINN_FUNCTION void multiply(Components<Number, kCount> &a, const Components<Number, kCount> &b)
{
    for (int i = 0; i < kCount; ++i) {
        a.v[i] = a.v[i] * b.v[i];
    }
}
template <class Number, int kCount>
AMINN_INLINE Number scale_by_component(Components<Number, kCount> &a, int j)
{
    const Number inv = 1.0F / a[j];
    scale(a, inv, a);
    return inv;
}
template <class Number, int kCount>
AMINN_INLINE void clear(Components<Number, kCount> &a)
{
    a = {};
}
template <class Number, int kCount>
AMINN_INLINE void clear_up_to(Components<Number, kCount> &a, int j)
{
    for (; j >= 0; --j) {
        a.v[j] = Number{};
    }
}
template <class Number, int kCount>
AMINN_INLINE void set_component(Components<Number, kCount> &a, int j, float value)
{
    a.v[j] = value - Number{}; // in all lanes of it
}

// Component i of a branch's row, or of the last one, or nothing: the column of a TendonRow.
template <int column, class AnyRow>
AMINN_INLINE float in_column(const AnyRow *branches, const AnyRow &last, int i)
{
    if constexpr (column < kBranch) {
        return branches[column][i];
    } else {
        return column == kBranch ? last[i] : 0.0F;
    }
}

} // namespace AMINN_CORE
} // namespace aminn

#endif
