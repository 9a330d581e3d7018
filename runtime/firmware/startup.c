/*
 * From reset to main on a Cortex-M7: FPU on, stack painted, .data and .bss set up; faults are reported and end the run
 * with a status that is not zero.
 */
#include <stdint.h>

#include "semihosting.h"
#include "startup.h"

#define SCB_CPACR (*(volatile uint32_t *)0xE000ED88u)
#define SCB_SHCSR (*(volatile uint32_t *)0xE000ED24u)
#define SCB_CFSR (*(volatile uint32_t *)0xE000ED28u)
#define SCB_HFSR (*(volatile uint32_t *)0xE000ED2Cu)
#define SCB_BFAR (*(volatile uint32_t *)0xE000ED38u)

#define STACK_PAINT 0xC5C5C5C5u

extern uint32_t __stack_limit[], __stack_top[];
extern uint32_t __data_load[], __data_start[], __data_end[], __bss_start[], __bss_end[];

int main(void);
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

/* The loops below must not become calls of memcpy or memset: those may use the FPU or the stack. */
__attribute__((noinline, optimize("no-tree-loop-distribute-patterns"))) void reset_handler(void)
{
    uint32_t *from = __data_load;
    uint32_t *to;
    SCB_CPACR |= 0xFu << 20; /* full access to the FPU */
    SCB_SHCSR |= 7u << 16;   /* memory, bus and usage faults have their own handlers */
    __asm volatile("dsb\n isb" ::: "memory");
    for (to = __data_start; to < __data_end; ++to) {
        *to = *from++;
    }
    for (to = __bss_start; to < __bss_end; ++to) {
        *to = 0;
    }
    stack_paint();
    semihost_exit(main());
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

__attribute__((noinline)) void stack_paint(void)
{
    volatile uint32_t *word = __stack_limit;
    const uint32_t *const here = (const uint32_t *)__builtin_frame_address(0);
    while (word < here - 16) { /* leaves this frame alone */
        *word++ = STACK_PAINT;
    }
}

uint32_t stack_free(void)
{
    const volatile uint32_t *word = __stack_limit;
    while (word < __stack_top && *word == STACK_PAINT) {
        ++word;
    }
    return (uint32_t)((uintptr_t)word - (uintptr_t)__stack_limit);
}

uint32_t stack_size(void)
{
    return (uint32_t)((uintptr_t)__stack_top - (uintptr_t)__stack_limit);
}

uint32_t stack_pointer_free(void)
{
    uint32_t sp;
    __asm volatile("mov %0, sp" : "=r"(sp));
    return sp - (uint32_t)(uintptr_t)__stack_limit;
}
