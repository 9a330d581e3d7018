// Rows of a Cortex-M with an FPU: arrays, whose sums over rows are written for its registers.
#ifndef AMINN_SRC_ROWS_CORTEX_M_HPP
#define AMINN_SRC_ROWS_CORTEX_M_HPP

#include "components.hpp"

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
AMINN_INLINE void inner_products(Row &to, const Row *rows, int n, const float *weight, int j)
{
    weighted_sum(to, rows, n, weight, &rows->v[j], sizeof *rows);
}
// rows[r] -= rows[r][j] factor
AMINN_FUNCTION void eliminate(Row *rows, int n, int j, const Row &factor)
{
    const float *p = &rows->v[j];
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

} // namespace AMINN_CORE
} // namespace aminn

#endif
