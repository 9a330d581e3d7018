// What compiler options and processor modes did to the arithmetic, told from a few results. Part of the core, since options
// are those of a source: a probe in another one would say nothing of it.
#ifndef AMINN_SRC_PROBE_HPP
#define AMINN_SRC_PROBE_HPP

#include "elementary.hpp"

namespace aminn {
inline namespace AMINN_CORE {

constexpr float kUlp = 0x1p-23F; // of 1, and of the factor
constexpr float kShare = 0.625F * kUlp;
constexpr float kFactor = 0x1.56b8p0F;
constexpr float kMinusSquare = -0x1.cad024p0F; // of the factor, rounded
constexpr float kTiny = 0x1p-128F;             // subnormal

// Bits of results, each of which has one right value.
struct Probe {
    uint32_t sum;        // kUlp: a share of it and a tiny number, added to the factor, and that taken away
    uint32_t by_inverse; // zero: a division undone
    uint32_t remainder;  // zero: a product, minus that product as it was rounded
    uint32_t doubled;    // not zero: a subnormal number times two
};

// Every number is read at run time, so that the compiler cannot compute here what the processor should.
static Probe probe()
{
    static const float kNumbers[] = {kShare, kFactor, kMinusSquare, kTiny};
    const volatile float *number = kNumbers;
    const float share = number[0];
    const float factor = number[1];
    const float minus_square = number[2];
    const float tiny = number[3];
    return {
        bits_of(((factor + share) + tiny) - factor),
        // three divisions by one number are worth an inverse; the first is -factor, in which the others vanish
        bits_of(((minus_square / factor + share / factor) + tiny / factor) + factor),
        bits_of(factor * factor + minus_square),
        bits_of(tiny + tiny),
    };
}

static aminn_status_t judged(const Probe &probe)
{
    const uint32_t reordered =
        probe.sum << 9; // a whole number of units, rounded in whatever way, has none of these bits
    int status = probe.doubled != 0 ? AMINN_OK : AMINN_E_FLUSH;
    if (probe.remainder != 0) {
        status = AMINN_E_CONTRACTED;
    }
    if ((reordered | probe.by_inverse) != 0) {
        status = AMINN_E_FAST_MATH;
    }
    if (reordered == 0 && probe.sum != bits_of(kUlp)) {
        status = AMINN_E_ROUNDING;
    }
    return static_cast<aminn_status_t>(status);
}

} // namespace AMINN_CORE
} // namespace aminn

#endif
