// What the statics compute with, so that vector registers are used where there are some:
//
//   Row         one number for each of the 6 components of the tool's motion
//   TendonRow   one number for each of the 3 tendons, and one more
//   Branches    one number for each of the 3 branches
//   ContactRow  Branches for each of the 3 dimensions of a contact and one more
//
// With vector registers a Row is 8 floats and Branches are 4, the last of each unused; they hold numbers that no result
// depends on. Without, a Row is an array of 6, which serves as the two others too, and the code for Branches runs for one
// branch after the other with a plain float. The operations on each component are the same, so are the bits.
#ifndef AMINN_SRC_LANES_HPP
#define AMINN_SRC_LANES_HPP

#include "vector3.hpp"

namespace aminn {
inline namespace AMINN_CORE {

constexpr float kOnesAndZeros[9] = {1.0F, 1.0F, 1.0F, 1.0F, 1.0F, 1.0F, 0.0F, 0.0F, 0.0F};

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

#if AMINN_LANES

#pragma GCC diagnostic ignored "-Wpsabi"           // nothing here is called across object files
#define AMINN_UNROLL_ROWS _Pragma("GCC unroll 16") // each step has its own code
using Float4 = float __attribute__((vector_size(16)));
using Int4 = int32_t __attribute__((vector_size(16)));

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
using Float8 = float __attribute__((vector_size(32)));
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
#else
// Of a vector of 32 bytes gcc would make numbers in memory where registers have 16.
struct Float8 {
    Float4 low;
    Float4 high;
    AMINN_INLINE float operator[](int i) const
    {
        return i < 4 ? low[i] : high[i - 4];
    }
};
AMINN_INLINE Float8 operator+(const Float8 &a, const Float8 &b)
{
    return {a.low + b.low, a.high + b.high};
}
AMINN_INLINE Float8 operator-(const Float8 &a, const Float8 &b)
{
    return {a.low - b.low, a.high - b.high};
}
AMINN_INLINE Float8 operator*(const Float8 &a, const Float8 &b)
{
    return {a.low * b.low, a.high * b.high};
}
AMINN_INLINE Float8 operator*(float s, const Float8 &a)
{
    return {s * a.low, s * a.high};
}
AMINN_INLINE Float8 operator/(float s, const Float8 &a)
{
    return {s / a.low, s / a.high};
}
AMINN_INLINE void set(Float8 &to, float x0, float x1, float x2, float x3, float x4, float x5, float x6, float x7)
{
    to = {Float4{x0, x1, x2, x3}, Float4{x4, x5, x6, x7}};
}
AMINN_INLINE void clear_places_up_to(Float8 &a, int j)
{
    clear_places_up_to(a.low, j);
    clear_places_up_to(a.high, j - 4);
}
AMINN_INLINE void set_place(Float8 &a, int j, float value)
{
    set_place(a.low, j, value);
    set_place(a.high, j - 4, value);
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

template <class Vector>
struct Lanes {
    Vector v;
    AMINN_INLINE float operator[](int i) const
    {
        return v[i];
    }
};
using Row = Lanes<Float8>;
using TendonRow = Lanes<Float4>;

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

using Branches = Float4;
constexpr int kSideBySide = kBranch; // branches in one Branches

AMINN_INLINE Branches broadcast(float x)
{
    return Branches{x, x, x, x};
}
AMINN_INLINE Branches root(Branches x)
{
    return Branches{root(x[0]), root(x[1]), root(x[2]), root(x[3])};
}
AMINN_INLINE Branches exponential(Branches x)
{
    return Branches{exponential(x[0]), exponential(x[1]), exponential(x[2]), 0.0F};
}
AMINN_INLINE Branches gather(const float *p, int stride)
{
    return Branches{p[0], p[stride], p[2 * stride], p[0]};
}
AMINN_INLINE void scatter(Branches x, float *p, int stride)
{
    p[0] = x[0];
    p[stride] = x[1];
    p[2 * stride] = x[2];
}

using ContactRow = Components<Branches, 4>;

#else // one component after the other

#define AMINN_UNROLL_ROWS

using Row = Components<float, kMotion>;
using TendonRow = Row;

#if AMINN_CORTEX_M
// Rows are loaded and stored as a whole, which the compiler does not do by itself. A sum that begins with -0 keeps the
// first product as it is.
constexpr float kMinusZeros[8] = {-0.0F, -0.0F, -0.0F, -0.0F, -0.0F, -0.0F, -0.0F, -0.0F};
#define AMINN_ROW_REGISTERS "s0", "s1", "s2", "s3", "s4", "s5", "s6", "s7", "s8", "s9", "s10", "s11", "cc", "memory"
#define AMINN_SIX(operation, factor)                                                                                \
    "    " operation " s0, s6, " factor "\n    " operation " s1, s7, " factor "\n    " operation " s2, s8, " factor \
    "\n    " operation " s3, s9, " factor "\n    " operation " s4, s10, " factor "\n    " operation                 \
    " s5, s11, " factor "\n"
#define AMINN_SIX_PAIRS(operation)                                                                             \
    "    " operation " s0, s0, s6\n    " operation " s1, s1, s7\n    " operation " s2, s2, s8\n    " operation \
    " s3, s3, s9\n    " operation " s4, s4, s10\n    " operation " s5, s5, s11\n"
#define AMINN_STORE "    vstmia %[a], {s0-s5}"

AMINN_FUNCTION void scale(Row &a, float s, const Row &c)
{
    __asm volatile("    vldmia %[c], {s6-s11}\n" AMINN_SIX("vmul.f32", "%[s]") AMINN_STORE
                   :
                   : [a] "r"(a.v), [c] "r"(c.v), [s] "t"(s)
                   : AMINN_ROW_REGISTERS);
}
AMINN_FUNCTION void add_scaled(Row &a, float s, const Row &c)
{
    __asm volatile("    vldmia %[a], {s0-s5}\n    vldmia %[c], {s6-s11}\n" AMINN_SIX("vmla.f32", "%[s]") AMINN_STORE
                   :
                   : [a] "r"(a.v), [c] "r"(c.v), [s] "t"(s)
                   : AMINN_ROW_REGISTERS);
}
AMINN_FUNCTION void multiply(Row &a, const Row &b)
{
    __asm volatile("    vldmia %[a], {s0-s5}\n    vldmia %[c], {s6-s11}\n" AMINN_SIX_PAIRS("vmul.f32") AMINN_STORE
                   :
                   : [a] "r"(a.v), [c] "r"(b.v)
                   : AMINN_ROW_REGISTERS);
}

AMINN_FUNCTION float dot(const Row &a, const Row &b)
{
    float sum = 0.0F;
    __asm volatile("    vldmia %[a], {s0-s5}\n    vldmia %[b], {s6-s11}\n" AMINN_SIX_PAIRS(
                       "vmul.f32") "    vadd.f32 s0, s0, s1\n    vadd.f32 s2, s2, s3\n    vadd.f32 s4, s4, s5\n"
                                   "    vadd.f32 s0, s0, s2\n    vadd.f32 %[sum], s0, s4"
                   : [sum] "=t"(sum)
                   : [a] "r"(a.v), [b] "r"(b.v)
                   : AMINN_ROW_REGISTERS);
    return sum;
}
AMINN_FUNCTION void sum_of_squares(Row &to, const Row *rows, int n, const float *weight)
{
    __asm volatile("    vldmia %[zero], {s0-s5}\n"
                   "1:  vldmia %[row]!, {s6-s11}\n"
                   "    vldmia %[weight]!, {s12}\n"
                   "    vmul.f32 s6, s6, s6\n    vmul.f32 s7, s7, s7\n    vmul.f32 s8, s8, s8\n"
                   "    vmul.f32 s9, s9, s9\n    vmul.f32 s10, s10, s10\n    vmul.f32 s11, s11, s11\n" AMINN_SIX(
                       "vmla.f32", "s12") "    subs %[n], #1\n"
                                          "    bne 1b\n" AMINN_STORE
                   : [row] "+r"(rows), [n] "+r"(n), [weight] "+r"(weight)
                   : [a] "r"(to.v), [zero] "r"(kMinusZeros)
                   : AMINN_ROW_REGISTERS, "s12");
}

#define AMINN_LOAD_WEIGHTED                                                          \
    "    vldmia %[row]!, {s12-s17}\n    vldr s18, [%[p]]\n    vldmia %[q]!, {s19}\n" \
    "    add %[p], %[step]\n    vmul.f32 s18, s19, s18\n"
// to = sum_r (q[r] p[r]) rows[r], p in steps of some bytes
AMINN_FUNCTION void weighted_sum(Row &to, const Row *row, int n, const float *q, const float *p, int step)
{
    __asm volatile("    vldmia %[zero], {s0-s7}\n    vldmia %[zero], {s8-s11}\n"
                   "1:\n" AMINN_LOAD_WEIGHTED
                   "    vmla.f32 s0, s12, s18\n    vmla.f32 s1, s13, s18\n    vmla.f32 s2, s14, s18\n"
                   "    vmla.f32 s3, s15, s18\n    vmla.f32 s4, s16, s18\n    vmla.f32 s5, s17, s18\n"
                   "    subs %[n], #1\n"
                   "    beq 2f\n" AMINN_LOAD_WEIGHTED
                   "    vmla.f32 s6, s12, s18\n    vmla.f32 s7, s13, s18\n    vmla.f32 s8, s14, s18\n"
                   "    vmla.f32 s9, s15, s18\n    vmla.f32 s10, s16, s18\n    vmla.f32 s11, s17, s18\n"
                   "    subs %[n], #1\n"
                   "    bne 1b\n"
                   "2:\n" AMINN_SIX_PAIRS("vadd.f32") AMINN_STORE
                   : [row] "+r"(row), [n] "+r"(n), [q] "+r"(q), [p] "+r"(p)
                   : [a] "r"(to.v), [zero] "r"(kMinusZeros), [step] "r"(step)
                   : AMINN_ROW_REGISTERS, "s12", "s13", "s14", "s15", "s16", "s17", "s18", "s19");
}
AMINN_INLINE void combine(Row &to, const Row *rows, int n, const float *c)
{
    weighted_sum(to, rows, n, c, kOnesAndZeros, 0);
}
AMINN_INLINE void inner_products(Row &to, const Row *rows, int n, const float *weight, int j)
{
    weighted_sum(to, rows, n, weight, &rows->v[j], sizeof *rows);
}
// rows[r] -= rows[r][j] factor
AMINN_FUNCTION void eliminate(Row *rows, int n, int j, const Row &factor)
{
    const float *p = &rows->v[j];
    __asm volatile("    vldmia %[factor], {s6-s11}\n"
                   "1:  vldmia %[row], {s0-s5}\n"
                   "    vldr s12, [%[p]]\n"
                   "    adds %[p], #24\n" AMINN_SIX("vmls.f32", "s12") "    vstmia %[row]!, {s0-s5}\n"
                                                                       "    subs %[n], #1\n"
                                                                       "    bne 1b"
                   : [row] "+r"(rows), [n] "+r"(n), [p] "+r"(p)
                   : [factor] "r"(factor.v)
                   : AMINN_ROW_REGISTERS, "s12");
}
#else
AMINN_FUNCTION void multiply(Row &a, const Row &b)
{
    for (int i = 0; i < kMotion; ++i) {
        a.v[i] = a.v[i] * b.v[i];
    }
}
#endif

using Branches = float;
using ContactRow = Row;
constexpr int kSideBySide = 1;

AMINN_INLINE Branches broadcast(float x)
{
    return x;
}
AMINN_INLINE Branches gather(const float *p, int)
{
    return *p;
}
AMINN_INLINE void scatter(Branches x, float *p, int)
{
    *p = x;
}

#endif

#if !AMINN_CORTEX_M // which has its own, above
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
AMINN_INLINE void combine(Row &to, const Row *rows, int n, const float *c)
{
    weighted_sum(to, rows, n, [c](int r) { return c[r]; });
}
// of column j of the rows with all columns: to = sum_r (weight[r] rows[r][j]) rows[r]
template <class AnyRow, class Number>
AMINN_INLINE void inner_products(AnyRow &to, const AnyRow *rows, int n, const Number *weight, int j)
{
    weighted_sum(to, rows, n, [=](int r) { return weight[r] * rows[r][j]; });
}
// rows[r] -= rows[r][j] factor
template <class AnyRow>
AMINN_INLINE void eliminate(AnyRow *rows, int n, int j, const AnyRow &factor)
{
    AMINN_UNROLL_ROWS
    for (int r = 0; r < n; ++r) {
        subtract_scaled(rows[r], rows[r][j], factor);
    }
}
// the sum of the products of the components
AMINN_FUNCTION float dot(const Row &a, const Row &b)
{
    Row p = a;
    multiply(p, b);
    return ((p[0] + p[1]) + (p[2] + p[3])) + (p[4] + p[5]);
}
// to = sum_r weight[r] rows[r]^2, component by component
AMINN_FUNCTION void sum_of_squares(Row &to, const Row *rows, int n, const float *weight)
{
    clear(to);
    AMINN_UNROLL_ROWS
    for (int r = 0; r < n; ++r) {
        Row square = rows[r];
        multiply(square, rows[r]);
        add_scaled(to, weight[r], square);
    }
}

#endif

// the smaller; x if it is no number
AMINN_INLINE Branches least(Branches limit, Branches x)
{
    return limit < x ? limit : x;
}

constexpr int kGroups = kBranch / kSideBySide; // of branches that are computed side by side

AMINN_INLINE Branches dot(const Branches a[3], const Branches b[3])
{
#if AMINN_LANES
    return (a[0] * b[0] + a[1] * b[1]) + a[2] * b[2];
#else
    return dot3(a, b);
#endif
}

// Rows whose columns' inner products are asked for one after the other.
template <int kCount>
class WeightedRows {
  public:
#if AMINN_LANES
    // they lie weighted in memory, from where a component is loaded into all places of a register
    WeightedRows(const Row *rows, const float *weight) : rows_(rows)
    {
        for (int r = 0; r < kCount; ++r) {
            const Float8 row = weight[r] * rows[r].v;
            std::memcpy(weighted_[r], &row, sizeof row);
        }
    }
    AMINN_INLINE void products_of(int j, Row &to) const
    {
        weighted_sum(to, rows_, kCount, [this, j](int r) { return weighted_[r][j]; });
    }

  private:
    float weighted_[kCount][8];
#else
    WeightedRows(const Row *rows, const float *weight) : weight_(weight), rows_(rows)
    {
    }
    AMINN_INLINE void products_of(int j, Row &to) const
    {
        inner_products(to, rows_, kCount, weight_, j);
    }

  private:
    const float *weight_;
#endif
    const Row *rows_;
};

#if AMINN_LANES
// components of a (0 to 7) and b (8 to 15)
template <int... i>
AMINN_INLINE void pick(Float8 &to, const Float8 &a, const Float8 &b)
{
    set(to, (i < 8 ? a[i % 8] : b[i % 8])...);
}
#endif

// to[i] = (a[i], b[i], c[i], d[i])
AMINN_INLINE void transpose(const Row &a, const Row &b, const Row &c, const Row &d, TendonRow to[kMotion])
{
#if AMINN_LANES
    AMINN_UNROLL_ROWS
    for (int i = 0; i < kMotion; ++i) {
        to[i].v = Float4{a[i], b[i], c[i], d[i]};
    }
#else
    for (int i = 0; i < kMotion; ++i) {
        to[i] = {{a[i], b[i], c[i], d[i], 0.0F, 0.0F}};
    }
#endif
}

// out[r] = the same of each of the rows and z, n at most 8
AMINN_INLINE void dots(const Row *rows, int n, const Row &z, float *out)
{
#if AMINN_LANES
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
#else
    for (int r = 0; r < n; ++r) {
        out[r] = dot(rows[r], z);
    }
#endif
}

} // namespace AMINN_CORE
} // namespace aminn

#endif
