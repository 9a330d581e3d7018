// Fuzz target: any bytes as a model. What aminn_model_from_blob accepts is initialised and predicts once; the outputs
// must be the documented ones whatever the model.
#include <algorithm>
#include <cstring>

#include "checks.hpp"
#include "mutate.hpp"

using namespace fuzz;

namespace {

aminn_t ctx;
aminn_model_t model;
aminn_output_t out;

void check_refused(aminn_status_t status)
{
    FUZZ_CHECK((status <= AMINN_E_DIMS && status >= AMINN_E_ALIGN) || status == AMINN_E_BYTE_ORDER);
    FUZZ_CHECK(model.format_version == 0 && model.wrench_log_scale == nullptr && model.cls2_b == nullptr);
    FUZZ_CHECK(model.stage[0].contact_mean == nullptr && model.stage[1].head_b == nullptr);
    FUZZ_CHECK(aminn_init(&ctx, &model, 0) == AMINN_E_VERSION);
    FUZZ_CHECK(aminn_predict(&ctx, &golden_input(), &out) == AMINN_E_NOT_INITIALISED);
}

bool in_range(float v, float least, float most)
{
    return v >= least && v <= most; // false for NaN
}

// what a good model has, found without the library's checks: tables inside the blob, numbers in their ranges
void check_accepted(const uint8_t *data, size_t size)
{
    constexpr float kLeast = 1e-45F;
    constexpr float kMost = 3.40282347e38F;
    FUZZ_CHECK(is_sealed(data, size));
    for (const uint32_t width : {model.contact_width, model.width[0], model.width[1], model.classifier_width}) {
        FUZZ_CHECK(width >= 1 && width <= AMINN_MAX_WIDTH);
    }
    FUZZ_CHECK(in_range(model.tau, 0.0F, 1.0F) && in_range(model.length_scale, kLeast, kMost) &&
               in_range(model.log_range, 0.0F, kMost) && in_range(model.friction_nominal, kLeast, kMost) &&
               in_range(model.max_translation, kLeast, kMost) && in_range(model.max_rotation, kLeast, kMost));
    for (const aminn_stage_model_t &stage : model.stage) {
        FUZZ_CHECK(in_range(stage.eps_kx, kLeast, kMost) && in_range(stage.eps_jq, 0.0F, kMost));
    }
    const uint8_t *end = nullptr;
    for (const aminn::TableInfo &info : aminn::kTables) {
        aminn::Table table;
        aminn::find_table(model, info, table);
        const auto *first = static_cast<const uint8_t *>(table.numbers);
        FUZZ_CHECK(first >= data + kBlobHeader && table.n * size_t{table.size} <= size_t(data + size - first));
        for (uint32_t i = 0; table.size == sizeof(float) && i < table.n; ++i) {
            float v = 0.0F;
            std::memcpy(&v, first + i * sizeof v, sizeof v);
            FUZZ_CHECK(in_range(v, i < table.n - table.positive ? -kMost : kLeast, kMost));
        }
        end = first + aminn::table_room(model, info);
    }
    FUZZ_CHECK(end == data + size);
}

// they end inside the blob's header
void check_names()
{
    FUZZ_CHECK(std::strlen(model.name) < 56 && std::strlen(model.hand) < 56 && std::strlen(model.made_by) < 40);
}

// whatever the blob, one of the documented codes; flags and context stay as they were
void self_test()
{
    const uint32_t flags = ctx.flags;
    const aminn_status_t status = aminn_self_test(&ctx);
    FUZZ_CHECK(status == AMINN_OK || status == AMINN_E_CRC || status == AMINN_E_KNOWN_ANSWER);
    FUZZ_CHECK(ctx.flags == flags && aminn_debug(&ctx, 0) == nullptr);
}

void predict_once()
{
    check_names();
    const aminn_input_t &in = golden_input();
    aminn_state_t state;
    std::memcpy(&state, &in, sizeof state);
    FUZZ_CHECK(aminn_init(&ctx, &model, AMINN_FLAG_ALWAYS_STAGE2 | AMINN_FLAG_DEBUG) == AMINN_OK);
    self_test();
    scribble(&out, sizeof out);
    check_prediction(ctx, model, state.w_e, aminn_predict_state(&ctx, &state, &out), out);
}

// one to 32 bytes changed as libFuzzer does, the length kept
void mutate_slice(uint8_t *data, size_t size, Random &random)
{
    const size_t at = below(random, size);
    const size_t n = std::min(size - at, 1 + below(random, 32));
    LLVMFuzzerMutate(data + at, n, n);
}

// other widths, and as many bytes as these need: the old ones, repeated
size_t change_widths(uint8_t *data, size_t size, size_t max_size, Random &random)
{
    uint32_t widths[kWidths];
    std::memcpy(widths, data + kBlobWidths, sizeof widths);
    widths[below(random, kWidths)] = static_cast<uint32_t>(1 + below(random, below(random, 32) != 0 ? 8 : 129));
    std::memcpy(data + kBlobWidths, widths, sizeof widths);
    if (size == kBlobHeader || *std::max_element(widths, widths + kWidths) > 129) {
        return size;
    }
    const size_t wanted = kBlobHeader + table_bytes(widths);
    if (wanted > max_size) {
        return size;
    }
    for (size_t i = size; i < wanted; ++i) {
        data[i] = data[kBlobHeader + (i - size) % (size - kBlobHeader)];
    }
    return wanted;
}

size_t mutate_once(uint8_t *data, size_t size, size_t max_size, Random &random)
{
    if (size < kBlobHeader) {
        return LLVMFuzzerMutate(data, size, max_size);
    }
    switch (below(random, 8)) {
    case 0:
        return LLVMFuzzerMutate(data, size, max_size);
    case 1:
        return change_widths(data, size, max_size, random);
    case 2:
        mutate_slice(data, kBlobHeader, random);
        return size;
    case 3:
        mutate_slice(data, size, random);
        return size;
    case 4: { // the header's constants
        const size_t i = below(random, 18);
        mutate_float(data + (i < 14 ? kBlobScalars + 4 * i : kBlobEps + 4 * (i - 14)), random);
        return size;
    }
    default:
        mutate_float(data + 4 * below(random, size / 4), random);
        return size;
    }
}

} // namespace

extern "C" size_t LLVMFuzzerCustomMutator(uint8_t *data, size_t size, size_t max_size, unsigned int seed)
{
    Random random(seed);
    size = mutate_once(data, size, max_size, random);
    if (below(random, 16) != 0) { // else most changes would end at the CRC
        seal_blob(data, size);
    }
    return size;
}

extern "C" int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    scribble(&model, sizeof model);
    const aminn_status_t status = aminn_model_from_blob(data, size, &model);
    if (status == AMINN_OK) {
        check_accepted(data, size);
        predict_once();
    } else {
        check_refused(status);
    }
    return 0;
}
