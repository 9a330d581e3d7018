/*
 * aminn_compare - are the results of a replay (host or target) what they must be?
 *
 *   aminn_compare MODEL.bin VECTORS.bin RESULTS.bin           the reference of the vector file, within tolerances.h
 *   aminn_compare --exact MODEL.bin VECTORS.bin RESULTS.bin   what this library predicts here, bit by bit
 *   aminn_compare WANT.bin GOT.bin                            two result files, bit by bit
 *
 * Files are told apart by what they hold; of two result files the first is the reference. Every number is judged. Options:
 *
 *   --json FILE    all figures, and every number that differs: output, sample, got, want, limit
 *   --junit FILE   a test case an output, for a build server
 *   --show N       how many of the failures to print, worst first (10)
 *   --on-demand    the results are of a runtime without AMINN_FLAG_ALWAYS_STAGE2: NaN where a grasp does not hold
 *
 * Prints figures, one "name value" a line (to stderr where a report goes to stdout). Exits with 0: the same; 1: differences; 2: bad arguments; 3: a file cannot be read,
 * is damaged, of another version or empty, or a report cannot be written.
 */
#include "host_file.h" /* first */

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "comparison.h"
#include "verdict_report.h"

enum { EXIT_DIFFERENT = 1, EXIT_USAGE = 2, EXIT_FILE = 3, MODEL_MAGIC = 0x4D4E4D41 };

typedef struct request {
    const char *model, *vectors, *results[2];
    const char *json, *junit;
    size_t shown;
    int exact, on_demand, n_results;
} request_t;

static void print_usage(FILE *file)
{
    fputs("usage: aminn_compare [OPTIONS] [--exact] MODEL.bin VECTORS.bin RESULTS.bin\n"
          "       aminn_compare [OPTIONS] WANT_RESULTS.bin GOT_RESULTS.bin\n"
          "options: --json FILE, --junit FILE, --show N, --on-demand\n",
          file);
}

static void usage(const char *why)
{
    fprintf(stderr, "%s: %s\n", program_name, why);
    print_usage(stderr);
    exit(EXIT_USAGE);
}

static void add_file(request_t *r, const char *path)
{
    const uint32_t magic = read_magic(path);
    const char **place = magic == MODEL_MAGIC    ? &r->model
                         : magic == VECTOR_MAGIC ? &r->vectors
                         : magic == RESULT_MAGIC ? &r->results[r->n_results < 1 ? 0 : 1]
                                                 : NULL;
    if (place == NULL) {
        die("%s: neither a model, a vector file nor a result file: damaged, or its replay did not end", path);
    }
    if (*place != NULL) {
        usage("too many files of one kind");
    }
    *place = path;
    r->n_results += magic == RESULT_MAGIC;
}

static request_t parse(int argc, char **argv)
{
    request_t r;
    int i;
    memset(&r, 0, sizeof r);
    r.shown = 10;
    for (i = 1; i < argc; ++i) {
        const char *word = argv[i];
        const char *value = i + 1 < argc ? argv[i + 1] : NULL;
        if (strcmp(word, "--exact") == 0) {
            r.exact = 1;
        } else if (strcmp(word, "--on-demand") == 0) {
            r.on_demand = 1;
        } else if (strcmp(word, "--json") == 0 && value != NULL) {
            r.json = argv[++i];
        } else if (strcmp(word, "--junit") == 0 && value != NULL) {
            r.junit = argv[++i];
        } else if (strcmp(word, "--show") == 0 && value != NULL) {
            char *end = NULL;
            r.shown = (size_t)strtoul(argv[++i], &end, 10);
            if (end == value || *end != '\0' || *value == '-') {
                usage("--show takes a number");
            }
        } else if (strcmp(word, "--help") == 0) {
            print_usage(stdout);
            exit(0);
        } else if (word[0] == '-' && word[1] == '-') {
            usage("unknown option, or its value is missing");
        } else {
            add_file(&r, word);
        }
    }
    return r;
}

static const vector_header_t *not_empty(const vector_header_t *header, const char *path)
{
    if (header->n == 0) {
        die("%s: holds no sample: there is nothing to compare", path);
    }
    return header;
}

static results_t read_results(const char *path)
{
    return results_of(not_empty(open_results(path), path));
}

/* its content is what it was exported with, and this library computes with it as it must */
static void check_model(const char *path, const aminn_model_t *model)
{
    static aminn_t ctx;
    aminn_status_t status = aminn_init(&ctx, model, 0);
    status = status == AMINN_OK ? aminn_self_test(&ctx) : status;
    if (status != AMINN_OK) {
        die("%s: %s: %s", path, aminn_status_name(status), aminn_status_text(status));
    }
}

static void judge_replay(verdict_t *verdict, const request_t *r)
{
    aminn_model_t model;
    const vector_header_t *vectors = not_empty(open_vectors(r->vectors), r->vectors);
    open_model(r->model, &model);
    check_model(r->model, &model);
    if (r->exact) {
        compare_bits(verdict, predict_all(&model, vectors), read_results(r->results[0]));
    } else {
        compare_within(verdict, &model, vectors, read_results(r->results[0]), r->on_demand);
    }
    if (vectors->model != 0 && vectors->model != model.content_crc) { /* the reference is that of another model */
        const failure_t failure = {MODEL, -1, -1, model.content_crc, vectors->model, 0, HUGE_VAL};
        add_failure(verdict, failure);
    }
}

static void refuse_inputs(const request_t *r, const char *out)
{
    const char *inputs[] = {r->model, r->vectors, r->results[0], r->results[1]};
    size_t i;
    for (i = 0; out != NULL && i < sizeof inputs / sizeof inputs[0]; ++i) {
        if (inputs[i] != NULL) {
            refuse_input(out, inputs[i]);
        }
    }
}

int main(int argc, char **argv)
{
    verdict_t verdict;
    request_t r;
    const char *what;
    FILE *says = stdout;
    int failed;
    program_name = "aminn_compare";
    failure_status = EXIT_FILE;
    r = parse(argc, argv);
    if (!(r.n_results == 2 && r.model == NULL && r.vectors == NULL) &&
        !(r.n_results == 1 && r.model != NULL && r.vectors != NULL)) {
        usage("two result files, or a model, a vector file and a result file are needed");
    }
    if (r.on_demand && (r.exact || r.n_results == 2)) {
        usage("--on-demand goes with tolerances, not with bits");
    }
    refuse_inputs(&r, r.json);
    refuse_inputs(&r, r.junit);
    what = r.results[r.n_results - 1];
    memset(&verdict, 0, sizeof verdict);
    if (r.n_results == 2) {
        compare_bits(&verdict, read_results(r.results[0]), read_results(r.results[1]));
    } else {
        judge_replay(&verdict, &r);
    }
    sort_failures(&verdict);
    if (r.json != NULL) {
        write_json(&verdict, what, r.json);
        says = output_is_stdout() ? stderr : says;
    }
    if (r.junit != NULL) {
        write_junit(&verdict, what, r.junit);
        says = output_is_stdout() ? stderr : says;
    }
    print_verdict(&verdict, what, r.shown, says);
    failed = verdict.n_failures > 0;
    free(verdict.failures);
    return failed ? EXIT_DIFFERENT : 0;
}
