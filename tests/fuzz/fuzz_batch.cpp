// Fuzz target: any bytes as the rows of a batch. Each row must have the bits and the status of a single prediction, and no
// other row may be written.
#include <cstring>

#include "aminn_batch.h"
#include "aminn_model.h"
#include "bytes.hpp"
#include "checks.hpp"
#include "tiny_model.h"

using namespace fuzz;

namespace {

constexpr size_t kRows = 6;

// One row of everything, one behind the other.
struct Row {
    aminn_input_t in;
    aminn_sensors_t sensors;
    float theta[AMINN_N_THETA];
};
constexpr size_t kStep = sizeof(Row) / sizeof(float);

struct Whole {
    uint8_t choices[4]; // model and flags; what is told; first row and number; which arrays have one row for all
    Row rows[kRows];
};

enum Told : uint8_t { kClosure = 1, kTheta = 2, kFriction = 4, kWeight = 8, kTension = 16, kBefore = 32, kRepair = 64 };

Whole whole()
{
    Whole w = {};
    for (Row &row : w.rows) {
        row.in = golden_input();
    }
    return w;
}

aminn_output_t outputs[kRows];
aminn_status_t statuses[kRows];
aminn_t ctx;
aminn_t single;
aminn_sensors_t before; // what the context was told of sensors
aminn_calibration_t calibration;

// of a field of the rows, each row its own or all the first one's
aminn_rows_t rows_of(const Whole &w, const float *first, bool own)
{
    (void)w;
    return {first, own ? kStep : 0};
}

aminn_batch_t batch_of(const Whole &w)
{
    const uint8_t told = w.choices[1];
    const uint8_t own = static_cast<uint8_t>(~w.choices[3]);
    const Row &r = w.rows[0];
    aminn_batch_t b = {};
    b.begin = w.choices[2] % kRows;
    b.n = w.choices[2] / kRows % (kRows - b.begin + 1);
    b.q = rows_of(w, r.in.q, (own & 1) != 0);
    b.x_ht = rows_of(w, r.in.x_ht, (own & 2) != 0);
    b.w_e = rows_of(w, r.in.w_e, (own & 4) != 0);
    b.contacts = rows_of(w, r.in.contacts[0], (own & 8) != 0);
    if ((told & kClosure) != 0) {
        b.j_x = rows_of(w, r.in.j_x[0][0], (own & 16) != 0);
        b.j_q = rows_of(w, r.in.j_q[0][0], (own & 16) != 0);
    }
    if ((told & kTheta) != 0) {
        b.theta = rows_of(w, r.theta, (own & 32) != 0);
    }
    if ((told & kFriction) != 0) {
        b.friction = rows_of(w, r.sensors.friction, (own & 64) != 0);
    }
    if ((told & kWeight) != 0) {
        b.tool_weight = rows_of(w, r.sensors.tool_weight, (own & 64) != 0);
    }
    if ((told & kTension) != 0) {
        b.tendon_tension = rows_of(w, r.sensors.tendon_tension, (own & 128) != 0);
    }
    return b;
}

template <class T>
void gather(const aminn_rows_t &rows, size_t i, T &field)
{
    if (rows.first != nullptr) {
        std::memcpy(&field, rows.first + i * rows.step, sizeof field);
    }
}

// a row alone
aminn_status_t predict_row(const aminn_model_t &model, const aminn_batch_t &b, size_t i, aminn_output_t &out)
{
    aminn_input_t in = {};
    aminn_sensors_t sensors = before;
    float theta[AMINN_N_THETA] = {};
    gather(b.q, i, in.q);
    gather(b.x_ht, i, in.x_ht);
    gather(b.w_e, i, in.w_e);
    gather(b.contacts, i, in.contacts);
    gather(b.j_x, i, in.j_x);
    gather(b.j_q, i, in.j_q);
    gather(b.theta, i, theta);
    gather(b.friction, i, sensors.friction);
    gather(b.tool_weight, i, sensors.tool_weight);
    gather(b.tendon_tension, i, sensors.tendon_tension);
    std::memcpy(&single, &ctx, sizeof single);
    aminn_status_t status = AMINN_OK;
    if (b.theta.first != nullptr) {
        status = aminn_calibration_set(&calibration, &model, theta);
        FUZZ_CHECK(status == expected_of_theta(theta));
        status = status == AMINN_OK ? aminn_calibrate(&single, &calibration) : status;
    }
    const bool told =
        b.friction.first != nullptr || b.tool_weight.first != nullptr || b.tendon_tension.first != nullptr;
    if (told && status == AMINN_OK) {
        status = aminn_sense(&single, &sensors);
    }
    if (status != AMINN_OK) {
        aminn_predict(&single, nullptr, &out); // leaves what an error leaves
        return status;
    }
    aminn_state_t state;
    std::memcpy(&state, &in, sizeof state);
    return b.j_x.first != nullptr ? aminn_predict(&single, &in, &out) : aminn_predict_state(&single, &state, &out);
}

bool is_scribbled(const void *memory, size_t size)
{
    const auto *bytes = static_cast<const uint8_t *>(memory);
    return std::all_of(bytes, bytes + size, [](uint8_t byte) { return byte == 0xA5; });
}

void check_rows(const aminn_model_t &model, const aminn_batch_t &b, aminn_status_t status, size_t bad)
{
    size_t first_bad = AMINN_NO_ROW;
    for (size_t i = 0; i < kRows; ++i) {
        if (i < b.begin || i >= b.begin + b.n) {
            FUZZ_CHECK(is_scribbled(&outputs[i], sizeof outputs[i]) && is_scribbled(&statuses[i], sizeof statuses[i]));
            continue;
        }
        aminn_output_t alone;
        const aminn_status_t expected = predict_row(model, b, i, alone);
        FUZZ_CHECK(expected == statuses[i]);
        FUZZ_CHECK(std::memcmp(&alone, &outputs[i], sizeof alone) == 0);
        first_bad = expected != AMINN_OK && first_bad == AMINN_NO_ROW ? i : first_bad;
    }
    FUZZ_CHECK(bad == first_bad && status == (bad == AMINN_NO_ROW ? AMINN_OK : statuses[bad]));
}

int try_one(Whole &w)
{
    const uint8_t told = w.choices[1];
    if ((told & kRepair) != 0) {
        for (Row &row : w.rows) {
            repair(row.in);
        }
    }
    const aminn_model_t &model = (w.choices[0] & 4) != 0 ? aminn_model : tiny_model;
    FUZZ_CHECK(aminn_init(&ctx, &model, w.choices[0] & 3) == AMINN_OK);
    before = w.rows[kRows - 1].sensors;
    if ((told & kBefore) == 0 || model.n_sensed == 0 || aminn_sense(&ctx, &before) != AMINN_OK) {
        before = aminn_sensors_t{};
    }
    const aminn_batch_t batch = batch_of(w);
    scribble(outputs, sizeof outputs);
    scribble(statuses, sizeof statuses);
    size_t bad = 0;
    const aminn_status_t status =
        aminn_predict_batch(&ctx, &batch, 1 + w.choices[0] / 8 % 4, outputs, nullptr, statuses, &bad);
    check_rows(model, batch, status, bad);
    return 0;
}

} // namespace

#include "numbers_target.hpp" // last
