// A block of a layer, written for the registers of a Cortex-M with an FPU.
#ifndef AMINN_SRC_DENSE_BLOCK_CORTEX_M_HPP
#define AMINN_SRC_DENSE_BLOCK_CORTEX_M_HPP

#include "lanes.hpp"
#include "weights.hpp"

namespace aminn {
inline namespace AMINN_CORE {

constexpr int kBlock = 8;

// a row of weights into s16-s23; of less than 4 bytes each it may begin anywhere, so core registers load it
#define AMINN_ROW_OF_FLOAT32 "    vldmia %[w], {s16-s23}\n    add %[w], %[step]\n"
#define AMINN_ROW_OF_FLOAT16                                                                                           \
    "    ldr %[t], [%[w]]\n    ldr %[u], [%[w], #4]\n    vmov s16, s17, %[t], %[u]\n"                                  \
    "    ldr %[t], [%[w], #8]\n    ldr %[u], [%[w], #12]\n    vmov s18, s19, %[t], %[u]\n    add %[w], %[step]\n"      \
    "    vcvtt.f32.f16 s23, s19\n    vcvtb.f32.f16 s22, s19\n    vcvtt.f32.f16 s21, s18\n    vcvtb.f32.f16 s20, s18\n" \
    "    vcvtt.f32.f16 s19, s17\n    vcvtb.f32.f16 s18, s17\n    vcvtt.f32.f16 s17, s16\n    vcvtb.f32.f16 s16, s16\n"
#define AMINN_FOUR_OF_INT8(a, b, c, d)                                                              \
    "    sxtb %[u], %[t]\n    sxtb %[v], %[t], ror #8\n    vmov " a ", " b ", %[u], %[v]\n"         \
    "    sxtb %[u], %[t], ror #16\n    asrs %[t], %[t], #24\n    vmov " c ", " d ", %[u], %[t]\n"   \
    "    vcvt.f32.s32 " a ", " a "\n    vcvt.f32.s32 " b ", " b "\n    vcvt.f32.s32 " c ", " c "\n" \
    "    vcvt.f32.s32 " d ", " d "\n"
#define AMINN_ROW_OF_INT8                        \
    "    ldr %[t], [%[w]]\n" AMINN_FOUR_OF_INT8( \
        "s16", "s17", "s18",                     \
        "s19") "    ldr %[t], [%[w], #4]\n    add %[w], %[step]\n" AMINN_FOUR_OF_INT8("s20", "s21", "s22", "s23")

// that times one input, added to the even sums s0-s7 or to the odd sums s8-s15
#define AMINN_ADD_EVEN(row)                                                                 \
    row "    vmla.f32 s0, s16, s24\n    vmla.f32 s1, s17, s24\n    vmla.f32 s2, s18, s24\n" \
        "    vmla.f32 s3, s19, s24\n    vmla.f32 s4, s20, s24\n    vmla.f32 s5, s21, s24\n" \
        "    vmla.f32 s6, s22, s24\n    vmla.f32 s7, s23, s24\n"
#define AMINN_ADD_ODD(row)                                                                     \
    row "    vmla.f32 s8, s16, s25\n    vmla.f32 s9, s17, s25\n    vmla.f32 s10, s18, s25\n"   \
        "    vmla.f32 s11, s19, s25\n    vmla.f32 s12, s20, s25\n    vmla.f32 s13, s21, s25\n" \
        "    vmla.f32 s14, s22, s25\n    vmla.f32 s15, s23, s25\n"
#define AMINN_BLOCK_OF(row)                                                                                          \
    "    vldmia %[b], {s0-s7}\n"                                                                                     \
    "    vldmia %[zero], {s8-s15}\n"                                                                                 \
    "    b 2f\n"                                                                                                     \
    "1:  vldmia %[x]!, {s24-s25}\n" AMINN_ADD_EVEN(row)                                                              \
        AMINN_ADD_ODD(row) "2:  subs %[n], #2\n"                                                                     \
                           "    bge 1b\n"                                                                            \
                           "    adds %[n], #1\n"                                                                     \
                           "    blt 3f\n"                                                                            \
                           "    vldr s24, [%[x]]\n" AMINN_ADD_EVEN(                                                  \
                               row) "3:  vadd.f32 s0, s0, s8\n    vadd.f32 s1, s1, s9\n    vadd.f32 s2, s2, s10\n"   \
                                    "    vadd.f32 s3, s3, s11\n    vadd.f32 s4, s4, s12\n    vadd.f32 s5, s5, s13\n" \
                                    "    vadd.f32 s6, s6, s14\n    vadd.f32 s7, s7, s15\n"                           \
                                    "    vstmia %[y], {s0-s7}"
#define AMINN_BLOCK_REGISTERS                                                                                    \
    "s0", "s1", "s2", "s3", "s4", "s5", "s6", "s7", "s8", "s9", "s10", "s11", "s12", "s13", "s14", "s15", "s16", \
        "s17", "s18", "s19", "s20", "s21", "s22", "s23", "s24", "s25", "cc", "memory"

// y = the sums of the products of x and kBlock outputs' weights, to which b is added first
inline void dense_block(const float *w, int step, const float *b, const float *x, int n_in, float *y)
{
    __asm volatile(AMINN_BLOCK_OF(AMINN_ROW_OF_FLOAT32)
                   : [w] "+&r"(w), [x] "+&r"(x), [n] "+&r"(n_in)
                   : [b] "r"(b), [y] "r"(y), [step] "r"(step * static_cast<int>(sizeof *w)), [zero] "r"(kMinusZeros)
                   : AMINN_BLOCK_REGISTERS);
}
inline void dense_block(const uint16_t *w, int step, const float *b, const float *x, int n_in, float *y)
{
    uint32_t t;
    uint32_t u;
    __asm volatile(AMINN_BLOCK_OF(AMINN_ROW_OF_FLOAT16)
                   : [w] "+&r"(w), [x] "+&r"(x), [n] "+&r"(n_in), [t] "=&r"(t), [u] "=&r"(u)
                   : [b] "r"(b), [y] "r"(y), [step] "r"(step * static_cast<int>(sizeof *w)), [zero] "r"(kMinusZeros)
                   : AMINN_BLOCK_REGISTERS);
}
// of steps: no bias
inline void dense_block(const int8_t *w, int step, const float *, const float *x, int n_in, float *y)
{
    uint32_t t;
    uint32_t u;
    uint32_t v;
    __asm volatile(AMINN_BLOCK_OF(AMINN_ROW_OF_INT8)
                   : [w] "+&r"(w), [x] "+&r"(x), [n] "+&r"(n_in), [t] "=&r"(t), [u] "=&r"(u), [v] "=&r"(v)
                   : [b] "r"(kMinusZeros), [y] "r"(y), [step] "r"(step), [zero] "r"(kMinusZeros)
                   : AMINN_BLOCK_REGISTERS);
}

} // namespace AMINN_CORE
} // namespace aminn

#endif
