// A block of a layer of float32 weights, written for the registers of a Cortex-M with an FPU.
#ifndef AMINN_SRC_DENSE_BLOCK_CORTEX_M_HPP
#define AMINN_SRC_DENSE_BLOCK_CORTEX_M_HPP

#include "lanes.hpp"

namespace aminn {
inline namespace AMINN_CORE {

constexpr int kBlock = 8;

// a row of weights times one input, added to the even sums s0-s7 or to the odd sums s8-s15
#define AMINN_LOAD_ROW "    vldmia %[w], {s16-s23}\n    add %[w], %[step]\n"
#define AMINN_ADD_EVEN                                                                                 \
    AMINN_LOAD_ROW "    vmla.f32 s0, s16, s24\n    vmla.f32 s1, s17, s24\n    vmla.f32 s2, s18, s24\n" \
                   "    vmla.f32 s3, s19, s24\n    vmla.f32 s4, s20, s24\n    vmla.f32 s5, s21, s24\n" \
                   "    vmla.f32 s6, s22, s24\n    vmla.f32 s7, s23, s24\n"
#define AMINN_ADD_ODD                                                                                     \
    AMINN_LOAD_ROW "    vmla.f32 s8, s16, s25\n    vmla.f32 s9, s17, s25\n    vmla.f32 s10, s18, s25\n"   \
                   "    vmla.f32 s11, s19, s25\n    vmla.f32 s12, s20, s25\n    vmla.f32 s13, s21, s25\n" \
                   "    vmla.f32 s14, s22, s25\n    vmla.f32 s15, s23, s25\n"

inline void dense_block(const float *w, int step, const float *b, const float *x, int n_in, float *y)
{
    __asm volatile("    vldmia %[b], {s0-s7}\n"
                   "    vldmia %[zero], {s8-s15}\n"
                   "    b 2f\n"
                   "1:  vldmia %[x]!, {s24-s25}\n" AMINN_ADD_EVEN AMINN_ADD_ODD "2:  subs %[n], #2\n"
                   "    bge 1b\n"
                   "    adds %[n], #1\n"
                   "    blt 3f\n"
                   "    vldr s24, [%[x]]\n" AMINN_ADD_EVEN "3:  vadd.f32 s0, s0, s8\n"
                   "    vadd.f32 s1, s1, s9\n"
                   "    vadd.f32 s2, s2, s10\n"
                   "    vadd.f32 s3, s3, s11\n"
                   "    vadd.f32 s4, s4, s12\n"
                   "    vadd.f32 s5, s5, s13\n"
                   "    vadd.f32 s6, s6, s14\n"
                   "    vadd.f32 s7, s7, s15\n"
                   "    vstmia %[y], {s0-s7}"
                   : [w] "+r"(w), [x] "+r"(x), [n] "+r"(n_in)
                   : [b] "r"(b), [y] "r"(y), [step] "r"(step * static_cast<int>(sizeof *w)), [zero] "r"(kMinusZeros)
                   : "s0", "s1", "s2", "s3", "s4", "s5", "s6", "s7", "s8", "s9", "s10", "s11", "s12", "s13", "s14",
                     "s15", "s16", "s17", "s18", "s19", "s20", "s21", "s22", "s23", "s24", "s25", "cc", "memory");
}

} // namespace AMINN_CORE
} // namespace aminn

#endif
