// A calibration: what follows from theta for a model's tables, and its use.
#include "parts.hpp"

namespace aminn {
namespace {

constexpr int kZeros = AMINN_N_FACTOR; // where the joints' zeros stand in theta
constexpr int kRadius = AMINN_N_THETA - 1;

// Place of an entry of a packed triangle, row >= column.
constexpr int entry_at(int row, int column)
{
    return row == column ? row : kCoord + row * (row - 1) / 2 + column;
}

aminn_status_t check_theta(const float *theta)
{
    if (!all_finite(theta, AMINN_N_THETA)) {
        return AMINN_E_NONFINITE;
    }
    bool inside = true;
    for (int i = 0; i < AMINN_N_THETA; ++i) {
        const float bound = i < kZeros ? AMINN_MAX_LOG_FACTOR : i < kRadius ? AMINN_MAX_ZERO : AMINN_MAX_RADIUS;
        inside &= __builtin_fabsf(theta[i]) <= bound;
    }
    return inside ? AMINN_OK : AMINN_E_CALIBRATION;
}

using Square = float[kCoord][kCoord];

// a = (L^-1 a)^T
void substitute(const float *l, Square &a)
{
    Square x;
    for (int c = 0; c < kCoord; ++c) {
        for (int r = 0; r < kCoord; ++r) {
            float sum = a[r][c];
            for (int k = 0; k < r; ++k) {
                sum = subtract_product(sum, l[entry_at(r, k)], x[c][k]);
            }
            x[c][r] = sum / l[r];
        }
    }
    __builtin_memcpy(a, x, sizeof a);
}

// The lower half of a, which becomes its Cholesky factor; false if a is not positive definite.
bool factor(Square &a)
{
    for (int r = 0; r < kCoord; ++r) {
        for (int c = 0; c <= r; ++c) {
            float sum = a[r][c];
            for (int k = 0; k < c; ++k) {
                sum = subtract_product(sum, a[r][k], a[c][k]);
            }
            if (r == c && !(sum > 0.0F)) {
                return false;
            }
            a[r][c] = r == c ? root(sum) : sum / a[c][c];
        }
    }
    return true;
}

// K's Cholesky factor from the nominal one L and what theta adds, D: of K = L (I + L^-1 D L^-T) L^T. What does not change,
// as stiff couplings, cancels nowhere, and where nothing is added L comes out bit by bit. `chol` is D packed at first.
bool add_to_springs(const float *nominal, float *chol)
{
    Square a;
    for (int r = 0; r < kCoord; ++r) {
        for (int c = 0; c <= r; ++c) {
            a[r][c] = a[c][r] = chol[entry_at(r, c)];
        }
    }
    substitute(nominal, a);
    substitute(nominal, a);
    for (int r = 0; r < kCoord; ++r) {
        a[r][r] = a[r][r] + 1.0F;
    }
    const bool held = factor(a);
    for (int r = 0; r < kCoord; ++r) {
        for (int c = 0; c <= r; ++c) {
            float sum = nominal[entry_at(r, c)] * a[c][c];
            for (int k = c + 1; k <= r; ++k) {
                sum = add_product(sum, nominal[entry_at(r, k)], a[k][c]);
            }
            chol[entry_at(r, c)] = sum;
        }
    }
    return held;
}

// Springs and gated tendons; false if they do not hold.
bool set_stiffness(const aminn_model_t &model, aminn_calibration_t &cal)
{
    if constexpr (kGated) {
        __builtin_memcpy(cal.tendon_gain, model.nominal.tendon_gain, sizeof cal.tendon_gain);
    }
    const float *term = model.theta_terms + AMINN_N_BRANCH * AMINN_N_TERM;
    for (int p = 0; p < AMINN_N_STIFF; ++p) {
        const float added = exponential(cal.theta[p]) - 1.0F;
        for (int b = 0; b < kBranch; ++b) {
            for (float &sum : cal.chol[b]) {
                sum = add_product(sum, added, *term++);
            }
            cal.tendon_gain[b] = add_product(cal.tendon_gain[b], added, *term++);
        }
    }
    bool held = true;
    for (int b = 0; b < kBranch; ++b) {
        held &= add_to_springs(model.nominal.chol + AMINN_N_CHOLESKY * b, cal.chol[b]) & (cal.tendon_gain[b] >= 0.0F);
    }
    return held;
}

void set_contacts(const aminn_model_t &model, aminn_calibration_t &cal)
{
    for (int b = 0; b < kBranch; ++b) {
        const float softer = exponential(cal.theta[AMINN_N_STIFF + b]);
        for (int i = 0; i < AMINN_N_STAGE; ++i) {
            cal.eps_m[i][b] = model.nominal.eps_m[i][b] * softer;
        }
        if constexpr (kTwisted) {
            cal.twist[b] = model.nominal.twist[b] / softer;
        }
    }
}

} // namespace
} // namespace aminn

using namespace aminn;

aminn_status_t aminn_calibration_set(aminn_calibration_t *cal, const aminn_model_t *model,
                                     const float theta[AMINN_N_THETA])
{
    if (cal == nullptr || model == nullptr) {
        return AMINN_E_NULL;
    }
    aminn_calibration_t next{};
    if (theta != nullptr) {
        const aminn_status_t status = check_theta(theta);
        if (status != AMINN_OK) {
            return status;
        }
        __builtin_memcpy(next.theta, theta, sizeof next.theta);
    }
    next.model = model;
    next.varied = {cal->chol[0], cal->tendon_gain, cal->twist, cal->theta, {cal->eps_m[0], cal->eps_m[1]}};
    if (!set_stiffness(*model, next)) {
        return AMINN_E_MODEL;
    }
    set_contacts(*model, next);
    *cal = next;
    return AMINN_OK;
}

aminn_status_t aminn_calibrate(aminn_t *ctx, const aminn_calibration_t *cal)
{
    const aminn_status_t status = context_status(ctx);
    if (status != AMINN_OK) {
        return status;
    }
    if (cal == nullptr) {
        ctx->varied = &ctx->model->nominal;
        ctx->correct = nullptr;
        return AMINN_OK;
    }
    if (cal->model != ctx->model || cal->varied.told != cal->theta) {
        return AMINN_E_CALIBRATION;
    }
    ctx->varied = &cal->varied;
    ctx->correct = aminn_correct;
    return AMINN_OK;
}

aminn_status_t aminn_correct(const aminn_calibration_t *cal, aminn_state_t *state)
{
    if (cal == nullptr || state == nullptr) {
        return AMINN_E_NULL;
    }
    for (int i = 0; i < AMINN_N_JOINT; ++i) {
        state->q[i] = state->q[i] + cal->theta[kZeros + i];
    }
    for (auto &contact : state->contacts) {
        for (int i = 0; i < 3; ++i) {
            contact[1 + i] = add_product(contact[1 + i], cal->theta[kRadius], contact[4 + i]);
        }
    }
    return AMINN_OK;
}
