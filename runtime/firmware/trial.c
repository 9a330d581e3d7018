#include "trial.h"

#include <math.h>

/* size of the difference of n numbers of two displacements, rotations times a length, m */
static float distance(const float *a, const float *b, int n, float length)
{
    float sum = 0.0F;
    int i;
    for (i = 0; i < n; ++i) {
        const float d = (a[i] - b[i]) * (i < 3 ? 1.0F : length);
        sum += d * d;
    }
    return sqrtf(sum);
}

void judge(limiter_t *limiter, float length_scale, trial_t *trial, verdict_t *verdict)
{
    static const float none[AMINN_N_WRENCH];
    const int held = trial->held > 0.5F;
    const int good = held && distance(trial->dx_ht, none, 3, length_scale) <= limiter->limits.max_translation;
    aminn_output_t predicted;
    int let_through;
    if (aminn_predict_state(&limiter->aminn, &trial->before, &predicted) == AMINN_OK && held && predicted.stable != 0) {
        const float size = distance(trial->dx_ht, none, AMINN_N_WRENCH, length_scale);
        verdict->error += distance(predicted.dx_ht, trial->dx_ht, AMINN_N_WRENCH, length_scale) / size;
        ++verdict->compared;
    }
    limiter_step(limiter, &trial->before);
    let_through = limiter->found.scale == 1.0F;
    verdict->good += (uint32_t)good;
    verdict->wrong += (uint32_t)(let_through && !good);
    verdict->needless += (uint32_t)(!let_through && good);
    verdict->share += limiter->found.scale;
    verdict->whole += (uint32_t)let_through;
}

float mean_error(const verdict_t *verdict)
{
    return verdict->compared > 0 ? verdict->error / (float)verdict->compared : 0.0F;
}

int is_better(const verdict_t *verdict, const verdict_t *before)
{
    return verdict->wrong <= before->wrong && verdict->wrong + verdict->needless <= before->wrong + before->needless &&
           mean_error(verdict) < mean_error(before);
}
