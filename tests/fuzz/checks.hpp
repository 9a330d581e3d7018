// What must hold after every call of the runtime. A check that fails ends the program, which counts as a crash.
#ifndef AMINN_FUZZ_CHECKS_HPP
#define AMINN_FUZZ_CHECKS_HPP

#include "aminn_rt.h"

#define FUZZ_CHECK(condition) ((condition) ? (void)0 : fuzz::failed(#condition, __FILE__, __LINE__))

namespace fuzz {

[[noreturn]] void failed(const char *condition, const char *file, int line);

// A plausible input, of tests/golden/golden.bin; the same one each time.
const aminn_input_t &golden_input();

// Fill every byte, so that what a call leaves unwritten does not look like a result.
void scribble(void *memory, size_t size);

// Outputs and debug view of a prediction under load w_e are those that aminn_rt.h promises for this status: after
// AMINN_OK numbers, and no stage in which the load takes energy out of the grasp. Returns the smaller stage's w.dx as a
// share of the sum of |w_i dx_i|, 1 after an error.
double check_prediction(const aminn_t &ctx, const aminn_model_t &model, const float *w_e, aminn_status_t status,
                        const aminn_output_t &out);

} // namespace fuzz

#endif
