/* The first UART of qemu's MPS2 and MPS3 boards. */
#include "uart.h"

#include "figures.h"

#define UART_DATA (*(volatile uint32_t *)(UART_BASE + 0x00u))
#define UART_STATE (*(volatile uint32_t *)(UART_BASE + 0x04u))
#define UART_CTRL (*(volatile uint32_t *)(UART_BASE + 0x08u))
#define UART_BAUDDIV (*(volatile uint32_t *)(UART_BASE + 0x10u))

enum { TX_FULL = 1u, RX_FULL = 2u, TX_RX_ENABLE = 3u, BAUD_DIVIDER = 217 /* 25 MHz / 115200 */ };
enum { SILENCE_TICKS = 25000000 / 5 }; /* of the boards' clock */

void uart_start(void)
{
    UART_BAUDDIV = BAUD_DIVIDER;
    UART_CTRL = TX_RX_ENABLE;
    ticks_start();
}

int uart_get(void)
{
    const uint32_t start = ticks_now();
    while ((UART_STATE & RX_FULL) == 0) {
        if (ticks_since(start) > SILENCE_TICKS) {
            return -1;
        }
    }
    return (int)(UART_DATA & 0xFFu);
}

void uart_put(uint8_t byte)
{
    while ((UART_STATE & TX_FULL) != 0) {
    }
    UART_DATA = byte;
}
