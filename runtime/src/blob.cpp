// A model as bytes in memory (docs/model-format.md).

#include "crc.hpp"
#include "parts.hpp"
#include "tables.hpp"

namespace aminn {
namespace {

constexpr uint32_t kMagic = 0x4D4E4D41u; // "AMNM"

// first bytes of a blob, little endian
struct Header {
    uint32_t magic;
    uint32_t format_version;
    uint32_t size;        // of the whole blob, bytes
    uint32_t crc;         // of everything after this field
    uint32_t content_crc; // from here to data_sha256 as in aminn_model_t
    uint32_t n_branch;
    uint32_t n_coord;
    uint32_t n_joint;
    uint32_t n_contact_feature;
    uint32_t n_wrench;
    uint32_t n_gated;
    uint32_t n_twist;
    uint32_t n_stiff;
    uint32_t n_tendon;
    uint32_t n_slide;
    uint32_t n_told;
    uint32_t n_sensed;
    uint32_t contact_width;
    uint32_t width[AMINN_N_STAGE];
    uint32_t classifier_width;
    uint32_t dq0;
    uint32_t weight_type;
    uint32_t stages_crc;
    float length_scale;
    float log_range;
    float displacement_log_scale;
    float tau;
    float friction_nominal;
    float max_translation;
    float max_rotation;
    float bound_edge[3];
    float bound_factor[4];
    uint8_t checkpoint_sha256[32];
    uint8_t data_sha256[32];
    float eps_kx[AMINN_N_STAGE];
    float eps_jq[AMINN_N_STAGE];
    char name[56];
    char hand[56];
    char made_by[40];
};
static_assert(sizeof(Header) == 384, "header layout");
constexpr size_t kCrcStart = offsetof(Header, content_crc);
constexpr size_t kSameBytes = offsetof(Header, eps_kx) - offsetof(Header, content_crc);
static_assert(offsetof(aminn_model_t, data_sha256) + sizeof(aminn_model_t::data_sha256) -
                      offsetof(aminn_model_t, content_crc) ==
                  kSameBytes,
              "copied as a whole");

constexpr uint32_t reversed(uint32_t v)
{
    return v >> 24 | (v >> 8 & 0xFF00u) | (v & 0xFF00u) << 8 | v << 24;
}

aminn_status_t check_header(const uint8_t *bytes, size_t len, Header &header)
{
    if (len < sizeof header) {
        return AMINN_E_SIZE;
    }
    __builtin_memcpy(&header, bytes, sizeof header);
    if (header.magic != kMagic) {
        return header.magic == reversed(kMagic) ? AMINN_E_BYTE_ORDER : AMINN_E_MAGIC;
    }
    if (header.format_version != AMINN_FORMAT_VERSION) {
        return AMINN_E_VERSION;
    }
    if (header.size != len) {
        return AMINN_E_SIZE;
    }
    return crc32(0, bytes + kCrcStart, len - kCrcStart) == header.crc ? AMINN_OK : AMINN_E_CRC;
}

void copy_constants(const Header &h, aminn_model_t &m)
{
    m.format_version = h.format_version;
    __builtin_memcpy(&m.content_crc, &h.content_crc, kSameBytes);
    for (int i = 0; i < AMINN_N_STAGE; ++i) {
        m.stage[i].eps_kx = h.eps_kx[i];
        m.stage[i].eps_jq = h.eps_jq[i];
    }
}

// Point the names into the blob; false if one does not end there.
bool place_names(const uint8_t *bytes, aminn_model_t &m)
{
    const auto *header = reinterpret_cast<const Header *>(bytes); // it begins where a number may
    m.name = header->name;
    m.hand = header->hand;
    m.made_by = header->made_by;
    return header->name[sizeof header->name - 1] == '\0' && header->hand[sizeof header->hand - 1] == '\0' &&
           header->made_by[sizeof header->made_by - 1] == '\0';
}

static_assert(sizeof(Header) % kTableAlignment == 0, "the tables follow the header at once");

// point the tables into the blob; false if it is not exactly as long as they are
bool place_tables(const uint8_t *bytes, size_t len, aminn_model_t &m)
{
    size_t at = sizeof(Header);
    for (const TableInfo &table : kTables) {
        const size_t size = table_room(m, table);
        if (len - at < size) {
            return false;
        }
        set_table_pointer(m, table, bytes + at);
        at += size;
    }
    return at == len;
}

// No table: its addresses would be data that a loader writes.
const aminn_storage_t *storage_of(uint32_t weight_type)
{
    return weight_type == AMINN_WEIGHTS_FLOAT16 ? &aminn_storage_float16
           : weight_type == AMINN_WEIGHTS_INT8  ? &aminn_storage_int8
                                                : nullptr;
}

aminn_status_t load(const uint8_t *bytes, size_t len, aminn_model_t &m)
{
    Header header;
    const aminn_status_t status = check_header(bytes, len, header);
    if (status != AMINN_OK) {
        return status;
    }
    copy_constants(header, m);
    if (!widths_ok(m)) { // before they are multiplied
        return AMINN_E_DIMS;
    }
    m.storage = storage_of(m.weight_type);
    const bool named = place_names(bytes, m);
    const bool placed = place_tables(bytes, len, m);
    const aminn_status_t checked = aminn_model_check(&m);
    if (checked == AMINN_E_DIMS || m.weight_type > AMINN_WEIGHTS_INT8) { // they make other lengths: name the cause
        return checked;
    }
    if (!placed) {
        return AMINN_E_SIZE;
    }
    return named ? checked : AMINN_E_MODEL;
}

} // namespace
} // namespace aminn

aminn_status_t aminn_model_from_blob(const void *bytes, size_t len, aminn_model_t *model_out)
{
    if (model_out == nullptr) {
        return AMINN_E_NULL;
    }
    *model_out = aminn_model_t{};
    if (bytes == nullptr) {
        return AMINN_E_NULL;
    }
    if (reinterpret_cast<uintptr_t>(bytes) % alignof(float) != 0) {
        return AMINN_E_ALIGN;
    }
    const aminn_status_t status = aminn::load(static_cast<const uint8_t *>(bytes), len, *model_out);
    if (status != AMINN_OK) {
        *model_out = aminn_model_t{};
    }
    return status;
}
