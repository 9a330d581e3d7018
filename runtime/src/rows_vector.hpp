// Rows in vector registers: a Row is 8 floats, a TendonRow 4 or 8, a SlideRow 4, 8 or 16. The last ones hold numbers that no result depends on.
#ifndef AMINN_SRC_ROWS_VECTOR_HPP
#define AMINN_SRC_ROWS_VECTOR_HPP

#include "row_sums.hpp"
#include "vector3.hpp"

namespace aminn {
inline namespace AMINN_CORE {

#pragma GCC diagnostic ignored "-Wpsabi" // nothing here is called across object files
using Int4 = int32_t __attribute__((vector_size(16)));

// the first four
AMINN_INLINE void set(Float4 &to, float x0, float x1, float x2, float x3, float, float, float, float)
{
    to = Float4{x0, x1, x2, x3};
}
AMINN_INLINE void set_place(Float4 &a, int j, float value)
{
    const Int4 places = {0, 1, 2, 3};
    a = places == j ? Float4{} + value : a;
}
AMINN_INLINE void clear_places_up_to(Float4 &a, int j)
{
    const Int4 places = {0, 1, 2, 3};
    a = places > j ? a : Float4{};
}

#if defined(__AVX__)
using Int8 = int32_t __attribute__((vector_size(32)));

AMINN_INLINE void set(Float8 &to, float x0, float x1, float x2, float x3, float x4, float x5, float x6, float x7)
{
    to = Float8{x0, x1, x2, x3, x4, x5, x6, x7};
}
AMINN_INLINE void clear_places_up_to(Float8 &a, int j)
{
    const Int8 places = {0, 1, 2, 3, 4, 5, 6, 7};
    a = places > j ? a : Float8{};
}
AMINN_INLINE void set_place(Float8 &a, int j, float value)
{
    const Int8 places = {0, 1, 2, 3, 4, 5, 6, 7};
    a = places == j ? Float8{} + value : a;
}
#endif

// Two vectors side by side.
template <class Half>
struct Twice {
    static constexpr int kHalf = sizeof(Half) / sizeof(float);
    Half low;
    Half high;
    AMINN_INLINE float operator[](int i) const
    {
        return i < kHalf ? low[i] : high[i - kHalf];
    }
};
template <class Half>
AMINN_INLINE Twice<Half> operator+(const Twice<Half> &a, const Twice<Half> &b)
{
    return {a.low + b.low, a.high + b.high};
}
template <class Half>
AMINN_INLINE Twice<Half> operator-(const Twice<Half> &a, const Twice<Half> &b)
{
    return {a.low - b.low, a.high - b.high};
}
template <class Half>
AMINN_INLINE Twice<Half> operator*(const Twice<Half> &a, const Twice<Half> &b)
{
    return {a.low * b.low, a.high * b.high};
}
template <class Half>
AMINN_INLINE Twice<Half> operator*(float s, const Twice<Half> &a)
{
    return {s * a.low, s * a.high};
}
template <class Half>
AMINN_INLINE Twice<Half> operator/(float s, const Twice<Half> &a)
{
    return {s / a.low, s / a.high};
}
template <class Half>
AMINN_INLINE void clear_places_up_to(Twice<Half> &a, int j)
{
    clear_places_up_to(a.low, j);
    clear_places_up_to(a.high, j - Twice<Half>::kHalf);
}
template <class Half>
AMINN_INLINE void set_place(Twice<Half> &a, int j, float value)
{
    set_place(a.low, j, value);
    set_place(a.high, j - Twice<Half>::kHalf, value);
}

#if !defined(__AVX__)
using Float8 = Twice<Float4>; // of a vector of 32 bytes gcc would make numbers in memory where registers have 16
AMINN_INLINE void set(Float8 &to, float x0, float x1, float x2, float x3, float x4, float x5, float x6, float x7)
{
    to = {Float4{x0, x1, x2, x3}, Float4{x4, x5, x6, x7}};
}
#endif

AMINN_INLINE void spread(Float8 &to, float s)
{
    set(to, s, s, s, s, s, s, s, s);
}
AMINN_INLINE void spread(Float4 &to, float s)
{
    to = Float4{s, s, s, s};
}
AMINN_INLINE void spread(Twice<Float8> &to, float s)
{
    spread(to.low, s);
    spread(to.high, s);
}

template <class Vector>
struct Lanes {
    Vector v;
    AMINN_INLINE float operator[](int i) const
    {
        return v[i];
    }
};

// a register for so many numbers
template <int kNumbers, bool kFour = kNumbers <= 4, bool kEight = kNumbers <= 8>
struct RegisterOf {
    using Type = Twice<Float8>;
};
template <int kNumbers>
struct RegisterOf<kNumbers, false, true> {
    using Type = Float8;
};
template <int kNumbers>
struct RegisterOf<kNumbers, true, true> {
    using Type = Float4;
};

using Row = Lanes<Float8>;
using TendonRow = Lanes<RegisterOf<kBranch + 1>::Type>;
using SlideRow = Lanes<RegisterOf<2 * kBranch>::Type>;

AMINN_INLINE void load_row(Row &a, const float *p)
{
    set(a.v, p[0], p[1], p[2], p[3], p[4], p[5], 0.0F, 0.0F);
}
// a = s c
template <class Vector>
AMINN_INLINE void scale(Lanes<Vector> &a, float s, const Lanes<Vector> &c)
{
    a.v = s * c.v;
}
// a += s c
template <class Vector>
AMINN_INLINE void add_scaled(Lanes<Vector> &a, float s, const Lanes<Vector> &c)
{
    a.v = a.v + s * c.v;
}
// a *= 1 / a[j], which is returned
template <class Vector>
AMINN_INLINE float scale_by_component(Lanes<Vector> &a, int j)
{
    Vector inv;
    spread(inv, a.v[j]);
    inv = 1.0F / inv;
    a.v = inv * a.v;
    return inv[0];
}
// a -= s c
template <class Vector>
AMINN_INLINE void subtract_scaled(Lanes<Vector> &a, float s, const Lanes<Vector> &c)
{
    a.v = a.v - s * c.v;
}
// a += b
template <class Vector>
AMINN_INLINE void add(Lanes<Vector> &a, const Lanes<Vector> &b)
{
    a.v = a.v + b.v;
}
// a *= b, component by component
template <class Vector>
AMINN_INLINE void multiply(Lanes<Vector> &a, const Lanes<Vector> &b)
{
    a.v = a.v * b.v;
}
template <class Vector>
AMINN_INLINE void clear(Lanes<Vector> &a)
{
    a.v = Vector{};
}
// zero for components 0 to j
template <class Vector>
AMINN_INLINE void clear_up_to(Lanes<Vector> &a, int j)
{
    clear_places_up_to(a.v, j);
}
template <class Vector>
AMINN_INLINE void set_component(Lanes<Vector> &a, int j, float value)
{
    set_place(a.v, j, value);
}

// one by one: a load of what single stores have just written would wait for them
AMINN_INLINE void load_slides(SlideRow &to, const float *p)
{
    clear(to);
    AMINN_UNROLL_ROWS
    for (int i = 0; i < 2 * kBranch; ++i) {
        set_component(to, i, p[i]);
    }
}

} // namespace AMINN_CORE
} // namespace aminn

#endif
