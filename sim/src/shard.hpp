// A shard: a range of grasps simulated by worker threads into arrays.
#pragma once

#include "grasp.hpp"

#include <functional>

namespace aminn::sim {

struct ShardRequest {
    std::uint64_t seed = 0, shard = 0;
    std::int64_t first_grasp_id = 0;
    int grasps = 0, cases = 0, threads = 1;
    std::vector<int> families;
    Eigen::MatrixXd theta; // a row a grasp; no rows: nominal
};

struct ShardResult {
    std::vector<GraspState> grasps;             // in order of grasp id
    std::vector<std::vector<CaseResult>> cases; // of each grasp
    std::int64_t steps = 0;                     // of the engine
};

// Simulates a shard. The result depends on the request and options, and not on the number of threads or their timing.
// `poll` is called on the calling thread about ten times a second with the number of load cases done; if it throws, the
// workers stop at their next case and the exception goes on to the caller. Exceptions of workers do the same.
ShardResult simulate_shard(const Prototype &prototype, const Options &options, const ShardRequest &request,
                           const std::function<void(int)> &poll);

} // namespace aminn::sim
