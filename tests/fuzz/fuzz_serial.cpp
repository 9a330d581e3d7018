// Fuzz target: any bytes on the serial line of the firmware's protocol, and silences between them. Every answer is a whole frame,
// predictions have the bits of the library's, and after a silence a good question is answered.
#include <csetjmp>
#include <cstdio>
#include <cstring>
#include <vector>

#include "aminn_model.h"
#include "checks.hpp"
#include "fast_crc.hpp"
#include "mutate.hpp"

extern "C" {
#include "figures.h"
#include "serial.h"
#include "uart.h"
#include "vector_file.h"
}

using namespace fuzz;

namespace {

constexpr int kSilence = 0xFB; // on this line the byte that a silence stands for, doubled where it is meant
constexpr uint32_t kSequence = 0x5EA1ED00u;
constexpr size_t kHeader = 12;
constexpr uint32_t kIdentity = 252;

std::vector<uint8_t> line;
std::vector<uint8_t> said;
size_t at;
std::jmp_buf over;

struct Frame {
    uint16_t version, kind;
    uint32_t sequence, length;
};

void put_question(std::vector<uint8_t> &bytes, const Frame &frame, const void *body)
{
    uint8_t header[kHeader];
    std::memcpy(header, &frame, sizeof header);
    uint32_t crc = crc32(0, header, sizeof header);
    crc = crc32(crc, body, frame.length);
    const auto put = [&bytes](const void *from, size_t n) {
        for (size_t i = 0; i < n; ++i) {
            const uint8_t byte = static_cast<const uint8_t *>(from)[i];
            bytes.insert(bytes.end(), byte == kSilence ? 2 : 1, byte);
        }
    };
    put("AMNQ", 4);
    put(header, sizeof header);
    put(body, frame.length);
    put(&crc, sizeof crc);
}

// a question that the prediction must be of
aminn_t ctx;

void check_prediction_of(const uint8_t *body, uint32_t length)
{
    int32_t status = 0;
    float row[RESULT_N_OUT];
    FUZZ_CHECK(length == sizeof status + sizeof row);
    std::memcpy(&status, body, sizeof status);
    std::memcpy(row, body + sizeof status, sizeof row);
    FUZZ_CHECK(status <= AMINN_OK && status >= AMINN_E_SENSORS);
    FUZZ_CHECK(row[0] >= 0.0F && row[0] <= 1.0F);
    FUZZ_CHECK(status == AMINN_OK ? row[1] - row[1] == 0.0F : row[1] != row[1] && row[VECTOR_N_OUT] == 0.0F);
}

// number of answers; what the last one was is kept
size_t check_answers(Frame &last, const uint8_t *&body)
{
    size_t n = 0;
    for (size_t i = 0; i < said.size(); ++n) {
        FUZZ_CHECK(said.size() - i >= 4 + kHeader + 4 && std::memcmp(&said[i], "AMNA", 4) == 0);
        std::memcpy(&last, &said[i + 4], kHeader);
        FUZZ_CHECK(last.version == 3 && last.kind <= 3 && last.length <= 512);
        FUZZ_CHECK(said.size() - i >= 4 + kHeader + last.length + 4);
        body = &said[i + 4 + kHeader];
        uint32_t crc = 0;
        std::memcpy(&crc, body + last.length, sizeof crc);
        FUZZ_CHECK(crc == crc32(0, &said[i + 4], kHeader + last.length));
        if (last.kind >= 2) {
            check_prediction_of(body, last.length);
        } else {
            FUZZ_CHECK(last.kind == 0 ? last.length == 4 && body[0] >= 1 && body[0] <= 3 : last.length == kIdentity);
        }
        i += 4 + kHeader + last.length + 4;
    }
    return n;
}

void check_last(const Frame &last, const uint8_t *body)
{
    static const std::vector<float> expected = [] {
        aminn_output_t out;
        std::vector<float> row(RESULT_N_OUT);
        FUZZ_CHECK(aminn_init(&ctx, &aminn_model, AMINN_FLAG_ALWAYS_STAGE2) == AMINN_OK);
        FUZZ_CHECK(aminn_predict(&ctx, &golden_input(), &out) == AMINN_OK);
        result_row(&out, row.data());
        return row;
    }();
    FUZZ_CHECK(last.kind == 2 && last.sequence == kSequence);
    FUZZ_CHECK(std::memcmp(body + 4, expected.data(), sizeof(float) * expected.size()) == 0);
}

size_t marks_in_line()
{
    size_t n = 0;
    for (size_t i = 0; i + 4 <= line.size(); ++i) {
        n += std::memcmp(&line[i], "AMNQ", 4) == 0 ? 1 : 0;
    }
    return n;
}

// a frame somewhere in the data gets the CRC-32 of its bytes
void seal_a_frame(uint8_t *data, size_t size)
{
    for (size_t i = 0; i + 4 + kHeader + 4 <= size; ++i) {
        Frame frame;
        std::memcpy(&frame, data + i + 4, kHeader);
        if (std::memcmp(data + i, "AMNQ", 4) == 0 && frame.length <= size - i - 4 - kHeader - 4) {
            const uint32_t crc = crc32(0, data + i + 4, kHeader + frame.length);
            std::memcpy(data + i + 4 + kHeader + frame.length, &crc, sizeof crc);
        }
    }
}

} // namespace

extern "C" {

void uart_start(void)
{
}

int uart_get(void)
{
    if (at == line.size()) {
        std::longjmp(over, 1);
    }
    const uint8_t byte = line[at++];
    if (byte == kSilence && (at == line.size() || line[at++] != kSilence)) {
        return -1;
    }
    return byte;
}

void uart_put(uint8_t byte)
{
    said.push_back(byte);
}

int fail(const char *what, const char *why)
{
    std::fprintf(stderr, "%s: %s\n", what, why);
    return 1;
}

size_t LLVMFuzzerCustomMutator(uint8_t *data, size_t size, size_t max_size, unsigned int seed)
{
    Random random(seed);
    if (size >= 4 && below(random, 2) == 0) {
        mutate_float(data + below(random, size - 3), random);
    } else {
        size = LLVMFuzzerMutate(data, size, max_size);
    }
    if (below(random, 8) != 0) {
        seal_a_frame(data, size);
    }
    return size;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static const bool started = serial_start() == 0;
    static const std::vector<uint8_t> closing = [] {
        std::vector<uint8_t> bytes;
        for (int i = 0; i < 4; ++i) { // one ends what goes before, the others are heard while nothing is asked
            bytes.push_back(kSilence);
            bytes.push_back(0);
        }
        put_question(bytes, {3, 2, kSequence, sizeof(aminn_input_t)}, &golden_input());
        return bytes;
    }();
    FUZZ_CHECK(started);
    line.assign(data, data + size);
    line.insert(line.end(), closing.begin(), closing.end());
    said.clear();
    at = 0;
    if (setjmp(over) == 0) {
        for (;;) {
            serial_answer();
        }
    }
    Frame last = {};
    const uint8_t *body = nullptr;
    const size_t n = check_answers(last, body);
    FUZZ_CHECK(n >= 1 && n <= marks_in_line());
    check_last(last, body);
    return 0;
}
}
