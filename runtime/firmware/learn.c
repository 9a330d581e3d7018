/*
 * The limiter on a hand that is not as its description has it: it judges loads, learns from ten pushes, and judges the loads
 * again. PUSHES.bin is a vector file whose reference is what was measured: p_stable 1 or 0, whether the grasp held, and dx_ht.
 * Its first ten samples are the pushes, the others the loads.
 */
#include <string.h>

#include MODEL_HEADER
#include "figures.h"
#include "limiter.h"
#include "modes.h"
#include "semihosting.h"
#include "trial.h"
#include "vector_file.h"

enum { PUSHES = 10, PERMILLE = 1000 };

static const aminn_load_limits_t limits = {1e-3F, 3.0F, 0.0F, 0.0F, 1.0F, 1.0F}; /* 1 mm */

static int read_sample(int file, const vector_header_t *header, uint32_t i, trial_t *sample)
{
    const uint32_t input = vector_sample(header) * 4u;
    const uint32_t inputs = (uint32_t)sizeof *header, outputs = inputs + header->n * input;
    return semihost_seek(file, inputs + i * input) != 0 ||
           semihost_read(file, &sample->before, sizeof sample->before) != 0 ||
           semihost_seek(file, outputs + i * VECTOR_N_OUT * 4u) != 0 ||
           semihost_read(file, &sample->held, sizeof sample->held + sizeof sample->dx_ht) != 0;
}

static int judge_all(int file, const vector_header_t *header, verdict_t *verdict)
{
    uint32_t i;
    memset(verdict, 0, sizeof *verdict);
    for (i = PUSHES; i < header->n; ++i) {
        trial_t sample;
        if (read_sample(file, header, i, &sample) != 0) {
            return 1;
        }
        judge(&limiter, MODEL_SYMBOL.length_scale, &sample, verdict);
    }
    return verdict->compared == 0;
}

static uint32_t permille(const verdict_t *verdict)
{
    return (uint32_t)(mean_error(verdict) * (float)PERMILLE);
}

int run_calibration(const char *pushes)
{
    const int file = semihost_open(pushes, SEMIHOST_READ);
    vector_header_t header;
    verdict_t nominal, learned;
    aminn_status_t status;
    uint32_t i;
    if (file < 0) {
        return fail(pushes, "cannot open");
    }
    if (semihost_read(file, &header, sizeof header) != 0 ||
        vector_header_error(&header, (uint32_t)semihost_length(file) - (uint32_t)sizeof header) != NULL ||
        header.n <= PUSHES) {
        return fail(pushes, "not a whole vector file of more than ten samples");
    }
    status = limiter_init(&limiter, &MODEL_SYMBOL, &limits);
    if (status != AMINN_OK) {
        return fail("limiter", aminn_status_name(status));
    }
    if (judge_all(file, &header, &nominal) != 0) {
        return fail(pushes, "cannot read");
    }
    for (i = 0; i < PUSHES; ++i) {
        trial_t sample;
        if (read_sample(file, &header, i, &sample) != 0) {
            return fail(pushes, "cannot read");
        }
        status = limiter_learn(&limiter, &sample.before, sample.dx_ht);
        if (status != AMINN_OK) {
            return fail("a push", aminn_status_name(status));
        }
    }
    if (judge_all(file, &header, &learned) != 0) {
        return fail(pushes, "cannot read");
    }
    semihost_close(file);
    print_figure("calibrate_pushes", limiter.calibrator.pushes);
    print_figure("calibrate_loads", header.n - PUSHES);
    print_figure("calibrate_loads_good", nominal.good);
    print_figure("calibrate_let_through_wrongly_before", nominal.wrong);
    print_figure("calibrate_let_through_wrongly_after", learned.wrong);
    print_figure("calibrate_refused_needlessly_before", nominal.needless);
    print_figure("calibrate_refused_needlessly_after", learned.needless);
    print_figure("calibrate_error_permille_before", permille(&nominal));
    print_figure("calibrate_error_permille_after", permille(&learned));
    return is_better(&learned, &nominal) ? 0 : fail("calibration", "the limiter is no better than before");
}
