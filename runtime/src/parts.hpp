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

inline namespace AMINN_CORE {

// cascade.cpp: a prediction from a checked input; false if a stage's results are not sound
bool run_cascade(aminn_t &ctx, const aminn_input_t &in, aminn_output_t &out);

} // namespace AMINN_CORE
} // namespace aminn

#endif
