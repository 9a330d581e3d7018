// Rows of a batch on several threads. A thread takes the next few rows when it has done some, so that one whose rows skip stage 2,
// or whose processor is busy with other work, keeps none waiting. No bit depends on which thread predicts a row.
#include "aminn_batch.h"

#include <atomic>
#include <cstring>

#include <pthread.h>
#include <unistd.h>
#ifdef __linux__
#include <sched.h>
#endif

namespace aminn {
namespace {

// What a thread takes at a time: it takes as long to start as some dozen predictions.
constexpr size_t kRows = 64;
constexpr size_t kSearches = 8;

// What a thread works with.
struct Worker {
    aminn_t ctx;
    aminn_calibration_t calibration; // it stays where it is
    aminn_sensors_t sensors;         // nor do they move
    const float *theta;              // that the calibration was set with; null: none
    aminn_status_t calibrated;
    aminn_status_t sensing;
};

// What all threads share.
struct Job {
    const aminn_t *ctx;
    const aminn_batch_t *batch;
    aminn_status_t (*predict)(const Job &job, Worker &worker, size_t i, aminn_status_t status);
    size_t chunk;
    aminn_status_t *statuses;
    aminn_output_t *outputs;
    aminn_stage_debug_t *stages;
    aminn_rows_t directions;
    const aminn_load_limits_t *limits;
    aminn_admissible_t *found;
    std::atomic<size_t> taken;
};

// One row's numbers into place, where they are told.
template <class T>
void gather(const aminn_rows_t &rows, size_t i, T &field)
{
    if (rows.first != nullptr) {
        std::memcpy(&field, rows.first + i * rows.step, sizeof field);
    }
}

void gather_state(const aminn_batch_t &batch, size_t i, aminn_state_t &state)
{
    gather(batch.q, i, state.q);
    gather(batch.x_ht, i, state.x_ht);
    gather(batch.w_e, i, state.w_e);
    gather(batch.contacts, i, state.contacts);
}

// Use a row's theta; what is in use already, where that is the same.
aminn_status_t calibrate(Worker &worker, const aminn_rows_t &theta, size_t i)
{
    const float *own = theta.first + i * theta.step;
    if (worker.theta == nullptr || std::memcmp(own, worker.theta, AMINN_N_THETA * sizeof *own) != 0) {
        worker.calibrated = aminn_calibration_set(&worker.calibration, worker.ctx.model, own);
        if (worker.calibrated == AMINN_OK) {
            worker.calibrated = aminn_calibrate(&worker.ctx, &worker.calibration);
        }
    }
    worker.theta = own;
    return worker.calibrated;
}

bool tells_sensors(const aminn_batch_t &batch)
{
    return batch.friction.first != nullptr || batch.tool_weight.first != nullptr ||
           batch.tendon_tension.first != nullptr;
}

void gather_sensors(const aminn_batch_t &batch, size_t i, aminn_sensors_t &sensors)
{
    gather(batch.friction, i, sensors.friction);
    gather(batch.tool_weight, i, sensors.tool_weight);
#if AMINN_N_TENDON > 0
    gather(batch.tendon_tension, i, sensors.tendon_tension);
#endif
}

aminn_status_t predict(const Job &job, Worker &worker, size_t i, aminn_status_t status)
{
    const aminn_batch_t &batch = *job.batch;
    aminn_output_t &out = job.outputs[i];
    if (status != AMINN_OK) {
        aminn_predict_state(&worker.ctx, nullptr, &out); // leaves what stands there after an error
        return status;
    }
    aminn_input_t in;
    aminn_state_t state;
    gather_state(batch, i, state);
    if (batch.j_x.first == nullptr) {
        status = aminn_predict_state(&worker.ctx, &state, &out);
    } else {
        std::memcpy(&in, &state, sizeof state); // as an input begins
        gather(batch.j_x, i, in.j_x);
        gather(batch.j_q, i, in.j_q);
        status = aminn_predict(&worker.ctx, &in, &out);
    }
    for (int s = 0; job.stages != nullptr && s < AMINN_N_STAGE; ++s) {
        const aminn_stage_debug_t *shown = aminn_debug(&worker.ctx, s);
        if (shown != nullptr) {
            job.stages[i * AMINN_N_STAGE + static_cast<size_t>(s)] = *shown;
        }
    }
    return status;
}

aminn_status_t search(const Job &job, Worker &worker, size_t i, aminn_status_t status)
{
    aminn_state_t state;
    float direction[AMINN_N_WRENCH];
    gather_state(*job.batch, i, state);
    gather(job.directions, i, direction);
    const aminn_status_t found =
        aminn_admissible_load(&worker.ctx, status == AMINN_OK ? &state : nullptr, direction, job.limits, &job.found[i]);
    return status == AMINN_OK ? found : status;
}

void predict_rows(const Job &job, Worker &worker, size_t begin, size_t end)
{
    const aminn_batch_t &batch = *job.batch;
    for (size_t i = begin; i < end; ++i) {
        aminn_status_t status = batch.theta.first != nullptr ? calibrate(worker, batch.theta, i) : AMINN_OK;
        gather_sensors(batch, i, worker.sensors);
        status = status == AMINN_OK ? worker.sensing : status;
        job.statuses[i] = job.predict(job, worker, i, status);
    }
}

void work(Job &job)
{
    Worker worker;
    worker.ctx = *job.ctx;
    worker.theta = nullptr;
    worker.sensors = worker.ctx.sensors != nullptr ? *worker.ctx.sensors : aminn_sensors_t{};
    worker.sensing = tells_sensors(*job.batch) ? aminn_sense(&worker.ctx, &worker.sensors) : AMINN_OK;
    const size_t n = job.batch->n;
    size_t at = job.taken.fetch_add(job.chunk, std::memory_order_relaxed);
    while (at < n) {
        const size_t end = n - at > job.chunk ? at + job.chunk : n;
        predict_rows(job, worker, job.batch->begin + at, job.batch->begin + end);
        at = job.taken.fetch_add(job.chunk, std::memory_order_relaxed);
    }
}

// A thread starts the next one and waits for it, so that no list of them is needed.
struct Team {
    Job *job;
    size_t others;
};

void *work_together(void *argument)
{
    const Team &team = *static_cast<const Team *>(argument);
    pthread_t next;
    Team rest = {team.job, team.others - 1};
    // where there is no further thread, the others do its rows
    const bool started = team.others > 0 && pthread_create(&next, nullptr, work_together, &rest) == 0;
    work(*team.job);
    if (started) {
        pthread_join(next, nullptr);
    }
    return nullptr;
}

size_t processors()
{
#ifdef __linux__
    cpu_set_t usable;
    if (sched_getaffinity(0, sizeof usable, &usable) == 0) {
        return static_cast<size_t>(CPU_COUNT(&usable));
    }
#endif
    const long online = sysconf(_SC_NPROCESSORS_ONLN);
    return online > 1 ? static_cast<size_t>(online) : 1;
}

// What is wrong with what both functions take; `results` is where they write to.
aminn_status_t check_arguments(const aminn_t *ctx, const aminn_batch_t *batch, const void *results,
                               const aminn_status_t *statuses)
{
    if (ctx == nullptr || batch == nullptr || results == nullptr || statuses == nullptr || batch->q.first == nullptr ||
        batch->x_ht.first == nullptr || batch->w_e.first == nullptr || batch->contacts.first == nullptr ||
        (batch->j_x.first == nullptr) != (batch->j_q.first == nullptr)) {
        return AMINN_E_NULL;
    }
    aminn_t copy = *ctx;
    return aminn_calibrate(&copy, nullptr); // which says whether it is initialised
}

aminn_status_t run(Job &job, unsigned threads, size_t *bad)
{
    const size_t begin = job.batch->begin;
    const size_t n = job.batch->n;
    const size_t wanted = threads != 0 ? threads : processors();
    const size_t most = n / job.chunk > 1 ? n / job.chunk : 1;
    Team team = {&job, (wanted < most ? wanted : most) - 1};
    work_together(&team);
    for (size_t i = begin; i < begin + n; ++i) {
        if (job.statuses[i] != AMINN_OK) {
            *bad = i;
            return job.statuses[i];
        }
    }
    return AMINN_OK;
}

} // namespace
} // namespace aminn

using namespace aminn;

aminn_status_t aminn_predict_batch(const aminn_t *ctx, const aminn_batch_t *batch, unsigned threads,
                                   aminn_output_t *outputs, aminn_stage_debug_t *stages, aminn_status_t *statuses,
                                   size_t *bad)
{
    size_t unasked = 0;
    size_t &first = bad != nullptr ? *bad : unasked;
    first = AMINN_NO_ROW;
    const aminn_status_t status = check_arguments(ctx, batch, outputs, statuses);
    if (status != AMINN_OK) {
        return status;
    }
    Job job = {ctx, batch, predict, kRows, statuses, outputs, stages, {nullptr, 0}, nullptr, nullptr, {0}};
    return run(job, threads, &first);
}

aminn_status_t aminn_admissible_batch(const aminn_t *ctx, const aminn_batch_t *batch, aminn_rows_t directions,
                                      const aminn_load_limits_t *limits, unsigned threads, aminn_admissible_t *found,
                                      aminn_status_t *statuses, size_t *bad)
{
    size_t unasked = 0;
    size_t &first = bad != nullptr ? *bad : unasked;
    first = AMINN_NO_ROW;
    aminn_status_t status = directions.first != nullptr && limits != nullptr ? AMINN_OK : AMINN_E_NULL;
    status = status == AMINN_OK ? check_arguments(ctx, batch, found, statuses) : status;
    if (status != AMINN_OK) {
        return status;
    }
    Job job = {ctx, batch, search, kSearches, statuses, nullptr, nullptr, directions, limits, found, {0}};
    return run(job, threads, &first);
}
