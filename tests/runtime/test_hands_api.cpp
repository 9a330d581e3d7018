/*
 * The public functions for the hand that this is compiled for (AMINN_HAND_HEADER): models in memory and as a blob, those of
 * other hands, the closure beside finite differences in double, and the names of a state's numbers.
 */
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
    TEST_ASSERT_TRUE(before > 0.005 && after < (kSlides ? 0.6 : 0.2) * before);
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
    return UNITY_END();
}
