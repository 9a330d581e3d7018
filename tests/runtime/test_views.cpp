// aminn_rt.hpp: Eigen views onto the C structs
#include "aminn_rt.hpp"

#include "aminn_model.h"

extern "C" {
#include "unity.h"

void setUp(void)
{
}

void tearDown(void)
{
}
}

static void views_point_into_the_structs()
{
    aminn_input_t in{};
    aminn::view::joints(in).setLinSpaced(1.0F, 8.0F);
    TEST_ASSERT_EQUAL_FLOAT(8.0F, in.q[7]);
    aminn::view::force(in) << 1.0F, 2.0F, 3.0F;
    aminn::view::moment(in) << 4.0F, 5.0F, 6.0F;
    TEST_ASSERT_EQUAL_FLOAT(3.0F, in.w_e[2]);
    TEST_ASSERT_EQUAL_FLOAT(4.0F, in.w_e[3]);
    aminn::view::tool_position(in).setConstant(0.5F);
    aminn::view::tool_rotation(in).setConstant(0.25F);
    TEST_ASSERT_EQUAL_FLOAT(0.5F, in.x_ht[2]);
    TEST_ASSERT_EQUAL_FLOAT(0.25F, in.x_ht[3]);
}

static void matrices_are_row_major()
{
    aminn_input_t in{};
    aminn::view::contacts(in)(2, 1) = 7.0F;
    TEST_ASSERT_EQUAL_FLOAT(7.0F, in.contacts[2][1]);
    aminn::view::tool_jacobian(in, 1)(2, 5) = 8.0F;
    TEST_ASSERT_EQUAL_FLOAT(8.0F, in.j_x[1][2][5]);
    aminn::view::joint_jacobian(in, 2)(0, 2) = 9.0F;
    TEST_ASSERT_EQUAL_FLOAT(9.0F, in.j_q[2][0][2]);
}

static void outputs_can_be_read_from_const()
{
    aminn_output_t out{};
    out.dx_ht[0] = 1.0F;
    out.dx_ht[5] = 2.0F;
    out.k_x[1][4] = 3.0F;
    out.gate[2] = 4.0F;
    const aminn_output_t &fixed = out;
    TEST_ASSERT_EQUAL_FLOAT(1.0F, aminn::view::translation(fixed).x());
    TEST_ASSERT_EQUAL_FLOAT(2.0F, aminn::view::rotation(fixed).z());
    TEST_ASSERT_EQUAL_FLOAT(2.0F, aminn::view::displacement(fixed)(5));
    TEST_ASSERT_EQUAL_FLOAT(3.0F, aminn::view::stiffness(fixed)(1, 4));
    TEST_ASSERT_EQUAL_FLOAT(4.0F, aminn::view::gates(fixed)(2));
}

static void the_c_header_works_from_cpp()
{
    static aminn_t ctx;
    aminn_output_t out{};
    aminn_state_t state{};
    TEST_ASSERT_EQUAL_INT(AMINN_OK, aminn_init(&ctx, &aminn_model, 0));
    TEST_ASSERT_EQUAL_INT(AMINN_E_NO_CONTACT, aminn_predict_state(&ctx, &state, &out));
}

int main()
{
    UNITY_BEGIN();
    RUN_TEST(views_point_into_the_structs);
    RUN_TEST(matrices_are_row_major);
    RUN_TEST(outputs_can_be_read_from_const);
    RUN_TEST(the_c_header_works_from_cpp);
    return UNITY_END();
}
