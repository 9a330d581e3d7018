// Closure Jacobians from the hand's geometry.
#include "parts.hpp"

namespace aminn {
namespace {

// joint that drives each branch coordinate; -1 where there is none
constexpr int kBranchJoint[kBranch][AMINN_N_COORD] = {{0, 1, 2}, {3, 4, 5}, {-1, 6, 7}};

// v turned about the unit vector axis by angle (Rodrigues)
Vec3 rotate(const Vec3 &axis, float angle, const Vec3 &v)
{
    const float s = std::sin(angle);
    const float c = std::cos(angle);
    return c * v + s * axis.cross(v) + (1.0F - c) * axis.dot(v) * axis;
}

// A = [I | -[r]x]
void tool_side(const Vec3 &r, float (*j_x)[AMINN_N_WRENCH])
{
    Mat36Map a(&j_x[0][0]);
    a.setZero();
    a(0, 0) = a(1, 1) = a(2, 2) = 1.0F;
    a(0, 4) = r.z();
    a(0, 5) = -r.y();
    a(1, 3) = -r.z();
    a(1, 5) = r.x();
    a(2, 3) = r.y();
    a(2, 4) = -r.x();
}

// -B, B = [z1 x s, z2 x s, z3 x (s - a)], s from the base to the contact; axes and link turned with the joints
void joint_side(const aminn_model_t &model, int b, const float *q, const Vec3 &contact, float (*j_q)[AMINN_N_COORD])
{
    const float *axes = model.geom_axis + 9 * b;
    const float *mask = model.coord_mask + 3 * b;
    const int *joint = kBranchJoint[b];
    const Vec3 z1 = ConstVec3Map(axes);
    Vec3 z2 = ConstVec3Map(axes + 3);
    Vec3 z3 = ConstVec3Map(axes + 6);
    Vec3 a = ConstVec3Map(model.geom_link_a + 3 * b);
    z3 = rotate(z2, q[joint[1]], z3);
    a = rotate(z2, q[joint[1]], a);
    if (joint[0] >= 0) {
        const float roll = q[joint[0]];
        z2 = rotate(z1, roll, z2);
        z3 = rotate(z1, roll, z3);
        a = rotate(z1, roll, a);
    }
    const Vec3 s = contact - ConstVec3Map(model.geom_base + 3 * b);
    Mat3Map out(&j_q[0][0]);
    out.col(0) = -mask[0] * z1.cross(s);
    out.col(1) = -mask[1] * z2.cross(s);
    out.col(2) = -mask[2] * z3.cross(s - a);
}

} // namespace

void closure(const aminn_model_t &model, const float *q, const float *x_ht,
             const float (*contacts)[AMINN_N_CONTACT_FEATURE], float (*j_x)[3][AMINN_N_WRENCH],
             float (*j_q)[3][AMINN_N_COORD])
{
    for (int b = 0; b < kBranch; ++b) {
        if (contacts[b][0] == 0.0F) {
            Mat36Map(&j_x[b][0][0]).setZero();
            Mat3Map(&j_q[b][0][0]).setZero();
            continue;
        }
        const Vec3 contact = ConstVec3Map(contacts[b] + 1);
        tool_side(contact - ConstVec3Map(x_ht), j_x[b]);
        joint_side(model, b, q, contact, j_q[b]);
    }
}

} // namespace aminn

aminn_status_t aminn_closure(const aminn_model_t *model, const float q[AMINN_N_JOINT], const float x_ht[AMINN_N_WRENCH],
                             const float contacts[AMINN_N_BRANCH][AMINN_N_CONTACT_FEATURE],
                             float j_x[AMINN_N_BRANCH][3][AMINN_N_WRENCH], float j_q[AMINN_N_BRANCH][3][AMINN_N_COORD])
{
    using namespace aminn;
    aminn_status_t status = AMINN_OK;
    if (model == nullptr || q == nullptr || x_ht == nullptr || contacts == nullptr || j_x == nullptr ||
        j_q == nullptr) {
        status = AMINN_E_NULL;
    } else if (!all_finite(q, AMINN_N_JOINT) || !all_finite(x_ht, AMINN_N_WRENCH) ||
               !all_finite(&contacts[0][0], AMINN_N_BRANCH * AMINN_N_CONTACT_FEATURE)) {
        status = AMINN_E_NONFINITE;
    } else {
        closure(*model, q, x_ht, contacts, j_x, j_q);
        return AMINN_OK;
    }
    if (j_x != nullptr) {
        Eigen::Map<Mat<AMINN_N_BRANCH * 3 * AMINN_N_WRENCH, 1>>(&j_x[0][0][0]).setConstant(NAN);
    }
    if (j_q != nullptr) {
        Eigen::Map<Mat<AMINN_N_BRANCH * 3 * AMINN_N_COORD, 1>>(&j_q[0][0][0]).setConstant(NAN);
    }
    return status;
}
