// Fuzz target: any bytes as a vector file or a result file, read as the host's programs read one. What is refused is wrong by
// this file's own reckoning; what is accepted is predicted.
#include <csetjmp>
#include <cstdio>
#include <cstring>

#include <sys/mman.h>
#include <unistd.h>

#include "aminn_model.h"
#include "checks.hpp"
#include "fast_crc.hpp"
#include "mutate.hpp"
#include "tiny_model.h"

extern "C" {
#include "host_file.h"

// host_file.c is compiled with these in the place of exit() and posix_memalign()
[[noreturn]] void fuzz_exit(int status);
int fuzz_memalign(void **memory, size_t alignment, size_t size);
}

using namespace fuzz;

namespace {

constexpr size_t kRoom = 32768; // more than the longest input
constexpr size_t kRows = kRoom / sizeof(aminn_input_t);

alignas(64) uint8_t file_bytes[kRoom];
float rows[kRows * RESULT_N_OUT];
int32_t statuses[kRows];
std::jmp_buf refused;

// the name of a file in memory with these bytes
const char *file_of(const uint8_t *data, size_t size)
{
    static const int descriptor = memfd_create("vectors", 0);
    static char path[32];
    std::snprintf(path, sizeof path, "/proc/self/fd/%d", descriptor);
    FUZZ_CHECK(ftruncate(descriptor, 0) == 0);
    FUZZ_CHECK(pwrite(descriptor, data, size, 0) == static_cast<ssize_t>(size));
    return path;
}

// null where the file is refused
const vector_header_t *open_file(const char *path, const vector_header_t *(*open)(const char *))
{
    static std::FILE *const nowhere = std::fopen("/dev/null", "w");
    std::FILE *const messages = stderr;
    const vector_header_t *volatile header = nullptr;
    stderr = nowhere;
    if (setjmp(refused) == 0) {
        header = open(path);
    }
    stderr = messages;
    return header;
}

bool is_good(const uint8_t *data, size_t size, uint32_t magic)
{
    vector_header_t h;
    if (size < sizeof h) {
        return false;
    }
    std::memcpy(&h, data, sizeof h);
    const uint64_t rest = size - sizeof h;
    if (h.magic != magic || h.version != VECTOR_VERSION || crc32(0, data + sizeof h, rest) != h.crc) {
        return false;
    }
    if (magic == RESULT_MAGIC) {
        return h.n_in == 0 && h.n_out == AMINN_N_OUTPUT + 1 && h.also == 0 && h.model == 0 &&
               rest == uint64_t{h.n} * 4 * (AMINN_N_OUTPUT + 2);
    }
    const uint32_t f64 = h.also & 0xFFu;
    const uint32_t sensors = h.also >> 8 & 0xFFu;
    const uint32_t theta = h.also >> 16;
    const uint64_t sample = 4 * (uint64_t{AMINN_N_INPUT} + theta + sensors + AMINN_N_OUTPUT) + f64 * 8 * AMINN_N_OUTPUT;
    return h.n_in == AMINN_N_INPUT && h.n_out == AMINN_N_OUTPUT && f64 <= 1 &&
           (sensors == 0 || sensors == AMINN_N_SENSOR) && (theta == 0 || theta == AMINN_N_THETA) &&
           rest == h.n * sample;
}

void predict(const vector_header_t *vectors)
{
    static aminn_t ctx;
    const aminn_model_t &model = vector_n_sensor(vectors) != 0 ? aminn_model : tiny_model;
    FUZZ_CHECK(aminn_init(&ctx, &model, AMINN_FLAG_ALWAYS_STAGE2) == AMINN_OK);
    const uint32_t n_refused = predict_rows(&ctx, &model, vectors, rows, statuses);
    uint32_t counted = 0;
    for (uint32_t i = 0; i < vectors->n; ++i) {
        const float *row = rows + size_t{i} * RESULT_N_OUT;
        const float stable = row[VECTOR_N_OUT];
        counted += statuses[i] != AMINN_OK ? 1 : 0;
        FUZZ_CHECK(row[0] >= 0.0F && row[0] <= 1.0F && (stable == 0.0F || stable == 1.0F));
        FUZZ_CHECK(statuses[i] == AMINN_OK ? row[1] - row[1] == 0.0F : row[1] != row[1] && stable == 0.0F);
    }
    FUZZ_CHECK(counted == n_refused);
}

void seal(uint8_t *data, size_t size, Random &random)
{
    vector_header_t h;
    std::memcpy(&h, data, sizeof h);
    const uint64_t sample = vector_payload(&h) / (h.n > 0 ? h.n : 1);
    if (sample > 0 && below(random, 4) != 0) {
        h.n = static_cast<uint32_t>((size - sizeof h) / sample);
    }
    h.crc = crc32(0, data + sizeof h, size - sizeof h);
    std::memcpy(data, &h, sizeof h);
}

} // namespace

void fuzz_exit(int status)
{
    (void)status;
    std::longjmp(refused, 1);
}

int fuzz_memalign(void **memory, size_t alignment, size_t size)
{
    FUZZ_CHECK(alignment == alignof(decltype(file_bytes)) || alignment == 64);
    FUZZ_CHECK(size <= sizeof file_bytes);
    *memory = file_bytes;
    return 0;
}

extern "C" size_t LLVMFuzzerCustomMutator(uint8_t *data, size_t size, size_t max_size, unsigned int seed)
{
    Random random(seed);
    if (size >= sizeof(vector_header_t) + 4 && below(random, 2) == 0) {
        for (size_t n = 1 + below(random, 4); n > 0; --n) {
            mutate_float(data + sizeof(vector_header_t) + 4 * below(random, (size - sizeof(vector_header_t)) / 4),
                         random);
        }
    } else if (size >= sizeof(vector_header_t) && below(random, 2) == 0) {
        LLVMFuzzerMutate(data, sizeof(vector_header_t), sizeof(vector_header_t));
    } else {
        size = LLVMFuzzerMutate(data, size, max_size);
    }
    if (size >= sizeof(vector_header_t) && below(random, 16) != 0) {
        seal(data, size, random);
    }
    return size;
}

extern "C" int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    if (size >= kRoom) {
        return 0;
    }
    const char *path = file_of(data, size);
    const vector_header_t *vectors = open_file(path, open_vectors);
    FUZZ_CHECK((vectors != nullptr) == is_good(data, size, VECTOR_MAGIC));
    if (vectors != nullptr) {
        predict(vectors);
    }
    FUZZ_CHECK((open_file(path, open_results) != nullptr) == is_good(data, size, RESULT_MAGIC));
    return 0;
}
