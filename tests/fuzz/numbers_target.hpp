// The fuzzer's two functions for a target whose input is a `Whole`, choices first. It comes last in a source that has
// `Whole whole()`, a plausible one, which lends a short input what it lacks, and `int try_one(Whole &)`.
#ifndef AMINN_FUZZ_NUMBERS_TARGET_HPP
#define AMINN_FUZZ_NUMBERS_TARGET_HPP

#include "bytes.hpp"
#include "numbers.hpp"

namespace {

const Whole &plausible()
{
    static const Whole w = whole();
    return w;
}

} // namespace

extern "C" size_t LLVMFuzzerCustomMutator(uint8_t *data, size_t size, size_t max_size, unsigned int seed)
{
    const Whole &w = plausible();
    return fuzz::mutate_numbers(data, size, max_size, seed, sizeof w.choices, &w, sizeof w);
}

extern "C" int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static Whole w;
    w = plausible();
    fuzz::Bytes(data, size).take(w);
    return try_one(w);
}

#endif
