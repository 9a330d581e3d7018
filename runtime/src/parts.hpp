// What the parts of the runtime offer each other. Nothing of this is visible to users of the library.
#ifndef AMINN_SRC_PARTS_HPP
#define AMINN_SRC_PARTS_HPP

#include "aminn_rt.h"
#include "lanes.hpp"

namespace aminn {

// input.cpp
aminn_status_t check_input(const float *numbers, size_t n, const float *x_ht,
                           const float (*contacts)[AMINN_N_CONTACT_FEATURE]);
bool all_finite(const float *values, int n);
bool in_training_range(const aminn_model_t &model, const float *state); // the fields of aminn_state_t

// closure.cpp: as aminn_closure, on finite arguments; false if an angle is too large
bool closure(const aminn_model_t &model, const float *q, const float *x_ht,
             const float (*contacts)[AMINN_N_CONTACT_FEATURE], float (*j_x)[3][AMINN_N_WRENCH],
             float (*j_q)[3][AMINN_N_COORD]);

inline namespace AMINN_CORE {

// What the mechanics head predicts, branch last.
struct Springs {
    float chol[6][kBranch];        // lower Cholesky factor L of the joint springs: 00 11 22 10 20 21
    float tendon_dir[3][kBranch];  // unit
    float tendon_gain[kBranch];    // N.m/rad
    float gate_params[3][kBranch]; // alpha, beta, rho
};

// What the statics need of an input, the same for both stages. "Scaled": lengths divided by length_scale.
struct Scene {
    Row a_s[3 * kBranch]; // rows of j_x S
    float w_s[kMotion];   // S w_e
    float scale[kMotion]; // S
    float inv_scale[kMotion];
};

// What stage 1's classifier sees of pass 2, and how far apart the stiffnesses lie.
struct StaticsSummary {
    float x_s[kMotion];      // scaled displacement, m
    float diag_k_s[kMotion]; // diagonal of the scaled stiffness, N/m
    float condition;         // trace(K) trace(K^-1), scaled
};

// network.cpp
void make_network_input(const aminn_model_t &model, const aminn_input_t &in, aminn_t &ctx);
void run_backbone(const aminn_model_t &model, const aminn_stage_model_t &stage, aminn_t &ctx);
float classify(const aminn_model_t &model, const StaticsSummary &summary, const float *gate, aminn_t &ctx);

// springs.cpp
void springs_from_head(const aminn_model_t &model, float *head, Springs &out); // head is overwritten
void store_springs(const Springs &springs, aminn_stage_debug_t &out);

// mechanics.cpp
void make_scene(const aminn_model_t &model, const aminn_input_t &in, Scene &scene);
enum Wanted : unsigned { kStiffness = 1, kDeflection = 2 }; // of k_x and dq0, which nothing else depends on
void two_pass(const aminn_model_t &model, const aminn_stage_model_t &stage, const Springs &springs, const Scene &scene,
              const aminn_input_t &in, unsigned wanted, aminn_stage_debug_t &out, StaticsSummary &summary);

// cascade.cpp: a prediction from a checked input; false if a stage's results are not sound
bool run_cascade(aminn_t &ctx, const aminn_input_t &in, aminn_output_t &out);

} // namespace AMINN_CORE
} // namespace aminn

#endif
