// Shards: ranges of grasps simulated by worker threads into arrays.
#pragma once

#include "grasp.hpp"

#include <condition_variable>
#include <deque>
#include <exception>
#include <functional>
#include <memory>
#include <mutex>
#include <thread>

namespace aminn::sim {

// What the shards of a data set have in common.
struct ShardOptions {
    Options options;
    std::uint64_t seed = 0;
    int cases = 0; // of each grasp
    std::vector<int> families;
};

struct ShardRequest {
    std::uint64_t shard = 0;
    std::int64_t first_grasp_id = 0;
    int grasps = 0;
    Eigen::MatrixXd theta; // a row a grasp; no rows: nominal
};

struct ShardResult {
    std::vector<GraspState> grasps;             // in order of grasp id
    std::vector<std::vector<CaseResult>> cases; // of each grasp
    std::int64_t steps = 0;                     // of the engine
};

// Simulates shards. A worker takes a grasp, of the first shard that has one left; where none has, it takes load cases
// of the grasps that others are at. So no worker idles while there is work. A result depends on the request and the
// options, and not on the number of threads or their timing.
class ShardQueue {
  public:
    // Throws std::invalid_argument for options that cannot be simulated. The prototype has to outlive the queue.
    ShardQueue(const Prototype &prototype, ShardOptions options, int threads);
    // Stops the workers at their next step.
    ~ShardQueue();
    ShardQueue(const ShardQueue &) = delete;
    ShardQueue &operator=(const ShardQueue &) = delete;

    // Does not wait.
    void add(ShardRequest request);
    // Waits for the shard that was added first of those that are left. `poll` is called on the calling thread about ten
    // times a second with the number of load cases done since the queue began; what it throws goes on to the caller, and
    // so does what simulating this shard throws. Throws std::logic_error where no shard is left.
    ShardResult next(const std::function<void(int)> &poll);

  private:
    struct Shard {
        ShardRequest request;
        ShardResult result;
        int begun = 0, left = 0; // grasps
        std::exception_ptr error;
    };
    // A grasp whose load cases are being simulated.
    struct Grasp {
        Shard *shard = nullptr;
        std::size_t slot = 0;
        std::vector<Load> loads;
        std::vector<bool> recheck;
        std::size_t begun = 0, left = 0;        // cases
        std::shared_ptr<const Settled> settled; // once others may take cases of it
    };
    using Lock = std::unique_lock<std::mutex>;

    void work();
    Shard *shard_with_grasps_left() const;
    std::shared_ptr<Grasp> grasp_with_cases_left() const;
    void begin_grasp(GraspWorker &worker, Shard &shard, Lock &lock);
    void run_cases(GraspWorker &worker, const std::shared_ptr<Grasp> &grasp, Lock &lock);
    void fail(Shard *shard);

    const Prototype &prototype_;
    const ShardOptions options_;
    std::mutex mutex_; // guards everything below but stop_
    std::condition_variable wake_, done_;
    std::deque<std::unique_ptr<Shard>> shards_;
    std::vector<std::shared_ptr<Grasp>> grasps_;
    int cases_done_ = 0;
    std::exception_ptr error_; // of a worker that could not begin
    std::atomic<bool> stop_{false};
    std::vector<std::thread> threads_;
};

} // namespace aminn::sim
