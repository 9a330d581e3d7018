/* Prints what test_hands --digest prints, from an image for a Cortex-M (hands_cortex_m.cmake). */
#include "hand_digest.hpp"

extern "C" {
#include "semihosting.h"
}

namespace aminn {
inline namespace core {
bool run_cascade(aminn_t &ctx, const aminn_input_t &in, aminn_output_t &out);
}
} // namespace aminn

static hand_case::Tables tables;
static aminn_model_t model;
static aminn_t ctx;

int main()
{
    const uint32_t value = hand_case::digest(aminn::run_cascade, tables, model, ctx);
    char text[] = "00000000\n";
    for (unsigned i = 0; i < 8; ++i) {
        text[i] = "0123456789abcdef"[value >> (28 - 4 * i) & 15u];
    }
    semihost_puts(text);
    return 0;
}
