// Is an input one that can be predicted from?
#include "parts.hpp"
#include "vector3.hpp"

namespace aminn {
namespace {

constexpr float kNormalTolerance = 1e-3F;
constexpr float kUnitSquare = 1.0F + kNormalTolerance * kNormalTolerance; // middle of (1 - tolerance)^2 and
constexpr float kUnitRange = 2.0F * kNormalTolerance;                     // (1 + tolerance)^2, and half their distance
constexpr float kMaxRotation = 3.14159265F * (1.0F + 1e-3F); // pi, and room for the rounding of whoever computed it

// any of these numbers of a state
AMINN_FUNCTION bool outside(const aminn_model_t &model, const float *state, int from, int to)
{
    unsigned any = 0;
    for (int i = from; i < to; ++i) {
        any |=
            static_cast<unsigned>(state[i] < model.range_min[i]) | static_cast<unsigned>(state[i] > model.range_max[i]);
    }
    return any != 0;
}

} // namespace

bool all_finite(const float *values, int n)
{
    uint32_t any = 0; // the top bit: of a sum that only an exponent of ones carries into it
    for (int i = 0; i < n; ++i) {
        any |= (bits_of(values[i]) & 0x7F800000u) + 0x00800000u;
    }
    return any >> 31 == 0;
}

bool in_training_range(const aminn_model_t &model, const float *state)
{
    bool beyond = outside(model, state, 0, kContacts);
    for (int i = kContacts; i < AMINN_N_STATE; i += AMINN_N_CONTACT_FEATURE) {
        // a branch out of contact has no numbers but its flag
        beyond |= outside(model, state, i, i + (state[i] > 0.0F ? AMINN_N_CONTACT_FEATURE : 1));
    }
    return !beyond;
}

aminn_status_t check_input(const float *numbers, int n)
{
    if (!all_finite(numbers, n)) {
        return AMINN_E_NONFINITE;
    }
    aminn_status_t status = AMINN_E_NO_CONTACT;
    for (int i = kContacts; i < AMINN_N_STATE; i += AMINN_N_CONTACT_FEATURE) {
        const float flag = numbers[i] + 0.0F; // no -0
        const float *normal = numbers + i + 4;
        if (!within(flag, 0, kOneBits)) {
            return AMINN_E_CONTACT_FLAG; // of any branch: before a normal
        }
        if (bits_of(flag) != 0 && status != AMINN_E_NORMAL) {
            status = __builtin_fabsf(dot3(normal, normal) - kUnitSquare) <= kUnitRange ? AMINN_OK : AMINN_E_NORMAL;
        }
    }
    const float *rotation = numbers + AMINN_N_JOINT + 3;
    const bool turned = dot3(rotation, rotation) > kMaxRotation * kMaxRotation;
    return turned && status != AMINN_E_NORMAL ? AMINN_E_ROTATION : status;
}

} // namespace aminn
