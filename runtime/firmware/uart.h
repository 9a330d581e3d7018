/* The serial line that the protocol of serial.c runs on. On another board replace uart.c. */
#ifndef UART_H
#define UART_H

#include <stdint.h>

void uart_start(void);
/* A byte, or -1 after a fifth of a second of silence. */
int uart_get(void);
void uart_put(uint8_t byte);

#endif
