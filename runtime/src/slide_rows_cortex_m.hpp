// Rows of slides of a Cortex-M with an FPU, for hands whose rows are no Row: 4, 8 or 10 numbers, written for its registers.
#ifndef AMINN_SRC_SLIDE_ROWS_CORTEX_M_HPP
#define AMINN_SRC_SLIDE_ROWS_CORTEX_M_HPP

#include "rows_cortex_m.hpp"

namespace aminn {
inline namespace AMINN_CORE {

using SlideRow = Components<float, 2 * kBranch>;

// Sums lie in s0 and up, those over odd rows in s10 and up, a row in s20 and up; s30 and s31 hold its factor.
#define AMINN_SLIDE_EACH_OF_4(X) X(0, 10, 20) X(1, 11, 21) X(2, 12, 22) X(3, 13, 23)
#define AMINN_SLIDE_EACH_OF_8(X) AMINN_SLIDE_EACH_OF_4(X) X(4, 14, 24) X(5, 15, 25) X(6, 16, 26) X(7, 17, 27)
#define AMINN_SLIDE_EACH_OF_10(X) AMINN_SLIDE_EACH_OF_8(X) X(8, 18, 28) X(9, 19, 29)
#if AMINN_N_BRANCH == 2
#define AMINN_SLIDE_EACH(X) AMINN_SLIDE_EACH_OF_4(X)
#define AMINN_SLIDE_SUMS "{s0-s3}"
#define AMINN_SLIDE_ROW "{s20-s23}"
#elif AMINN_N_BRANCH == 4
#define AMINN_SLIDE_EACH(X) AMINN_SLIDE_EACH_OF_8(X)
#define AMINN_SLIDE_SUMS "{s0-s7}"
#define AMINN_SLIDE_ROW "{s20-s27}"
#else
#define AMINN_SLIDE_EACH(X) AMINN_SLIDE_EACH_OF_10(X)
#define AMINN_SLIDE_SUMS "{s0-s9}"
#define AMINN_SLIDE_ROW "{s20-s29}"
#endif
#define AMINN_SLIDE_SCALE(even, odd, row) "    vmul.f32 s" #even ", s" #row ", s30\n"
#define AMINN_SLIDE_ADD(even, odd, row) "    vmla.f32 s" #even ", s" #row ", s30\n"
#define AMINN_SLIDE_ADD_ODD(even, odd, row) "    vmla.f32 s" #odd ", s" #row ", s30\n"
#define AMINN_SLIDE_SUBTRACT(even, odd, row) "    vmls.f32 s" #even ", s" #row ", s30\n"
#define AMINN_SLIDE_JOIN(even, odd, row) "    vadd.f32 s" #even ", s" #even ", s" #odd "\n"
#define AMINN_SLIDE_CLEAR_SUMS \
    "    vldmia %[zero], {s0-s7}\n    vldmia %[zero], {s8-s15}\n    vldmia %[zero], {s16-s19}\n"
#define AMINN_SLIDE_LOAD_ROW                                                                                          \
    "    vldmia %[row]!, " AMINN_SLIDE_ROW "\n    vldr s30, [%[p]]\n    vldmia %[q]!, {s31}\n    add %[p], %[step]\n" \
    "    vmul.f32 s30, s31, s30\n"

#define AMINN_SLIDE_REGISTERS                                                                                       \
    AMINN_ROW_REGISTERS, "s12", "s13", "s14", "s15", "s16", "s17", "s18", "s19", "s20", "s21", "s22", "s23", "s24", \
        "s25", "s26", "s27", "s28", "s29"

AMINN_FUNCTION void scale(SlideRow &a, float s, const SlideRow &c)
{
    register float factor __asm("s30") = s;
    __asm volatile("    vldmia %[c], " AMINN_SLIDE_ROW
                   "\n" AMINN_SLIDE_EACH(AMINN_SLIDE_SCALE) "    vstmia %[a], " AMINN_SLIDE_SUMS
                   :
                   : [a] "r"(a.v), [c] "r"(c.v), "t"(factor)
                   : AMINN_SLIDE_REGISTERS);
}
#define AMINN_SLIDE_CHANGE(operation)                                                         \
    register float factor __asm("s30") = s;                                                   \
    __asm volatile("    vldmia %[a], " AMINN_SLIDE_SUMS "\n    vldmia %[c], " AMINN_SLIDE_ROW \
                   "\n" AMINN_SLIDE_EACH(operation) "    vstmia %[a], " AMINN_SLIDE_SUMS      \
                   :                                                                          \
                   : [a] "r"(a.v), [c] "r"(c.v), "t"(factor)                                  \
                   : AMINN_SLIDE_REGISTERS)
AMINN_FUNCTION void add_scaled(SlideRow &a, float s, const SlideRow &c)
{
    AMINN_SLIDE_CHANGE(AMINN_SLIDE_ADD);
}
AMINN_FUNCTION void subtract_scaled(SlideRow &a, float s, const SlideRow &c)
{
    AMINN_SLIDE_CHANGE(AMINN_SLIDE_SUBTRACT);
}
// to = sum_r (q[r] p[r]) rows[r], p in steps of some bytes: the sum over even r plus that over odd r
AMINN_FUNCTION void weighted_sum(SlideRow &to, const SlideRow *row, int n, const float *q, const float *p, int step)
{
    __asm volatile(AMINN_SLIDE_CLEAR_SUMS "1:\n" AMINN_SLIDE_LOAD_ROW AMINN_SLIDE_EACH(
                       AMINN_SLIDE_ADD) "    subs %[n], #1\n    beq 2f\n" AMINN_SLIDE_LOAD_ROW
                       AMINN_SLIDE_EACH(AMINN_SLIDE_ADD_ODD) "    subs %[n], #1\n    bne 1b\n2:\n" AMINN_SLIDE_EACH(
                           AMINN_SLIDE_JOIN) "    vstmia %[a], " AMINN_SLIDE_SUMS
                   : [row] "+&r"(row), [n] "+&r"(n), [q] "+&r"(q), [p] "+&r"(p)
                   : [a] "r"(to.v), [zero] "r"(kMinusZeros), [step] "r"(step)
                   : AMINN_SLIDE_REGISTERS, "s30", "s31");
}
// rows[r] -= p[6 r] factor
AMINN_FUNCTION void subtract_products(SlideRow *rows, int n, const float *p, const SlideRow &factor)
{
    __asm volatile("    vldmia %[factor], " AMINN_SLIDE_ROW "\n1:  vldmia %[row], " AMINN_SLIDE_SUMS
                   "\n    vldr s30, [%[p]]\n"
                   "    adds %[p], #24\n" AMINN_SLIDE_EACH(AMINN_SLIDE_SUBTRACT) "    vstmia %[row]!, " AMINN_SLIDE_SUMS
                                                                                 "\n    subs %[n], #1\n    bne 1b"
                   : [row] "+&r"(rows), [n] "+&r"(n), [p] "+&r"(p)
                   : [factor] "r"(factor.v)
                   : AMINN_SLIDE_REGISTERS, "s30");
}
// the upper half of to = the inner products of the rows' columns, one row after the other; the lower half has no meaning
template <int kColumns, int kCount>
AMINN_FUNCTION void squares(SlideRow *to, const SlideRow *rows, const float *weight)
{
    for (int j = 0; j < kColumns; ++j) {
        const SlideRow *row = rows;
        const float *p = &rows->v[j];
        const float *q = weight;
        int n = kCount;
        __asm volatile(AMINN_SLIDE_CLEAR_SUMS "1:\n" AMINN_SLIDE_LOAD_ROW AMINN_SLIDE_EACH(
                           AMINN_SLIDE_ADD) "    subs %[n], #1\n    bne 1b\n    vstmia %[a], " AMINN_SLIDE_SUMS
                       : [row] "+&r"(row), [n] "+&r"(n), [q] "+&r"(q), [p] "+&r"(p)
                       : [a] "r"(to[j].v), [zero] "r"(kMinusZeros), [step] "r"(sizeof *rows)
                       : AMINN_SLIDE_REGISTERS, "s30", "s31");
    }
}

} // namespace AMINN_CORE
} // namespace aminn

#endif
