// First inputs of both fuzz targets: make_seeds FOLDER writes FOLDER/blob and FOLDER/predict.
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <string>
#include <vector>

extern "C" {
#include "host_file.h"
}
#include "mutate.hpp"
#include "tables.hpp"
#include "tiny_model.h"

namespace {

using Bytes = std::vector<uint8_t>;

constexpr uint32_t kSamples = 16;
constexpr uint32_t kMagic = 0x4D4E4D41u; // "AMNM"

template <class T>
void put(Bytes &bytes, const T &value)
{
    const uint8_t *from = reinterpret_cast<const uint8_t *>(&value);
    bytes.insert(bytes.end(), from, from + sizeof value);
}

void put_name(Bytes &bytes, const char *name, size_t room)
{
    const size_t end = bytes.size() + room;
    bytes.insert(bytes.end(), name, name + std::strlen(name));
    bytes.resize(end);
}

void put_header(Bytes &bytes, const aminn_model_t &m)
{
    for (uint32_t v :
         {kMagic, m.format_version, 0u, 0u, m.content_crc, m.n_branch, m.n_coord, m.n_joint, m.n_contact_feature,
          m.n_wrench, m.n_gated, m.contact_width, m.width, m.classifier_width, m.dq0, m.weight_type, m.stages_crc}) {
        put(bytes, v);
    }
    for (float v : {m.length_scale, m.log_range, m.displacement_log_scale, m.tau}) {
        put(bytes, v);
    }
    put(bytes, m.checkpoint_sha256);
    put(bytes, m.data_sha256);
    for (float v : {m.stage[0].eps_kx, m.stage[1].eps_kx, m.stage[0].eps_jq, m.stage[1].eps_jq}) {
        put(bytes, v);
    }
    put(bytes, AMINN_N_TWIST);
    put_name(bytes, m.name, 56);
    put_name(bytes, m.hand, 56);
    put_name(bytes, m.made_by, 40);
}

// the model as a blob; widths may be smaller than those of its tables, which are cut then
Bytes blob_of(const aminn_model_t &m)
{
    Bytes bytes;
    put_header(bytes, m);
    for (const aminn::TableInfo &info : aminn::kTables) {
        aminn::Table table;
        aminn::find_table(m, info, table);
        const auto *values = static_cast<const uint8_t *>(table.numbers);
        const size_t end = bytes.size() + aminn::table_room(m, info);
        bytes.insert(bytes.end(), values, values + table.n * table.size);
        bytes.resize(end);
    }
    fuzz::seal_blob(bytes.data(), bytes.size());
    return bytes;
}

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
