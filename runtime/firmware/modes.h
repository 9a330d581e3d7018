/* The firmware's other ways to run, beside the replay of main.c. Both return the exit status. */
#ifndef MODES_H
#define MODES_H

#include <stdint.h>

/* firmware --control FRAMES.bin: a 1 kHz loop on the states of a vector file. */
int run_control(const char *frames);

/* firmware --serial: answers questions on the board's UART for ever (docs/runtime.md has the protocol). */
int run_serial(void);

/* Of main.c: message, figure line, SysTick as a clock (ticks of the processor, instructions a tick times 1000). */
int fail(const char *what, const char *why);
void print_figure(const char *name, uint32_t value);
void ticks_start(void);
uint32_t ticks_since(uint32_t start);
uint32_t calibrate(void);

#endif
