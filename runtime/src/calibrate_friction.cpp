// The friction of a grasp, from its pushes.
//
// A load asks for friction: the largest tangential over normal force among the contacts, if none of them slides. If none
// did, the coefficient is more than that, softly; if one did, it is less, but not much, since the grasp held. Whether one
// did shows in how much further the tool moved than sticking contacts let it. So each push gives a likelihood of the
// coefficient on a fixed grid. Constants were found on validation grasps.
//
// From the likelihood and from what a sensor says come the coefficient and the deviation that a model is told.
#include "parts.hpp"

namespace aminn {
namespace {

#if AMINN_N_SLIDE
constexpr int kCoefficients = AMINN_N_COEFFICIENT;
constexpr float kLeastFriction = 0.4F;
constexpr float kFrictionRange = 0.7F;
constexpr float kFrictionStep = kFrictionRange / static_cast<float>(kCoefficients - 1);
constexpr float kAllowance = 0.3e-3F;  // m: what a contact that sticks may move further than predicted,
constexpr float kAllowedShare = 0.14F; // and as a share of the motion
constexpr float kLeastOdds = 0.01F;    // of a slide, by the motion
constexpr float kMostOdds = 1000.0F;
constexpr float kMostRatio = 8.0F;        // of a coefficient and what was asked for, either way
constexpr float kLeastLikelihood = 1e-6F; // beside the most likely coefficient's
constexpr float kLeastNews = 0.02F;
// Where a sensor's distribution is looked at, in its standard deviations, and its density there.
constexpr int kDeviations = 11;
constexpr float kDeviation[kDeviations] = {-3.5F, -2.8F, -2.1F, -1.4F, -0.7F, 0.0F, 0.7F, 1.4F, 2.1F, 2.8F, 3.5F};
constexpr float kNormal[kDeviations] = {0.00218749112F, 0.0198410947F, 0.110250525F, 0.375311099F,  0.782704538F,  1.0F,
                                        0.782704538F,   0.375311099F,  0.110250525F, 0.0198410947F, 0.00218749112F};

constexpr float coefficient(int k)
{
    return kLeastFriction + static_cast<float>(k) * kFrictionStep;
}

AMINN_FUNCTION float bounded(float least, float x, float most)
{
    const float above = x > least ? x : least;
    return above < most ? above : most;
}

struct Moments {
    float mean;
    float variance;
};

Moments moments_of(const float *x, const float *weights, int n)
{
    float sum = 0.0F;
    float mean = 0.0F;
    float variance = 0.0F;
    for (int k = 0; k < n; ++k) {
        sum = sum + weights[k];
        mean = add_product(mean, weights[k], x[k]);
    }
    mean = mean / sum;
    for (int k = 0; k < n; ++k) {
        const float off = x[k] - mean;
        variance = add_product(variance, weights[k] * off, off);
    }
    return {mean, variance / sum};
}

// Mean and deviation of the likelihood with the grid's own distribution taken out again, as networks bring it with them: the
// more so, the less is learned. Zeros where pushes have told nothing.
void alone(const float *likelihood, float *friction)
{
    constexpr float kMean = kLeastFriction + 0.5F * kFrictionRange;
    constexpr float kInverse =
        12.0F / (kFrictionStep * kFrictionStep * static_cast<float>(kCoefficients * kCoefficients - 1));
    float at[kCoefficients];
    for (int k = 0; k < kCoefficients; ++k) {
        at[k] = coefficient(k);
    }
    const Moments found = moments_of(at, likelihood, kCoefficients);
    const float share = found.variance * kInverse;
    const float own = share * share;
    const float news = 1.0F - own;
    if (news > kLeastNews) {
        const float mean = (found.mean - own * kMean) / news;
        friction[0] = 1.0F;
        friction[1] = bounded(kLeastFriction, mean, kLeastFriction + kFrictionRange);
        friction[2] = root(found.variance / news);
    } else {
        __builtin_memset(friction, 0, 3 * sizeof *friction);
    }
}

// The same with what a sensor says.
void together(const float *likelihood, const float *sensor, float *friction)
{
    float at[kDeviations];
    float weight[kDeviations];
    for (int k = 0; k < kDeviations; ++k) {
        const float x = add_product(sensor[1], sensor[2], kDeviation[k]);
        const float place = bounded(0.0F, (x - kLeastFriction) / kFrictionStep, static_cast<float>(kCoefficients - 1));
        int low = static_cast<int>(place);
        low = low < kCoefficients - 1 ? low : kCoefficients - 2;
        const float above = place - static_cast<float>(low);
        at[k] = x;
        weight[k] = kNormal[k] * add_product(likelihood[low], above, likelihood[low + 1] - likelihood[low]);
        weight[k] = x > 0.0F ? weight[k] : 0.0F; // there is no coefficient below zero
    }
    const Moments found = moments_of(at, weight, kDeviations);
    friction[0] = 1.0F;
    friction[1] = found.mean;
    friction[2] = root(found.variance);
}

// What a sensor says becomes what it and the likelihood say.
void combine(const float *likelihood, float *friction)
{
    float found[3];
    if (friction[0] == 0.0F) {
        alone(likelihood, found);
    } else {
        together(likelihood, friction, found);
    }
    if (all_finite(found, 3)) {
        __builtin_memcpy(friction, found, sizeof found);
    }
}
#endif

} // namespace

#if AMINN_N_SLIDE
void forget_friction(aminn_calibrator_t &c)
{
    for (float &likelihood : c.friction) {
        likelihood = 1.0F;
    }
}

void narrow_friction(aminn_calibrator_t &c, const PushedFriction &push, bool sure)
{
    const float allowed = add_product(kAllowance * kAllowance, kAllowedShare * kAllowedShare, push.size);
    const float odds = bounded(kLeastOdds, push.off / allowed, kMostOdds);
    float most = 0.0F;
    for (int k = 0; k < kCoefficients; ++k) {
        const float ratio = bounded(1.0F / kMostRatio, coefficient(k) / push.asked, kMostRatio); // of 0 as well
        const float square = ratio * ratio;
        float sticks = square * square; // odds of it
        sticks = sticks * sticks;
        sticks = sure ? sticks * sticks : sticks;
        const float slides = odds * (square < 1.0F ? square : 1.0F);
        c.friction[k] = c.friction[k] * ((sticks + slides) / (sticks + 1.0F));
        most = c.friction[k] > most ? c.friction[k] : most;
    }
    for (float &likelihood : c.friction) {
        const float share = likelihood / most;
        likelihood = share > kLeastLikelihood ? share : kLeastLikelihood;
    }
}

#endif
} // namespace aminn

using namespace aminn;

aminn_status_t aminn_calibrator_friction(const aminn_calibrator_t *calibrator, const aminn_state_t *state,
                                         const float sensor[3], float friction[3])
{
    static const float kUnknown[3] = {0.0F, 0.0F, 0.0F};
    if (calibrator == nullptr || state == nullptr || friction == nullptr) {
        return AMINN_E_NULL;
    }
    const float *const own = sensor == nullptr ? kUnknown : sensor;
    if (!all_finite(own, 3) || !friction_in_range(own)) {
        return AMINN_E_SENSORS;
    }
    __builtin_memmove(friction, own, 3 * sizeof *own);
#if AMINN_N_SLIDE
    const bool exact = friction[0] != 0.0F && friction[2] == 0.0F;
    if (!exact && same_grasp(*calibrator, *state)) {
        combine(calibrator->friction, friction);
    }
#endif
    return AMINN_OK;
}
