/*
 * aminn_soak PREDICTIONS THREADS - many predictions in one process, of four models and both predict functions, alone and in
 * batches: each has the bits of the first of its kind, and memory stays as it was after the first tenth. Prints figures as
 * JSON; exits 1 where a bit differs or memory grows.
 */
#include "host_file.h" /* first */

#include <fcntl.h>
#include <malloc.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "aminn_batch.h"
#include "aminn_model.h"
#include "byte_model.h"
#include "half_model.h"
#include "tiny_model.h"

enum { MODELS = 4, FORMS = 2, SAMPLES = 32, ROWS = 8 * SAMPLES, ROUND = 2048, MOST_THREADS = 64 };
enum {
    ALLOWED_KIB = 256,
    ALLOWED_HEAP_BYTES = 65536
}; /* what the threads of batches leave in caches of the C library */

typedef struct prediction {
    aminn_status_t status;
    aminn_output_t out;
} prediction_t;

static const aminn_model_t *const models[MODELS] = {&aminn_model, &tiny_model, &half_model, &byte_model};
static aminn_input_t inputs[SAMPLES];
static aminn_state_t states[ROWS];
static prediction_t first[MODELS][FORMS][SAMPLES];
static unsigned long done, different; /* of all threads */
static unsigned long wanted_each;

/* what a thread works with */
typedef struct worker {
    pthread_t thread;
    aminn_t ctx[MODELS];
    aminn_output_t outputs[ROWS];
    aminn_status_t statuses[ROWS];
} worker_t;
static worker_t workers[MOST_THREADS];

static void start(worker_t *w)
{
    int m;
    for (m = 0; m < MODELS; ++m) {
        if (aminn_init(&w->ctx[m], models[m], 0) != AMINN_OK) {
            die("a model is refused");
        }
    }
}

static prediction_t predict(aminn_t *ctx, int form, int sample)
{
    prediction_t p;
    memset(&p, 0, sizeof p);
    p.status =
        form == 0 ? aminn_predict(ctx, &inputs[sample], &p.out) : aminn_predict_state(ctx, &states[sample], &p.out);
    return p;
}

static unsigned long round_of_batches(worker_t *w)
{
    unsigned long wrong = 0;
    int m, i;
    for (m = 0; m < MODELS; ++m) {
        const aminn_batch_t batch = aminn_batch_of_states(states, ROWS);
        aminn_predict_batch(&w->ctx[m], &batch, 2, w->outputs, NULL, w->statuses, NULL);
        for (i = 0; i < ROWS; ++i) {
            const prediction_t *p = &first[m][1][i % SAMPLES];
            wrong += w->statuses[i] != p->status || memcmp(&w->outputs[i], &p->out, sizeof p->out) != 0;
        }
    }
    return wrong;
}

static void *work(void *argument)
{
    worker_t *w = argument;
    unsigned long i = 0;
    while (i < wanted_each) {
        unsigned long wrong = round_of_batches(w), begin = i;
        for (; i < begin + ROUND; ++i) {
            const unsigned long m = i % MODELS, form = i / MODELS % FORMS, sample = i / MODELS / FORMS % SAMPLES;
            const prediction_t p = predict(&w->ctx[m], (int)form, (int)sample);
            wrong += memcmp(&p, &first[m][form][sample], sizeof p) != 0;
        }
        i += (unsigned long)MODELS * ROWS;
        __atomic_fetch_add(&done, i - begin, __ATOMIC_RELAXED);
        __atomic_fetch_add(&different, wrong, __ATOMIC_RELAXED);
    }
    return NULL;
}

static long resident_kib(void)
{
    char text[128] = "";
    long pages = 0;
    const int descriptor = open("/proc/self/statm", O_RDONLY);
    if (descriptor >= 0) {
        if (read(descriptor, text, sizeof text - 1) > 0) {
            char *resident = strchr(text, ' ');
            pages = resident != NULL ? strtol(resident, NULL, 10) : 0;
        }
        close(descriptor);
    }
    return pages * (sysconf(_SC_PAGESIZE) / 1024);
}

static void load_samples(void)
{
    const vector_header_t *golden = open_vectors(GOLDEN_DIR "/golden.bin");
    const float *sample = (const float *)(const void *)(golden + 1);
    int m, form, i;
    if (golden->n < SAMPLES) {
        die("golden.bin has too few samples");
    }
    for (i = 0; i < ROWS; ++i) {
        if (i < SAMPLES) {
            memcpy(&inputs[i], sample, sizeof inputs[i]);
            sample += vector_sample(golden);
        }
        memcpy(&states[i], &inputs[i % SAMPLES], sizeof states[i]);
    }
    for (m = 0; m < MODELS; ++m) {
        for (form = 0; form < FORMS; ++form) {
            for (i = 0; i < SAMPLES; ++i) {
                first[m][form][i] = predict(&workers[0].ctx[m], form, i);
            }
        }
    }
}

int main(int argc, char **argv)
{
    const struct timespec moment = {0, 2000000};
    struct timespec begun, ended;
    unsigned long threads, n, so_far;
    long rss_before = 0, rss_most = 0, rss;
    size_t heap_before = 0, heap_after;
    unsigned long i;
    program_name = "aminn_soak";
    if (argc != 3 || (n = strtoul(argv[1], NULL, 10)) < 1 || (threads = strtoul(argv[2], NULL, 10)) < 1 ||
        threads > MOST_THREADS) {
        die("usage: aminn_soak PREDICTIONS THREADS");
    }
    for (i = 0; i < threads; ++i) {
        start(&workers[i]);
    }
    load_samples();
    wanted_each = (n + threads - 1) / threads;
    clock_gettime(CLOCK_MONOTONIC, &begun);
    for (i = 0; i < threads; ++i) {
        if (pthread_create(&workers[i].thread, NULL, work, &workers[i]) != 0) {
            die("no thread");
        }
    }
    do {
        nanosleep(&moment, NULL);
        so_far = __atomic_load_n(&done, __ATOMIC_RELAXED);
        rss = resident_kib();
        if (rss_before == 0 && so_far >= n / 10) {
            rss_before = rss;
            heap_before = mallinfo2().uordblks;
        }
        rss_most = rss > rss_most ? rss : rss_most;
    } while (so_far < n);
    for (i = 0; i < threads; ++i) {
        pthread_join(workers[i].thread, NULL);
    }
    heap_after = mallinfo2().uordblks;
    clock_gettime(CLOCK_MONOTONIC, &ended);
    printf("{\"soak_predictions\": %lu, \"soak_threads\": %lu, \"soak_models\": %d, \"soak_different\": %lu, "
           "\"soak_seconds\": %.1f, \"soak_resident_after_a_tenth_kib\": %ld, \"soak_resident_most_kib\": %ld, "
           "\"soak_heap_growth_bytes\": %ld}\n",
           done, threads, MODELS, different, (double)(ended.tv_sec - begun.tv_sec), rss_before, rss_most,
           (long)heap_after - (long)heap_before);
    return different != 0 || rss_most > rss_before + ALLOWED_KIB || heap_after > heap_before + ALLOWED_HEAP_BYTES;
}
