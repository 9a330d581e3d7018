// The hand as the compiled MuJoCo model has it: ids, shapes, drives. Which parts of the model are the hand comes from
// Python, by name (`HandParts`); what they are is read from the model. Nothing here is typed twice.
#pragma once

#include "mujoco_handle.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <string>
#include <vector>

namespace aminn::sim {

inline constexpr int kWrench = 6, kContactFeatures = 8; // in contact, position (3), normal (3), normal force
inline constexpr int kMostBranches = 5;
inline constexpr int kBaseJoints = 6;
inline constexpr int kToolGeoms = 3; // primitives that a tool may be made of

using Vec3 = Eigen::Vector3d;
using Mat3 = Eigen::Matrix3d;
using Vector = Eigen::VectorXd;
using Wrench = Eigen::Matrix<double, kWrench, 1>; // force, moment; also position, rotation vector
using Jacobian = Eigen::Matrix3Xd;                // one column a coordinate

struct Pose { // of a frame in another
    Vec3 p = Vec3::Zero();
    Mat3 R = Mat3::Identity();
};

// Rotation vector of a rotation matrix, angle in [0, pi].
Vec3 rotation_vector(const Mat3 &R);

// A branch by the names of its parts.
struct BranchParts {
    std::string name, group, tip_body;
    std::vector<std::string> joints, tip_geoms, tendons;
    Vec3 tip_point_m = Vec3::Zero(); // pad point, H, at q = 0
};

// What of a model is the hand, and how it pinches.
struct HandParts {
    std::string prefix, palm; // of the names of the base, the tool and what else the simulation adds; the palm's body
    std::vector<BranchParts> branches;
    std::vector<int> first_side, second_side;                // branches that face each other
    Vec3 tool_axis = Vec3::UnitX(), forward = Vec3::UnitY(); // H; from the second side to the first at rest
    double torsional_friction_m = 0;                         // above 0: soft fingers
};

// An actuator that moves a branch: force = gain * command - stiffness * length + offset.
struct Drive {
    int actuator;
    double gain, stiffness, offset, gear;
    double low_N, high_N; // of its force
    bool is_tendon;
    int held_joint = -1; // coordinate that it keeps where it was put; -1: it presses
};

struct Tendon {
    int tendon;
    std::vector<int> actuators;
    std::vector<double> gears;
    double stiffness_N_m, relaxed_m; // its own spring
};

struct Branch {
    std::string name;
    int group;                  // number of its group
    int first_joint;            // where its angles begin in q
    int tip_body;               // that a contact is held by
    std::vector<int> tip_geoms; // the pad point goes with the first
    Vec3 tip_offset;            // of the pad point in the frame of the first, m
    std::vector<int> joint, dof, qpos;
    Vector spring_Nm_rad, spring_reference_rad, low_rad, high_rad;
    std::vector<Drive> drives;
    std::vector<bool> pressed;      // coordinates that no held servo keeps
    std::vector<int> springs;       // tendons with a spring of their own that cross it
    std::vector<Vector> couplings;  // directions in which an equality of the model holds coordinates together
    std::vector<int> by_coordinate; // the drive that takes a coordinate's torque, -1: none; empty: no such order

    int coordinates() const
    {
        return static_cast<int>(joint.size());
    }
};

// Where two sides of a hand meet: a tool goes between them.
struct Pinch {
    Vec3 first, second;               // middle of each side's pad points, m, H
    Vec3 tool_axis, forward;          // as in HandParts
    double first_reach, second_reach; // from these points to the surface that faces the tool, m
    double half_span;                 // half of the largest distance within a side, m
};

class Hand {
  public:
    Hand() = default;
    // Throws MujocoError if `model` lacks a part of the hand.
    Hand(const mjModel &model, const HandParts &parts);

    std::vector<Branch> branches;
    std::vector<Tendon> tendons; // branch by branch
    std::vector<int> qpos, dof;  // addresses of the joints, branch by branch
    std::array<int, kBaseJoints> base_qpos, base_actuator;
    int palm_body, tool_body, tool_qpos, tool_dof;
    std::array<int, kToolGeoms> tool_geoms;
    std::vector<int> first_side, second_side;
    Vec3 tool_axis, forward;
    int groups = 0;
    int coordinates = 0; // of the longest branch

    int count() const
    {
        return static_cast<int>(branches.size());
    }
    int joint_count() const
    {
        return static_cast<int>(qpos.size());
    }
    // Branches that a grasp needs.
    int least_holding() const
    {
        return std::min(count(), 3);
    }

    // Valid after mj_kinematics (or any forward pass).
    Pose palm(const mjData &d) const
    {
        return body_pose(d, palm_body);
    }
    bool is_tool(const mjModel &m, int geom) const
    {
        return m.geom_bodyid[geom] == tool_body;
    }
    // Branch whose fingertip a geom is part of, -1: none.
    int branch_of(int geom) const
    {
        return branch_of_geom_[static_cast<std::size_t>(geom)];
    }
    Pose tool_in_palm(const mjData &d) const;
    Vec3 tip_in_palm(const mjData &d, int branch) const;
    Pinch pinch(const mjModel &m, const mjData &d) const;
    Vector joints(const mjData &d) const;
    // Takes the stiffnesses of springs, tendons and drives from the model again.
    void read_stiffness(const mjModel &m);
    // B of the closure: velocity of the fingertip's material point `c` (m, H) for unit rates of its coordinates.
    Jacobian branch_jacobian(const mjData &d, int branch, const Vec3 &c) const;

    static Pose body_pose(const mjData &d, int body);

  private:
    void read_branch(const mjModel &m, const BranchParts &parts);
    void read_drives(const mjModel &m, const mjData &d, Branch &branch, const std::vector<std::string> &names);
    double reach(const mjModel &m, const mjData &d, const std::vector<int> &side, const Vec3 &middle,
                 const Vec3 &direction) const;
    std::vector<int> branch_of_geom_;
};

inline Mat3 skew(const Vec3 &r)
{
    Mat3 s;
    s << 0, -r.z(), r.y(), r.z(), 0, -r.x(), -r.y(), r.x(), 0;
    return s;
}

} // namespace aminn::sim
