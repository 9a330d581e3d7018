// A model in memory as the exporter would write it to a binary file (docs/model-format.md).
#ifndef AMINN_TESTS_BLOB_WRITER_HPP
#define AMINN_TESTS_BLOB_WRITER_HPP

#include <cstdint>
#include <cstring>
#include <vector>

#include "crc.hpp"
#include "tables.hpp"

namespace blob_writer {

using Bytes = std::vector<uint8_t>;

template <class T>
void put(Bytes &bytes, const T &value)
{
    const auto *from = reinterpret_cast<const uint8_t *>(&value);
    bytes.insert(bytes.end(), from, from + sizeof value);
}

inline void put_name(Bytes &bytes, const char *name, size_t room)
{
    const size_t end = bytes.size() + room;
    bytes.insert(bytes.end(), name, name + std::strlen(name));
    bytes.resize(end);
}

inline void put_header(Bytes &bytes, const aminn_model_t &m)
{
    constexpr uint32_t kMagic = 0x4D4E4D41u; // "AMNM"
    for (uint32_t v : {kMagic,     m.format_version, 0u,
                       0u,         m.content_crc,    m.n_branch,
                       m.n_coord,  m.n_joint,        m.n_contact_feature,
                       m.n_wrench, m.n_gated,        m.n_twist,
                       m.n_stiff,  m.n_tendon,       m.n_slide,
                       m.n_told,   m.n_sensed,       m.contact_width,
                       m.width[0], m.width[1],       m.classifier_width,
                       m.dq0,      m.weight_type,    m.stages_crc}) {
        put(bytes, v);
    }
    for (float v : {m.length_scale, m.log_range, m.displacement_log_scale, m.tau, m.friction_nominal, m.max_translation,
                    m.max_rotation}) {
        put(bytes, v);
    }
    put(bytes, m.bound_edge);
    put(bytes, m.bound_factor);
    put(bytes, m.checkpoint_sha256);
    put(bytes, m.data_sha256);
    for (float v : {m.stage[0].eps_kx, m.stage[1].eps_kx, m.stage[0].eps_jq, m.stage[1].eps_jq}) {
        put(bytes, v);
    }
    put_name(bytes, m.name, 56);
    put_name(bytes, m.hand, 56);
    put_name(bytes, m.made_by, 40);
}

// Size and CRC-32 in a blob's header made right (the fuzz targets do it faster, for millions of blobs).
inline void seal(uint8_t *data, size_t size)
{
    const auto bytes = static_cast<uint32_t>(size);
    const uint32_t crc = aminn::crc32(0, data + 16, size - 16);
    std::memcpy(data + 8, &bytes, sizeof bytes);
    std::memcpy(data + 12, &crc, sizeof crc);
}

// The model as a blob; widths may be smaller than those of its tables, which are cut then.
inline Bytes blob_of(const aminn_model_t &m)
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
    seal(bytes.data(), bytes.size());
    return bytes;
}

} // namespace blob_writer

#endif
