// Weights of 2 bytes each.
#include "dense.hpp"
#include "storage.hpp"

namespace aminn {
namespace {

bool float16_sound(const void *w, uint32_t n)
{
    const auto *values = static_cast<const uint16_t *>(w);
    bool ok = true;
    for (uint32_t i = 0; i < n; ++i) {
        ok = ok && (values[i] & 0x7C00u) != 0x7C00u;
    }
    return ok;
}

} // namespace
} // namespace aminn

extern "C" const aminn_storage_t aminn_storage_float16 =
    AMINN_STORAGE(AMINN_WEIGHTS_FLOAT16, aminn::float16_sound, uint16_t);
