// Elementary functions of float32, the same bits on every target: only additions, multiplications, divisions and integer
// operations in a fixed order, no branch on the argument, no libm. So the compiler may also run them over whole arrays.
//
// Largest error over all arguments of the stated range, in ULP of the result, beside float64 (make fidelity measures it,
// tests/runtime/test_elementary.cpp holds it):
//
//   exponential           -86 .. 88.72            1 ULP    below: 4.5e-38; above: infinity
//   logarithm             all positive normal     1 ULP
//   hyperbolic_tangent    all                     2 ULP
//   sigmoid               -86 .. all              3 ULP    below: 4.5e-38
//   sine_cosine           |x| <= kMaxAngle        absolute error 1.5 * 2^-24 (an ULP of 1/2 .. 1 is 2^-24)
//
// NaN gives NaN. The polynomials are minimax fits with float32 coefficients (relative error below 5e-9).
#ifndef AMINN_SRC_ELEMENTARY_HPP
#define AMINN_SRC_ELEMENTARY_HPP

#include "core.hpp" // first

#include <float.h>
#include <stdint.h>

namespace aminn {
inline namespace AMINN_CORE {

constexpr float kMaxAngle = 8192.0F; // rad; the reduction of sine and cosine is exact up to it

AMINN_INLINE uint32_t bits_of(float x)
{
    uint32_t u = 0;
    __builtin_memcpy(&u, &x, sizeof u);
    return u;
}

AMINN_INLINE float from_bits(uint32_t u)
{
    float x = 0.0F;
    __builtin_memcpy(&x, &u, sizeof x);
    return x;
}

#if AMINN_LANES // numbers side by side, whose words these are
#define AMINN_SIDE_BY_SIDE(Numbers, Words, bytes)               \
    using Numbers = float __attribute__((vector_size(bytes)));  \
    using Words = uint32_t __attribute__((vector_size(bytes))); \
    AMINN_INLINE Words bits_of(Numbers x)                       \
    {                                                           \
        Words u;                                                \
        __builtin_memcpy(&u, &x, sizeof u);                     \
        return u;                                               \
    }                                                           \
    AMINN_INLINE Numbers from_bits(Words u)                     \
    {                                                           \
        Numbers x;                                              \
        __builtin_memcpy(&x, &u, sizeof x);                     \
        return x;                                               \
    }
AMINN_SIDE_BY_SIDE(Float4, Word4, 16)
#if defined(__AVX__)
AMINN_SIDE_BY_SIDE(Float8, Word8, 32)
#endif
#undef AMINN_SIDE_BY_SIDE
#endif

// Numbers that are not negative are in the order of their bits; -0, NaN and what is negative come after all of them.
constexpr uint32_t kSmallestBits = 1u;
constexpr uint32_t kOneBits = 0x3F800000u;
constexpr uint32_t kLargestBits = 0x7F7FFFFFu; // FLT_MAX

AMINN_INLINE bool within(float x, uint32_t least, uint32_t most)
{
    return bits_of(x) - least <= most - least;
}

// Correctly rounded everywhere by IEEE 754: an instruction, or the C library's.
AMINN_INLINE float root(float x)
{
    return __builtin_sqrtf(x);
}

// a + b c and a - b c, the product rounded as well
AMINN_INLINE float add_product(float a, float b, float c)
{
#if AMINN_CORTEX_M
    __asm("vmla.f32 %0, %1, %2" : "+t"(a) : "t"(b), "t"(c));
    return a;
#else
    return a + b * c;
#endif
}

AMINN_INLINE float subtract_product(float a, float b, float c)
{
#if AMINN_CORTEX_M
    __asm("vmls.f32 %0, %1, %2" : "+t"(a) : "t"(b), "t"(c));
    return a;
#else
    return a - b * c;
#endif
}

// Adding and subtracting it rounds |x| < 2^22 to an integer; its last bits then hold that integer.
constexpr float kRounder = 0x1.8p23F;

// exp(x) = 2 (1 + above_one) half_scale, the latter a power of two. Number: one number, or several side by side.
template <class Number>
struct Exponential {
    Number above_one;
    Number half_scale;
};

template <class Number>
AMINN_INLINE Exponential<Number> split_exponential(Number x)
{
    constexpr float kLog2e = 0x1.715476p0F;
    constexpr float kLn2Hi = 0x1.62e4p-1F; // 15 bits: exact times a small integer
    constexpr float kLn2Lo = 0x1.7f7d1cp-20F;
    const Number largest = Number{} + 88.73F; // above it the result is infinity
    const Number smallest = Number{} - 86.0F;
    x = x > largest ? largest : x;
    x = x < smallest ? smallest : x;
    const Number shifted = x * kLog2e + kRounder;
    const Number n = shifted - kRounder;
    const Number r = (x - n * kLn2Hi) - n * kLn2Lo;
    const Number s = r * r;
    const Number high = (0x1.5554b8p-5F + r * 0x1.123f9p-7F) + s * 0x1.6d8398p-10F;
    const Number p = (0.5F + r * 0x1.55548ap-3F) + s * high;
    // 2^(n - 1): the exponent of infinity is never written, and the last doubling overflows as it should
    return {r + s * p, from_bits((bits_of(shifted) - bits_of(kRounder) + 126u) << 23)};
}

template <class Number>
AMINN_INLINE Number one_exponential(Number x)
{
    const Exponential<Number> e = split_exponential(x);
    return ((1.0F + e.above_one) * e.half_scale) * 2.0F;
}

AMINN_INLINE float one_logarithm(float x)
{
    constexpr float kLn2Hi = 0x1.62e4p-1F;
    constexpr float kLn2Lo = 0x1.7f7d1cp-20F;
    constexpr uint32_t kRootHalf = 0x3F3504F3u; // sqrt(1/2)
    const uint32_t u = bits_of(x) - kRootHalf;
    const float m = from_bits((u & 0x007FFFFFu) + kRootHalf); // sqrt(1/2) .. sqrt(2)
    const float e = static_cast<float>(static_cast<int32_t>(u) >> 23);
    const float r = m - 1.0F;
    const float s = r * r;
    const float p0 = (0x1.555546p-2F + r * -0x1.ffffeep-3F) + s * (0x1.99a542p-3F + r * -0x1.5562ep-3F);
    const float p4 = (0x1.233306p-3F + r * -0x1.fb43dep-4F) + s * (0x1.e64d7p-4F + r * -0x1.e2e482p-4F);
    const float p = p0 + (s * s) * (p4 + (s * s) * 0x1.1b4374p-4F);
    const float tail = (r * s) * p + e * kLn2Lo;
    const float result = (r + (tail - 0.5F * s)) + e * kLn2Hi;
    return x <= FLT_MAX ? result : x; // infinity, NaN
}

// from exp(2 |x|) - 1, which keeps its digits near zero
AMINN_INLINE float one_hyperbolic_tangent(float x)
{
    constexpr float kNear = 0.34375F;
    const float a = __builtin_fabsf(x);
    const Exponential<float> e = split_exponential(a + a); // finite, however large a is
    const float half = e.above_one * e.half_scale + (e.half_scale - 0.5F);
    const float far = half / (half + 1.0F);
    const float near = subtract_product(half, half, far); // the same number, without the rounding of half + 1
    return __builtin_copysignf(a < kNear ? near : far, x);
}

// Of n numbers in their place, and of one. Where code is to be small there is one copy, which loads its constants once.
#define AMINN_OF_NUMBERS(name, names)          \
    AMINN_FUNCTION void names(float *x, int n) \
    {                                          \
        for (int i = 0; i < n; ++i) {          \
            x[i] = one_##name(x[i]);           \
        }                                      \
    }                                          \
    AMINN_INLINE float name(float x)           \
    {                                          \
        names(&x, 1);                          \
        return x;                              \
    }
AMINN_OF_NUMBERS(exponential, exponentials)
AMINN_OF_NUMBERS(logarithm, logarithms)
AMINN_OF_NUMBERS(hyperbolic_tangent, hyperbolic_tangents)
#undef AMINN_OF_NUMBERS

AMINN_FUNCTION float sigmoid(float x)
{
    return 1.0F / (1.0F + exponential(-x));
}

struct SineCosine {
    float sine;
    float cosine;
};

// |x| <= kMaxAngle
AMINN_FUNCTION SineCosine sine_cosine(float x)
{
    constexpr float kTwoOverPi = 0x1.45f306p-1F;
    constexpr float kHalfPi1 = 0x1.92p0F; // 9 and 11 bits: exact times an integer below 2^13
    constexpr float kHalfPi2 = 0x1.fb4p-12F;
    constexpr float kHalfPi3 = 0x1.4442d2p-24F;
    const float shifted = x * kTwoOverPi + kRounder;
    const float n = shifted - kRounder;
    const float r = ((x - n * kHalfPi1) - n * kHalfPi2) - n * kHalfPi3;
    const float s = r * r;
    const float sine = r + (r * s) * (-0x1.555544p-3F + s * (0x1.1106bcp-7F + s * -0x1.991652p-13F));
    const float cosine = 1.0F + (s * s * (0x1.55554ap-5F + s * (-0x1.6c0c1cp-10F + s * 0x1.99e1d6p-16F)) - 0.5F * s);
    const uint32_t quadrant = bits_of(shifted);
    const float first = (quadrant & 1u) != 0 ? cosine : sine;
    const float second = (quadrant & 1u) != 0 ? sine : cosine;
    return {(quadrant & 2u) != 0 ? -first : first, ((quadrant + 1u) & 2u) != 0 ? -second : second};
}

} // namespace AMINN_CORE
} // namespace aminn

#endif
