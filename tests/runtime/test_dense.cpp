/* dense.hpp: layers of every width and both types of weights give the bits of the plain loop, at all blocks' edges */
#include "dense.hpp"

#include "unity.h"

using namespace aminn;

enum { MAX_IN = 7, MAX_OUT = 130 };

static float weights[MAX_IN * MAX_OUT], bias[MAX_OUT], x[MAX_IN];
static uint16_t half[MAX_IN * MAX_OUT];

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
        weights[i] = random();
    }
}

extern "C" void tearDown(void)
{
}

static float expected(const float *w, int n_in, int n_out, int output, float floor)
{
    float even = bias[output], odd = 0.0F;
    for (int i = 0; i < n_in; ++i) {
        float &sum = i % 2 == 0 ? even : odd;
        sum = sum + w[i * n_out + output] * x[i];
    }
    return even + odd < floor ? 0.0F : even + odd;
}

static void check(const void *w, uint32_t type, const float *same, int n_in, int n_out, float floor)
{
    float y[MAX_OUT + 1];
    y[n_out] = -7.0F; /* nothing is written behind the outputs */
    dense(w, type, bias, x, n_in, n_out, floor, y);
    for (int i = 0; i < n_out; ++i) {
        const float value = expected(same, n_in, n_out, i, floor);
        TEST_ASSERT_EQUAL_MEMORY(&value, &y[i], sizeof value);
    }
    TEST_ASSERT_EQUAL_FLOAT(-7.0F, y[n_out]);
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

static void what_is_no_number_stays(void)
{
    float y[MAX_OUT];
    x[2] = NAN;
    dense(weights, AMINN_WEIGHTS_FLOAT32, bias, x, MAX_IN, MAX_OUT, kRectified, y);
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
    RUN_TEST(what_is_no_number_stays);
    return UNITY_END();
}
