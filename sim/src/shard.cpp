#include "shard.hpp"

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <exception>
#include <mutex>
#include <thread>

namespace aminn::sim {

namespace {

// Shared by the workers of one shard.
class Job {
  public:
    Job(const Prototype &prototype, const Options &options, const ShardRequest &request)
        : prototype_(prototype), options_(options), request_(request)
    {
        result_.grasps.resize(static_cast<std::size_t>(request.grasps));
        result_.cases.resize(static_cast<std::size_t>(request.grasps));
    }

    void start()
    {
        running_ = std::max(1, std::min(request_.threads, request_.grasps));
        const int n = running_;
        threads_.reserve(static_cast<std::size_t>(n));
        for (int i = 0; i < n; ++i)
            threads_.emplace_back([this] { work(); });
    }

    // Waits a while; true when every worker is done.
    bool wait()
    {
        std::unique_lock lock(mutex_);
        return done_.wait_for(lock, std::chrono::milliseconds(100), [this] { return running_ == 0; });
    }

    void stop()
    {
        stop_ = true;
    }
    void join()
    {
        for (auto &t : threads_)
            t.join();
        threads_.clear();
    }
    int cases_done() const
    {
        return cases_done_;
    }

    ShardResult finish()
    {
        join();
        if (error_)
            std::rethrow_exception(error_);
        result_.steps = steps_;
        return std::move(result_);
    }

    ~Job()
    {
        stop();
        join();
    }

  private:
    void work()
    {
        try {
            GraspWorker worker(prototype_, options_, request_.seed, &stop_);
            for (int g = next_++; g < request_.grasps && !stop_; g = next_++)
                one_grasp(worker, g);
            steps_ += worker.steps();
        } catch (...) {
            const std::lock_guard lock(mutex_);
            if (!error_)
                error_ = std::current_exception();
            stop_ = true;
        }
        const std::lock_guard lock(mutex_);
        if (--running_ == 0)
            done_.notify_all();
    }

    void one_grasp(GraspWorker &worker, int g)
    {
        const auto slot = static_cast<std::size_t>(g);
        const Vector theta = request_.theta.rows() > 0 ? Vector(request_.theta.row(g)) : Vector();
        result_.grasps[slot] = worker.make(request_.shard, static_cast<std::uint64_t>(g), request_.first_grasp_id + g,
                                           request_.families, theta);
        for (int i = 0; i < request_.cases && !stop_; ++i) {
            const Load load = worker.draw_load();
            result_.cases[slot].push_back(worker.load(load, worker.draw_recheck()));
            ++cases_done_;
        }
    }

    const Prototype &prototype_;
    const Options &options_;
    const ShardRequest &request_;
    ShardResult result_;
    std::vector<std::thread> threads_;
    std::mutex mutex_;
    std::condition_variable done_;
    std::atomic<int> next_{0}, cases_done_{0};
    std::atomic<std::int64_t> steps_{0};
    std::atomic<bool> stop_{false};
    int running_ = 0;
    std::exception_ptr error_;
};

} // namespace

ShardResult simulate_shard(const Prototype &prototype, const Options &options, const ShardRequest &request,
                           const std::function<void(int)> &poll)
{
    Job job(prototype, options, request);
    job.start();
    while (!job.wait())
        poll(job.cases_done());
    poll(job.cases_done());
    return job.finish();
}

} // namespace aminn::sim
