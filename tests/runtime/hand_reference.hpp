/* What the numerical core computes, in float64 and as docs/mechanics.md writes it, for the hand that this is compiled for. */
#ifndef HAND_REFERENCE_HPP
#define HAND_REFERENCE_HPP

#include <cmath>
#include <cstring>

#include "hand_case.hpp"

namespace hand_reference {

using namespace hand_case;
constexpr int W = AMINN_N_WRENCH;

using Vector6 = double[W];
using Matrix6 = double[W][W];

struct Stage {
    double k_spring[B][C][C], direction[B][C], gain[B], gate_params[B][3], gate[B], twist[B];
    double dx0[W], dx[W], dq0[B][C], k_x[W][W];
    /* of contacts that can slide; the motion before it is cut, the stiffness before anything slides */
    double friction[B], preload[B][3], slide[B], use[B], share[B], pressing[B], dx_uncut[W], k_held[W][W];
    double give[B], k_engaged[B][C][C];
};

/* What sensors tell of the contacts: coefficient of friction, tangential forces before the load; and what networks see. */
struct Told {
    double friction, preload[B][3], sensed[AMINN_N_SENSED];
};

struct Reference {
    double p_stable, p_slide, bound_95;
    Stage stage[AMINN_N_STAGE];
};

/* x of a x = y, n x n, by elimination with pivots */
template <int N>
inline void solve(const double (&a)[N][N], const double (&y)[N], double (&x)[N])
{
    double m[N][N + 1];
    for (int i = 0; i < N; ++i) {
        std::memcpy(m[i], a[i], sizeof a[i]);
        m[i][N] = y[i];
    }
    for (int j = 0; j < N; ++j) {
        int best = j;
        for (int i = j; i < N; ++i) {
            best = std::fabs(m[i][j]) > std::fabs(m[best][j]) ? i : best;
        }
        for (int k = 0; k <= N; ++k) {
            const double swap = m[j][k];
            m[j][k] = m[best][k];
            m[best][k] = swap;
        }
        for (int i = j + 1; i < N; ++i) {
            const double factor = m[i][j] / m[j][j];
            for (int k = j; k <= N; ++k) {
                m[i][k] -= factor * m[j][k];
            }
        }
    }
    for (int i = N - 1; i >= 0; --i) {
        x[i] = m[i][N];
        for (int k = i + 1; k < N; ++k) {
            x[i] -= m[i][k] * x[k];
        }
        x[i] /= m[i][i];
    }
}

inline void dense(const void *weights, const float *b, const double *x, int n_in, int n_out, bool rectify, double *y)
{
    const auto *w = static_cast<const float *>(weights);
    for (int o = 0; o < n_out; ++o) {
        double sum = static_cast<double>(b[o]);
        for (int i = 0; i < n_in; ++i) {
            sum += static_cast<double>(w[i * n_out + o]) * x[i];
        }
        y[o] = rectify && sum < 0.0 ? 0.0 : sum;
    }
}

inline double normal(double x, const float *mean, const float *inv_std, int i)
{
    return (x - static_cast<double>(mean[i])) * static_cast<double>(inv_std[i]);
}

/* B K^-1 B^T + eps I of a branch, and K^-1 B^T */
inline void contact_compliance(const double (&k)[C][C], const float (&j_q)[3][C], double eps, double (&m)[3][3],
                               double (&k_inv_bt)[C][3])
{
    for (int i = 0; i < 3; ++i) {
        double column[C], x[C];
        for (int c = 0; c < C; ++c) {
            column[c] = -static_cast<double>(j_q[i][c]);
        }
        solve<C>(k, column, x);
        for (int c = 0; c < C; ++c) {
            k_inv_bt[c][i] = x[c];
        }
    }
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            m[i][j] = i == j ? eps : 0.0;
            for (int c = 0; c < C; ++c) {
                m[i][j] -= static_cast<double>(j_q[i][c]) * k_inv_bt[c][j];
            }
        }
    }
}

/* The same of a contact that gives along its tangents; c s, whose force the flag c then weighs. */
inline void give_of(const aminn_model_t &model, int which, const aminn_input_t &in, int b, const double (&k)[C][C],
                    double slide, double (&m)[3][3], double (&k_inv_bt)[C][3])
{
    const double flag = static_cast<double>(in.contacts[b][0]);
    contact_compliance(k, in.j_q[b], static_cast<double>(model.nominal.eps_m[which][b]), m, k_inv_bt);
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            const double square =
                static_cast<double>(in.contacts[b][4 + i]) * static_cast<double>(in.contacts[b][4 + j]);
            m[i][j] += flag * slide * ((i == j ? 1.0 : 0.0) - square);
        }
    }
}

/* K_x in SI, and the load's displacement; contacts give along their tangents by `slide` */
inline void statics(const aminn_model_t &model, int which, const aminn_input_t &in, const double (&k)[B][C][C],
                    const double (&twist)[B], const double (&slide)[B], Matrix6 &k_x, Vector6 &dx)
{
    for (int i = 0; i < W; ++i) {
        for (int j = 0; j < W; ++j) {
            k_x[i][j] = i == j ? static_cast<double>(model.stage[which].eps_kx) : 0.0;
        }
    }
    for (int b = 0; b < B; ++b) {
        double m[3][3], unused[C][3];
        give_of(model, which, in, b, k[b], slide[b], m, unused);
        for (int j = 0; j < W; ++j) {
            double column[3], x[3];
            for (int r = 0; r < 3; ++r) {
                column[r] = static_cast<double>(in.j_x[b][r][j]);
            }
            solve<3>(m, column, x);
            for (int i = 0; i < W; ++i) {
                for (int r = 0; r < 3; ++r) {
                    k_x[i][j] += static_cast<double>(in.contacts[b][0]) * static_cast<double>(in.j_x[b][r][i]) * x[r];
                }
            }
        }
    }
    for (int b = 0; b < B; ++b) { // about the normals
        const float *contact = in.contacts[b];
        for (int i = 0; i < 3; ++i) {
            for (int j = 0; j < 3; ++j) {
                const double square = static_cast<double>(contact[4 + i]) * static_cast<double>(contact[4 + j]);
                k_x[3 + i][3 + j] += static_cast<double>(contact[0]) * twist[b] * square;
            }
        }
    }
    double load[W];
    for (int i = 0; i < W; ++i) {
        load[i] = static_cast<double>(in.w_e[i]);
    }
    solve<W>(k_x, load, dx);
}

/* dq0 of a branch: K^-1 B^T f, f = c M^-1 A dx0; or the paper's -(J_q + eps I)^-1 J_x dx0 */
inline void deflection(const aminn_model_t &model, int which, const aminn_input_t &in, int b, const double (&k)[C][C],
                       const Vector6 &dx0, double (&dq0)[C])
{
    double m[3][3], k_inv_bt[C][3], motion[3], force[3];
    contact_compliance(k, in.j_q[b], static_cast<double>(model.nominal.eps_m[which][b]), m, k_inv_bt);
    const double contact = static_cast<double>(in.contacts[b][0]);
    for (int r = 0; r < 3; ++r) {
        motion[r] = 0.0;
        for (int j = 0; j < W; ++j) {
            motion[r] += static_cast<double>(in.j_x[b][r][j]) * dx0[j];
        }
    }
    solve<3>(m, motion, force);
    for (int c = 0; c < C; ++c) {
        dq0[c] = 0.0;
        for (int r = 0; r < 3; ++r) {
            dq0[c] += contact * k_inv_bt[c][r] * force[r];
        }
    }
    if constexpr (C == 3) {
        if (model.dq0 == AMINN_DQ0_INVERSE) {
            double a[3][3], x[3];
            for (int r = 0; r < 3; ++r) {
                for (int c = 0; c < C; ++c) {
                    a[r][c] = static_cast<double>(in.j_q[b][r][c]) +
                              (r == c ? static_cast<double>(model.stage[which].eps_jq) : 0.0);
                }
            }
            solve<3>(a, motion, x);
            for (int c = 0; c < C; ++c) {
                dq0[c] = -contact * static_cast<double>(model.coord_mask[C * b + c]) * x[c];
            }
        }
    }
}

/* springs, tendons and gates from the head's numbers, which stand in rows of B */
inline void head_to_springs(const aminn_model_t &model, const aminn_input_t &in, const Told &told, const double *head,
                            Stage &stage)
{
    const double range = static_cast<double>(model.log_range);
    for (int b = 0; b < B; ++b) {
        const auto raw = [&](int row) { return head[row * B + b]; };
        const float *chol = model.nominal.chol + kPacked * b, *mask = model.coord_mask + C * b;
        double l[C][C] = {};
        for (int r = 0; r < C; ++r) {
            const double nominal = static_cast<double>(chol[r]);
            l[r][r] = mask[r] != 0.0F ? nominal * std::exp(range * std::tanh(raw(r))) : nominal;
            for (int c = 0; c < r; ++c) {
                const int i = r * (r - 1) / 2 + c;
                const double size = std::sqrt(nominal * static_cast<double>(chol[c]));
                l[r][c] = static_cast<double>(mask[r] * mask[c]) *
                          (static_cast<double>(chol[C + i]) + size * std::tanh(raw(kOffRow + i)));
            }
        }
        for (int r = 0; r < C; ++r) {
            for (int c = 0; c < C; ++c) {
                stage.k_spring[b][r][c] = 0.0;
                for (int k = 0; k < C; ++k) {
                    stage.k_spring[b][r][c] += l[r][k] * l[c][k];
                }
            }
        }
        stage.twist[b] =
            kSoft ? static_cast<double>(model.nominal.twist[b]) * std::exp(2.0 * range * std::tanh(raw(kTwistRow)))
                  : 0.0;
        if (kSlides) {
            const double flag = static_cast<double>(in.contacts[b][0]);
            const float *normal = in.contacts[b] + 4;
            double along = 0.0;
            for (int i = 0; i < 3; ++i) {
                along += static_cast<double>(normal[i]) * (told.preload[b][i] + raw(kPreloadRow + i));
            }
            for (int i = 0; i < 3; ++i) {
                const double across =
                    told.preload[b][i] + raw(kPreloadRow + i) - along * static_cast<double>(normal[i]);
                stage.preload[b][i] = flag * across;
            }
            stage.friction[b] = told.friction * std::exp(std::tanh(raw(kFrictionRow)));
        }
        if (G == 0) {
            continue;
        }
        double square = 1e-12;
        for (int c = 0; c < C; ++c) {
            stage.direction[b][c] =
                has_tendon(b) ? static_cast<double>(mask[c]) *
                                    (static_cast<double>(model.tendon_dir_nom[C * b + c]) + raw(kDirectionRow + c))
                              : 0.0;
            square += stage.direction[b][c] * stage.direction[b][c];
        }
        for (double &d : stage.direction[b]) {
            d /= std::sqrt(square);
        }
        stage.gain[b] = static_cast<double>(model.nominal.tendon_gain[b]) * std::exp(range * std::tanh(raw(kGainRow)));
        stage.gate_params[b][0] = static_cast<double>(model.gate_nom[0]) * std::exp(range * std::tanh(raw(kAlphaRow)));
        stage.gate_params[b][1] = static_cast<double>(model.gate_nom[1]) * raw(kBetaRow);
        stage.gate_params[b][2] = static_cast<double>(model.gate_nom[2]) + raw(kRhoRow);
    }
}

/* Two unit vectors across a normal, and this; of one of length 0 any. */
inline void tangents(const float *normal, double (&t)[3][3])
{
    int least = 0;
    double square = 0.0;
    for (int i = 0; i < 3; ++i) {
        t[2][i] = static_cast<double>(normal[i]);
        square += t[2][i] * t[2][i];
        least = std::fabs(t[2][i]) < std::fabs(t[2][least]) ? i : least;
    }
    const double size = square > 0.0 ? std::sqrt(square) : 1.0;
    double across = 0.0;
    for (int i = 0; i < 3; ++i) {
        t[0][i] = (i == least ? 1.0 : 0.0) - t[2][i] * t[2][least] / (size * size);
        across += t[0][i] * t[0][i];
    }
    for (double &number : t[0]) {
        number /= std::sqrt(across);
    }
    for (int i = 0; i < 3; ++i) {
        t[1][i] = (t[2][(i + 1) % 3] * t[0][(i + 2) % 3] - t[2][(i + 2) % 3] * t[0][(i + 1) % 3]) / size;
    }
}

/* The forces on the fingertips, along two tangents and the normal of each, that a motion of the tool causes. */
inline void forces_of(const aminn_model_t &model, int which, const aminn_input_t &in, const double (&k)[B][C][C],
                      const double (&slide)[B], const Vector6 &dx, double (&force)[B][3])
{
    for (int b = 0; b < B; ++b) {
        double m[3][3], unused[C][3], t[3][3], motion[3] = {}, f[3];
        give_of(model, which, in, b, k[b], slide[b], m, unused);
        for (int r = 0; r < 3; ++r) {
            for (int j = 0; j < W; ++j) {
                motion[r] += static_cast<double>(in.j_x[b][r][j]) * dx[j];
            }
        }
        solve<3>(m, motion, f);
        tangents(in.contacts[b] + 4, t);
        for (int d = 0; d < 3; ++d) {
            force[b][d] = 0.0;
            for (int r = 0; r < 3; ++r) {
                force[b][d] += static_cast<double>(in.contacts[b][0]) * t[d][r] * f[r];
            }
        }
    }
}

/* What the finger itself gives along its tangents, without its tendon. */
inline double give_of_finger(const aminn_model_t &model, int which, const aminn_input_t &in, const double (&k)[C][C],
                             int b)
{
    double m[3][3], unused[C][3], t[3][3], sum = 0.0;
    give_of(model, which, in, b, k, 0.0, m, unused);
    tangents(in.contacts[b] + 4, t);
    for (int d = 0; d < 2; ++d) {
        for (int i = 0; i < 3; ++i) {
            for (int j = 0; j < 3; ++j) {
                sum += 0.5 * t[d][i] * m[i][j] * t[d][j];
            }
        }
    }
    return sum;
}

inline void cut(const aminn_model_t &model, Vector6 &dx)
{
    double size[2] = {};
    for (int i = 0; i < W; ++i) {
        size[i / 3] += dx[i] * dx[i];
    }
    const double share = std::fmin(1.0, std::fmin(static_cast<double>(model.max_translation) / std::sqrt(size[0]),
                                                  static_cast<double>(model.max_rotation) / std::sqrt(size[1])));
    for (double &number : dx) {
        number *= share;
    }
}

/* Secant friction, each step solved anew. */
inline void slide_contacts(const aminn_model_t &model, int which, const aminn_input_t &in, const double (&k)[B][C][C],
                           Stage &stage)
{
    double *give = stage.give, force[B][3];
    std::memcpy(stage.k_engaged, k, sizeof k);
    for (int b = 0; b < B; ++b) {
        stage.slide[b] = 0.0;
        give[b] = give_of_finger(model, which, in, stage.k_spring[b], b);
    }
    for (int step = 0; step < 3; ++step) {
        forces_of(model, which, in, k, stage.slide, stage.dx, force);
        for (int b = 0; b < B; ++b) {
            double t[3][3], along = 0.0, square = 0.0, before = 0.0, borne = 0.0;
            tangents(in.contacts[b] + 4, t);
            for (int d = 0; d < 2; ++d) {
                double preload = 0.0;
                for (int i = 0; i < 3; ++i) {
                    preload += t[d][i] * stage.preload[b][i];
                }
                along += preload * force[b][d];
                square += force[b][d] * force[b][d];
                before += preload * preload;
                borne += (preload - force[b][d]) * (preload - force[b][d]);
            }
            const double flag = static_cast<double>(in.contacts[b][0]);
            const double pressing =
                std::fmax((flag > 0.0 ? static_cast<double>(in.contacts[b][7]) : 0.0) - force[b][2], 0.01);
            const double limit = std::pow(stage.friction[b] * pressing, 2);
            const double reserve = std::fmax(limit - before, 0.01 * limit);
            const double over = (std::sqrt(along * along + square * reserve) - along) / reserve;
            if (step == 0) {
                stage.use[b] = std::fmin(flag * std::sqrt((borne + 1e-12) / limit), 100.0);
                stage.pressing[b] = pressing;
            }
            const double more = (give[b] + stage.slide[b]) * over - give[b];
            stage.slide[b] = std::fmin(std::fmax(more, 0.0), 5e-3);
            stage.share[b] = stage.slide[b] / give[b];
        }
        statics(model, which, in, k, stage.twist, stage.slide, stage.k_x, stage.dx);
    }
    std::memcpy(stage.dx_uncut, stage.dx, sizeof stage.dx);
    cut(model, stage.dx);
}

inline void two_pass(const aminn_model_t &model, int which, const aminn_input_t &in, Stage &stage)
{
    const double none[B] = {};
    statics(model, which, in, stage.k_spring, stage.twist, none, stage.k_x, stage.dx0);
    double k[B][C][C];
    std::memcpy(k, stage.k_spring, sizeof k);
    for (int b = 0; b < B; ++b) {
        deflection(model, which, in, b, stage.k_spring[b], stage.dx0, stage.dq0[b]);
        if (!has_tendon(b)) {
            continue;
        }
        double eta = 0.0;
        for (int c = 0; c < C; ++c) {
            eta += stage.dq0[b][c] * stage.direction[b][c];
        }
        const double *gate = stage.gate_params[b];
        stage.gate[b] = 1.0 / (1.0 + std::exp(-(gate[0] * (eta - gate[1]) + gate[2])));
        for (int r = 0; r < C; ++r) {
            for (int c = 0; c < C; ++c) {
                k[b][r][c] += stage.gain[b] * stage.gate[b] * stage.direction[b][r] * stage.direction[b][c];
            }
        }
    }
    statics(model, which, in, k, stage.twist, none, stage.k_x, stage.dx);
    std::memcpy(stage.k_held, stage.k_x, sizeof stage.k_x);
    std::memcpy(stage.dx_uncut, stage.dx, sizeof stage.dx);
    if (kSlides) {
        slide_contacts(model, which, in, k, stage);
    }
}

inline double log_by_size(double w, double scale)
{
    return std::copysign(std::log1p(std::fabs(w) / scale), w);
}

inline void run_stage(const aminn_model_t &model, int i, const aminn_input_t &in, const Told &told, Stage &stage,
                      double *feature)
{
    const aminn_stage_model_t &s = model.stage[i];
    const int h = kWidths[i];
    double contact[AMINN_N_CONTACT_INPUT], trunk[kTrunkInput], hidden[kWidth], head[AMINN_N_HEAD_STORED];
    for (int b = 0; b < B; ++b) {
        for (int k = 0; k < AMINN_N_BRANCH_FEATURE; ++k) {
            const float number =
                k < AMINN_N_CONTACT_FEATURE ? in.contacts[b][k] : (&in.j_q[b][0][0])[k - AMINN_N_CONTACT_FEATURE];
            const double flag = k == 0 ? 1.0 : static_cast<double>(in.contacts[b][0]);
            const int at = b * AMINN_N_BRANCH_FEATURE + k;
            contact[at] = normal(flag * static_cast<double>(number), s.contact_mean, s.contact_inv_std, at);
        }
    }
    dense(s.contact_w, s.contact_b, contact, AMINN_N_CONTACT_INPUT, kContactWidth, true, trunk);
    constexpr int kFirst = AMINN_N_JOINT + 2 * W;
    for (int k = 0; k < kFirst; ++k) {
        trunk[kContactWidth + k] =
            normal(static_cast<double>(reinterpret_cast<const float *>(&in)[k]), s.global_mean, s.global_inv_std, k);
    }
    for (int k = 0; k < W; ++k) {
        const double w = log_by_size(static_cast<double>(in.w_e[k]), static_cast<double>(model.wrench_log_scale[k]));
        trunk[kContactWidth + kFirst + k] = normal(w, s.global_mean, s.global_inv_std, kFirst + k);
    }
    for (int k = AMINN_N_GLOBAL_INPUT; k < kGlobal; ++k) {
        const int at = k - AMINN_N_GLOBAL_INPUT;
        const double number = at < kTold ? static_cast<double>(model.nominal.told[at]) : told.sensed[at - kTold];
        trunk[kContactWidth + k] = normal(number, s.global_mean, s.global_inv_std, k);
    }
    dense(s.trunk1_w, s.trunk1_b, trunk, kTrunkInput, h, true, hidden);
    dense(s.trunk2_w, s.trunk2_b, hidden, h, h, true, feature);
    dense(s.head_w, s.head_b, feature, h, AMINN_N_HEAD_STORED, false, head);
    head_to_springs(model, in, told, head, stage);
    two_pass(model, i, in, stage);
}

/* What networks see of a contact's friction. */
inline double of_friction(const Stage &stage, int i)
{
    const double *numbers[] = {stage.use, stage.share, stage.pressing};
    return std::log1p(numbers[i / B][i % B]);
}

/* What stage 1's classifier makes of the trunk's output, which stands first in `feature`, and of the statics. */
inline double classify(const aminn_model_t &model, const Stage &stage, double (&feature)[kClassifierInput])
{
    const double length = static_cast<double>(model.length_scale);
    double aux[AMINN_N_AUX] = {}, x[W], square = 0.0, hidden[kClassifier], logit = 0.0;
    for (int i = 0; i < W; ++i) {
        x[i] = stage.dx_uncut[i] * (i < 3 ? 1.0 : length);
        square += x[i] * x[i];
    }
    const double size = std::sqrt(square), fade = std::fmin(length / size, 1.0);
    for (int i = 0; i < W; ++i) {
        aux[i] = x[i] * std::log1p(size / static_cast<double>(model.displacement_log_scale)) / size;
        aux[W + i] = std::log(stage.k_held[i][i] / (i < 3 ? 1.0 : length * length));
    }
    for (int b = 0; b < B && G > 0; ++b) {
        aux[(2 * W + b) % AMINN_N_AUX] = stage.gate[b];
    }
    for (int i = 0; i < AMINN_N_SLID; ++i) {
        aux[(AMINN_N_AUX - AMINN_N_SLID + i) % AMINN_N_AUX] = of_friction(stage, i);
    }
    for (int i = 0; i < AMINN_N_AUX; ++i) {
        feature[kWidths[0] + i] = normal(aux[i], model.aux_mean, model.aux_inv_std, i) * (i < W ? 1.0 : fade);
    }
    dense(model.cls1_w, model.cls1_b, feature, kClassifierInput, kClassifier, true, hidden);
    dense(model.cls2_w, model.cls2_b, hidden, kClassifier, 1, false, &logit);
    return 1.0 / (1.0 + std::exp(-logit));
}

/* p_slide and bound_95 of stage 2's trunk and statics. */
inline void doubt(const aminn_model_t &model, const Stage &stage, double (&feature)[kSureInput], Reference &reference)
{
    double square = 0.0, found[2];
    for (int i = 0; i < W; ++i) {
        const double x = stage.dx_uncut[i] * (i < 3 ? 1.0 : static_cast<double>(model.length_scale));
        square += x * x;
    }
    const double seen = std::log1p(std::sqrt(square) / static_cast<double>(model.displacement_log_scale));
    feature[kWidth] = normal(seen, model.sure_mean, model.sure_inv_std, 0);
    for (int i = 0; i < AMINN_N_SLID; ++i) {
        feature[kWidth + 1 + i] = normal(of_friction(stage, i), model.sure_mean, model.sure_inv_std, 1 + i);
    }
    dense(model.sure_w, model.sure_b, feature, kSureInput, 2, false, found);
    reference.p_slide = 1.0 / (1.0 + std::exp(-found[0]));
    int bin = 0;
    for (const float edge : model.bound_edge) {
        bin += reference.p_slide >= static_cast<double>(edge) ? 1 : 0;
    }
    reference.bound_95 = std::exp(found[1]) * static_cast<double>(model.bound_factor[bin]);
}

inline Reference predict(const aminn_model_t &model, const aminn_input_t &in, const Told &told)
{
    Reference reference = {};
    double stability[kClassifierInput], doubts[kSureInput]; // the trunk's output stands first in both
    run_stage(model, 0, in, told, reference.stage[0], stability);
    reference.p_stable = classify(model, reference.stage[0], stability);
    run_stage(model, 1, in, told, reference.stage[1], doubts);
    doubt(model, reference.stage[1], doubts, reference);
    return reference;
}

/* What a context was told, as it stands there. */
inline Told told_of(const aminn_t &ctx)
{
    Told told = {};
    for (int i = 0; i < AMINN_N_SENSED; ++i) {
        told.sensed[i] = static_cast<double>(ctx.sensed[i]);
    }
#if AMINN_N_SLIDE
    told.friction = static_cast<double>(ctx.friction);
    for (int i = 0; i < 3 * B; ++i) {
        told.preload[i / 3][i % 3] = static_cast<double>(ctx.preload[i / 3][i % 3]);
    }
#endif
    return told;
}

/* What sensors tell of an input, by the formulas of docs/mechanics.md. */
inline Told told_by(const aminn_model_t &model, const aminn_input_t &in, const aminn_sensors_t &sensors)
{
    Told told = {};
    const double nominal = static_cast<double>(model.friction_nominal);
    if (sensors.friction[0] != 0.0F) {
        const double mu = static_cast<double>(sensors.friction[1]);
        told.sensed[0] = 1.0 / (1.0 + std::pow(static_cast<double>(sensors.friction[2]) / (0.3 * mu), 2));
        told.sensed[1] = told.sensed[0] * std::log(mu / nominal);
    }
    told.friction = nominal * std::exp(told.sensed[1]);
    const auto *numbers = reinterpret_cast<const float *>(&sensors);
    for (int i = 3; i < AMINN_N_SENSOR; ++i) {
        const float known = numbers[i < 7 ? 3 : 7];
        told.sensed[i - 1] = known != 0.0F ? static_cast<double>(numbers[i]) : 0.0;
    }
    if (sensors.tool_weight[0] == 0.0F) {
        return told;
    }
    const double length = static_cast<double>(model.length_scale);
    double g[W][W] = {}, rest[W] = {}, y[W], across[B][3][W];
    for (int i = 0; i < W; ++i) {
        g[i][i] = std::pow((i < 3 ? 0.3 : 0.008 / length) / 0.7, 2);
        rest[i] = i < 3 ? -static_cast<double>(sensors.tool_weight[1 + i]) : 0.0;
    }
    for (int b = 0; b < B; ++b) {
        const double c = static_cast<double>(in.contacts[b][0]);
        double a[3][W], n[3];
        for (int r = 0; r < 3; ++r) {
            n[r] = static_cast<double>(in.contacts[b][4 + r]);
            for (int j = 0; j < W; ++j) {
                a[r][j] = static_cast<double>(in.j_x[b][r][j]) / (j < 3 ? 1.0 : length);
            }
        }
        for (int j = 0; j < W; ++j) {
            const double along = n[0] * a[0][j] + n[1] * a[1][j] + n[2] * a[2][j];
            rest[j] -= c * static_cast<double>(in.contacts[b][7]) * along;
            for (int r = 0; r < 3; ++r) {
                across[b][r][j] = a[r][j] - n[r] * along;
            }
        }
        for (int i = 0; i < W; ++i) {
            for (int j = 0; j < W; ++j) {
                for (int r = 0; r < 3; ++r) {
                    g[i][j] += c * across[b][r][i] * across[b][r][j];
                }
            }
        }
    }
    solve<W>(g, rest, y);
    for (int b = 0; b < B; ++b) {
        for (int r = 0; r < 3; ++r) {
            for (int j = 0; j < W; ++j) {
                told.preload[b][r] += static_cast<double>(in.contacts[b][0]) * across[b][r][j] * y[j];
            }
        }
    }
    return told;
}

} // namespace hand_reference

#endif
