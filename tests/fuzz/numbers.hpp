// Inputs that are some bytes that choose, and floats behind them.
#ifndef AMINN_FUZZ_NUMBERS_HPP
#define AMINN_FUZZ_NUMBERS_HPP

#include <cstddef>
#include <cstdint>

#include "bytes.hpp"

namespace fuzz {

// For LLVMFuzzerCustomMutator: some floats scaled, negated or made extreme, now and then the choices or anything. What an
// input lacks at its end is taken from `whole` first.
size_t mutate_numbers(uint8_t *data, size_t size, size_t max_size, unsigned int seed, size_t choices, const void *whole,
                      size_t whole_size);

// The same for inputs of one type, whose choices come first.
template <class Whole>
size_t mutate_as(const Whole &plausible, uint8_t *data, size_t size, size_t max_size, unsigned int seed)
{
    return mutate_numbers(data, size, max_size, seed, sizeof plausible.choices, &plausible, sizeof plausible);
}

// An input from bytes; what they lack at their end is taken from `plausible`.
template <class Whole>
Whole whole_of(const Whole &plausible, const uint8_t *data, size_t size)
{
    Whole w = plausible;
    Bytes(data, size).take(w);
    return w;
}

} // namespace fuzz

#endif
