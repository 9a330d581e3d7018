// Names of the numbers of theta: apart from all else, so that a controller that prints none does not hold them.
#include "aminn_rt.h"
#include "words.hpp"

namespace {

#define AMINN_NAME(name) name "\0"
constexpr char kNames[] = AMINN_THETA_NAMES(AMINN_NAME) "none";

constexpr int names()
{
    int n = 0;
    for (const char c : kNames) {
        n += c == '\0';
    }
    return n;
}
static_assert(names() == AMINN_N_THETA + 1, "AMINN_THETA_NAMES (aminn_hand.h) names each number of theta once");

} // namespace

const char *aminn_theta_name(int index)
{
    return aminn::text_of(kNames, static_cast<unsigned>(index), AMINN_N_THETA);
}
