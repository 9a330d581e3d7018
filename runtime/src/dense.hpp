// y = W x + b, W stored [input][output], so that y is a sum of contiguous rows of memory:
//
//      y      b       w_0        w_1
//     | | =  | |  +  |   | x0 + |   | x1 + ...
//
// Each output has two sums, of its even and of its odd inputs, added in the end (the latter begins with -0, which adds
// nothing to any number): half the rounding errors of one sum, and twice as many independent operations. A block of
// outputs stays in registers while the weights stream by. The last block may overlap the one before it: its outputs are
// computed again, with the same result. Of int8 weights sums begin with -0 and are of steps: the sum of both is multiplied by
// the size of the output's steps, then its bias is added.
#ifndef AMINN_SRC_DENSE_HPP
#define AMINN_SRC_DENSE_HPP

#include "core.hpp" // first

#if AMINN_LANES
#include "dense_vector.hpp"
#else
#include "dense_scalar.hpp"
#endif

#endif
