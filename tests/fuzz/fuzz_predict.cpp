// Fuzz target: any bytes as an input of a model. The first byte chooses model, function, flags, and whether sensors and theta
// are told; behind it stand the input, sensors and theta. Bytes that are missing are those of a golden sample.
#include <algorithm>
#include <cmath>
#include <cstring>
#include <iterator>

#include "aminn_model.h"
#include "byte_model.h"
#include "bytes.hpp"
#include "checks.hpp"
#include "half_model.h"
#include "mutate.hpp"
#include "tiny_model.h"

using namespace fuzz;

namespace {

constexpr uint8_t kAlwaysStage2 = 1;
constexpr uint8_t kGivenClosure = 2;
constexpr uint8_t kSensors = 4; // the reference model's alone
constexpr uint8_t kTheta = 8;
constexpr int kModelBits = 4; // where the model's number stands
constexpr size_t kSize = 1 + sizeof(aminn_input_t);
constexpr int kFloats = sizeof(aminn_input_t) / sizeof(float);
constexpr int kStateFloats = sizeof(aminn_state_t) / sizeof(float);

const aminn_model_t *const kModels[] = {&tiny_model, &byte_model, &half_model, &aminn_model};

// A context that is used again and again, and what it must predict from the golden input.
struct Predictor {
    const aminn_model_t &model;
    aminn_t ctx;
    aminn_output_t golden;
    aminn_calibration_t calibration;

    Predictor(const aminn_model_t &of, uint32_t flags) : model(of)
    {
        FUZZ_CHECK(aminn_init(&ctx, &model, flags) == AMINN_OK);
        FUZZ_CHECK(aminn_predict(&ctx, &golden_input(), &golden) == AMINN_OK);
    }
};

// What one input asks for.
struct Question {
    aminn_input_t in;
    aminn_sensors_t sensors;
    float theta[AMINN_N_THETA];
    bool given_closure;
    bool with_sensors;
    bool with_theta;

    Question(const uint8_t *data, size_t size) : in(golden_input()), sensors{}, theta{}
    {
        Bytes bytes(data, size);
        const uint8_t mode = bytes.byte();
        bytes.take(in);
        bytes.take(sensors);
        bytes.take(theta);
        given_closure = (mode & kGivenClosure) != 0;
        with_sensors = (mode & kSensors) != 0;
        with_theta = (mode & kTheta) != 0;
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
void check_range(const Predictor &p, const aminn_state_t &state, aminn_status_t status)
{
    const int first = aminn_first_out_of_range(&p.model, &state);
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
void check_closure(Predictor &p, const aminn_state_t &corrected, aminn_status_t status)
{
    aminn_input_t in;
    aminn_output_t given;
    std::memcpy(&in, &corrected, sizeof corrected);
    if (aminn_closure(&p.model, in.q, in.x_ht, in.contacts, in.j_x, in.j_q) != AMINN_OK) {
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

aminn_status_t predict(Predictor &p, const Question &asked, const aminn_state_t &state)
{
    scribble(&out, sizeof out);
    return asked.given_closure ? aminn_predict(&p.ctx, &asked.in, &out) : aminn_predict_state(&p.ctx, &state, &out);
}

// false where theta is refused, as it must be
bool prepare(Predictor &p, const Question &asked)
{
    const bool sees = p.model.n_sensed != 0;
    FUZZ_CHECK(!asked.with_sensors || aminn_sense(&p.ctx, &asked.sensors) == (sees ? AMINN_OK : AMINN_E_SENSORS));
    if (!asked.with_theta) {
        return true;
    }
    const aminn_status_t expected = expected_of_theta(asked.theta);
    FUZZ_CHECK(aminn_calibration_set(&p.calibration, &p.model, asked.theta) == expected);
    return expected == AMINN_OK && aminn_calibrate(&p.ctx, &p.calibration) == AMINN_OK;
}

void run(Predictor &p, const Question &asked)
{
    const Question kept = asked;
    const aminn_input_t &in = asked.in;
    const int n_floats = asked.given_closure ? kFloats : kStateFloats;
    aminn_state_t state;
    std::memcpy(&state, &in, sizeof state);
    aminn_status_t status = AMINN_E_CALIBRATION;
    if (prepare(p, asked)) {
        status = predict(p, asked, state);
        FUZZ_CHECK(std::memcmp(&kept.in, &in, sizeof in) == 0);
        check_status(in, n_floats, status);
        if (asked.with_sensors && p.model.n_sensed != 0 && !are_sensors(asked.sensors)) {
            FUZZ_CHECK(status != AMINN_OK);
        } else {
            FUZZ_CHECK(status != AMINN_E_SENSORS);
        }
        count(status, check_prediction(p.ctx, p.model, in.w_e, status, out));
        const bool finite = expected_refusal(in, n_floats) == AMINN_OK;
        if (asked.with_theta && !asked.given_closure && finite) {
            aminn_correct(&p.calibration, &state);
        }
        check_range(p, state, status);
        if (!asked.given_closure && finite) {
            check_closure(p, state, status);
        }
    }
    FUZZ_CHECK(aminn_sense(&p.ctx, nullptr) == AMINN_OK && aminn_calibrate(&p.ctx, nullptr) == AMINN_OK);
    if (status != AMINN_OK) {
        check_still_works(p);
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
    const Question asked(data, size);
    data[0] = size > 0 ? data[0] : 0;
    std::memcpy(data + 1, &asked.in, sizeof asked.in);
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
    if (below(random, 16) == 0) {
        data[0] = static_cast<uint8_t>(below(random, 256));
    }
    size = std::max(size, kSize);
    for (size_t n = below(random, 4); n > 0; --n) { // of sensors and theta too, where they are
        mutate_float(data + 1 + 4 * below(random, (size - 1) / 4), random);
    }
    return size;
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
    static Predictor *predictors[std::size(kModels)][2];
    const uint8_t mode = size > 0 ? data[0] : 0;
    const size_t model = (mode >> kModelBits) % std::size(kModels);
    Predictor *&p = predictors[model][mode & kAlwaysStage2];
    if (p == nullptr) {
        p = new Predictor(*kModels[model], (mode & kAlwaysStage2) | AMINN_FLAG_DEBUG);
    }
    run(*p, Question(data, size));
    return 0;
}
