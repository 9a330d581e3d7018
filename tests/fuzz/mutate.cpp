#include "mutate.hpp"

#include <array>
#include <cfloat>
#include <cmath>
#include <cstring>
#include <iterator>

namespace fuzz {
namespace {

constexpr size_t kSizeAt = 8;
constexpr size_t kCrcAt = 12;
constexpr size_t kCrcStart = 16;

float changed(float v, Random &random)
{
    static const float kSpecial[] = {0.0F,  -0.0F,  1.0F,    -1.0F,    0.5F,    3.14159265F, 1e-3F,    1e6F,
                                     1e18F, 1e-18F, FLT_MAX, -FLT_MAX, FLT_MIN, 1e-45F,      INFINITY, NAN};
    switch (below(random, 5)) {
    case 0:
        return kSpecial[below(random, std::size(kSpecial))];
    case 1:
        return std::ldexp(below(random, 2) != 0 ? 1.0F : -1.0F, static_cast<int>(below(random, 129)) - 64);
    case 2:
        return std::ldexp(v, static_cast<int>(below(random, 129)) - 64);
    case 3:
        return -v;
    default:
        return v * (0.5F + static_cast<float>(below(random, 1000)) * 1e-3F);
    }
}

// by a table of 256, since every changed blob passes here: vector_file.h has it bit by bit
uint32_t crc32(const uint8_t *bytes, size_t n)
{
    static const std::array<uint32_t, 256> table = [] {
        std::array<uint32_t, 256> t{};
        for (uint32_t i = 0; i < 256; ++i) {
            t[i] = i;
            for (int bit = 0; bit < 8; ++bit) {
                t[i] = (t[i] >> 1) ^ (0xEDB88320u & (0u - (t[i] & 1u)));
            }
        }
        return t;
    }();
    uint32_t crc = 0xFFFFFFFFu;
    for (size_t i = 0; i < n; ++i) {
        crc = (crc >> 8) ^ table[(crc ^ bytes[i]) & 0xFFu];
    }
    return ~crc;
}

} // namespace

void mutate_float(uint8_t *at, Random &random)
{
    float v = 0.0F;
    std::memcpy(&v, at, sizeof v);
    v = changed(v, random);
    std::memcpy(at, &v, sizeof v);
}

void seal_blob(uint8_t *data, size_t size)
{
    if (size < kBlobHeader) {
        return;
    }
    const uint32_t length = static_cast<uint32_t>(size);
    const uint32_t crc = crc32(data + kCrcStart, size - kCrcStart);
    std::memcpy(data + kSizeAt, &length, sizeof length);
    std::memcpy(data + kCrcAt, &crc, sizeof crc);
}

} // namespace fuzz
