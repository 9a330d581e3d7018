#include "verdict_report.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "host_file.h"

enum { JUNIT_FAILURES = 20 }; /* of an output that are told in full */

typedef struct figure {
    const char *name;
    double value;
    int whole; /* 1: a count */
} figure_t;

enum { MAX_FIGURES = 32 };

/* fills `figures`, returns their number */
static int figures_of(const verdict_t *v, figure_t figures[MAX_FIGURES])
{
    const figure_t both[] = {{"samples", v->n, 1}, {"refused", v->refused, 1}};
    const figure_t exact[] = {{"different_words", (double)v->different_words, 1}};
    const figure_t within[] = {{"p_stable_difference_max", v->largest[P_STABLE], 0},
                               {"dx_relative_difference_max", v->largest[DX_HT], 0},
                               {"dx_relative_difference_median", v->dx_median, 0},
                               {"k_x_relative_difference_max", v->largest[K_X], 0},
                               {"gate_difference_max", v->largest[GATE], 0},
                               {"p_slide_difference_max", v->largest[P_SLIDE], 0},
                               {"bound_95_relative_difference_max", v->largest[BOUND_95], 0},
                               {"friction_use_difference_max", v->largest[FRICTION_USE], 0},
                               {"decisions_different", v->decisions, 1},
                               {"p_stable_of_limit_max", v->share_largest[P_STABLE], 0},
                               {"dx_of_limit_max", v->share_largest[DX_HT], 0},
                               {"k_x_of_limit_max", v->share_largest[K_X], 0},
                               {"gate_of_limit_max", v->share_largest[GATE], 0},
                               {"p_slide_of_limit_max", v->share_largest[P_SLIDE], 0},
                               {"bound_95_of_limit_max", v->share_largest[BOUND_95], 0},
                               {"friction_use_of_limit_max", v->share_largest[FRICTION_USE], 0},
                               {"p_stable_of_limit_median", v->median[P_STABLE], 0},
                               {"dx_of_limit_median", v->median[DX_HT], 0},
                               {"k_x_of_limit_median", v->median[K_X], 0},
                               {"gate_of_limit_median", v->median[GATE], 0},
                               {"p_slide_of_limit_median", v->median[P_SLIDE], 0},
                               {"bound_95_of_limit_median", v->median[BOUND_95], 0},
                               {"friction_use_of_limit_median", v->median[FRICTION_USE], 0}};
    const size_t n = v->exact ? sizeof exact / sizeof *exact : sizeof within / sizeof *within;
    memcpy(figures, both, sizeof both);
    memcpy(figures + 2, v->exact ? exact : within, n * sizeof *figures);
    figures[2 + n].name = v->exact ? "different_numbers" : "numbers_beyond_limit";
    figures[2 + n].value = (double)v->n_failures;
    figures[2 + n].whole = 1;
    return (int)(3 + n);
}

/* ---- text ---- */

/* one failure as a sentence without its end */
static void print_failure(FILE *file, const failure_t *f)
{
    char name[40];
    component_name(f, name, sizeof name);
    if (f->output == SAMPLES) {
        fprintf(file, "samples: got %.0f, want %.0f", f->got, f->want);
    } else if (f->output == MODEL) {
        fprintf(file, "model: the reference is of content_crc %08" PRIx32 ", this model has %08" PRIx32,
                (uint32_t)f->want, (uint32_t)f->got);
    } else if (f->sample < 0) {
        fprintf(file, "%s: median of difference over limit %.3g, limit %.3g", name, f->got, f->limit);
    } else if (f->output == STATUS) {
        fprintf(file, "status of sample %" PRId64 ": got %.0f (%s), want %.0f", f->sample, f->got,
                aminn_status_name((aminn_status_t)f->got), f->want);
    } else {
        fprintf(file, "%s of sample %" PRId64 ": got %.9g, want %.9g, limit %.3g", name, f->sample, f->got, f->want,
                f->limit);
    }
}

void print_verdict(const verdict_t *verdict, const char *what, size_t shown, FILE *says)
{
    figure_t figures[MAX_FIGURES];
    const int n = figures_of(verdict, figures);
    size_t i;
    int k;
    for (k = 0; k < n; ++k) {
        fprintf(says, figures[k].whole ? "%s %.0f\n" : "%s %.3g\n", figures[k].name, figures[k].value);
    }
    fflush(says);
    if (verdict->n_failures == 0) {
        return;
    }
    for (i = 0; i < verdict->n_failures && i < shown; ++i) {
        fprintf(stderr, "%s: ", program_name);
        print_failure(stderr, &verdict->failures[i]);
        fputc('\n', stderr);
    }
    fprintf(stderr, "%s: %s: %zu numbers differ", program_name, what, verdict->n_failures);
    fprintf(stderr, i < verdict->n_failures ? "; the worst %zu stand above\n" : "\n", i);
}

/* ---- files ---- */

/* Length of the UTF-8 character that begins at s, 0 if none does. */
static int character(const unsigned char *s)
{
    const int n = *s < 0x80 ? 1 : *s < 0xC2 ? 0 : *s < 0xE0 ? 2 : *s < 0xF0 ? 3 : *s < 0xF5 ? 4 : 0;
    int i;
    for (i = 1; i < n; ++i) {
        if ((s[i] & 0xC0) != 0x80) {
            return 0;
        }
    }
    return n;
}

/* Text within quotes of JSON or of an attribute of XML; what is no UTF-8, and in XML control characters, as "?". */
static void put_text(FILE *file, const char *text, int xml)
{
    const unsigned char *s = (const unsigned char *)text;
    while (*s != '\0') {
        const int n = character(s);
        if (n == 0) {
            fputc('?', file);
        } else if (*s < 0x20) {
            fprintf(file, xml ? "?" : "\\u%04x", *s);
        } else if (!xml && (*s == '"' || *s == '\\')) {
            fprintf(file, "\\%c", *s);
        } else if (xml && strchr("<>&\"", *s) != NULL) {
            fprintf(file, "&#%d;", *s);
        } else {
            fwrite(s, 1, (size_t)n, file);
        }
        s += n > 0 ? n : 1;
    }
}

/* a number of JSON, which knows neither NaN nor infinity: these as text */
static void put_number(FILE *file, double value)
{
    if (isnan(value)) {
        fputs("\"nan\"", file);
    } else if (isinf(value)) {
        fputs(value > 0 ? "\"inf\"" : "\"-inf\"", file);
    } else {
        fprintf(file, "%.9g", value);
    }
}

void write_json(const verdict_t *verdict, const char *what, const char *path)
{
    FILE *file = create_output(path);
    figure_t figures[MAX_FIGURES];
    const int n = figures_of(verdict, figures);
    size_t i;
    int k;
    fputs("{\n \"what\": \"", file);
    put_text(file, what, 0);
    fprintf(file, "\",\n \"ok\": %s,\n", verdict->n_failures == 0 ? "true" : "false");
    for (k = 0; k < n; ++k) {
        fprintf(file, " \"%s\": ", figures[k].name);
        put_number(file, figures[k].value);
        fputs(",\n", file);
    }
    fputs(" \"failures\": [", file);
    for (i = 0; i < verdict->n_failures; ++i) {
        const failure_t *f = &verdict->failures[i];
        char name[40];
        component_name(f, name, sizeof name);
        fprintf(file, "%s\n  {\"output\": \"%s\", \"sample\": ", i > 0 ? "," : "", name);
        if (f->sample < 0) {
            fputs("null", file);
        } else {
            fprintf(file, "%" PRId64, f->sample);
        }
        fputs(", \"got\": ", file);
        put_number(file, f->got);
        fputs(", \"want\": ", file);
        put_number(file, f->want);
        fputs(", \"limit\": ", file);
        put_number(file, f->limit);
        fputc('}', file);
    }
    fputs("\n ]\n}\n", file);
    finish_output(file);
}

void write_junit(const verdict_t *verdict, const char *what, const char *path)
{
    FILE *file = create_output(path);
    int output, failed = 0;
    size_t i;
    for (output = 0; output < N_OUTPUT; ++output) {
        failed += verdict->failed[output] > 0;
    }
    fputs("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n", file);
    fprintf(file, "<testsuites>\n<testsuite name=\"aminn_compare\" tests=\"%d\" failures=\"%d\" errors=\"0\">\n",
            (int)N_OUTPUT, failed);
    for (output = 0; output < N_OUTPUT; ++output) {
        const uint64_t count = verdict->failed[output];
        size_t told = 0;
        fputs("<testcase classname=\"", file);
        put_text(file, what, 1);
        fprintf(file, "\" name=\"%s\">", output_names[output]);
        if (count > 0) {
            fprintf(file, "<failure message=\"%" PRIu64 " numbers differ\">", count);
            for (i = 0; i < verdict->n_failures && told < JUNIT_FAILURES; ++i) {
                if ((int)verdict->failures[i].output == output) {
                    print_failure(file, &verdict->failures[i]);
                    fputc('\n', file);
                    ++told;
                }
            }
            fputs("</failure>", file);
        }
        fputs("</testcase>\n", file);
    }
    fputs("</testsuite>\n</testsuites>\n", file);
    finish_output(file);
}
