// Names of the numbers of theta: apart from all else, so that a controller that prints none does not hold them.
#include "aminn_rt.h"
#include "words.hpp"

namespace {

#define AMINN_NAME(name) name "\0"
constexpr char kThetaNames[] = AMINN_THETA_NAMES(AMINN_NAME) "none";

static_assert(aminn::texts_in(kThetaNames) == AMINN_N_THETA + 1,
              "AMINN_THETA_NAMES (aminn_hand.h) names each number of theta once");

} // namespace

const char *aminn_theta_name(int index)
{
    return aminn::text_of(kThetaNames, static_cast<unsigned>(index), AMINN_N_THETA);
}
