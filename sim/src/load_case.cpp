// The label protocol: ramp the load, hold it, settle; what is watched on the way, and what the label is made of.
#include "grasp.hpp"

#include <algorithm>

namespace aminn::sim {

const std::array<const char *, kReasons> kReasonNames = {"stable",   "contact_lost", "tool_left", "translation",
                                                         "rotation", "not_settled",  "diverged"};

namespace {

// Least size of a load that a residual is taken relative to; moments count by the rotation arm.
constexpr double kLeastLoad_N = 1e-3;

// Scaled change of cost in the solver's last iteration: the friction iterations (noslip) come after Newton's.
double solver_residual(const mjData &d)
{
    const int last = std::min(d.solver_iter, static_cast<int>(mjNSOLVER)) - 1;
    return last >= 0 ? std::abs(d.solver[last].improvement) : 0;
}

double load_size(const Wrench &w)
{
    return std::hypot(w.head<3>().norm(), w.tail<3>().norm() / kRotationArm);
}

// Watches one load case step by step.
struct Watch {
    const Options &options;
    const Pose before;
    const double dt;
    CaseResult &result;
    std::array<int, kMostBranches> open_steps{};

    // Takes in the present state at `time`; returns true when the case is clearly lost.
    bool look(double time, const ContactState &c, const ContactState &had, const Pose &now)
    {
        result.worst_penetration_m = std::max(result.worst_penetration_m, c.worst_penetration);
        result.other_contact |= c.other > 0;
        watch_contacts(time, c, had);
        const bool touched = std::any_of(c.count.begin(), c.count.end(), [](int n) { return n > 0; });
        const Wrench moved = displacement(before, now);
        const double translation = moved.head<3>().norm(), rotation = moved.tail<3>().norm();
        result.max_translation_m = std::max(result.max_translation_m, translation);
        result.max_rotation_rad = std::max(result.max_rotation_rad, rotation);
        result.tool_left |= translation > options.tool_left_m || (result.contact_lost && !touched);
        return result.contact_lost || result.tool_left ||
               translation > options.stop_factor * options.translation_max_m ||
               rotation > options.stop_factor * options.rotation_max_rad;
    }

    void watch_contacts(double time, const ContactState &c, const ContactState &had)
    {
        const int limit = steps_of(options.lost_contact_s, dt);
        for (std::size_t b = 0; b < kMostBranches; ++b) {
            open_steps[b] = had.branch[b].in_contact && !c.branch[b].in_contact ? open_steps[b] + 1 : 0;
            if (open_steps[b] <= limit || result.lost_time_s[b] >= 0)
                continue;
            result.contact_lost = true;
            result.lost_time_s[b] = time - (open_steps[b] - 1) * dt; // when it opened
        }
    }
};

Reason judge(const CaseResult &r, const Options &o)
{
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

} // namespace

double smooth_ramp(double x)
{
    return x >= 1 ? 1 : x * x * (3 - 2 * x);
}

Load GraspWorker::draw_load()
{
    const Options &o = options_;
    const double kind = random_.uniform();
    const double force = random_.log_uniform(o.force_min_N, o.force_max_N);
    const double moment = random_.log_uniform(o.moment_min_Nm, o.moment_max_Nm);
    const Vec3 f = force * random_.direction(), n = moment * random_.direction();
    const double along = random_.uniform(), angle = random_.uniform(0, 2 * M_PI);
    Load load;
    load.point = state_.tool_in_palm.p;
    if (kind < o.share_moment) {
        load.w_e.tail<3>() = n;
        return load;
    }
    load.w_e.head<3>() = f;
    if (kind < o.share_moment + o.share_force)
        return load;
    if (kind < o.share_moment + o.share_force + o.share_point_force) { // at a point of the surface
        Vec3 arm = state_.tool_in_palm.R * state_.tool.surface_point(along, angle);
        const double size = arm.cross(f).norm();
        if (size > o.moment_max_Nm)
            arm *= o.moment_max_Nm / size; // nearer to the origin, so that the moment stays in its range
        load.point += arm;
        load.w_e.tail<3>() = arm.cross(f);
        return load;
    }
    load.w_e.tail<3>() = n;
    return load;
}

bool GraspWorker::draw_recheck()
{
    return random_.uniform() < options_.noise_share;
}

// What is left of the wrenches on the tool (contacts, weight, load), relative to the load.
double GraspWorker::equilibrium_residual(const Wrench &w)
{
    const mjModel *m = model_.get();
    mjData *d = data_.get();
    const Pose T = Hand::body_pose(*d, hand_.tool_body);
    const Mat3 to_hand = hand_.palm(*d).R.transpose();
    const mjtNum *g = m->opt.gravity;
    Vec3 force = state_.tool.mass_kg * Vec3(g[0], g[1], g[2]), moment = Vec3::Zero();
    for (int i = 0; i < d->ncon; ++i) {
        const mjContact &c = d->contact[i];
        const bool is_1 = hand_.is_tool(*m, c.geom1), is_2 = hand_.is_tool(*m, c.geom2);
        if (c.efc_address < 0 || is_1 == is_2)
            continue;
        mjtNum local[6];
        mj_contactForce(m, d, i, local);
        const Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>> frame(c.frame);
        const double sign = is_2 ? 1 : -1; // the force acts on geom 2, its opposite on geom 1
        const Vec3 f = sign * (frame.transpose() * Vec3(local[0], local[1], local[2]));
        force += f;
        moment += (Vec3(c.pos[0], c.pos[1], c.pos[2]) - T.p).cross(f);
        moment += sign * (frame.transpose() * Vec3(local[3], local[4], local[5]));
    }
    Wrench rest = w;
    rest.head<3>() += to_hand * force;
    rest.tail<3>() += to_hand * moment;
    return load_size(rest) / std::max(load_size(w), kLeastLoad_N);
}

CaseResult GraspWorker::load(const Load &load, bool recheck)
{
    CaseResult result = run_case(load);
    if (recheck) {
        const double dt = model_->opt.timestep, impratio = model_->opt.impratio;
        result.rechecked = true;
        result.half_step = again(load, 0.5 * dt, impratio);
        result.impratio = again(load, dt, 10 * impratio);
    }
    return result;
}

Recheck GraspWorker::again(const Load &load, double timestep, double impratio)
{
    mjOption &option = model_->opt;
    const double dt_before = option.timestep, impratio_before = option.impratio;
    option.timestep = timestep;
    option.impratio = impratio;
    const auto restore_options = [&] { option.timestep = dt_before, option.impratio = impratio_before; };
    CaseResult result;
    try {
        result = run_case(load);
    } catch (...) {
        restore_options();
        throw;
    }
    restore_options();
    return {result.dx, result.reason == Reason::stable};
}

CaseResult GraspWorker::run_case(const Load &load)
{
    restore();
    CaseResult result;
    result.load = load;
    const Options &o = options_;
    const Pose before = state_.tool_in_palm;
    const double dt = model_->opt.timestep;
    Watch watch{o, before, dt, result};
    const int ramp = steps_of(o.ramp_s, dt), window = steps_of(o.drift_window_s, dt);
    const int least = ramp + steps_of(o.hold_s, dt), most = ramp + steps_of(o.hold_max_s, dt);
    Pose window_start = before;
    bool lost = false;
    int n = 0; // steps done
    while (n < most && !lost) {
        if (n == ramp)
            window_start = hand_.tool_in_palm(*data_);
        apply(load.w_e, smooth_ramp(static_cast<double>(n + 1) / ramp));
        step();
        ++n;
        if (diverged())
            break;
        const Pose now = hand_.tool_in_palm(*data_);
        lost = watch.look(n * dt, contacts(false), state_.contacts, now);
        if (n <= ramp || (n - ramp) % window != 0)
            continue;
        const Wrench moved = displacement(window_start, now);
        result.creep_rate_m_s = moved.head<3>().norm() / o.drift_window_s;
        result.drift_m_s = mean_rate(window_start, now, o.drift_window_s);
        result.settled = result.drift_m_s <= o.drift_max_m_s;
        if (!result.settled)
            result.settle_time_s = -1;
        else if (result.settle_time_s < 0)
            result.settle_time_s = (n - ramp) * dt;
        window_start = now;
        if (n >= least && result.drift_m_s <= o.drift_stop_m_s)
            break;
    }
    if (diverged()) { // the engine has reset the state: there is no pose to report
        restore();
        result.dx.setZero();
        result.q_after = state_.q;
        result.settled = false;
        result.reason = Reason::diverged;
        return result;
    }
    result.solver_residual = solver_residual(*data_);
    refresh();
    result.equilibrium_residual = equilibrium_residual(load.w_e);
    result.hold_time_s = std::max(0, n - ramp) * dt;
    result.dx = displacement(before, hand_.tool_in_palm(*data_));
    result.max_translation_m = std::max(result.max_translation_m, result.dx.head<3>().norm());
    result.max_rotation_rad = std::max(result.max_rotation_rad, result.dx.tail<3>().norm());
    result.q_after = hand_.joints(*data_);
    result.tension_after_N = tensions();
    result.reason = judge(result, o);
    return result;
}

} // namespace aminn::sim
