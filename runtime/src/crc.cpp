#include "crc.hpp"

namespace aminn {

// Bit by bit: it runs at start alone, and tables for more bits at a time are flash.
uint32_t crc32(uint32_t crc, const void *bytes, size_t n)
{
    const auto *byte = static_cast<const uint8_t *>(bytes);
    crc = ~crc;
    for (const uint8_t *const end = byte + n; byte != end; ++byte) {
        crc ^= *byte;
        for (int bit = 0; bit < 8; ++bit) {
            crc = (crc >> 1) ^ (0xEDB88320u & (0u - (crc & 1u)));
        }
    }
    return ~crc;
}

} // namespace aminn
