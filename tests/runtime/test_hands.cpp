/*
 * The numerical core for the hand that this is compiled for (AMINN_HAND_HEADER): it agrees with the formulas of
 * docs/mechanics.md in float64, every core gives the bits of the plain one, and what a hand lacks adds exactly nothing.
 *
 *   test_hands            runs the tests
 *   test_hands --digest   prints the CRC-32 of the plain core's outputs, for a comparison with another machine
 *   test_hands --properties N   tries N random models and inputs against the laws of hand_properties.hpp; prints counts as JSON
 *   test_hands --work N   counts predictions, of N with arbitrary heads, in which the load takes energy out of the grasp
 */
#include <cstdio>
#include <cstdlib>
#include <initializer_list>

#include "hand_digest.hpp"
#include "hand_properties.hpp"
#include "hand_reference.hpp"
#include "unity.h"

namespace aminn {
#define DECLARE_CORE(name)                                                        \
    namespace name {                                                              \
    bool run_cascade(aminn_t &ctx, const aminn_input_t &in, aminn_output_t &out); \
    }
DECLARE_CORE(core_plain)
DECLARE_CORE(core_vector)
#ifdef TEST_AVX2
DECLARE_CORE(core_avx2)
#endif
#ifdef TEST_AVX512
DECLARE_CORE(core_avx512)
#endif
} // namespace aminn

using namespace hand_case;

constexpr uint32_t kInputs = 60;
constexpr uint32_t kAll = AMINN_FLAG_ALWAYS_STAGE2 | AMINN_FLAG_DEBUG;

static Tables tables;
static aminn_model_t model;
static aminn_t plain, other;

extern "C" void setUp(void)
{
    make_model(tables, model);
}

extern "C" void tearDown(void)
{
}

static aminn_output_t run(Core core, aminn_t &ctx, const aminn_input_t &in, uint32_t flags = kAll)
{
    aminn_output_t out;
    begin(ctx, model, flags);
    std::memset(&out, 0, sizeof out);
    TEST_ASSERT_TRUE(core(ctx, in, out));
    return out;
}

/* Largest difference of two arrays over the largest entry of the second, or over `size` where that is more. */
template <class Number>
static double difference(const void *got, const Number &want, double size = 1e-30)
{
    const auto *a = static_cast<const float *>(got);
    const auto *b = reinterpret_cast<const double *>(&want);
    double worst = 0.0;
    for (size_t i = 0; i < sizeof want / sizeof *b; ++i) {
        worst = std::fmax(worst, std::fabs(static_cast<double>(a[i]) - b[i]));
        size = std::fmax(size, std::fabs(b[i]));
    }
    return worst / size;
}

static void check_springs(const aminn_stage_debug_t &got, const hand_reference::Stage &want)
{
    TEST_ASSERT_DOUBLE_WITHIN(2e-6, 0.0, difference(got.k_spring, want.k_spring));
    TEST_ASSERT_DOUBLE_WITHIN(2e-6, 0.0, difference(got.tendon_dir, want.direction));
    TEST_ASSERT_DOUBLE_WITHIN(2e-6, 0.0, difference(got.tendon_gain, want.gain));
    TEST_ASSERT_DOUBLE_WITHIN(2e-6, 0.0, difference(got.gate_params, want.gate_params));
    TEST_ASSERT_DOUBLE_WITHIN(2e-6, 0.0, difference(got.friction, want.friction));
    TEST_ASSERT_DOUBLE_WITHIN(2e-6, 0.0, difference(got.preload, want.preload, 0.1));
}

/* Of s only so many digits are there: it is what a contact gives beyond what the grasp gives, from forces that add up to the
 * load. But stiffness and motion follow from the s that was found. */
static int check_slides(int i, const aminn_input_t &in, const aminn_stage_debug_t &got, hand_reference::Stage &want)
{
    int slid = 0;
    if (kSlides) {
        double slide[B];
        for (int b = 0; b < B; ++b) {
            slide[b] = static_cast<double>(got.slide[b]);
            slid += slide[b] > 0.0 ? 1 : 0;
            TEST_ASSERT_DOUBLE_WITHIN(3e-3 * (want.give[b] + want.slide[b]), want.slide[b], slide[b]);
        }
        hand_reference::statics(model, i, in, want.k_engaged, want.twist, slide, want.k_x, want.dx);
        hand_reference::cut(model, want.dx);
    }
    return slid;
}

static int check_stage(int i, const aminn_input_t &in, const aminn_stage_debug_t &got, hand_reference::Stage &want)
{
    check_springs(got, want);
    const int slid = check_slides(i, in, got, want);
    TEST_ASSERT_DOUBLE_WITHIN(2e-5, 0.0, difference(got.dx0, want.dx0));
    TEST_ASSERT_DOUBLE_WITHIN(1e-4, 0.0, difference(got.dq0, want.dq0));
    TEST_ASSERT_DOUBLE_WITHIN(1e-4, 0.0, difference(got.gate, want.gate, 1.0));
    // of a slide in the stiffest direction of a contact there are only so many digits, too
    TEST_ASSERT_DOUBLE_WITHIN(slid > 0 ? 4e-5 : 2e-5, 0.0, difference(got.dx, want.dx));
    TEST_ASSERT_DOUBLE_WITHIN(slid > 0 ? 4e-5 : 1e-5, 0.0, difference(got.k_x, want.k_x));
    return slid;
}

static void check_against_float64(void)
{
    int slid = 0;
    for (uint32_t i = 0; i < kInputs; ++i) {
        aminn_input_t in;
        make_input(i, in);
        const aminn_output_t out = run(aminn::core_plain::run_cascade, plain, in);
        hand_reference::Reference want = hand_reference::predict(model, in, hand_reference::told_of(plain));
        const int first = check_stage(0, in, plain.stage[0], want.stage[0]);
        const int second = check_stage(1, in, plain.stage[1], want.stage[1]);
        slid += first + second;
        const double sure =
            kSlides ? 2e-4 : 1e-5; // these follow from the forces of contacts that only nearly slide, too
        TEST_ASSERT_DOUBLE_WITHIN(first > 0 ? 2e-4 : 1e-5, want.p_stable, static_cast<double>(out.p_stable));
        TEST_ASSERT_DOUBLE_WITHIN(sure, want.p_slide, static_cast<double>(out.p_slide));
        TEST_ASSERT_DOUBLE_WITHIN(sure * want.bound_95, want.bound_95, static_cast<double>(out.bound_95));
        TEST_ASSERT_DOUBLE_WITHIN(2e-3, 0.0, difference(out.friction_use, want.stage[0].use, 0.1));
        TEST_ASSERT_EQUAL_MEMORY(plain.stage[1].dx, out.dx_ht, sizeof out.dx_ht);
        TEST_ASSERT_EQUAL_MEMORY(plain.stage[1].k_x, out.k_x, sizeof out.k_x);
        TEST_ASSERT_EQUAL_MEMORY(plain.stage[1].gate, out.gate, sizeof out.gate);
    }
    const int contacts = 2 * B * static_cast<int>(kInputs);
    TEST_ASSERT_TRUE(kSlides ? 20 * slid > contacts && 2 * slid < contacts : slid == 0);
}

static void agrees_with_the_formulas_in_float64(void)
{
    check_against_float64();
}

/* the paper's way, where j_q is square */
static void agrees_where_j_q_is_inverted(void)
{
    model.dq0 = C == 3 ? AMINN_DQ0_INVERSE : AMINN_DQ0_STATICS;
    check_against_float64();
}

static void check_same_bits(Core core)
{
    for (uint32_t i = 0; i < kInputs; ++i) {
        aminn_input_t in;
        make_input(i, in);
        for (const uint32_t dq0 : {AMINN_DQ0_STATICS, AMINN_DQ0_INVERSE}) {
            model.dq0 = dq0;
            const aminn_output_t want = run(aminn::core_plain::run_cascade, plain, in);
            const aminn_output_t got = run(core, other, in);
            TEST_ASSERT_EQUAL_MEMORY(&want, &got, sizeof got);
            TEST_ASSERT_EQUAL_MEMORY(plain.stage, other.stage, sizeof plain.stage);
            const aminn_output_t quiet = run(core, other, in, AMINN_FLAG_ALWAYS_STAGE2);
            TEST_ASSERT_EQUAL_MEMORY(&want, &quiet, sizeof quiet);
        }
    }
}

static void vector_registers_give_the_same_bits(void)
{
    check_same_bits(aminn::core_vector::run_cascade);
}

#ifdef TEST_AVX2
static void avx2_gives_the_same_bits(void)
{
    if (!__builtin_cpu_supports("avx2")) {
        TEST_IGNORE_MESSAGE("this processor has no AVX2");
    }
    check_same_bits(aminn::core_avx2::run_cascade);
}
#endif

#ifdef TEST_AVX512
static void avx512_gives_the_same_bits(void)
{
    if (!__builtin_cpu_supports("avx512f") || !__builtin_cpu_supports("avx512vl")) {
        TEST_IGNORE_MESSAGE("this processor has no AVX-512");
    }
    check_same_bits(aminn::core_avx512::run_cascade);
}
#endif

/* Their gates are 0, and nothing that the head says of their tendons matters. */
static void branches_without_tendon_add_nothing(void)
{
    for (uint32_t i = 0; i < kInputs; ++i) {
        aminn_input_t in;
        setUp();
        make_input(i, in);
        const aminn_output_t before = run(aminn::core_plain::run_cascade, plain, in);
        for (int b = 0; b < B; ++b) {
            TEST_ASSERT_TRUE(has_tendon(b) ? before.gate[b] > 0.0F : before.gate[b] == 0.0F);
            for (StageTables &stage : tables.stage) {
                for (int row = kGainRow; row <= kRhoRow && G > 0 && !has_tendon(b); ++row) {
                    const bool tendon = row <= kAlphaRow || row >= kDirectionRow;
                    stage.head_b[row * B + b] += tendon ? 0.7F : 0.0F;
                }
            }
        }
        const aminn_output_t after = run(aminn::core_plain::run_cascade, other, in);
        TEST_ASSERT_EQUAL_MEMORY(&before, &after, sizeof after);
        if (G == 0 && !kSlides) {
            TEST_ASSERT_EQUAL_MEMORY(plain.stage[1].dx0, plain.stage[1].dx, sizeof plain.stage[1].dx);
        }
    }
}

static void branches_out_of_contact_have_no_influence(void)
{
    for (int b = 0; b < B; ++b) {
        aminn_input_t in;
        make_input(2, in);
        in.contacts[b][0] = 0.0F;
        const aminn_output_t before = run(aminn::core_plain::run_cascade, plain, in);
        in.contacts[b][3] += 0.2F;
        in.j_q[b][1][C - 1] += 0.05F;
        in.j_x[b][0][4] += 0.05F;
        const aminn_output_t after = run(aminn::core_plain::run_cascade, plain, in);
        TEST_ASSERT_EQUAL_MEMORY(before.dx_ht, after.dx_ht, sizeof after.dx_ht);
        TEST_ASSERT_EQUAL_MEMORY(before.k_x, after.k_x, sizeof after.k_x);
    }
}

/* The load gives its energy to the grasp, and no contact gives more than it may, whatever the heads say: also numbers that
 * no training would leave there. */
static int work_violations(Core core, int predictions, double *slid)
{
    Random random(11);
    aminn_input_t in;
    int violations = 0;
    *slid = 0.0;
    for (int i = 0; i < predictions; ++i) {
        if (i % 16 == 0) {
            const float size = i % 64 == 0 ? 30.0F : 2.0F;
            for (StageTables &stage : tables.stage) {
                random.fill(stage.head_b, AMINN_N_HEAD, -size, size);
            }
            make_input(static_cast<uint32_t>(i), in);
        }
        random.fill(in.w_e, 3, -4.0F, 4.0F);
        random.fill(in.w_e + 3, 3, -0.1F, 0.1F);
        aminn_output_t out;
        begin(other, model, AMINN_FLAG_ALWAYS_STAGE2);
        bool ok = core(other, in, out);
        for (const aminn_stage_debug_t &stage : other.stage) {
            double work = 0.0;
            for (int k = 0; k < AMINN_N_WRENCH; ++k) {
                work += static_cast<double>(in.w_e[k]) * static_cast<double>(stage.dx[k]);
            }
            ok = ok && work >= 0.0;
            for (const float slide : stage.slide) {
                ok = ok && slide >= 0.0F && slide <= 5e-3F;
                *slid += slide > 0.0F ? 0.5 / predictions / B : 0.0;
            }
        }
        violations += ok ? 0 : 1;
    }
    return violations;
}

static void the_load_gives_its_energy_to_the_grasp(void)
{
    double slid;
    TEST_ASSERT_EQUAL_INT(0, work_violations(aminn::core_vector::run_cascade, 4000, &slid));
    TEST_ASSERT_TRUE(kSlides ? slid > 0.2 && slid < 0.8 : slid == 0.0);
}

static void random_models_obey_the_laws(void)
{
    hand_properties::Law laws[hand_properties::kLaws];
    hand_properties::try_cases(aminn::core_vector::run_cascade, 400, laws);
    for (const hand_properties::Law &law : laws) {
        TEST_ASSERT_EQUAL_INT_MESSAGE(0, law.broken, law.name);
        TEST_ASSERT_TRUE_MESSAGE(law.cases > law.skipped || hand_properties::partner(0) < 0, law.name);
    }
}

int main(int argc, char **argv)
{
    if (argc > 2 && std::strcmp(argv[1], "--properties") == 0) {
        hand_properties::Law laws[hand_properties::kLaws];
        hand_properties::try_cases(aminn::core_vector::run_cascade, static_cast<uint32_t>(std::atol(argv[2])), laws);
        return hand_properties::print(laws) != 0;
    }
    if (argc > 1 && std::strcmp(argv[1], "--digest") == 0) {
        std::printf("%08x\n", static_cast<unsigned>(digest(aminn::core_plain::run_cascade, tables, model, plain)));
        return 0;
    }
    if (argc > 2 && std::strcmp(argv[1], "--work") == 0) {
        double slid;
        make_model(tables, model);
        const int violations = work_violations(aminn::core_vector::run_cascade, std::atoi(argv[2]), &slid);
        std::printf(
            "full-work violations %d in %s predictions with arbitrary heads, in which %.0f %% of contacts slid\n",
            violations, argv[2], 100.0 * slid);
        return violations != 0;
    }
    UNITY_BEGIN();
    RUN_TEST(agrees_with_the_formulas_in_float64);
    RUN_TEST(agrees_where_j_q_is_inverted);
    RUN_TEST(vector_registers_give_the_same_bits);
#ifdef TEST_AVX2
    RUN_TEST(avx2_gives_the_same_bits);
#endif
#ifdef TEST_AVX512
    RUN_TEST(avx512_gives_the_same_bits);
#endif
    RUN_TEST(branches_without_tendon_add_nothing);
    RUN_TEST(branches_out_of_contact_have_no_influence);
    RUN_TEST(the_load_gives_its_energy_to_the_grasp);
    RUN_TEST(random_models_obey_the_laws);
    return UNITY_END();
}
