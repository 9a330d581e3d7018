// Fuzz target: any bytes as settings of a calibrator and as pushes that it learns from. What it says it has learnt is within
// its bounds, what it refuses leaves no trace, and what it has learnt predicts.
#include <cstring>

#include "aminn_model.h"
#include "bytes.hpp"
#include "checks.hpp"
#include "tiny_model.h"

using namespace fuzz;

namespace {

constexpr int kPushes = 3;

struct Push {
    aminn_state_t before;
    float dx_ht[AMINN_N_WRENCH];
};

struct Whole {
    uint8_t choices[4]; // model and repairs; pushes
    aminn_calibrator_settings_t settings;
    float theta[AMINN_N_THETA];
    aminn_sensors_t sensors;
    float sensor[3];
    Push pushes[kPushes];
};

enum Choice : uint8_t { kReference = 1, kRepair = 2, kDefaults = 4, kNominal = 8, kSense = 16 };

Whole whole()
{
    Whole w = {};
    w.choices[0] = kRepair;
    w.choices[1] = kPushes;
    w.settings = aminn_calibrator_defaults;
    for (int i = 0; i < kPushes; ++i) {
        std::memcpy(&w.pushes[i].before, &golden_input(), sizeof w.pushes[i].before);
        w.pushes[i].before.w_e[0] += 0.2F * static_cast<float>(i);
        w.pushes[i].dx_ht[0] = 1e-3F;
    }
    return w;
}

aminn_t ctx;
aminn_calibrator_t calibrator;
aminn_calibrator_t kept;
aminn_output_t out;

bool is_untouched()
{
    return std::memcmp(&calibrator, &kept, sizeof kept) == 0;
}

constexpr float kLeastSd = 1e-3F; // no push makes a factor surer

// within rounding
void check_learnt(const aminn_calibrator_settings_t &settings)
{
    for (int i = 0; i < AMINN_N_FACTOR; ++i) {
        FUZZ_CHECK(std::fabs(calibrator.calibration.theta[i]) <= settings.bound);
        const float sd = aminn_calibrator_sd(&calibrator, i);
        FUZZ_CHECK(sd >= 0.0F && sd <= 1.001F * std::max(settings.prior, kLeastSd));
    }
    for (const float covariance : calibrator.covariance) {
        FUZZ_CHECK(std::isfinite(covariance));
    }
    for (const float likelihood : calibrator.friction) {
        FUZZ_CHECK(likelihood >= 0.0F && likelihood <= 1.0F);
    }
    FUZZ_CHECK(calibrator.outcome <= AMINN_PUSH_WORSE && calibrator.in_grasp <= calibrator.pushes);
}

void check_friction(const Whole &w, const aminn_state_t &state)
{
    float friction[3] = {-1.0F, -1.0F, -1.0F};
    const aminn_status_t status = aminn_calibrator_friction(&calibrator, &state, w.sensor, friction);
    if (status != AMINN_OK) {
        FUZZ_CHECK(status == AMINN_E_SENSORS && friction[0] == -1.0F && friction[2] == -1.0F);
        return;
    }
    aminn_sensors_t sensors = {};
    std::memcpy(sensors.friction, friction, sizeof friction);
    FUZZ_CHECK(are_sensors(sensors));
}

void learn(const Whole &w, const aminn_model_t &model, const Push &push, const aminn_calibrator_settings_t &settings)
{
    std::memcpy(&kept, &calibrator, sizeof kept);
    const aminn_status_t status = aminn_calibrate_push(&ctx, &calibrator, &push.before, push.dx_ht);
    FUZZ_CHECK(aminn_debug(&ctx, 0) == nullptr);
    if (status != AMINN_OK) {
        FUZZ_CHECK(status <= AMINN_E_NONFINITE && status >= AMINN_E_SENSORS && is_untouched());
        return;
    }
    check_learnt(settings);
    check_friction(w, push.before);
    FUZZ_CHECK(aminn_calibrate(&ctx, &calibrator.calibration) == AMINN_OK);
    scribble(&out, sizeof out);
    const aminn_status_t predicted = aminn_predict_state(&ctx, &push.before, &out);
    check_prediction(ctx, model, push.before.w_e, predicted, out);
}

int try_one(Whole &w)
{
    const uint8_t chosen = w.choices[0];
    if ((chosen & kRepair) != 0) {
        for (Push &push : w.pushes) {
            repair(push.before);
        }
    }
    const aminn_model_t &model = (chosen & kReference) != 0 ? aminn_model : tiny_model;
    FUZZ_CHECK(aminn_init(&ctx, &model, AMINN_FLAG_DEBUG) == AMINN_OK);
    if ((chosen & kSense) != 0 && model.n_sensed != 0) {
        FUZZ_CHECK(aminn_sense(&ctx, &w.sensors) == AMINN_OK);
    }
    scribble(&calibrator, sizeof calibrator);
    std::memcpy(&kept, &calibrator, sizeof kept);
    const bool defaults = (chosen & kDefaults) != 0;
    const aminn_status_t begun = aminn_calibrator_init(
        &calibrator, &model, (chosen & kNominal) != 0 ? nullptr : w.theta, defaults ? nullptr : &w.settings);
    if (begun != AMINN_OK) {
        FUZZ_CHECK((begun == AMINN_E_NONFINITE || begun == AMINN_E_CALIBRATION) && is_untouched());
        return 0;
    }
    FUZZ_CHECK((chosen & kNominal) != 0 || expected_of_theta(w.theta) == AMINN_OK);
    const aminn_calibrator_settings_t &settings = defaults ? aminn_calibrator_defaults : w.settings;
    for (int i = 0; i < w.choices[1] % (kPushes + 1); ++i) {
        learn(w, model, w.pushes[i], settings);
    }
    return 0;
}

} // namespace

#include "numbers_target.hpp" // last
