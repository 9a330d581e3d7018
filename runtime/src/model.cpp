// Is a model complete and sane?
#include "parts.hpp"
#include "storage.hpp"
#include "tables.hpp"

namespace aminn {
namespace {

// what a model must have from n_branch on
constexpr uint8_t kDims[] = {AMINN_N_BRANCH, AMINN_N_COORD, AMINN_N_JOINT, AMINN_N_CONTACT_FEATURE, AMINN_N_WRENCH,
                             AMINN_N_GATED,  AMINN_N_TWIST, AMINN_N_STIFF, AMINN_N_TENDON,          AMINN_N_SLIDE};
static_assert(offsetof(aminn_model_t, n_told) - offsetof(aminn_model_t, n_branch) == sizeof kDims * sizeof(uint32_t),
              "they stand one behind the other");

bool dims_ok(const aminn_model_t &m)
{
    uint32_t wrong = m.n_told != 0 ? m.n_told ^ AMINN_N_FACTOR : 0;
    wrong |= m.n_sensed != 0 ? m.n_sensed ^ AMINN_N_SENSED : 0;
    const uint32_t *dim = &m.n_branch;
    for (const uint8_t wanted : kDims) {
        wrong |= *dim++ ^ wanted;
    }
    return wrong == 0 && widths_ok(m);
}

// The top bit is set if one of these finite numbers is not above zero.
[[gnu::noinline]] uint32_t signs_of(const float *v, uint32_t n)
{
    uint32_t signs = 0;
    for (uint32_t i = 0; i < n; ++i) {
        signs |= (bits_of(v[i]) - 1u) | bits_of(v[i]);
    }
    return signs;
}

// The paper's way to the joints' deflection inverts j_q, which must be square.
constexpr uint32_t kLastDq0 = kCoord == 3 ? AMINN_DQ0_INVERSE : AMINN_DQ0_STATICS;
static_assert(AMINN_DQ0_STATICS == 0 && AMINN_DQ0_INVERSE == 1, "the ways are counted from 0");

bool constants_ok(const aminn_model_t &m)
{
    bool ok = m.name != nullptr && m.hand != nullptr && m.made_by != nullptr &&
              m.weight_type == (m.storage != nullptr ? m.storage->weight_type : AMINN_WEIGHTS_FLOAT32) &&
              m.dq0 <= kLastDq0 && within(m.length_scale, kSmallestBits, kLargestBits) &&
              within(m.displacement_log_scale, kSmallestBits, kLargestBits) && within(m.log_range, 0, kLargestBits) &&
              within(m.tau, 0, kOneBits);
    for (const float *v = &m.friction_nominal; v <= &m.max_rotation; ++v) {
        ok = ok && within(*v, kSmallestBits, kLargestBits);
    }
    float edge = 0.0F;
    for (const float next : m.bound_edge) {
        ok = ok && next >= edge && next <= 1.0F;
        edge = next;
    }
    for (const float factor : m.bound_factor) {
        ok = ok && within(factor, kSmallestBits, kLargestBits);
    }
    for (const aminn_stage_model_t &s : m.stage) {
        ok = ok && within(s.eps_kx, kSmallestBits, kLargestBits) &&
             within(s.eps_jq, m.dq0 == AMINN_DQ0_STATICS ? 0 : kSmallestBits, kLargestBits);
    }
    return ok;
}

// Every table is there, all of it finite, and above zero where it must be. Of the mask, each number is 0 or 1, a branch
// lacks its first coordinates, and those that there are are the joints.
bool tables_ok(const aminn_model_t &m)
{
    uint32_t signs = 0;
    for (const TableInfo &info : kTables) {
        Table table;
        find_table(m, info, table);
        if (table.numbers == nullptr && table.n != 0) {
            return false;
        }
        const auto *numbers = static_cast<const float *>(table.numbers);
        if (table.size == sizeof(float) ? !all_finite(numbers, static_cast<int>(table.n))
                                        : !m.storage->sound(table.numbers, table.n)) {
            return false;
        }
        signs |= signs_of(numbers + (table.n - table.positive), table.positive);
    }
    uint32_t wrong = 0;
    uint32_t joints = 0;
    const float *mask = m.coord_mask;
    for (int b = 0; b < AMINN_N_BRANCH; ++b) {
        signs |= signs_of(m.nominal.chol + AMINN_N_CHOLESKY * b, AMINN_N_COORD);
        if constexpr (kSomeLack) { // zero: the branch has no gated tendon
            signs |= bits_of(m.nominal.tendon_gain[b]);
        }
        uint32_t wanted = 0; // once there is a coordinate
        for (int c = 0; c < AMINN_N_COORD; ++c) {
            const uint32_t there = bits_of(*mask++);
            wanted = (wanted | there) != 0 ? kOneBits : 0u;
            wrong |= there ^ wanted;
            joints += wanted;
        }
    }
    return (signs >> 31 | wrong | (joints ^ kOneBits * AMINN_N_JOINT)) == 0;
}

} // namespace
} // namespace aminn

aminn_status_t aminn_model_check(const aminn_model_t *model)
{
    using namespace aminn;
    if (model == nullptr) {
        return AMINN_E_NULL;
    }
    if (model->format_version != AMINN_FORMAT_VERSION) {
        return AMINN_E_VERSION;
    }
    if (!dims_ok(*model)) {
        return AMINN_E_DIMS;
    }
    return constants_ok(*model) && tables_ok(*model) ? AMINN_OK : AMINN_E_MODEL;
}
