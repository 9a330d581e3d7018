// The numbers of a weight table: float32; float16, as uint16_t; or int8, of which a weight's value is that many steps of its
// output's size.
#ifndef AMINN_SRC_WEIGHTS_HPP
#define AMINN_SRC_WEIGHTS_HPP

#include "elementary.hpp"

namespace aminn {
inline namespace AMINN_CORE {

// What is done to a sum y of a layer: y < floor becomes 0. NaN stays NaN, so that an overflow is found in the end.
constexpr float kLinear = -__builtin_inff();
constexpr float kRectified = 0.0F;

// Whether sums are of steps: what is behind the biases then are the sizes of each output's steps.
template <class Weight>
constexpr bool scaled()
{
    return sizeof(Weight) == sizeof(int8_t);
}

AMINN_INLINE float value_of(float w)
{
    return w;
}
AMINN_INLINE float value_of(uint16_t w)
{
    const uint32_t u = w;
    // the exponent's bias differs by 112; a multiplication mends it for subnormal numbers too, and is exact
    const float size = from_bits((u & 0x7FFFu) << 13) * 0x1p112F;
    return from_bits(bits_of(size) | (u & 0x8000u) << 16);
}
AMINN_INLINE float value_of(int8_t w)
{
    return static_cast<float>(w);
}

// What the sum of an output's even inputs begins with; that of the odd ones begins with -0, which changes no number.
template <class Weight>
AMINN_INLINE float first_of(const float *b)
{
    return scaled<Weight>() ? -0.0F : *b;
}

// y from the sum of both; its bias, and n_out numbers behind it the size of its steps
template <class Weight>
AMINN_INLINE float finished(float sum, const float *b, int n_out, float floor)
{
    if constexpr (scaled<Weight>()) {
        sum = sum * b[n_out] + *b;
    }
    return sum < floor ? 0.0F : sum;
}

} // namespace AMINN_CORE
} // namespace aminn

#endif
