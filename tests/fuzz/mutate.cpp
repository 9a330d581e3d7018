#include "mutate.hpp"

#include <cfloat>
#include <cmath>
#include <cstring>
#include <iterator>

#include "fast_crc.hpp"

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
    const uint32_t crc = crc32(0, data + kCrcStart, size - kCrcStart);
    std::memcpy(data + kSizeAt, &length, sizeof length);
    std::memcpy(data + kCrcAt, &crc, sizeof crc);
}

bool is_sealed(const uint8_t *data, size_t size)
{
    uint32_t length = 0;
    uint32_t crc = 0;
    if (size < kBlobHeader) {
        return false;
    }
    std::memcpy(&length, data + kSizeAt, sizeof length);
    std::memcpy(&crc, data + kCrcAt, sizeof crc);
    return std::memcmp(data, "AMNM", 4) == 0 && length == size && crc == crc32(0, data + kCrcStart, size - kCrcStart);
}

} // namespace fuzz
