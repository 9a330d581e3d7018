// What the parts of the runtime offer each other. Nothing of this is visible to users of the library.
#ifndef AMINN_SRC_PARTS_HPP
#define AMINN_SRC_PARTS_HPP

#include "aminn_rt.h"
#include "linalg.hpp"

namespace aminn {

constexpr int kBranch = AMINN_N_BRANCH;

// What the mechanics head predicts.
struct Springs {
    Mat3 chol[kBranch];         // lower Cholesky factor L of the joint springs, K = L L^T
    Vec3 tendon_dir[kBranch];   // unit
    float tendon_gain[kBranch]; // N.m/rad
    Vec3 gate_params[kBranch];  // alpha, beta, rho
};

// What the statics need of an input, the same for both stages. "Scaled": lengths divided by length_scale.
struct Scene {
    Mat<3, 6> a_s[kBranch];      // j_x S
    Mat3 b_t[kBranch];           // B^T = -j_q^T
    float root_contact[kBranch]; // square root of the contact flag
    Vec6 w_s;                    // S w_e
};

// What stage 1's classifier sees of pass 2.
struct StaticsSummary {
    Vec6 x_s;      // scaled displacement, m
    Vec6 diag_k_s; // diagonal of the scaled stiffness, N/m
};

// input.cpp
aminn_status_t check_state(const float *x_ht, const float (*contacts)[AMINN_N_CONTACT_FEATURE]); // all finite
bool all_finite(const float *values, int n);

// closure.cpp: as aminn_closure, on checked arguments
void closure(const aminn_model_t &model, const float *q, const float *x_ht,
             const float (*contacts)[AMINN_N_CONTACT_FEATURE], float (*j_x)[3][AMINN_N_WRENCH],
             float (*j_q)[3][AMINN_N_COORD]);

// network.cpp
void make_network_input(const aminn_model_t &model, const aminn_input_t &in, aminn_t &ctx);
void run_backbone(const aminn_model_t &model, const aminn_stage_model_t &stage, aminn_t &ctx);
float classify(const aminn_model_t &model, const StaticsSummary &summary, const float *gate, aminn_t &ctx);
float sigmoid(float x);

// springs.cpp
Springs springs_from_head(const aminn_model_t &model, const float *head);
void store_springs(const Springs &springs, aminn_stage_debug_t &out);

// mechanics.cpp
Scene make_scene(const aminn_model_t &model, const aminn_input_t &in);
StaticsSummary two_pass(const aminn_model_t &model, const aminn_stage_model_t &stage, const Springs &springs,
                        const Scene &scene, const aminn_input_t &in, aminn_stage_debug_t &out);

} // namespace aminn

#endif
