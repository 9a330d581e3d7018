// Changes of inputs that keep their structure, for libFuzzer's custom mutators.
#ifndef AMINN_FUZZ_MUTATE_HPP
#define AMINN_FUZZ_MUTATE_HPP

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <random>

#include "tables.hpp"

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

// Whether mark, size and CRC-32 are those of the bytes.
bool is_sealed(const uint8_t *data, size_t size);

constexpr size_t kWidths = 2 + AMINN_N_STAGE; // contact_width, width, classifier_width

// Bytes behind the header of a blob with these widths and float32 weights.
inline size_t table_bytes(const uint32_t widths[kWidths])
{
    aminn_model_t model = {};
    std::memcpy(&model.contact_width, widths, kWidths * sizeof *widths);
    size_t bytes = 0;
    for (const aminn::TableInfo &table : aminn::kTables) {
        bytes += aminn::table_room(model, table);
    }
    return bytes;
}

constexpr size_t kBlobHeader = 384;
constexpr size_t kBlobWidths = 68;
constexpr size_t kBlobScalars = 96; // 14 floats
constexpr size_t kBlobEps = 216;    // 4 floats

} // namespace fuzz

#endif
