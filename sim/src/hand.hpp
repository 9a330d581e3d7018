// The hand as the compiled MuJoCo model has it: ids, geometry, stiffness, tendons. Nothing here is typed twice.
#pragma once

#include "mujoco_handle.hpp"

#include <aminn_rt.h>

#include <Eigen/Dense>
#include <array>
#include <string>

namespace aminn::sim {

inline constexpr int kBranches = AMINN_N_BRANCH, kCoords = AMINN_N_COORD, kJoints = AMINN_N_JOINT;
inline constexpr int kTendonsPerBranch = 2, kTendons = kTendonsPerBranch * kBranches;
inline constexpr int kBaseJoints = 6;
inline constexpr int kToolGeoms = 3; // primitives that a tool may be made of

using Vec3 = Eigen::Vector3d;
using Mat3 = Eigen::Matrix3d;
using JointVector = Eigen::Matrix<double, kJoints, 1>;
using Wrench = Eigen::Matrix<double, AMINN_N_WRENCH, 1>; // force, moment; also position, rotation vector
using BranchVector = Eigen::Matrix<double, kCoords, 1>;  // roll, proximal, distal

// Names in branch order and in joint order.
extern const std::array<const char *, kBranches> kBranchNames;
extern const std::array<const char *, kJoints> kJointNames;
// Joint of each branch coordinate, -1 where the branch has none.
extern const std::array<std::array<int, kCoords>, kBranches> kBranchJoints;

struct Pose { // of a frame in another
    Vec3 p = Vec3::Zero();
    Mat3 R = Mat3::Identity();
};

// Rotation vector of a rotation matrix, angle in [0, pi].
Vec3 rotation_vector(const Mat3 &R);

struct Tendon {
    int branch, actuator, tendon;
    BranchVector arm_m; // flexing torque of each coordinate for a tension of 1 N
    double stiffness_N_m, max_tension_N;
};

struct Branch {
    int tip_geom, tip_body;
    std::array<int, kCoords> joint, dof, qpos; // -1 where the coordinate does not exist
    BranchVector stiffness_Nm_rad;             // return springs and, for a roll, its servo
    BranchVector spring_Nm_rad, spring_reference_rad;
    Vec3 base_m, link_a_m, link_b_m; // in H at q = 0: base; base to distal joint; distal joint to fingertip centre
    std::array<Vec3, kCoords> axis;  // in H at q = 0
    BranchVector low_rad, high_rad;  // limits of the joints; 0 where absent
    double tip_radius_m;
};

class Hand {
  public:
    Hand() = default;
    // Throws MujocoError if `model` lacks a part of the hand.
    explicit Hand(const mjModel &model);

    std::array<Branch, kBranches> branches;
    std::array<Tendon, kTendons> tendons;
    std::array<int, kJoints> qpos, dof;     // addresses of the joints
    std::array<int, kJoints> roll_actuator; // -1 where the joint is not a roll
    std::array<int, kBaseJoints> base_qpos, base_actuator;
    int palm_body, tool_body, tool_qpos, tool_dof;
    std::array<int, kToolGeoms> tool_geoms;

    // Valid after mj_kinematics (or any forward pass).
    Pose palm(const mjData &d) const
    {
        return body_pose(d, palm_body);
    }
    bool is_tool(const mjModel &m, int geom) const
    {
        return m.geom_bodyid[geom] == tool_body;
    }
    Pose tool_in_palm(const mjData &d) const;
    Vec3 tip_in_palm(const mjData &d, int branch) const;
    JointVector joints(const mjData &d) const;
    // B of the closure: velocity of the fingertip's material point `c` (m, H) for unit rates of roll, proximal, distal.
    Mat3 branch_jacobian(const mjData &d, int branch, const Vec3 &c) const;

    static Pose body_pose(const mjData &d, int body);
};

inline Mat3 skew(const Vec3 &r)
{
    Mat3 s;
    s << 0, -r.z(), r.y(), r.z(), 0, -r.x(), -r.y(), r.x(), 0;
    return s;
}

} // namespace aminn::sim
