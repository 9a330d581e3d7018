#include "crc.hpp"

namespace aminn {

#if __BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__
constexpr bool kReversed = false;
#else
constexpr bool kReversed = true;
#endif

// Bit by bit: it runs at start alone, and tables for more bits at a time are flash.
uint32_t crc32(uint32_t crc, const void *numbers, size_t n, size_t size)
{
    const auto *bytes = static_cast<const uint8_t *>(numbers);
    crc = ~crc;
    for (size_t i = 0; i < n * size; ++i) {
        crc ^= bytes[kReversed ? i ^ (size - 1) : i];
        for (int bit = 0; bit < 8; ++bit) {
            crc = (crc >> 1) ^ (0xEDB88320u & (0u - (crc & 1u)));
        }
    }
    return ~crc;
}

} // namespace aminn
