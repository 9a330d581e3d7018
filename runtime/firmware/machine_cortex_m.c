/*
 * A Cortex-M: reset with the FPU on; faults are reported and end the run with a status that is not zero.
 */
#include <stdint.h>

#include "figures.h"
#include "semihosting.h"
#include "startup.h"

#define SCB_CPACR (*(volatile uint32_t *)0xE000ED88u)
#define SCB_SHCSR (*(volatile uint32_t *)0xE000ED24u)
#define SCB_CFSR (*(volatile uint32_t *)0xE000ED28u)
#define SCB_HFSR (*(volatile uint32_t *)0xE000ED2Cu)
#define SCB_BFAR (*(volatile uint32_t *)0xE000ED38u)

extern uint32_t __stack_limit[], __stack_top[];

void reset_handler(void);
void fault_handler(void);
void report_fault(const uint32_t *frame);

/* first two words: stack pointer and reset; then the system exceptions. No interrupt is used. */
typedef union vector {
    uint32_t *stack;
    void (*handler)(void);
} vector_t;

__attribute__((section(".vectors"), used)) static const vector_t vectors[16] = {
    {.stack = __stack_top},     {.handler = reset_handler}, {.handler = fault_handler}, /* NMI */
    {.handler = fault_handler},                                                         /* hard fault */
    {.handler = fault_handler},                                                         /* memory management */
    {.handler = fault_handler},                                                         /* bus fault */
    {.handler = fault_handler},                                                         /* usage fault */
    {.handler = fault_handler}, {.handler = fault_handler}, {.handler = fault_handler},
    {.handler = fault_handler}, {.handler = fault_handler}, /* SVCall */
    {.handler = fault_handler},                             /* debug monitor */
    {.handler = fault_handler}, {.handler = fault_handler}, /* PendSV */
    {.handler = fault_handler},                             /* SysTick */
};

void reset_handler(void)
{
    SCB_CPACR |= 0xFu << 20; /* full access to the FPU */
    SCB_SHCSR |= 7u << 16;   /* memory, bus and usage faults have their own handlers */
    __asm volatile("dsb\n isb" ::: "memory");
    enter_main();
}

/* hands the stacked registers (r0-r3, r12, lr, pc, xpsr) to the report, on a stack that is surely there */
__attribute__((naked)) void fault_handler(void)
{
    __asm volatile("mrs r0, msp\n"
                   "ldr r1, =__stack_top\n"
                   "mov sp, r1\n"
                   "b report_fault\n");
}

void report_fault(const uint32_t *frame)
{
    const uint32_t ipsr_mask = 0x1FFu;
    uint32_t ipsr;
    const int readable = frame >= __stack_limit && frame + 8 <= __stack_top;
    __asm volatile("mrs %0, ipsr" : "=r"(ipsr));
    semihost_puts("firmware: fault ");
    semihost_put_u32(ipsr & ipsr_mask);
    semihost_puts(" (3 hard, 4 memory, 5 bus, 6 usage), CFSR ");
    semihost_put_hex(SCB_CFSR);
    semihost_puts(" HFSR ");
    semihost_put_hex(SCB_HFSR);
    semihost_puts(" BFAR ");
    semihost_put_hex(SCB_BFAR);
    semihost_puts(readable ? " PC " : " stack overflow");
    if (readable) {
        semihost_put_hex(frame[6]);
    }
    semihost_puts("\n");
    semihost_exit(EXIT_FAULT);
}

void cause_fault(void)
{
    __asm volatile("udf #0");
}

int32_t semihost_call(uint32_t operation, const void *arguments)
{
    register uint32_t r0 __asm("r0") = operation;
    register const void *r1 __asm("r1") = arguments;
    __asm volatile("bkpt 0xAB" : "+r"(r0) : "r"(r1) : "memory");
    return (int32_t)r0;
}

/* ---- time: SysTick counts down; under "-icount" its rate is a fixed number of instructions a tick ---- */

void ticks_start(void)
{
    SYST_RVR = 0xFFFFFFu;
    SYST_CVR = 0;
    SYST_CSR = 5u; /* on, processor clock, no interrupt */
}

uint32_t ticks_since(uint32_t start)
{
    return (start - SYST_CVR) & 0xFFFFFFu;
}

void spin(uint32_t loops)
{
    __asm volatile(".syntax unified\n1: subs %0, %0, #1\n bne 1b" : "+l"(loops) : : "cc");
}
