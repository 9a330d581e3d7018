// The one list of a model's tables, in the order in which a blob holds them. Checking and loading both walk it.
#ifndef AMINN_SRC_TABLES_HPP
#define AMINN_SRC_TABLES_HPP

#include "compiler.hpp" // first

#include <stddef.h>
#include <stdint.h>

#include "aminn_rt.h"

namespace aminn {

#define AMINN_WIDTH(i) (kWidth + ((i) << 8)) // of a stage

// What a table's length is made of: rows times columns, each a number below 256, or that and a width of the model.
enum Extent : uint16_t {
    kContactWidth = 1u << 8,
    kWidth = 2u << 8, // of stage 1, that of stage 2 follows
    kClassifierWidth = (2u + AMINN_N_STAGE) << 8,
    kTrunkInput = kContactWidth + AMINN_N_GLOBAL_INPUT,
    kClassifierInput = kWidth + AMINN_N_AUX,
    kSureInput = AMINN_WIDTH(1u) + AMINN_N_SURE,
};

constexpr unsigned kExtentBits = 11;

enum Kind : uint8_t {
    kFloats = 0,
    kPositive = 1, // floats above zero
    kWeights = 2,  // of the model's weight_type
    kBiases = 3,   // floats, and as many more above zero if the weights are int8
    kSees = 4,     // floats, and the model's n_told and n_sensed more rows
    kTold = 5,     // floats, its n_told more rows
    kSeesWeights = 6,
};

struct TableInfo {
    uint32_t place : 7;                 // of the pointer in aminn_model_t, in pointers
    uint32_t extents : 2 * kExtentBits; // rows, then columns unless that is one
    uint32_t kind : 3;
};
static_assert(sizeof(aminn_model_t) / sizeof(void *) < 128, "a place has 7 bits");
static_assert(AMINN_N_HEAD_STORED < kContactWidth && AMINN_N_CONTACT_INPUT < kContactWidth, "an extent has 8 bits");
static_assert((sizeof(aminn_known_answer_t) / sizeof(float)) < kContactWidth, "an extent has 8 bits");
static_assert(1 + AMINN_N_STIFF < kContactWidth, "an extent has 8 bits: AMINN_N_STIFF");

#define AMINN_TABLE(field, rows, columns, kind) \
    {offsetof(aminn_model_t, field) / sizeof(void *), (rows) | ((columns) == 1 ? 0u : (columns) << kExtentBits), kind}
#define AMINN_STAGE_TABLES(i)                                                            \
    AMINN_TABLE(nominal.eps_m[i], AMINN_N_BRANCH, 1, kPositive),                         \
        AMINN_TABLE(stage[i].contact_mean, AMINN_N_CONTACT_INPUT, 1, kFloats),           \
        AMINN_TABLE(stage[i].contact_inv_std, AMINN_N_CONTACT_INPUT, 1, kFloats),        \
        AMINN_TABLE(stage[i].global_mean, AMINN_N_GLOBAL_INPUT, 1, kSees),               \
        AMINN_TABLE(stage[i].global_inv_std, AMINN_N_GLOBAL_INPUT, 1, kSees),            \
        AMINN_TABLE(stage[i].contact_w, AMINN_N_CONTACT_INPUT, kContactWidth, kWeights), \
        AMINN_TABLE(stage[i].contact_b, kContactWidth, 1, kBiases),                      \
        AMINN_TABLE(stage[i].trunk1_w, kTrunkInput, AMINN_WIDTH(i), kSeesWeights),       \
        AMINN_TABLE(stage[i].trunk1_b, AMINN_WIDTH(i), 1, kBiases),                      \
        AMINN_TABLE(stage[i].trunk2_w, AMINN_WIDTH(i), AMINN_WIDTH(i), kWeights),        \
        AMINN_TABLE(stage[i].trunk2_b, AMINN_WIDTH(i), 1, kBiases),                      \
        AMINN_TABLE(stage[i].head_w, AMINN_WIDTH(i), AMINN_N_HEAD_STORED, kWeights),     \
        AMINN_TABLE(stage[i].head_b, AMINN_N_HEAD_STORED, 1, kBiases)

inline constexpr TableInfo kTables[] = {
    // one copy, whoever walks it
    AMINN_TABLE(wrench_log_scale, AMINN_N_WRENCH, 1, kPositive),
    AMINN_TABLE(nominal.chol, AMINN_N_BRANCH, AMINN_N_CHOLESKY, kFloats),
#if AMINN_N_GATED > 0
    AMINN_TABLE(tendon_dir_nom, AMINN_N_BRANCH, AMINN_N_COORD, kFloats),
    AMINN_TABLE(nominal.tendon_gain, AMINN_N_BRANCH, 1, AMINN_N_GATED < AMINN_N_BRANCH ? kFloats : kPositive),
    AMINN_TABLE(gate_nom, 3, 1, kFloats),
#endif
#if AMINN_N_TWIST > 0
    AMINN_TABLE(nominal.twist, AMINN_N_BRANCH, 1, kPositive),
#endif
    AMINN_TABLE(nominal.told, 0, 1, kTold),
    AMINN_TABLE(theta_terms, 1 + AMINN_N_STIFF, AMINN_N_BRANCH *AMINN_N_TERM, kFloats),
    AMINN_TABLE(coord_mask, AMINN_N_BRANCH, AMINN_N_COORD, kFloats),
    AMINN_TABLE(geom_axis, AMINN_N_BRANCH, AMINN_N_COORD * 3, kFloats),
    AMINN_TABLE(geom_anchor, AMINN_N_BRANCH, AMINN_N_COORD * 3, kFloats),
    AMINN_TABLE(range_min, AMINN_N_STATE, 1, kFloats),
    AMINN_TABLE(range_max, AMINN_N_STATE, 1, kFloats),
    AMINN_STAGE_TABLES(0),
    AMINN_STAGE_TABLES(1),
    AMINN_TABLE(aux_mean, AMINN_N_AUX, 1, kFloats),
    AMINN_TABLE(aux_inv_std, AMINN_N_AUX, 1, kFloats),
    AMINN_TABLE(cls1_w, kClassifierInput, kClassifierWidth, kWeights),
    AMINN_TABLE(cls1_b, kClassifierWidth, 1, kBiases),
    AMINN_TABLE(cls2_w, kClassifierWidth, 1, kWeights),
    AMINN_TABLE(cls2_b, 1, 1, kBiases),
    AMINN_TABLE(sure_mean, AMINN_N_SURE, 1, kFloats),
    AMINN_TABLE(sure_inv_std, AMINN_N_SURE, 1, kFloats),
    AMINN_TABLE(sure_w, kSureInput, 2, kWeights),
    AMINN_TABLE(sure_b, 2, 1, kBiases),
    AMINN_TABLE(known_answer, sizeof(aminn_known_answer_t) / sizeof(float), 1, kFloats),
};

static_assert(offsetof(aminn_model_t, width) - offsetof(aminn_model_t, contact_width) == sizeof(uint32_t) &&
                  offsetof(aminn_model_t, classifier_width) - offsetof(aminn_model_t, width) ==
                      AMINN_N_STAGE * sizeof(uint32_t),
              "the widths stand one behind the other");
static_assert(kClassifierWidth <= 7u << 8, "an extent's width has 3 bits");

// Every width is from 1 to AMINN_MAX_WIDTH.
[[gnu::noinline]] inline bool widths_ok(const aminn_model_t &m)
{
    uint32_t beyond = 0;
    for (const uint32_t *width = &m.contact_width; width <= &m.classifier_width; ++width) {
        beyond |= (*width - 1u) / AMINN_MAX_WIDTH;
    }
    return beyond == 0;
}

// A table of a model.
struct Table {
    const void *numbers;
    uint32_t n;
    uint32_t size;     // of a number, bytes
    uint32_t positive; // of them, the last ones: floats that must be above zero
};

// The widths in the model must be set.
[[gnu::noinline]] inline void find_table(const aminn_model_t &m, TableInfo info, Table &table)
{
    __builtin_memcpy(&table.numbers, reinterpret_cast<const char *>(&m) + info.place * sizeof(void *), sizeof(void *));
    uint32_t n = 1;
    uint32_t extents = info.extents;
    const bool weights = info.kind == kWeights || info.kind == kSeesWeights;
    uint32_t width = info.kind >= kSees ? m.n_told : 0u;
    width += info.kind >= kSees && info.kind != kTold ? m.n_sensed : 0u;
    do {
        const uint32_t which = extents / kContactWidth % 8;
        if (which != 0) {
            const size_t place = offsetof(aminn_model_t, contact_width) + sizeof width * (which - 1);
            uint32_t own = 0;
            __builtin_memcpy(&own, reinterpret_cast<const char *>(&m) + place, sizeof own);
            width += own;
        }
        n *= width + extents % kContactWidth;
        width = 0;
        extents >>= kExtentBits;
    } while (extents != 0);
    table.positive = info.kind == kPositive ? n : 0u;
    if (info.kind == kBiases && m.weight_type == AMINN_WEIGHTS_INT8) {
        table.positive = n;
        n += n;
    }
    table.n = n;
    table.size = sizeof(float) >> (weights ? m.weight_type & 3u : 0u);
}

// Each table of a blob begins at a multiple of this, counted from the blob's start: a row of weights then lies in as few
// lines of a host's cache as it can.
constexpr size_t kTableAlignment = 64;

// What a table takes of a blob, with what fills it up.
inline size_t table_room(const aminn_model_t &m, const TableInfo &info)
{
    Table table;
    find_table(m, info, table);
    return (table.n * table.size + kTableAlignment - 1) / kTableAlignment * kTableAlignment;
}

inline void set_table_pointer(aminn_model_t &m, const TableInfo &table, const void *pointer)
{
    __builtin_memcpy(reinterpret_cast<char *>(&m) + table.place * sizeof(void *), &pointer, sizeof pointer);
}

} // namespace aminn

#endif
