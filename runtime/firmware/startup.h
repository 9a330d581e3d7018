/* From reset to main, and the stack's high-water mark. */
#ifndef STARTUP_H
#define STARTUP_H

#include <stdint.h>

enum { EXIT_FAULT = 70 };

/* Of the machine's own part: runs into an undefined instruction, to try the fault handler. */
void cause_fault(void);

/* For the reset handler: memory, stack and main; ends the run. */
void enter_main(void);

/* Fill the unused part of the stack with a pattern. */
void stack_paint(void);

/* Bytes at the far end of the stack that were never written since it was painted. */
uint32_t stack_free(void);

/* Bytes of the whole stack, and bytes below the stack pointer here. */
uint32_t stack_size(void);
uint32_t stack_pointer_free(void);

#endif
