/*
 * A controller loop on the target: read a state, predict, write the result; here from and to files of the host
 * (semihosting), so that the results can be compared there.
 *
 * Command line: firmware VECTORS.bin OUT.bin   the formats of runtime/tools/vector_file.h
 *               firmware --control FRAMES.bin  a 100 Hz loop that limits the commanded load (control.c)
 *               firmware --calibrate PUSHES.bin  that limiter before and after it has learned from ten pushes (learn.c)
 *               firmware --serial              answers on the UART (serial.c, uart.c)
 *               firmware --self-test           the self-test under other modes of the FPU (self_test.c)
 *               firmware --fault               runs into an undefined instruction, to try the fault handler
 *
 * Ends with 0; 1 and a message on a bad file; 70 after a fault. Prints figures as lines "firmware: NAME VALUE".
 */
#include <string.h>

#include MODEL_HEADER
#include "figures.h"
#include "learning.h"
#include "modes.h"
#include "semihosting.h"
#include "startup.h"
#include "vector_file.h"

enum { STACK_SAMPLES = 16 };

/* all static: this is the whole memory that the runtime needs beside its stack */
static aminn_t ctx;
static aminn_input_t in;
static aminn_output_t out;
static aminn_calibrator_t calibrator; /* and this that of one that learns */
#ifdef MODEL_TOLD
static aminn_calibration_t calibration;
static aminn_status_t theta_status = AMINN_OK;
#endif

static char command_line[512];
static int vectors_file = -1, results_file = -1;

typedef struct figures {
    uint32_t refused, call_stack, ticks_total, ticks_max;
    uint32_t push_stack, push_ticks_total, push_ticks_max, pushes_refused;
    uint32_t load_stack, load_ticks_max, loads_crc;
} figures_t;

/* ---- files ---- */

/* two words after the program's name, in place */
static int parse(char **first, char **second)
{
    char *space = strchr(command_line, ' ');
    *first = *second = NULL;
    if (space == NULL) {
        return 1;
    }
    *first = space + 1;
    space = strchr(*first, ' ');
    if (space != NULL) {
        *space = '\0';
        *second = space + 1;
    }
    return 0;
}

/* null, or what is wrong with the vector file; leaves the file at its first sample */
static const char *check_vectors(vector_header_t *header)
{
    static uint8_t chunk[1024];
    const int32_t length = semihost_length(vectors_file);
    uint32_t crc = 0, left;
    const char *error;
    if (length < (int32_t)sizeof *header || semihost_read(vectors_file, header, sizeof *header) != 0) {
        return "truncated: no header";
    }
    left = (uint32_t)length - (uint32_t)sizeof *header;
    error = vector_header_error(header, left);
    if (error != NULL) {
        return error;
    }
#ifndef MODEL_TOLD
    if (vector_n_theta(header) != 0) {
        return "has a theta for each sample, which this image's model is not told";
    }
#endif
#ifndef MODEL_SENSES
    if (vector_n_sensor(header) != 0) {
        return "has sensors for each sample, which this image's model does not see";
    }
#endif
    while (left > 0) {
        const uint32_t n = left < sizeof chunk ? left : (uint32_t)sizeof chunk;
        if (semihost_read(vectors_file, chunk, n) != 0) {
            return "cannot read";
        }
        crc = vector_crc(crc, chunk, n);
        left -= n;
    }
    if (crc != header->crc) {
        return "damaged: its CRC-32 does not match";
    }
    return semihost_seek(vectors_file, (uint32_t)sizeof *header) == 0 ? NULL : "cannot seek";
}

/* writes one row behind the rows before it, and its status behind all rows */
static int store(uint32_t n, uint32_t i, aminn_status_t status, uint32_t *crc)
{
    const uint32_t row_size = RESULT_N_OUT * 4u;
    const int32_t code = status;
    float row[RESULT_N_OUT];
    result_row(&out, row);
    *crc = vector_crc(*crc, row, sizeof row);
    return semihost_seek(results_file, (uint32_t)sizeof(vector_header_t) + i * row_size) != 0 ||
           semihost_write(results_file, row, sizeof row) != 0 ||
           semihost_seek(results_file, (uint32_t)sizeof(vector_header_t) + n * row_size + i * 4u) != 0 ||
           semihost_write(results_file, &code, sizeof code) != 0;
}

/* header last: until it is there, the file is not a result file */
static int finish(uint32_t n, uint32_t crc)
{
    vector_header_t header = {RESULT_MAGIC, VECTOR_VERSION, 0, 0, RESULT_N_OUT, 0, 0, 0};
    uint32_t i;
    if (semihost_seek(results_file, (uint32_t)sizeof header + n * RESULT_N_OUT * 4u) != 0) {
        return 1;
    }
    for (i = 0; i < n; ++i) {
        int32_t code;
        if (semihost_read(results_file, &code, sizeof code) != 0) {
            return 1;
        }
        crc = vector_crc(crc, &code, sizeof code);
    }
    header.n = n;
    header.crc = crc;
    return semihost_seek(results_file, 0) != 0 || semihost_write(results_file, &header, sizeof header) != 0;
}

/* ---- the loop ---- */

/* one prediction with its cost; the stack is measured on the first samples only, since painting it takes long */
static aminn_status_t predict(uint32_t i, figures_t *f)
{
    aminn_status_t status;
    uint32_t start, ticks;
    if (i < STACK_SAMPLES) {
        stack_paint();
    }
#ifdef MODEL_TOLD
    if (theta_status != AMINN_OK) {
        aminn_predict(&ctx, NULL, &out); /* leaves what an error leaves */
        ++f->refused;
        return theta_status;
    }
#endif
    start = ticks_now();
    status = aminn_predict(&ctx, &in, &out);
    ticks = ticks_since(start);
    if (i < STACK_SAMPLES) {
        const uint32_t used = stack_pointer_free() - stack_free();
        f->call_stack = used > f->call_stack ? used : f->call_stack;
    }
    f->ticks_total += ticks;
    f->ticks_max = ticks > f->ticks_max ? ticks : f->ticks_max;
    f->refused += status != AMINN_OK;
    return status;
}

/* reads a sample's theta, if it has one, and has the context use it; 1 if it cannot be read */
static int take_theta(const vector_header_t *header)
{
#ifdef MODEL_TOLD
    static float theta[AMINN_N_THETA];
    if (vector_n_theta(header) == 0) {
        return 0;
    }
    if (semihost_read(vectors_file, theta, sizeof theta) != 0) {
        return 1;
    }
    theta_status = aminn_calibration_set(&calibration, &MODEL_SYMBOL, theta);
    if (theta_status == AMINN_OK) {
        theta_status = aminn_calibrate(&ctx, &calibration);
    }
#else
    (void)header;
#endif
    return 0;
}

/* the same of its sensors */
static int take_sensors(const vector_header_t *header)
{
#ifdef MODEL_SENSES
    static aminn_sensors_t sensors;
    if (vector_n_sensor(header) != 0) {
        aminn_sense(&ctx, &sensors);
        return semihost_read(vectors_file, &sensors, sizeof sensors) != 0;
    }
#else
    (void)header;
#endif
    return 0;
}

/* the same of a push */
static aminn_status_t learn(uint32_t i, figures_t *f)
{
    const uint32_t pushes = calibrator.pushes;
    aminn_status_t status;
    uint32_t start, ticks;
    if (i < STACK_SAMPLES) {
        stack_paint();
    }
    start = ticks_now();
    status = learn_sample(&ctx, &calibrator, i, &in, out.dx_ht, out.stable);
    ticks = ticks_since(start);
    if (i < STACK_SAMPLES) {
        const uint32_t used = stack_pointer_free() - stack_free();
        f->push_stack = used > f->push_stack ? used : f->push_stack;
    }
    if (calibrator.pushes != pushes) {
        f->push_ticks_total += ticks;
        f->push_ticks_max = ticks > f->push_ticks_max ? ticks : f->push_ticks_max;
    }
    return status;
}

/* and of a search for the largest admissible load */
static void look_for_load(const vector_header_t *header, uint32_t i, figures_t *f)
{
    uint32_t start, ticks;
    if (i >= LOADED_SAMPLES) {
        return;
    }
    stack_paint();
    start = ticks_now();
    f->loads_crc = load_crc(&ctx, header, i, &in, f->loads_crc);
    ticks = ticks_since(start);
    f->load_ticks_max = ticks > f->load_ticks_max ? ticks : f->load_ticks_max;
    if (stack_pointer_free() - stack_free() > f->load_stack) {
        f->load_stack = stack_pointer_free() - stack_free();
    }
}

static int run(const vector_header_t *header, figures_t *f)
{
    const uint32_t blank[sizeof(vector_header_t) / 4] = {0};
    const uint32_t n = header->n;
    uint32_t i, crc = 0;
    if (semihost_write(results_file, blank, sizeof blank) != 0) {
        return fail("results", "cannot write");
    }
    for (i = 0; i < n; ++i) {
        if (semihost_read(vectors_file, &in, sizeof in) != 0 || take_theta(header) != 0 || take_sensors(header) != 0) {
            return fail("vectors", "cannot read");
        }
        if (store(n, i, predict(i, f), &crc) != 0) {
            return fail("results", "cannot write");
        }
        look_for_load(header, i, f);
        f->pushes_refused += learn(i, f) != AMINN_OK;
    }
    return finish(n, crc) != 0 ? fail("results", "cannot write") : 0;
}

static void print_figures(uint32_t n, const figures_t *f, uint32_t rate)
{
    print_figure("samples", n);
    print_figure("refused", f->refused);
    print_figure("context_bytes", (uint32_t)sizeof ctx);
    print_figure("stack_predict_bytes", f->call_stack);
    print_figure("stack_high_water_bytes", stack_size() - stack_free());
    if (rate != 0 && n > 0) {
        print_figure("instructions_per_prediction", (uint32_t)((uint64_t)f->ticks_total * rate / n / 1000u));
        print_figure("instructions_worst", (uint32_t)((uint64_t)f->ticks_max * rate / 1000u));
    }
    print_figure("pushes", calibrator.pushes);
    print_figure("pushes_refused", f->pushes_refused);
    print_figure("calibration_bytes", (uint32_t)sizeof calibrator.calibration);
    print_figure("calibrator_bytes", (uint32_t)sizeof calibrator);
    print_figure("calibration_crc", learned_crc(&calibrator));
    print_figure("stack_push_bytes", f->push_stack);
    print_figure("loads_crc", f->loads_crc);
    print_figure("stack_load_bytes", f->load_stack);
    if (rate != 0) {
        print_figure("instructions_load_worst", (uint32_t)((uint64_t)f->load_ticks_max * rate / 1000u));
    }
    if (rate != 0 && calibrator.pushes > 0) {
        print_figure("instructions_per_push",
                     (uint32_t)((uint64_t)f->push_ticks_total * rate / calibrator.pushes / 1000u));
        print_figure("instructions_push_worst", (uint32_t)((uint64_t)f->push_ticks_max * rate / 1000u));
    }
}

int main(void)
{
    vector_header_t header;
    figures_t figures = {0};
    uint32_t rate;
    char *vectors = NULL, *results = NULL;
    aminn_status_t status = aminn_init(&ctx, &MODEL_SYMBOL, AMINN_FLAG_ALWAYS_STAGE2);
    const char *error;
    int result;
    if (status != AMINN_OK) {
        return fail("aminn_init", aminn_status_name(status));
    }
    status = aminn_self_test(&ctx);
    if (status != AMINN_OK) {
        return fail("aminn_self_test", aminn_status_name(status));
    }
    status = aminn_calibrator_init(&calibrator, &MODEL_SYMBOL, NULL, NULL);
    if (status != AMINN_OK) {
        return fail("aminn_calibrator_init", aminn_status_name(status));
    }
    if (semihost_command_line(command_line, sizeof command_line) != 0 || parse(&vectors, &results) != 0) {
        return fail("usage", "firmware VECTORS.bin OUT.bin");
    }
    if (strcmp(vectors, "--fault") == 0) {
        cause_fault();
    }
#ifdef __arm__
    if (strcmp(vectors, "--self-test") == 0) {
        return run_self_test(&ctx);
    }
    if (strcmp(vectors, "--serial") == 0) {
        return run_serial();
    }
    if (strcmp(vectors, "--control") == 0 && results != NULL) {
        return run_control(results);
    }
    if (strcmp(vectors, "--calibrate") == 0 && results != NULL) {
        return run_calibration(results);
    }
#endif
    if (results == NULL) {
        return fail("usage", "firmware VECTORS.bin OUT.bin");
    }
    vectors_file = semihost_open(vectors, SEMIHOST_READ);
    if (vectors_file < 0) {
        return fail(vectors, "cannot open");
    }
    error = check_vectors(&header);
    if (error != NULL) {
        return fail(vectors, error);
    }
    results_file = semihost_open(results, SEMIHOST_WRITE);
    if (results_file < 0) {
        return fail(results, "cannot open for writing");
    }
    ticks_start();
    rate = calibrate();
    result = run(&header, &figures);
    semihost_close(results_file);
    semihost_close(vectors_file);
    if (result == 0) {
        print_figures(header.n, &figures, rate);
    }
    return result;
}
