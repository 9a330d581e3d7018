// Closure Jacobians from the hand's geometry.
#include "parts.hpp"

namespace aminn {
namespace {

// joint that drives each branch coordinate; -1 where there is none
constexpr int kBranchJoint[kBranch][AMINN_N_COORD] = {{0, 1, 2}, {3, 4, 5}, {-1, 6, 7}};

struct Vec3 {
    float x, y, z;
};

AMINN_FUNCTION Vec3 load(const float *p)
{
    return {p[0], p[1], p[2]};
}

AMINN_FUNCTION Vec3 subtract(const Vec3 &a, const Vec3 &b)
{
    return {a.x - b.x, a.y - b.y, a.z - b.z};
}

AMINN_FUNCTION Vec3 cross(const Vec3 &a, const Vec3 &b)
{
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

// v turned about a unit vector (Rodrigues)
AMINN_FUNCTION Vec3 turn(const Vec3 &axis, const SineCosine &angle, const Vec3 &v)
{
    const Vec3 across = cross(axis, v);
    const float along = (1.0F - angle.cosine) * ((axis.x * v.x + axis.y * v.y) + axis.z * v.z);
    return {(angle.cosine * v.x + angle.sine * across.x) + along * axis.x,
            (angle.cosine * v.y + angle.sine * across.y) + along * axis.y,
            (angle.cosine * v.z + angle.sine * across.z) + along * axis.z};
}

// A = [I | -[r]x]
void tool_side(const Vec3 &r, float (*j_x)[AMINN_N_WRENCH])
{
    for (int i = 0; i < 3; ++i) {
        for (int k = 0; k < AMINN_N_WRENCH; ++k) {
            j_x[i][k] = i == k ? 1.0F : 0.0F;
        }
    }
    j_x[0][4] = r.z;
    j_x[0][5] = -r.y;
    j_x[1][3] = -r.z;
    j_x[1][5] = r.x;
    j_x[2][3] = r.y;
    j_x[2][4] = -r.x;
}

// -B, B = [z1 x s, z2 x s, z3 x (s - a)], s from the base to the contact; axes and link turned with the joints
void joint_side(const aminn_model_t &model, int b, const float *q, const Vec3 &contact, float (*j_q)[AMINN_N_COORD])
{
    const float *axes = model.geom_axis + 9 * b;
    const float *mask = model.coord_mask + 3 * b;
    const int *joint = kBranchJoint[b];
    Vec3 z[AMINN_N_COORD] = {load(axes), load(axes + 3), load(axes + 6)};
    Vec3 a = load(model.geom_link_a + 3 * b);
    const SineCosine proximal = sine_cosine(q[joint[1]]);
    z[2] = turn(z[1], proximal, z[2]);
    a = turn(z[1], proximal, a);
    if (joint[0] >= 0) {
        const SineCosine roll = sine_cosine(q[joint[0]]);
        z[1] = turn(z[0], roll, z[1]);
        z[2] = turn(z[0], roll, z[2]);
        a = turn(z[0], roll, a);
    }
    Vec3 arm = subtract(contact, load(model.geom_base + 3 * b));
    for (int c = 0; c < AMINN_N_COORD; ++c) {
        if (c == AMINN_N_COORD - 1) {
            arm = subtract(arm, a);
        }
        const Vec3 velocity = cross(z[c], arm);
        j_q[0][c] = -mask[c] * velocity.x;
        j_q[1][c] = -mask[c] * velocity.y;
        j_q[2][c] = -mask[c] * velocity.z;
    }
}

void fill(float *values, size_t n, float value)
{
    for (size_t i = 0; values != nullptr && i < n; ++i) {
        values[i] = value;
    }
}

} // namespace

bool closure(const aminn_model_t &model, const float *q, const float *x_ht,
             const float (*contacts)[AMINN_N_CONTACT_FEATURE], float (*j_x)[3][AMINN_N_WRENCH],
             float (*j_q)[3][AMINN_N_COORD])
{
    for (int i = 0; i < AMINN_N_JOINT; ++i) {
        if (std::fabs(q[i]) > kMaxAngle) {
            return false;
        }
    }
    for (int b = 0; b < kBranch; ++b) {
        if (contacts[b][0] == 0.0F) {
            fill(j_x[b][0], 3 * AMINN_N_WRENCH, 0.0F);
            fill(j_q[b][0], 3 * AMINN_N_COORD, 0.0F);
            continue;
        }
        const Vec3 contact = load(contacts[b] + 1);
        tool_side(subtract(contact, load(x_ht)), j_x[b]);
        joint_side(model, b, q, contact, j_q[b]);
    }
    return true;
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
    } else if (!closure(*model, q, x_ht, contacts, j_x, j_q)) {
        status = AMINN_E_NUMERIC;
    }
    if (status != AMINN_OK) {
        fill(j_x == nullptr ? nullptr : &j_x[0][0][0], AMINN_N_BRANCH * 3 * AMINN_N_WRENCH, NAN);
        fill(j_q == nullptr ? nullptr : &j_q[0][0][0], AMINN_N_BRANCH * 3 * AMINN_N_COORD, NAN);
    }
    return status;
}
