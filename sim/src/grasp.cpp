#include "grasp.hpp"

#include <algorithm>
#include <limits>

namespace aminn::sim {

const std::array<const char *, kRejections> kRejectionNames = {
    "no_fit", "overlap", "fell", "not_settled", "other_contact", "no_contact", "weak_contact", "joint_limit", "moved"};

namespace {

// Natural frequency (rad/s) of the virtual spring that holds the tool while the hand closes; critically damped.
constexpr double kHoldFrequency = 120;
constexpr double kBoundMargin = 0.03; // rad, from a joint's limit
constexpr double kUneven = 0.16;      // of a branch's share of the pinch force
constexpr double kEndless = std::numeric_limits<double>::infinity();
constexpr double kLeastTorque = 1e-9; // N.m, changes below which forces have been found
constexpr int kSweeps = 200;
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

// Shares of n branches that sum to 1, up to a sixth more or less than even by `u` in [0, 1).
std::vector<double> uneven_shares(std::size_t n, double u)
{
    std::vector<double> out(n, 1.0);
    const double even = 1.0 / static_cast<double>(n);
    double rest = 1;
    for (std::size_t i = 0; i + 1 < n; ++i) {
        const double tilt = 1 - 2 * static_cast<double>(i) / static_cast<double>(n - 1); // from 1 to -1
        out[i] = even * (1 - kUneven * tilt) + even * (2 * kUneven * tilt) * u;
        rest -= out[i];
    }
    out[n - 1] = rest;
    return out;
}

// What can turn the joints of a branch: torque a newton, least and greatest force, and where the force goes.
struct Generator {
    Vector moment;
    double low, high;
    double *force;
};

// Forces within their bounds whose torques come nearest to `torque`; one after the other until none changes.
void least_squares(const std::vector<Generator> &generators, Vector torque)
{
    for (int sweep = 0; sweep < kSweeps; ++sweep) {
        double most = 0;
        for (const Generator &g : generators) {
            const double square = g.moment.squaredNorm();
            if (square == 0)
                continue;
            const double wanted = *g.force + g.moment.dot(torque) / square;
            const double step = std::min(std::max(wanted, g.low), g.high) - *g.force;
            *g.force += step;
            torque -= step * g.moment;
            most = std::max(most, std::abs(step) * std::sqrt(square));
        }
        if (most < kLeastTorque)
            return;
    }
}

// Reasons and how often they were met, the most frequent first.
std::string in_words(const RejectionCounts &counts)
{
    std::vector<std::size_t> order;
    for (std::size_t i = 0; i < counts.size(); ++i)
        if (counts[i] > 0)
            order.push_back(i);
    std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return counts[a] > counts[b]; });
    std::string out;
    for (const std::size_t i : order)
        out += (out.empty() ? "most often " : ", ") + std::string(kRejectionNames[i]) + ", " +
               std::to_string(counts[i]) + " times";
    return out;
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
      options_(options), synergy_(prototype.synergy), mechanics_(prototype.mechanics), seed_(seed), random_(0, 0, 0),
      stop_(stop)
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
        const int of = hand_.branch_of(other);
        if (of < 0) {
            ++s.other;
            continue;
        }
        const auto b = static_cast<std::size_t>(of);
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
        row.geom = other;
        const mjtNum *kbip = d->efc_KBIP + 4 * c.efc_address;
        row.give_m_N = d->efc_R[c.efc_address] / (kbip[0] * kbip[2]);
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

std::vector<double> GraspWorker::tensions() const
{
    std::vector<double> out;
    for (const Tendon &t : hand_.tendons) {
        double pull = t.stiffness_N_m > 0 ? t.stiffness_N_m * (data_->ten_length[t.tendon] - t.relaxed_m) : 0.0;
        for (std::size_t i = 0; i < t.actuators.size(); ++i)
            pull -= t.gears[i] * data_->actuator_force[t.actuators[i]]; // slack is +0
        out.push_back(pull);
    }
    return out;
}

int GraspWorker::tool_contacts() const
{
    int n = 0;
    for (int i = 0; i < data_->ncon; ++i)
        n += hand_.is_tool(*model_, data_->contact[i].geom1) || hand_.is_tool(*model_, data_->contact[i].geom2);
    return n;
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
    state_.psi = synergy_.low;
    for (Eigen::Index k = 0; k < state_.psi.size(); ++k)
        state_.psi[k] += (synergy_.high[k] - synergy_.low[k]) * u[static_cast<std::size_t>(k)];
    const Placement placement{u[3], u[4], Vec3(u[5], u[6], u[7])};
    const double force_ratio = options_.pinch_force_max_N / options_.pinch_force_min_N;
    state_.pinch_force_N = options_.pinch_force_min_N * std::pow(force_ratio, u[8]);
    first_side_force_N_ = uneven_shares(hand_.first_side.size(), u[9]);
    for (double &force : first_side_force_N_)
        force *= state_.pinch_force_N;
    preshape_ = synergy_.posture(state_.psi);
    const auto family = static_cast<ToolFamily>(families[random_.index(static_cast<int>(families.size()))]);
    // wrist: the direction of gravity in H is uniform on the sphere
    const double rx = random_.uniform(-M_PI, M_PI), ry = std::asin(random_.uniform(-1, 1)), rz = 0;
    state_.base_pose << 0, 0, 0, rx, ry, rz;

    const auto pose_hand = [&] {
        for (std::size_t i = 0; i < kBaseJoints; ++i)
            d->qpos[hand_.base_qpos[i]] = d->ctrl[hand_.base_actuator[i]] =
                state_.base_pose[static_cast<Eigen::Index>(i)];
        for (const Branch &branch : hand_.branches) {
            for (std::size_t c = 0; c < branch.qpos.size(); ++c)
                d->qpos[branch.qpos[c]] = preshape_[branch.first_joint + static_cast<Eigen::Index>(c)];
            for (const Drive &drive : branch.drives)
                if (drive.held_joint >= 0)
                    command(drive, 0, drive.gear * preshape_[branch.first_joint + drive.held_joint]);
        }
        guarded([&] { mj_kinematics(m, d); });
    };
    pose_hand();
    if (!draw_tool(random_, options_, family, placement, hand_.pinch(*m, *d), state_.tool, placed_))
        return reject(Rejection::no_fit);

    install_tool(*m, *d, hand_, state_.tool);
    if (varied_)
        mechanics_.rule_contacts(*m, hand_);
    pose_hand();
    const Pose H = hand_.palm(*d);
    const Vec3 p = H.p + H.R * placed_.p;
    const Eigen::Quaterniond r(Mat3(H.R * placed_.R));
    const double qpos[7] = {p.x(), p.y(), p.z(), r.w(), r.x(), r.y(), r.z()};
    mju_copy(d->qpos + hand_.tool_qpos, qpos, 7);
    warnings_before_ = count_warnings(*d);
    refresh();
    return tool_contacts() == 0 || reject(Rejection::overlap);
}

// The command with which a drive of this length gives `force` (N).
void GraspWorker::command(const Drive &drive, double force, double length)
{
    data_->ctrl[drive.actuator] = drive.stiffness / drive.gain * length + (force - drive.offset) / drive.gain;
}

// Sets the drives' commands so that they balance what the hand's own springs do and, by `share`, press the fingertips
// on the tool: those of the first side towards the middle of the second, those of the second against the sum of these.
void GraspWorker::press(double share)
{
    const auto tip_of = [&](int b) { return hand_.tip_in_palm(*data_, b); };
    Vec3 opposite = tip_of(hand_.second_side[0]);
    for (std::size_t i = 1; i < hand_.second_side.size(); ++i)
        opposite += tip_of(hand_.second_side[i]);
    const double part = 1.0 / static_cast<double>(hand_.second_side.size());
    opposite *= part;
    Vec3 rest = Vec3::Zero();
    for (std::size_t i = 0; i < hand_.first_side.size(); ++i) {
        const int b = hand_.first_side[i];
        const Vec3 tip = tip_of(b), force = first_side_force_N_[i] * share * (opposite - tip).normalized();
        rest -= force;
        press_branch(b, tip, force);
    }
    for (const int b : hand_.second_side)
        press_branch(b, tip_of(b), part * rest);
}

void GraspWorker::press_branch(int b, const Vec3 &tip, const Vec3 &force)
{
    mjData *d = data_.get();
    const int nv = model_->nv;
    const Branch &branch = hand_.branches[static_cast<std::size_t>(b)];
    const Jacobian B = hand_.branch_jacobian(*d, b, tip);
    Vector torque(branch.coordinates());
    for (int c = 0; c < branch.coordinates(); ++c) {
        const int address = branch.qpos[static_cast<std::size_t>(c)];
        torque[c] = B.col(c).dot(force);
        torque[c] += branch.spring_Nm_rad[c] * (d->qpos[address] - branch.spring_reference_rad[c]);
    }
    const auto row = [&](const mjtNum *dense, int i) {
        Vector out(branch.coordinates());
        for (int c = 0; c < branch.coordinates(); ++c)
            out[c] = dense[i * nv + branch.dof[static_cast<std::size_t>(c)]];
        return out;
    };
    for (const int t : branch.springs)
        torque += model_->tendon_stiffness[t] * (d->ten_length[t] - model_->tendon_lengthspring[t]) * row(d->ten_J, t);

    std::vector<double> forces(branch.drives.size());
    if (!branch.by_coordinate.empty()) { // from the tip inwards, each drive takes what those before leave
        for (int c = branch.coordinates() - 1; c >= 0; --c) {
            const int i = branch.by_coordinate[static_cast<std::size_t>(c)];
            if (i < 0)
                continue;
            const Drive &drive = branch.drives[static_cast<std::size_t>(i)];
            const Vector moment = row(d->actuator_moment, drive.actuator);
            const double wanted = torque[c] / moment[c];
            forces[static_cast<std::size_t>(i)] = drive.high_N <= 0 ? std::min(0.0, wanted) : wanted;
            torque -= forces[static_cast<std::size_t>(i)] * moment;
        }
    } else {
        std::vector<Generator> generators;
        for (std::size_t i = 0; i < branch.drives.size(); ++i) {
            const Drive &drive = branch.drives[i];
            if (drive.held_joint < 0)
                generators.push_back({row(d->actuator_moment, drive.actuator), drive.low_N, drive.high_N, &forces[i]});
        }
        std::vector<double> held(branch.couplings.size()); // they give what they must
        for (std::size_t i = 0; i < held.size(); ++i)
            generators.push_back({branch.couplings[i], -kEndless, kEndless, &held[i]});
        for (int c = 0; c < branch.coordinates(); ++c)
            if (!branch.pressed[static_cast<std::size_t>(c)]) {
                torque[c] = 0;
                for (Generator &g : generators)
                    g.moment[c] = 0;
            }
        least_squares(generators, torque);
    }
    const Vector posture = posture_held(branch, B, force);
    for (std::size_t i = 0; i < branch.drives.size(); ++i) {
        const Drive &drive = branch.drives[i];
        if (drive.held_joint >= 0)
            continue;
        const int joint = model_->actuator_trnid[2 * drive.actuator];
        const auto found = std::find(branch.joint.begin(), branch.joint.end(), joint);
        const bool by_posture = posture.size() > 0 && !drive.is_tendon && found != branch.joint.end();
        const double length =
            by_posture ? drive.gear * posture[found - branch.joint.begin()] : d->actuator_length[drive.actuator];
        command(drive, forces[i], length);
    }
}

// Where the servos of a branch hold it while it presses: in the shape that it was given, moved along with the tip in the
// direction of the force alone, in which they must not hold it back. Empty where something else than servos drives it.
Vector GraspWorker::posture_held(const Branch &branch, const Jacobian &B, const Vec3 &force) const
{
    Vector stiffness = Vector::Zero(branch.coordinates());
    for (const Drive &drive : branch.drives)
        for (int c = 0; c < branch.coordinates() && !drive.is_tendon; ++c)
            if (model_->actuator_trnid[2 * drive.actuator] == branch.joint[static_cast<std::size_t>(c)])
                stiffness[c] += drive.stiffness * drive.gear * drive.gear;
    if (stiffness.size() == 0 || stiffness.minCoeff() <= 0)
        return Vector();
    const Vector shape = preshape_.segment(branch.first_joint, branch.coordinates());
    if (force.isZero(0))
        return shape;
    Vector moved(branch.coordinates());
    for (int c = 0; c < branch.coordinates(); ++c)
        moved[c] = data_->qpos[branch.qpos[static_cast<std::size_t>(c)]] - shape[c];
    const Vector along = B.transpose() * force.normalized(), give = along.cwiseQuotient(stiffness);
    return shape + give * (along.dot(moved) / along.dot(give));
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
        press(std::min(1.0, static_cast<double>(i) / ramp));
        hold_tool(1);
        step();
    }
}

// From here on the commands stand still: each drive is a spring, a cable one that can only pull.
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
            if (diverged() || tool_contacts() == 0)
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

bool GraspWorker::at_joint_limit(const ContactState &touching) const
{
    for (std::size_t b = 0; b < hand_.branches.size(); ++b) {
        const Branch &branch = hand_.branches[b];
        for (int c = 0; c < branch.coordinates() && touching.branch[b].in_contact; ++c) {
            const double q = data_->qpos[branch.qpos[static_cast<std::size_t>(c)]];
            if (q < branch.low_rad[c] + kBoundMargin || q > branch.high_rad[c] - kBoundMargin)
                return true;
        }
    }
    return false;
}

// Whether the settled state is a grasp by enough fingertips, of every group at least one.
bool GraspWorker::holds()
{
    refresh();
    const ContactState c = contacts();
    if (c.other > 0)
        return reject(Rejection::other_contact);
    int missing = hand_.count() - hand_.least_holding(); // that may be
    std::vector<bool> touched(static_cast<std::size_t>(hand_.groups));
    for (std::size_t b = 0; b < hand_.branches.size(); ++b) {
        if (c.count[b] == 0 && --missing < 0)
            return reject(Rejection::no_contact);
        if (c.count[b] == 0)
            continue;
        touched[static_cast<std::size_t>(hand_.branches[b].group)] = true;
        if (c.count[b] > 1)
            return reject(Rejection::other_contact);
        if (c.branch[b].normal_force < options_.contact_force_min_N)
            return reject(Rejection::weak_contact);
    }
    if (std::find(touched.begin(), touched.end(), false) != touched.end())
        return reject(Rejection::no_contact);
    if (at_joint_limit(c))
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
        return reject(diverged() || tool_contacts() == 0 ? Rejection::fell : Rejection::not_settled);
    return holds();
}

const GraspState &GraspWorker::make(std::uint64_t shard, std::uint64_t index, std::int64_t grasp_id,
                                    const std::vector<int> &families, const Vector &theta)
{
    varied_ = theta.size() > 0;
    if (varied_) {
        mechanics_.write(*model_, theta);
        hand_.read_stiffness(*model_);
    }
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
    throw std::runtime_error(
        "grasp " + std::to_string(grasp_id) + ": none of " + std::to_string(options_.grasp_attempts) +
        " attempts held the tool (" + in_words(state_.rejections) +
        "); widen the tool, synergy and force ranges or raise grasp_attempts; no_fit: [closing] of the "
        "hand file has to open wide enough for the tools");
}

void GraspWorker::save()
{
    const mjData &d = *data_;
    const mjModel &m = *model_;
    saved_.time = d.time;
    saved_.qpos.assign(d.qpos, d.qpos + m.nq);
    saved_.qvel.assign(d.qvel, d.qvel + m.nv);
    saved_.act.assign(d.act, d.act + m.na);
    saved_.warmstart.assign(d.qacc_warmstart, d.qacc_warmstart + m.nv);
    saved_.ctrl.assign(d.ctrl, d.ctrl + m.nu);
}

std::shared_ptr<const Settled> GraspWorker::settled() const
{
    return std::make_shared<const Settled>(Settled{copy_model(*model_), hand_, state_, saved_});
}

void GraspWorker::adopt(const Settled &settled)
{
    copy_model(*settled.model, *model_);
    hand_ = settled.hand;
    state_ = settled.state;
    saved_ = settled.saved;
}

void GraspWorker::restore()
{
    const mjModel *m = model_.get();
    mjData *d = data_.get();
    guarded([&] { mj_resetData(m, d); });
    d->time = saved_.time;
    std::copy(saved_.qpos.begin(), saved_.qpos.end(), d->qpos);
    std::copy(saved_.qvel.begin(), saved_.qvel.end(), d->qvel);
    std::copy(saved_.act.begin(), saved_.act.end(), d->act);
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
    for (int i = 0; i < hand_.count(); ++i) {
        const auto b = static_cast<std::size_t>(i);
        state_.j_x[b].setZero();
        state_.j_q[b].setZero(3, hand_.coordinates);
        const ContactState::Row &row = state_.contacts.branch[b];
        if (!row.in_contact)
            continue;
        state_.j_x[b] << Mat3::Identity(), -skew(row.position - state_.tool_in_palm.p);
        state_.j_q[b].rightCols(hand_.branches[b].coordinates()) = hand_.branch_jacobian(*data_, i, row.position);
        state_.j_q[b] *= -1;
    }
}

} // namespace aminn::sim
