// Layers without vector registers: block by block. A model brings along the code for weights that are not float32
// (storage.hpp), so that an image holds that of its own model alone.
#ifndef AMINN_SRC_DENSE_SCALAR_HPP
#define AMINN_SRC_DENSE_SCALAR_HPP

#include "storage.hpp"
#include "weights.hpp"

#if AMINN_CORTEX_M
#include "dense_block_cortex_m.hpp"
#else
#include "dense_block_plain.hpp"
#endif

namespace aminn {
inline namespace AMINN_CORE {

// out = (v - mean) * inv_std
[[maybe_unused]] static void normalise(const float *v, const float *mean, const float *inv_std, int n, float *out)
{
    for (int i = 0; i < n; ++i) {
        out[i] = (v[i] - mean[i]) * inv_std[i];
    }
}

template <class Weight>
AMINN_INLINE void dense_of(const Weight *w, const float *b, const float *x, int n_in, int n_out, float floor, float *y)
{
    int at = 0;
    for (; n_out >= kBlock && at < n_out; at += kBlock) {
        const int from = at + kBlock <= n_out ? at : n_out - kBlock;
        dense_block(w + from, n_out, b + from, x, n_in, y + from);
    }
    for (; at < n_out; ++at) {
        float next = first_of<Weight>(b + at); // the sum of the even inputs, and after each step that of the others
        float other = -0.0F;
        for (int i = 0; i < n_in; ++i) {
            const float sum = next + value_of(w[i * n_out + at]) * x[i];
            next = other;
            other = sum;
        }
        y[at] = next + other;
    }
    for (int i = 0; i < n_out; ++i) {
        y[i] = finished<Weight>(y[i], b + i, n_out, floor);
    }
}

// of a storage (storage.hpp)
template <class Weight>
void dense_stored(const aminn_model_t &, const void *w, const float *b, const float *x, int n_in, int n_out,
                  float floor, float *y)
{
    dense_of(static_cast<const Weight *>(w), b, x, n_in, n_out, floor, y);
}

inline void dense(const aminn_model_t &model, const void *w, const float *b, const float *x, int n_in, int n_out,
                  float floor, float *y)
{
    if (model.storage != nullptr) {
        model.storage->dense(model, w, b, x, n_in, n_out, floor, y);
        return;
    }
    dense_of(static_cast<const float *>(w), b, x, n_in, n_out, floor, y);
}

} // namespace AMINN_CORE
} // namespace aminn

#endif
