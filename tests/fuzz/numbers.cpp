// The mutator of targets whose input is some bytes that choose, and floats behind them.
#include "numbers.hpp"

#include <algorithm>
#include <cstring>

#include "mutate.hpp"

namespace fuzz {

size_t mutate_numbers(uint8_t *data, size_t size, size_t max_size, unsigned int seed, size_t choices, const void *whole,
                      size_t whole_size)
{
    Random random(seed);
    const size_t kind = below(random, 8);
    if (max_size < whole_size || kind == 0) {
        return LLVMFuzzerMutate(data, size, max_size);
    }
    if (size < whole_size) {
        std::memcpy(data + size, static_cast<const uint8_t *>(whole) + size, whole_size - size);
        size = whole_size;
    }
    if (kind == 1) {
        LLVMFuzzerMutate(data, choices, choices);
        return size;
    }
    const size_t floats = (size - choices) / sizeof(float);
    for (size_t n = 1 + below(random, 4); n > 0; --n) {
        mutate_float(data + choices + sizeof(float) * below(random, floats), random);
    }
    return size;
}

} // namespace fuzz
