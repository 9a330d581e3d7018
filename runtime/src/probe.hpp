// What compiler options and processor modes did to the arithmetic, told from a few results. Part of the core, since options
// are those of a source: a probe in another one would say nothing of it.
#ifndef AMINN_SRC_PROBE_HPP
#define AMINN_SRC_PROBE_HPP

#include "elementary.hpp"

namespace aminn {
inline namespace AMINN_CORE {

constexpr float kUlp = 0x1p-23F; // of 1
constexpr float kShare = 0.75F * kUlp;

// Bits of results, each of which has one right value.
struct Probe {
    uint32_t up;         // rounded up to a unit
    uint32_t down;       // rounded down to nothing
    uint32_t by_inverse; // nothing: divisions undone
    uint32_t remainder;  // nothing: a product, minus that product as it was rounded
    uint32_t doubled;    // the smallest normal number, out of half of it
};

// Every number is read at run time, so that the compiler cannot compute here what the processor should.
static Probe probe()
{
    // the latter are a factor, and minus its square, which rounding changes
    static const float kNumbers[] = {kShare, 0.5F * kShare, 0x1.56b8p0F, -0x1.cad024p0F, FLT_MIN};
    const volatile float *number = kNumbers;
    const float share = number[0];
    const float half_share = number[1];
    const float factor = number[2];
    const float square = number[3];
    const float half = 0.5F * number[4];
    return {
        bits_of((factor + share) - factor),
        bits_of((factor + half_share) - factor),
        // three divisions by one number are worth an inverse; square times that is not -factor
        bits_of((square / factor + factor) + (share / factor - 2.0F * (half_share / factor))),
        bits_of(factor * factor + square),
        bits_of(half + half),
    };
}

static aminn_status_t judged(const Probe &probe)
{
    const bool reordered = probe.up == bits_of(kShare); // what was added
    if (!reordered && ((probe.up ^ bits_of(kUlp)) | probe.down) != 0) {
        return AMINN_E_ROUNDING;
    }
    if (reordered || probe.by_inverse != 0) {
        return AMINN_E_FAST_MATH;
    }
    if (probe.remainder != 0) {
        return AMINN_E_CONTRACTED;
    }
    return probe.doubled == bits_of(FLT_MIN) ? AMINN_OK : AMINN_E_FLUSH;
}

} // namespace AMINN_CORE
} // namespace aminn

#endif
