// First inputs of the fuzz targets that need some: make_seeds FOLDER writes FOLDER/TARGET/...
#include <cstdio>
#include <filesystem>
#include <string>

extern "C" {
#include "host_file.h"
}
#include "blob_writer.hpp"
#include "byte_model.h"
#include "half_model.h"
#include "tiny_model.h"

// The library counts its coverage, which is the fuzzer's to read: here is none.
extern "C" {
void __sanitizer_cov_8bit_counters_init(char *, char *)
{
}
void __sanitizer_cov_pcs_init(const uintptr_t *, const uintptr_t *)
{
}
}

namespace {

using blob_writer::blob_of;
using blob_writer::Bytes;
using blob_writer::put;

constexpr uint32_t kSamples = 16;

void write(const std::filesystem::path &path, const void *bytes, size_t size)
{
    FILE *file = std::fopen(path.c_str(), "wb");
    if (file == nullptr || std::fwrite(bytes, 1, size, file) != size || std::fclose(file) != 0) {
        die("%s: cannot write", path.c_str());
    }
}

void write_model(const std::filesystem::path &path, const Bytes &blob)
{
    aminn_model_t model;
    if (aminn_model_from_blob(blob.data(), blob.size(), &model) != AMINN_OK) {
        die("%s: not a good model", path.c_str());
    }
    write(path, blob.data(), blob.size());
}

// small ones: a prediction is short, and so is the CRC-32
void write_models(const std::filesystem::path &folder)
{
    write_model(folder / "tiny", blob_of(tiny_model));
    write_model(folder / "byte", blob_of(byte_model));
    aminn_model_t model = tiny_model;
    model.contact_width = model.width[0] = model.width[1] = model.classifier_width = 1;
    model.dq0 = AMINN_DQ0_STATICS;
    write_model(folder / "smallest", blob_of(model));
    model.dq0 = AMINN_DQ0_INVERSE;
    model.stage[0].eps_jq = model.stage[1].eps_jq = 1e-3F;
    write_model(folder / "inverse", blob_of(model));
    model = half_model;
    model.contact_width = model.width[0] = model.width[1] = model.classifier_width = 2;
    write_model(folder / "half", blob_of(model));
}

// every set of choices that fuzz_predict.cpp has
void write_samples(const std::filesystem::path &folder, const aminn_input_t *inputs, const aminn_sensors_t &sensors)
{
    const float theta[AMINN_N_THETA] = {0.1F, -0.1F};
    for (uint32_t i = 0; i < kSamples; ++i) {
        Bytes bytes(1, static_cast<uint8_t>(i | i % 4 << 4));
        put(bytes, inputs[i]);
        put(bytes, sensors);
        put(bytes, theta);
        write(folder / std::to_string(i), bytes.data(), bytes.size());
    }
}

void write_vectors(const std::filesystem::path &folder, const aminn_input_t *inputs, const aminn_sensors_t &sensors)
{
    constexpr uint32_t kFew = 2;
    const float theta[AMINN_N_THETA] = {0.1F, -0.1F};
    for (const uint32_t told : {0u, 1u}) {
        Bytes samples;
        for (uint32_t i = 0; i < kFew; ++i) {
            put(samples, inputs[i]);
            if (told != 0) {
                put(samples, theta);
                put(samples, sensors);
            }
        }
        samples.resize(samples.size() + kFew * AMINN_N_OUTPUT * (sizeof(float) + (told != 0 ? sizeof(double) : 0u)));
        const uint32_t also = told != 0 ? 1u | AMINN_N_SENSOR << 8 | AMINN_N_THETA << 16 : 0u;
        Bytes bytes;
        put(bytes, vector_header_t{VECTOR_MAGIC, VECTOR_VERSION, kFew, VECTOR_N_IN, VECTOR_N_OUT, also,
                                   vector_crc(0, samples.data(), samples.size()), 0});
        bytes.insert(bytes.end(), samples.begin(), samples.end());
        write(folder / (told != 0 ? "told" : "plain"), bytes.data(), bytes.size());
    }
    const float rows[kFew * RESULT_N_OUT] = {0.5F};
    const int32_t statuses[kFew] = {0, -4};
    Bytes bytes;
    put(bytes, result_header(kFew, rows, statuses));
    put(bytes, rows);
    put(bytes, statuses);
    write(folder / "results", bytes.data(), bytes.size());
}

// questions of every kind, one by one, and one that is longer than any
void write_questions(const std::filesystem::path &folder, const aminn_input_t &input, const aminn_sensors_t &sensors)
{
    for (uint16_t kind = 0; kind < 5; ++kind) {
        Bytes body(kind == 4 ? 600 : 0);
        if (kind == 2 || kind == 3) {
            put(body, input);
        }
        if (kind == 3) {
            put(body, sensors);
        }
        Bytes frame;
        put(frame, uint16_t{3});
        put(frame, kind);
        put(frame, uint32_t{7});
        put(frame, static_cast<uint32_t>(body.size()));
        frame.insert(frame.end(), body.begin(), body.end());
        put(frame, vector_crc(0, frame.data(), frame.size()));
        frame.insert(frame.begin(), {'A', 'M', 'N', 'Q'});
        write(folder / std::to_string(kind), frame.data(), frame.size());
    }
}

} // namespace

int main(int argc, char **argv)
{
    program_name = "make_seeds";
    if (argc != 2) {
        die("usage: make_seeds FOLDER");
    }
    const std::filesystem::path folder = argv[1];
    for (const char *target : {"blob", "predict", "vectors", "serial"}) {
        std::filesystem::create_directories(folder / target);
    }
    const vector_header_t *golden = open_vectors(GOLDEN_DIR "/golden.bin");
    if (golden->n < kSamples || vector_n_sensor(golden) == 0) {
        die("golden.bin: too few samples, or no sensors");
    }
    static aminn_input_t inputs[kSamples];
    aminn_sensors_t sensors = {};
    const float *sample = reinterpret_cast<const float *>(golden + 1);
    for (aminn_input_t &input : inputs) {
        std::memcpy(&input, sample, sizeof input);
        std::memcpy(&sensors, sample + VECTOR_N_IN, sizeof sensors);
        sample += vector_sample(golden);
    }
    write_models(folder / "blob");
    write_samples(folder / "predict", inputs, sensors);
    write_vectors(folder / "vectors", inputs, sensors);
    write_questions(folder / "serial", inputs[0], sensors);
    return 0;
}
