// A block of a layer, on any machine.
#ifndef AMINN_SRC_DENSE_BLOCK_PLAIN_HPP
#define AMINN_SRC_DENSE_BLOCK_PLAIN_HPP

#include "weights.hpp"

namespace aminn {
inline namespace AMINN_CORE {

constexpr int kBlock = 8;

// y = the sums of the products of x and kBlock outputs' weights, to which b is added first
template <class Weight>
void dense_block(const Weight *w, int step, const float *b, const float *x, int n_in, float *y)
{
    float even[kBlock];
    float odd[kBlock];
    for (int k = 0; k < kBlock; ++k) {
        even[k] = first_of<Weight>(b + k);
        odd[k] = -0.0F;
    }
    int i = 0;
    for (; i + 2 <= n_in; i += 2) {
        for (int k = 0; k < kBlock; ++k) {
            even[k] = even[k] + value_of(w[k]) * x[i];
            odd[k] = odd[k] + value_of(w[step + k]) * x[i + 1];
        }
        w += 2 * step;
    }
    if (i < n_in) {
        for (int k = 0; k < kBlock; ++k) {
            even[k] = even[k] + value_of(w[k]) * x[i];
        }
    }
    for (int k = 0; k < kBlock; ++k) {
        y[k] = even[k] + odd[k];
    }
}

} // namespace AMINN_CORE
} // namespace aminn

#endif
