#include "batch.hpp"

#include <cstring>
#include <vector>

#include "aminn_rt.h"

namespace batch {

const size_t kOutputWords = sizeof(aminn_output_t) / sizeof(uint32_t);
const size_t kStagesWords = AMINN_N_STAGE * sizeof(aminn_stage_debug_t) / sizeof(uint32_t);
const size_t kInputWords = sizeof(aminn_input_t) / sizeof(float);

namespace {

// A model in memory that the runtime may use in place, and a context for it.
struct Loaded {
    std::vector<uint64_t> bytes;
    aminn_model_t model;
    std::vector<aminn_t> ctx;

    Loaded() : model(), ctx(1)
    {
    }
    aminn_status_t load(const void *blob, size_t size, uint32_t flags)
    {
        bytes.resize((size + sizeof(uint64_t) - 1) / sizeof(uint64_t));
        std::memcpy(bytes.data(), blob, size);
        const aminn_status_t status = aminn_model_from_blob(bytes.data(), size, &model);
        return status == AMINN_OK ? aminn_init(ctx.data(), &model, flags) : status;
    }
};

aminn_status_t predict(aminn_t &ctx, const float *row, size_t columns, aminn_output_t &out)
{
    if (columns == AMINN_N_STATE) {
        aminn_state_t state;
        std::memcpy(&state, row, sizeof state);
        return aminn_predict_state(&ctx, &state, &out);
    }
    aminn_input_t in;
    std::memcpy(&in, row, sizeof in);
    return aminn_predict(&ctx, &in, &out);
}

} // namespace
} // namespace batch

using namespace batch;

int32_t aminn_batch_run(const void *blob, size_t size, const float *rows, size_t n, size_t columns, uint32_t *outputs,
                        uint32_t *stages, int32_t *statuses)
{
    Loaded loaded;
    const aminn_status_t status = loaded.load(blob, size, AMINN_FLAG_ALWAYS_STAGE2 | AMINN_FLAG_DEBUG);
    for (size_t i = 0; status == AMINN_OK && i < n; ++i) {
        aminn_output_t out;
        statuses[i] = predict(loaded.ctx[0], rows + i * columns, columns, out);
        std::memcpy(outputs + i * kOutputWords, &out, sizeof out);
        const aminn_stage_debug_t *first = aminn_debug(loaded.ctx.data(), 0); // the second lies behind it
        if (first != nullptr) {
            std::memcpy(stages + i * kStagesWords, first, kStagesWords * sizeof(uint32_t));
        }
    }
    return status;
}

int32_t aminn_batch_self_test(const void *blob, size_t size)
{
    Loaded loaded;
    const aminn_status_t status = loaded.load(blob, size, 0);
    return status == AMINN_OK ? aminn_self_test(loaded.ctx.data()) : status;
}
