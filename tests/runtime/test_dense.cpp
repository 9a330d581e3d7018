/* dense.hpp: layers of every width and every type of weights give the bits of the plain loop, at all blocks' edges */
#include <cmath>
#include <initializer_list>

#include "dense.hpp"

#include "unity.h"

using namespace aminn;

enum { MAX_IN = 7, MAX_OUT = 130 };

static float weights[MAX_IN * MAX_OUT], bias[MAX_OUT], x[MAX_IN];
static uint16_t half[MAX_IN * MAX_OUT];
static int8_t steps[MAX_IN * MAX_OUT];

extern "C" void setUp(void)
{
    uint32_t state = 1;
    const auto random = [&state] {
        state = state * 1664525u + 1013904223u;
        return static_cast<float>(static_cast<int32_t>(state)) * 0x1p-31F;
    };
    for (float &value : bias) {
        value = random();
    }
    for (float &value : x) {
        value = random();
    }
    for (int i = 0; i < MAX_IN * MAX_OUT; ++i) {
        half[i] = static_cast<uint16_t>(i % 3 == 0 ? 0xB8A3 + i % 512 : 0x3411 + i % 900); /* -0.58 .., 0.25 .. */
        steps[i] = static_cast<int8_t>(i * 7 % 256 - 128);
        weights[i] = random();
    }
}

extern "C" void tearDown(void)
{
}

template <class Weight>
static float sum_of(const Weight *w, float even, int n_in, int n_out, int output)
{
    float odd = -0.0F;
    for (int i = 0; i < n_in; ++i) {
        float &sum = i % 2 == 0 ? even : odd;
        sum = sum + static_cast<float>(w[i * n_out + output]) * x[i];
    }
    return even + odd;
}

static aminn_model_t model_of(uint32_t type)
{
    aminn_model_t model = {};
    model.weight_type = type;
    model.storage = type == AMINN_WEIGHTS_FLOAT16 ? &aminn_storage_float16
                    : type == AMINN_WEIGHTS_INT8  ? &aminn_storage_int8
                                                  : nullptr;
    return model;
}

template <class Expected>
static void check(const void *w, uint32_t type, const float *b, int n_in, int n_out, float floor, Expected expected)
{
    float y[MAX_OUT + 1];
    y[n_out] = -7.0F; /* nothing is written behind the outputs */
    dense(model_of(type), w, b, x, n_in, n_out, floor, y);
    for (int i = 0; i < n_out; ++i) {
        const float sum = expected(i), value = sum < floor ? 0.0F : sum;
        TEST_ASSERT_EQUAL_MEMORY(&value, &y[i], sizeof value);
    }
    TEST_ASSERT_EQUAL_FLOAT(-7.0F, y[n_out]);
}

static void check(const void *w, uint32_t type, const float *same, int n_in, int n_out, float floor)
{
    check(w, type, bias, n_in, n_out, floor, [=](int i) { return sum_of(same, bias[i], n_in, n_out, i); });
}

static void every_width_gives_the_same_bits(void)
{
    for (int n_in = MAX_IN - 1; n_in <= MAX_IN; ++n_in) {
        for (int n_out = 1; n_out <= MAX_OUT; ++n_out) {
            check(weights, AMINN_WEIGHTS_FLOAT32, weights, n_in, n_out, kLinear);
            check(weights, AMINN_WEIGHTS_FLOAT32, weights, n_in, n_out, kRectified);
        }
    }
}

static void half_weights_are_those_numbers(void)
{
    static float same[MAX_IN * MAX_OUT];
    for (int i = 0; i < MAX_IN * MAX_OUT; ++i) {
        same[i] = value_of(half[i]);
    }
    for (int n_out = 1; n_out <= MAX_OUT; ++n_out) {
        check(half, AMINN_WEIGHTS_FLOAT16, same, MAX_IN, n_out, kRectified);
    }
}

/* steps are added up, then scaled, then comes the bias */
static void int8_weights_are_steps(void)
{
    static float both[2 * MAX_OUT]; /* biases, and the sizes of steps behind them */
    for (int n_in = 1; n_in <= MAX_IN; ++n_in) {
        for (int n_out = 1; n_out <= MAX_OUT; ++n_out) {
            for (int i = 0; i < n_out; ++i) {
                both[i] = bias[i];
                both[n_out + i] = 1e-3F * static_cast<float>(i + 1);
            }
            for (const float floor : {kLinear, kRectified}) {
                check(steps, AMINN_WEIGHTS_INT8, both, n_in, n_out, floor,
                      [=](int i) { return sum_of(steps, -0.0F, n_in, n_out, i) * both[n_out + i] + both[i]; });
            }
        }
    }
}

static void what_is_no_number_stays(void)
{
    float y[MAX_OUT];
    x[2] = NAN;
    dense(model_of(AMINN_WEIGHTS_FLOAT32), weights, bias, x, MAX_IN, MAX_OUT, kRectified, y);
    for (const float value : y) {
        TEST_ASSERT_FLOAT_IS_NAN(value);
    }
}

int main(void)
{
#if defined(__AVX512F__)
    const bool supported = __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl");
#elif defined(__AVX2__)
    const bool supported = __builtin_cpu_supports("avx2");
#else
    const bool supported = true;
#endif
    if (!supported) {
        return 77; /* skipped */
    }
    UNITY_BEGIN();
    RUN_TEST(every_width_gives_the_same_bits);
    RUN_TEST(half_weights_are_those_numbers);
    RUN_TEST(int8_weights_are_steps);
    RUN_TEST(what_is_no_number_stays);
    return UNITY_END();
}
