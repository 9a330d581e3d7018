// CRC-32 (IEEE 802.3, reflected) of numbers as they stand in a blob: little endian, whatever this processor is.
#ifndef AMINN_SRC_CRC_HPP
#define AMINN_SRC_CRC_HPP

#include "compiler.hpp" // first

#include <cstddef>
#include <cstdint>

namespace aminn {

// crc.cpp: of n numbers of `size` bytes (1, 2 or 4), going on from the CRC-32 of what stands before them, 0 at first
uint32_t crc32(uint32_t crc, const void *numbers, size_t n, size_t size);

} // namespace aminn

#endif
