/* The firmware's other ways to run, beside the replay of main.c. Both return the exit status. */
#ifndef MODES_H
#define MODES_H

/* firmware --control FRAMES.bin: a 1 kHz loop on the states of a vector file. */
int run_control(const char *frames);

/* firmware --serial: answers questions on the board's UART for ever (docs/runtime.md has the protocol). */
int run_serial(void);

#endif
