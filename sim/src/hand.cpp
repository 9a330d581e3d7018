#include "hand.hpp"

namespace aminn::sim {

const std::array<const char *, kBranches> kBranchNames = {"finger1", "finger2", "thumb"};
const std::array<const char *, kJoints> kJointNames = {"finger1_roll",   "finger1_proximal", "finger1_distal",
                                                       "finger2_roll",   "finger2_proximal", "finger2_distal",
                                                       "thumb_proximal", "thumb_distal"};
const std::array<std::array<int, kCoords>, kBranches> kBranchJoints = {{{0, 1, 2}, {3, 4, 5}, {-1, 6, 7}}};

namespace {

const std::array<const char *, kTendonsPerBranch> kTendonSuffix = {"_proximal_flexor", "_distal_flexor"};
const std::array<const char *, kBaseJoints> kBaseNames = {"base_x",  "base_y",  "base_z",
                                                          "base_rx", "base_ry", "base_rz"};

Vec3 vec3(const mjtNum *x)
{
    return {x[0], x[1], x[2]};
}
Mat3 mat3(const mjtNum *x)
{
    return Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(x);
}

Tendon read_tendon(const mjModel &m, int branch, const std::string &name)
{
    Tendon t;
    t.branch = branch;
    t.tendon = id_of(m, mjOBJ_TENDON, name);
    t.actuator = id_of(m, mjOBJ_ACTUATOR, name);
    t.arm_m.setZero();
    for (int w = m.tendon_adr[t.tendon]; w < m.tendon_adr[t.tendon] + m.tendon_num[t.tendon]; ++w) {
        for (int c = 0; c < kCoords; ++c) {
            const int j = kBranchJoints[branch][c];
            // a tendon's length is the sum of coefficient times angle; a flexor's coefficients are negative
            if (j >= 0 && m.wrap_objid[w] == id_of(m, mjOBJ_JOINT, kJointNames[j]))
                t.arm_m[c] = -m.wrap_prm[w];
        }
    }
    t.stiffness_N_m = m.actuator_gainprm[t.actuator * mjNGAIN];
    t.max_tension_N = -m.actuator_forcerange[2 * t.actuator];
    return t;
}

} // namespace

Vec3 rotation_vector(const Mat3 &R)
{
    const Eigen::AngleAxisd a(Eigen::Quaterniond(R).normalized());
    return a.angle() > M_PI ? Vec3((a.angle() - 2 * M_PI) * a.axis()) : Vec3(a.angle() * a.axis());
}

Pose Hand::body_pose(const mjData &d, int body)
{
    return {vec3(d.xpos + 3 * body), mat3(d.xmat + 9 * body)};
}

Hand::Hand(const mjModel &m)
{
    palm_body = id_of(m, mjOBJ_BODY, "palm");
    tool_body = id_of(m, mjOBJ_BODY, "tool");
    for (int k = 0; k < kToolGeoms; ++k)
        tool_geoms[static_cast<std::size_t>(k)] = id_of(m, mjOBJ_GEOM, "tool_" + std::to_string(k));
    const int tool_joint = id_of(m, mjOBJ_JOINT, "tool");
    tool_qpos = m.jnt_qposadr[tool_joint];
    tool_dof = m.jnt_dofadr[tool_joint];
    for (int i = 0; i < kBaseJoints; ++i) {
        base_qpos[i] = m.jnt_qposadr[id_of(m, mjOBJ_JOINT, kBaseNames[i])];
        base_actuator[i] = id_of(m, mjOBJ_ACTUATOR, kBaseNames[i]);
    }
    for (int j = 0; j < kJoints; ++j) {
        const int joint = id_of(m, mjOBJ_JOINT, kJointNames[j]);
        qpos[j] = m.jnt_qposadr[joint];
        dof[j] = m.jnt_dofadr[joint];
        roll_actuator[j] = mj_name2id(&m, mjOBJ_ACTUATOR, kJointNames[j]);
    }

    // geometry at q = 0, with the palm wherever qpos0 has it
    const DataPtr data = make_data(m);
    mjData *d = data.get();
    guarded([&] { mj_resetData(&m, d), mj_kinematics(&m, d); });
    const Pose H = palm(*d);
    for (int b = 0; b < kBranches; ++b) {
        Branch &branch = branches[b];
        branch.tip_geom = id_of(m, mjOBJ_GEOM, std::string(kBranchNames[b]) + "_tip");
        branch.tip_body = m.geom_bodyid[branch.tip_geom];
        branch.tip_radius_m = m.geom_size[3 * branch.tip_geom];
        branch.stiffness_Nm_rad.setZero();
        branch.spring_Nm_rad.setZero();
        branch.spring_reference_rad.setZero();
        branch.low_rad.setZero();
        branch.high_rad.setZero();
        Vec3 anchor[kCoords];
        for (int c = 0; c < kCoords; ++c) {
            const int j = kBranchJoints[b][c];
            branch.axis[c].setZero();
            branch.joint[c] = branch.dof[c] = branch.qpos[c] = -1;
            if (j < 0)
                continue;
            const int joint = branch.joint[c] = id_of(m, mjOBJ_JOINT, kJointNames[j]);
            branch.dof[c] = dof[j];
            branch.qpos[c] = qpos[j];
            branch.low_rad[c] = m.jnt_range[2 * joint];
            branch.high_rad[c] = m.jnt_range[2 * joint + 1];
            branch.spring_Nm_rad[c] = m.jnt_stiffness[joint];
            branch.spring_reference_rad[c] = m.qpos_spring[qpos[j]];
            branch.stiffness_Nm_rad[c] = m.jnt_stiffness[joint];
            if (roll_actuator[j] >= 0)
                branch.stiffness_Nm_rad[c] += m.actuator_gainprm[roll_actuator[j] * mjNGAIN];
            branch.axis[c] = H.R.transpose() * vec3(d->xaxis + 3 * joint);
            anchor[c] = H.R.transpose() * (vec3(d->xanchor + 3 * joint) - H.p);
        }
        branch.base_m = anchor[1];
        branch.link_a_m = anchor[2] - anchor[1];
        branch.link_b_m = tip_in_palm(*d, b) - anchor[2];
        for (int i = 0; i < kTendonsPerBranch; ++i)
            tendons[b * kTendonsPerBranch + i] = read_tendon(m, b, std::string(kBranchNames[b]) + kTendonSuffix[i]);
    }
}

Pose Hand::tool_in_palm(const mjData &d) const
{
    const Pose H = palm(d), T = body_pose(d, tool_body);
    return {H.R.transpose() * (T.p - H.p), H.R.transpose() * T.R};
}

Vec3 Hand::tip_in_palm(const mjData &d, int branch) const
{
    const Pose H = palm(d);
    return H.R.transpose() * (vec3(d.geom_xpos + 3 * branches[branch].tip_geom) - H.p);
}

JointVector Hand::joints(const mjData &d) const
{
    JointVector q;
    for (int j = 0; j < kJoints; ++j)
        q[j] = d.qpos[qpos[j]];
    return q;
}

Mat3 Hand::branch_jacobian(const mjData &d, int branch, const Vec3 &c) const
{
    const Pose H = palm(d);
    Mat3 B = Mat3::Zero();
    for (int i = 0; i < kCoords; ++i) {
        const int joint = branches[branch].joint[i];
        if (joint < 0)
            continue;
        const Vec3 anchor = H.R.transpose() * (vec3(d.xanchor + 3 * joint) - H.p);
        B.col(i) = (H.R.transpose() * vec3(d.xaxis + 3 * joint)).cross(c - anchor);
    }
    return B;
}

} // namespace aminn::sim
