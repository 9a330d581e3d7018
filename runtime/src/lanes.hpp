// What the statics compute with, so that vector registers are used where there are some:
//
//   Row         one number for each of the 6 components of the tool's motion
//   TendonRow   one number for each tendon, and one more
//   Branches    one number for each of the branches of a group: all of them, as far as a register holds them, or one
//   ContactRow  Branches for each of the 3 dimensions of a contact and, where there are tendons, one more
//
// The operations on each component are the same on every machine, so are the bits. A file for each kind of machine has the
// rows and their sums, and one the branches:
//
//   vector registers        rows_vector.hpp, lanes_vector.hpp
//   Cortex-M with an FPU    rows_cortex_m.hpp, slide_rows_cortex_m.hpp where contacts slide and are not three, lanes_scalar.hpp
//   any other               rows_plain.hpp, lanes_scalar.hpp
#ifndef AMINN_SRC_LANES_HPP
#define AMINN_SRC_LANES_HPP

#include "core.hpp" // first

#if AMINN_LANES
#include "lanes_vector.hpp"
#else
#include "lanes_scalar.hpp"
#endif

namespace aminn {
inline namespace AMINN_CORE {

constexpr int kGroups = (kBranch + kSideBySide - 1) / kSideBySide; // of branches that are computed side by side

// branches of a group; the last may have fewer than the others
constexpr int in_group(int g)
{
    return kBranch % kSideBySide == 0 || g < kGroups - 1 ? kSideBySide : kBranch % kSideBySide;
}

// zero where the number is zero, else x
AMINN_INLINE Branches where_not_zero(Branches number, Branches x)
{
    return number != 0.0F ? x : Branches{};
}

// the larger; the limit if x is no number
AMINN_INLINE Branches largest(Branches limit, Branches x)
{
    return x > limit ? x : limit;
}

// the smaller; x if it is no number
AMINN_INLINE Branches least(Branches limit, Branches x)
{
    return limit < x ? limit : x;
}

} // namespace AMINN_CORE
} // namespace aminn

#endif
