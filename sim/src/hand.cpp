#include "hand.hpp"

#include <algorithm>
#include <limits>

namespace aminn::sim {

namespace {

const std::array<const char *, kBaseJoints> kBaseNames = {"x", "y", "z", "rx", "ry", "rz"};
constexpr double kSamePoint = 1e-12; // m
constexpr double kUneven = 1e-9;     // m, less is not told apart from 0

std::size_t at(int i)
{
    return static_cast<std::size_t>(i);
}

Vec3 vec3(const mjtNum *x)
{
    return {x[0], x[1], x[2]};
}
Mat3 mat3(const mjtNum *x)
{
    return Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(x);
}

// Greatest distance of a geom's surface from its own centre along `y` (unit, in the geom's frame), m.
double extent(const mjModel &m, int geom, const Vec3 &y)
{
    const Vec3 size = vec3(m.geom_size + 3 * geom);
    switch (m.geom_type[geom]) {
    case mjGEOM_SPHERE:
        return size[0];
    case mjGEOM_CAPSULE:
        return size[0] + size[1] * std::abs(y.z());
    case mjGEOM_ELLIPSOID:
        return size.cwiseProduct(y).norm();
    case mjGEOM_CYLINDER:
        return size[0] * std::hypot(y.x(), y.y()) + size[1] * std::abs(y.z());
    case mjGEOM_BOX:
        return size.dot(y.cwiseAbs());
    case mjGEOM_MESH: {
        const int mesh = m.geom_dataid[geom];
        double most = -std::numeric_limits<double>::infinity();
        for (int v = m.mesh_vertadr[mesh]; v < m.mesh_vertadr[mesh] + m.mesh_vertnum[mesh]; ++v)
            most = std::max(most, y.dot(Eigen::Map<const Eigen::Vector3f>(m.mesh_vert + 3 * v).cast<double>()));
        return most;
    }
    default:
        return m.geom_rbound[geom];
    }
}

void read_force_law(const mjModel &m, Drive &drive)
{
    const int a = drive.actuator;
    const bool affine = m.actuator_biastype[a] == mjBIAS_AFFINE;
    drive.gain = m.actuator_gainprm[a * mjNGAIN];
    drive.stiffness = affine ? -m.actuator_biasprm[a * mjNBIAS + 1] : 0;
    drive.offset = affine ? m.actuator_biasprm[a * mjNBIAS] : 0;
}

Drive read_drive(const mjModel &m, int a)
{
    Drive drive;
    drive.actuator = a;
    read_force_law(m, drive);
    drive.gear = m.actuator_gear[6 * a];
    const bool limited = m.actuator_forcelimited[a];
    const double endless = std::numeric_limits<double>::infinity();
    drive.low_N = limited ? m.actuator_forcerange[2 * a] : -endless;
    drive.high_N = limited ? m.actuator_forcerange[2 * a + 1] : endless;
    drive.is_tendon = m.actuator_trntype[a] == mjTRN_TENDON;
    return drive;
}

// Row of a dense Jacobian over the coordinates of a branch.
Vector row_of(const mjtNum *dense, int nv, int row, const Branch &branch)
{
    Vector out(branch.coordinates());
    for (int c = 0; c < branch.coordinates(); ++c)
        out[c] = dense[row * nv + branch.dof[at(c)]];
    return out;
}

// For each coordinate the drive whose outermost coordinate it is, where that is one drive at most and none crosses it
// beside the drives of the coordinates farther out: torques then follow from the tip inwards. Else empty.
std::vector<int> outwards(const mjModel &m, const mjData &d, const Branch &branch)
{
    std::vector<int> out(branch.joint.size(), -1);
    for (std::size_t i = 0; i < branch.drives.size(); ++i) {
        const Drive &drive = branch.drives[i];
        if (drive.held_joint >= 0)
            continue;
        if (!drive.is_tendon)
            return {};
        const Vector moment = row_of(d.actuator_moment, m.nv, drive.actuator, branch);
        int last = branch.coordinates() - 1;
        while (last >= 0 && moment[last] == 0)
            --last;
        if (last < 0 || out[at(last)] >= 0)
            return {};
        out[at(last)] = static_cast<int>(i);
    }
    for (std::size_t c = 0; c < out.size(); ++c)
        if (branch.pressed[c] && out[c] < 0)
            return {};
    return branch.couplings.empty() ? out : std::vector<int>();
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

Hand::Hand(const mjModel &m, const HandParts &parts)
    : first_side(parts.first_side), second_side(parts.second_side), tool_axis(parts.tool_axis), forward(parts.forward),
      branch_of_geom_(at(m.ngeom), -1)
{
    palm_body = id_of(m, mjOBJ_BODY, parts.palm);
    tool_body = id_of(m, mjOBJ_BODY, parts.prefix + "tool");
    for (int k = 0; k < kToolGeoms; ++k) {
        const int g = tool_geoms[at(k)] = id_of(m, mjOBJ_GEOM, parts.prefix + "tool_" + std::to_string(k));
        if (m.geom_bodyid[g] != tool_body)
            throw MujocoError("the tool's geoms are not on the tool");
    }
    const int tool_joint = id_of(m, mjOBJ_JOINT, parts.prefix + "tool");
    tool_qpos = m.jnt_qposadr[tool_joint];
    tool_dof = m.jnt_dofadr[tool_joint];
    for (int i = 0; i < kBaseJoints; ++i) {
        const std::string name = parts.prefix + "base_" + kBaseNames[at(i)];
        base_qpos[at(i)] = m.jnt_qposadr[id_of(m, mjOBJ_JOINT, name)];
        base_actuator[at(i)] = id_of(m, mjOBJ_ACTUATOR, name);
    }
    if (mj_isSparse(&m))
        throw MujocoError("the model has more than 60 degrees of freedom; lock what is not part of the grasp");
    if (parts.branches.size() > kMostBranches)
        throw MujocoError("more branches than " + std::to_string(kMostBranches));
    for (const BranchParts &branch : parts.branches)
        read_branch(m, branch);

    const DataPtr data = make_data(m);
    mjData *d = data.get();
    guarded([&] { mj_resetData(&m, d), mj_forward(&m, d); });
    const Pose H = palm(*d);
    std::vector<std::string> named;
    for (std::size_t b = 0; b < branches.size(); ++b) {
        Branch &branch = branches[b];
        const int g = branch.tip_geoms[0];
        branch.tip_offset = mat3(d->geom_xmat + 9 * g).transpose() *
                            (H.p + H.R * parts.branches[b].tip_point_m - vec3(d->geom_xpos + 3 * g));
        if (branch.tip_offset.norm() < kSamePoint)
            branch.tip_offset.setZero();
        const auto found = std::find(named.begin(), named.end(), parts.branches[b].group);
        branch.group = static_cast<int>(found - named.begin());
        if (found == named.end())
            named.push_back(parts.branches[b].group);
        read_drives(m, *d, branch, parts.branches[b].tendons);
    }
    groups = static_cast<int>(named.size());
    read_stiffness(m);
}

void Hand::read_branch(const mjModel &m, const BranchParts &parts)
{
    Branch branch;
    const auto n = static_cast<Eigen::Index>(parts.joints.size());
    branch.name = parts.name;
    branch.first_joint = joint_count();
    branch.tip_body = id_of(m, mjOBJ_BODY, parts.tip_body);
    for (Vector *x : {&branch.spring_Nm_rad, &branch.spring_reference_rad, &branch.low_rad, &branch.high_rad})
        x->setZero(n);
    for (const std::string &name : parts.joints) {
        const int joint = id_of(m, mjOBJ_JOINT, name);
        const auto c = static_cast<Eigen::Index>(branch.joint.size());
        branch.joint.push_back(joint);
        branch.dof.push_back(m.jnt_dofadr[joint]);
        branch.qpos.push_back(m.jnt_qposadr[joint]);
        branch.low_rad[c] = m.jnt_range[2 * joint];
        branch.high_rad[c] = m.jnt_range[2 * joint + 1];
        branch.spring_reference_rad[c] = m.qpos_spring[branch.qpos.back()];
        qpos.push_back(branch.qpos.back());
        dof.push_back(branch.dof.back());
    }
    for (const std::string &name : parts.tip_geoms) {
        branch.tip_geoms.push_back(id_of(m, mjOBJ_GEOM, name));
        branch_of_geom_[at(branch.tip_geoms.back())] = count();
    }
    coordinates = std::max(coordinates, branch.coordinates());
    branches.push_back(std::move(branch));
}

void Hand::read_drives(const mjModel &m, const mjData &d, Branch &branch, const std::vector<std::string> &names)
{
    for (const std::string &name : names) {
        Tendon t{id_of(m, mjOBJ_TENDON, name), {}, {}, 0, 0};
        t.relaxed_m = m.tendon_lengthspring[t.tendon];
        for (int a = 0; a < m.nu; ++a)
            if (m.actuator_trntype[a] == mjTRN_TENDON && m.actuator_trnid[2 * a] == t.tendon) {
                t.actuators.push_back(a);
                t.gears.push_back(m.actuator_gear[6 * a]);
            }
        tendons.push_back(std::move(t));
    }
    for (int t = 0; t < m.ntendon; ++t)
        if (m.tendon_stiffness[t] > 0 && !row_of(d.ten_J, m.nv, t, branch).isZero(0))
            branch.springs.push_back(t);
    for (int a = 0; a < m.nu; ++a) {
        const bool own = std::find(base_actuator.begin(), base_actuator.end(), a) != base_actuator.end();
        if (!own && !row_of(d.actuator_moment, m.nv, a, branch).isZero(0))
            branch.drives.push_back(read_drive(m, a));
    }
    for (int r = 0; r < d.nefc; ++r) {
        const Vector row = row_of(d.efc_J, m.nv, r, branch);
        if (d.efc_type[r] == mjCNSTR_EQUALITY && !row.isZero(0))
            branch.couplings.push_back(row);
    }
    // a servo of a joint that no driven tendon crosses keeps the joint where the others bend theirs
    std::vector<bool> crossed(branch.joint.size());
    bool pulled = false;
    for (const Drive &drive : branch.drives) {
        const Vector moment = row_of(d.actuator_moment, m.nv, drive.actuator, branch);
        pulled |= drive.is_tendon;
        for (int c = 0; c < branch.coordinates(); ++c)
            crossed[at(c)] = crossed[at(c)] || (drive.is_tendon && moment[c] != 0);
    }
    branch.pressed.assign(branch.joint.size(), true);
    for (Drive &drive : branch.drives)
        for (int c = 0; c < branch.coordinates(); ++c)
            if (pulled && !drive.is_tendon && !crossed[at(c)] && drive.stiffness > 0 &&
                m.actuator_trnid[2 * drive.actuator] == branch.joint[at(c)]) {
                drive.held_joint = c;
                branch.pressed[at(c)] = false;
            }
    branch.by_coordinate = outwards(m, d, branch);
}

void Hand::read_stiffness(const mjModel &m)
{
    for (Branch &branch : branches) {
        for (int c = 0; c < branch.coordinates(); ++c)
            branch.spring_Nm_rad[c] = m.jnt_stiffness[branch.joint[at(c)]];
        for (Drive &drive : branch.drives)
            read_force_law(m, drive);
    }
    for (Tendon &tendon : tendons)
        tendon.stiffness_N_m = m.tendon_stiffness[tendon.tendon];
}

Pose Hand::tool_in_palm(const mjData &d) const
{
    const Pose H = palm(d), T = body_pose(d, tool_body);
    return {H.R.transpose() * (T.p - H.p), H.R.transpose() * T.R};
}

Vec3 Hand::tip_in_palm(const mjData &d, int b) const
{
    const Branch &branch = branches[at(b)];
    const Pose H = palm(d);
    const int g = branch.tip_geoms[0];
    Vec3 point = vec3(d.geom_xpos + 3 * g);
    if (!branch.tip_offset.isZero(0))
        point += mat3(d.geom_xmat + 9 * g) * branch.tip_offset;
    return H.R.transpose() * (point - H.p);
}

// From `middle` along `direction` to the farthest surface of a side's fingertips; uneven tips count.
double Hand::reach(const mjModel &m, const mjData &d, const std::vector<int> &side, const Vec3 &middle,
                   const Vec3 &direction) const
{
    const Pose H = palm(d);
    double most = 0;
    for (const int b : side) {
        const int g = branches[at(b)].tip_geoms[0];
        const Vec3 tip = tip_in_palm(d, b), centre = H.R.transpose() * (vec3(d.geom_xpos + 3 * g) - H.p);
        const Vec3 local = mat3(d.geom_xmat + 9 * g).transpose() * (H.R * direction);
        const double ahead = direction.dot(tip - middle);
        most =
            std::max(most, (std::abs(ahead) > kUneven ? ahead : 0) + direction.dot(centre - tip) + extent(m, g, local));
    }
    return most;
}

Pinch Hand::pinch(const mjModel &m, const mjData &d) const
{
    Pinch out;
    const auto middle = [&](const std::vector<int> &side) {
        Vec3 sum = tip_in_palm(d, side[0]);
        for (std::size_t i = 1; i < side.size(); ++i)
            sum += tip_in_palm(d, side[i]);
        return Vec3((1.0 / static_cast<double>(side.size())) * sum);
    };
    out.first = middle(first_side);
    out.second = middle(second_side);
    out.tool_axis = tool_axis;
    out.forward = forward;
    const Vec3 y = (out.first - out.second).normalized();
    out.first_reach = reach(m, d, first_side, out.first, -y);
    out.second_reach = reach(m, d, second_side, out.second, y);
    out.half_span = 0;
    for (const auto *side : {&first_side, &second_side})
        for (std::size_t i = 0; i < side->size(); ++i)
            for (std::size_t j = i + 1; j < side->size(); ++j)
                out.half_span =
                    std::max(out.half_span, 0.5 * (tip_in_palm(d, (*side)[i]) - tip_in_palm(d, (*side)[j])).norm());
    return out;
}

Vector Hand::joints(const mjData &d) const
{
    Vector q(joint_count());
    for (int j = 0; j < joint_count(); ++j)
        q[j] = d.qpos[qpos[at(j)]];
    return q;
}

Jacobian Hand::branch_jacobian(const mjData &d, int b, const Vec3 &c) const
{
    const Branch &branch = branches[at(b)];
    const Pose H = palm(d);
    Jacobian B(3, branch.coordinates());
    for (int i = 0; i < branch.coordinates(); ++i) {
        const int joint = branch.joint[at(i)];
        const Vec3 anchor = H.R.transpose() * (vec3(d.xanchor + 3 * joint) - H.p);
        B.col(i) = (H.R.transpose() * vec3(d.xaxis + 3 * joint)).cross(c - anchor);
    }
    return B;
}

} // namespace aminn::sim
