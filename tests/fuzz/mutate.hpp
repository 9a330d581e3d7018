// Changes of inputs that keep their structure, for libFuzzer's custom mutators.
#ifndef AMINN_FUZZ_MUTATE_HPP
#define AMINN_FUZZ_MUTATE_HPP

#include <cstddef>
#include <cstdint>
#include <random>

// libFuzzer's own mutations
extern "C" size_t LLVMFuzzerMutate(uint8_t *data, size_t size, size_t max_size);

namespace fuzz {

using Random = std::minstd_rand;

inline size_t below(Random &random, size_t n)
{
    return static_cast<size_t>(random()) % n;
}

// The four bytes at `at` as a float: scaled, negated, or an extreme value.
void mutate_float(uint8_t *at, Random &random);

// Size and CRC-32 in a blob's header made right.
void seal_blob(uint8_t *data, size_t size);

// Floats behind the header of a blob with these widths (docs/model-format.md).
constexpr size_t table_floats(size_t hc, size_t h, size_t hd)
{
    return 93 + 2 * (193 + 52 * hc + (hc + 27) * h + (h + 1) * h + 39 * h) + 31 + (h + 17) * hd;
}

constexpr size_t kBlobHeader = 128;
constexpr size_t kBlobWidths = 36; // contact_width, width, classifier_width

} // namespace fuzz

#endif
