/*
 * What any processor does between reset and main: stack painted, .data and .bss set up. The machine's own part, which calls
 * this one, is in machine_cortex_m.c or machine_riscv.c.
 */
#include "startup.h"

#include "semihosting.h"

#define STACK_PAINT 0xC5C5C5C5u
#ifdef __riscv
#define COPY_SP "mv %0, sp"
#else
#define COPY_SP "mov %0, sp"
#endif

extern uint32_t __stack_limit[], __stack_top[];
extern uint32_t __data_load[], __data_start[], __data_end[], __bss_start[], __bss_end[];

int main(void);

/* The loops below must not become calls of memcpy or memset: those may use the FPU or the stack. */
__attribute__((noinline, optimize("no-tree-loop-distribute-patterns"))) void enter_main(void)
{
    uint32_t *from = __data_load;
    uint32_t *to;
    for (to = __data_start; to < __data_end; ++to) {
        *to = *from++;
    }
    for (to = __bss_start; to < __bss_end; ++to) {
        *to = 0;
    }
    stack_paint();
    semihost_exit(main());
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
    __asm volatile(COPY_SP : "=r"(sp));
    return sp - (uint32_t)(uintptr_t)__stack_limit;
}
