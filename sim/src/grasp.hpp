// One grasp: made from the synergy space, released, settled, saved; then loaded again and again from the saved state.
#pragma once

#include "hand.hpp"
#include "options.hpp"
#include "random.hpp"
#include "synergy.hpp"
#include "tool.hpp"

#include <cstdint>
#include <vector>

namespace aminn::sim {

// Contacts of one moment, in H.
struct ContactState {
    struct Row {
        bool in_contact = false;
        Vec3 position = Vec3::Zero(), normal = Vec3::Zero(); // normal into the tool
        double normal_force = 0;
    };
    std::array<Row, kBranches> branch;
    std::array<int, kBranches> count{}; // contacts of each fingertip with the tool
    int other = 0;                      // contacts of the tool with anything but a fingertip
    double worst_penetration = 0;       // m
};

// What a settled grasp is, before any load.
struct GraspState {
    std::int64_t grasp_id = 0;
    Vec3 psi = Vec3::Zero();
    Tool tool;
    JointVector q = JointVector::Zero();
    Pose tool_in_palm;
    ContactState contacts;
    std::array<Eigen::Matrix<double, 3, AMINN_N_WRENCH>, kBranches> j_x;
    std::array<Mat3, kBranches> j_q;
    std::array<double, kTendons> tension_N{};
    Wrench base_pose = Wrench::Zero(); // angles and positions of the base joints
    Vec3 gravity_m_s2 = Vec3::Zero();  // in H
    double pinch_force_N = 0, drift_m_s = 0;
    int attempts = 0;
};

// Why a case is not stable; the order is that of `reason` in a data set.
enum class Reason : int { stable = 0, contact_lost, tool_left, translation, rotation, not_settled, diverged };
inline constexpr int kReasons = 7;
extern const std::array<const char *, kReasons> kReasonNames;

// Outcome of one load case.
struct CaseResult {
    Wrench w_e = Wrench::Zero();
    Wrench dx = Wrench::Zero(), dx_early = Wrench::Zero(); // translation, rotation vector, H
    JointVector q_after = JointVector::Zero();
    double creep_rate_m_s = 0, drift_m_s = 0, max_translation_m = 0, max_rotation_rad = 0;
    double worst_penetration_m = 0, solver_residual = 0, hold_time_s = 0;
    bool settled = false, contact_lost = false, tool_left = false, other_contact = false;
    std::array<double, kTendons> tension_after_N{};
    Reason reason = Reason::stable;
};

// The integration state that MuJoCo needs to continue bit by bit as it would have.
struct SavedState {
    double time = 0;
    std::vector<double> qpos, qvel, warmstart, ctrl;
};

// A worker's own model and data. Not shared between threads.
class GraspWorker {
  public:
    GraspWorker(const mjModel &prototype, const Hand &hand, const Options &options);

    // Makes the grasp of (seed, shard, index); `families` are those to draw from. The state afterwards is the settled
    // one. Throws std::runtime_error if no attempt succeeds.
    const GraspState &make(std::uint64_t seed, std::uint64_t shard, std::uint64_t index, std::int64_t grasp_id,
                           const std::vector<int> &families);
    // The next random wrench of this grasp's stream (force, moment about the tool's origin; N, N.m, H).
    Wrench draw_wrench();
    // Runs the label protocol with wrench `w` from the settled state.
    CaseResult load(const Wrench &w);

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
    mjData &data()
    {
        return *data_;
    }
    void restore();
    // Puts `w` (H) on the tool, scaled; takes effect with the next step.
    void apply(const Wrench &w, double scale);
    void step();
    // Brings positions and contacts in line with the present joint coordinates.
    void refresh();
    ContactState contacts();
    const std::array<int, 16> &rejections() const
    {
        return rejections_;
    }

  private:
    bool attempt(const std::vector<int> &families);
    bool place(const std::vector<int> &families);
    void close_hand();
    void release();
    bool settle();
    void set_tensions(double share);
    void hold_tool(double gain);
    bool diverged() const;
    double mean_rate(const Pose &from, const Pose &to, double seconds) const;
    void save();
    void describe();
    std::array<double, kTendons> tensions() const;

    ModelPtr model_;
    DataPtr data_;
    Hand hand_;
    Options options_;
    Synergy synergy_;
    Random random_;
    GraspState state_;
    SavedState saved_;
    Pose placed_; // the tool in H when it was put between the fingertips
    JointVector preshape_;
    std::array<double, 2> finger_force_N_{};
    int warnings_before_ = 0;
    std::array<int, 16> rejections_{};
};

} // namespace aminn::sim
