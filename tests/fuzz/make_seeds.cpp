// First inputs of both fuzz targets: make_seeds FOLDER writes FOLDER/blob and FOLDER/predict.
#include <cstdio>
#include <filesystem>
#include <string>

extern "C" {
#include "host_file.h"
}
#include "blob_writer.hpp"
#include "tiny_model.h"

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

void write_models(const std::filesystem::path &folder)
{
    size_t size = 0;
    const uint8_t *reference = static_cast<const uint8_t *>(read_file(GOLDEN_DIR "/aminn_model.bin", &size));
    write_model(folder / "reference", Bytes(reference, reference + size));
    aminn_model_t model = tiny_model;
    write_model(folder / "tiny", blob_of(model));
    model.contact_width = model.width = model.classifier_width = 1;
    write_model(folder / "smallest", blob_of(model));
    model.dq0 = AMINN_DQ0_INVERSE;
    model.stage[0].eps_jq = model.stage[1].eps_jq = 1e-3F;
    write_model(folder / "inverse", blob_of(model));
}

void write_samples(const std::filesystem::path &folder)
{
    const vector_header_t *header = open_vectors(GOLDEN_DIR "/golden.bin");
    const aminn_input_t *inputs = reinterpret_cast<const aminn_input_t *>(header + 1);
    for (uint32_t i = 0; i < kSamples && i < header->n; ++i) {
        Bytes bytes(1, static_cast<uint8_t>(i % 4)); // function and flags
        put(bytes, inputs[i]);
        write(folder / std::to_string(i), bytes.data(), bytes.size());
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
    std::filesystem::create_directories(folder / "blob");
    std::filesystem::create_directories(folder / "predict");
    write_models(folder / "blob");
    write_samples(folder / "predict");
    return 0;
}
