// probe.hpp: which status follows from which results. That real options and modes give these results is shown by
// test_self_test.c and test_wrong_builds.py.
#include "probe.hpp"

#include <cmath>

#include "unity.h"

using namespace aminn;

extern "C" void setUp()
{
}

extern "C" void tearDown()
{
}

namespace {

// what a correct build measures, with one result changed
#define JUDGED(status, field, value)                    \
    do {                                                \
        Probe changed = probe();                        \
        changed.field = bits_of(value);                 \
        TEST_ASSERT_EQUAL_INT(status, judged(changed)); \
    } while (0)

void a_correct_build_is_passed()
{
    TEST_ASSERT_EQUAL_INT(AMINN_OK, judged(probe()));
}

void rounding_comes_first()
{
    JUDGED(AMINN_E_ROUNDING, sum, 0.0F);
    JUDGED(AMINN_E_ROUNDING, sum, -0.0F);
    JUDGED(AMINN_E_ROUNDING, sum, 2.0F * kUlp);
    Probe all = {0, 1, 1, 0};
    TEST_ASSERT_EQUAL_INT(AMINN_E_ROUNDING, judged(all));
    all.sum = bits_of(kUlp);
    TEST_ASSERT_EQUAL_INT(AMINN_E_FAST_MATH, judged(all));
    all.by_inverse = 0;
    TEST_ASSERT_EQUAL_INT(AMINN_E_CONTRACTED, judged(all));
    all.remainder = 0;
    TEST_ASSERT_EQUAL_INT(AMINN_E_FLUSH, judged(all));
}

void a_sum_in_another_order_and_an_inverse_are_fast_math()
{
    JUDGED(AMINN_E_FAST_MATH, sum, kShare);
    JUDGED(AMINN_E_FAST_MATH, sum, kShare + kTiny);
    JUDGED(AMINN_E_FAST_MATH, by_inverse, kUlp);
    JUDGED(AMINN_E_FAST_MATH, by_inverse, -0.0F);
}

void what_fma_leaves_is_a_contraction()
{
    JUDGED(AMINN_E_CONTRACTED, remainder, std::fma(kFactor, kFactor, kMinusSquare));
}

void what_is_flushed_is_zero()
{
    JUDGED(AMINN_E_FLUSH, doubled, 0.0F);
}

// the numbers are chosen so that a multiplication by the inverse rounds to something else than the division
void an_inverse_is_not_a_division()
{
    const volatile float inverse = 1.0F / kFactor;
    const volatile float product = kMinusSquare * inverse;
    TEST_ASSERT_TRUE(kMinusSquare / kFactor == -kFactor);
    TEST_ASSERT_TRUE(product != -kFactor);
}

} // namespace

int main()
{
    UNITY_BEGIN();
    RUN_TEST(a_correct_build_is_passed);
    RUN_TEST(rounding_comes_first);
    RUN_TEST(a_sum_in_another_order_and_an_inverse_are_fast_math);
    RUN_TEST(what_fma_leaves_is_a_contraction);
    RUN_TEST(what_is_flushed_is_zero);
    RUN_TEST(an_inverse_is_not_a_division);
    return UNITY_END();
}
