// Inputs that are some bytes that choose, and floats behind them.
#ifndef AMINN_FUZZ_NUMBERS_HPP
#define AMINN_FUZZ_NUMBERS_HPP

#include <cstddef>
#include <cstdint>

namespace fuzz {

// For LLVMFuzzerCustomMutator: some floats scaled, negated or made extreme, now and then the choices or anything. What an
// input lacks at its end is taken from `whole` first.
size_t mutate_numbers(uint8_t *data, size_t size, size_t max_size, unsigned int seed, size_t choices, const void *whole,
                      size_t whole_size);

} // namespace fuzz

#endif
