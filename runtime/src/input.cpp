// Is an input one that can be predicted from?
#include "parts.hpp"

namespace aminn {
namespace {

constexpr float kNormalTolerance = 1e-3F;
constexpr float kMaxRotation = 3.14159265F * (1.0F + 1e-3F); // pi, and room for the rounding of whoever computed it

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
            if (!(std::fabs(ConstVec3Map(contacts[b] + 4).norm() - 1.0F) <= kNormalTolerance)) {
                return AMINN_E_NORMAL;
            }
        }
    }
    return any ? AMINN_OK : AMINN_E_NO_CONTACT;
}

} // namespace

bool all_finite(const float *values, int n)
{
    for (int i = 0; i < n; ++i) {
        if (!std::isfinite(values[i])) {
            return false;
        }
    }
    return true;
}

aminn_status_t check_state(const float *x_ht, const float (*contacts)[AMINN_N_CONTACT_FEATURE])
{
    const aminn_status_t status = check_contacts(contacts);
    if (status == AMINN_E_CONTACT_FLAG || status == AMINN_E_NORMAL) {
        return status;
    }
    // a bad rotation comes before a missing contact in the order that the header promises
    return ConstVec3Map(x_ht + 3).norm() <= kMaxRotation ? status : AMINN_E_ROTATION;
}

} // namespace aminn
