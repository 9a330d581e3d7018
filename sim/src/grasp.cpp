#include "grasp.hpp"

#include <algorithm>

namespace aminn::sim {

const std::array<const char *, kReasons> kReasonNames = {"stable",   "contact_lost", "tool_left", "translation",
                                                         "rotation", "not_settled",  "diverged"};

namespace {

// Natural frequency (rad/s) of the virtual spring that holds the tool while the hand closes; critically damped.
constexpr double kHoldFrequency = 120;
// Distance (m) that a rotation of 1 rad counts as where one number must bound both.
constexpr double kRotationArm = 0.1;
constexpr double kBoundMargin = 0.03; // rad, from a joint's limit

constexpr int kBadState[] = {mjWARN_BADQPOS, mjWARN_BADQVEL,     mjWARN_BADQACC,
                             mjWARN_INERTIA, mjWARN_CONTACTFULL, mjWARN_CNSTRFULL};

enum Rejection : int { no_fit, fell, no_contact, too_many_contacts, weak, moved, at_limit, drifting };

int count_warnings(const mjData &d)
{
    int n = 0;
    for (const int w : kBadState)
        n += d.warning[w].number;
    return n;
}

// Scaled change of cost in the solver's last iteration: the friction iterations (noslip) come after Newton's.
double solver_residual(const mjData &d)
{
    const int last = std::min(d.solver_iter, static_cast<int>(mjNSOLVER)) - 1;
    return last >= 0 ? std::abs(d.solver[last].improvement) : 0;
}

int steps(double seconds, double dt)
{
    return static_cast<int>(std::lround(seconds / dt));
}

Wrench displacement(const Pose &before, const Pose &after)
{
    Wrench dx;
    dx << after.p - before.p, rotation_vector(after.R * before.R.transpose());
    return dx;
}

} // namespace

GraspWorker::GraspWorker(const mjModel &prototype, const Hand &hand, const Options &options)
    : model_(copy_model(prototype)), data_(make_data(prototype)), hand_(hand), options_(options), random_(0, 0, 0)
{
}

void GraspWorker::step()
{
    const mjModel *m = model_.get();
    mjData *d = data_.get();
    guarded([&] { mj_step(m, d); });
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

ContactState GraspWorker::contacts()
{
    const mjModel *m = model_.get();
    mjData *d = data_.get();
    const Pose H = hand_.palm(*d);
    ContactState s;
    for (int i = 0; i < d->ncon; ++i) {
        const mjContact &c = d->contact[i];
        if (c.exclude != 0 || c.efc_address < 0)
            continue;
        const bool tool_is_1 = c.geom1 == hand_.tool_geom, tool_is_2 = c.geom2 == hand_.tool_geom;
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
        mjtNum force[6];
        mj_contactForce(m, d, i, force);
        ContactState::Row &row = s.branch[b];
        if (row.in_contact && row.normal_force >= force[0])
            continue; // of several contacts the strongest stands
        row.in_contact = true;
        row.position = H.R.transpose() * (Vec3(c.pos[0], c.pos[1], c.pos[2]) - H.p);
        // MuJoCo's normal points from geom1 to geom2
        row.normal = H.R.transpose() * Vec3(c.frame[0], c.frame[1], c.frame[2]) * (tool_is_2 ? 1.0 : -1.0);
        row.normal_force = force[0];
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

bool GraspWorker::place(const std::vector<int> &families)
{
    mjModel *m = model_.get();
    mjData *d = data_.get();
    guarded([&] { mj_resetData(m, d); });
    for (int i = 0; i < 3; ++i)
        state_.psi[i] = random_.uniform(-1, 1);
    preshape_ = synergy_.posture(state_.psi);
    const auto family = static_cast<ToolFamily>(families[random_.index(static_cast<int>(families.size()))]);
    // wrist: the direction of gravity in H is uniform on the sphere
    const double rx = random_.uniform(-M_PI, M_PI), ry = std::asin(random_.uniform(-1, 1)), rz = 0;
    state_.base_pose << 0, 0, 0, rx, ry, rz;
    state_.pinch_force_N = random_.log_uniform(options_.pinch_force_min_N, options_.pinch_force_max_N);
    const double share = random_.uniform(0.42, 0.58);
    finger_force_N_ = {state_.pinch_force_N * share, state_.pinch_force_N * (1 - share)};

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
    if (!draw_tool(random_, options_, family, tip, radius, state_.tool, placed_))
        return false;

    install_tool(*m, *d, hand_, state_.tool);
    pose_hand();
    const Pose H = hand_.palm(*d);
    const Vec3 p = H.p + H.R * placed_.p;
    const Eigen::Quaterniond r(Mat3(H.R * placed_.R));
    const double qpos[7] = {p.x(), p.y(), p.z(), r.w(), r.x(), r.y(), r.z()};
    mju_copy(d->qpos + hand_.tool_qpos, qpos, 7);
    warnings_before_ = count_warnings(*d);
    refresh();
    return d->ncon == 0;
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
    const Mat3 inertia = T.R * state_.tool.inertia_kgm2().asDiagonal() * T.R.transpose();
    const Vec3 moment = inertia * (w * w * rotation_vector(goal.R * T.R.transpose()) - 2 * w * angular);
    for (int i = 0; i < 3; ++i) {
        d->xfrc_applied[6 * hand_.tool_body + i] = gain * force[i];
        d->xfrc_applied[6 * hand_.tool_body + 3 + i] = gain * moment[i];
    }
}

void GraspWorker::close_hand()
{
    const double dt = model_->opt.timestep;
    const int ramp = steps(options_.close_s, dt), all = ramp + steps(options_.dwell_s, dt);
    for (int i = 0; i < all && !diverged(); ++i) {
        set_tensions(std::min(1.0, static_cast<double>(i) / ramp));
        hold_tool(1);
        step();
    }
}

// From here on the tendons' commands stand still: each is a spring that can only pull.
void GraspWorker::release()
{
    const int n = steps(options_.release_s, model_->opt.timestep);
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
    const int window = steps(options_.drift_window_s, model_->opt.timestep);
    const int most = steps(options_.grasp_settle_max_s, model_->opt.timestep) / window;
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

bool GraspWorker::attempt(const std::vector<int> &families)
{
    const auto reject = [&](Rejection r) { return ++rejections_[r], false; };
    if (!place(families))
        return reject(no_fit);
    close_hand();
    if (diverged())
        return reject(fell);
    release();
    if (diverged() || !settle())
        return reject(data_->ncon == 0 ? fell : drifting);
    refresh();
    const ContactState c = contacts();
    if (c.other > 0)
        return reject(too_many_contacts);
    for (int b = 0; b < kBranches; ++b) {
        if (c.count[b] == 0)
            return reject(no_contact);
        if (c.count[b] > 1)
            return reject(too_many_contacts);
        if (c.branch[b].normal_force < options_.contact_force_min_N)
            return reject(weak);
    }
    for (int j = 0; j < kJoints; ++j) {
        const int joint = hand_.branches[j < 3 ? 0 : j < 6 ? 1 : 2].joint[j < 6 ? j % 3 : j - 5];
        const double q = data_->qpos[hand_.qpos[j]];
        if (q < model_->jnt_range[2 * joint] + kBoundMargin || q > model_->jnt_range[2 * joint + 1] - kBoundMargin)
            return reject(at_limit);
    }
    const Wrench moved_by = displacement(placed_, hand_.tool_in_palm(*data_));
    if (moved_by.head<3>().norm() > options_.grasp_shift_max_m ||
        moved_by.tail<3>().norm() > options_.grasp_tilt_max_rad)
        return reject(moved);
    return true;
}

const GraspState &GraspWorker::make(std::uint64_t seed, std::uint64_t shard, std::uint64_t index, std::int64_t grasp_id,
                                    const std::vector<int> &families)
{
    random_ = Random(seed, shard, index);
    state_ = GraspState();
    for (int n = 1; n <= options_.grasp_attempts; ++n) {
        if (!attempt(families))
            continue;
        save();
        describe();
        state_.grasp_id = grasp_id;
        state_.attempts = n;
        return state_;
    }
    throw std::runtime_error("grasp " + std::to_string(grasp_id) + ": none of " +
                             std::to_string(options_.grasp_attempts) +
                             " attempts held the tool; widen the tool and force ranges or raise grasp_attempts");
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

Wrench GraspWorker::draw_wrench()
{
    const double kind = random_.uniform();
    const double low = std::pow(10.0, -options_.load_decades);
    const double force = options_.force_max_N * random_.log_uniform(low, 1);
    const double moment = options_.moment_max_Nm * random_.log_uniform(low, 1);
    const Vec3 f = random_.direction(), n = random_.direction();
    const bool has_force = kind >= options_.share_moment_only;
    const bool has_moment =
        kind < options_.share_moment_only || kind >= options_.share_moment_only + options_.share_force_only;
    Wrench w = Wrench::Zero();
    if (has_force)
        w.head<3>() = force * f;
    if (has_moment)
        w.tail<3>() = moment * n;
    return w;
}

namespace {

// Watches one load case step by step.
struct Watch {
    const Options &options;
    const Pose before;
    int lost_steps[kBranches] = {};
    int lost_limit;
    CaseResult &result;

    // Takes in the present state; returns true when the case is clearly lost.
    bool look(const ContactState &c, const std::array<ContactState::Row, kBranches> &had, const Pose &now)
    {
        result.worst_penetration_m = std::max(result.worst_penetration_m, c.worst_penetration);
        result.other_contact |= c.other > 0;
        for (int b = 0; b < kBranches; ++b) {
            lost_steps[b] = had[b].in_contact && !c.branch[b].in_contact ? lost_steps[b] + 1 : 0;
            result.contact_lost |= lost_steps[b] > lost_limit;
        }
        const bool touched = c.count[0] + c.count[1] + c.count[2] > 0;
        const double moved = (now.p - before.p).norm();
        const double turned = rotation_vector(now.R * before.R.transpose()).norm();
        result.max_translation_m = std::max(result.max_translation_m, moved);
        result.max_rotation_rad = std::max(result.max_rotation_rad, turned);
        result.tool_left |= moved > options.tool_left_m || (result.contact_lost && !touched);
        return result.contact_lost || result.tool_left || moved > options.stop_factor * options.translation_max_m ||
               turned > options.stop_factor * options.rotation_max_rad;
    }
};

Reason judge(const CaseResult &r, const Options &o, bool diverged)
{
    if (diverged)
        return Reason::diverged;
    if (r.tool_left)
        return Reason::tool_left;
    if (r.contact_lost)
        return Reason::contact_lost;
    if (r.max_translation_m > o.translation_max_m)
        return Reason::translation;
    if (r.max_rotation_rad > o.rotation_max_rad)
        return Reason::rotation;
    if (!r.settled)
        return Reason::not_settled;
    return Reason::stable;
}

// 0 to 1 with zero slope at both ends.
double smooth_ramp(double x)
{
    return x >= 1 ? 1 : x * x * (3 - 2 * x);
}

} // namespace

CaseResult GraspWorker::load(const Wrench &w)
{
    restore();
    CaseResult result;
    result.w_e = w;
    const Pose before = state_.tool_in_palm;
    const double dt = model_->opt.timestep;
    Watch watch{options_, before, {}, steps(options_.lost_contact_s, dt), result};
    const int ramp = steps(options_.ramp_s, dt), hold = steps(options_.hold_s, dt);
    const int window = steps(options_.drift_window_s, dt), most = ramp + hold + steps(options_.hold_extra_s, dt);
    bool lost = false, early_taken = false;
    Pose early = before, window_start = before, creep_start = before;
    int n = 0;
    for (; n < most && !lost; ++n) {
        if (n == ramp + hold - window)
            window_start = hand_.tool_in_palm(*data_);
        if (n >= ramp + hold && (n - ramp - hold) % window == 0) { // the hold is over, or one more window is
            const Pose now = hand_.tool_in_palm(*data_);
            result.drift_m_s = mean_rate(window_start, now, options_.drift_window_s);
            if ((result.settled = result.drift_m_s <= options_.drift_max_m_s))
                break;
            window_start = now;
        }
        if (n == ramp + hold / 2) {
            early = creep_start = hand_.tool_in_palm(*data_);
            early_taken = true;
        }
        apply(w, smooth_ramp(static_cast<double>(n + 1) / ramp));
        step();
        if (diverged())
            break;
        lost = watch.look(contacts(), state_.contacts.branch, hand_.tool_in_palm(*data_));
    }
    const bool bad = diverged();
    if (bad) { // the engine has reset the state: there is no pose to report
        restore();
        result.dx.setZero();
        result.q_after = state_.q;
        result.reason = Reason::diverged;
        return result;
    }
    result.solver_residual = solver_residual(*data_);
    refresh();
    const Pose after = hand_.tool_in_palm(*data_);
    if (!lost && !result.settled) { // the last window of the extension
        result.drift_m_s = mean_rate(window_start, after, options_.drift_window_s);
        result.settled = result.drift_m_s <= options_.drift_max_m_s;
    }
    result.hold_time_s = std::max(0, n - ramp) * dt;
    result.dx = displacement(before, after);
    result.max_translation_m = std::max(result.max_translation_m, result.dx.head<3>().norm());
    result.max_rotation_rad = std::max(result.max_rotation_rad, result.dx.tail<3>().norm());
    result.dx_early = early_taken ? displacement(before, early) : result.dx;
    const double creep_time = (n - ramp - hold / 2) * dt;
    if (early_taken && creep_time > 0)
        result.creep_rate_m_s = (after.p - creep_start.p).norm() / creep_time;
    result.q_after = hand_.joints(*data_);
    result.tension_after_N = tensions();
    result.reason = judge(result, options_, bad);
    return result;
}

} // namespace aminn::sim
