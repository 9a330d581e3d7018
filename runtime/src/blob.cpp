// A model as bytes in memory (docs/model-format.md).
#include "parts.hpp"
#include "tables.hpp"

namespace aminn {
namespace {

constexpr uint32_t kMagic = 0x4D4E4D41u; // "AMNM"

// first bytes of a blob, little endian
struct Header {
    uint32_t magic;
    uint32_t format_version;
    uint32_t size; // of the whole blob, bytes
    uint32_t crc;  // of everything after this field
    uint32_t n_branch;
    uint32_t n_coord;
    uint32_t n_joint;
    uint32_t n_contact_feature;
    uint32_t n_wrench;
    uint32_t contact_width;
    uint32_t width;
    uint32_t classifier_width;
    uint32_t dq0;
    uint32_t weight_type;
    uint8_t checkpoint_sha256[32];
    float length_scale;
    float log_range;
    float displacement_log_scale;
    float tau;
    float eps_m[AMINN_N_STAGE];
    float eps_kx[AMINN_N_STAGE];
    float eps_jq[AMINN_N_STAGE];
};
static_assert(sizeof(Header) == 128, "header layout");
constexpr size_t kCrcStart = offsetof(Header, n_branch);

// CRC-32 (IEEE 802.3, reflected), half a byte at a time: a table of 64 bytes
uint32_t crc32(const uint8_t *bytes, size_t n)
{
    static const uint32_t kTable[16] = {0x00000000u, 0x1DB71064u, 0x3B6E20C8u, 0x26D930ACu, 0x76DC4190u, 0x6B6B51F4u,
                                        0x4DB26158u, 0x5005713Cu, 0xEDB88320u, 0xF00F9344u, 0xD6D6A3E8u, 0xCB61B38Cu,
                                        0x9B64C2B0u, 0x86D3D2D4u, 0xA00AE278u, 0xBDBDF21Cu};
    uint32_t crc = 0xFFFFFFFFu;
    for (size_t i = 0; i < n; ++i) {
        crc ^= bytes[i];
        crc = (crc >> 4) ^ kTable[crc & 15u];
        crc = (crc >> 4) ^ kTable[crc & 15u];
    }
    return ~crc;
}

aminn_status_t check_header(const uint8_t *bytes, size_t len, Header &header)
{
    if (len < sizeof header) {
        return AMINN_E_SIZE;
    }
    std::memcpy(&header, bytes, sizeof header);
    if (header.magic != kMagic) {
        return AMINN_E_MAGIC;
    }
    if (header.format_version != AMINN_FORMAT_VERSION) {
        return AMINN_E_VERSION;
    }
    if (header.size != len) {
        return AMINN_E_SIZE;
    }
    return crc32(bytes + kCrcStart, len - kCrcStart) == header.crc ? AMINN_OK : AMINN_E_CRC;
}

void copy_constants(const Header &h, aminn_model_t &m)
{
    m.format_version = h.format_version;
    m.n_branch = h.n_branch;
    m.n_coord = h.n_coord;
    m.n_joint = h.n_joint;
    m.n_contact_feature = h.n_contact_feature;
    m.n_wrench = h.n_wrench;
    m.contact_width = h.contact_width;
    m.width = h.width;
    m.classifier_width = h.classifier_width;
    m.dq0 = h.dq0;
    m.weight_type = h.weight_type;
    std::memcpy(m.checkpoint_sha256, h.checkpoint_sha256, sizeof m.checkpoint_sha256);
    m.length_scale = h.length_scale;
    m.log_range = h.log_range;
    m.displacement_log_scale = h.displacement_log_scale;
    m.tau = h.tau;
    for (int i = 0; i < AMINN_N_STAGE; ++i) {
        m.stage[i].eps_m = h.eps_m[i];
        m.stage[i].eps_kx = h.eps_kx[i];
        m.stage[i].eps_jq = h.eps_jq[i];
    }
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

bool widths_sane(const aminn_model_t &m)
{
    return m.contact_width <= AMINN_MAX_WIDTH && m.width <= AMINN_MAX_WIDTH && m.classifier_width <= AMINN_MAX_WIDTH;
}

aminn_status_t load(const uint8_t *bytes, size_t len, aminn_model_t &m)
{
    Header header;
    const aminn_status_t status = check_header(bytes, len, header);
    if (status != AMINN_OK) {
        return status;
    }
    copy_constants(header, m);
    if (!widths_sane(m)) { // before they are multiplied
        return AMINN_E_DIMS;
    }
    const bool placed = place_tables(bytes, len, m);
    const aminn_status_t checked = aminn_model_check(&m);
    if (checked == AMINN_E_DIMS) { // other dimensions make other lengths: name the cause
        return checked;
    }
    return placed ? checked : AMINN_E_SIZE;
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
