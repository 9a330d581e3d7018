/* What the firmware tells its host, and the clock that it measures with. */
#ifndef FIGURES_H
#define FIGURES_H

#include <stdint.h>

/* Prints "firmware: WHAT: WHY"; returns the exit status 1. */
int fail(const char *what, const char *why);
/* Prints "firmware: NAME VALUE". */
void print_figure(const char *name, uint32_t value);

#ifdef __riscv
static inline uint32_t ticks_now(void)
{
    uint32_t now;
    __asm volatile(".option push\n.option arch, +zicsr\n csrr %0, mcycle\n.option pop" : "=r"(now));
    return now;
}
#else
/* SysTick: control, period, and a clock of 24 bits that counts down. */
#define SYST_CSR (*(volatile uint32_t *)0xE000E010u)
#define SYST_RVR (*(volatile uint32_t *)0xE000E014u)
#define SYST_CVR (*(volatile uint32_t *)0xE000E018u)
#define SYST_COUNTFLAG (1u << 16) /* of SYST_CSR: the period has passed; reading clears it */

static inline uint32_t ticks_now(void)
{
    return SYST_CVR;
}
#endif

/* Starts the clock, with the longest period. */
void ticks_start(void);
uint32_t ticks_since(uint32_t start);
/* Two instructions a loop. */
void spin(uint32_t loops);
/* Instructions a tick, times 1000; 0 if the clock does not follow the instructions. */
uint32_t calibrate(void);

#endif
