#include "opened.h"

#include <algorithm>
#include <cstddef>
#include <cstring>
#include <memory>
#include <new>
#include <vector>

namespace {

struct alignas(64) Line { // tables begin at multiples of 64 bytes
    unsigned char bytes[64];
};

} // namespace

struct aminn_opened {
    std::vector<Line> blob;
    aminn_model_t model;
    aminn_t ctx;
};

namespace {

aminn_status_t open(aminn_opened &opened, const void *blob, size_t size, uint32_t flags)
{
    opened.blob.resize((size + sizeof(Line) - 1) / sizeof(Line));
    std::memcpy(opened.blob.data(), blob, size);
    const aminn_status_t status = aminn_model_from_blob(opened.blob.data(), size, &opened.model);
    return status == AMINN_OK ? aminn_init(&opened.ctx, &opened.model, flags) : status;
}

} // namespace

const uint32_t aminn_hand_counts[8] = {AMINN_N_BRANCH, AMINN_N_COORD, AMINN_N_JOINT,  AMINN_N_GATED,
                                       AMINN_N_TWIST,  AMINN_N_STIFF, AMINN_N_TENDON, AMINN_N_SLIDE};

aminn_opened_t *aminn_open(const void *blob, size_t size, uint32_t flags, aminn_status_t *status)
{
    *status = AMINN_E_SIZE;
    try {
        auto opened = std::make_unique<aminn_opened>();
        *status = open(*opened, blob, size, flags);
        return *status == AMINN_OK ? opened.release() : nullptr;
    } catch (const std::bad_alloc &) {
        return nullptr;
    }
}

void aminn_close(aminn_opened_t *opened)
{
    delete opened;
}

const aminn_t *aminn_opened_context(const aminn_opened_t *opened)
{
    return &opened->ctx;
}

void aminn_opened_ranges(const aminn_opened_t *opened, float *smallest, float *largest)
{
    std::copy_n(opened->model.range_min, AMINN_N_STATE, smallest);
    std::copy_n(opened->model.range_max, AMINN_N_STATE, largest);
}

aminn_status_t aminn_opened_self_test(const aminn_opened_t *opened)
{
    aminn_t ctx = opened->ctx;
    return aminn_self_test(&ctx);
}
