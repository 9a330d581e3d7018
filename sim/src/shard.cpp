#include "shard.hpp"

#include <algorithm>
#include <chrono>

namespace aminn::sim {

ShardQueue::ShardQueue(const Prototype &prototype, ShardOptions options, int threads)
    : prototype_(prototype), options_(std::move(options))
{
    check_options(options_.options, prototype.model->opt.timestep);
    threads_.reserve(static_cast<std::size_t>(threads));
    for (int i = 0; i < threads; ++i)
        threads_.emplace_back([this] { work(); });
}

ShardQueue::~ShardQueue()
{
    {
        const std::lock_guard lock(mutex_);
        stop_ = true;
    }
    wake_.notify_all();
    for (auto &t : threads_)
        t.join();
}

void ShardQueue::add(ShardRequest request)
{
    auto shard = std::make_unique<Shard>();
    shard->left = request.grasps;
    shard->result.grasps.resize(static_cast<std::size_t>(request.grasps));
    shard->result.cases.resize(static_cast<std::size_t>(request.grasps));
    shard->request = std::move(request);
    {
        const std::lock_guard lock(mutex_);
        shards_.push_back(std::move(shard));
    }
    wake_.notify_all();
}

ShardResult ShardQueue::next(const std::function<void(int)> &poll)
{
    Lock lock(mutex_);
    if (shards_.empty())
        throw std::logic_error("no shard is left");
    const Shard &first = *shards_.front();
    const auto over = [&] { return error_ || first.error || first.left == 0; };
    bool ended = false;
    while (!ended) {
        ended = done_.wait_for(lock, std::chrono::milliseconds(100), over);
        const int done = cases_done_;
        lock.unlock();
        poll(done);
        lock.lock();
    }
    if (error_ || first.error)
        std::rethrow_exception(error_ ? error_ : first.error);
    ShardResult result = std::move(shards_.front()->result);
    shards_.pop_front();
    return result;
}

ShardQueue::Shard *ShardQueue::shard_with_grasps_left() const
{
    for (const auto &shard : shards_)
        if (!shard->error && shard->begun < shard->request.grasps)
            return shard.get();
    return nullptr;
}

std::shared_ptr<ShardQueue::Grasp> ShardQueue::grasp_with_cases_left() const
{
    for (const auto &grasp : grasps_)
        if (grasp->settled && !grasp->shard->error && grasp->begun < grasp->loads.size())
            return grasp;
    return nullptr;
}

void ShardQueue::work()
{
    Lock lock(mutex_, std::defer_lock);
    try {
        GraspWorker worker(prototype_, options_.options, options_.seed, &stop_);
        lock.lock();
        while (!stop_) {
            if (Shard *shard = shard_with_grasps_left())
                begin_grasp(worker, *shard, lock);
            else if (const std::shared_ptr<Grasp> grasp = grasp_with_cases_left()) {
                worker.adopt(*grasp->settled);
                run_cases(worker, grasp, lock);
            } else
                wake_.wait(lock);
        }
    } catch (...) {
        if (!lock.owns_lock())
            lock.lock();
        error_ = std::current_exception();
        done_.notify_all();
    }
}

void ShardQueue::begin_grasp(GraspWorker &worker, Shard &shard, Lock &lock)
{
    const int index = shard.begun++;
    const auto grasp = std::make_shared<Grasp>();
    grasp->shard = &shard;
    grasp->slot = static_cast<std::size_t>(index);
    const std::int64_t steps_before = worker.steps();
    lock.unlock();
    try {
        const ShardRequest &request = shard.request;
        const Vector theta = request.theta.rows() > 0 ? Vector(request.theta.row(index)) : Vector();
        shard.result.grasps[grasp->slot] = worker.make(request.shard, static_cast<std::uint64_t>(index),
                                                       request.first_grasp_id + index, options_.families, theta);
        for (int i = 0; i < options_.cases; ++i) {
            grasp->loads.push_back(worker.draw_load());
            grasp->recheck.push_back(worker.draw_recheck());
        }
        shard.result.cases[grasp->slot].resize(grasp->loads.size());
        lock.lock();
    } catch (...) {
        lock.lock();
        fail(&shard);
        return;
    }
    shard.result.steps += worker.steps() - steps_before;
    grasp->left = grasp->loads.size();
    grasps_.push_back(grasp);
    run_cases(worker, grasp, lock);
}

// Cases of a grasp that the worker has made or adopted, until none is left to begin.
void ShardQueue::run_cases(GraspWorker &worker, const std::shared_ptr<Grasp> &grasp, Lock &lock)
{
    Shard &shard = *grasp->shard;
    while (!stop_ && !shard.error && grasp->begun < grasp->loads.size()) {
        if (!grasp->settled && threads_.size() > 1 && shard_with_grasps_left() == nullptr) {
            grasp->settled = worker.settled();
            wake_.notify_all();
        }
        const std::size_t i = grasp->begun++;
        const std::int64_t steps_before = worker.steps();
        lock.unlock();
        try {
            CaseResult result = worker.load(grasp->loads[i], grasp->recheck[i]);
            lock.lock();
            shard.result.cases[grasp->slot][i] = std::move(result);
        } catch (...) {
            if (!lock.owns_lock())
                lock.lock();
            fail(&shard);
            return;
        }
        shard.result.steps += worker.steps() - steps_before;
        ++cases_done_;
        if (--grasp->left > 0)
            continue;
        grasps_.erase(std::find(grasps_.begin(), grasps_.end(), grasp));
        if (--shard.left == 0)
            done_.notify_all();
    }
}

void ShardQueue::fail(Shard *shard)
{
    shard->error = std::current_exception();
    done_.notify_all();
}

} // namespace aminn::sim
