// y = W x + b, W stored [input][output], so that y is a sum of contiguous rows of memory:
//
//      y      b       w_0        w_1
//     | | =  | |  +  |   | x0 + |   | x1 + ...
//
// Each output has two sums, of its even and of its odd inputs, added in the end (the latter begins with -0, which adds
// nothing to any number): half the rounding errors of one sum, and twice as many independent operations. A block of
// outputs stays in registers while the weights stream by. The last block may overlap the one before it: its outputs are
// computed again, with the same result.
#ifndef AMINN_SRC_DENSE_HPP
#define AMINN_SRC_DENSE_HPP

#include "lanes.hpp" // first

#include <type_traits>

// Weights are float32 or float16 (as uint16_t); a float16 becomes the float32 of the same value.
namespace aminn {
inline namespace AMINN_CORE {

// What is done to a sum y of a layer: y < floor becomes 0. NaN stays NaN, so that an overflow is found in the end.
constexpr float kLinear = -INFINITY;
constexpr float kRectified = 0.0F;

AMINN_INLINE float value_of(uint16_t w)
{
    const uint32_t u = w;
    // the exponent's bias differs by 112; a multiplication mends it for subnormal numbers too, and is exact
    const float size = from_bits((u & 0x7FFFu) << 13) * 0x1p112F;
    return from_bits(bits_of(size) | (u & 0x8000u) << 16);
}

#if AMINN_LANES

#if defined(__AVX__)
using Register = float __attribute__((vector_size(32)));
#else
using Register = float __attribute__((vector_size(16)));
#endif
#if defined(__AVX512F__) // a cache line: for rows of whole lines only, others begin within one
using LineRegister = float __attribute__((vector_size(64)));
#else
using LineRegister = Register;
#endif
template <class AnyRegister>
constexpr int kLanes = sizeof(AnyRegister) / sizeof(float);
constexpr int kRegisters = 5; // of outputs at most: with two sums each, and one for a weight, they fit 16

#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Warray-bounds" // of pointers that are null, which gcc's sanitizers look for
template <class AnyRegister>
AMINN_INLINE void load(const float *w, AnyRegister &r)
{
    std::memcpy(&r, w, sizeof r);
}
#pragma GCC diagnostic pop

template <class AnyRegister>
AMINN_INLINE void load(const uint16_t *w, AnyRegister &r)
{
    float values[kLanes<AnyRegister>];
    for (int k = 0; k < kLanes<AnyRegister>; ++k) {
        values[k] = value_of(w[k]);
    }
    std::memcpy(&r, values, sizeof r);
}

// kCount registers of outputs, side by side but for the last, which begins at `last`
template <class AnyRegister, int kCount, class Weight>
AMINN_INLINE void dense_block(const Weight *w, int step, const float *b, const float *x, int n_in, int last,
                              float floor, float *y)
{
    const auto place = [last](int k) { return k < kCount - 1 ? k * kLanes<AnyRegister> : last; };
    AnyRegister even[kCount];
    AnyRegister odd[kCount];
    AMINN_UNROLL_ROWS
    for (int k = 0; k < kCount; ++k) {
        AnyRegister r;
        load(b + place(k), r);
        even[k] = r;
        odd[k] = -AnyRegister{};
    }
    int i = 0;
    const auto add = [&](AnyRegister(&sums)[kCount], const Weight *row, float factor) {
        AMINN_UNROLL_ROWS
        for (int k = 0; k < kCount; ++k) {
            AnyRegister r;
            load(row + place(k), r);
            sums[k] = sums[k] + r * factor;
        }
    };
    for (; i + 2 <= n_in; i += 2) {
        add(even, w, x[i]);
        add(odd, w + step, x[i + 1]);
        w += 2 * step;
    }
    if (i < n_in) {
        add(even, w, x[i]);
    }
    AMINN_UNROLL_ROWS
    for (int k = 0; k < kCount; ++k) {
        even[k] = even[k] + odd[k];
        even[k] = even[k] < floor ? AnyRegister{} : even[k];
        std::memcpy(y + place(k), &even[k], sizeof even[k]);
    }
}

template <class AnyRegister, class Weight>
[[gnu::noinline]] void dense_of(const Weight *w, const float *b, const float *x, int n_in, int n_out, float floor,
                                float *y)
{
    constexpr int kWidth = kLanes<AnyRegister>;
    int at = 0;
    for (; n_out - at > kRegisters * kWidth; at += 4 * kWidth) { // a register or more is left
        dense_block<AnyRegister, 4>(w + at, n_out, b + at, x, n_in, 3 * kWidth, floor, y + at);
    }
    const int last = n_out - at - kWidth; // of the rest; the last register may share outputs with the one before it
    const auto rest = [&](auto count) {
        dense_block<AnyRegister, count>(w + at, n_out, b + at, x, n_in, last, floor, y + at);
    };
    switch ((last + kWidth - 1) / kWidth) {
    case 0:
        rest(std::integral_constant<int, 1>());
        break;
    case 1:
        rest(std::integral_constant<int, 2>());
        break;
    case 2:
        rest(std::integral_constant<int, 3>());
        break;
    case 3:
        rest(std::integral_constant<int, 4>());
        break;
    default:
        rest(std::integral_constant<int, kRegisters>());
        break;
    }
}

AMINN_INLINE float value_of(float w)
{
    return w;
}

// outputs that do not fill a register
template <class Weight>
[[gnu::noinline]] void dense_by_numbers(const Weight *w, const float *b, const float *x, int n_in, int n_out,
                                        float floor, float *y)
{
    for (int at = 0; at < n_out; ++at) {
        float even = b[at];
        float odd = -0.0F;
        int i = 0;
        for (; i + 2 <= n_in; i += 2) {
            even = even + value_of(w[i * n_out + at]) * x[i];
            odd = odd + value_of(w[(i + 1) * n_out + at]) * x[i + 1];
        }
        if (i < n_in) {
            even = even + value_of(w[i * n_out + at]) * x[i];
        }
        const float sum = even + odd;
        y[at] = sum < floor ? 0.0F : sum;
    }
}

template <class Weight>
AMINN_INLINE void dense(const Weight *w, const float *b, const float *x, int n_in, int n_out, float floor, float *y)
{
    if (n_out % kLanes<LineRegister> == 0) {
        dense_of<LineRegister>(w, b, x, n_in, n_out, floor, y);
    } else if (n_out >= kLanes<Register>) {
        dense_of<Register>(w, b, x, n_in, n_out, floor, y);
    } else {
        dense_by_numbers(w, b, x, n_in, n_out, floor, y);
    }
}

inline void dense(const void *w, uint32_t weight_type, const float *b, const float *x, int n_in, int n_out, float floor,
                  float *y)
{
    if (weight_type == AMINN_WEIGHTS_FLOAT16) {
        dense(static_cast<const uint16_t *>(w), b, x, n_in, n_out, floor, y);
    } else {
        dense(static_cast<const float *>(w), b, x, n_in, n_out, floor, y);
    }
}

#else

constexpr int kBlock = 8;

#if AMINN_CORTEX_M
// a row of weights times one input, added to the even sums s0-s7 or to the odd sums s8-s15
#define AMINN_LOAD_ROW "    vldmia %[w], {s16-s23}\n    add %[w], %[step]\n"
#define AMINN_ADD_EVEN                                                                                 \
    AMINN_LOAD_ROW "    vmla.f32 s0, s16, s24\n    vmla.f32 s1, s17, s24\n    vmla.f32 s2, s18, s24\n" \
                   "    vmla.f32 s3, s19, s24\n    vmla.f32 s4, s20, s24\n    vmla.f32 s5, s21, s24\n" \
                   "    vmla.f32 s6, s22, s24\n    vmla.f32 s7, s23, s24\n"
#define AMINN_ADD_ODD                                                                                     \
    AMINN_LOAD_ROW "    vmla.f32 s8, s16, s25\n    vmla.f32 s9, s17, s25\n    vmla.f32 s10, s18, s25\n"   \
                   "    vmla.f32 s11, s19, s25\n    vmla.f32 s12, s20, s25\n    vmla.f32 s13, s21, s25\n" \
                   "    vmla.f32 s14, s22, s25\n    vmla.f32 s15, s23, s25\n"
#endif

// a block of float32 weights
inline void dense_block(const float *w, int step, const float *b, const float *x, int n_in, float *y)
{
#if AMINN_CORTEX_M
    __asm volatile("    vldmia %[b], {s0-s7}\n"
                   "    vldmia %[zero], {s8-s15}\n"
                   "    b 2f\n"
                   "1:  vldmia %[x]!, {s24-s25}\n" AMINN_ADD_EVEN AMINN_ADD_ODD "2:  subs %[n], #2\n"
                   "    bge 1b\n"
                   "    adds %[n], #1\n"
                   "    blt 3f\n"
                   "    vldr s24, [%[x]]\n" AMINN_ADD_EVEN "3:  vadd.f32 s0, s0, s8\n"
                   "    vadd.f32 s1, s1, s9\n"
                   "    vadd.f32 s2, s2, s10\n"
                   "    vadd.f32 s3, s3, s11\n"
                   "    vadd.f32 s4, s4, s12\n"
                   "    vadd.f32 s5, s5, s13\n"
                   "    vadd.f32 s6, s6, s14\n"
                   "    vadd.f32 s7, s7, s15\n"
                   "    vstmia %[y], {s0-s7}"
                   : [w] "+r"(w), [x] "+r"(x), [n] "+r"(n_in)
                   : [b] "r"(b), [y] "r"(y), [step] "r"(step * static_cast<int>(sizeof *w)), [zero] "r"(kMinusZeros)
                   : "s0", "s1", "s2", "s3", "s4", "s5", "s6", "s7", "s8", "s9", "s10", "s11", "s12", "s13", "s14",
                     "s15", "s16", "s17", "s18", "s19", "s20", "s21", "s22", "s23", "s24", "s25", "cc", "memory");
#else
    float even[kBlock];
    float odd[kBlock];
    for (int k = 0; k < kBlock; ++k) {
        even[k] = b[k];
        odd[k] = -0.0F;
    }
    int i = 0;
    for (; i + 2 <= n_in; i += 2) {
        for (int k = 0; k < kBlock; ++k) {
            even[k] = even[k] + w[k] * x[i];
            odd[k] = odd[k] + w[step + k] * x[i + 1];
        }
        w += 2 * step;
    }
    if (i < n_in) {
        for (int k = 0; k < kBlock; ++k) {
            even[k] = even[k] + w[k] * x[i];
        }
    }
    for (int k = 0; k < kBlock; ++k) {
        y[k] = even[k] + odd[k];
    }
#endif
}

inline void dense(const void *w, uint32_t weight_type, const float *b, const float *x, int n_in, int n_out, float floor,
                  float *y)
{
    const auto *w32 = static_cast<const float *>(w);
    const auto *w16 = static_cast<const uint16_t *>(w);
    const bool half = weight_type == AMINN_WEIGHTS_FLOAT16; // for half the flash, and not for speed
    int at = 0;
    for (; n_out >= kBlock && !half && at < n_out; at += kBlock) {
        const int from = at + kBlock <= n_out ? at : n_out - kBlock;
        dense_block(w32 + from, n_out, b + from, x, n_in, y + from);
    }
    for (; at < n_out; ++at) {
        float next = b[at]; // the sum of the even inputs, and after each step that of the others
        float other = -0.0F;
        for (int i = 0; i < n_in; ++i) {
            const int k = i * n_out + at;
            const float sum = next + (half ? value_of(w16[k]) : w32[k]) * x[i];
            next = other;
            other = sum;
        }
        y[at] = next + other;
    }
    for (int i = 0; i < n_out; ++i) {
        y[i] = y[i] < floor ? 0.0F : y[i];
    }
}

#endif

} // namespace AMINN_CORE
} // namespace aminn

#endif
