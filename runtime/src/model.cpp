// Is a model complete and sane?
#include "parts.hpp"
#include "tables.hpp"

namespace aminn {
namespace {

bool width_ok(uint32_t width)
{
    return width >= 1 && width <= AMINN_MAX_WIDTH;
}

bool dims_ok(const aminn_model_t &m)
{
    return m.n_branch == AMINN_N_BRANCH && m.n_coord == AMINN_N_COORD && m.n_joint == AMINN_N_JOINT &&
           m.n_contact_feature == AMINN_N_CONTACT_FEATURE && m.n_wrench == AMINN_N_WRENCH &&
           width_ok(m.contact_width) && width_ok(m.width) && width_ok(m.classifier_width);
}

bool at_least(uint32_t least_bits, const float *v, int n)
{
    bool ok = true;
    for (int i = 0; i < n; ++i) {
        ok = ok && within(v[i], least_bits, kLargestBits);
    }
    return ok;
}

bool positive(const float *v, int n)
{
    return at_least(kSmallestBits, v, n);
}

// The paper's way to the joints' deflection inverts j_q, which must be square.
constexpr uint32_t kLastDq0 = kCoord == 3 ? AMINN_DQ0_INVERSE : AMINN_DQ0_STATICS;
static_assert(AMINN_DQ0_STATICS == 0 && AMINN_DQ0_INVERSE == 1, "the ways are counted from 0");

bool constants_ok(const aminn_model_t &m)
{
    bool ok = m.name != nullptr && m.hand != nullptr && m.made_by != nullptr &&
              m.weight_type <= AMINN_WEIGHTS_FLOAT16 && m.dq0 <= kLastDq0 &&
              within(m.length_scale, kSmallestBits, kLargestBits) &&
              within(m.displacement_log_scale, kSmallestBits, kLargestBits) && within(m.log_range, 0, kLargestBits) &&
              within(m.tau, 0, kOneBits);
    for (const aminn_stage_model_t &s : m.stage) {
        ok = ok && within(s.eps_m, kSmallestBits, kLargestBits) && within(s.eps_kx, kSmallestBits, kLargestBits) &&
             within(s.eps_jq, m.dq0 == AMINN_DQ0_STATICS ? 0 : kSmallestBits, kLargestBits);
    }
    return ok;
}

bool all_finite16(const uint16_t *values, uint32_t n)
{
    bool ok = true;
    for (uint32_t i = 0; i < n; ++i) {
        ok = ok && (values[i] & 0x7C00u) != 0x7C00u;
    }
    return ok;
}

// every table is there, and all of it finite
bool tables_finite(const aminn_model_t &m)
{
    for (const TableInfo &info : kTables) {
        Table table;
        find_table(m, info, table);
        if (table.numbers == nullptr) {
            return false;
        }
        if (table.size == sizeof(float)
                ? !all_finite(static_cast<const float *>(table.numbers), static_cast<int>(table.n))
                : !all_finite16(static_cast<const uint16_t *>(table.numbers), table.n)) {
            return false;
        }
    }
    return true;
}

// finite everywhere is checked before; here the tables that have a sign
bool tables_in_range(const aminn_model_t &m)
{
    bool ok = positive(m.wrench_log_scale, AMINN_N_WRENCH);
    if constexpr (kGated) { // zero: the branch has no gated tendon
        ok = ok && at_least(kSomeLack ? 0 : kSmallestBits, m.tendon_gain_nom, kBranch);
    }
    for (int b = 0; b < kBranch; ++b) {
        ok = ok && positive(m.chol_nom + AMINN_N_CHOLESKY * b, kCoord);
    }
    for (int i = 0; i < kBranch * AMINN_N_COORD; ++i) { // 0 or 1
        ok = ok && m.coord_mask[i] * m.coord_mask[i] == m.coord_mask[i];
    }
    return ok;
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
    return constants_ok(*model) && tables_finite(*model) && tables_in_range(*model) ? AMINN_OK : AMINN_E_MODEL;
}
