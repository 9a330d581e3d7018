// One measured push more: a step of a recursive fit of theta's factors (an extended Kalman filter).
//
// A push is a load w on a known grasp and the displacement that was measured. The tool moves by x = K_x^-1 w, and what changes
// a branch's springs K or the compliance eps of its contact moves it further by
//
//   dx = sum_b c_b P_b^T (deps - B K^-1 dK K^-1 B^T) P_b w,   P_b = M^-1 A_b K_x^-1,   M = B K^-1 B^T + eps I
//
// Rows c^1/2 M^-1/2 A_b of all branches, below them eps_kx, are Q R with K_x = R^T R: their product with K_x^-1 is Q R^-T, which
// needs no stiffness formed, and P w is the force on the contact. What the networks say is held, and how much contacts slide.
// Of the head's correction,
// L = L(nominal) changed entry by entry, the factor T = L L(nominal)^-1 is held: dK = T d(nominal K) T^T. Both are good enough
// for the step's direction, and each step is tried: one that predicts its own push worse than before is not taken.
//
// Six measurements with independent noise in the scaled pose are absorbed one after another. In scaled units, as the statics.
#include "parts.hpp"

namespace aminn {
namespace {

constexpr int kFactors = AMINN_N_FACTOR;
constexpr int kTwists = kTwisted ? kBranch : 0;
constexpr int kContactRows = 3 * kBranch;
constexpr int kRows = kContactRows + kTwists + kMotion;
constexpr int kCovariances = AMINN_N_FACTOR * (AMINN_N_FACTOR + 1) / 2;

constexpr float kDoubtful = 12.0F;      // sum of six normalised squares above which a push counts less
constexpr float kSlipped = 400.0F;      // and above which not at all
constexpr float kLeastVariance = 1e-6F; // of a logarithm, so that rounding leaves a covariance
constexpr float kSameJoint = 0.02F;     // rad: what a joint may turn by from push to push of one grasp
constexpr float kSameTool = 0.002F;     // m, rotations times length_scale: and the tool move by

template <int n, int m>
using Matrix = float[n][m];
using Slopes = Matrix<kMotion, kFactors>;

// a's lower half becomes its Cholesky factor.
template <int n>
void factor(Matrix<n, n> &a)
{
    for (int r = 0; r < n; ++r) {
        for (int c = 0; c <= r; ++c) {
            float sum = a[r][c];
            for (int k = 0; k < c; ++k) {
                sum = subtract_product(sum, a[r][k], a[c][k]);
            }
            a[r][c] = r == c ? root(sum) : sum / a[c][c];
        }
    }
}

// x becomes L^-1 x
template <int n, int m>
void substitute(const Matrix<n, n> &l, Matrix<n, m> &x)
{
    for (int c = 0; c < m; ++c) {
        for (int r = 0; r < n; ++r) {
            float sum = x[r][c];
            for (int k = 0; k < r; ++k) {
                sum = subtract_product(sum, l[r][k], x[k][c]);
            }
            x[r][c] = sum / l[r][r];
        }
    }
}

// x becomes L^-T x
template <int n, int m>
void substitute_back(const Matrix<n, n> &l, Matrix<n, m> &x)
{
    for (int c = 0; c < m; ++c) {
        for (int r = n - 1; r >= 0; --r) {
            float sum = x[r][c];
            for (int k = r + 1; k < n; ++k) {
                sum = subtract_product(sum, l[k][r], x[k][c]);
            }
            x[r][c] = sum / l[r][r];
        }
    }
}

AMINN_FUNCTION float inner(const float *a, const float *b, int n)
{
    float sum = 0.0F;
    for (int i = 0; i < n; ++i) {
        sum = add_product(sum, a[i], b[i]);
    }
    return sum;
}

// What a branch's rows of Q R^-T are multiplied by: its joints' deflections as nominal springs see them, that along the
// tendon, and the root of eps times the force on the contact.
enum Seen { kJoints = 0, kTendon = kCoord, kForce, kSeen = kForce + 3 };
struct Branch {
    Matrix<kSeen, 3> seen;
};

// A branch after a prediction, with its contact sliding or as if it did not; `rows` become c^1/2 M^-1/2 A.
void look_at(const aminn_t &ctx, int b, bool sliding, Branch &branch, Matrix<3, kMotion> &rows)
{
    const aminn_stage_debug_t &stage = ctx.stage[1];
    const aminn_input_t &in = ctx.input;
    const float eps = ctx.varied->eps_m[1][b];
    const float *direction = stage.tendon_dir[b];
    Matrix<kCoord, kCoord> springs;
    Matrix<kCoord, kCoord> held; // by springs and tendon
    __builtin_memcpy(springs, stage.k_spring[b], sizeof springs);
    const float taut = kGated ? stage.tendon_gain[b] * stage.gate[b] : 0.0F;
    for (int r = 0; r < kCoord; ++r) {
        for (int c = 0; c < kCoord; ++c) {
            held[r][c] = kGated ? add_product(springs[r][c], taut * direction[r], direction[c]) : springs[r][c];
        }
    }
    factor<kCoord>(springs);
    factor<kCoord>(held);
    Matrix<kCoord, 3> moved; // K^-1/2 B^T, then K^-1 B^T M^-T/2
    for (int c = 0; c < kCoord; ++c) {
        for (int i = 0; i < 3; ++i) {
            moved[c][i] = -in.j_q[b][i][c];
        }
    }
    substitute<kCoord, 3>(held, moved);
    Matrix<3, 3> soft; // M
    for (int i = 0; i < 3; ++i) {
        for (int k = 0; k <= i; ++k) {
            float sum = i == k ? eps : 0.0F;
            for (const float *row : moved) {
                sum = add_product(sum, row[i], row[k]);
            }
            soft[i][k] = sum;
        }
    }
    if constexpr (kSliding) {
        const float slide = sliding ? stage.slide[b] : 0.0F;
        const float *normal = in.contacts[b] + 4;
        for (int i = 0; i < 3; ++i) {
            for (int k = 0; k <= i; ++k) {
                soft[i][k] = add_product(soft[i][k], slide, (i == k ? 1.0F : 0.0F) - normal[i] * normal[k]);
            }
        }
    }
    factor<3>(soft);
    substitute<3, kMotion>(soft, rows);
    const float share = root(in.contacts[b][0]);
    for (auto &row : rows) {
        for (float &value : row) {
            value = share * value;
        }
    }
    for (float *row : moved) {
        for (int i = 0; i < 3; ++i) {
            float sum = row[i];
            for (int k = 0; k < i; ++k) {
                sum = subtract_product(sum, soft[i][k], row[k]);
            }
            row[i] = sum / soft[i][i];
        }
    }
    substitute_back<kCoord, 3>(held, moved);
    Matrix<3, 3> inverse = {{1.0F}, {0.0F, 1.0F}, {0.0F, 0.0F, 1.0F}}; // M^-1/2
    substitute<3, 3>(soft, inverse);
    Matrix<kCoord, kCoord> nominal = {};
    const float *chol = ctx.varied->chol + AMINN_N_CHOLESKY * b;
    const float *below = chol + kCoord;
    for (int r = 0; r < kCoord; ++r) {
        for (int c = 0; c < r; ++c) {
            nominal[r][c] = *below++;
        }
        nominal[r][r] = chol[r];
    }
    Matrix<kCoord, 3> seen; // T^T K^-1 B^T M^-T/2
    const float root_eps = root(eps);
    for (int i = 0; i < 3; ++i) {
        float along = 0.0F;
        for (int r = 0; r < kCoord; ++r) {
            float sum = 0.0F;
            for (int k = r; k < kCoord; ++k) {
                sum = add_product(sum, springs[k][r], moved[k][i]);
            }
            seen[r][i] = sum;
            if constexpr (kGated) {
                along = add_product(along, direction[r], moved[r][i]);
            }
        }
        branch.seen[kTendon][i] = along;
        for (int k = 0; k < 3; ++k) {
            branch.seen[kForce + k][i] = root_eps * inverse[i][k];
        }
    }
    substitute_back<kCoord, 3>(nominal, seen);
    __builtin_memcpy(branch.seen, seen, sizeof seen);
}

// Rows become Q R^-T, by modified Gram-Schmidt.
void respond(Matrix<kRows, kMotion> &rows)
{
    Matrix<kMotion, kMotion> r;
    for (int j = 0; j < kMotion; ++j) {
        for (int k = j; k < kMotion; ++k) {
            float sum = 0.0F;
            for (const float *row : rows) {
                sum = add_product(sum, row[j], row[k]);
            }
            r[j][k] = k == j ? root(sum) : sum; // of column j once it is scaled
            if (k == j) {
                const float inverse = 1.0F / r[j][j];
                for (float *row : rows) {
                    row[j] = row[j] * inverse;
                }
            } else {
                for (float *row : rows) {
                    row[k] = subtract_product(row[k], sum, row[j]);
                }
            }
        }
    }
    for (float *row : rows) {
        for (int j = kMotion - 1; j >= 0; --j) {
            float sum = row[j];
            for (int k = j + 1; k < kMotion; ++k) {
                sum = subtract_product(sum, r[j][k], row[k]);
            }
            row[j] = sum / r[j][j];
        }
    }
}

// The tool and all branches after a prediction with AMINN_FLAG_DEBUG.
struct Grasp {
    Branch branch[kBranch];
    Matrix<kRows, kMotion> rows; // Q R^-T
    float w[kMotion];
};

[[gnu::noinline]] void look(const aminn_t &ctx, bool sliding, Grasp &grasp)
{
    const aminn_model_t &model = *ctx.model;
    const aminn_input_t &in = ctx.input;
    const float inv_length = 1.0F / model.length_scale;
    const float scale[kMotion] = {1.0F, 1.0F, 1.0F, inv_length, inv_length, inv_length};
    Matrix<kRows, kMotion> &rows = grasp.rows;
    __builtin_memset(rows, 0, sizeof rows);
    const float root_eps_kx = root(model.stage[1].eps_kx);
    for (int i = 0; i < kMotion; ++i) {
        grasp.w[i] = in.w_e[i] * scale[i];
        rows[kRows - kMotion + i][i] = root_eps_kx * scale[i];
    }
    for (int b = 0; b < kBranch; ++b) {
        Matrix<3, kMotion> own;
        for (int k = 0; k < 3; ++k) {
            for (int i = 0; i < kMotion; ++i) {
                own[k][i] = in.j_x[b][k][i] * scale[i];
            }
        }
        look_at(ctx, b, sliding, grasp.branch[b], own);
        __builtin_memcpy(rows[3 * b], own, sizeof own);
        if constexpr (kTwisted) { // run_motion() leaves the contacts' stiffnesses there
            const float *contact = in.contacts[b];
            const float stiff = root(contact[0] * ctx.layer_in[b]) * inv_length;
            for (int i = 0; i < 3; ++i) {
                rows[kContactRows + b][3 + i] = stiff * contact[4 + i];
            }
        }
    }
    respond(rows);
}

// d x / d logarithm of each factor
[[gnu::noinline]] void find_slopes(const aminn_t &ctx, const Grasp &grasp, const float *theta, Slopes &slopes)
{
    const aminn_model_t &model = *ctx.model;
    const Matrix<kRows, kMotion> &rows = grasp.rows;
    const float *w = grasp.w;
    __builtin_memset(slopes, 0, sizeof slopes);
    float factors[AMINN_N_STIFF];
    for (int p = 0; p < AMINN_N_STIFF; ++p) {
        factors[p] = exponential(theta[p]);
    }
    for (int b = 0; b < kBranch; ++b) {
        Matrix<kSeen, kMotion> by_load;
        float now[kSeen];
        for (int k = 0; k < kSeen; ++k) {
            for (int i = 0; i < kMotion; ++i) {
                float sum = 0.0F;
                for (int j = 0; j < 3; ++j) {
                    sum = add_product(sum, grasp.branch[b].seen[k][j], rows[3 * b + j][i]);
                }
                by_load[k][i] = sum;
            }
            now[k] = inner(by_load[k], w, kMotion);
        }
        for (int p = 0; p < AMINN_N_STIFF; ++p) {
            const float *term = model.theta_terms + ((1 + p) * kBranch + b) * AMINN_N_TERM;
            uint32_t any = 0;
            for (int k = 0; k < AMINN_N_TERM; ++k) {
                any |= bits_of(term[k]);
            }
            if (any == 0) {
                continue;
            }
            float torque[kSeen] = {}; // of what the factor adds, by the deflection now
            const float *below = term + kCoord;
            for (int r = 0; r < kCoord; ++r) {
                torque[r] = add_product(torque[r], term[r], now[r]);
                for (int c = 0; c < r; ++c) {
                    torque[r] = add_product(torque[r], *below, now[c]);
                    torque[c] = add_product(torque[c], *below++, now[r]);
                }
            }
            if constexpr (kGated) {
                if (term[AMINN_N_TERM - 1] != 0.0F) {
                    const aminn_stage_debug_t &stage = ctx.stage[1];
                    const float added = stage.gate[b] * stage.tendon_gain[b] / ctx.varied->tendon_gain[b];
                    torque[kTendon] = (term[AMINN_N_TERM - 1] * added) * now[kTendon];
                }
            }
            for (int k = 0; k < kForce; ++k) {
                const float share = factors[p] * torque[k];
                for (int i = 0; i < kMotion; ++i) {
                    slopes[i][p] = subtract_product(slopes[i][p], share, by_load[k][i]);
                }
            }
        }
        for (int i = 0; i < kMotion; ++i) {
            float sum = 0.0F;
            for (int k = kForce; k < kSeen; ++k) {
                sum = add_product(sum, by_load[k][i], now[k]);
            }
            if constexpr (kTwisted) {
                const float *turned = rows[kContactRows + b];
                sum = add_product(sum, inner(turned, w, kMotion), turned[i]);
            }
            slopes[i][AMINN_N_STIFF + b] = sum;
        }
    }
}

// Place of an entry of the packed covariance, row >= column.
constexpr int packed(int row, int column)
{
    return row * (row + 1) / 2 + column;
}

// The covariance before a push: by what is forgotten, nearer to that of the start.
void forget(const aminn_calibrator_settings_t &settings, const float *from, float *to)
{
    const float fresh = (1.0F - settings.memory) * (settings.prior * settings.prior);
    for (int r = 0; r < kFactors; ++r) {
        for (int c = 0; c <= r; ++c) {
            const float kept = settings.memory * from[packed(r, c)];
            to[packed(r, c)] = r == c ? kept + fresh : kept;
        }
    }
}

// What is known after a push, if it is believed.
struct Belief {
    float covariance[kCovariances];
    float change[kFactors]; // of the logarithms
    float variance;         // of each measurement
    float squares;          // sum of the normalised ones: how much the push surprises
};

// A measured push in scaled units, and what is thought of it.
struct Push {
    float measured[kMotion];
    float error[kMotion]; // measured beyond predicted
    Slopes slopes;
    Belief belief;
};

// Least variance of a measurement, as a share of what the covariance expects of it. What is surer leaves a difference of nearly
// equal numbers, whose rounding would be more than what is left: a covariance that is none.
constexpr float kLeastDoubt = 1e-5F;

// Absorbs one measurement after another.
void absorb(const aminn_calibrator_t &c, Push &push)
{
    Belief &belief = push.belief;
    float *change = belief.change;
    forget(c.settings, c.covariance, belief.covariance);
    __builtin_memset(change, 0, sizeof belief.change);
    belief.squares = 0.0F;
    for (int i = 0; i < kMotion; ++i) {
        const float *slope = push.slopes[i];
        float spread[kFactors];
        for (int r = 0; r < kFactors; ++r) {
            float sum = 0.0F;
            for (int k = 0; k < kFactors; ++k) {
                sum = add_product(sum, belief.covariance[r >= k ? packed(r, k) : packed(k, r)], slope[k]);
            }
            spread[r] = sum;
        }
        const float known = inner(slope, spread, kFactors);
        const float signal = known > 0.0F ? known : 0.0F;
        const float least = kLeastDoubt * signal;
        const float inverse = 1.0F / (signal + (belief.variance > least ? belief.variance : least));
        const float surprise = push.error[i] - inner(slope, change, kFactors);
        const float gain = surprise * inverse;
        belief.squares = add_product(belief.squares, surprise, gain);
        for (int r = 0; r < kFactors; ++r) {
            const float share = spread[r] * inverse;
            change[r] = add_product(change[r], gain, spread[r]);
            for (int k = 0; k <= r; ++k) {
                float &entry = belief.covariance[packed(r, k)];
                entry = subtract_product(entry, share, spread[k]);
            }
            float &own = belief.covariance[packed(r, r)];
            own = own > kLeastVariance ? own : kLeastVariance;
        }
    }
}

constexpr float kUnsound = 3e38F;

// Predicts the push in ctx.input; the error's square, or kUnsound.
float try_push(aminn_t &ctx, uint32_t flags, Push &push)
{
    ctx.flags = flags;
    if (!AMINN_ON_BEST_CORE(run_motion(ctx, ctx.input))) {
        return kUnsound;
    }
    for (int i = 0; i < kMotion; ++i) {
        const float dx = ctx.stage[1].dx[i];
        push.error[i] = push.measured[i] - (i < 3 ? dx : dx * ctx.model->length_scale);
    }
    return inner(push.error, push.error, kMotion);
}

// Changes theta within bounds; true where the whole step was taken.
bool step(const aminn_calibrator_settings_t &settings, const float *change, float *theta)
{
    float largest = 0.0F;
    for (int i = 0; i < kFactors; ++i) {
        const float size = __builtin_fabsf(change[i]);
        largest = size > largest ? size : largest;
    }
    const bool whole = largest <= settings.step;
    const float share = whole ? 1.0F : settings.step / largest;
    for (int i = 0; i < kFactors; ++i) {
        float moved = add_product(theta[i], share, change[i]);
        moved = moved < settings.bound ? moved : settings.bound;
        theta[i] = moved > -settings.bound ? moved : -settings.bound;
    }
    return whole;
}

// Sets the calibration's theta; false where its springs do not hold.
bool take(aminn_calibrator_t &c, const float *theta)
{
    return aminn_calibration_set(&c.calibration, c.calibration.model, theta) == AMINN_OK;
}

// Of each measurement of the n-th push of a grasp: a model errs alike on all of them, so each further one counts less. The
// share is that of the smaller motion: a tool that slips far is no reason to expect it.
float variance_of(const aminn_calibrator_settings_t &settings, uint32_t n, const Push &push)
{
    float predicted[kMotion];
    for (int i = 0; i < kMotion; ++i) {
        predicted[i] = push.measured[i] - push.error[i];
    }
    const float moved = inner(push.measured, push.measured, kMotion);
    const float expected = inner(predicted, predicted, kMotion);
    const float share = settings.model_share * settings.model_share;
    return static_cast<float>(n) *
           (settings.noise_m * settings.noise_m + share * (moved < expected ? moved : expected));
}

#if AMINN_N_SLIDE
// What a push says of friction, from the grasp as if no contact slid.
PushedFriction judge(const aminn_t &ctx, const Grasp &grasp, const float *measured)
{
    const aminn_model_t &model = *ctx.model;
    float motion[kMotion] = {};
    float strain[kRows];
    for (int r = 0; r < kRows; ++r) {
        strain[r] = inner(grasp.rows[r], grasp.w, kMotion);
        for (int i = 0; i < kMotion; ++i) {
            motion[i] = add_product(motion[i], strain[r], grasp.rows[r][i]);
        }
    }
    PushedFriction trial = {0.0F, 0.0F, 0.0F};
    for (int b = 0; b < kBranch; ++b) {
        const float *contact = ctx.input.contacts[b];
        const float *normal = contact + 4;
        const float share = root(contact[0]) / root(ctx.varied->eps_m[1][b]);
        float force[3];
        for (int i = 0; i < 3; ++i) {
            force[i] = share * inner(grasp.branch[b].seen[kForce + i], strain + 3 * b, 3);
        }
        const float along = inner(force, normal, 3);
        float square = 0.0F;
        for (int i = 0; i < 3; ++i) {
            const float across = ctx.stage[1].preload[b][i] - subtract_product(force[i], along, normal[i]);
            square = add_product(square, across, across);
        }
        const float left = contact[7] - along;
        const float asked = contact[0] * root(square) / (left > kLeastPressing ? left : kLeastPressing);
        trial.asked = asked > trial.asked ? asked : trial.asked;
    }
    const float length = root(inner(motion, motion, 3)) / model.max_translation;
    const float angle = root(inner(motion + 3, motion + 3, 3)) / (model.max_rotation * model.length_scale);
    const float largest = length > angle ? length : angle;
    const float kept = largest > 1.0F ? 1.0F / largest : 1.0F;
    for (int i = 0; i < kMotion; ++i) {
        const float cut = kept * motion[i];
        const float further = measured[i] - cut;
        trial.off = add_product(trial.off, further, further);
        trial.size = add_product(trial.size, cut, cut);
    }
    return trial;
}

bool any_slides(const aminn_t &ctx)
{
    bool any = false;
    for (const float slide : ctx.stage[1].slide) {
        any |= slide > 0.0F;
    }
    return any;
}
#endif

// The push in ctx.input, the n-th of its grasp, with the calibrator's tables in use.
aminn_status_t learn(aminn_t &ctx, aminn_calibrator_t &c, uint32_t n, Push &push)
{
    const float before = try_push(ctx, AMINN_FLAG_DEBUG, push);
    push.belief.variance = variance_of(c.settings, n, push);
    Grasp grasp;
    look(ctx, true, grasp);
    find_slopes(ctx, grasp, c.calibration.theta, push.slopes);
#if AMINN_N_SLIDE
    PushedFriction friction{};
    if (ctx.sensors != nullptr) {
        if (any_slides(ctx)) {
            look(ctx, false, grasp);
        }
        friction = judge(ctx, grasp, push.measured);
    }
#endif
    absorb(c, push);
    const float squares = push.belief.squares;
    if (squares > kDoubtful) {
        push.belief.variance = push.belief.variance * (squares * (1.0F / kDoubtful));
        absorb(c, push);
    }
    if (before == kUnsound ||
        !all_finite(reinterpret_cast<const float *>(&push.belief), sizeof push.belief / sizeof(float))) {
        return AMINN_E_NUMERIC;
    }
#if AMINN_N_SLIDE
    if (n == 1) {
        forget_friction(c);
    }
    if (ctx.sensors != nullptr) {
        narrow_friction(c, friction, ctx.sensors->tool_weight[0] != 0.0F);
    }
#endif
    if (squares > kSlipped) {
        c.outcome = AMINN_PUSH_SLIPPED;
        return AMINN_OK;
    }
    float kept[AMINN_N_THETA];
    float theta[AMINN_N_THETA];
    __builtin_memcpy(kept, c.calibration.theta, sizeof kept);
    __builtin_memcpy(theta, kept, sizeof theta);
    const bool whole = step(c.settings, push.belief.change, theta);
    if (!(take(c, theta) && try_push(ctx, 0, push) <= before)) {
        take(c, kept);
        c.outcome = AMINN_PUSH_WORSE;
        return AMINN_OK;
    }
    if (whole) { // else the next push may go on
        __builtin_memcpy(c.covariance, push.belief.covariance, sizeof c.covariance);
    }
    c.outcome = squares > kDoubtful ? AMINN_PUSH_DOUBTED : AMINN_PUSH_LEARNED;
    return AMINN_OK;
}

bool between(float x, float least, float most)
{
    return x >= least && x <= most;
}

bool settings_ok(const aminn_calibrator_settings_t &s)
{
    constexpr float kLeast = 1e-9F;
    return between(s.prior, kLeast, 1.0F) && between(s.noise_m, kLeast, 1.0F) && between(s.model_share, 0.0F, 1.0F) &&
           between(s.step, kLeast, AMINN_MAX_LOG_FACTOR) && between(s.bound, kLeast, AMINN_MAX_LOG_FACTOR) &&
           between(s.memory, kLeast, 1.0F);
}

// Else the first push would have to step further than the settings allow. What is no number is left to the calibration.
bool begins_within(float bound, const float *theta)
{
    bool within = true;
    for (int i = 0; theta != nullptr && i < kFactors; ++i) {
        within &= !(__builtin_fabsf(theta[i]) > bound);
    }
    return within;
}

} // namespace

bool same_grasp(const aminn_calibrator_t &c, const aminn_state_t &state)
{
    bool same = c.in_grasp != 0;
    for (int i = 0; i < AMINN_N_JOINT; ++i) {
        same &= __builtin_fabsf(state.q[i] - c.grasp[i]) <= kSameJoint;
    }
    const float length = c.calibration.model->length_scale;
    for (int i = 0; i < kMotion; ++i) {
        const float moved = state.x_ht[i] - c.grasp[AMINN_N_JOINT + i];
        same &= __builtin_fabsf(i < 3 ? moved : moved * length) <= kSameTool;
    }
    return same;
}
} // namespace aminn

using namespace aminn;

const aminn_calibrator_settings_t aminn_calibrator_defaults = {0.5F, 5e-5F, 0.08F, 0.5F, 1.5F, 1.0F};

aminn_status_t aminn_calibrator_init(aminn_calibrator_t *calibrator, const aminn_model_t *model,
                                     const float theta[AMINN_N_THETA], const aminn_calibrator_settings_t *settings)
{
    if (calibrator == nullptr || model == nullptr) {
        return AMINN_E_NULL;
    }
    const aminn_calibrator_settings_t chosen = settings == nullptr ? aminn_calibrator_defaults : *settings;
    if (!settings_ok(chosen) || !begins_within(chosen.bound, theta)) {
        return AMINN_E_CALIBRATION;
    }
    const aminn_status_t status = aminn_calibration_set(&calibrator->calibration, model, theta);
    if (status != AMINN_OK) {
        return status;
    }
    calibrator->settings = chosen;
    calibrator->pushes = 0;
    calibrator->in_grasp = 0;
    calibrator->outcome = AMINN_PUSH_NONE;
    __builtin_memset(calibrator->grasp, 0, sizeof calibrator->grasp);
#if AMINN_N_SLIDE
    forget_friction(*calibrator);
#endif
    __builtin_memset(calibrator->covariance, 0, sizeof calibrator->covariance);
    for (int i = 0; i < kFactors; ++i) {
        calibrator->covariance[packed(i, i)] = chosen.prior * chosen.prior;
    }
    return AMINN_OK;
}

aminn_status_t aminn_calibrate_push(aminn_t *ctx, aminn_calibrator_t *calibrator, const aminn_state_t *before,
                                    const float dx_ht[AMINN_N_WRENCH])
{
    if (calibrator == nullptr || before == nullptr || dx_ht == nullptr) {
        return AMINN_E_NULL;
    }
    aminn_status_t status = context_status(ctx);
    if (status != AMINN_OK) {
        return status;
    }
    const aminn_calibration_t &calibration = calibrator->calibration;
    ctx->stages_done = 0;
    if (calibration.model != ctx->model || calibration.varied.told != calibration.theta) {
        return AMINN_E_CALIBRATION;
    }
    status = check_input(reinterpret_cast<const float *>(before), AMINN_N_STATE);
    if (status == AMINN_OK && !all_finite(dx_ht, AMINN_N_WRENCH)) {
        status = AMINN_E_NONFINITE;
    }
    if (status != AMINN_OK) {
        return status;
    }
    aminn_input_t &in = ctx->input;
    __builtin_memcpy(&in, before, sizeof *before);
    aminn_correct(&calibration, reinterpret_cast<aminn_state_t *>(&in));
    if (!closure(*ctx->model, in.q, in.x_ht, in.contacts, in.j_x, in.j_q)) {
        return AMINN_E_NUMERIC;
    }
    status = take_sensors(*ctx, in);
    if (status != AMINN_OK) {
        return status;
    }
    Push push;
    for (int i = 0; i < kMotion; ++i) {
        push.measured[i] = i < 3 ? dx_ht[i] : dx_ht[i] * ctx->model->length_scale;
    }
    const bool same = same_grasp(*calibrator, *before);
    const uint32_t in_grasp = same ? calibrator->in_grasp + 1 : 1;
    const aminn_varied_t *const varied = ctx->varied;
    const uint32_t flags = ctx->flags;
    ctx->varied = &calibration.varied;
    status = learn(*ctx, *calibrator, in_grasp, push);
    ctx->varied = varied;
    ctx->flags = flags;
    ctx->stages_done = 0;
    if (status == AMINN_OK) {
        calibrator->pushes = calibrator->pushes + 1;
        calibrator->in_grasp = in_grasp;
        if (!same) {
            __builtin_memcpy(calibrator->grasp, before, sizeof calibrator->grasp); // begins with q and x_ht
        }
    }
    return status;
}

float aminn_calibrator_sd(const aminn_calibrator_t *calibrator, int i)
{
    return calibrator == nullptr || i < 0 || i >= kFactors ? 0.0F : root(calibrator->covariance[packed(i, i)]);
}
