// One grasp: made from the synergy space, released, settled, saved; then loaded again and again from the saved state.
#pragma once

#include "mechanics.hpp"
#include "options.hpp"
#include "random.hpp"
#include "sobol.hpp"
#include "synergy.hpp"
#include "tool.hpp"

#include <atomic>
#include <cstdint>
#include <stdexcept>
#include <vector>

namespace aminn::sim {

// Contacts of one moment, in H.
struct ContactState {
    struct Row {
        bool in_contact = false;
        Vec3 position = Vec3::Zero(), normal = Vec3::Zero(); // normal into the tool
        double normal_force = 0;
        Vec3 force = Vec3::Zero(); // on the tool
        int geom = -1;             // of the fingertip
        double give_m_N = 0;       // of the contact along its normal
    };
    std::array<Row, kMostBranches> branch;
    std::array<int, kMostBranches> count{}; // contacts of each fingertip with the tool
    int other = 0;                          // contacts of the tool with anything but a fingertip
    double worst_penetration = 0;           // m
};

// Why an attempt at a grasp was thrown away; the order is that of `rejections` in a data set.
enum class Rejection : int {
    no_fit = 0,    // no tool of the family fits between the fingertips
    overlap,       // the tool touches the hand before it closes
    fell,          // it left the hand, or the engine gave up
    not_settled,   // it did not come to rest
    other_contact, // it touches something other than a fingertip, or a fingertip twice
    no_contact,    // too few fingertips touch it, or none of a group
    weak_contact,  // one presses too little
    joint_limit,   // a joint is at a limit
    moved          // the tool moved too far from where it was put
};
inline constexpr int kRejections = 9;
using RejectionCounts = std::array<int, kRejections>;
extern const std::array<const char *, kRejections> kRejectionNames;

// What a settled grasp is, before any load.
struct GraspState {
    std::int64_t grasp_id = 0;
    Vector psi;
    Tool tool;
    Vector q;
    Pose tool_in_palm;
    ContactState contacts;
    std::array<Eigen::Matrix<double, 3, kWrench>, kMostBranches> j_x;
    std::array<Jacobian, kMostBranches> j_q; // columns as in a data set: a short branch has its own last
    std::vector<double> tension_N;
    Wrench base_pose = Wrench::Zero(); // angles and positions of the base joints
    Vec3 gravity_m_s2 = Vec3::Zero();  // in H
    double pinch_force_N = 0, drift_m_s = 0;
    RejectionCounts rejections{}; // attempts before this one
};

// Why a case is not stable; the order is that of `reason` in a data set.
enum class Reason : int { stable = 0, contact_lost, tool_left, translation, rotation, not_settled, diverged };
inline constexpr int kReasons = 7;
extern const std::array<const char *, kReasons> kReasonNames;

// A load: the wrench about the tool's origin (N, N.m, H) and the point that its force acts at (m, H).
struct Load {
    Wrench w_e = Wrench::Zero();
    Vec3 point = Vec3::Zero();
};

// The same load simulated otherwise, to see how far a label can be trusted.
struct Recheck {
    Wrench dx = Wrench::Zero();
    bool stable = false;
};

// Outcome of one load case.
struct CaseResult {
    Load load;
    Wrench dx = Wrench::Zero(); // translation, rotation vector, H
    Vector q_after;
    double creep_rate_m_s = 0, drift_m_s = 0, max_translation_m = 0, max_rotation_rad = 0;
    double worst_penetration_m = 0, solver_residual = 0, equilibrium_residual = 0, hold_time_s = 0, settle_time_s = -1;
    bool settled = false, contact_lost = false, tool_left = false, other_contact = false;
    std::array<double, kMostBranches> lost_time_s{-1, -1, -1, -1, -1}; // from the start of the load; -1: not lost
    std::vector<double> tension_after_N;
    Reason reason = Reason::stable;
    bool rechecked = false;
    Recheck half_step, impratio; // half the time step; ten times impratio
};

// Distance (m) that a rotation of 1 rad counts as where one number must bound both.
inline constexpr double kRotationArm = 0.1;
// From one pose of the tool to another: translation, rotation vector.
Wrench displacement(const Pose &before, const Pose &after);
// 0 to 1 with zero slope at both ends; the share of the load that acts at `x` of the ramp.
double smooth_ramp(double x);
// Number of time steps.
int steps_of(double seconds, double dt);

// The integration state that MuJoCo needs to continue bit by bit as it would have.
struct SavedState {
    double time = 0;
    std::vector<double> qpos, qvel, act, warmstart, ctrl;
};

// A settled grasp, for other workers than the one that made it.
struct Settled {
    ModelPtr model; // with the grasp's tool and mechanics
    Hand hand;
    GraspState state;
    SavedState saved;
};

// What all workers share.
struct Prototype {
    ModelPtr model;
    Hand hand;
    Synergy synergy;
    Mechanics mechanics;
};

// Thrown out of a grasp or a load case that is no longer wanted.
struct Stopped : std::runtime_error {
    Stopped() : std::runtime_error("stopped")
    {
    }
};

// A worker's own model and data. Not shared between threads.
class GraspWorker {
  public:
    // Throws std::invalid_argument for options that cannot be simulated. Where `stop` is given and becomes true, the
    // next step of the engine throws Stopped.
    GraspWorker(const Prototype &prototype, const Options &options, std::uint64_t seed,
                const std::atomic<bool> *stop = nullptr);

    // Makes the grasp of (seed, shard, index); `families` are those to draw from. `theta` has the hand's mechanics
    // parameters: for every grasp of a worker, or, empty, for none. The state afterwards is the settled one. Throws
    // std::runtime_error if no attempt succeeds.
    const GraspState &make(std::uint64_t shard, std::uint64_t index, std::int64_t grasp_id,
                           const std::vector<int> &families, const Vector &theta);
    // What the load cases of the present grasp depend on.
    std::shared_ptr<const Settled> settled() const;
    // From here on load() is of that grasp, with the same bits; there is nothing to draw from its stream.
    void adopt(const Settled &settled);
    // The next random load of this grasp's stream.
    Load draw_load();
    // Whether the next case is one of those simulated again; one draw of the stream.
    bool draw_recheck();
    // Runs the label protocol with `load` from the settled state, and again otherwise where asked.
    CaseResult load(const Load &load, bool recheck);

    const GraspState &state() const
    {
        return state_;
    }
    const Hand &hand() const
    {
        return hand_;
    }
    const mjModel &model() const
    {
        return *model_;
    }
    const Options &options() const
    {
        return options_;
    }
    mjData &data()
    {
        return *data_;
    }
    // Steps of the engine so far.
    std::int64_t steps() const
    {
        return steps_;
    }
    void restore();
    // Puts `w` (H) on the tool, scaled; takes effect with the next step.
    void apply(const Wrench &w, double scale);
    void step();
    // Brings positions and contacts in line with the present joint coordinates.
    void refresh();
    // Without forces the rows say only whether there is a contact; that is cheaper.
    ContactState contacts(bool with_forces = true);

  private:
    bool attempt(const std::vector<int> &families, int number);
    bool reject(Rejection why);
    bool place(const std::vector<int> &families, int number);
    void close_hand();
    void release();
    bool settle();
    bool holds();
    bool at_joint_limit(const ContactState &touching) const;
    int tool_contacts() const;
    void press(double share);
    void press_branch(int b, const Vec3 &tip, const Vec3 &force);
    Vector posture_held(const Branch &branch, const Jacobian &B, const Vec3 &force) const;
    void command(const Drive &drive, double force, double length);
    void hold_tool(double gain);
    bool diverged() const;
    double mean_rate(const Pose &from, const Pose &to, double seconds) const;
    void save();
    void describe();
    std::vector<double> tensions() const;
    CaseResult run_case(const Load &load);
    Recheck again(const Load &load, double timestep, double impratio);
    double equilibrium_residual(const Wrench &w);

    ModelPtr model_;
    DataPtr data_;
    Hand hand_;
    Options options_;
    Synergy synergy_;
    Mechanics mechanics_;
    bool varied_ = false; // the model is that of a theta
    std::uint64_t seed_;
    Sobol sobol_;
    Random random_;
    GraspState state_;
    SavedState saved_;
    Pose placed_; // the tool in H when it was put between the fingertips
    Vector preshape_;
    std::vector<double> first_side_force_N_; // of each of its branches
    int warnings_before_ = 0;
    std::int64_t steps_ = 0;
    const std::atomic<bool> *stop_;
};

} // namespace aminn::sim
