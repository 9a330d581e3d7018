// Layers without vector registers: block by block.
#ifndef AMINN_SRC_DENSE_SCALAR_HPP
#define AMINN_SRC_DENSE_SCALAR_HPP

#include "weights.hpp"

#if AMINN_CORTEX_M
#include "dense_block_cortex_m.hpp"
#else
#include "dense_block_plain.hpp"
#endif

namespace aminn {
inline namespace AMINN_CORE {

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

} // namespace AMINN_CORE
} // namespace aminn

#endif
