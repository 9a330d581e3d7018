// What the parts of the runtime offer each other. Nothing of this is visible to users of the library.
#ifndef AMINN_SRC_PARTS_HPP
#define AMINN_SRC_PARTS_HPP

#include "vector3.hpp"

namespace aminn {

// input.cpp
aminn_status_t check_input(const float *numbers, int n); // the fields of aminn_state_t, and what follows them
bool all_finite(const float *values, int n);
bool in_training_range(const aminn_model_t &model, const float *state); // the fields of aminn_state_t

// closure.cpp: as aminn_closure, on finite arguments; false if an angle is too large
bool closure(const aminn_model_t &model, const float *q, const float *x_ht,
             const float (*contacts)[AMINN_N_CONTACT_FEATURE], float (*j_x)[3][AMINN_N_WRENCH],
             float (*j_q)[3][AMINN_N_COORD]);
// as probe_arithmetic(), of the arithmetic of closure.cpp
aminn_status_t probe_closure();

// predict.cpp: AMINN_OK for a context that aminn_init has prepared, else AMINN_E_NULL or AMINN_E_NOT_INITIALISED
aminn_status_t context_status(const aminn_t *ctx);
// predict.cpp: leaves in *out, unless it is null, what stands there after an error; returns the status
aminn_status_t fail(aminn_status_t status, aminn_output_t *out);

// predict.cpp: nothing is known beside the state
void forget_sensors(aminn_t &ctx);

// what the context's sensors, if it has some, say of this input; AMINN_OK, or what is wrong with them
inline aminn_status_t take_sensors(aminn_t &ctx, const aminn_input_t &in)
{
    return ctx.sense != nullptr ? ctx.sense(&ctx, &in) : AMINN_OK;
}

inline bool is_flag(float known)
{
    return known == 0.0F || known == 1.0F;
}

// whether three finite numbers are an aminn_sensors_t.friction
inline bool friction_in_range(const float *friction)
{
    return is_flag(friction[0]) & ((friction[0] == 0.0F) | ((friction[1] > 0.0F) & (friction[2] >= 0.0F)));
}

// calibrate_push.cpp: whether the state is of the grasp of the latest push
bool same_grasp(const aminn_calibrator_t &c, const aminn_state_t &state);

#if AMINN_N_SLIDE
// What a push says of friction.
struct PushedFriction {
    float asked; // coefficient that the load asks for if no contact slides
    float off;   // square of the motion beyond that of contacts that stick, m^2
    float size;  // square of the latter, m^2
};

// calibrate_friction.cpp: the likelihood of a new grasp's friction, and after one more push; `sure` where the tool's weight is
// known, and so the preload
void forget_friction(aminn_calibrator_t &c);
void narrow_friction(aminn_calibrator_t &c, const PushedFriction &push, bool sure);
#endif

// cascade.cpp, compiled for each instruction set
#define AMINN_CORE_FUNCTIONS                                                                                \
    /* a prediction from a checked input; false if a stage's results are not sound */                       \
    bool run_cascade(aminn_t &ctx, const aminn_input_t &in, aminn_output_t &out);                           \
    /* stage 2 alone, into ctx.stage[1]; false if its results are not sound */                              \
    bool run_motion(aminn_t &ctx, const aminn_input_t &in);                                                 \
    /* what is wrong with the arithmetic of this core: a status of aminn_self_test, AMINN_OK for nothing */ \
    aminn_status_t probe_arithmetic();

inline namespace AMINN_CORE {
AMINN_CORE_FUNCTIONS
} // namespace AMINN_CORE

#ifdef AMINN_RT_DISPATCH
namespace core_avx2 {
AMINN_CORE_FUNCTIONS
}
namespace core_avx512 {
AMINN_CORE_FUNCTIONS
}

// Calls the function of the core that suits this processor.
#define AMINN_ON_BEST_CORE(call)                                                                 \
    (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") ? core_avx512::call \
     : __builtin_cpu_supports("avx2")                                        ? core_avx2::call   \
                                                                             : aminn::AMINN_CORE::call)
#else
#define AMINN_ON_BEST_CORE(call) call
#endif
} // namespace aminn

#endif
