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
AMINN_FUNCTION void clear_rows(Row *rows, int n)
{
    __asm volatile("    vmov s0, s1, %[zero], %[zero]\n    vmov s2, s3, %[zero], %[zero]\n"
                   "    vmov s4, s5, %[zero], %[zero]\n1:  vstmia %[rows]!, {s0-s5}\n"
                   "    subs %[n], #1\n    bne 1b"
                   : [rows] "+&r"(rows), [n] "+&r"(n)
                   : [zero] "r"(0)
                   : AMINN_ROW_REGISTERS);
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
                   : [row] "+&r"(rows), [n] "+&r"(n), [weight] "+&r"(weight)
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
                   : [row] "+&r"(row), [n] "+&r"(n), [q] "+&r"(q), [p] "+&r"(p)
                   : [a] "r"(to.v), [zero] "r"(kMinusZeros), [step] "r"(step)
                   : AMINN_ROW_REGISTERS, "s12", "s13", "s14", "s15", "s16", "s17", "s18", "s19");
}
template <int kCount>
AMINN_INLINE void combine(Components<float, kCount> &to, const Components<float, kCount> *rows, int n, const float *c)
{
    weighted_sum(to, rows, n, c, kOnes, 0);
}
// of column j of q with all columns of the rows: to = sum_r (weight[r] q[r][j]) rows[r]
template <int kCount>
AMINN_INLINE void inner_products(Components<float, kCount> &to, const Components<float, kCount> *rows, int n,
                                 const float *weight, const Row *q, int j)
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
                   : [row] "+&r"(rows), [n] "+&r"(n), [p] "+&r"(p)
                   : [factor] "r"(factor.v)
                   : AMINN_ROW_REGISTERS, "s12");
}
// rows[r] -= q[r][j] factor
template <int kCount>
AMINN_INLINE void eliminate(Components<float, kCount> *rows, int n, const Row *q, int j,
                            const Components<float, kCount> &factor)
{
    subtract_products(rows, n, &q->v[j], factor);
}

#define AMINN_MUL(to, a, b) "    vmul.f32 s" #to ", s" #a ", s" #b "\n"
#define AMINN_MLA(to, a, b) "    vmla.f32 s" #to ", s" #a ", s" #b "\n"
#define AMINN_MLS(to, a, b) "    vmls.f32 s" #to ", s" #a ", s" #b "\n"
#define AMINN_ALL_REGISTERS                                                                                         \
    AMINN_ROW_REGISTERS, "s12", "s13", "s14", "s15", "s16", "s17", "s18", "s19", "s20", "s21", "s22", "s23", "s24", \
        "s25", "s26", "s27", "s28", "s29", "s30", "s31"
// the upper half of to = the inner products of the rows' columns, which s0-s20 sum
AMINN_FUNCTION void six_squares(Row *to, const Row *row, int n, const float *weight)
{
    // clang-format off
    __asm volatile(
        "    vldmia %[zero], {s0-s7}\n" "    vldmia %[zero], {s8-s15}\n" "    vldmia %[zero], {s16-s20}\n"
        "1:  vldmia %[row]!, {s21-s26}\n" "    vldmia %[weight]!, {s27}\n"
        AMINN_MUL(28, 27, 21) AMINN_MLA(0, 28, 21) AMINN_MLA(1, 28, 22) AMINN_MLA(2, 28, 23) AMINN_MLA(3, 28, 24)
        AMINN_MLA(4, 28, 25) AMINN_MLA(5, 28, 26)
        AMINN_MUL(29, 27, 22) AMINN_MLA(6, 29, 22) AMINN_MLA(7, 29, 23) AMINN_MLA(8, 29, 24) AMINN_MLA(9, 29, 25)
        AMINN_MLA(10, 29, 26)
        AMINN_MUL(30, 27, 23) AMINN_MLA(11, 30, 23) AMINN_MLA(12, 30, 24) AMINN_MLA(13, 30, 25) AMINN_MLA(14, 30, 26)
        AMINN_MUL(31, 27, 24) AMINN_MLA(15, 31, 24) AMINN_MLA(16, 31, 25) AMINN_MLA(17, 31, 26)
        AMINN_MUL(28, 27, 25) AMINN_MLA(18, 28, 25) AMINN_MLA(19, 28, 26)
        AMINN_MUL(29, 27, 26) AMINN_MLA(20, 29, 26)
        "    subs %[n], #1\n" "    bne 1b\n"
        "    vstmia %[to]!, {s0-s5}\n" "    adds %[to], #4\n"
        "    vstmia %[to]!, {s6-s10}\n" "    adds %[to], #8\n"
        "    vstmia %[to]!, {s11-s14}\n" "    adds %[to], #12\n"
        "    vstmia %[to]!, {s15-s17}\n" "    adds %[to], #16\n"
        "    vstmia %[to]!, {s18-s19}\n" "    adds %[to], #20\n"
        "    vstmia %[to], {s20}\n"
        : [to] "+&r"(to), [row] "+&r"(row), [n] "+&r"(n), [weight] "+&r"(weight)
        : [zero] "r"(kMinusZeros)
        : AMINN_ALL_REGISTERS);
    // clang-format on
}

#if AMINN_N_SLIDE && AMINN_N_BRANCH == 3
// What find_forces() does, in registers: the upper half of E in s0-s20, forces in s21-s26.
AMINN_FUNCTION void six_forces(const Row *e, const Row &held, const float *s, float *force, float *sigma)
{
    sigma += 6;
    // clang-format off
    __asm volatile(
        "    vldmia %[e]!, {s0-s5}\n" "    adds %[e], #4\n"
        "    vldmia %[e]!, {s6-s10}\n" "    adds %[e], #8\n"
        "    vldmia %[e]!, {s11-s14}\n" "    adds %[e], #12\n"
        "    vldmia %[e]!, {s15-s17}\n" "    adds %[e], #16\n"
        "    vldmia %[e]!, {s18-s19}\n" "    adds %[e], #20\n"
        "    vldmia %[e], {s20}\n" "    vldmia %[held], {s21-s26}\n"
        "    vldmia %[s]!, {s27}\n" "    vmov.f32 s28, #1.0\n" "    vmov.f32 s29, s28\n"
        AMINN_MLA(28, 27, 0) "    vdiv.f32 s28, s29, s28\n" "    vstmia %[force]!, {s28}\n"
        AMINN_MUL(27, 27, 28) AMINN_MUL(29, 27, 1) AMINN_MLS(6, 29, 1) AMINN_MLS(7, 29, 2) AMINN_MLS(8, 29, 3)
        AMINN_MLS(9, 29, 4) AMINN_MLS(10, 29, 5) AMINN_MLS(22, 29, 21)
        AMINN_MUL(29, 27, 2) AMINN_MLS(11, 29, 2) AMINN_MLS(12, 29, 3) AMINN_MLS(13, 29, 4) AMINN_MLS(14, 29, 5)
        AMINN_MLS(23, 29, 21)
        AMINN_MUL(29, 27, 3) AMINN_MLS(15, 29, 3) AMINN_MLS(16, 29, 4) AMINN_MLS(17, 29, 5) AMINN_MLS(24, 29, 21)
        AMINN_MUL(29, 27, 4) AMINN_MLS(18, 29, 4) AMINN_MLS(19, 29, 5) AMINN_MLS(25, 29, 21)
        AMINN_MUL(29, 27, 5) AMINN_MLS(20, 29, 5) AMINN_MLS(26, 29, 21)
        "    vldmia %[s]!, {s27}\n" "    vmov.f32 s28, #1.0\n" "    vmov.f32 s29, s28\n"
        AMINN_MLA(28, 27, 6) "    vdiv.f32 s28, s29, s28\n" "    vstmia %[force]!, {s28}\n"
        AMINN_MUL(27, 27, 28) AMINN_MUL(29, 27, 7) AMINN_MLS(11, 29, 7) AMINN_MLS(12, 29, 8) AMINN_MLS(13, 29, 9)
        AMINN_MLS(14, 29, 10) AMINN_MLS(23, 29, 22)
        AMINN_MUL(29, 27, 8) AMINN_MLS(15, 29, 8) AMINN_MLS(16, 29, 9) AMINN_MLS(17, 29, 10) AMINN_MLS(24, 29, 22)
        AMINN_MUL(29, 27, 9) AMINN_MLS(18, 29, 9) AMINN_MLS(19, 29, 10) AMINN_MLS(25, 29, 22)
        AMINN_MUL(29, 27, 10) AMINN_MLS(20, 29, 10) AMINN_MLS(26, 29, 22)
        "    vldmia %[s]!, {s27}\n" "    vmov.f32 s28, #1.0\n" "    vmov.f32 s29, s28\n"
        AMINN_MLA(28, 27, 11) "    vdiv.f32 s28, s29, s28\n" "    vstmia %[force]!, {s28}\n"
        AMINN_MUL(27, 27, 28) AMINN_MUL(29, 27, 12) AMINN_MLS(15, 29, 12) AMINN_MLS(16, 29, 13) AMINN_MLS(17, 29, 14)
        AMINN_MLS(24, 29, 23)
        AMINN_MUL(29, 27, 13) AMINN_MLS(18, 29, 13) AMINN_MLS(19, 29, 14) AMINN_MLS(25, 29, 23)
        AMINN_MUL(29, 27, 14) AMINN_MLS(20, 29, 14) AMINN_MLS(26, 29, 23)
        "    vldmia %[s]!, {s27}\n" "    vmov.f32 s28, #1.0\n" "    vmov.f32 s29, s28\n"
        AMINN_MLA(28, 27, 15) "    vdiv.f32 s28, s29, s28\n" "    vstmia %[force]!, {s28}\n"
        AMINN_MUL(27, 27, 28) AMINN_MUL(29, 27, 16) AMINN_MLS(18, 29, 16) AMINN_MLS(19, 29, 17) AMINN_MLS(25, 29, 24)
        AMINN_MUL(29, 27, 17) AMINN_MLS(20, 29, 17) AMINN_MLS(26, 29, 24)
        "    vldmia %[s]!, {s27}\n" "    vmov.f32 s28, #1.0\n" "    vmov.f32 s29, s28\n"
        AMINN_MLA(28, 27, 18) "    vdiv.f32 s28, s29, s28\n" "    vstmia %[force]!, {s28}\n"
        AMINN_MUL(27, 27, 28) AMINN_MUL(29, 27, 19) AMINN_MLS(20, 29, 19) AMINN_MLS(26, 29, 25)
        "    vldmia %[s]!, {s27}\n" "    vmov.f32 s28, #1.0\n" "    vmov.f32 s29, s28\n"
        AMINN_MLA(28, 27, 20) "    vdiv.f32 s28, s29, s28\n" "    vstmia %[force]!, {s28}\n"
        "    vldmdb %[force]!, {s27}\n" "    vldmdb %[s]!, {s28}\n" AMINN_MUL(26, 27, 26) AMINN_MUL(28, 28, 26)
        "    vstmdb %[sigma]!, {s28}\n"
        AMINN_MLS(21, 5, 28) AMINN_MLS(22, 10, 28) AMINN_MLS(23, 14, 28) AMINN_MLS(24, 17, 28) AMINN_MLS(25, 19, 28)
        "    vldmdb %[force]!, {s27}\n" "    vldmdb %[s]!, {s28}\n" AMINN_MUL(25, 27, 25) AMINN_MUL(28, 28, 25)
        "    vstmdb %[sigma]!, {s28}\n"
        AMINN_MLS(21, 4, 28) AMINN_MLS(22, 9, 28) AMINN_MLS(23, 13, 28) AMINN_MLS(24, 16, 28)
        "    vldmdb %[force]!, {s27}\n" "    vldmdb %[s]!, {s28}\n" AMINN_MUL(24, 27, 24) AMINN_MUL(28, 28, 24)
        "    vstmdb %[sigma]!, {s28}\n"
        AMINN_MLS(21, 3, 28) AMINN_MLS(22, 8, 28) AMINN_MLS(23, 12, 28)
        "    vldmdb %[force]!, {s27}\n" "    vldmdb %[s]!, {s28}\n" AMINN_MUL(23, 27, 23) AMINN_MUL(28, 28, 23)
        "    vstmdb %[sigma]!, {s28}\n"
        AMINN_MLS(21, 2, 28) AMINN_MLS(22, 7, 28)
        "    vldmdb %[force]!, {s27}\n" "    vldmdb %[s]!, {s28}\n" AMINN_MUL(22, 27, 22) AMINN_MUL(28, 28, 22)
        "    vstmdb %[sigma]!, {s28}\n"
        AMINN_MLS(21, 1, 28)
        "    vldmdb %[force]!, {s27}\n" "    vldmdb %[s]!, {s28}\n" AMINN_MUL(21, 27, 21) AMINN_MUL(28, 28, 21)
        "    vstmdb %[sigma]!, {s28}\n"
        "    vstmia %[force], {s21-s26}\n"
        : [e] "+&r"(e), [s] "+&r"(s), [force] "+&r"(force), [sigma] "+&r"(sigma)
        : [held] "r"(held.v)
        : AMINN_ALL_REGISTERS);
    // clang-format on
}
#endif

} // namespace AMINN_CORE
} // namespace aminn

#endif
