// CRC-32 (IEEE 802.3, reflected) of numbers as they stand in a blob: little endian, whatever this processor is.
#ifndef AMINN_SRC_CRC_HPP
#define AMINN_SRC_CRC_HPP

#include "compiler.hpp" // first

#include <stddef.h>
#include <stdint.h>

namespace aminn {

constexpr bool kBigEndian = __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__;

// crc.cpp: of n bytes, going on from the CRC-32 of what stands before them, 0 at first
uint32_t crc32(uint32_t crc, const void *bytes, size_t n);

// The same of n numbers of `size` bytes, 1, 2 or 4.
inline uint32_t crc32(uint32_t crc, const void *numbers, size_t n, size_t size)
{
    if constexpr (kBigEndian) {
        for (size_t i = 0; i < n * size; ++i) {
            crc = crc32(crc, static_cast<const uint8_t *>(numbers) + (i ^ (size - 1)), 1);
        }
        return crc;
    } else {
        return crc32(crc, numbers, n * size);
    }
}

} // namespace aminn

#endif
