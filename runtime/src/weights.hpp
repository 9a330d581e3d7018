// Weights are float32 or float16 (as uint16_t); a float16 becomes the float32 of the same value.
#ifndef AMINN_SRC_WEIGHTS_HPP
#define AMINN_SRC_WEIGHTS_HPP

#include "elementary.hpp"

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

} // namespace AMINN_CORE
} // namespace aminn

#endif
