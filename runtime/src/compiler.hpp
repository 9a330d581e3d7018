// What a compiler must not do to the library's arithmetic: undone here where a pragma can, refused where a macro tells, and
// otherwise found by aminn_self_test(). The first thing that a source of the library sees, so that what it includes is
// compiled alike: functions of other options would not be inlined. docs/runtime.md lists the options of gcc and clang.
#ifndef AMINN_SRC_COMPILER_HPP
#define AMINN_SRC_COMPILER_HPP

#if __cplusplus < 201703L
#error "the library is C++17: compile with -std=c++17 (Zephyr: CONFIG_STD_CPP17=y)"
#endif

// Helium's registers take subnormal numbers for zero, whatever FPSCR says.
#if defined(__ARM_FEATURE_MVE) && (__ARM_FEATURE_MVE & 2)
#define AMINN_HELIUM 1
#else
#define AMINN_HELIUM 0
#endif

// No fused multiply-add: every operation is rounded to float32.
#if defined(__clang__)
#pragma clang diagnostic push
#pragma clang diagnostic ignored "-Wignored-pragmas" // not of every target
#pragma float_control(precise, on)                   // takes back the parts of -ffast-math that no macro tells
#pragma clang diagnostic pop
#pragma clang fp contract(off)
#elif defined(__GNUC__) && !defined(__INTEL_COMPILER) && !defined(__NVCOMPILER) && !defined(__ICCARM__)
#pragma GCC optimize("fp-contract=off", "no-associative-math") // the latter would come back by such a pragma
#if AMINN_HELIUM
#pragma GCC optimize("no-tree-vectorize")
#endif
#if defined(__arm__) && defined(__OPTIMIZE_SIZE__) // off with -Os, but for such a pragma
#pragma GCC optimize("no-shrink-wrap")
#ifdef __SOFTFP__ // gcc 12 makes wrong code of calibrate_push.cpp with it (make fidelity: cortex_m3)
#pragma GCC optimize("no-ivopts")
#endif
#endif
#elif !defined(AMINN_RT_OTHER_COMPILER)
#error "not gcc, not clang: have it fuse, reorder, flush nothing, define AMINN_RT_OTHER_COMPILER, run aminn_self_test"
#endif

#if AMINN_HELIUM && defined(__clang__) && !defined(AMINN_RT_NOT_VECTORISED)
#error "Helium flushes to zero: add +nomve.fp, or -fno-vectorize -fno-slp-vectorize -DAMINN_RT_NOT_VECTORISED"
#elif defined(__FAST_MATH__)
#error "compile without -ffast-math and -Ofast (or with -fno-fast-math behind them): order of operations, NaN"
#elif defined(__ASSOCIATIVE_MATH__)
#error "compile without -fassociative-math and -funsafe-math-optimizations: the order of operations is lost"
#elif defined(__RECIPROCAL_MATH__)
#error "compile without -freciprocal-math: a division becomes a multiplication, which rounds twice"
#elif defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__
#error "compile without -ffinite-math-only: the checks for NaN and infinity are lost"
#elif defined(__NO_SIGNED_ZEROS__)
#error "compile without -fno-signed-zeros: sums begin with -0"
#elif defined(__FLT_EVAL_METHOD__) && __FLT_EVAL_METHOD__ != 0
#error "float operations must be rounded to float: on 32-bit x86 compile with -msse2 -mfpmath=sse"
#endif

#endif
