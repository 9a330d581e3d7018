// Vectors of three numbers.
#ifndef AMINN_SRC_VECTOR3_HPP
#define AMINN_SRC_VECTOR3_HPP

#include "elementary.hpp"

namespace aminn {
inline namespace AMINN_CORE {

AMINN_FUNCTION void subtract(const float *a, const float *b, float *out)
{
    for (int i = 0; i < 3; ++i) {
        out[i] = a[i] - b[i];
    }
}

AMINN_FUNCTION float dot3(const float *a, const float *b)
{
    return add_product(add_product(a[0] * b[0], a[1], b[1]), a[2], b[2]);
}

AMINN_FUNCTION void cross(const float *a, const float *b, float *out)
{
    const float a0 = a[0];
    const float a1 = a[1];
    const float a2 = a[2];
    const float b0 = b[0];
    const float b1 = b[1];
    const float b2 = b[2];
    out[0] = subtract_product(a1 * b2, a2, b1);
    out[1] = subtract_product(a2 * b0, a0, b2);
    out[2] = subtract_product(a0 * b1, a1, b0);
}

} // namespace AMINN_CORE
} // namespace aminn

#endif
