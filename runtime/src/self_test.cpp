// Does this library, on this processor, compute the bits that it must?
#include "crc.hpp"
#include "parts.hpp"
#include "tables.hpp"

namespace aminn {
namespace {

constexpr size_t kWord = sizeof(uint32_t);

// what aminn_model_t.content_crc is of
uint32_t content_crc(const aminn_model_t &m)
{
    constexpr size_t kNumbers = offsetof(aminn_model_t, checkpoint_sha256) - offsetof(aminn_model_t, n_branch);
    constexpr size_t kDigests = sizeof m.checkpoint_sha256 + sizeof m.data_sha256;
    uint32_t crc = 0;
    if constexpr (kBigEndian) {
        crc = crc32(0, &m.n_branch, kNumbers / kWord, kWord);
        crc = crc32(crc, m.checkpoint_sha256, kDigests);
    } else {
        crc = crc32(0, &m.n_branch, kNumbers + kDigests);
    }
    for (const aminn_stage_model_t &stage : m.stage) {
        crc = crc32(crc, &stage.eps_kx, 2, kWord);
    }
    for (const TableInfo &info : kTables) {
        Table table;
        find_table(m, info, table);
        crc = crc32(crc, table.numbers, table.n, table.size);
    }
    return crc;
}

// Does a prediction give every word of the known answer, and did both stages compute what they must on the way?
bool answers_as_known(aminn_t &ctx)
{
    const aminn_known_answer_t &known = *ctx.model->known_answer;
    const uint32_t flags = ctx.flags;
    const aminn_varied_t *const varied = ctx.varied;
    auto *const correct = ctx.correct;
    auto *const sense = ctx.sense;
    aminn_output_t out;
    ctx.varied = &ctx.model->nominal;
    ctx.correct = nullptr;
    ctx.sense = nullptr;
    forget_sensors(ctx);
    ctx.flags = AMINN_FLAG_ALWAYS_STAGE2 | AMINN_FLAG_DEBUG;
    auto other = static_cast<uint32_t>(aminn_predict_state(&ctx, &known.state, &out));
    ctx.flags = flags;
    ctx.varied = varied;
    ctx.correct = correct;
    ctx.sense = sense;
    ctx.stages_done = 0;
    other |= crc32(0, ctx.stage, sizeof ctx.stage / kWord, kWord) ^ ctx.model->stages_crc;
    const void *got = &out; // bits, not numbers
    const void *want = &known.output;
    other |= static_cast<uint32_t>(__builtin_memcmp(got, want, sizeof out));
    return other == 0;
}

} // namespace
} // namespace aminn

aminn_status_t aminn_self_test(aminn_t *ctx)
{
    using namespace aminn;
    aminn_status_t status = context_status(ctx);
    if (status != AMINN_OK) {
        return status;
    }
    status = AMINN_ON_BEST_CORE(probe_arithmetic());
    status = status == AMINN_OK ? probe_closure() : status;
    if (status != AMINN_OK) {
        return status;
    }
    if (content_crc(*ctx->model) != ctx->model->content_crc) {
        return AMINN_E_CRC;
    }
    return answers_as_known(*ctx) ? AMINN_OK : AMINN_E_KNOWN_ANSWER;
}
