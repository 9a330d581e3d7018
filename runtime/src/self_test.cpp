// Does this library, on this processor, compute the bits that it must?
#include "crc.hpp"
#include "parts.hpp"
#include "tables.hpp"

namespace aminn {
namespace {

// what aminn_model_t.content_crc is of
uint32_t content_crc(const aminn_model_t &m)
{
    constexpr size_t kWord = sizeof(uint32_t);
    uint32_t crc =
        crc32(0, &m.n_branch, (offsetof(aminn_model_t, checkpoint_sha256) - offsetof(aminn_model_t, n_branch)) / kWord,
              kWord);
    crc = crc32(crc, m.checkpoint_sha256, sizeof m.checkpoint_sha256 + sizeof m.data_sha256, 1);
    for (const aminn_stage_model_t &stage : m.stage) {
        crc = crc32(crc, &stage.eps_m, 3, kWord);
    }
    for (const TableInfo &info : kTables) {
        Table table;
        find_table(m, info, table);
        crc = crc32(crc, table.numbers, table.n, table.size);
    }
    return crc;
}

// every word of the outputs, and of what both stages computed on the way
bool answers_as_known(aminn_t &ctx)
{
    const aminn_known_answer_t &known = *ctx.model->known_answer;
    const uint32_t flags = ctx.flags;
    aminn_output_t out;
    ctx.flags = AMINN_FLAG_ALWAYS_STAGE2 | AMINN_FLAG_DEBUG;
    bool same = aminn_predict_state(&ctx, &known.state, &out) == AMINN_OK;
    ctx.flags = flags;
    ctx.stages_done = 0;
    const auto *got = reinterpret_cast<const uint8_t *>(&out);
    const auto *want = reinterpret_cast<const uint8_t *>(&known.output);
    for (size_t i = 0; i < sizeof out; ++i) {
        same = same && got[i] == want[i];
    }
    return same && crc32(0, ctx.stage, sizeof ctx.stage / (sizeof(float)), sizeof(float)) == ctx.model->stages_crc;
}

} // namespace
} // namespace aminn

aminn_status_t aminn_self_test(aminn_t *ctx)
{
    using namespace aminn;
    if (ctx == nullptr) {
        return AMINN_E_NULL;
    }
    if (!initialised(*ctx)) {
        return AMINN_E_NOT_INITIALISED;
    }
    const aminn_status_t arithmetic = AMINN_ON_BEST_CORE(probe_arithmetic());
    if (arithmetic != AMINN_OK) {
        return arithmetic;
    }
    if (content_crc(*ctx->model) != ctx->model->content_crc) {
        return AMINN_E_CRC;
    }
    return answers_as_known(*ctx) ? AMINN_OK : AMINN_E_KNOWN_ANSWER;
}
