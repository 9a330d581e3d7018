/*
 * What a build of the library computes: prints the status of its self-test, and the CRC-32 of all outputs and status codes
 * of some states. For any set of compiler options, on a host and in an image for qemu's boards; option_sets.py compiles it
 * and puts the files into data.S.
 */
#include <string.h>

#include "aminn_rt.h"
#include "vector_file.h"

#ifdef AMINN_PROBE_IMAGE
#include "semihosting.h"
#define PRINT semihost_puts
#else
#include <stdio.h>
#define PRINT(text) fputs(text, stdout)
#endif

extern const uint8_t model_begin[], model_end[];
extern const uint8_t states_begin[], states_end[]; /* of an aminn_input_t each */

static aminn_model_t model;
static aminn_t ctx;
static aminn_input_t in;
static aminn_state_t state;
static aminn_output_t out;
static float j_x[AMINN_N_BRANCH][3][AMINN_N_WRENCH], j_q[AMINN_N_BRANCH][3][AMINN_N_COORD];

static uint32_t add(uint32_t crc, aminn_status_t status, const void *bytes, size_t n)
{
    const int32_t code = (int32_t)status;
    return vector_crc(vector_crc(crc, &code, sizeof code), bytes, n);
}

static uint32_t outputs_crc(void)
{
    const uint8_t *at = states_begin;
    uint32_t crc = 0;
    for (; at < states_end; at += sizeof in) {
        memcpy(&in, at, sizeof in);
        memcpy(&state, at, sizeof state);
        crc = add(crc, aminn_predict(&ctx, &in, &out), &out, sizeof out);
        crc = add(crc, aminn_predict_state(&ctx, &state, &out), &out, sizeof out);
        crc = add(crc, aminn_closure(&model, in.q, in.x_ht, in.contacts, j_x, j_q), j_x, sizeof j_x);
        crc = vector_crc(crc, j_q, sizeof j_q);
    }
    return crc;
}

static void print_crc(uint32_t value)
{
    char text[] = "outputs 00000000\n";
    int i;
    for (i = 0; i < 8; ++i) {
        text[8 + i] = "0123456789abcdef"[value >> (28 - 4 * i) & 15u];
    }
    PRINT(text);
}

int main(void)
{
    aminn_status_t status;
#ifdef AMINN_PROBE_FLUSH /* as a start-up file does that sets FPSCR.FZ */
    __asm volatile("vmsr fpscr, %0" : : "r"(1u << 24));
#endif
    status = aminn_model_from_blob(model_begin, (size_t)(model_end - model_begin), &model);
    if (status == AMINN_OK) {
        status = aminn_init(&ctx, &model, AMINN_FLAG_ALWAYS_STAGE2);
    }
    if (status != AMINN_OK) {
        PRINT(aminn_status_name(status));
        return 1;
    }
    PRINT("self_test ");
    PRINT(aminn_status_name(aminn_self_test(&ctx)));
    PRINT("\n");
    print_crc(outputs_crc());
    return 0;
}
