// Fuzz target: any bytes as an input of the reference model. The first byte chooses function and flags, the rest is the
// input. Bytes that are missing are those of a golden sample, so that a shortened input stays a plausible one.
#include <algorithm>
#include <cmath>
#include <cstring>
#include <iterator>

#include "aminn_model.h"
#include "checks.hpp"
#include "mutate.hpp"

using namespace fuzz;

namespace {

constexpr uint8_t kAlwaysStage2 = 1;
constexpr uint8_t kGivenClosure = 2;
constexpr size_t kSize = 1 + sizeof(aminn_input_t);
constexpr int kFloats = sizeof(aminn_input_t) / sizeof(float);
constexpr int kStateFloats = sizeof(aminn_state_t) / sizeof(float);

// A context that is used again and again, and what it must predict from the golden input.
struct Predictor {
    aminn_t ctx;
    aminn_output_t golden;

    explicit Predictor(uint32_t flags)
    {
        FUZZ_CHECK(aminn_init(&ctx, &aminn_model, flags) == AMINN_OK);
        FUZZ_CHECK(aminn_predict(&ctx, &golden_input(), &golden) == AMINN_OK);
    }
};

aminn_output_t out;

// Counted as coverage: which status, and how near to 0 the work is (in powers of 2). So the fuzzer keeps inputs that
// come nearer to a violation although they take no new branch.
constexpr int kStatuses = 16;
constexpr int kWorkSteps = 32;
__attribute__((section("__libfuzzer_extra_counters"))) uint8_t counters[kStatuses + kWorkSteps];

void count(aminn_status_t status, double work_share)
{
    counters[-static_cast<int>(status)] = 1;
    const double step = work_share > 0.0 ? -std::log2(work_share) : kWorkSteps - 1;
    counters[kStatuses + static_cast<int>(std::clamp(step, 0.0, kWorkSteps - 1.0))] = 1;
}

aminn_input_t input_of(const uint8_t *data, size_t size)
{
    aminn_input_t in = golden_input();
    if (size > 1) {
        std::memcpy(&in, data + 1, std::min(size - 1, sizeof in));
    }
    return in;
}

// the first two of the documented checks, written once more
aminn_status_t expected_refusal(const aminn_input_t &in, int n_floats)
{
    const float *values = reinterpret_cast<const float *>(&in);
    if (!std::all_of(values, values + n_floats, [](float v) { return std::isfinite(v); })) {
        return AMINN_E_NONFINITE;
    }
    for (const auto &contact : in.contacts) {
        if (!(contact[0] >= 0.0F && contact[0] <= 1.0F)) {
            return AMINN_E_CONTACT_FLAG;
        }
    }
    return AMINN_OK;
}

void check_status(const aminn_input_t &in, int n_floats, aminn_status_t status)
{
    const aminn_status_t expected = expected_refusal(in, n_floats);
    if (expected != AMINN_OK) {
        FUZZ_CHECK(status == expected);
    } else {
        FUZZ_CHECK(status != AMINN_E_NONFINITE && status != AMINN_E_CONTACT_FLAG);
    }
}

// the field that is named is why it is noted
void check_range(const aminn_input_t &in, aminn_status_t status)
{
    aminn_state_t state;
    std::memcpy(&state, &in, sizeof state);
    const int first = aminn_first_out_of_range(&aminn_model, &state);
    FUZZ_CHECK(first >= -1 && first < AMINN_N_STATE);
    if (status == AMINN_OK) {
        FUZZ_CHECK((first >= 0) == ((out.notes & AMINN_NOTE_OUT_OF_RANGE) != 0));
    }
}

// a failed call leaves nothing behind
void check_still_works(Predictor &p)
{
    FUZZ_CHECK(aminn_predict(&p.ctx, &golden_input(), &out) == AMINN_OK);
    FUZZ_CHECK(std::memcmp(&p.golden, &out, sizeof out) == 0);
}

// what aminn_predict_state did, in two steps
void check_closure(Predictor &p, aminn_input_t in, aminn_status_t status)
{
    aminn_output_t given;
    if (aminn_closure(&aminn_model, in.q, in.x_ht, in.contacts, in.j_x, in.j_q) != AMINN_OK) {
        FUZZ_CHECK(status != AMINN_OK); // a joint angle whose sine has no digits
        return;
    }
    const aminn_status_t again = aminn_predict(&p.ctx, &in, &given);
    if (status == AMINN_OK) {
        FUZZ_CHECK(again == AMINN_OK && std::memcmp(&given, &out, sizeof out) == 0);
    } else { // a Jacobian that overflowed is an input that is not finite
        FUZZ_CHECK(again == status || again == AMINN_E_NONFINITE);
    }
}

aminn_status_t predict(Predictor &p, const aminn_input_t &in, bool given_closure)
{
    scribble(&out, sizeof out);
    if (given_closure) {
        return aminn_predict(&p.ctx, &in, &out);
    }
    aminn_state_t state;
    std::memcpy(&state, &in, sizeof state);
    return aminn_predict_state(&p.ctx, &state, &out);
}

void run(Predictor &p, const aminn_input_t &in, bool given_closure)
{
    const aminn_input_t kept = in;
    const int n_floats = given_closure ? kFloats : kStateFloats;
    const aminn_status_t status = predict(p, in, given_closure);
    FUZZ_CHECK(std::memcmp(&kept, &in, sizeof in) == 0);
    check_status(in, n_floats, status);
    check_range(in, status);
    count(status, check_prediction(p.ctx, aminn_model, in.w_e, status, out));
    if (!given_closure && expected_refusal(in, n_floats) == AMINN_OK) {
        check_closure(p, in, status);
    }
    if (status != AMINN_OK) {
        check_still_works(p);
    }
}

// back to what is checked before the networks run: finite, flags in [0, 1], unit normals, a short rotation
void repair(aminn_input_t &in)
{
    float *values = reinterpret_cast<float *>(&in);
    for (int i = 0; i < kFloats; ++i) {
        values[i] = std::isfinite(values[i]) ? values[i] : 1.0F;
    }
    for (auto &contact : in.contacts) {
        contact[0] = std::min(std::fabs(contact[0]), 1.0F);
        const float length = std::hypot(contact[4], contact[5], contact[6]);
        for (int i = 4; i < 7; ++i) {
            contact[i] = length > 0.0F && std::isfinite(length) ? contact[i] / length : (i == 4 ? 1.0F : 0.0F);
        }
    }
    for (int i = 3; i < 6; ++i) {
        in.x_ht[i] = std::fmod(in.x_ht[i], 1.8F);
    }
}

// three floats times the same power of 2
void scale_vector(uint8_t *at, Random &random)
{
    float v[3];
    const int exponent = static_cast<int>(below(random, 129)) - 64;
    std::memcpy(v, at, sizeof v);
    for (float &f : v) {
        f = std::ldexp(f, exponent);
    }
    std::memcpy(at, v, sizeof v);
}

// mode and input in full
void complete(uint8_t *data, size_t size)
{
    const aminn_input_t in = input_of(data, size);
    data[0] = size > 0 ? data[0] : 0;
    std::memcpy(data + 1, &in, sizeof in);
}

size_t mutate_once(uint8_t *data, size_t size, size_t max_size, Random &random)
{
    if (max_size < kSize || below(random, 4) == 0) {
        return LLVMFuzzerMutate(data, size, max_size);
    }
    if (size < kSize) {
        complete(data, size);
    }
    if (below(random, 2) == 0) { // the tool far away, or a contact: lever arms beside which the springs vanish
        constexpr size_t kFirst = AMINN_N_JOINT + 2 * AMINN_N_WRENCH + 1; // position of the first contact
        const size_t which = below(random, AMINN_N_BRANCH + 1);
        const size_t place = which == 0 ? AMINN_N_JOINT : kFirst + AMINN_N_CONTACT_FEATURE * (which - 1);
        scale_vector(data + 1 + 4 * place, random);
    }
    for (size_t n = below(random, 4); n > 0; --n) {
        mutate_float(data + 1 + 4 * below(random, kFloats), random);
    }
    return std::max(size, kSize);
}

} // namespace

extern "C" size_t LLVMFuzzerCustomMutator(uint8_t *data, size_t size, size_t max_size, unsigned int seed)
{
    Random random(seed);
    size = mutate_once(data, size, max_size, random);
    if (size >= kSize && below(random, 4) != 0) {
        aminn_input_t in;
        std::memcpy(&in, data + 1, sizeof in);
        repair(in);
        std::memcpy(data + 1, &in, sizeof in);
    }
    return size;
}

extern "C" int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static Predictor predictors[] = {Predictor(AMINN_FLAG_DEBUG),
                                     Predictor(AMINN_FLAG_ALWAYS_STAGE2 | AMINN_FLAG_DEBUG)};
    const uint8_t mode = size > 0 ? data[0] : 0;
    run(predictors[mode & kAlwaysStage2], input_of(data, size), (mode & kGivenClosure) != 0);
    return 0;
}
