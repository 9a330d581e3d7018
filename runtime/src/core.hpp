// What every source of the numerical core begins with.
//
// The core (network, springs, mechanics, cascade) is compiled once, or, where the instruction sets of one architecture
// differ, once for each of them under another namespace (CMakeLists.txt). All of them give the same bits: every operation
// is rounded to float32, and its order does not depend on how many lanes a register has.
#ifndef AMINN_SRC_CORE_HPP
#define AMINN_SRC_CORE_HPP

#include "compiler.hpp" // first

#include <stddef.h>

#include "aminn_rt.h"

#ifndef AMINN_CORE
#define AMINN_CORE core
#endif

#ifndef AMINN_INLINE // plain "inline" where coverage is measured
#define AMINN_INLINE [[gnu::always_inline]] inline
#endif

// Vector registers: see lanes.hpp; not those of 32-bit ARM, which take subnormal numbers for zero. AMINN_RT_SCALAR is for
// tests of the other form on the same machine.
#if (defined(__SSE2__) || (defined(__ARM_NEON) && defined(__aarch64__))) && !defined(AMINN_RT_SCALAR)
#define AMINN_LANES 1
#define AMINN_FUNCTION AMINN_INLINE
// each step has its own code: 15 rows of the reference hand, 21 of the largest, 26 where its fingertips are soft
#if AMINN_N_BRANCH > 4 && AMINN_N_TWIST > 0
#define AMINN_UNROLL_ROWS _Pragma("GCC unroll 28")
#elif AMINN_N_BRANCH > 3 || AMINN_N_TWIST > 0
#define AMINN_UNROLL_ROWS _Pragma("GCC unroll 24")
#else
#define AMINN_UNROLL_ROWS _Pragma("GCC unroll 16")
#endif
#else
#define AMINN_LANES 0
#define AMINN_FUNCTION [[gnu::noinline]] inline // small rather than fast
#define AMINN_UNROLL_ROWS
#endif

#define AMINN_ALWAYS __attribute__((always_inline)) // of a lambda
#define AMINN_UNROLL _Pragma("GCC unroll 8")        // of a contact's few rows and columns, everywhere

// Cortex-M with an FPU has VMLA, which rounds the product and the sum: the bits of two operations in one instruction. The
// compiler does not use it unless it may fuse operations, so it is asked for by name.
#if defined(__ARM_ARCH_PROFILE) && __ARM_ARCH_PROFILE == 'M' && defined(__ARM_FP)
#define AMINN_CORTEX_M 1
#else
#define AMINN_CORTEX_M 0
#endif

namespace aminn {
constexpr int kBranch = AMINN_N_BRANCH;
constexpr int kCoord = AMINN_N_COORD;
constexpr int kBelow = kCoord * (kCoord - 1) / 2; // entries of a branch's Cholesky factor below its diagonal
constexpr bool kGated = AMINN_N_GATED > 0;
constexpr bool kSomeLack = kGated && AMINN_N_GATED < kBranch; // a gated tendon: their nominal gain is zero
constexpr bool kTwisted = AMINN_N_TWIST > 0;                  // fingertips resist twisting
constexpr bool kSliding = AMINN_N_SLIDE > 0;                  // contacts can slide
constexpr float kLeastPressing = 0.01F;                       // N: below it one that can is as good as lost
constexpr int kMotion = AMINN_N_WRENCH;
constexpr int kContacts = AMINN_N_JOINT + 2 * AMINN_N_WRENCH; // numbers before them in aminn_state_t: q, x_ht, w_e

// What the kernels take for granted of a hand (aminn_hand.h).
static_assert(kBranch >= 2 && kBranch <= 5, "a hand has 2 to 5 branches: AMINN_N_BRANCH");
static_assert(kCoord >= 1 && kCoord <= 5, "a branch has 1 to 5 coordinates: AMINN_N_COORD");
static_assert(AMINN_N_JOINT >= kCoord + kBranch - 1 && AMINN_N_JOINT <= kBranch * kCoord,
              "the longest branch has AMINN_N_COORD joints, and every other one to as many: AMINN_N_JOINT");
static_assert(4 * kBranch + kMotion <= 28 && 4 * 4 + kMotion <= 24 && 3 * 3 + kMotion <= 16,
              "as many rows as AMINN_UNROLL_ROWS unrolls");
static_assert(AMINN_N_GATED >= 0 && AMINN_N_GATED <= kBranch, "a branch has one gated tendon at most: AMINN_N_GATED");
static_assert(AMINN_N_SLIDE == 0 || AMINN_N_SLIDE == 1, "contacts can slide, or they cannot: AMINN_N_SLIDE");
static_assert(AMINN_N_TWIST == 0 || AMINN_N_TWIST == kBranch, "all fingertips resist twisting, or none: AMINN_N_TWIST");
static_assert(offsetof(aminn_state_t, contacts) == kContacts * sizeof(float), "aminn_state_t has no gaps");
} // namespace aminn

#endif
