/* status.cpp: names of status codes, version */
#include "support.h"

void setUp(void)
{
}

void tearDown(void)
{
}

static void names_come_from_the_list(void)
{
#define CHECK(name, value, text)                               \
    TEST_ASSERT_EQUAL_INT(value, name);                        \
    TEST_ASSERT_EQUAL_STRING(#name, aminn_status_name(value)); \
    TEST_ASSERT_EQUAL_STRING(text, aminn_status_text(value));
    AMINN_STATUS_LIST(CHECK)
#undef CHECK
}

static void ok_is_zero_and_errors_are_negative_and_distinct(void)
{
    static const int values[] = {
#define VALUE(name, value, text) value,
        AMINN_STATUS_LIST(VALUE)
#undef VALUE
    };
    size_t i, j;
    TEST_ASSERT_EQUAL_INT(0, AMINN_OK);
    for (i = 0; i < sizeof values / sizeof values[0]; ++i) {
        TEST_ASSERT_TRUE(values[i] <= 0);
        for (j = 0; j < i; ++j) {
            TEST_ASSERT_NOT_EQUAL_INT(values[i], values[j]);
        }
    }
}

static void other_numbers_have_a_name_too(void)
{
    TEST_ASSERT_EQUAL_STRING("AMINN_E_UNKNOWN", aminn_status_name(1));
    TEST_ASSERT_EQUAL_STRING("AMINN_E_UNKNOWN", aminn_status_name(-1000));
    TEST_ASSERT_NOT_NULL(aminn_status_text(42));
}

static void version_is_the_headers(void)
{
    char text[32];
    snprintf(text, sizeof text, "%d.%d.%d", AMINN_VERSION_MAJOR, AMINN_VERSION_MINOR, AMINN_VERSION_PATCH);
    TEST_ASSERT_EQUAL_STRING(AMINN_VERSION_STRING, text);
    TEST_ASSERT_EQUAL_STRING(AMINN_VERSION_STRING, aminn_version());
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(names_come_from_the_list);
    RUN_TEST(ok_is_zero_and_errors_are_negative_and_distinct);
    RUN_TEST(other_numbers_have_a_name_too);
    RUN_TEST(version_is_the_headers);
    return UNITY_END();
}
