#ifndef AMINN_FUZZ_FAST_CRC_HPP
#define AMINN_FUZZ_FAST_CRC_HPP

#include <cstddef>
#include <cstdint>

namespace fuzz {

// Of n bytes, going on from the CRC-32 of what stands before them, 0 at first.
uint32_t crc32(uint32_t crc, const void *bytes, size_t n);

} // namespace fuzz

#endif
