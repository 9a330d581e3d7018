#include "comparison.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "host_file.h"
#include "tolerances.h"

enum { N_DX = AMINN_N_WRENCH, N_K_X = N_DX * N_DX, N_GATE = AMINN_N_BRANCH, N_USE = AMINN_N_BRANCH };
enum { AT_GATE = 1 + N_DX + N_K_X, AT_SURE = AT_GATE + N_GATE };

typedef struct tolerance {
    double floor, share, per_condition, per_m, per_use, median;
} tolerance_t;

#define ROW(name, floor, share, per_condition, per_m, per_use, median) \
    {floor, share, per_condition, per_m, per_use, median},
static const tolerance_t tolerances[STABLE] = {TOLERANCES(ROW)};
#undef ROW
/* first word of each output in a row, and where the row ends */
static const int first_word[STABLE + 2] = {0,           1,           1 + N_DX,         AT_GATE,     AT_SURE,
                                           AT_SURE + 1, AT_SURE + 2, RESULT_N_OUT - 1, RESULT_N_OUT};

const char *const output_names[N_OUTPUT] = {"p_stable",     "dx_ht",  "k_x",    "gate",    "p_slide", "bound_95",
                                            "friction_use", "stable", "status", "samples", "model"};

/* ---- failures ---- */

void component_name(const failure_t *failure, char *text, size_t size)
{
    const char *name = output_names[failure->output];
    if (failure->component < 0) {
        snprintf(text, size, "%s", name);
    } else if (failure->output == K_X) {
        snprintf(text, size, "%s[%d][%d]", name, (int)failure->component / 6, (int)failure->component % 6);
    } else {
        snprintf(text, size, "%s[%d]", name, (int)failure->component);
    }
}

void add_failure(verdict_t *verdict, failure_t failure)
{
    if (verdict->n_failures == verdict->capacity) {
        const size_t capacity = verdict->capacity > 0 ? 2 * verdict->capacity : 256;
        failure_t *more = realloc(verdict->failures, capacity * sizeof failure);
        if (more == NULL) {
            die("out of memory for %zu failures", capacity);
        }
        verdict->failures = more;
        verdict->capacity = capacity;
    }
    verdict->failures[verdict->n_failures++] = failure;
    ++verdict->failed[failure.output];
}

static void fail(verdict_t *verdict, output_t output, int component, int64_t sample, double got, double want,
                 double limit, double share)
{
    const failure_t failure = {output, component, sample, got, want, limit, share};
    add_failure(verdict, failure);
}

static int by_share(const void *a, const void *b)
{
    const failure_t *x = (const failure_t *)a, *y = (const failure_t *)b;
    if (x->share != y->share) {
        return x->share > y->share ? -1 : 1;
    }
    if (x->sample != y->sample) {
        return x->sample < y->sample ? -1 : 1;
    }
    return x->output != y->output ? (int)x->output - (int)y->output : x->component - y->component;
}

void sort_failures(verdict_t *verdict)
{
    if (verdict->n_failures > 0) {
        qsort(verdict->failures, verdict->n_failures, sizeof *verdict->failures, by_share);
    }
}

static void clear(verdict_t *verdict, uint32_t n, int exact)
{
    failure_t *failures = verdict->failures;
    const size_t capacity = verdict->capacity;
    memset(verdict, 0, sizeof *verdict);
    verdict->failures = failures;
    verdict->capacity = capacity;
    verdict->n = n;
    verdict->exact = exact;
}

/* whether both have as many samples */
static int same_number(verdict_t *verdict, uint32_t got, uint32_t want)
{
    if (got != want) {
        fail(verdict, SAMPLES, -1, -1, got, want, 0, HUGE_VAL);
    }
    return got == want;
}

/* ---- results ---- */

results_t results_of(const vector_header_t *header)
{
    results_t r;
    r.n = header->n;
    r.rows = (const float *)(header + 1);
    r.statuses = (const int32_t *)(const void *)(r.rows + (size_t)header->n * RESULT_N_OUT);
    return r;
}

results_t predict_all(const aminn_model_t *model, const vector_header_t *vectors)
{
    static aminn_t ctx;
    float *rows = malloc(((size_t)vectors->n * RESULT_N_OUT + 1) * sizeof *rows);
    int32_t *statuses = malloc(((size_t)vectors->n + 1) * sizeof *statuses);
    const aminn_status_t status = aminn_init(&ctx, model, AMINN_FLAG_ALWAYS_STAGE2);
    results_t results;
    if (rows == NULL || statuses == NULL) {
        die("out of memory for %u samples", (unsigned)vectors->n);
    }
    if (status != AMINN_OK) {
        die("%s: %s", aminn_status_name(status), aminn_status_text(status));
    }
    predict_rows(&ctx, model, vectors, rows, statuses);
    results.n = vectors->n;
    results.rows = rows;
    results.statuses = statuses;
    return results;
}

/* ---- bits ---- */

static uint32_t bits_of(float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

static void compare_row(verdict_t *verdict, uint32_t i, const float *got, const float *want)
{
    int output, word;
    for (output = P_STABLE; output <= STABLE; ++output) {
        const int first = first_word[output], n = first_word[output + 1] - first;
        for (word = 0; word < n; ++word) {
            const float a = got[first + word], b = want[first + word];
            if (bits_of(a) != bits_of(b)) {
                ++verdict->different_words;
                fail(verdict, (output_t)output, n > 1 ? word : -1, i, (double)a, (double)b, 0, HUGE_VAL);
            }
        }
    }
}

void compare_bits(verdict_t *verdict, results_t want, results_t got)
{
    uint32_t i;
    clear(verdict, got.n, 1);
    if (!same_number(verdict, got.n, want.n)) {
        return;
    }
    for (i = 0; i < got.n; ++i) {
        verdict->refused += got.statuses[i] != AMINN_OK;
        if (got.statuses[i] != want.statuses[i]) {
            fail(verdict, STATUS, -1, i, got.statuses[i], want.statuses[i], 0, HUGE_VAL);
        }
        compare_row(verdict, i, got.rows + (size_t)i * RESULT_N_OUT, want.rows + (size_t)i * RESULT_N_OUT);
    }
}

/* ---- within tolerances ---- */

/* a Jacobi rotation that makes a[p][q] zero */
static void rotate(double a[6][6], int p, int q)
{
    const double theta = 0.5 * atan2(2 * a[p][q], a[q][q] - a[p][p]), c = cos(theta), s = sin(theta);
    int k;
    for (k = 0; k < 6; ++k) {
        const double x = a[p][k], y = a[q][k];
        a[p][k] = c * x - s * y;
        a[q][k] = s * x + c * y;
    }
    for (k = 0; k < 6; ++k) {
        const double x = a[k][p], y = a[k][q];
        a[k][p] = c * x - s * y;
        a[k][q] = s * x + c * y;
    }
}

/* eigenvalues of a symmetric 6x6 matrix by Jacobi rotations; returns largest over smallest */
static double condition(double a[6][6])
{
    double low = HUGE_VAL, high = 0;
    int sweep, p, q, k, turned = 1;
    for (sweep = 0; sweep < 30 && turned; ++sweep) {
        turned = 0;
        for (p = 0; p < 5; ++p) {
            for (q = p + 1; q < 6; ++q) {
                if (fabs(a[p][q]) > 1e-12 * sqrt(fabs(a[p][p] * a[q][q]))) {
                    rotate(a, p, q);
                    turned = 1;
                }
            }
        }
    }
    for (k = 0; k < 6; ++k) {
        low = fmin(low, a[k][k]);
        high = fmax(high, a[k][k]);
    }
    return low * CONDITION_MAX > high ? high / low : CONDITION_MAX;
}

/* what the limits of a sample follow from */
typedef struct sample {
    uint32_t i;
    const float *got, *want;
    double length;    /* length_scale of the model, m */
    double condition; /* of the reference's K_x with lengths divided by it */
    double size;      /* of the reference's dx_ht with rotations times it, m */
    double use;       /* largest of the reference's friction_use */
    double k_x;       /* largest entry of the reference's K_x with lengths divided by it */
    double relative;  /* difference of dx_ht over size */
    double share[STABLE];
    int absent; /* 1: stage 2 did not run */
} sample_t;

/* what component c of K_x, row-major, is multiplied with when lengths are divided by length_scale */
static double k_x_scale(const sample_t *s, int c)
{
    return 1 / ((c / 6 < 3 ? 1 : s->length) * (c % 6 < 3 ? 1 : s->length));
}

static double dx_scale(const sample_t *s, int c)
{
    return c < 3 ? 1 : s->length;
}

static sample_t sample_of(uint32_t i, const float *got, const float *want, double length)
{
    double a[6][6], sum = 0;
    sample_t s;
    int c;
    memset(&s, 0, sizeof s);
    s.i = i;
    s.got = got;
    s.want = want;
    s.length = length;
    memset(a, 0, sizeof a);
    for (c = 0; c < N_K_X; ++c) {
        a[c / 6][c % 6] = (double)want[first_word[K_X] + c] * k_x_scale(&s, c);
        s.k_x = fmax(s.k_x, fabs(a[c / 6][c % 6]));
    }
    for (c = 0; c < N_DX; ++c) {
        const double v = (double)want[first_word[DX_HT] + c] * dx_scale(&s, c);
        sum += v * v;
    }
    s.size = sqrt(sum);
    for (c = 0; c < N_USE; ++c) {
        s.use = fmax(s.use, (double)want[first_word[FRICTION_USE] + c]);
    }
    s.condition = condition(a);
    return s;
}

static double limit_of(const sample_t *s, output_t output, double scale)
{
    const tolerance_t *t = &tolerances[output];
    return t->floor + scale * (t->share + t->per_condition * s->condition + t->per_m * s->size + t->per_use * s->use);
}

/* infinite unless it is a number: NaN is larger than every limit, and stays so */
static double sound(double difference)
{
    return difference <= HUGE_VAL ? difference : HUGE_VAL;
}

static double share_of(double difference, double limit)
{
    return difference == 0 ? 0 : sound(sound(difference) / limit);
}

/* difference of one number of the sample, times scale; infinite if either is none */
static double difference_of(const sample_t *s, int word, double scale)
{
    return sound(fabs((double)s->got[word] - (double)s->want[word]) * scale);
}

/* judges one number by its own limit */
static void judge_word(verdict_t *verdict, sample_t *s, output_t output, int component, double scale, double limit,
                       double of)
{
    const int word = first_word[output] + (component > 0 ? component : 0);
    const double difference = difference_of(s, word, scale), share = share_of(difference, limit);
    verdict->largest[output] = fmax(verdict->largest[output], share_of(difference, of));
    s->share[output] = fmax(s->share[output], share);
    if (!(share <= 1)) {
        fail(verdict, output, component, s->i, (double)s->got[word], (double)s->want[word], limit / scale, share);
    }
}

/* the motion is judged as a whole; the failure names the component that is furthest off */
static void judge_motion(verdict_t *verdict, sample_t *s)
{
    const double limit = limit_of(s, DX_HT, s->size);
    double sum = 0, worst = -1;
    int c, component = 0;
    for (c = 0; c < N_DX; ++c) {
        const double d = difference_of(s, first_word[DX_HT] + c, dx_scale(s, c));
        sum += d * d;
        if (d > worst) {
            worst = d;
            component = c;
        }
    }
    s->share[DX_HT] = share_of(sqrt(sum), limit);
    s->relative = share_of(sqrt(sum), s->size + tolerances[DX_HT].floor);
    verdict->largest[DX_HT] = fmax(verdict->largest[DX_HT], s->relative);
    if (!(s->share[DX_HT] <= 1)) {
        const int word = first_word[DX_HT] + component;
        fail(verdict, DX_HT, component, s->i, (double)s->got[word], (double)s->want[word],
             limit / dx_scale(s, component), s->share[DX_HT]);
    }
}

static void judge_stiffness(verdict_t *verdict, sample_t *s)
{
    int c;
    for (c = 0; c < N_K_X; ++c) {
        const int word = first_word[K_X] + c, mirrored = first_word[K_X] + 6 * (c % 6) + c / 6;
        judge_word(verdict, s, K_X, c, k_x_scale(s, c), limit_of(s, K_X, s->k_x), s->k_x);
        if (c / 6 < c % 6 && bits_of(s->got[word]) != bits_of(s->got[mirrored])) {
            fail(verdict, K_X, c, s->i, (double)s->got[word], (double)s->got[mirrored], 0, HUGE_VAL);
        }
    }
}

/* The decision is the reference's, except so close to tau that p_stable may lie on either side: then it is that of the
 * result's own p_stable. */
static void judge_decision(verdict_t *verdict, const sample_t *s, double limit, float tau)
{
    const float got = s->got[first_word[STABLE]], reference = s->want[P_STABLE] >= tau ? 1.0F : 0.0F;
    const double distance = fabs((double)s->want[P_STABLE] - (double)tau);
    const int close = distance <= limit;
    const float want = close ? (s->got[P_STABLE] >= tau ? 1.0F : 0.0F) : reference;
    verdict->decisions += !(got == reference);
    if (!(got == want)) {
        fail(verdict, STABLE, -1, s->i, (double)got, (double)want, 0, close ? HUGE_VAL : share_of(distance, limit));
    }
}

/* Without AMINN_FLAG_ALWAYS_STAGE2 a grasp that does not hold has no motion: NaN alone is right. */
static void judge_absence(verdict_t *verdict, const sample_t *s)
{
    int output, c;
    for (output = DX_HT; output < FRICTION_USE; ++output) {
        const int first = first_word[output], n = first_word[output + 1] - first;
        for (c = 0; c < n; ++c) {
            if (s->got[first + c] == s->got[first + c]) {
                fail(verdict, (output_t)output, n > 1 ? c : -1, s->i, (double)s->got[first + c], (double)NAN, 0,
                     HUGE_VAL);
            }
        }
    }
}

/* of the sigmoid that has this value; 0 where none has */
static double steepness(double value)
{
    return fmax(value * (1 - value), 0);
}

/* the factor of the bin that p_slide of a row lies in */
static double bound_factor(const aminn_model_t *model, const float *row)
{
    int i, bin = 0;
    for (i = 0; i < 3; ++i) {
        bin += row[first_word[P_SLIDE]] >= model->bound_edge[i];
    }
    return (double)model->bound_factor[bin];
}

/* p_slide, and bound_95 over the factor of the bin that its own p_slide lies in */
static void judge_doubt(verdict_t *verdict, sample_t *s, const aminn_model_t *model)
{
    const int word = first_word[BOUND_95];
    const double own = bound_factor(model, s->got), factor = bound_factor(model, s->want);
    const double want = (double)s->want[word] / factor, limit = limit_of(s, BOUND_95, fmax(want, 0));
    const double difference = sound(fabs((double)s->got[word] / own - want)), share = share_of(difference, limit);
    judge_word(verdict, s, P_SLIDE, -1, 1, limit_of(s, P_SLIDE, steepness((double)s->want[first_word[P_SLIDE]])), 1);
    verdict->largest[BOUND_95] = fmax(verdict->largest[BOUND_95], share_of(difference, want));
    s->share[BOUND_95] = share;
    if (!(share <= 1)) {
        fail(verdict, BOUND_95, -1, s->i, (double)s->got[word], (double)s->want[word], limit, share);
    }
}

static void judge_sample(verdict_t *verdict, sample_t *s, const aminn_model_t *model, int on_demand)
{
    const double p_limit = limit_of(s, P_STABLE, steepness((double)s->want[P_STABLE]));
    int c;
    judge_word(verdict, s, P_STABLE, -1, 1, p_limit, 1);
    judge_decision(verdict, s, p_limit, model->tau);
    for (c = 0; c < N_USE; ++c) {
        const double use = (double)s->want[first_word[FRICTION_USE] + c];
        judge_word(verdict, s, FRICTION_USE, c, 1, limit_of(s, FRICTION_USE, fmax(use, 0)), 1);
    }
    s->absent = on_demand && s->got[first_word[STABLE]] == 0.0F;
    if (s->absent) {
        judge_absence(verdict, s);
        return;
    }
    judge_motion(verdict, s);
    judge_stiffness(verdict, s);
    for (c = 0; c < N_GATE; ++c) {
        const double steep = steepness((double)s->want[first_word[GATE] + c]);
        judge_word(verdict, s, GATE, c, 1, limit_of(s, GATE, steep), 1);
    }
    judge_doubt(verdict, s, model);
}

static int by_size(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static double median_of(double *values, uint32_t n)
{
    qsort(values, n, sizeof *values, by_size);
    return n == 0 ? 0 : 0.5 * (values[(n - 1) / 2] + values[n / 2]);
}

static void judge_medians(verdict_t *verdict, double *shares, uint32_t capacity, const uint32_t *counts)
{
    int output;
    for (output = P_STABLE; output < STABLE; ++output) {
        const double limit = tolerances[output].median;
        const double median = median_of(shares + (size_t)output * capacity, counts[output]);
        verdict->median[output] = median;
        if (counts[output] >= MEDIAN_MIN_SAMPLES && !(median <= limit)) {
            fail(verdict, (output_t)output, -1, -1, median, 0, limit, median / limit);
        }
    }
}

void compare_within(verdict_t *verdict, const aminn_model_t *model, const vector_header_t *vectors, results_t got,
                    int on_demand)
{
    const float *want = (const float *)(vectors + 1) + (size_t)vectors->n * vector_sample(vectors);
    double *shares = calloc((size_t)(STABLE + 1) * vectors->n + 1, sizeof *shares);
    uint32_t counts[STABLE] = {0}, i;
    int output;
    if (shares == NULL) {
        die("out of memory for %u samples", (unsigned)vectors->n);
    }
    clear(verdict, got.n, 0);
    if (!same_number(verdict, got.n, vectors->n)) {
        free(shares);
        return;
    }
    for (i = 0; i < got.n; ++i) {
        sample_t s = sample_of(i, got.rows + (size_t)i * RESULT_N_OUT, want + (size_t)i * VECTOR_N_OUT,
                               (double)model->length_scale);
        if (got.statuses[i] != AMINN_OK) {
            ++verdict->refused;
            fail(verdict, STATUS, -1, i, got.statuses[i], AMINN_OK, 0, HUGE_VAL);
            continue;
        }
        judge_sample(verdict, &s, model, on_demand);
        for (output = P_STABLE; output < STABLE; ++output) {
            if (s.absent && output != P_STABLE && output != FRICTION_USE) {
                continue;
            }
            verdict->share_largest[output] = fmax(verdict->share_largest[output], s.share[output]);
            shares[(size_t)output * got.n + counts[output]++] = s.share[output];
        }
        if (!s.absent) {
            shares[(size_t)STABLE * got.n + counts[DX_HT] - 1] = s.relative;
        }
    }
    judge_medians(verdict, shares, got.n, counts);
    verdict->dx_median = median_of(shares + (size_t)STABLE * got.n, counts[DX_HT]);
    free(shares);
}
