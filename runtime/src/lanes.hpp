// The two shapes in which the statics compute side by side, so that vector registers are used where there are some:
//
//   Row        one number for each of the 6 components of the tool's motion
//   Branches   one number for each of the 3 branches
//
// With vector registers a Row is 8 floats and Branches are 4, the last of each unused; they hold numbers that no result
// depends on. Without, a Row is an array of 6, and the code for Branches runs for one branch after the other with a plain
// float. The operations on each component are the same, so are the bits.
#ifndef AMINN_SRC_LANES_HPP
#define AMINN_SRC_LANES_HPP

#include "aminn_rt.h"
#include "elementary.hpp"

namespace aminn {
inline namespace AMINN_CORE {

constexpr int kBranch = AMINN_N_BRANCH;
constexpr int kMotion = AMINN_N_WRENCH;

#if AMINN_LANES

#pragma GCC diagnostic ignored "-Wpsabi"          // nothing here is called across object files
#define AMINN_UNROLL_ROWS _Pragma("GCC unroll 9") // each step has its own code
using Float4 = float __attribute__((vector_size(16)));
using Float8 = float __attribute__((vector_size(32)));
using Int8 = int32_t __attribute__((vector_size(32)));

struct Row {
    Float8 v;
    AMINN_INLINE float operator[](int i) const
    {
        return v[i];
    }
};

AMINN_INLINE void load_row(Row &a, const float *p)
{
    a.v = Float8{p[0], p[1], p[2], p[3], p[4], p[5], 0.0F, 0.0F};
}
// a = s c
AMINN_INLINE void scale(Row &a, float s, const Row &c)
{
    a.v = s * c.v;
}
// a += s c
AMINN_INLINE void add_scaled(Row &a, float s, const Row &c)
{
    a.v = a.v + s * c.v;
}
// a -= s c
AMINN_INLINE void subtract_scaled(Row &a, float s, const Row &c)
{
    a.v = a.v - s * c.v;
}
// a += b
AMINN_INLINE void add(Row &a, const Row &b)
{
    a.v = a.v + b.v;
}
// a *= b, component by component
AMINN_INLINE void multiply(Row &a, const Row &b)
{
    a.v = a.v * b.v;
}
AMINN_INLINE void clear(Row &a)
{
    a.v = Float8{};
}
// zero for components 0 to j
AMINN_INLINE void clear_up_to(Row &a, int j)
{
    const Int8 components = {0, 1, 2, 3, 4, 5, 6, 7};
    a.v = components > j ? a.v : Float8{};
}
AMINN_INLINE void set_component(Row &a, int j, float value)
{
    const Int8 components = {0, 1, 2, 3, 4, 5, 6, 7};
    a.v = components == j ? Float8{} + value : a.v;
}

using Branches = Float4;
constexpr int kSideBySide = kBranch; // branches in one Branches

AMINN_INLINE Branches add_product(Branches a, Branches b, Branches c)
{
    return a + b * c;
}
AMINN_INLINE Branches subtract_product(Branches a, Branches b, Branches c)
{
    return a - b * c;
}
AMINN_INLINE Branches broadcast(float x)
{
    return Branches{x, x, x, x};
}
AMINN_INLINE Branches root(Branches x)
{
    return Branches{root(x[0]), root(x[1]), root(x[2]), root(x[3])};
}
AMINN_INLINE Branches sigmoid(Branches x)
{
    return Branches{sigmoid(x[0]), sigmoid(x[1]), sigmoid(x[2]), 0.0F};
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

#else // one component after the other

#define AMINN_UNROLL_ROWS

struct Row {
    float v[kMotion];
    AMINN_INLINE float operator[](int i) const
    {
        return v[i];
    }
};

AMINN_INLINE void load_row(Row &a, const float *p)
{
    std::memcpy(a.v, p, sizeof a.v);
}

#if AMINN_CORTEX_M
// Rows are loaded and stored as a whole, which the compiler does not do by itself.
#define AMINN_ROW_REGISTERS "s0", "s1", "s2", "s3", "s4", "s5", "s6", "s7", "s8", "s9", "s10", "s11", "memory"
#define AMINN_SIX(operation, factor)                                                                                \
    "    " operation " s0, s6, " factor "\n    " operation " s1, s7, " factor "\n    " operation " s2, s8, " factor \
    "\n    " operation " s3, s9, " factor "\n    " operation " s4, s10, " factor "\n    " operation                 \
    " s5, s11, " factor "\n"
#define AMINN_SIX_PAIRS(operation)                                                                             \
    "    " operation " s0, s0, s6\n    " operation " s1, s1, s7\n    " operation " s2, s2, s8\n    " operation \
    " s3, s3, s9\n    " operation " s4, s4, s10\n    " operation " s5, s5, s11\n"
#define AMINN_LOAD_TWO "    vldmia %[a], {s0-s5}\n    vldmia %[c], {s6-s11}\n"
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
    __asm volatile(AMINN_LOAD_TWO AMINN_SIX("vmla.f32", "%[s]") AMINN_STORE
                   :
                   : [a] "r"(a.v), [c] "r"(c.v), [s] "t"(s)
                   : AMINN_ROW_REGISTERS);
}
AMINN_FUNCTION void subtract_scaled(Row &a, float s, const Row &c)
{
    __asm volatile(AMINN_LOAD_TWO AMINN_SIX("vmls.f32", "%[s]") AMINN_STORE
                   :
                   : [a] "r"(a.v), [c] "r"(c.v), [s] "t"(s)
                   : AMINN_ROW_REGISTERS);
}
AMINN_FUNCTION void add(Row &a, const Row &b)
{
    __asm volatile(AMINN_LOAD_TWO AMINN_SIX_PAIRS("vadd.f32") AMINN_STORE
                   :
                   : [a] "r"(a.v), [c] "r"(b.v)
                   : AMINN_ROW_REGISTERS);
}
AMINN_FUNCTION void multiply(Row &a, const Row &b)
{
    __asm volatile(AMINN_LOAD_TWO AMINN_SIX_PAIRS("vmul.f32") AMINN_STORE
                   :
                   : [a] "r"(a.v), [c] "r"(b.v)
                   : AMINN_ROW_REGISTERS);
}
#else
AMINN_FUNCTION void scale(Row &a, float s, const Row &c)
{
    for (int i = 0; i < kMotion; ++i) {
        a.v[i] = s * c.v[i];
    }
}
AMINN_FUNCTION void add_scaled(Row &a, float s, const Row &c)
{
    for (int i = 0; i < kMotion; ++i) {
        a.v[i] = a.v[i] + s * c.v[i];
    }
}
AMINN_FUNCTION void subtract_scaled(Row &a, float s, const Row &c)
{
    for (int i = 0; i < kMotion; ++i) {
        a.v[i] = a.v[i] - s * c.v[i];
    }
}
AMINN_FUNCTION void add(Row &a, const Row &b)
{
    for (int i = 0; i < kMotion; ++i) {
        a.v[i] = a.v[i] + b.v[i];
    }
}
AMINN_FUNCTION void multiply(Row &a, const Row &b)
{
    for (int i = 0; i < kMotion; ++i) {
        a.v[i] = a.v[i] * b.v[i];
    }
}
#endif

AMINN_INLINE void clear(Row &a)
{
    for (float &component : a.v) {
        component = 0.0F;
    }
}
AMINN_INLINE void clear_up_to(Row &a, int j)
{
    for (; j >= 0; --j) {
        a.v[j] = 0.0F;
    }
}
AMINN_INLINE void set_component(Row &a, int j, float value)
{
    a.v[j] = value;
}

using Branches = float;
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

constexpr int kGroups = kBranch / kSideBySide; // of branches that are computed side by side

AMINN_INLINE Branches dot(const Branches a[3], const Branches b[3])
{
    return add_product(add_product(a[0] * b[0], a[1], b[1]), a[2], b[2]);
}

// the sum of the components
AMINN_FUNCTION float sum(const Row &a)
{
    return ((a[0] + a[1]) + (a[2] + a[3])) + (a[4] + a[5]);
}

// the sum of the products of the components
AMINN_FUNCTION float dot(Row a, const Row &b)
{
    multiply(a, b);
    return sum(a);
}

} // namespace AMINN_CORE
} // namespace aminn

#endif
