// CRC-32 with tables for 8 bytes at a time. The library's own, bit by bit, takes nearly all of the time of a loader that is
// fed millions of models; the build without sanitizers is linked with this one in its place.
#include "fast_crc.hpp"

#include <array>
#include <cstring>

#include "crc.hpp"

namespace fuzz {
namespace {

using Table = std::array<std::array<uint32_t, 256>, 8>;

Table make_table()
{
    Table t{};
    for (uint32_t i = 0; i < 256; ++i) {
        t[0][i] = i;
        for (int bit = 0; bit < 8; ++bit) {
            t[0][i] = (t[0][i] >> 1) ^ (0xEDB88320u & (0u - (t[0][i] & 1u)));
        }
    }
    for (size_t k = 1; k < t.size(); ++k) {
        for (uint32_t i = 0; i < 256; ++i) {
            t[k][i] = (t[k - 1][i] >> 8) ^ t[0][t[k - 1][i] & 0xFFu];
        }
    }
    return t;
}

} // namespace

uint32_t crc32(uint32_t crc, const void *bytes, size_t n)
{
    static const Table t = make_table();
    const auto *p = static_cast<const uint8_t *>(bytes);
    crc = ~crc;
    for (; n >= 8; n -= 8, p += 8) {
        uint32_t low = 0;
        uint32_t high = 0;
        std::memcpy(&low, p, 4);
        std::memcpy(&high, p + 4, 4);
        low ^= crc;
        crc = t[7][low & 0xFFu] ^ t[6][low >> 8 & 0xFFu] ^ t[5][low >> 16 & 0xFFu] ^ t[4][low >> 24] ^
              t[3][high & 0xFFu] ^ t[2][high >> 8 & 0xFFu] ^ t[1][high >> 16 & 0xFFu] ^ t[0][high >> 24];
    }
    for (; n > 0; --n) {
        crc = (crc >> 8) ^ t[0][(crc ^ *p++) & 0xFFu];
    }
    return ~crc;
}

} // namespace fuzz

#ifdef AMINN_FUZZ_FAST
namespace aminn {
uint32_t crc32(uint32_t crc, const void *bytes, size_t n)
{
    return fuzz::crc32(crc, bytes, n);
}
} // namespace aminn
#endif
