/*
 * A 32-bit RISC-V, the first instruction at the start of its memory (qemu's virt board): reset with the FPU on, where there is
 * one; faults are reported and end the run with a status that is not zero.
 */
#include <stdint.h>

#include "figures.h"
#include "semihosting.h"
#include "startup.h"

void reset_handler(void);
void fault_handler(void);

__attribute__((naked, used, section(".vectors"))) void reset_handler(void)
{
    __asm volatile(".option arch, +zicsr\n"
                   "la sp, __stack_top\n"
                   "la t0, fault_handler\n"
                   "csrw mtvec, t0\n"
                   "li t0, 0x6000\n" /* mstatus.FS */
                   "csrs mstatus, t0\n"
                   "j enter_main\n");
}

/* on a stack that is surely there */
__attribute__((naked, aligned(4))) void fault_handler(void)
{
    __asm volatile("la sp, __stack_top\n"
                   "j report_fault\n");
}

__attribute__((used)) void report_fault(void)
{
    uint32_t cause, pc;
    __asm volatile(".option arch, +zicsr\n csrr %0, mcause\n csrr %1, mepc" : "=r"(cause), "=r"(pc));
    semihost_puts("firmware: fault ");
    semihost_put_u32(cause);
    semihost_puts(" (mcause) PC ");
    semihost_put_hex(pc);
    semihost_puts("\n");
    semihost_exit(EXIT_FAULT);
}

void cause_fault(void)
{
    __asm volatile("unimp");
}

/* three instructions that are not compressed, in one page: so a debugger knows the call */
__attribute__((noinline)) int32_t semihost_call(uint32_t operation, const void *arguments)
{
    register uint32_t a0 __asm("a0") = operation;
    register const void *a1 __asm("a1") = arguments;
    __asm volatile(".option push\n.option norvc\n.balign 16\n"
                   "slli x0, x0, 0x1f\n ebreak\n srai x0, x0, 7\n"
                   ".option pop"
                   : "+r"(a0)
                   : "r"(a1)
                   : "memory");
    return (int32_t)a0;
}

/* ---- time: mcycle counts up; under "-icount" it counts instructions ---- */

void ticks_start(void)
{
}

uint32_t ticks_since(uint32_t start)
{
    return ticks_now() - start;
}

void spin(uint32_t loops)
{
    __asm volatile("1: addi %0, %0, -1\n bnez %0, 1b" : "+r"(loops));
}
