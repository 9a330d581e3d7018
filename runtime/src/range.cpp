// Which number of a state lies outside what the model was trained on, and its name.
#include "parts.hpp"
#include "words.hpp"

namespace {

#define AMINN_XYZ(before, after) before "x" after "\0" before "y" after "\0" before "z" after "\0"
#define AMINN_CONTACT(b) \
    b ".in_contact\0" AMINN_XYZ(b ".position_", "_m") AMINN_XYZ(b ".normal_", "") b ".normal_force_N\0"

#define AMINN_ANGLE(joint) "q." joint "_rad\0"

// in the order of aminn_state_t, and what stands for none
constexpr char kNames[] = // clang-format off
    AMINN_JOINT_NAMES(AMINN_ANGLE)
    AMINN_XYZ("x_ht.position_", "_m")
    AMINN_XYZ("x_ht.rotation_", "_rad")
    AMINN_XYZ("w_e.force_", "_N")
    AMINN_XYZ("w_e.moment_", "_Nm")
    AMINN_CONTACT("contacts[0]")
    AMINN_CONTACT("contacts[1]")
#if AMINN_N_BRANCH > 2
    AMINN_CONTACT("contacts[2]")
#endif
#if AMINN_N_BRANCH > 3
    AMINN_CONTACT("contacts[3]")
#endif
#if AMINN_N_BRANCH > 4
    AMINN_CONTACT("contacts[4]")
#endif
    "none"; // clang-format on

static_assert(aminn::texts_in(kNames) == AMINN_N_STATE + 1, "AMINN_JOINT_NAMES (aminn_hand.h) names each joint once");

} // namespace

int aminn_first_out_of_range(const aminn_model_t *model, const aminn_state_t *state)
{
    if (model == nullptr || state == nullptr) {
        return -1;
    }
    const auto *numbers = reinterpret_cast<const float *>(state);
    for (int i = 0; i < AMINN_N_STATE; ++i) {
        const int in_row = i < aminn::kContacts ? 0 : (i - aminn::kContacts) % AMINN_N_CONTACT_FEATURE;
        const bool counts = in_row == 0 || numbers[i - in_row] > 0.0F;
        if (counts && (numbers[i] < model->range_min[i] || numbers[i] > model->range_max[i])) {
            return i;
        }
    }
    return -1;
}

const char *aminn_field_name(int index)
{
    return aminn::text_of(kNames, static_cast<unsigned>(index), AMINN_N_STATE);
}
