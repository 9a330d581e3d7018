// Rows of a Cortex-M with an FPU: arrays, whose sums over rows are written for its registers.
#ifndef AMINN_SRC_ROWS_CORTEX_M_HPP
#define AMINN_SRC_ROWS_CORTEX_M_HPP

#include "components.hpp"
#include "row_sums.hpp" // of rows that are no Row

namespace aminn {
inline namespace AMINN_CORE {

using Row = Components<float, kMotion>;

// Rows are loaded and stored as a whole, which the compiler does not do by itself. A sum that begins with -0 keeps the
// first product as it is.
constexpr float kMinusZeros[8] = {-0.0F, -0.0F, -0.0F, -0.0F, -0.0F, -0.0F, -0.0F, -0.0F};
#define AMINN_ROW_REGISTERS "s0", "s1", "s2", "s3", "s4", "s5", "s6", "s7", "s8", "s9", "s10", "s11", "cc", "memory"
#define AMINN_SIX(operation, factor)                                                                                \
    "    " operation " s0, s6, " factor "\n    " operation " s1, s7, " factor "\n    " operation " s2, s8, " factor \
    "\n    " operation " s3, s9, " factor "\n    " operation " s4, s10, " factor "\n    " operation                 \
    " s5, s11, " factor "\n"
#define AMINN_SIX_PAIRS(operation)                                                                             \
    "    " operation " s0, s0, s6\n    " operation " s1, s1, s7\n    " operation " s2, s2, s8\n    " operation \
    " s3, s3, s9\n    " operation " s4, s4, s10\n    " operation " s5, s5, s11\n"
#define AMINN_STORE "    vstmia %[a], {s0-s5}"

AMINN_FUNCTION void load_row(Row &a, const float *p)
{
    __asm volatile("    vldmia %[p], {s0-s5}\n" AMINN_STORE : : [a] "r"(a.v), [p] "r"(p) : AMINN_ROW_REGISTERS);
}
AMINN_INLINE void clear(Row &a)
{
    float zero = 0.0F;
    __asm("" : "+t"(zero)); // a zero of which the compiler does not know, or it would call memset
    for (int i = 0; i < kMotion; ++i) {
        a.v[i] = zero;
    }
}
AMINN_FUNCTION void scale(Row &a, float s, const Row &c)
{
    __asm volatile("    vldmia %[c], {s6-s11}\n" AMINN_SIX("vmul.f32", "%[s]") AMINN_STORE
                   :
                   : [a] "r"(a.v), [c] "r"(c.v), [s] "t"(s)
                   : AMINN_ROW_REGISTERS);
}
AMINN_FUNCTION void add_scaled(Row &a, float s, const Row &c)
{
    __asm volatile("    vldmia %[a], {s0-s5}\n    vldmia %[c], {s6-s11}\n" AMINN_SIX("vmla.f32", "%[s]") AMINN_STORE
                   :
                   : [a] "r"(a.v), [c] "r"(c.v), [s] "t"(s)
                   : AMINN_ROW_REGISTERS);
}
AMINN_FUNCTION void multiply(Row &a, const Row &b)
{
    __asm volatile("    vldmia %[a], {s0-s5}\n    vldmia %[c], {s6-s11}\n" AMINN_SIX_PAIRS("vmul.f32") AMINN_STORE
                   :
                   : [a] "r"(a.v), [c] "r"(b.v)
                   : AMINN_ROW_REGISTERS);
}

AMINN_FUNCTION float dot(const Row &a, const Row &b)
{
    float sum = 0.0F;
    __asm volatile("    vldmia %[a], {s0-s5}\n    vldmia %[b], {s6-s11}\n" AMINN_SIX_PAIRS(
                       "vmul.f32") "    vadd.f32 s0, s0, s1\n    vadd.f32 s2, s2, s3\n    vadd.f32 s4, s4, s5\n"
                                   "    vadd.f32 s0, s0, s2\n    vadd.f32 %[sum], s0, s4"
                   : [sum] "=t"(sum)
                   : [a] "r"(a.v), [b] "r"(b.v)
                   : AMINN_ROW_REGISTERS);
    return sum;
}
AMINN_FUNCTION void sum_of_squares(Row &to, const Row *rows, int n, const float *weight)
{
    __asm volatile("    vldmia %[zero], {s0-s5}\n"
                   "1:  vldmia %[row]!, {s6-s11}\n"
                   "    vldmia %[weight]!, {s12}\n"
                   "    vmul.f32 s6, s6, s6\n    vmul.f32 s7, s7, s7\n    vmul.f32 s8, s8, s8\n"
                   "    vmul.f32 s9, s9, s9\n    vmul.f32 s10, s10, s10\n    vmul.f32 s11, s11, s11\n" AMINN_SIX(
                       "vmla.f32", "s12") "    subs %[n], #1\n"
                                          "    bne 1b\n" AMINN_STORE
                   : [row] "+r"(rows), [n] "+r"(n), [weight] "+r"(weight)
                   : [a] "r"(to.v), [zero] "r"(kMinusZeros)
                   : AMINN_ROW_REGISTERS, "s12");
}

#define AMINN_LOAD_WEIGHTED                                                          \
    "    vldmia %[row]!, {s12-s17}\n    vldr s18, [%[p]]\n    vldmia %[q]!, {s19}\n" \
    "    add %[p], %[step]\n    vmul.f32 s18, s19, s18\n"
// to = sum_r (q[r] p[r]) rows[r], p in steps of some bytes
AMINN_FUNCTION void weighted_sum(Row &to, const Row *row, int n, const float *q, const float *p, int step)
{
    __asm volatile("    vldmia %[zero], {s0-s7}\n    vldmia %[zero], {s8-s11}\n"
                   "1:\n" AMINN_LOAD_WEIGHTED
                   "    vmla.f32 s0, s12, s18\n    vmla.f32 s1, s13, s18\n    vmla.f32 s2, s14, s18\n"
                   "    vmla.f32 s3, s15, s18\n    vmla.f32 s4, s16, s18\n    vmla.f32 s5, s17, s18\n"
                   "    subs %[n], #1\n"
                   "    beq 2f\n" AMINN_LOAD_WEIGHTED
                   "    vmla.f32 s6, s12, s18\n    vmla.f32 s7, s13, s18\n    vmla.f32 s8, s14, s18\n"
                   "    vmla.f32 s9, s15, s18\n    vmla.f32 s10, s16, s18\n    vmla.f32 s11, s17, s18\n"
                   "    subs %[n], #1\n"
                   "    bne 1b\n"
                   "2:\n" AMINN_SIX_PAIRS("vadd.f32") AMINN_STORE
                   : [row] "+r"(row), [n] "+r"(n), [q] "+r"(q), [p] "+r"(p)
                   : [a] "r"(to.v), [zero] "r"(kMinusZeros), [step] "r"(step)
                   : AMINN_ROW_REGISTERS, "s12", "s13", "s14", "s15", "s16", "s17", "s18", "s19");
}
AMINN_INLINE void combine(Row &to, const Row *rows, int n, const float *c)
{
    weighted_sum(to, rows, n, c, kOnes, 0);
}
// of column j of q with all columns of the rows: to = sum_r (weight[r] q[r][j]) rows[r]
AMINN_INLINE void inner_products(Row &to, const Row *rows, int n, const float *weight, const Row *q, int j)
{
    weighted_sum(to, rows, n, weight, &q->v[j], sizeof *q);
}
// rows[r] -= p[6 r] factor
AMINN_FUNCTION void subtract_products(Row *rows, int n, const float *p, const Row &factor)
{
    __asm volatile("    vldmia %[factor], {s6-s11}\n"
                   "1:  vldmia %[row], {s0-s5}\n"
                   "    vldr s12, [%[p]]\n"
                   "    adds %[p], #24\n" AMINN_SIX("vmls.f32", "s12") "    vstmia %[row]!, {s0-s5}\n"
                                                                       "    subs %[n], #1\n"
                                                                       "    bne 1b"
                   : [row] "+r"(rows), [n] "+r"(n), [p] "+r"(p)
                   : [factor] "r"(factor.v)
                   : AMINN_ROW_REGISTERS, "s12");
}
// rows[r] -= q[r][j] factor
AMINN_INLINE void eliminate(Row *rows, int n, const Row *q, int j, const Row &factor)
{
    subtract_products(rows, n, &q->v[j], factor);
}

// to = the inner products of the rows' columns, all 36 of 21
AMINN_FUNCTION void six_squares(Row *to, const Row *row, int n, const float *weight)
{
    __asm volatile(
        "    vldmia %[zero], {s0-s7}\n    vldmia %[zero], {s8-s15}\n    vldmia %[zero], {s16-s20}\n"
        "1:  vldmia %[row]!, {s21-s26}\n    vldmia %[weight]!, {s27}\n"
        "    vmul.f32 s28, s27, s21\n    vmla.f32 s0, s28, s21\n    vmla.f32 s1, s28, s22\n    vmla.f32 s2, s28, s23\n "
        "   vmla.f32 s3, s28, s24\n    vmla.f32 s4, s28, s25\n    vmla.f32 s5, s28, s26\n"
        "    vmul.f32 s29, s27, s22\n    vmla.f32 s6, s29, s22\n    vmla.f32 s7, s29, s23\n    vmla.f32 s8, s29, s24\n "
        "   vmla.f32 s9, s29, s25\n    vmla.f32 s10, s29, s26\n"
        "    vmul.f32 s30, s27, s23\n    vmla.f32 s11, s30, s23\n    vmla.f32 s12, s30, s24\n    vmla.f32 s13, s30, "
        "s25\n    vmla.f32 s14, s30, s26\n"
        "    vmul.f32 s31, s27, s24\n    vmla.f32 s15, s31, s24\n    vmla.f32 s16, s31, s25\n    vmla.f32 s17, s31, "
        "s26\n"
        "    vmul.f32 s28, s27, s25\n    vmla.f32 s18, s28, s25\n    vmla.f32 s19, s28, s26\n"
        "    vmul.f32 s29, s27, s26\n    vmla.f32 s20, s29, s26\n"
        "    subs %[n], #1\n    bne 1b\n"
        "    vstmia %[to]!, {s0-s5}\n    vstmia %[to]!, {s1}\n    vstmia %[to]!, {s6-s10}\n    vstmia %[to]!, {s2}\n   "
        " vstmia %[to]!, {s7}\n    vstmia %[to]!, {s11-s14}\n    vstmia %[to]!, {s3}\n    vstmia %[to]!, {s8}\n    "
        "vstmia %[to]!, {s12}\n    vstmia %[to]!, {s15-s17}\n    vstmia %[to]!, {s4}\n    vstmia %[to]!, {s9}\n    "
        "vstmia %[to]!, {s13}\n    vstmia %[to]!, {s16}\n    vstmia %[to]!, {s18-s19}\n    vstmia %[to]!, {s5}\n    "
        "vstmia %[to]!, {s10}\n    vstmia %[to]!, {s14}\n    vstmia %[to]!, {s17}\n    vstmia %[to]!, {s19-s20}"
        : [to] "+r"(to), [row] "+r"(row), [n] "+r"(n), [weight] "+r"(weight)
        : [zero] "r"(kMinusZeros)
        : AMINN_ROW_REGISTERS, "s12", "s13", "s14", "s15", "s16", "s17", "s18", "s19", "s20", "s21", "s22", "s23",
          "s24", "s25", "s26", "s27", "s28", "s29", "s30", "s31");
}

#if AMINN_N_SLIDE && AMINN_N_BRANCH == 3
// What find_forces() does, in registers: the upper half of E in s0-s20, forces in s21-s26.
AMINN_FUNCTION void six_forces(const Row *e, const Row &held, const float *s, float *force, float *sigma)
{
    sigma += 6;
    __asm volatile(
        "    vldmia %[e]!, {s0-s5}\n    adds %[e], #4\n    vldmia %[e]!, {s6-s10}\n    adds %[e], #8\n"
        "    vldmia %[e]!, {s11-s14}\n    adds %[e], #12\n    vldmia %[e]!, {s15-s17}\n    adds %[e], #16\n"
        "    vldmia %[e]!, {s18-s19}\n    adds %[e], #20\n    vldmia %[e], {s20}\n"
        "    vldmia %[held], {s21-s26}\n    vldmia %[s]!, {s27}\n    vmov.f32 s28, #1.0\n    vmov.f32 s29, s28\n"
        "    vmla.f32 s28, s27, s0\n    vdiv.f32 s28, s29, s28\n    vstmia %[force]!, {s28}\n"
        "    vmul.f32 s27, s27, s28\n    vmul.f32 s29, s27, s1\n    vmls.f32 s6, s29, s1\n"
        "    vmls.f32 s7, s29, s2\n    vmls.f32 s8, s29, s3\n    vmls.f32 s9, s29, s4\n"
        "    vmls.f32 s10, s29, s5\n    vmls.f32 s22, s29, s21\n    vmul.f32 s29, s27, s2\n"
        "    vmls.f32 s11, s29, s2\n    vmls.f32 s12, s29, s3\n    vmls.f32 s13, s29, s4\n"
        "    vmls.f32 s14, s29, s5\n    vmls.f32 s23, s29, s21\n    vmul.f32 s29, s27, s3\n"
        "    vmls.f32 s15, s29, s3\n    vmls.f32 s16, s29, s4\n    vmls.f32 s17, s29, s5\n"
        "    vmls.f32 s24, s29, s21\n    vmul.f32 s29, s27, s4\n    vmls.f32 s18, s29, s4\n"
        "    vmls.f32 s19, s29, s5\n    vmls.f32 s25, s29, s21\n    vmul.f32 s29, s27, s5\n"
        "    vmls.f32 s20, s29, s5\n    vmls.f32 s26, s29, s21\n    vldmia %[s]!, {s27}\n"
        "    vmov.f32 s28, #1.0\n    vmov.f32 s29, s28\n    vmla.f32 s28, s27, s6\n    vdiv.f32 s28, s29, s28\n"
        "    vstmia %[force]!, {s28}\n    vmul.f32 s27, s27, s28\n    vmul.f32 s29, s27, s7\n"
        "    vmls.f32 s11, s29, s7\n    vmls.f32 s12, s29, s8\n    vmls.f32 s13, s29, s9\n"
        "    vmls.f32 s14, s29, s10\n    vmls.f32 s23, s29, s22\n    vmul.f32 s29, s27, s8\n"
        "    vmls.f32 s15, s29, s8\n    vmls.f32 s16, s29, s9\n    vmls.f32 s17, s29, s10\n"
        "    vmls.f32 s24, s29, s22\n    vmul.f32 s29, s27, s9\n    vmls.f32 s18, s29, s9\n"
        "    vmls.f32 s19, s29, s10\n    vmls.f32 s25, s29, s22\n    vmul.f32 s29, s27, s10\n"
        "    vmls.f32 s20, s29, s10\n    vmls.f32 s26, s29, s22\n    vldmia %[s]!, {s27}\n"
        "    vmov.f32 s28, #1.0\n    vmov.f32 s29, s28\n    vmla.f32 s28, s27, s11\n    vdiv.f32 s28, s29, s28\n"
        "    vstmia %[force]!, {s28}\n    vmul.f32 s27, s27, s28\n    vmul.f32 s29, s27, s12\n"
        "    vmls.f32 s15, s29, s12\n    vmls.f32 s16, s29, s13\n    vmls.f32 s17, s29, s14\n"
        "    vmls.f32 s24, s29, s23\n    vmul.f32 s29, s27, s13\n    vmls.f32 s18, s29, s13\n"
        "    vmls.f32 s19, s29, s14\n    vmls.f32 s25, s29, s23\n    vmul.f32 s29, s27, s14\n"
        "    vmls.f32 s20, s29, s14\n    vmls.f32 s26, s29, s23\n    vldmia %[s]!, {s27}\n"
        "    vmov.f32 s28, #1.0\n    vmov.f32 s29, s28\n    vmla.f32 s28, s27, s15\n    vdiv.f32 s28, s29, s28\n"
        "    vstmia %[force]!, {s28}\n    vmul.f32 s27, s27, s28\n    vmul.f32 s29, s27, s16\n"
        "    vmls.f32 s18, s29, s16\n    vmls.f32 s19, s29, s17\n    vmls.f32 s25, s29, s24\n"
        "    vmul.f32 s29, s27, s17\n    vmls.f32 s20, s29, s17\n    vmls.f32 s26, s29, s24\n"
        "    vldmia %[s]!, {s27}\n    vmov.f32 s28, #1.0\n    vmov.f32 s29, s28\n    vmla.f32 s28, s27, s18\n"
        "    vdiv.f32 s28, s29, s28\n    vstmia %[force]!, {s28}\n    vmul.f32 s27, s27, s28\n"
        "    vmul.f32 s29, s27, s19\n    vmls.f32 s20, s29, s19\n    vmls.f32 s26, s29, s25\n"
        "    vldmia %[s]!, {s27}\n    vmov.f32 s28, #1.0\n    vmov.f32 s29, s28\n    vmla.f32 s28, s27, s20\n"
        "    vdiv.f32 s28, s29, s28\n    vstmia %[force]!, {s28}\n    vldmdb %[force]!, {s27}\n"
        "    vldmdb %[s]!, {s28}\n    vmul.f32 s26, s27, s26\n    vmul.f32 s28, s28, s26\n"
        "    vstmdb %[sigma]!, {s28}\n    vmls.f32 s21, s5, s28\n    vmls.f32 s22, s10, s28\n"
        "    vmls.f32 s23, s14, s28\n    vmls.f32 s24, s17, s28\n    vmls.f32 s25, s19, s28\n"
        "    vldmdb %[force]!, {s27}\n    vldmdb %[s]!, {s28}\n    vmul.f32 s25, s27, s25\n"
        "    vmul.f32 s28, s28, s25\n    vstmdb %[sigma]!, {s28}\n    vmls.f32 s21, s4, s28\n"
        "    vmls.f32 s22, s9, s28\n    vmls.f32 s23, s13, s28\n    vmls.f32 s24, s16, s28\n"
        "    vldmdb %[force]!, {s27}\n    vldmdb %[s]!, {s28}\n    vmul.f32 s24, s27, s24\n"
        "    vmul.f32 s28, s28, s24\n    vstmdb %[sigma]!, {s28}\n    vmls.f32 s21, s3, s28\n"
        "    vmls.f32 s22, s8, s28\n    vmls.f32 s23, s12, s28\n    vldmdb %[force]!, {s27}\n"
        "    vldmdb %[s]!, {s28}\n    vmul.f32 s23, s27, s23\n    vmul.f32 s28, s28, s23\n"
        "    vstmdb %[sigma]!, {s28}\n    vmls.f32 s21, s2, s28\n    vmls.f32 s22, s7, s28\n"
        "    vldmdb %[force]!, {s27}\n    vldmdb %[s]!, {s28}\n    vmul.f32 s22, s27, s22\n"
        "    vmul.f32 s28, s28, s22\n    vstmdb %[sigma]!, {s28}\n    vmls.f32 s21, s1, s28\n"
        "    vldmdb %[force]!, {s27}\n    vldmdb %[s]!, {s28}\n    vmul.f32 s21, s27, s21\n"
        "    vmul.f32 s28, s28, s21\n    vstmdb %[sigma]!, {s28}\n    vstmia %[force], {s21-s26}\n"
        : [e] "+r"(e), [s] "+r"(s), [force] "+r"(force), [sigma] "+r"(sigma)
        : [held] "r"(held.v)
        : AMINN_ROW_REGISTERS, "s12", "s13", "s14", "s15", "s16", "s17", "s18", "s19", "s20", "s21", "s22", "s23",
          "s24", "s25", "s26", "s27", "s28", "s29");
}
#endif

} // namespace AMINN_CORE
} // namespace aminn

#endif
