// The one list of a model's tables, in the order in which a blob holds them. Checking and loading both walk it.
#ifndef AMINN_SRC_TABLES_HPP
#define AMINN_SRC_TABLES_HPP

#include "compiler.hpp" // first

#include <cstddef>
#include <cstdint>
#include <cstring>

#include "aminn_rt.h"

namespace aminn {

// What a table's length is made of: rows times columns, each a number below 64, or that and a width of the model.
enum Extent : uint8_t {
    kContactWidth = 1u << 6,
    kWidth = 2u << 6,
    kClassifierWidth = 3u << 6,
    kTrunkInput = kContactWidth + AMINN_N_GLOBAL_INPUT,
    kClassifierInput = kWidth + AMINN_N_AUX,
};

struct TableInfo {
    uint8_t place; // of the pointer in aminn_model_t, in pointers
    uint8_t rows;
    uint8_t columns;
    uint8_t weights; // 1: of the model's weight_type, else float
};

#define AMINN_TABLE(field, rows, columns, weights) \
    {offsetof(aminn_model_t, field) / sizeof(void *), rows, columns, weights}
#define AMINN_STAGE_TABLES(i)                                                                                        \
    AMINN_TABLE(stage[i].contact_mean, AMINN_N_CONTACT_INPUT, 1, false),                                             \
        AMINN_TABLE(stage[i].contact_inv_std, AMINN_N_CONTACT_INPUT, 1, false),                                      \
        AMINN_TABLE(stage[i].global_mean, AMINN_N_GLOBAL_INPUT, 1, false),                                           \
        AMINN_TABLE(stage[i].global_inv_std, AMINN_N_GLOBAL_INPUT, 1, false),                                        \
        AMINN_TABLE(stage[i].contact_w, AMINN_N_CONTACT_INPUT, kContactWidth, true),                                 \
        AMINN_TABLE(stage[i].contact_b, kContactWidth, 1, false),                                                    \
        AMINN_TABLE(stage[i].trunk1_w, kTrunkInput, kWidth, true), AMINN_TABLE(stage[i].trunk1_b, kWidth, 1, false), \
        AMINN_TABLE(stage[i].trunk2_w, kWidth, kWidth, true), AMINN_TABLE(stage[i].trunk2_b, kWidth, 1, false),      \
        AMINN_TABLE(stage[i].head_w, kWidth, AMINN_N_HEAD_STORED, true),                                             \
        AMINN_TABLE(stage[i].head_b, AMINN_N_HEAD_STORED, 1, false)

inline constexpr TableInfo kTables[] = {
    // one copy, whoever walks it
    AMINN_TABLE(wrench_log_scale, AMINN_N_WRENCH, 1, false),
    AMINN_TABLE(chol_nom, AMINN_N_BRANCH, 6, false),
    AMINN_TABLE(tendon_dir_nom, AMINN_N_BRANCH, AMINN_N_COORD, false),
    AMINN_TABLE(tendon_gain_nom, AMINN_N_BRANCH, 1, false),
    AMINN_TABLE(gate_nom, 3, 1, false),
    AMINN_TABLE(coord_mask, AMINN_N_BRANCH, AMINN_N_COORD, false),
    AMINN_TABLE(geom_base, AMINN_N_BRANCH, 3, false),
    AMINN_TABLE(geom_axis, AMINN_N_BRANCH, AMINN_N_COORD * 3, false),
    AMINN_TABLE(geom_link_a, AMINN_N_BRANCH, 3, false),
    AMINN_TABLE(range_min, AMINN_N_STATE, 1, false),
    AMINN_TABLE(range_max, AMINN_N_STATE, 1, false),
    AMINN_STAGE_TABLES(0),
    AMINN_STAGE_TABLES(1),
    AMINN_TABLE(aux_mean, AMINN_N_AUX, 1, false),
    AMINN_TABLE(aux_inv_std, AMINN_N_AUX, 1, false),
    AMINN_TABLE(cls1_w, kClassifierInput, kClassifierWidth, true),
    AMINN_TABLE(cls1_b, kClassifierWidth, 1, false),
    AMINN_TABLE(cls2_w, kClassifierWidth, 1, true),
    AMINN_TABLE(cls2_b, 1, 1, false),
    AMINN_TABLE(known_answer, 31, 3, false),
};

static_assert(sizeof(aminn_known_answer_t) == 31 * 3 * sizeof(float),
              "the known answer is checked and placed as a table");

static_assert(offsetof(aminn_model_t, width) - offsetof(aminn_model_t, contact_width) == sizeof(uint32_t) &&
                  offsetof(aminn_model_t, classifier_width) - offsetof(aminn_model_t, width) == sizeof(uint32_t),
              "the widths stand one behind the other");

[[gnu::noinline]] inline uint32_t extent(const aminn_model_t &m, uint32_t code)
{
    uint32_t width = 0;
    if (code >= kContactWidth) {
        const size_t place = offsetof(aminn_model_t, contact_width) + sizeof width * (code / kContactWidth - 1);
        std::memcpy(&width, reinterpret_cast<const char *>(&m) + place, sizeof width);
    }
    return width + code % kContactWidth;
}

// A table of a model.
struct Table {
    const void *numbers;
    uint32_t n;
    uint32_t size; // of a number, bytes
};

// The widths in the model must be set.
[[gnu::noinline]] inline void find_table(const aminn_model_t &m, const TableInfo &info, Table &table)
{
    std::memcpy(&table.numbers, reinterpret_cast<const char *>(&m) + info.place * sizeof(void *), sizeof(void *));
    table.n = extent(m, info.rows) * extent(m, info.columns);
    table.size = sizeof(float) >> (info.weights & m.weight_type);
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
    std::memcpy(reinterpret_cast<char *>(&m) + table.place * sizeof(void *), &pointer, sizeof pointer);
}

} // namespace aminn

#endif
