// Closure Jacobians from the hand's geometry.
#include "parts.hpp"
#include "probe.hpp"
#include "vector3.hpp"

namespace aminn {
namespace {

// v turned about a unit vector (Rodrigues)
void turn(const float *axis, const SineCosine &angle, float *v)
{
    float across[3];
    cross(axis, v, across);
    const float along = (1.0F - angle.cosine) * dot3(axis, v);
    for (int i = 0; i < 3; ++i) {
        v[i] = (angle.cosine * v[i] + angle.sine * across[i]) + along * axis[i];
    }
}

// A = [I | -[r]x], a column of either half for each axis
void tool_side(const float *r, float (*j_x)[AMINN_N_WRENCH])
{
    for (int k = 0; k < 3; ++k) {
        float axis[3] = {};
        float velocity[3];
        axis[k] = 1.0F;
        cross(axis, r, velocity);
        for (int i = 0; i < 3; ++i) {
            j_x[i][k] = axis[i];
            j_x[i][3 + k] = velocity[i];
        }
    }
}

// A coordinate's axis, and its anchor seen from that of the coordinate before it.
enum Vector { kAxis, kLink, kVectors };

// -B: column c is z_c x (contact - anchor_c), axes and anchors turned with the coordinates before them. `first` is the
// first coordinate that the branch has, q its angle.
void joint_side(const aminn_model_t &model, int b, int first, const float *q, const float *contact,
                float (*j_q)[AMINN_N_COORD])
{
    constexpr int kLast = AMINN_N_COORD - 1;
    const float *axis = model.geom_axis + 3 * AMINN_N_COORD * b;
    const float *anchor = model.geom_anchor + 3 * AMINN_N_COORD * b;
    float chain[kVectors * AMINN_N_COORD][3]; // axis and link of each coordinate
    for (int c = kLast; c >= first; --c) {
        float (*const own)[3] = chain + kVectors * c;
        __builtin_memcpy(own[kAxis], axis + 3 * c, sizeof own[kAxis]);
        __builtin_memcpy(own[kLink], anchor + 3 * c, sizeof own[kLink]);
        if (c > first) {
            subtract(own[kLink], anchor + 3 * c - 3, own[kLink]);
        }
        if (c < kLast) { // the last coordinate turns nothing that counts
            const SineCosine angle = sine_cosine(q[c - first]);
            for (int k = kVectors * (c + 1); k < kVectors * AMINN_N_COORD; ++k) {
                turn(own[kAxis], angle, chain[k]);
            }
        }
    }
    float arm[3];
    __builtin_memcpy(arm, contact, sizeof arm);
    for (int c = first; c <= kLast; ++c) {
        float velocity[3];
        subtract(arm, chain[kVectors * c + kLink], arm);
        cross(chain[kVectors * c + kAxis], arm, velocity);
        // a mere sign would go into the difference, and zeros might change theirs
        const float minus_one = -model.coord_mask[AMINN_N_COORD * b + c];
        for (int i = 0; i < 3; ++i) {
            j_q[i][c] = minus_one * velocity[i];
        }
    }
}

void fill(float *values, size_t n, float value)
{
    for (size_t i = 0; values != nullptr && i < n; ++i) {
        values[i] = value;
    }
}

} // namespace

aminn_status_t probe_closure()
{
    const Probe found = probe(); // modes are the processor's, and nothing is divided here
    return judged({found.sum, 0, found.remainder, 1});
}

bool closure(const aminn_model_t &model, const float *q, const float *x_ht,
             const float (*contacts)[AMINN_N_CONTACT_FEATURE], float (*j_x)[3][AMINN_N_WRENCH],
             float (*j_q)[3][AMINN_N_COORD])
{
    for (int i = 0; i < AMINN_N_JOINT; ++i) {
        if (__builtin_fabsf(q[i]) > kMaxAngle) {
            return false;
        }
    }
    fill(j_x[0][0], kBranch * 3 * AMINN_N_WRENCH, 0.0F);
    fill(j_q[0][0], kBranch * 3 * AMINN_N_COORD, 0.0F);
    const float *mask = model.coord_mask;
    for (int b = 0; b < kBranch; ++b) {
        int first = 0;
        while (bits_of(mask[first]) == 0) { // never the last one
            ++first;
        }
        if (contacts[b][0] != 0.0F) {
            const float *contact = contacts[b] + 1;
            float r[3];
            subtract(contact, x_ht, r);
            tool_side(r, j_x[b]);
            joint_side(model, b, first, q, contact, j_q[b]);
        }
        q += AMINN_N_COORD - first;
        mask += AMINN_N_COORD;
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
        fill(j_x == nullptr ? nullptr : &j_x[0][0][0], AMINN_N_BRANCH * 3 * AMINN_N_WRENCH, __builtin_nanf(""));
        fill(j_q == nullptr ? nullptr : &j_q[0][0][0], AMINN_N_BRANCH * 3 * AMINN_N_COORD, __builtin_nanf(""));
    }
    return status;
}
