#include "batch.h"

#include <algorithm>
#include <cstddef>
#include <cstring>
#include <memory>
#include <new>
#include <exception>
#include <thread>
#include <vector>

namespace {

struct alignas(64) Line { // tables begin at multiples of 64 bytes
    unsigned char bytes[64];
};

} // namespace

struct aminn_batch {
    std::vector<Line> blob;
    aminn_model_t model;
    aminn_t ctx;
};

namespace {

constexpr size_t kFewestRows = 64; // a thread takes as long to start as some dozen predictions

// What a thread works with.
struct Worker {
    aminn_t ctx;
    aminn_calibration_t calibration; // it stays where it is
    aminn_status_t calibrated;
    aminn_sensors_t sensors; // nor do they
    aminn_status_t sensing;
};

// One row's numbers into place.
template <class T>
void gather(const aminn_batch_rows_t &rows, size_t i, T &field)
{
    std::memcpy(&field, rows.first + i * rows.step, sizeof field);
}

// Of a row whose theta cannot be: what the runtime gives after an error.
aminn_status_t refuse(aminn_status_t status, aminn_output_t &out)
{
    std::memset(&out, 0xFF, offsetof(aminn_output_t, stable)); // NaN
    out.p_stable = 0.0F;
    out.stable = 0;
    out.notes = 0;
    return status;
}

// Use a row's theta; the one before it, where they are the same.
aminn_status_t calibrate(const aminn_batch_t &batch, Worker &worker, const aminn_batch_rows_t &theta, size_t i,
                         bool first)
{
    const float *own = theta.first + i * theta.step;
    if (first || (theta.step != 0 && std::memcmp(own, own - theta.step, AMINN_N_THETA * sizeof *own) != 0)) {
        worker.calibrated = aminn_calibration_set(&worker.calibration, &batch.model, own);
        if (worker.calibrated == AMINN_OK) {
            worker.calibrated = aminn_calibrate(&worker.ctx, &worker.calibration);
        }
    }
    return worker.calibrated;
}

aminn_state_t state_of(const aminn_batch_inputs_t &inputs, size_t i)
{
    aminn_state_t state;
    gather(inputs.q, i, state.q);
    gather(inputs.x_ht, i, state.x_ht);
    gather(inputs.w_e, i, state.w_e);
    gather(inputs.contacts, i, state.contacts);
    return state;
}

template <class T>
void gather_told(const aminn_batch_rows_t &rows, size_t i, T &field)
{
    if (rows.first != nullptr) {
        gather(rows, i, field);
    }
}

// Tell the context a row's sensors, if there are any.
aminn_status_t sense(Worker &worker, const aminn_batch_inputs_t &inputs, size_t i, bool first)
{
    if (inputs.friction.first == nullptr && inputs.tool_weight.first == nullptr &&
        inputs.tendon_tension.first == nullptr) {
        return AMINN_OK;
    }
    gather_told(inputs.friction, i, worker.sensors.friction);
    gather_told(inputs.tool_weight, i, worker.sensors.tool_weight);
#if AMINN_N_TENDON > 0
    gather_told(inputs.tendon_tension, i, worker.sensors.tendon_tension);
#endif
    if (first) {
        worker.sensing = aminn_sense(&worker.ctx, &worker.sensors);
    }
    return worker.sensing;
}

aminn_status_t predict(aminn_t &ctx, const aminn_batch_inputs_t &inputs, size_t i, aminn_output_t &out)
{
    const aminn_state_t state = state_of(inputs, i);
    if (inputs.j_x.first == nullptr || inputs.j_q.first == nullptr) {
        return aminn_predict_state(&ctx, &state, &out);
    }
    aminn_input_t in;
    std::memcpy(&in, &state, sizeof state); // as an input begins
    gather(inputs.j_x, i, in.j_x);
    gather(inputs.j_q, i, in.j_q);
    return aminn_predict(&ctx, &in, &out);
}

// Where a row's theta cannot be: what the runtime gives after an error.
aminn_status_t refuse(aminn_status_t status, aminn_admissible_t &found)
{
    found = aminn_admissible_t{};
    return refuse(status, found.at);
}

// row(worker, i, status of its theta and of its model's sensors) for n rows, shared by threads.
template <class Row>
void over_rows(const aminn_batch_t &batch, const aminn_batch_inputs_t &inputs, size_t n, unsigned threads, Row row)
{
    const size_t parts = std::max<size_t>(1, std::min<size_t>(threads, n / kFewestRows));
    const auto work = [&, n, parts](size_t part) noexcept {
        Worker worker = {};
        worker.ctx = batch.ctx;
        const size_t begin = n * part / parts;
        for (size_t i = begin; i < n * (part + 1) / parts; ++i) {
            aminn_status_t status = AMINN_OK;
            if (inputs.theta.first != nullptr) {
                status = calibrate(batch, worker, inputs.theta, i, i == begin);
            }
            const aminn_status_t sensing = sense(worker, inputs, i, i == begin);
            status = status == AMINN_OK ? sensing : status;
            row(worker, i, status);
        }
    };
    std::vector<std::thread> others;
    size_t part = 1;
    try {
        others.reserve(parts - 1);
        for (; part < parts; ++part) {
            others.emplace_back(work, part);
        }
    } catch (const std::exception &) { // no more threads or memory: the rest is done here
    }
    work(0);
    for (; part < parts; ++part) {
        work(part);
    }
    for (std::thread &other : others) {
        other.join();
    }
}

aminn_status_t open(aminn_batch &batch, const void *blob, size_t size, uint32_t flags)
{
    batch.blob.resize((size + sizeof(Line) - 1) / sizeof(Line));
    std::memcpy(batch.blob.data(), blob, size);
    const aminn_status_t status = aminn_model_from_blob(batch.blob.data(), size, &batch.model);
    return status == AMINN_OK ? aminn_init(&batch.ctx, &batch.model, flags) : status;
}

} // namespace

const uint32_t aminn_batch_counts[8] = {AMINN_N_BRANCH, AMINN_N_COORD, AMINN_N_JOINT,  AMINN_N_GATED,
                                        AMINN_N_TWIST,  AMINN_N_STIFF, AMINN_N_TENDON, AMINN_N_SLIDE};

aminn_batch_t *aminn_batch_open(const void *blob, size_t size, uint32_t flags, aminn_status_t *status)
{
    *status = AMINN_E_SIZE;
    try {
        auto batch = std::make_unique<aminn_batch>();
        *status = open(*batch, blob, size, flags);
        return *status == AMINN_OK ? batch.release() : nullptr;
    } catch (const std::bad_alloc &) {
        return nullptr;
    }
}

void aminn_batch_close(aminn_batch_t *batch)
{
    delete batch;
}

void aminn_batch_ranges(const aminn_batch_t *batch, float *smallest, float *largest)
{
    std::copy_n(batch->model.range_min, AMINN_N_STATE, smallest);
    std::copy_n(batch->model.range_max, AMINN_N_STATE, largest);
}

void aminn_batch_predict(const aminn_batch_t *batch, const aminn_batch_inputs_t *inputs, size_t n, unsigned threads,
                         aminn_output_t *outputs, aminn_stage_debug_t *stages, aminn_status_t *statuses)
{
    over_rows(*batch, *inputs, n, threads, [=](Worker &worker, size_t i, aminn_status_t status) {
        statuses[i] = status == AMINN_OK ? predict(worker.ctx, *inputs, i, outputs[i]) : refuse(status, outputs[i]);
        const aminn_stage_debug_t *first =
            stages == nullptr || status != AMINN_OK ? nullptr : aminn_debug(&worker.ctx, 0);
        if (first != nullptr) { // the second lies behind it
            std::memcpy(stages + i * AMINN_N_STAGE, first, AMINN_N_STAGE * sizeof *stages);
        }
    });
}

void aminn_batch_admissible(const aminn_batch_t *batch, const aminn_batch_inputs_t *inputs,
                            const aminn_batch_rows_t *directions, const aminn_load_limits_t *limits, size_t n,
                            unsigned threads, aminn_admissible_t *found, aminn_status_t *statuses)
{
    over_rows(*batch, *inputs, n, threads, [=](Worker &worker, size_t i, aminn_status_t status) {
        float direction[AMINN_N_WRENCH];
        gather(*directions, i, direction);
        const aminn_state_t state = state_of(*inputs, i);
        statuses[i] = status == AMINN_OK ? aminn_admissible_load(&worker.ctx, &state, direction, limits, &found[i])
                                         : refuse(status, found[i]);
    });
}

aminn_status_t aminn_batch_self_test(const aminn_batch_t *batch)
{
    aminn_t ctx = batch->ctx;
    return aminn_self_test(&ctx);
}
