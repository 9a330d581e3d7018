/*
 * The serial protocol of `aminn verify --port`: read a question, predict, answer (docs/runtime.md). On qemu's MPS2 boards
 * through their first UART; on another board replace get() and put().
 */
#include <string.h>

#include MODEL_HEADER
#include "figures.h"
#include "modes.h"
#include "vector_file.h"

#ifndef UART_BASE
#define UART_BASE 0x40004000u
#endif
#define UART_DATA (*(volatile uint32_t *)(UART_BASE + 0x00u))
#define UART_STATE (*(volatile uint32_t *)(UART_BASE + 0x04u))
#define UART_CTRL (*(volatile uint32_t *)(UART_BASE + 0x08u))
#define UART_BAUDDIV (*(volatile uint32_t *)(UART_BASE + 0x10u))

enum { TX_FULL = 1u, RX_FULL = 2u, TX_RX_ENABLE = 3u, BAUD_DIVIDER = 217 /* 25 MHz / 115200 */, BAD_FRAME = -100 };

typedef struct question {
    aminn_input_t in;
    uint32_t crc;
} question_t;

typedef struct answer {
    int32_t status;
    float outputs[RESULT_N_OUT];
    uint32_t crc;
} answer_t;

static aminn_t ctx;
static question_t question;
static answer_t answer;

static uint8_t get(void)
{
    while ((UART_STATE & RX_FULL) == 0) {
    }
    return (uint8_t)UART_DATA;
}

static void put(uint8_t byte)
{
    while ((UART_STATE & TX_FULL) != 0) {
    }
    UART_DATA = byte;
}

static void get_all(void *bytes, size_t n)
{
    uint8_t *p = (uint8_t *)bytes;
    while (n-- > 0) {
        *p++ = get();
    }
}

static void put_all(const void *bytes, size_t n)
{
    const uint8_t *p = (const uint8_t *)bytes;
    while (n-- > 0) {
        put(*p++);
    }
}

/* skips bytes until the mark has passed */
static void wait_for(const char mark[4])
{
    char window[4] = {0, 0, 0, 0};
    while (memcmp(window, mark, sizeof window) != 0) {
        memmove(window, window + 1, sizeof window - 1);
        window[3] = (char)get();
    }
}

static void predict(void)
{
    aminn_output_t out;
    answer.status = aminn_predict(&ctx, &question.in, &out);
    answer.outputs[0] = out.p_stable;
    memcpy(answer.outputs + 1, out.dx_ht, sizeof out.dx_ht);
    memcpy(answer.outputs + 7, out.k_x, sizeof out.k_x);
    memcpy(answer.outputs + 43, out.gate, sizeof out.gate);
    answer.outputs[46] = (float)out.stable;
}

int run_serial(void)
{
    UART_BAUDDIV = BAUD_DIVIDER;
    UART_CTRL = TX_RX_ENABLE;
    if (aminn_init(&ctx, &MODEL_SYMBOL, AMINN_FLAG_ALWAYS_STAGE2) != AMINN_OK) {
        return fail("serial", "the model is refused");
    }
    for (;;) {
        wait_for("AMNQ");
        get_all(&question, sizeof question);
        if (vector_crc(0, &question.in, sizeof question.in) == question.crc) {
            predict();
        } else {
            answer.status = BAD_FRAME;
        }
        answer.crc = vector_crc(0, &answer, offsetof(answer_t, crc));
        put_all("AMNA", 4);
        put_all(&answer, sizeof answer);
    }
}
