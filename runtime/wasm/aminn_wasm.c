/*
 * aminn_wasm.c - what the WebAssembly module has beside the library's own functions, which it exports by their names.
 *
 * aminn.mjs calls both. The module imports nothing: whoever loads it puts structs and files into its memory, behind
 * __heap_base. SPDX-License-Identifier: Apache-2.0
 */
#include "aminn_rt.h"
#include "learning.h"
#include "vector_file.h"

/* The hand's counts, then sizes of structs in bytes: aminn.mjs lays its views out by the former and checks the latter. */
const uint32_t aminn_wasm_layout[] = {
    AMINN_N_BRANCH,
    AMINN_N_COORD,
    AMINN_N_JOINT,
    AMINN_N_GATED,
    AMINN_N_TWIST,
    AMINN_N_STIFF,
    AMINN_N_TENDON,
    AMINN_N_SLIDE,
    sizeof(aminn_t),
    sizeof(aminn_model_t),
    sizeof(aminn_state_t),
    sizeof(aminn_input_t),
    sizeof(aminn_output_t),
    sizeof(aminn_stage_debug_t),
    sizeof(aminn_sensors_t),
    sizeof(aminn_load_limits_t),
    sizeof(aminn_admissible_t),
};

/* Size in bytes of the result file that belongs to a vector file. */
size_t aminn_wasm_result_size(const vector_header_t *vectors)
{
    return sizeof *vectors + (size_t)vectors->n * (RESULT_N_OUT + 1u) * sizeof(float);
}

/*
 * What the program aminn_replay does, in memory.
 *
 *   vectors  a vector file of `size` bytes, aligned to 8.
 *   result   written: the result file, aminn_wasm_result_size() bytes; the header last.
 *   told     written: pushes, calibration_crc, loads_crc.
 *
 * Returns null, or what is wrong: then nothing of `result` counts.
 */
const char *aminn_wasm_replay(const aminn_model_t *model, const vector_header_t *vectors, size_t size,
                              vector_header_t *result, uint32_t told[3])
{
    static aminn_t ctx;
    static aminn_calibrator_t calibrator;
    float *rows = (float *)(result + 1);
    int32_t *statuses = (int32_t *)(rows + (size_t)vectors->n * RESULT_N_OUT);
    uint32_t loads = 0;
    aminn_status_t status;
    const char *error = vector_header_error(vectors, size - sizeof *vectors);
    if (error != NULL) {
        return error;
    }
    if (vector_crc(0, vectors + 1, size - sizeof *vectors) != vectors->crc) {
        return "damaged: its CRC-32 does not match";
    }
    status = aminn_init(&ctx, model, AMINN_FLAG_ALWAYS_STAGE2);
    status = status == AMINN_OK ? aminn_calibrator_init(&calibrator, model, NULL, NULL) : status;
    if (status != AMINN_OK) {
        return aminn_status_text(status);
    }
    predict_rows(&ctx, model, vectors, rows, statuses);
    aminn_init(&ctx, model, 0);
    learn_rows(&ctx, &calibrator, vectors, rows, &loads);
    told[0] = calibrator.pushes;
    told[1] = learned_crc(&calibrator);
    told[2] = loads;
    *result = result_header(vectors->n, rows, statuses);
    return NULL;
}
