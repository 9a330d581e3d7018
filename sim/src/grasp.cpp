#include "grasp.hpp"

#include <algorithm>

namespace aminn::sim {

const std::array<const char *, kRejections> kRejectionNames = {
    "no_fit", "overlap", "fell", "not_settled", "other_contact", "no_contact", "weak_contact", "joint_limit", "moved"};

namespace {

// Natural frequency (rad/s) of the virtual spring that holds the tool while the hand closes; critically damped.
constexpr double kHoldFrequency = 120;
constexpr double kBoundMargin = 0.03; // rad, from a joint's limit
// Key of the streams that shift the sequence of placements, one an attempt; no shard has it.
constexpr std::uint64_t kShiftStream = ~std::uint64_t{0};

constexpr int kBadState[] = {mjWARN_BADQPOS, mjWARN_BADQVEL,     mjWARN_BADQACC,
                             mjWARN_INERTIA, mjWARN_CONTACTFULL, mjWARN_CNSTRFULL};

int count_warnings(const mjData &d)
{
    int n = 0;
    for (const int w : kBadState)
        n += d.warning[w].number;
    return n;
}

// The most frequent reason and its count, in words.
std::string worst_rejection(const RejectionCounts &counts)
{
    const auto worst = std::max_element(counts.begin(), counts.end());
    return std::string("most often ") + kRejectionNames[static_cast<std::size_t>(worst - counts.begin())] + ", " +
           std::to_string(*worst) + " times";
}

} // namespace

Wrench displacement(const Pose &before, const Pose &after)
{
    Wrench dx;
    dx << after.p - before.p, rotation_vector(after.R * before.R.transpose());
    return dx;
}

int steps_of(double seconds, double dt)
{
    return static_cast<int>(std::lround(seconds / dt));
}

GraspWorker::GraspWorker(const Prototype &prototype, const Options &options, std::uint64_t seed,
                         const std::atomic<bool> *stop)
    : model_(copy_model(*prototype.model)), data_(make_data(*prototype.model)), hand_(prototype.hand),
      options_(options), synergy_(prototype.synergy), seed_(seed), random_(0, 0, 0), stop_(stop)
{
    check_options(options_, model_->opt.timestep);
}

void GraspWorker::step()
{
    if (stop_ != nullptr && stop_->load(std::memory_order_relaxed))
        throw Stopped();
    const mjModel *m = model_.get();
    mjData *d = data_.get();
    guarded([&] { mj_step(m, d); });
    ++steps_;
}

void GraspWorker::refresh()
{
    const mjModel *m = model_.get();
    mjData *d = data_.get();
    guarded([&] { mj_forward(m, d); });
}

bool GraspWorker::diverged() const
{
    return count_warnings(*data_) != warnings_before_;
}

ContactState GraspWorker::contacts(bool with_forces)
{
    const mjModel *m = model_.get();
    mjData *d = data_.get();
    const Pose H = hand_.palm(*d);
    ContactState s;
    for (int i = 0; i < d->ncon; ++i) {
        const mjContact &c = d->contact[i];
        if (c.exclude != 0 || c.efc_address < 0)
            continue;
        const bool tool_is_1 = hand_.is_tool(*m, c.geom1), tool_is_2 = hand_.is_tool(*m, c.geom2);
        if (!tool_is_1 && !tool_is_2)
            continue;
        s.worst_penetration = std::max(s.worst_penetration, -c.dist);
        const int other = tool_is_1 ? c.geom2 : c.geom1;
        int b = 0;
        while (b < kBranches && hand_.branches[b].tip_geom != other)
            ++b;
        if (b == kBranches) {
            ++s.other;
            continue;
        }
        ++s.count[b];
        ContactState::Row &row = s.branch[b];
        if (!with_forces) {
            row.in_contact = true;
            continue;
        }
        mjtNum force[6];
        mj_contactForce(m, d, i, force);
        if (row.in_contact && row.normal_force >= force[0])
            continue; // of several contacts the strongest stands
        row.in_contact = true;
        row.position = H.R.transpose() * (Vec3(c.pos[0], c.pos[1], c.pos[2]) - H.p);
        // MuJoCo's normal points from geom1 to geom2
        row.normal = H.R.transpose() * Vec3(c.frame[0], c.frame[1], c.frame[2]) * (tool_is_2 ? 1.0 : -1.0);
        row.normal_force = force[0];
        const Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>> frame(c.frame);
        row.force =
            H.R.transpose() * (frame.transpose() * Vec3(force[0], force[1], force[2])) * (tool_is_2 ? 1.0 : -1.0);
    }
    return s;
}

std::array<double, kTendons> GraspWorker::tensions() const
{
    std::array<double, kTendons> t;
    for (int i = 0; i < kTendons; ++i)
        t[i] = 0.0 - data_->actuator_force[hand_.tendons[i].actuator]; // slack is +0
    return t;
}

void GraspWorker::apply(const Wrench &w, double scale)
{
    mjData *d = data_.get();
    const Pose H = hand_.palm(*d);
    const Vec3 force = H.R * w.head<3>() * scale, moment = H.R * w.tail<3>() * scale;
    // MuJoCo applies both at the body's centre of mass, which is the origin of the tool's frame
    for (int i = 0; i < 3; ++i) {
        d->xfrc_applied[6 * hand_.tool_body + i] = force[i];
        d->xfrc_applied[6 * hand_.tool_body + 3 + i] = moment[i];
    }
}

bool GraspWorker::reject(Rejection why)
{
    ++state_.rejections[static_cast<std::size_t>(why)];
    return false;
}

bool GraspWorker::place(const std::vector<int> &families, int number)
{
    mjModel *m = model_.get();
    mjData *d = data_.get();
    guarded([&] { mj_resetData(m, d); });
    // over the grasps of a data set the first attempts fill the space evenly, and so do the second ones
    const Random shift(seed_, kShiftStream, static_cast<std::uint64_t>(number));
    const Sobol::Point u = sobol_.point(static_cast<std::uint32_t>(state_.grasp_id), shift);
    state_.psi = synergy_.low + (synergy_.high - synergy_.low).cwiseProduct(Vec3(u[0], u[1], u[2]));
    const Placement placement{u[3], u[4], Vec3(u[5], u[6], u[7])};
    const double force_ratio = options_.pinch_force_max_N / options_.pinch_force_min_N;
    state_.pinch_force_N = options_.pinch_force_min_N * std::pow(force_ratio, u[8]);
    const double share = 0.42 + 0.16 * u[9]; // finger 1's of the pinch force
    finger_force_N_ = {state_.pinch_force_N * share, state_.pinch_force_N * (1 - share)};
    preshape_ = synergy_.posture(state_.psi);
    const auto family = static_cast<ToolFamily>(families[random_.index(static_cast<int>(families.size()))]);
    // wrist: the direction of gravity in H is uniform on the sphere
    const double rx = random_.uniform(-M_PI, M_PI), ry = std::asin(random_.uniform(-1, 1)), rz = 0;
    state_.base_pose << 0, 0, 0, rx, ry, rz;

    const auto pose_hand = [&] {
        for (int i = 0; i < kBaseJoints; ++i)
            d->qpos[hand_.base_qpos[i]] = d->ctrl[hand_.base_actuator[i]] = state_.base_pose[i];
        for (int j = 0; j < kJoints; ++j) {
            d->qpos[hand_.qpos[j]] = preshape_[j];
            if (hand_.roll_actuator[j] >= 0)
                d->ctrl[hand_.roll_actuator[j]] = preshape_[j];
        }
        guarded([&] { mj_kinematics(m, d); });
    };
    pose_hand();
    std::array<Vec3, kBranches> tip;
    std::array<double, kBranches> radius;
    for (int b = 0; b < kBranches; ++b)
        tip[b] = hand_.tip_in_palm(*d, b), radius[b] = hand_.branches[b].tip_radius_m;
    if (!draw_tool(random_, options_, family, placement, tip, radius, state_.tool, placed_))
        return reject(Rejection::no_fit);

    install_tool(*m, *d, hand_, state_.tool);
    pose_hand();
    const Pose H = hand_.palm(*d);
    const Vec3 p = H.p + H.R * placed_.p;
    const Eigen::Quaterniond r(Mat3(H.R * placed_.R));
    const double qpos[7] = {p.x(), p.y(), p.z(), r.w(), r.x(), r.y(), r.z()};
    mju_copy(d->qpos + hand_.tool_qpos, qpos, 7);
    warnings_before_ = count_warnings(*d);
    refresh();
    return d->ncon == 0 || reject(Rejection::overlap);
}

// Sets the tendons' commands so that their tensions balance the return springs and, by `share`, press the fingertips
// on the tool: fingers towards the thumb's tip, the thumb against the sum of both.
void GraspWorker::set_tensions(double share)
{
    mjData *d = data_.get();
    std::array<Vec3, kBranches> tip;
    for (int b = 0; b < kBranches; ++b)
        tip[b] = hand_.tip_in_palm(*d, b);
    std::array<Vec3, kBranches> force;
    for (int b = 0; b < 2; ++b)
        force[b] = finger_force_N_[b] * share * (tip[2] - tip[b]).normalized();
    force[2] = -force[0] - force[1];
    for (int b = 0; b < kBranches; ++b) {
        const Branch &branch = hand_.branches[b];
        BranchVector torque = hand_.branch_jacobian(*d, b, tip[b]).transpose() * force[b];
        for (int c = 0; c < kCoords; ++c)
            if (branch.qpos[c] >= 0)
                torque[c] += branch.spring_Nm_rad[c] * (d->qpos[branch.qpos[c]] - branch.spring_reference_rad[c]);
        // the distal joint has one tendon; the proximal flexor takes what that one leaves
        const Tendon &proximal = hand_.tendons[b * kTendonsPerBranch],
                     &distal = hand_.tendons[b * kTendonsPerBranch + 1];
        const double t_distal = std::max(0.0, torque[2] / distal.arm_m[2]);
        const double t_proximal = std::max(0.0, (torque[1] - distal.arm_m[1] * t_distal) / proximal.arm_m[1]);
        d->ctrl[proximal.actuator] = d->ten_length[proximal.tendon] - t_proximal / proximal.stiffness_N_m;
        d->ctrl[distal.actuator] = d->ten_length[distal.tendon] - t_distal / distal.stiffness_N_m;
    }
}

// A critically damped virtual spring to the placed pose, and the tool's weight, both times `gain`.
void GraspWorker::hold_tool(double gain)
{
    mjData *d = data_.get();
    const Pose H = hand_.palm(*d), T = Hand::body_pose(*d, hand_.tool_body);
    const Pose goal{H.p + H.R * placed_.p, H.R * placed_.R};
    const mjtNum *v = d->qvel + hand_.tool_dof; // a free joint: linear in the world, angular in the body
    const Vec3 linear(v[0], v[1], v[2]), angular = T.R * Vec3(v[3], v[4], v[5]);
    const Vec3 gravity(model_->opt.gravity[0], model_->opt.gravity[1], model_->opt.gravity[2]);
    const double w = kHoldFrequency;
    const Vec3 force = state_.tool.mass_kg * (w * w * (goal.p - T.p) - 2 * w * linear - gravity);
    const Mat3 inertia = T.R * state_.tool.inertia_kgm2.asDiagonal() * T.R.transpose();
    const Vec3 moment = inertia * (w * w * rotation_vector(goal.R * T.R.transpose()) - 2 * w * angular);
    for (int i = 0; i < 3; ++i) {
        d->xfrc_applied[6 * hand_.tool_body + i] = gain * force[i];
        d->xfrc_applied[6 * hand_.tool_body + 3 + i] = gain * moment[i];
    }
}

void GraspWorker::close_hand()
{
    const double dt = model_->opt.timestep;
    const int ramp = steps_of(options_.close_s, dt), all = ramp + steps_of(options_.dwell_s, dt);
    for (int i = 0; i < all && !diverged(); ++i) {
        set_tensions(std::min(1.0, static_cast<double>(i) / ramp));
        hold_tool(1);
        step();
    }
}

// From here on the tendons' commands stand still: each is a spring that can only pull.
void GraspWorker::release()
{
    const int n = steps_of(options_.release_s, model_->opt.timestep);
    for (int i = 0; i < n && !diverged(); ++i) {
        hold_tool(1 - static_cast<double>(i + 1) / n);
        step();
    }
    mju_zero(data_->xfrc_applied + 6 * hand_.tool_body, 6);
}

double GraspWorker::mean_rate(const Pose &from, const Pose &to, double seconds) const
{
    const Wrench dx = displacement(from, to);
    return (dx.head<3>().norm() + kRotationArm * dx.tail<3>().norm()) / seconds;
}

bool GraspWorker::settle()
{
    const int window = steps_of(options_.drift_window_s, model_->opt.timestep);
    const int most = steps_of(options_.grasp_settle_max_s, model_->opt.timestep) / window;
    Pose before = hand_.tool_in_palm(*data_);
    for (int k = 0; k < most; ++k) {
        for (int i = 0; i < window; ++i) {
            step();
            if (diverged() || data_->ncon == 0)
                return false;
        }
        const Pose now = hand_.tool_in_palm(*data_);
        state_.drift_m_s = mean_rate(before, now, options_.drift_window_s);
        if (state_.drift_m_s < options_.grasp_drift_max_m_s)
            return true;
        before = now;
    }
    return false;
}

bool GraspWorker::at_joint_limit() const
{
    for (const Branch &branch : hand_.branches)
        for (int c = 0; c < kCoords; ++c) {
            if (branch.qpos[c] < 0)
                continue;
            const double q = data_->qpos[branch.qpos[c]];
            if (q < branch.low_rad[c] + kBoundMargin || q > branch.high_rad[c] - kBoundMargin)
                return true;
        }
    return false;
}

// Whether the settled state is a grasp by the three fingertips.
bool GraspWorker::holds()
{
    refresh();
    const ContactState c = contacts();
    if (c.other > 0)
        return reject(Rejection::other_contact);
    for (int b = 0; b < kBranches; ++b) {
        if (c.count[b] == 0)
            return reject(Rejection::no_contact);
        if (c.count[b] > 1)
            return reject(Rejection::other_contact);
        if (c.branch[b].normal_force < options_.contact_force_min_N)
            return reject(Rejection::weak_contact);
    }
    if (at_joint_limit())
        return reject(Rejection::joint_limit);
    const Wrench by = displacement(placed_, hand_.tool_in_palm(*data_));
    const bool near =
        by.head<3>().norm() <= options_.grasp_shift_max_m && by.tail<3>().norm() <= options_.grasp_tilt_max_rad;
    return near || reject(Rejection::moved);
}

bool GraspWorker::attempt(const std::vector<int> &families, int number)
{
    if (!place(families, number))
        return false;
    close_hand();
    if (diverged())
        return reject(Rejection::fell);
    release();
    if (diverged() || !settle())
        return reject(diverged() || data_->ncon == 0 ? Rejection::fell : Rejection::not_settled);
    return holds();
}

const GraspState &GraspWorker::make(std::uint64_t shard, std::uint64_t index, std::int64_t grasp_id,
                                    const std::vector<int> &families)
{
    random_ = Random(seed_, shard, index);
    state_ = GraspState();
    state_.grasp_id = grasp_id;
    for (int k = 0; k < options_.grasp_attempts; ++k) {
        if (!attempt(families, k))
            continue;
        save();
        describe();
        return state_;
    }
    throw std::runtime_error("grasp " + std::to_string(grasp_id) + ": none of " +
                             std::to_string(options_.grasp_attempts) + " attempts held the tool (" +
                             worst_rejection(state_.rejections) +
                             "); widen the tool, synergy and force ranges or raise grasp_attempts");
}

void GraspWorker::save()
{
    const mjData &d = *data_;
    const mjModel &m = *model_;
    saved_.time = d.time;
    saved_.qpos.assign(d.qpos, d.qpos + m.nq);
    saved_.qvel.assign(d.qvel, d.qvel + m.nv);
    saved_.warmstart.assign(d.qacc_warmstart, d.qacc_warmstart + m.nv);
    saved_.ctrl.assign(d.ctrl, d.ctrl + m.nu);
}

void GraspWorker::restore()
{
    const mjModel *m = model_.get();
    mjData *d = data_.get();
    guarded([&] { mj_resetData(m, d); });
    d->time = saved_.time;
    std::copy(saved_.qpos.begin(), saved_.qpos.end(), d->qpos);
    std::copy(saved_.qvel.begin(), saved_.qvel.end(), d->qvel);
    std::copy(saved_.warmstart.begin(), saved_.warmstart.end(), d->qacc_warmstart);
    std::copy(saved_.ctrl.begin(), saved_.ctrl.end(), d->ctrl);
    refresh();
    std::copy(saved_.warmstart.begin(), saved_.warmstart.end(), d->qacc_warmstart);
    warnings_before_ = count_warnings(*d);
}

void GraspWorker::describe()
{
    restore();
    state_.contacts = contacts();
    state_.q = hand_.joints(*data_);
    state_.tool_in_palm = hand_.tool_in_palm(*data_);
    state_.tension_N = tensions();
    const Vec3 gravity(model_->opt.gravity[0], model_->opt.gravity[1], model_->opt.gravity[2]);
    state_.gravity_m_s2 = hand_.palm(*data_).R.transpose() * gravity;
    for (int b = 0; b < kBranches; ++b) {
        state_.j_x[b].setZero();
        state_.j_q[b].setZero();
        const ContactState::Row &row = state_.contacts.branch[b];
        if (!row.in_contact)
            continue;
        state_.j_x[b] << Mat3::Identity(), -skew(row.position - state_.tool_in_palm.p);
        state_.j_q[b] = -hand_.branch_jacobian(*data_, b, row.position);
    }
}

} // namespace aminn::sim
