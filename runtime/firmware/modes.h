/* The firmware's other ways to run, beside the replay of main.c. Each returns the exit status. */
#ifndef MODES_H
#define MODES_H

#include "limiter.h"

/* Of the two modes that have one: memory is short on some boards. */
extern limiter_t limiter;

/* firmware --control FRAMES.bin: a 100 Hz loop on the states of a vector file. */
int run_control(const char *frames);

/* firmware --calibrate PUSHES.bin: the limiter judges loads, learns from ten pushes, and judges them again (learn.c). */
int run_calibration(const char *pushes);

/* firmware --serial: answers questions on the board's UART for ever (docs/runtime.md has the protocol). */
int run_serial(void);

/* firmware --self-test: the self-test of an initialised context under other modes of the FPU, each of which it must name. */
int run_self_test(aminn_t *ctx);

#endif
