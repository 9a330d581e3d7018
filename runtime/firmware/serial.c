/* The serial protocol of `aminn verify --port`: read a question, predict, answer (docs/runtime.md). */
#include <string.h>

#include MODEL_HEADER
#include "figures.h"
#include "modes.h"
#include "serial.h"
#include "uart.h"
#include "vector_file.h"

enum { PROTOCOL = 3, KIND_REFUSED = 0, KIND_IDENTITY = 1, KIND_PREDICT = 2, KIND_SENSE = 3 };
enum { REFUSED_DAMAGED = 1, REFUSED_VERSION = 2, REFUSED_KIND = 3 };

typedef struct frame_header {
    uint16_t version, kind;
    uint32_t sequence; /* chosen by the host, repeated in the answer */
    uint32_t length;   /* of the body, bytes */
} frame_header_t;

typedef struct identity {
    char name[56], hand[56], made_by[44], library[16];
    uint8_t checkpoint_sha256[32], data_sha256[32];
    uint32_t format_version, content_crc;
    float tau;
    int32_t self_test; /* status of aminn_self_test() */
} identity_t;

typedef struct prediction {
    int32_t status;
    float outputs[RESULT_N_OUT];
} prediction_t;

static aminn_t ctx;
/* Of a prediction: the input; behind it of a told model theta, and of one that sees them sensors, where the question has them. */
#ifdef MODEL_TOLD
enum { N_THETA = AMINN_N_THETA };
static aminn_calibration_t calibration;
#else
enum { N_THETA = 0 };
#endif
#ifdef MODEL_SENSES
enum { N_SENSOR = AMINN_N_SENSOR };
static aminn_sensors_t sensors;
#else
enum { N_SENSOR = 0 };
#endif
static struct {
    aminn_input_t input;
    float more[N_THETA + N_SENSOR + 1];
} question;
enum { LARGEST_QUESTION = (VECTOR_N_IN + N_THETA + N_SENSOR) * 4 };
static aminn_status_t self_test;

/* 0, or -1 if a silence came before the last byte */
static int get_all(void *bytes, size_t n)
{
    uint8_t *p = (uint8_t *)bytes;
    while (n-- > 0) {
        const int byte = uart_get();
        if (byte < 0) {
            return -1;
        }
        *p++ = (uint8_t)byte;
    }
    return 0;
}

static void put_all(const void *bytes, size_t n)
{
    const uint8_t *p = (const uint8_t *)bytes;
    while (n-- > 0) {
        uart_put(*p++);
    }
}

/* skips bytes until the mark has passed; bytes of a mark that silence tears apart do not count */
static void wait_for(const char mark[4])
{
    char window[4] = {0, 0, 0, 0};
    while (memcmp(window, mark, sizeof window) != 0) {
        const int byte = uart_get();
        memmove(window, window + 1, sizeof window - 1);
        window[3] = (char)(byte < 0 ? 0 : byte);
    }
}

static void answer(uint16_t kind, uint32_t sequence, const void *body, uint32_t length)
{
    const frame_header_t header = {PROTOCOL, kind, sequence, length};
    const uint32_t crc = vector_crc(vector_crc(0, &header, sizeof header), body, length);
    put_all("AMNA", 4);
    put_all(&header, sizeof header);
    put_all(body, length);
    put_all(&crc, sizeof crc);
}

static void refuse(uint32_t sequence, uint32_t reason)
{
    answer(KIND_REFUSED, sequence, &reason, sizeof reason);
}

static void answer_identity(uint32_t sequence)
{
    const aminn_model_t *m = &MODEL_SYMBOL;
    static identity_t who; /* zeros behind every text */
    strncpy(who.name, m->name, sizeof who.name - 1);
    strncpy(who.hand, m->hand, sizeof who.hand - 1);
    strncpy(who.made_by, m->made_by, sizeof who.made_by - 1);
    strncpy(who.library, aminn_version(), sizeof who.library - 1);
    memcpy(who.checkpoint_sha256, m->checkpoint_sha256, sizeof who.checkpoint_sha256);
    memcpy(who.data_sha256, m->data_sha256, sizeof who.data_sha256);
    who.format_version = m->format_version;
    who.content_crc = m->content_crc;
    who.tau = m->tau;
    who.self_test = self_test;
    answer(KIND_IDENTITY, sequence, &who, sizeof who);
}

/* numbers of theta behind the input of a question; -1: it has another length than any */
static int theta_in(uint32_t kind, uint32_t length)
{
    const uint32_t bare = (uint32_t)sizeof question.input + (kind == KIND_SENSE ? N_SENSOR * 4u : 0u);
    if (kind == KIND_SENSE && N_SENSOR == 0) {
        return -1;
    }
    return length == bare ? 0 : N_THETA > 0 && length == bare + N_THETA * 4u ? N_THETA : -1;
}

static void answer_prediction(uint32_t sequence, uint32_t kind, int n_theta)
{
    prediction_t prediction;
    aminn_output_t out;
#ifdef MODEL_SENSES
    memcpy(&sensors, question.more + n_theta, sizeof sensors);
    aminn_sense(&ctx, kind == KIND_SENSE ? &sensors : NULL);
#endif
#ifdef MODEL_TOLD
    if (n_theta > 0) {
        prediction.status = predict_calibrated(&ctx, &MODEL_SYMBOL, &calibration, question.more, &question.input, &out);
        aminn_calibrate(&ctx, NULL);
    } else
#endif
    {
        prediction.status = aminn_predict(&ctx, &question.input, &out);
    }
    (void)n_theta;
    result_row(&out, prediction.outputs);
    answer((uint16_t)kind, sequence, &prediction, sizeof prediction);
}

/* what follows a mark: a question that is answered, or refused with the reason */
static void take_question(void)
{
    frame_header_t header;
    uint32_t crc;
    if (get_all(&header, sizeof header) != 0) {
        refuse(0, REFUSED_DAMAGED);
    } else if (header.length > LARGEST_QUESTION || get_all(&question, header.length) != 0 ||
               get_all(&crc, sizeof crc) != 0 ||
               vector_crc(vector_crc(0, &header, sizeof header), &question, header.length) != crc) {
        refuse(header.sequence, REFUSED_DAMAGED);
    } else if (header.version != PROTOCOL) {
        refuse(header.sequence, REFUSED_VERSION);
    } else if (header.kind == KIND_IDENTITY && header.length == 0) {
        answer_identity(header.sequence);
    } else if ((header.kind == KIND_PREDICT || header.kind == KIND_SENSE) &&
               theta_in(header.kind, header.length) >= 0) {
        answer_prediction(header.sequence, header.kind, theta_in(header.kind, header.length));
    } else {
        refuse(header.sequence, REFUSED_KIND);
    }
}

int serial_start(void)
{
    uart_start();
    if (aminn_init(&ctx, &MODEL_SYMBOL, AMINN_FLAG_ALWAYS_STAGE2) != AMINN_OK) {
        return fail("serial", "the model is refused");
    }
    self_test = aminn_self_test(&ctx);
    return 0;
}

void serial_answer(void)
{
    wait_for("AMNQ");
    take_question();
}

int run_serial(void)
{
    if (serial_start() != 0) {
        return 1;
    }
    for (;;) {
        serial_answer();
    }
}
