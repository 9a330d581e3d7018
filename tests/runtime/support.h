/* What the tests share: files, vector files, a good input, comparisons. */
#ifndef SUPPORT_H
#define SUPPORT_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include "aminn_rt.h"
#include "unity.h"
#include "vector_file.h"

/* Whole file in memory from malloc; fails the test if it cannot be read. The caller frees it. */
void *load_file(const char *path, size_t *size);

/* A checked vector file. Samples i: inputs[i], sensors[i] or null where the model sees none, reference[i * VECTOR_N_OUT],
 * reference_f64 likewise or null. */
typedef struct golden {
    void *memory, *samples;
    uint32_t n;
    const aminn_input_t *inputs;
    const aminn_sensors_t *sensors;
    const float *reference;
    const double *reference_f64;
} golden_t;

golden_t load_golden(const char *path);
void free_golden(golden_t *golden);

/* Predicts sample i as it was recorded: with its sensors, where the model sees them; ctx uses none afterwards. */
aminn_status_t predict_golden(aminn_t *ctx, const golden_t *golden, uint32_t i, aminn_output_t *out);

/* The state part of an input. */
aminn_state_t state_of(const aminn_input_t *in);

/* A plausible input with all branches in contact (the first such sample of golden.bin). */
aminn_input_t good_input(void);

/* The outputs are those that the header promises after an error. */
void assert_failed_output(const aminn_output_t *out);
void assert_same_output(const aminn_output_t *a, const aminn_output_t *b);

/* Fill every byte, to see what a call writes. */
void scribble(void *memory, size_t size);

#endif
