/*
 * The public functions for the hand that this is compiled for (AMINN_HAND_HEADER): models in memory and as a blob, those of
 * other hands, the closure beside finite differences in double, and the names of a state's numbers.
 */
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <string>
#include <vector>

#include "blob_writer.hpp"
#include "hand_case.hpp"
#include "hand_reference.hpp"
#include "unity.h"

using blob_writer::blob_of;
using namespace hand_case;

static Tables tables;
static float axes[B * C * 3], anchors[B * C * 3], lowest[AMINN_N_STATE], highest[AMINN_N_STATE];
static aminn_known_answer_t known;
static aminn_model_t model;
static aminn_t ctx;
static aminn_input_t in;

static void make_geometry()
{
    Random random(11);
    for (int b = 0; b < B; ++b) {
        for (int c = lacking(b); c < C; ++c) {
            float *axis = axes + 3 * (C * b + c), *anchor = anchors + 3 * (C * b + c), length = 0;
            random.fill(axis, 3, -1.0F, 1.0F);
            random.fill(anchor, 3, -0.06F, 0.06F);
            for (int i = 0; i < 3; ++i) {
                length += axis[i] * axis[i];
            }
            for (int i = 0; i < 3; ++i) {
                axis[i] /= std::sqrt(length);
            }
        }
    }
}

extern "C" void setUp(void)
{
    make_model(tables, model);
    make_geometry();
    for (int i = 0; i < AMINN_N_STATE; ++i) {
        lowest[i] = -2.0F;
        highest[i] = 2.0F;
    }
    model.format_version = AMINN_FORMAT_VERSION;
    model.n_branch = AMINN_N_BRANCH;
    model.n_coord = AMINN_N_COORD;
    model.n_joint = AMINN_N_JOINT;
    model.n_contact_feature = AMINN_N_CONTACT_FEATURE;
    model.n_wrench = AMINN_N_WRENCH;
    model.n_gated = AMINN_N_GATED;
    model.n_twist = AMINN_N_TWIST;
    model.n_stiff = AMINN_N_STIFF;
    model.n_tendon = AMINN_N_TENDON;
    model.n_slide = AMINN_N_SLIDE;
    model.name = "made up";
    model.hand = AMINN_HAND_NAME;
    model.made_by = "a test";
    model.library = AMINN_LIBRARY;
    model.geom_axis = axes;
    model.geom_anchor = anchors;
    model.range_min = lowest;
    model.range_max = highest;
    model.known_answer = &known;
    make_input(1, in);
    for (int b = 0; b < B; ++b) {
        float *normal = in.contacts[b] + 4;
        normal[0] = 0.6F;
        normal[1] = 0.0F;
        normal[2] = b % 2 == 0 ? 0.8F : -0.8F;
        in.contacts[b][0] = 1.0F;
    }
}

extern "C" void tearDown(void)
{
}

static aminn_output_t predicted(const aminn_model_t &m)
{
    aminn_output_t out;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &m, AMINN_FLAG_ALWAYS_STAGE2));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &out));
    return out;
}

static void a_blob_predicts_as_the_model_in_memory()
{
    const std::vector<uint8_t> blob = blob_of(model);
    aminn_model_t loaded;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_model_from_blob(blob.data(), blob.size(), &loaded));
    const aminn_output_t a = predicted(model), b = predicted(loaded);
    TEST_ASSERT_EQUAL_MEMORY(&a, &b, sizeof a);
    if (G == 0) {
        for (const float gate : a.gate) {
            TEST_ASSERT_EQUAL_FLOAT(0.0F, gate);
        }
    }
}

static void a_model_of_another_hand_is_refused()
{
    uint32_t *const counts[] = {&model.n_branch, &model.n_coord, &model.n_joint, &model.n_contact_feature,
                                &model.n_wrench, &model.n_gated, &model.n_twist, &model.n_stiff,
                                &model.n_tendon, &model.n_slide, &model.n_told,  &model.n_sensed};
    for (uint32_t *count : counts) {
        *count += 1;
        TEST_ASSERT_EQUAL_INT(AMINN_E_DIMS, aminn_model_check(&model));
        const std::vector<uint8_t> blob = blob_of(model);
        aminn_model_t loaded;
        TEST_ASSERT_EQUAL_INT(AMINN_E_DIMS, aminn_model_from_blob(blob.data(), blob.size(), &loaded));
        TEST_ASSERT_NULL(loaded.nominal.chol);
        *count -= 1;
    }
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_model_check(&model));
    tables.coord_mask[C * B - 1] = 0.0F; /* the last branch lacks its last coordinate */
    TEST_ASSERT_EQUAL_INT(AMINN_E_MODEL, aminn_model_check(&model));
}

/* x turned about the line through `anchor` along `axis`, in double */
static void turn(const float *axis, const float *anchor, double angle, double x[3])
{
    const double s = std::sin(angle), c = std::cos(angle);
    double k[3], a[3], r[3];
    for (int i = 0; i < 3; ++i) {
        k[i] = static_cast<double>(axis[i]);
        a[i] = static_cast<double>(anchor[i]);
        r[i] = x[i] - a[i];
    }
    const double along = k[0] * r[0] + k[1] * r[1] + k[2] * r[2];
    for (int i = 0; i < 3; ++i) {
        const int j = (i + 1) % 3, l = (i + 2) % 3;
        x[i] = a[i] + c * r[i] + s * (k[j] * r[l] - k[l] * r[j]) + (1 - c) * along * k[i];
    }
}

/* where the tip of a branch carries a point that it holds at q = 0: the outermost joint turns first; or, back, where it was */
static void carry(int b, const double angles[C], double x[3], bool back)
{
    for (int n = lacking(b); n < C; ++n) {
        const int c = back ? n : C - 1 - n + lacking(b), at = 3 * (C * b + c);
        turn(axes + at, anchors + at, back ? -angles[c] : angles[c], x);
    }
}

static void the_closure_is_the_motion_of_the_contacts()
{
    static float j_x[B][3][AMINN_N_WRENCH], j_q[B][3][C];
    constexpr double kStep = 1e-6;
    double worst = 0;
    for (uint32_t seed = 0; seed < 40; ++seed) {
        make_input(seed, in);
        TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_closure(&model, in.q, in.x_ht, in.contacts, j_x, j_q));
        int joint = 0;
        for (int b = 0; b < B; ++b) {
            const bool closed = in.contacts[b][0] != 0.0F;
            double angles[C] = {};
            for (int c = lacking(b); c < C; ++c) {
                angles[c] = static_cast<double>(in.q[joint++]);
            }
            for (int c = 0; c < C; ++c) {
                double ahead[3], behind[3];
                for (int i = 0; i < 3; ++i) {
                    ahead[i] = behind[i] = static_cast<double>(in.contacts[b][1 + i]);
                }
                double moved[C];
                std::memcpy(moved, angles, sizeof moved);
                carry(b, angles, ahead, true);
                carry(b, angles, behind, true);
                moved[c] += kStep;
                carry(b, moved, ahead, false);
                moved[c] -= 2 * kStep;
                carry(b, moved, behind, false);
                for (int i = 0; i < 3; ++i) {
                    const bool counts = closed && c >= lacking(b);
                    const double want = counts ? -(ahead[i] - behind[i]) / (2 * kStep) : 0.0;
                    worst = std::fmax(worst, std::fabs(static_cast<double>(j_q[b][i][c]) - want));
                    TEST_ASSERT_EQUAL_FLOAT(closed ? 1.0F : 0.0F, j_x[b][i][i]);
                }
            }
            const float *p = in.contacts[b] + 1; /* a turn about z moves the contact by z x r */
            TEST_ASSERT_EQUAL_FLOAT(closed ? -(p[1] - in.x_ht[1]) : 0.0F, j_x[b][0][5]);
            TEST_ASSERT_EQUAL_FLOAT(closed ? p[0] - in.x_ht[0] : 0.0F, j_x[b][1][5]);
        }
        TEST_ASSERT_EQUAL_INT(AMINN_N_JOINT, joint);
    }
    std::printf("closure against differences: %.2g m/rad, of about 0.5\n", worst);
    TEST_ASSERT_TRUE(worst < 5e-7);
}

static void a_state_is_predicted_from_as_with_its_closure()
{
    aminn_state_t state;
    aminn_output_t a, b;
    std::memcpy(&state, &in, sizeof state);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_closure(&model, in.q, in.x_ht, in.contacts, in.j_x, in.j_q));
    b = predicted(model);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict_state(&ctx, &state, &a));
    TEST_ASSERT_EQUAL_MEMORY(&a, &b, sizeof a);
    state.q[AMINN_N_JOINT - 1] = 1e4F;
    TEST_ASSERT_EQUAL_INT(AMINN_E_NUMERIC, aminn_predict_state(&ctx, &state, &a));
}

static void numbers_out_of_range_have_names()
{
    aminn_state_t state;
    std::memcpy(&state, &in, sizeof state);
    TEST_ASSERT_EQUAL_INT(-1, aminn_first_out_of_range(&model, &state));
    for (int j = 0; j < AMINN_N_JOINT; ++j) {
        const float kept = state.q[j];
        state.q[j] = 3.0F;
        TEST_ASSERT_EQUAL_INT(j, aminn_first_out_of_range(&model, &state));
        TEST_ASSERT_EQUAL_STRING(("q.joint_" + std::to_string(j) + "_rad").c_str(), aminn_field_name(j));
        state.q[j] = kept;
    }
    state.contacts[B - 1][7] = 3.0F;
    TEST_ASSERT_EQUAL_INT(AMINN_N_STATE - 1, aminn_first_out_of_range(&model, &state));
    const std::string last = "contacts[" + std::to_string(B - 1) + "].normal_force_N";
    TEST_ASSERT_EQUAL_STRING(last.c_str(), aminn_field_name(AMINN_N_STATE - 1));
    TEST_ASSERT_EQUAL_STRING("none", aminn_field_name(AMINN_N_STATE));
}

/* Each number of `got` within `tolerance`, as a share of `size` at least */
static void assert_near(double tolerance, double size, const double *want, const float *got, int n)
{
    for (int i = 0; i < n; ++i) {
        TEST_ASSERT_DOUBLE_WITHIN(tolerance * std::fmax(size, std::fabs(want[i])), want[i],
                                  static_cast<double>(got[i]));
    }
}

/* friction and weight, known or not, any number of contacts: as the formulas have it, and what is not known has no influence */
static void sensors_tell_networks_and_layer()
{
    Random random(5);
    for (uint32_t seed = 0; seed < 24; ++seed) {
        aminn_sensors_t sensors = {};
        aminn_output_t out;
        random.fill(&sensors.friction[0], AMINN_N_SENSOR, -2.0F, 2.0F);
        sensors.friction[0] = seed % 2 == 0 ? 1.0F : 0.0F;
        sensors.friction[1] = random.within(0.3F, 1.2F);
        sensors.friction[2] = seed % 4 == 0 ? 0.0F : random.within(0.0F, 0.4F);
        sensors.tool_weight[0] = seed % 3 < 2 ? 1.0F : 0.0F;
#if AMINN_N_TENDON > 0
        sensors.tendon_tension[0] = seed % 5 < 2 ? 1.0F : 0.0F;
#endif
        make_input(seed, in);
        TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &model, AMINN_FLAG_ALWAYS_STAGE2));
        if (kSensed == 0) {
            TEST_ASSERT_EQUAL_INT(AMINN_E_SENSORS, aminn_sense(&ctx, &sensors));
            continue;
        }
        TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_sense(&ctx, &sensors));
        TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict(&ctx, &in, &out));
        const hand_reference::Told told = hand_reference::told_by(model, in, sensors);
        const hand_reference::Told got = hand_reference::told_of(ctx);
        for (int i = 0; i < AMINN_N_SENSED; ++i) {
            TEST_ASSERT_DOUBLE_WITHIN(1e-6, told.sensed[i], got.sensed[i]);
        }
        if (kSlides) {
            TEST_ASSERT_DOUBLE_WITHIN(1e-6, told.friction, got.friction);
            for (int i = 0; i < 3 * B; ++i) {
                TEST_ASSERT_DOUBLE_WITHIN(1e-5, told.preload[i / 3][i % 3], got.preload[i / 3][i % 3]);
            }
        }
        const hand_reference::Reference want = hand_reference::predict(model, in, told);
        TEST_ASSERT_DOUBLE_WITHIN(2e-4, want.p_stable, static_cast<double>(out.p_stable));
        assert_near(5e-3, 0.1, want.stage[0].use, out.friction_use, B);
    }
}

/* a state with all branches in contact */
static aminn_state_t made_up_state(uint32_t seed)
{
    aminn_input_t made;
    aminn_state_t state;
    make_input(seed, made);
    std::memcpy(made.contacts, in.contacts, sizeof in.contacts);
    std::memcpy(&state, &made, sizeof state);
    return state;
}

static void motion(const float *theta, const aminn_state_t &state, float *dx)
{
    static aminn_calibration_t hand;
    aminn_output_t out;
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_calibration_set(&hand, &model, theta));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_calibrate(&ctx, &hand));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_predict_state(&ctx, &state, &out));
    std::memcpy(dx, out.dx_ht, sizeof out.dx_ht);
}

static double error_of_motion(const float *theta, const float *truth)
{
    double sum = 0;
    for (uint32_t seed = 0; seed < 40; ++seed) {
        const aminn_state_t state = made_up_state(seed);
        float dx[AMINN_N_WRENCH], want[AMINN_N_WRENCH];
        double off = 0, size = 0;
        motion(theta, state, dx);
        motion(truth, state, want);
        for (int i = 0; i < AMINN_N_WRENCH; ++i) {
            const double scale = i < 3 ? 1.0 : static_cast<double>(model.length_scale);
            off += std::pow(scale * static_cast<double>(dx[i] - want[i]), 2);
            size += std::pow(scale * static_cast<double>(want[i]), 2);
        }
        sum += std::sqrt(off / size);
    }
    return sum / 40;
}

/* of springs, tendons, contacts, and what soft fingertips resist, whatever of these the hand has */
static void pushes_teach_the_hand()
{
    static aminn_calibrator_t calibrator;
    const aminn_calibrator_settings_t settings = {0.5F, 1e-7F, 0.01F, 0.5F, 1.5F, 1.0F};
    float truth[AMINN_N_THETA] = {};
    const float nominal[AMINN_N_THETA] = {};
    for (int i = 0; i < AMINN_N_FACTOR; ++i) {
        truth[i] = i % 2 == 0 ? 0.3F : -0.2F;
    }
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &model, AMINN_FLAG_ALWAYS_STAGE2));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_calibrator_init(&calibrator, &model, nullptr, &settings));
    for (uint32_t seed = 0; seed < 120; ++seed) {
        const aminn_state_t state = made_up_state(seed);
        float dx[AMINN_N_WRENCH];
        motion(truth, state, dx);
        TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_calibrate_push(&ctx, &calibrator, &state, dx));
    }
    const double before = error_of_motion(nominal, truth);
    const double after = error_of_motion(calibrator.calibration.theta, truth);
    std::printf("error of the predicted motion: %.3f nominal, %.4f after 120 pushes\n", before, after);
    TEST_ASSERT_TRUE(before > 0.005 && after < (kSlides ? 0.5 : 0.2) * before);
}

/* a load on the grasp of a state: another direction and size each time */
static aminn_state_t loaded(uint32_t seed)
{
    Random random(seed);
    aminn_state_t state = made_up_state(1);
    random.fill(state.w_e, 3, -1.0F, 1.0F);
    random.fill(state.w_e + 3, 3, -0.03F, 0.03F);
    return state;
}

static aminn_calibrator_t calibrator;
static aminn_sensors_t known_sensors;

/* a calibrator that learns friction, and hardly anything of theta */
static void start_with_sensors()
{
    const aminn_calibrator_settings_t settings = {1e-9F, 1e-3F, 0.5F, 0.5F, 1.5F, 1.0F};
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &model, AMINN_FLAG_ALWAYS_STAGE2));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_calibrator_init(&calibrator, &model, nullptr, &settings));
    known_sensors = aminn_sensors_t{};
    if (kSlides) {
        TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_sense(&ctx, &known_sensors));
    }
}

static void friction_of(const aminn_state_t &state, const float *sensor, float *friction)
{
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_calibrator_friction(&calibrator, &state, sensor, friction));
}

#if AMINN_N_SLIDE
constexpr int kCoefficients = AMINN_N_COEFFICIENT;

static double coefficient(int k)
{
    return 0.4 + 0.7 * k / (kCoefficients - 1);
}

/* Likelihoods after a push of which the formulas say that its load asks for so much friction, and that moved the tool. */
static void narrow(const aminn_state_t &state, const float *dx, double (&likelihood)[kCoefficients])
{
    aminn_input_t full;
    std::memcpy(&full, &state, sizeof state);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_closure(&model, full.q, full.x_ht, full.contacts, full.j_x, full.j_q));
    aminn_model_t now = model; /* with the theta of before the push */
    now.nominal = calibrator.calibration.varied;
    const hand_reference::Reference found =
        hand_reference::predict(now, full, hand_reference::told_by(now, full, known_sensors));
    const hand_reference::Stage &stage = found.stage[1];
    double asked = 1e-6, w[AMINN_N_WRENCH], motion[AMINN_N_WRENCH], off = 0, size = 0, most = 0;
    for (int b = 0; b < B; ++b) {
        asked = std::fmax(asked, stage.use[b] * stage.friction[b]);
    }
    for (int i = 0; i < AMINN_N_WRENCH; ++i) {
        w[i] = static_cast<double>(state.w_e[i]);
    }
    hand_reference::solve<AMINN_N_WRENCH>(stage.k_held, w, motion);
    hand_reference::cut(model, motion);
    for (int i = 0; i < AMINN_N_WRENCH; ++i) {
        const double scale = i < 3 ? 1.0 : static_cast<double>(model.length_scale);
        off += std::pow(scale * (static_cast<double>(dx[i]) - motion[i]), 2);
        size += std::pow(scale * motion[i], 2);
    }
    const double odds = std::fmin(std::fmax(off / (std::pow(0.3e-3, 2) + std::pow(0.14, 2) * size), 0.01), 1000.0);
    for (int k = 0; k < kCoefficients; ++k) {
        const double ratio = std::fmin(std::fmax(coefficient(k) / asked, 0.125), 8.0);
        const double sticks = std::pow(ratio, known_sensors.tool_weight[0] > 0 ? 16 : 8);
        likelihood[k] *= (sticks + odds * std::pow(std::fmin(ratio, 1.0), 2)) / (sticks + 1.0);
        most = std::fmax(most, likelihood[k]);
    }
    for (double &value : likelihood) {
        value = std::fmax(value / most, 1e-6);
    }
}

/* those that stick, those that slide, and those that the limits cut; with and without the tool's weight */
static void pushes_narrow_friction_as_the_formulas_have_it()
{
    double told = 0;
    for (int weighed = 0; weighed < 2; ++weighed) {
        double likelihood[kCoefficients];
        std::fill(likelihood, likelihood + kCoefficients, 1.0);
        start_with_sensors();
        known_sensors.tool_weight[0] = static_cast<float>(weighed);
        known_sensors.tool_weight[3] = -1.5F;
        for (uint32_t seed = 0; seed < 12; ++seed) {
            aminn_state_t state = loaded(seed);
            float dx[AMINN_N_WRENCH];
            const float size = seed % 4 == 3 ? 30.0F : seed % 4 == 2 ? 0.3F : 1.0F;
            for (float &number : state.w_e) {
                number *= size;
            }
            motion(nullptr, state, dx);
            for (float &number : dx) {
                number *= seed % 3 == 0 ? 2.5F : 1.0F;
            }
            narrow(state, dx, likelihood);
            TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_calibrate_push(&ctx, &calibrator, &state, dx));
            for (int k = 0; k < kCoefficients; ++k) {
                TEST_ASSERT_DOUBLE_WITHIN(0.02, likelihood[k], static_cast<double>(calibrator.friction[k]));
                told = std::fmax(told, 1.0 - likelihood[k]);
            }
        }
    }
    TEST_ASSERT_TRUE(told > 0.3);
}

static void set_likelihood(int first, int last)
{
    for (int k = 0; k < kCoefficients; ++k) {
        calibrator.friction[k] = k >= first && k <= last ? 1.0F : 1e-6F;
    }
}

/* mean and variance of coefficients that are equally likely, with the grid's own taken out; as a sensor's; or both together */
static void likelihood_and_sensor_make_a_sensor()
{
    const aminn_state_t state = loaded(1);
    float dx[AMINN_N_WRENCH], friction[3], again[3];
    start_with_sensors();
    motion(nullptr, state, dx);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_calibrate_push(&ctx, &calibrator, &state, dx));
    for (int last = 3; last < kCoefficients; ++last) {
        const double step = 0.7 / 15, n = last + 1, variance = step * step * (n * n - 1) / 12;
        const double own = std::pow((n * n - 1) / 255, 2), mean = 0.4 + 0.5 * step * last;
        set_likelihood(0, last);
        friction_of(state, nullptr, friction);
        if (1 - own <= 0.02) {
            TEST_ASSERT_EQUAL_FLOAT(0.0F, friction[0] + friction[1] + friction[2]);
            continue;
        }
        const double alone[3] = {1.0, std::fmin(std::fmax((mean - own * 0.75) / (1 - own), 0.4), 1.1),
                                 std::sqrt(variance / (1 - own))};
        assert_near(1e-3, 0.1, alone, friction, 3);
    }
    const float broad[3] = {1.0F, 0.75F, 0.1F}, exact[3] = {1.0F, 0.6F, 0.0F}, beyond[3] = {1.0F, 1.6F, 0.05F};
    const float huge[3] = {1.0F, 1e20F, 1e20F}, low[3] = {1.0F, 0.2F, 0.02F};
    set_likelihood(0, 15);
    for (const float *sensor : {broad, beyond, low}) { /* all coefficients are as likely: only the sensor counts */
        friction_of(state, sensor, friction);
        const double same[3] = {1.0, static_cast<double>(sensor[1]), static_cast<double>(sensor[2])};
        assert_near(0.01, 0.1, same, friction, 3);
    }
    set_likelihood(8, 15);
    friction_of(state, broad, friction);
    TEST_ASSERT_TRUE(friction[1] > 0.79F && friction[1] < 0.87F && friction[2] < 0.08F);
    std::memcpy(again, broad, sizeof again);
    friction_of(state, again, again); /* in its place */
    TEST_ASSERT_EQUAL_MEMORY(friction, again, sizeof again);
    for (const float *sensor : {exact, huge}) { /* nothing to add; nothing that could be computed */
        friction_of(state, sensor, friction);
        TEST_ASSERT_EQUAL_MEMORY(sensor, friction, sizeof friction);
    }
}
#endif

/* it starts anew with each grasp, and of another grasp, or without sensors, only a sensor counts */
static void friction_is_that_of_the_present_grasp()
{
    const float sensor[3] = {1.0F, 0.75F, 0.1F}, none[3] = {};
    aminn_state_t state = loaded(1), other = state;
    float dx[AMINN_N_WRENCH], friction[3];
    other.q[0] += 0.1F;
    start_with_sensors();
    friction_of(state, sensor, friction);
    TEST_ASSERT_EQUAL_MEMORY(sensor, friction, sizeof friction);
    motion(nullptr, state, dx);
    for (float &number : dx) {
        number *= 4.0F;
    }
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_calibrate_push(&ctx, &calibrator, &state, dx));
    friction_of(other, sensor, friction);
    TEST_ASSERT_EQUAL_MEMORY(sensor, friction, sizeof friction);
    friction_of(other, nullptr, friction);
    TEST_ASSERT_EQUAL_MEMORY(none, friction, sizeof friction);
    friction_of(state, sensor, friction);
    TEST_ASSERT_EQUAL(kSlides, std::memcmp(sensor, friction, sizeof friction) != 0);
#if AMINN_N_SLIDE
    float after[AMINN_N_COEFFICIENT], fresh[AMINN_N_COEFFICIENT];
    std::memcpy(after, calibrator.friction, sizeof after);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_calibrate_push(&ctx, &calibrator, &other, dx));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_calibrate_push(&ctx, &calibrator, &state, dx));
    for (int k = 0; k < AMINN_N_COEFFICIENT; ++k) { /* but for what theta has changed by */
        TEST_ASSERT_FLOAT_WITHIN(1e-3F, after[k], calibrator.friction[k]);
    }
    std::memcpy(after, calibrator.friction, sizeof after);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_sense(&ctx, nullptr));
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_calibrate_push(&ctx, &calibrator, &state, dx));
    TEST_ASSERT_EQUAL_MEMORY(after, calibrator.friction, sizeof after);
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_calibrate_push(&ctx, &calibrator, &other, dx));
    std::fill(fresh, fresh + AMINN_N_COEFFICIENT, 1.0F);
    TEST_ASSERT_EQUAL_MEMORY(fresh, calibrator.friction, sizeof fresh);
#endif
}

static void no_sensor_says_so()
{
    const aminn_state_t state = loaded(1);
    const float wrong[][3] = {{0.5F, 0.75F, 0.1F}, {1.0F, 0.0F, 0.1F}, {1.0F, -1.0F, 0.1F}, {1.0F, 0.75F, -0.1F},
                              {1.0F, NAN, 0.1F},   {0.0F, 0.0F, NAN},  {NAN, 0.75F, 0.1F}};
    float friction[3] = {7.0F, 8.0F, 9.0F};
    const float kept[3] = {7.0F, 8.0F, 9.0F};
    start_with_sensors();
    for (const float *sensor : wrong) {
        TEST_ASSERT_EQUAL_INT(AMINN_E_SENSORS, aminn_calibrator_friction(&calibrator, &state, sensor, friction));
    }
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_calibrator_friction(nullptr, &state, nullptr, friction));
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_calibrator_friction(&calibrator, nullptr, nullptr, friction));
    TEST_ASSERT_EQUAL_INT(AMINN_E_NULL, aminn_calibrator_friction(&calibrator, &state, nullptr, nullptr));
    TEST_ASSERT_EQUAL_MEMORY(kept, friction, sizeof kept);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(a_blob_predicts_as_the_model_in_memory);
    RUN_TEST(a_model_of_another_hand_is_refused);
    RUN_TEST(the_closure_is_the_motion_of_the_contacts);
    RUN_TEST(a_state_is_predicted_from_as_with_its_closure);
    RUN_TEST(numbers_out_of_range_have_names);
    RUN_TEST(sensors_tell_networks_and_layer);
    RUN_TEST(pushes_teach_the_hand);
#if AMINN_N_SLIDE
    RUN_TEST(pushes_narrow_friction_as_the_formulas_have_it);
    RUN_TEST(likelihood_and_sensor_make_a_sensor);
#endif
    RUN_TEST(friction_is_that_of_the_present_grasp);
    RUN_TEST(no_sensor_says_so);
    return UNITY_END();
}
