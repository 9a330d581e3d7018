/* elementary.hpp: special arguments and all quadrants; the errors themselves are aminn_ulp's (test runtime_ulp) */
#include "elementary.hpp"

#include <cfloat>
#include <cmath>

#include "unity.h"

using namespace aminn;

extern "C" void setUp(void)
{
}

extern "C" void tearDown(void)
{
}

static void exponentials_saturate(void)
{
    TEST_ASSERT_EQUAL_FLOAT(1.0F, exponential(0.0F));
    TEST_ASSERT_TRUE(exponential(1000.0F) > FLT_MAX);
    TEST_ASSERT_TRUE(exponential(INFINITY) > FLT_MAX);
    TEST_ASSERT_TRUE(exponential(-1000.0F) > 0.0F && exponential(-1000.0F) < 5e-38F);
    TEST_ASSERT_FLOAT_IS_NAN(exponential(NAN));
}

static void logarithms_keep_what_is_no_number(void)
{
    TEST_ASSERT_EQUAL_FLOAT(0.0F, logarithm(1.0F));
    TEST_ASSERT_TRUE(logarithm(INFINITY) > FLT_MAX);
    TEST_ASSERT_FLOAT_IS_NAN(logarithm(NAN));
}

static void tangents_are_odd_and_bounded(void)
{
    for (float x = 0.0F; x < 12.0F; x += 0.01F) {
        TEST_ASSERT_TRUE(hyperbolic_tangent(-x) == -hyperbolic_tangent(x));
        TEST_ASSERT_TRUE(hyperbolic_tangent(x) <= 1.0F);
    }
    TEST_ASSERT_EQUAL_FLOAT(1.0F, hyperbolic_tangent(INFINITY));
    TEST_ASSERT_EQUAL_FLOAT(-1.0F, hyperbolic_tangent(-INFINITY));
    TEST_ASSERT_FLOAT_IS_NAN(hyperbolic_tangent(NAN));
}

static void sigmoids_lie_between_0_and_1(void)
{
    TEST_ASSERT_EQUAL_FLOAT(0.5F, sigmoid(0.0F));
    TEST_ASSERT_EQUAL_FLOAT(0.0F, sigmoid(-1000.0F));
    TEST_ASSERT_EQUAL_FLOAT(1.0F, sigmoid(1000.0F));
    TEST_ASSERT_FLOAT_IS_NAN(sigmoid(NAN));
}

static void sine_and_cosine_are_right_in_all_quadrants(void)
{
    for (int i = -2000; i <= 2000; ++i) {
        const float x = 0.01F * static_cast<float>(i);
        const SineCosine s = sine_cosine(x);
        TEST_ASSERT_FLOAT_WITHIN(1e-7F, std::sin(x), s.sine);
        TEST_ASSERT_FLOAT_WITHIN(1e-7F, std::cos(x), s.cosine);
    }
}

static void products_are_rounded_before_they_are_added(void)
{
    const float x = 1.0F + FLT_EPSILON;
    const float product = x * x; /* exactly 1 + 2 eps + eps^2, of which the last part is lost */
    TEST_ASSERT_EQUAL_FLOAT(0.0F, subtract_product(product, x, x));
    TEST_ASSERT_EQUAL_FLOAT(0.0F, add_product(-product, x, x));
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(exponentials_saturate);
    RUN_TEST(logarithms_keep_what_is_no_number);
    RUN_TEST(tangents_are_odd_and_bounded);
    RUN_TEST(sigmoids_lie_between_0_and_1);
    RUN_TEST(sine_and_cosine_are_right_in_all_quadrants);
    RUN_TEST(products_are_rounded_before_they_are_added);
    return UNITY_END();
}
