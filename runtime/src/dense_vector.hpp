// Layers in vector registers.
#ifndef AMINN_SRC_DENSE_VECTOR_HPP
#define AMINN_SRC_DENSE_VECTOR_HPP

#if defined(__AVX2__)
#include <immintrin.h>
#elif defined(__SSE2__)
#include <emmintrin.h>
#elif defined(__aarch64__)
#include <arm_neon.h>
#endif

#include "weights.hpp"

namespace aminn {
inline namespace AMINN_CORE {

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
    __builtin_memcpy(&r, w, sizeof r);
}
#pragma GCC diagnostic pop

#if defined(__SSE2__) // which gcc does not find by itself
AMINN_INLINE void load(const int8_t *w, float __attribute__((vector_size(16))) & r)
{
    int32_t four = 0;
    __builtin_memcpy(&four, w, sizeof four);
    const __m128i bytes = _mm_cvtsi32_si128(four);
    const __m128i pairs = _mm_unpacklo_epi8(bytes, bytes);
    r = _mm_cvtepi32_ps(_mm_srai_epi32(_mm_unpacklo_epi16(pairs, pairs), 24));
}
#endif
#if defined(__AVX2__)
AMINN_INLINE void load(const int8_t *w, float __attribute__((vector_size(32))) & r)
{
    r = _mm256_cvtepi32_ps(_mm256_cvtepi8_epi32(_mm_loadl_epi64(reinterpret_cast<const __m128i *>(w))));
}
#endif
#if defined(__AVX512F__)
AMINN_INLINE void load(const int8_t *w, float __attribute__((vector_size(64))) & r)
{
    constexpr __mmask16 kAll = 0xFFFF; // gcc warns of the intrinsics without a mask
    const __m128i bytes = _mm_loadu_si128(reinterpret_cast<const __m128i *>(w));
    r = _mm512_maskz_cvtepi32_ps(kAll, _mm512_maskz_cvtepi8_epi32(kAll, bytes));
}
#endif

#if defined(__aarch64__) && !defined(__AARCH64EB__)
AMINN_INLINE void load(const int8_t *w, float __attribute__((vector_size(16))) & r)
{
    uint32_t four = 0;
    __builtin_memcpy(&four, w, sizeof four);
    r = vcvtq_f32_s32(vmovl_s16(vget_low_s16(vmovl_s8(vreinterpret_s8_u32(vdup_n_u32(four))))));
}
#endif

template <class Weight, class AnyRegister>
AMINN_INLINE void load(const Weight *w, AnyRegister &r)
{
    float values[kLanes<AnyRegister>];
    for (int k = 0; k < kLanes<AnyRegister>; ++k) {
        values[k] = value_of(w[k]);
    }
    __builtin_memcpy(&r, values, sizeof r);
}

// out = (v - mean) * inv_std, a register at a time; the last one may share numbers with the one before it
template <class AnyRegister>
AMINN_INLINE void normalise_by(const float *v, const float *mean, const float *inv_std, int n, float *out)
{
    for (int at = 0; at < n; at += kLanes<AnyRegister>) {
        const int i = at + kLanes<AnyRegister> <= n ? at : n - kLanes<AnyRegister>;
        AnyRegister x;
        AnyRegister middle;
        AnyRegister factor;
        load(v + i, x);
        load(mean + i, middle);
        load(inv_std + i, factor);
        x = (x - middle) * factor;
        __builtin_memcpy(out + i, &x, sizeof x);
    }
}
AMINN_FUNCTION void normalise(const float *v, const float *mean, const float *inv_std, int n, float *out)
{
    if (n >= kLanes<Register>) {
        normalise_by<Register>(v, mean, inv_std, n, out);
    } else if (n >= kLanes<Float4>) {
        normalise_by<Float4>(v, mean, inv_std, n, out);
    } else {
        normalise_by<float>(v, mean, inv_std, n, out);
    }
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
        AnyRegister r = -AnyRegister{};
        odd[k] = r;
        if constexpr (!scaled<Weight>()) {
            load(b + place(k), r);
        }
        even[k] = r;
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
        if constexpr (scaled<Weight>()) { // as many numbers as the layer has outputs lie between two rows
            AnyRegister size;
            AnyRegister r;
            load(b + step + place(k), size);
            load(b + place(k), r);
            even[k] = even[k] * size + r;
        }
        even[k] = even[k] < floor ? AnyRegister{} : even[k];
        __builtin_memcpy(y + place(k), &even[k], sizeof even[k]);
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
    w += at;
    b += at;
    y += at;
    switch ((last + kWidth - 1) / kWidth) {
    case 0:
        dense_block<AnyRegister, 1>(w, n_out, b, x, n_in, last, floor, y);
        break;
    case 1:
        dense_block<AnyRegister, 2>(w, n_out, b, x, n_in, last, floor, y);
        break;
    case 2:
        dense_block<AnyRegister, 3>(w, n_out, b, x, n_in, last, floor, y);
        break;
    case 3:
        dense_block<AnyRegister, 4>(w, n_out, b, x, n_in, last, floor, y);
        break;
    default:
        dense_block<AnyRegister, kRegisters>(w, n_out, b, x, n_in, last, floor, y);
        break;
    }
}

// outputs that do not fill a register
template <class Weight>
[[gnu::noinline]] void dense_by_numbers(const Weight *w, const float *b, const float *x, int n_in, int n_out,
                                        float floor, float *y)
{
    for (int at = 0; at < n_out; ++at) {
        float even = first_of<Weight>(b + at);
        float odd = -0.0F;
        int i = 0;
        for (; i + 2 <= n_in; i += 2) {
            even = even + value_of(w[i * n_out + at]) * x[i];
            odd = odd + value_of(w[(i + 1) * n_out + at]) * x[i + 1];
        }
        if (i < n_in) {
            even = even + value_of(w[i * n_out + at]) * x[i];
        }
        y[at] = finished<Weight>(even + odd, b + at, n_out, floor);
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

inline void dense(const aminn_model_t &model, const void *w, const float *b, const float *x, int n_in, int n_out,
                  float floor, float *y)
{
    switch (model.weight_type) {
    case AMINN_WEIGHTS_FLOAT16:
        dense(static_cast<const uint16_t *>(w), b, x, n_in, n_out, floor, y);
        break;
    case AMINN_WEIGHTS_INT8:
        dense(static_cast<const int8_t *>(w), b, x, n_in, n_out, floor, y);
        break;
    default:
        dense(static_cast<const float *>(w), b, x, n_in, n_out, floor, y);
    }
}

} // namespace AMINN_CORE
} // namespace aminn

#endif
