// Is an input one that can be predicted from?
#include "parts.hpp"

namespace aminn {
namespace {

constexpr float kNormalTolerance = 1e-3F;
constexpr float kMaxRotation = 3.14159265F * (1.0F + 1e-3F); // pi, and room for the rounding of whoever computed it

float length(const float v[3])
{
    return root((v[0] * v[0] + v[1] * v[1]) + v[2] * v[2]);
}

aminn_status_t check_contacts(const float (*contacts)[AMINN_N_CONTACT_FEATURE])
{
    bool any = false;
    for (int b = 0; b < kBranch; ++b) {
        if (contacts[b][0] < 0.0F || contacts[b][0] > 1.0F) {
            return AMINN_E_CONTACT_FLAG;
        }
    }
    for (int b = 0; b < kBranch; ++b) {
        if (contacts[b][0] > 0.0F) {
            any = true;
            if (!(std::fabs(length(contacts[b] + 4) - 1.0F) <= kNormalTolerance)) {
                return AMINN_E_NORMAL;
            }
        }
    }
    return any ? AMINN_OK : AMINN_E_NO_CONTACT;
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
    constexpr int kContacts = AMINN_N_JOINT + 2 * AMINN_N_WRENCH;
    unsigned outside = 0;
    int i = 0;
    const auto check = [&](int end, unsigned counts) {
        for (; i < end; ++i) {
            outside |= counts & (static_cast<unsigned>(state[i] < model.range_min[i]) |
                                 static_cast<unsigned>(state[i] > model.range_max[i]));
        }
    };
    check(kContacts, 1u);
    for (int b = 0; b < kBranch; ++b) {
        const unsigned closed = state[i] > 0.0F ? 1u : 0u;
        check(i + 1, 1u);
        check(i + AMINN_N_CONTACT_FEATURE - 1, closed); // a branch out of contact has no numbers but its flag
    }
    return outside == 0;
}

aminn_status_t check_input(const float *numbers, size_t n, const float *x_ht,
                           const float (*contacts)[AMINN_N_CONTACT_FEATURE])
{
    if (!all_finite(numbers, static_cast<int>(n))) {
        return AMINN_E_NONFINITE;
    }
    const aminn_status_t status = check_contacts(contacts);
    // a bad rotation comes before a missing contact in the order that the header promises
    const bool later = status == AMINN_OK || status == AMINN_E_NO_CONTACT;
    return later && length(x_ht + 3) > kMaxRotation ? AMINN_E_ROTATION : status;
}

} // namespace aminn
