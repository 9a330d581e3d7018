// Predictions of many rows with a binary model, and its self-test: what the Python module and the library of another hand
// offer alike.
#ifndef AMINN_EXPORT_BATCH_HPP
#define AMINN_EXPORT_BATCH_HPP

#include <cstddef>
#include <cstdint>

namespace batch {

// of a row of outputs: aminn_output_t; of both aminn_stage_debug_t; of a row that is a whole aminn_input_t
extern const size_t kOutputWords;
extern const size_t kStagesWords;
extern const size_t kInputWords;

} // namespace batch

extern "C" {

// Predict with both stages from n rows of float, each an aminn_state_t or an aminn_input_t, as `columns` says. Writes the
// words of aminn_output_t and of both aminn_stage_debug_t, which are left alone after an error, and a status for each row.
// Returns the status of loading the model; after an error of that nothing is written.
int32_t aminn_batch_run(const void *blob, size_t size, const float *rows, size_t n, size_t columns, uint32_t *outputs,
                        uint32_t *stages, int32_t *statuses);

// Status of loading the model, then of aminn_self_test().
int32_t aminn_batch_self_test(const void *blob, size_t size);
}

#endif
