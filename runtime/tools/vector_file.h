/*
 * vector_file.h - headers of vector files (inputs with reference outputs) and of result files; docs/model-format.md has
 * the bytes. Used by the host's replay program, by the firmware and by the WebAssembly module.
 */
#ifndef AMINN_VECTOR_FILE_H
#define AMINN_VECTOR_FILE_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "aminn_rt.h"

#define VECTOR_MAGIC 0x564E4D41u /* "AMNV" */
#define RESULT_MAGIC 0x4F4E4D41u /* "AMNO" */
#define VECTOR_VERSION 2u
#define VECTOR_N_IN ((uint32_t)AMINN_N_INPUT)   /* q, x_ht, w_e, contacts, j_x, j_q: the layout of aminn_input_t */
#define VECTOR_N_OUT ((uint32_t)AMINN_N_OUTPUT) /* p_stable 1, dx_ht 6, k_x 36, gate, p_slide, bound_95, friction_use */
#define RESULT_N_OUT (VECTOR_N_OUT + 1u)        /* the same and stable (0 or 1) */

typedef struct vector_header {
    uint32_t magic;
    uint32_t version;
    uint32_t n;
    uint32_t n_in;
    uint32_t n_out;
    uint32_t
        also; /* lowest byte: 1 if there are float64 outputs; next: numbers of sensors, high half: of theta a sample */
    uint32_t crc;   /* CRC-32 of everything after the header */
    uint32_t model; /* of vectors: content_crc of the model that they are of, 0 if it is not known */
} vector_header_t;

static inline uint32_t vector_has_f64(const vector_header_t *h)
{
    return h->also & 0xFFu;
}

/* Numbers of sensors behind each sample's input and theta: 0, or AMINN_N_SENSOR. */
static inline uint32_t vector_n_sensor(const vector_header_t *h)
{
    return h->also >> 8 & 0xFFu;
}

/* Numbers of theta behind each sample's input: 0, or AMINN_N_THETA. */
static inline uint32_t vector_n_theta(const vector_header_t *h)
{
    return h->also >> 16;
}

/* Numbers of a sample: input, theta, sensors. */
static inline uint32_t vector_sample(const vector_header_t *h)
{
    return VECTOR_N_IN + vector_n_theta(h) + vector_n_sensor(h);
}

/* Row of a result file. */
static inline void result_row(const aminn_output_t *out, float row[RESULT_N_OUT])
{
    memcpy(row, out, VECTOR_N_OUT * sizeof *row); /* with which the struct begins */
    row[VECTOR_N_OUT] = (float)out->stable;
}

/* Uses a sample's theta, of which `cal` is filled in, and predicts. */
static inline aminn_status_t predict_calibrated(aminn_t *ctx, const aminn_model_t *model, aminn_calibration_t *cal,
                                                const float *theta, const aminn_input_t *in, aminn_output_t *out)
{
    aminn_status_t status = aminn_calibration_set(cal, model, theta);
    status = status == AMINN_OK ? aminn_calibrate(ctx, cal) : status;
    if (status != AMINN_OK) {
        aminn_predict(ctx, NULL, out); /* leaves what an error leaves */
        return status;
    }
    return aminn_predict(ctx, in, out);
}

/* Predicts the samples behind the header of a vector file into rows (n x RESULT_N_OUT) and statuses (n); returns how many
 * were refused. `model` is that of ctx, which uses neither calibration nor sensors afterwards. */
static inline uint32_t predict_rows(aminn_t *ctx, const aminn_model_t *model, const vector_header_t *vectors,
                                    float *rows, int32_t *statuses)
{
    const uint32_t n_theta = vector_n_theta(vectors), n_sensor = vector_n_sensor(vectors);
    const float *sample = (const float *)(vectors + 1);
    aminn_calibration_t cal;
    aminn_sensors_t sensors;
    aminn_status_t sensing = AMINN_OK;
    uint32_t i, refused = 0;
    memset(&sensors, 0, sizeof sensors);
    if (n_sensor != 0) {
        sensing = aminn_sense(ctx, &sensors);
    }
    for (i = 0; i < vectors->n; ++i) {
        aminn_input_t in;
        aminn_output_t out;
        memcpy(&in, sample, sizeof in);
        sample += VECTOR_N_IN;
        memcpy(&sensors, sample + n_theta, n_sensor * sizeof *sample);
        if (sensing != AMINN_OK) {
            aminn_predict(ctx, NULL, &out); /* leaves what an error leaves */
            statuses[i] = sensing;
        } else {
            statuses[i] =
                n_theta == 0 ? aminn_predict(ctx, &in, &out) : predict_calibrated(ctx, model, &cal, sample, &in, &out);
        }
        sample += n_theta + n_sensor;
        refused += statuses[i] != AMINN_OK;
        result_row(&out, rows + (size_t)i * RESULT_N_OUT);
    }
    aminn_calibrate(ctx, NULL);
    aminn_sense(ctx, NULL);
    return refused;
}

/* CRC-32 of more bytes: start with 0, feed the result back in. */
static inline uint32_t vector_crc(uint32_t crc, const void *bytes, size_t n)
{
    const uint8_t *p = (const uint8_t *)bytes;
    size_t i;
    int bit;
    crc = ~crc;
    for (i = 0; i < n; ++i) {
        crc ^= p[i];
        for (bit = 0; bit < 8; ++bit) {
            crc = (crc >> 1) ^ (0xEDB88320u & (0u - (crc & 1u)));
        }
    }
    return ~crc;
}

/* Between the files' little endian and the machine's order, in place; nothing to do on most machines. */
static inline void vector_swap(void *words, size_t n)
{
#if __BYTE_ORDER__ == __ORDER_BIG_ENDIAN__
    uint32_t *w = (uint32_t *)words;
    size_t i;
    for (i = 0; i < n; ++i) {
        w[i] = w[i] >> 24 | (w[i] >> 8 & 0xFF00u) | (w[i] << 8 & 0xFF0000u) | w[i] << 24;
    }
#else
    (void)words;
    (void)n;
#endif
}

/* Header, in this machine's order, of a result file whose rows and status codes are in the file's order already. */
static inline vector_header_t result_header(uint32_t n, const float *rows, const int32_t *statuses)
{
    vector_header_t header = {RESULT_MAGIC, VECTOR_VERSION, 0, 0, RESULT_N_OUT, 0, 0, 0};
    header.n = n;
    header.crc =
        vector_crc(vector_crc(0, rows, (size_t)n * RESULT_N_OUT * sizeof *rows), statuses, n * sizeof *statuses);
    return header;
}

/* Bytes that follow the header of a vector file. */
static inline uint64_t vector_payload(const vector_header_t *h)
{
    uint64_t per_sample = ((uint64_t)h->n_in + vector_n_theta(h) + vector_n_sensor(h) + h->n_out) * 4u;
    per_sample += vector_has_f64(h) ? (uint64_t)h->n_out * 8u : 0u;
    return (uint64_t)h->n * per_sample;
}

/* Null if the header is that of a vector file with `payload` bytes behind it, else what is wrong. */
static inline const char *vector_header_error(const vector_header_t *h, uint64_t payload)
{
    if (h->magic != VECTOR_MAGIC) {
        return "not a vector file (wrong magic)";
    }
    if (h->version != VECTOR_VERSION) {
        return "a vector file of another version; export it again";
    }
    if (h->n_in != VECTOR_N_IN || h->n_out != VECTOR_N_OUT || vector_has_f64(h) > 1u ||
        (vector_n_theta(h) != 0 && vector_n_theta(h) != AMINN_N_THETA) ||
        (vector_n_sensor(h) != 0 && vector_n_sensor(h) != AMINN_N_SENSOR)) {
        return "a vector file of other dimensions; export it again";
    }
    if (vector_payload(h) != payload) {
        return "truncated, or longer than its header says";
    }
    return NULL;
}

/* The same for a result file: rows of RESULT_N_OUT floats, then a status code a sample. */
static inline const char *result_header_error(const vector_header_t *h, uint64_t payload)
{
    if (h->magic != RESULT_MAGIC) {
        return "not a result file (wrong magic): the replay did not finish";
    }
    if (h->version != VECTOR_VERSION || h->n_in != 0 || h->n_out != RESULT_N_OUT || h->also != 0 || h->model != 0) {
        return "a result file of another version; replay again";
    }
    if ((uint64_t)h->n * (RESULT_N_OUT + 1u) * 4u != payload) {
        return "truncated, or longer than its header says";
    }
    return NULL;
}

#endif
