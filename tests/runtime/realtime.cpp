// What a control loop calls, in functions that may not block: clang's RealtimeSanitizer ends the program where one of them
// allocates, locks, waits or asks the system for anything. Prints the number of calls as JSON.
//
//   aminn_realtime            every function that a loop calls
//   aminn_realtime --malloc   a loop that allocates: the sanitizer must say so
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <initializer_list>

extern "C" {
#include "host_file.h"
}
#include "aminn_model.h"
#include "byte_model.h"
#include "half_model.h"
#include "tiny_model.h"

namespace {

constexpr int kSamples = 32;
constexpr int kRounds = 20;

aminn_input_t inputs[kSamples];
aminn_sensors_t sensors;
aminn_t ctx;
aminn_output_t out;
aminn_calibration_t calibration;
aminn_calibrator_t calibrator;
aminn_admissible_t found;
float j_x[AMINN_N_BRANCH][3][AMINN_N_WRENCH], j_q[AMINN_N_BRANCH][3][AMINN_N_COORD];
long calls;

void tick(const aminn_model_t &model, const aminn_input_t &in) [[clang::nonblocking]]
{
    aminn_state_t state;
    aminn_input_t bad = in;
    float theta[AMINN_N_THETA] = {0.1F};
    const aminn_load_limits_t limits = {2e-3F, 0.1F, 0.0F, 0.5F, 1.0F, 10.0F};
    const float direction[AMINN_N_WRENCH] = {1.0F};
    const float dx[AMINN_N_WRENCH] = {1e-3F};
    float friction[3];
    std::memcpy(&state, &in, sizeof state);
    bad.w_e[0] = 3e38F;
    aminn_init(&ctx, &model, AMINN_FLAG_DEBUG);
    aminn_self_test(&ctx);
    if (model.n_sensed != 0) {
        aminn_sense(&ctx, &sensors);
    }
    aminn_predict(&ctx, &in, &out);
    aminn_predict(&ctx, &bad, &out);
    aminn_predict_state(&ctx, &state, &out);
    aminn_debug(&ctx, 1);
    aminn_first_out_of_range(&model, &state);
    aminn_closure(&model, in.q, in.x_ht, in.contacts, j_x, j_q);
    aminn_calibration_set(&calibration, &model, theta);
    aminn_calibrate(&ctx, &calibration);
    aminn_predict_state(&ctx, &state, &out);
    aminn_correct(&calibration, &state);
    aminn_calibrator_init(&calibrator, &model, nullptr, nullptr);
    aminn_calibrate_push(&ctx, &calibrator, &state, dx);
    aminn_calibrator_friction(&calibrator, &state, nullptr, friction);
    aminn_calibrator_sd(&calibrator, 0);
    aminn_admissible_load(&ctx, &state, direction, &limits, &found);
    aminn_status_text(aminn_predict_state(&ctx, nullptr, &out));
    calls += 20;
}

void allocating_tick() [[clang::nonblocking]]
{
    void *volatile memory = std::malloc(16);
    std::free(memory);
}

} // namespace

int main(int argc, char **argv)
{
    if (argc > 1 && std::strcmp(argv[1], "--malloc") == 0) {
        allocating_tick();
        return 0;
    }
    const vector_header_t *golden = open_vectors(GOLDEN_DIR "/golden.bin");
    const auto *sample = reinterpret_cast<const float *>(golden + 1);
    for (aminn_input_t &input : inputs) {
        std::memcpy(&input, sample, sizeof input);
        std::memcpy(&sensors, sample + VECTOR_N_IN, sizeof sensors);
        sample += vector_sample(golden);
    }
    for (int round = 0; round < kRounds; ++round) {
        for (const aminn_model_t *model : {&aminn_model, &tiny_model, &half_model, &byte_model}) {
            for (const aminn_input_t &input : inputs) {
                tick(*model, input);
            }
        }
    }
    std::printf("{\"realtime_calls\": %ld, \"realtime_violations\": 0}\n", calls);
    return 0;
}
