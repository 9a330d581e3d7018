/* Laws that the numerical core obeys for every model and input, tried with random ones: networks of any width with any weights,
 * hands from soft to stiff, contacts that fade. A generator with a fixed seed; no library. */
#ifndef HAND_PROPERTIES_HPP
#define HAND_PROPERTIES_HPP

#include <algorithm>

#include "hand_digest.hpp"

namespace hand_properties {

using namespace hand_case;

constexpr uint32_t kFlags = AMINN_FLAG_ALWAYS_STAGE2 | AMINN_FLAG_DEBUG;
constexpr double kRounding = 1e-4;      /* of work, where stiffnesses lie less than kFar apart */
constexpr float kFar = 1e6F;            /* condition */
constexpr float kFewDigits = 1e5F;      /* condition from which a stored K_x may have lost its smallest eigenvalue */
constexpr double kLostByStoring = 1e-6; /* of an eigenvalue, in float32, beyond */
constexpr float kTiny = 1e-30F;         /* scaling by powers of two is exact above */
constexpr int kPool = 2 * (AMINN_MAX_WIDTH + AMINN_N_LAST_INPUT) * AMINN_MAX_WIDTH;

/* How often a law was tried; of these how often the input was refused, or conditioned too ill to tell; and how often it broke. */
struct Law {
    const char *name;
    long cases, skipped, broken;
};
enum { kSpd, kWork, kRest, kStiffer, kFade, kScale, kExchange, kMirror, kLaws };

struct Case {
    Tables tables;
    aminn_model_t model;
    aminn_input_t in;
    float chol[B * kPacked], no_weights[AMINN_MAX_WIDTH * AMINN_N_HEAD_STORED], head_b[AMINN_N_HEAD_STORED];
};

inline float decade(Random &random, float low, float high)
{
    return std::pow(10.0F, random.within(low, high));
}

inline int below(Random &random, int n)
{
    return static_cast<int>(random.within(0.0F, 0.9999F) * static_cast<float>(n));
}

/* Numbers of sizes from shy to wild, of which tables of any length are parts. */
inline const float *pool(Random &random, int n)
{
    static float values[4][kPool];
    static const bool filled = [] {
        const float sizes[4] = {0.02F, 0.15F, 1.0F, 8.0F};
        Random all(5);
        for (int i = 0; i < 4; ++i) {
            all.fill(values[i], kPool, -sizes[i], sizes[i]);
        }
        return true;
    }();
    (void)filled;
    const int which = below(random, 4);
    return values[which] + below(random, kPool - n);
}

inline uint32_t random_width(Random &random)
{
    return static_cast<uint32_t>(1 + below(random, below(random, 8) == 0 ? AMINN_MAX_WIDTH : 24));
}

inline void random_networks(Random &random, Case &c)
{
    aminn_model_t &m = c.model;
    m.n_told = below(random, 2) != 0 ? AMINN_N_FACTOR : 0;
    m.n_sensed = below(random, 2) != 0 ? AMINN_N_SENSED : 0;
    m.contact_width = random_width(random);
    for (uint32_t &width : m.width) {
        width = random_width(random);
    }
    m.classifier_width = random_width(random);
    const int hc = static_cast<int>(m.contact_width), hd = static_cast<int>(m.classifier_width);
    const int global = AMINN_N_GLOBAL_INPUT + static_cast<int>(m.n_told + m.n_sensed);
    static float scales[AMINN_N_TOLD_INPUT + AMINN_N_CONTACT_INPUT];
    random.fill(scales, AMINN_N_TOLD_INPUT + AMINN_N_CONTACT_INPUT, 0.1F, 3.0F);
    for (int i = 0; i < AMINN_N_STAGE; ++i) {
        aminn_stage_model_t &s = m.stage[i];
        const int h = static_cast<int>(m.width[i]);
        s.contact_mean = pool(random, AMINN_N_CONTACT_INPUT);
        s.contact_inv_std = scales;
        s.global_mean = pool(random, global);
        s.global_inv_std = scales;
        s.contact_w = pool(random, AMINN_N_CONTACT_INPUT * hc);
        s.contact_b = pool(random, hc);
        s.trunk1_w = pool(random, (hc + global) * h);
        s.trunk1_b = pool(random, h);
        s.trunk2_w = pool(random, h * h);
        s.trunk2_b = pool(random, h);
        s.head_w = pool(random, h * AMINN_N_HEAD_STORED);
        s.head_b = pool(random, AMINN_N_HEAD_STORED);
    }
    m.cls1_w = pool(random, (static_cast<int>(m.width[0]) + AMINN_N_AUX) * hd);
    m.cls1_b = pool(random, hd);
    m.cls2_w = pool(random, hd);
    m.sure_w = pool(random, (static_cast<int>(m.width[1]) + AMINN_N_SURE) * 2);
}

inline void random_case(uint32_t seed, Case &c)
{
    Random random(seed * 2246822519u + 3u);
    make_model(c.tables, c.model);
    aminn_model_t &m = c.model;
    random_networks(random, c);
    for (int b = 0; b < B; ++b) {
        const float stiffer = decade(random, -1.0F, 1.0F);
        for (int i = 0; i < kPacked; ++i) {
            c.tables.chol_nom[b * kPacked + i] *= stiffer;
        }
        c.tables.tendon_gain_nom[b] *= decade(random, -1.0F, 1.0F);
        c.tables.twist_nom[b] *= decade(random, -1.0F, 1.0F);
        for (StageTables &stage : c.tables.stage) {
            stage.eps_m[b] = decade(random, -7.0F, -3.5F);
        }
    }
    for (aminn_stage_model_t &stage : m.stage) {
        stage.eps_kx = decade(random, -2.0F, 1.0F);
    }
    c.tables.gate_nom[0] = decade(random, 0.0F, 3.0F);
    c.tables.gate_nom[1] = random.within(-0.1F, 0.1F);
    c.tables.gate_nom[2] = random.within(-3.0F, 3.0F);
    m.log_range = random.within(0.0F, 1.5F);
    m.length_scale = decade(random, -1.7F, 0.0F);
    make_input(seed, c.in);
    const float load = decade(random, -4.0F, 2.5F);
    for (float &w : c.in.w_e) {
        w *= load;
    }
    for (int b = 0; b < B; ++b) {
        c.in.contacts[b][7] = decade(random, -2.0F, 1.5F);
        if (below(random, 4) == 0) {
            c.in.contacts[b][0] = random.within(0.001F, 1.0F);
        }
    }
}

/* Heads that say the same whatever their input: what is tried then is statics. */
inline void still_heads(Case &c)
{
    std::memset(c.no_weights, 0, sizeof c.no_weights);
    std::memcpy(c.head_b, c.model.stage[1].head_b, sizeof c.head_b);
    for (aminn_stage_model_t &stage : c.model.stage) {
        stage.head_w = c.no_weights;
        stage.head_b = c.head_b;
    }
}

class Trial {
  public:
    explicit Trial(Core core) : core_(core)
    {
    }
    bool predict(const aminn_model_t &model, const aminn_input_t &in)
    {
        begin(ctx, model, kFlags);
        std::memset(&out, 0, sizeof out);
        return core_(ctx, in, out);
    }
    const aminn_stage_debug_t &stage(int i) const
    {
        return ctx.stage[i];
    }
    aminn_t ctx;
    aminn_output_t out;

  private:
    Core core_;
};

inline double work(const float *w, const float *dx)
{
    double sum = 0.0;
    for (int i = 0; i < AMINN_N_WRENCH; ++i) {
        sum += static_cast<double>(w[i]) * static_cast<double>(dx[i]);
    }
    return sum;
}

/* Whether a symmetric matrix, scaled to ones on its diagonal, has no eigenvalue of -shift or less (shift of any sign). */
inline bool is_definite(const float *k, int n, double shift)
{
    double a[AMINN_N_WRENCH][AMINN_N_WRENCH];
    for (int i = 0; i < n; ++i) {
        for (int j = 0; j <= i; ++j) {
            const double size = std::sqrt(static_cast<double>(k[n * i + i]) * static_cast<double>(k[n * j + j]));
            double sum = static_cast<double>(k[n * i + j]) / size + (i == j ? shift : 0.0);
            for (int m = 0; m < j; ++m) {
                sum -= a[i][m] * a[j][m];
            }
            if (i == j && !(sum > 0.0)) {
                return false;
            }
            a[i][j] = i == j ? std::sqrt(sum) : sum / a[j][j];
        }
    }
    return true;
}

inline bool is_spd(const Trial &t)
{
    bool ok = true;
    for (int s = 0; s < AMINN_N_STAGE; ++s) {
        const aminn_stage_debug_t &stage = t.stage(s);
        for (int i = 0; i < AMINN_N_WRENCH; ++i) {
            for (int j = 0; j < i; ++j) {
                ok = ok && stage.k_x[i][j] == stage.k_x[j][i];
            }
        }
        const bool sure = s == 1 && !kSlides && t.out.condition < kFewDigits;
        ok = ok && is_definite(stage.k_x[0], AMINN_N_WRENCH, sure ? 0.0 : kLostByStoring);
        for (int b = 0; b < B; ++b) {
            ok = ok && is_definite(stage.k_spring[b][0], C, kLostByStoring);
        }
    }
    return ok;
}

inline bool gives_energy(const Trial &t, const aminn_input_t &in)
{
    bool ok = true;
    for (int s = 0; s < AMINN_N_STAGE; ++s) {
        double size = 0.0;
        for (int i = 0; i < AMINN_N_WRENCH; ++i) {
            size += std::fabs(static_cast<double>(in.w_e[i]) * static_cast<double>(t.stage(s).dx[i]));
        }
        ok = ok && work(in.w_e, t.stage(s).dx) >= -1e-6 * size;
        ok = ok && (t.out.condition > kFar || work(in.w_e, t.stage(s).dx0) >= 0.0);
    }
    return ok;
}

inline bool is_at_rest(const Trial &t)
{
    bool ok = true;
    for (int s = 0; s < AMINN_N_STAGE; ++s) {
        for (int i = 0; i < AMINN_N_WRENCH; ++i) {
            ok = ok && t.stage(s).dx[i] == 0.0F && t.stage(s).dx0[i] == 0.0F;
        }
    }
    return ok;
}

/* one thing stiffer; whether tendons */
inline bool stiffen(Random &random, Case &c)
{
    const int b = below(random, B);
    const float s = decade(random, 0.01F, 2.0F);
    switch (below(random, G > 0 ? 5 : 4)) {
    case 0:
        for (int i = 0; i < kPacked; ++i) {
            c.tables.chol_nom[b * kPacked + i] *= std::sqrt(s);
        }
        return false;
    case 1:
        c.tables.twist_nom[b] *= s;
        return false;
    case 2:
        c.model.stage[0].eps_kx *= s;
        c.model.stage[1].eps_kx *= s;
        return false;
    case 3:
        c.tables.stage[0].eps_m[b] /= s;
        c.tables.stage[1].eps_m[b] /= s;
        return false;
    default:
        c.tables.tendon_gain_nom[b] *= s;
        return true;
    }
}

inline bool no_farther(const Trial &t, const Trial &before, const aminn_input_t &in, bool tendons)
{
    bool ok = true;
    for (int s = 0; s < AMINN_N_STAGE; ++s) {
        if (!is_definite(t.stage(s).k_x[0], AMINN_N_WRENCH, -1.0 / static_cast<double>(kFar))) {
            continue; /* the condition that is told is of stage 2 alone */
        }
        const double soft = work(in.w_e, before.stage(s).dx0), stiff = work(in.w_e, t.stage(s).dx0);
        ok = ok && stiff <= soft * (1.0 + kRounding) + static_cast<double>(kTiny);
        if (tendons && !kSlides) {
            const double slack = work(in.w_e, before.stage(s).dx), tight = work(in.w_e, t.stage(s).dx);
            ok = ok && tight <= slack * (1.0 + kRounding) + static_cast<double>(kTiny) &&
                 slack <= soft * (1.0 + kRounding) + static_cast<double>(kTiny) &&
                 std::memcmp(before.stage(s).gate, t.stage(s).gate, sizeof before.stage(s).gate) == 0;
        }
    }
    return ok;
}

/* Each number of b is that of a times a power of two, bit by bit. */
inline bool is_scaled(const float *a, const float *b, int power, const float *signs = nullptr)
{
    bool ok = true;
    for (int i = 0; i < AMINN_N_WRENCH; ++i) {
        const float wanted = std::ldexp(signs != nullptr ? signs[i] * a[i] : a[i], power);
        ok = ok && (wanted == b[i] || std::fabs(wanted) < kTiny);
    }
    return ok;
}

inline int partner(int b)
{
    for (int other = b + 1; other < B; ++other) {
        if (lacking(other) == lacking(b) && has_tendon(other) == has_tendon(b)) {
            return other;
        }
    }
    return -1;
}

template <class T>
void swap_rows(T *rows, int n, int a, int b)
{
    std::swap_ranges(rows + n * a, rows + n * (a + 1), rows + n * b);
}

/* Branches a and b in each other's place: inputs, springs, contacts, and what the heads say of them. */
inline void exchange(Case &c, int a, int b)
{
    swap_rows(&c.in.contacts[0][0], AMINN_N_CONTACT_FEATURE, a, b);
    swap_rows(&c.in.j_x[0][0][0], 3 * AMINN_N_WRENCH, a, b);
    swap_rows(&c.in.j_q[0][0][0], 3 * C, a, b);
    swap_rows(c.tables.chol_nom, kPacked, a, b);
    swap_rows(c.tables.tendon_dir_nom, C, a, b);
    swap_rows(c.tables.tendon_gain_nom, 1, a, b);
    swap_rows(c.tables.twist_nom, 1, a, b);
    for (StageTables &stage : c.tables.stage) {
        swap_rows(stage.eps_m, 1, a, b);
    }
    for (int row = 0; row < AMINN_N_BRANCH_HEAD; ++row) {
        std::swap(c.head_b[row * B + a], c.head_b[row * B + b]);
    }
}

/* of the scaled poses, over the larger one */
inline double distance(const float *a, const float *b, float length)
{
    double difference = 0.0, size = 1e-300;
    for (int i = 0; i < AMINN_N_WRENCH; ++i) {
        const double unit = i < 3 ? 1.0 : static_cast<double>(length);
        difference += std::pow(unit * (static_cast<double>(a[i]) - static_cast<double>(b[i])), 2);
        size += std::pow(unit * static_cast<double>(b[i]), 2);
    }
    return std::sqrt(difference / size);
}

constexpr float kMirrored[AMINN_N_WRENCH] = {-1.0F, 1.0F, 1.0F, 1.0F, -1.0F, -1.0F}; /* x to -x */

inline void mirror(aminn_input_t &in)
{
    for (int i = 0; i < AMINN_N_WRENCH; ++i) {
        in.w_e[i] *= kMirrored[i];
        in.x_ht[i] *= kMirrored[i];
    }
    for (int b = 0; b < B; ++b) {
        in.contacts[b][1] = -in.contacts[b][1];
        in.contacts[b][4] = -in.contacts[b][4];
        for (int i = 0; i < 3; ++i) {
            for (int k = 0; k < AMINN_N_WRENCH; ++k) {
                in.j_x[b][i][k] *= kMirrored[i] * kMirrored[k];
            }
            for (int k = 0; k < C; ++k) {
                in.j_q[b][i][k] *= kMirrored[i];
            }
        }
    }
}

inline void note(Law &law, uint32_t seed, bool sound, bool holds)
{
    ++law.cases;
    law.skipped += sound ? 0 : 1;
    if (sound && !holds) {
        ++law.broken;
        std::fprintf(stderr, "%s is broken by case %lu\n", law.name, static_cast<unsigned long>(seed));
    }
}

/* One random case through every law. */
inline void try_case(Core core, uint32_t seed, Law *laws)
{
    static Case c;
    Random random(seed ^ 0x5bd1e995u);
    static Trial before(core), after(core);
    before = Trial(core);
    after = Trial(core);
    random_case(seed, c);
    bool sound = before.predict(c.model, c.in);
    note(laws[kSpd], seed, sound, is_spd(before));
    note(laws[kWork], seed, sound, gives_energy(before, c.in));
    aminn_input_t unloaded = c.in;
    std::memset(unloaded.w_e, 0, sizeof unloaded.w_e);
    const bool resting = after.predict(c.model, unloaded);
    note(laws[kRest], seed, resting, is_at_rest(after));

    c.model.n_told = 0; /* else the networks see what is changed below */
    sound = before.predict(c.model, c.in) && before.out.condition < kFar;
    const bool tendons = stiffen(random, c);
    sound = after.predict(c.model, c.in) && after.out.condition < kFar && sound;
    note(laws[kStiffer], seed, sound, no_farther(after, before, c.in, tendons));

    still_heads(c);
    sound = before.predict(c.model, c.in) && before.out.condition < kFar;
    const aminn_input_t in = c.in;
    const int power = below(random, 17) - 8;
    for (float &w : c.in.w_e) {
        w = std::ldexp(w, power);
    }
    bool scaled = after.predict(c.model, c.in);
    note(laws[kScale], seed, sound && scaled,
         is_scaled(before.stage(0).dx0, after.stage(0).dx0, power) &&
             is_scaled(before.stage(1).dx0, after.stage(1).dx0, power));
    c.in = in;
    mirror(c.in);
    scaled = after.predict(c.model, c.in);
    const bool dx_too = !kSlides; /* a head says tangential forces before the load in axes of H */
    note(laws[kMirror], seed, sound && scaled,
         is_scaled(before.stage(1).dx0, after.stage(1).dx0, 0, kMirrored) &&
             (!dx_too || is_scaled(before.stage(1).dx, after.stage(1).dx, 0, kMirrored)) &&
             std::memcmp(before.out.gate, after.out.gate, sizeof after.out.gate) == 0);
    c.in = in;

    const int b = below(random, B);
    const float share = random.within(0.0F, 0.999F);
    c.in.contacts[b][0] *= share;
    const bool faded = after.predict(c.model, c.in) && after.out.condition < kFar;
    note(laws[kFade], seed, sound && faded,
         work(in.w_e, after.stage(1).dx0) * (1.0 + kRounding) + static_cast<double>(kTiny) >=
             work(in.w_e, before.stage(1).dx0));
    c.in = in;

    const int first = below(random, B), second = partner(first);
    if (second >= 0) {
        exchange(c, first, second);
        const bool exchanged = after.predict(c.model, c.in) && before.out.condition < kFewDigits;
        note(laws[kExchange], seed, sound && exchanged,
             distance(after.stage(1).dx0, before.stage(1).dx0, c.model.length_scale) < 3e-2 &&
                 std::fabs(after.out.gate[first] - before.out.gate[second]) < 3e-2F);
    }
}

/* Cases 0 .. n - 1. */
inline void try_cases(Core core, uint32_t n, Law *laws)
{
    static const char *const names[kLaws] = {"spd",  "work",  "zero_wrench_zero_motion", "stiffer_never_moves_more",
                                             "fade", "scale", "branch_exchange",         "mirror"};
    for (int i = 0; i < kLaws; ++i) {
        laws[i] = {names[i], 0, 0, 0};
    }
    for (uint32_t seed = 0; seed < n; ++seed) {
        try_case(core, seed, laws);
    }
}

/* Prints the counts as JSON; how many were broken. */
inline long print(const Law *laws)
{
    long broken = 0;
    std::printf("{");
    for (int i = 0; i < kLaws; ++i) {
        std::printf("%s\"%s_cases\": %ld, \"%s_skipped\": %ld, \"%s_broken\": %ld", i > 0 ? ", " : "", laws[i].name,
                    laws[i].cases, laws[i].name, laws[i].skipped, laws[i].name, laws[i].broken);
        broken += laws[i].broken;
    }
    std::printf("}\n");
    return broken;
}

} // namespace hand_properties

#endif
