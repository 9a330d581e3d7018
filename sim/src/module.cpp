// Python module aminn_sim._core: the simulation with numpy arrays at its edges. It holds no policy: files, progress and
// configuration are Python's.
#include "shard.hpp"

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/function.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <atomic>
#include <cstring>
#include <memory>
#include <mutex>
#include <thread>

namespace nb = nanobind;
using namespace nb::literals;

namespace aminn::sim {
namespace {

using Shape = std::vector<std::size_t>;
template <class T>
using Array = nb::ndarray<nb::numpy, T>;
using InVector = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

// A zeroed array that numpy owns.
template <class T>
Array<T> make_array(const Shape &shape)
{
    std::size_t n = 1;
    for (const std::size_t s : shape)
        n *= s;
    T *data = new T[n > 0 ? n : 1]();
    const nb::capsule owner(data, [](void *p) noexcept { delete[] static_cast<T *>(p); });
    return Array<T>(data, shape.size(), shape.data(), owner);
}

// Adds to `out` an array with one row for each item: write(item, pointer to the row).
template <class T, class Items, class Write>
void column(nb::dict &out, const char *name, const Items &items, const Shape &row, Write &&write)
{
    Shape shape{items.size()};
    shape.insert(shape.end(), row.begin(), row.end());
    std::size_t width = 1;
    for (const std::size_t s : row)
        width *= s;
    Array<T> array = make_array<T>(shape);
    T *p = array.data();
    for (const auto &item : items) {
        write(item, p);
        p += width;
    }
    out[name] = array.cast();
}

template <class Derived>
void put(const Eigen::MatrixBase<Derived> &x, double *p)
{
    for (Eigen::Index i = 0; i < x.rows(); ++i)
        for (Eigen::Index j = 0; j < x.cols(); ++j)
            *p++ = x(i, j); // row-major
}
template <std::size_t N>
void put(const std::array<double, N> &x, double *p)
{
    std::copy(x.begin(), x.end(), p);
}

Wrench pose_vector(const Pose &pose)
{
    Wrench x;
    x << pose.p, rotation_vector(pose.R);
    return x;
}

void put_contacts(const ContactState &c, double *p)
{
    for (int b = 0; b < kBranches; ++b, p += AMINN_N_CONTACT_FEATURE) {
        const ContactState::Row &row = c.branch[b];
        if (!row.in_contact)
            continue;
        p[0] = 1;
        put(row.position, p + 1);
        put(row.normal, p + 4);
        p[7] = row.normal_force;
    }
}

constexpr int kXCols = AMINN_N_WRENCH;

template <class Items, class State>
void state_columns(nb::dict &out, const Items &items, State &&state)
{
    column<double>(out, "q", items, {kJoints}, [&](const auto &i, double *p) { put(state(i).q, p); });
    column<double>(out, "x_ht", items, {kXCols},
                   [&](const auto &i, double *p) { put(pose_vector(state(i).tool_in_palm), p); });
    column<double>(out, "contacts", items, {kBranches, AMINN_N_CONTACT_FEATURE},
                   [&](const auto &i, double *p) { put_contacts(state(i).contacts, p); });
    column<double>(out, "j_x", items, {kBranches, 3, kXCols}, [&](const auto &i, double *p) {
        for (int b = 0; b < kBranches; ++b)
            put(state(i).j_x[b], p + b * 3 * kXCols);
    });
    column<double>(out, "j_q", items, {kBranches, 3, kCoords}, [&](const auto &i, double *p) {
        for (int b = 0; b < kBranches; ++b)
            put(state(i).j_q[b], p + b * 3 * kCoords);
    });
    column<std::int64_t>(out, "grasp_id", items, {}, [&](const auto &i, std::int64_t *p) { *p = state(i).grasp_id; });
}

template <class Items, class Case>
void case_columns(nb::dict &out, const Items &items, Case &&get)
{
    const auto number = [&](const char *name, double CaseResult::*member) {
        column<double>(out, name, items, {}, [&](const auto &i, double *p) { *p = get(i).*member; });
    };
    const auto flag = [&](const char *name, bool CaseResult::*member) {
        column<std::uint8_t>(out, name, items, {}, [&](const auto &i, std::uint8_t *p) { *p = get(i).*member; });
    };
    column<double>(out, "w_e", items, {kXCols}, [&](const auto &i, double *p) { put(get(i).w_e, p); });
    column<double>(out, "dx_ht", items, {kXCols}, [&](const auto &i, double *p) { put(get(i).dx, p); });
    column<double>(out, "dx_ht_early", items, {kXCols}, [&](const auto &i, double *p) { put(get(i).dx_early, p); });
    column<double>(out, "q_after", items, {kJoints}, [&](const auto &i, double *p) { put(get(i).q_after, p); });
    column<double>(out, "tendon_tension_after_N", items, {kTendons},
                   [&](const auto &i, double *p) { put(get(i).tension_after_N, p); });
    number("creep_rate_m_s", &CaseResult::creep_rate_m_s);
    number("drift_m_s", &CaseResult::drift_m_s);
    number("max_translation_m", &CaseResult::max_translation_m);
    number("max_rotation_rad", &CaseResult::max_rotation_rad);
    number("worst_penetration_m", &CaseResult::worst_penetration_m);
    number("solver_residual", &CaseResult::solver_residual);
    number("hold_time_s", &CaseResult::hold_time_s);
    flag("settled", &CaseResult::settled);
    flag("contact_lost", &CaseResult::contact_lost);
    flag("tool_left", &CaseResult::tool_left);
    flag("other_contact", &CaseResult::other_contact);
    column<std::uint8_t>(out, "stable", items, {},
                         [&](const auto &i, std::uint8_t *p) { *p = get(i).reason == Reason::stable; });
    column<std::int8_t>(out, "reason", items, {},
                        [&](const auto &i, std::int8_t *p) { *p = static_cast<std::int8_t>(get(i).reason); });
}

template <class Items>
void grasp_columns(nb::dict &out, const Items &grasps)
{
    column<std::int64_t>(out, "grasp_id", grasps, {}, [](const GraspState &g, std::int64_t *p) { *p = g.grasp_id; });
    column<double>(out, "psi", grasps, {3}, [](const GraspState &g, double *p) { put(g.psi, p); });
    column<std::int8_t>(out, "tool_family", grasps, {},
                        [](const GraspState &g, std::int8_t *p) { *p = static_cast<std::int8_t>(g.tool.family); });
    column<double>(out, "tool_size_m", grasps, {3}, [](const GraspState &g, double *p) { put(g.tool.half_m, p); });
    const auto number = [&](const char *name, auto get) {
        column<double>(out, name, grasps, {}, [&](const GraspState &g, double *p) { *p = get(g); });
    };
    number("tool_mass_kg", [](const GraspState &g) { return g.tool.mass_kg; });
    number("friction", [](const GraspState &g) { return g.tool.friction; });
    number("pinch_force_N", [](const GraspState &g) { return g.pinch_force_N; });
    number("drift_m_s", [](const GraspState &g) { return g.drift_m_s; });
    number("worst_penetration_m", [](const GraspState &g) { return g.contacts.worst_penetration; });
    column<double>(out, "tendon_tension_N", grasps, {kTendons},
                   [](const GraspState &g, double *p) { put(g.tension_N, p); });
    column<double>(out, "base_pose", grasps, {kBaseJoints},
                   [](const GraspState &g, double *p) { put(g.base_pose, p); });
    column<double>(out, "gravity_m_s2", grasps, {3}, [](const GraspState &g, double *p) { put(g.gravity_m_s2, p); });
    column<std::int32_t>(out, "attempts", grasps, {}, [](const GraspState &g, std::int32_t *p) { *p = g.attempts; });
}

nb::dict shard_arrays(const ShardResult &r)
{
    using Sample = std::pair<const GraspState *, const CaseResult *>;
    std::vector<Sample> samples;
    for (std::size_t g = 0; g < r.grasps.size(); ++g)
        for (const CaseResult &c : r.cases[g])
            samples.emplace_back(&r.grasps[g], &c);
    nb::dict arrays, grasps, out;
    state_columns(arrays, samples, [](const Sample &s) -> const GraspState & { return *s.first; });
    case_columns(arrays, samples, [](const Sample &s) -> const CaseResult & { return *s.second; });
    grasp_columns(grasps, r.grasps);
    state_columns(grasps, r.grasps, [](const GraspState &g) -> const GraspState & { return g; });
    out["samples"] = arrays;
    out["grasps"] = grasps;
    out["rejections"] = nb::cast(r.rejections);
    return out;
}

nb::list vector_list(const Eigen::Ref<const Eigen::VectorXd> &x)
{
    nb::list l;
    for (Eigen::Index i = 0; i < x.size(); ++i)
        l.append(x[i]);
    return l;
}

// The manifest's `hand` entry.
nb::dict hand_dict(const mjModel &m, const Hand &hand)
{
    nb::dict out;
    nb::list branches, joints, branch_joints, base, axis, a, b, radius, stiffness, spring, reference, tendons;
    for (const char *name : kBranchNames)
        branches.append(name);
    for (const char *name : kJointNames)
        joints.append(name);
    for (int i = 0; i < kBranches; ++i) {
        const Branch &branch = hand.branches[i];
        nb::list indices, axes;
        for (int c = 0; c < kCoords; ++c) {
            indices.append(kBranchJoints[i][c]);
            axes.append(vector_list(branch.axis[c]));
        }
        branch_joints.append(indices);
        axis.append(axes);
        base.append(vector_list(branch.base_m));
        a.append(vector_list(branch.link_a_m));
        b.append(vector_list(branch.link_b_m));
        radius.append(branch.tip_radius_m);
        stiffness.append(vector_list(branch.stiffness_Nm_rad));
        spring.append(vector_list(branch.spring_Nm_rad));
        reference.append(vector_list(branch.spring_reference_rad));
    }
    for (const Tendon &t : hand.tendons) {
        nb::dict d;
        d["branch"] = t.branch;
        d["moment_arm_m"] = vector_list(t.arm_m);
        d["stiffness_N_m"] = t.stiffness_N_m;
        d["max_tension_N"] = t.max_tension_N;
        d["name"] = mj_id2name(&m, mjOBJ_TENDON, t.tendon);
        tendons.append(d);
    }
    out["name"] = "three_finger_hand";
    out["branches"] = branches;
    out["joints"] = joints;
    out["branch_joints"] = branch_joints;
    out["base_m"] = base;
    out["axis"] = axis;
    out["link_a_m"] = a;
    out["link_b_m"] = b;
    out["tip_radius_m"] = radius;
    out["joint_stiffness_Nm_rad"] = stiffness;
    out["joint_spring_Nm_rad"] = spring;
    out["joint_spring_reference_rad"] = reference;
    out["tendons"] = tendons;
    return out;
}

template <int N>
Eigen::Matrix<double, N, 1> in_vector(const InVector &x, const char *name)
{
    if (x.shape(0) != N)
        throw std::invalid_argument(std::string(name) + " has " + std::to_string(x.shape(0)) + " entries, expected " +
                                    std::to_string(N));
    Eigen::Matrix<double, N, 1> v = Eigen::Map<const Eigen::Matrix<double, N, 1>>(x.data());
    if (!v.allFinite())
        throw std::invalid_argument(std::string(name) + " is not finite");
    return v;
}

Array<double> out_array(const Eigen::Ref<const Eigen::MatrixXd> &x)
{
    Array<double> a =
        x.cols() == 1 ? make_array<double>({static_cast<std::size_t>(x.rows())})
                      : make_array<double>({static_cast<std::size_t>(x.rows()), static_cast<std::size_t>(x.cols())});
    put(x, a.data());
    return a;
}

void check_families(const std::vector<int> &families)
{
    if (families.empty())
        throw std::invalid_argument("families is empty");
    for (const int f : families)
        if (f < 0 || f >= kToolFamilies)
            throw std::invalid_argument("no tool family " + std::to_string(f));
}

// A compiled model to simulate shards of.
class Simulator {
  public:
    explicit Simulator(const std::string &path) : model_(load_model(path)), hand_(*model_)
    {
    }

    nb::dict shard(const Options &options, std::uint64_t seed, std::uint64_t shard, std::int64_t first_grasp_id,
                   int grasps, int cases, int threads, const std::vector<int> &families, nb::object progress) const
    {
        if (grasps < 1 || cases < 1 || threads < 1)
            throw std::invalid_argument("grasps, cases and threads must be at least 1");
        check_families(families);
        const ShardRequest request{seed, shard, first_grasp_id, grasps, cases, threads, families};
        const auto poll = [&](int done) {
            const nb::gil_scoped_acquire gil;
            if (PyErr_CheckSignals() != 0)
                throw nb::python_error();
            if (!progress.is_none())
                progress(done);
        };
        ShardResult result;
        {
            const nb::gil_scoped_release free;
            result = simulate_shard(*model_, hand_, options, request, poll);
        }
        return shard_arrays(result);
    }

    nb::dict hand() const
    {
        return hand_dict(*model_, hand_);
    }
    const mjModel &model() const
    {
        return *model_;
    }
    const Hand &geometry() const
    {
        return hand_;
    }

  private:
    ModelPtr model_;
    Hand hand_;
};

// One grasp in the hands of Python: for tests, fidelity and pictures.
class Session {
  public:
    Session(const Simulator &simulator, const Options &options, std::uint64_t seed, std::uint64_t shard,
            std::uint64_t index, const std::vector<int> &families)
        : worker_(simulator.model(), simulator.geometry(), options)
    {
        check_families(families);
        const nb::gil_scoped_release free;
        worker_.make(seed, shard, index, static_cast<std::int64_t>(index), families);
    }

    nb::dict grasp() const
    {
        const std::vector<GraspState> one{worker_.state()};
        nb::dict out;
        grasp_columns(out, one);
        state_columns(out, one, [](const GraspState &g) -> const GraspState & { return g; });
        return out;
    }
    nb::dict load(const InVector &w_e)
    {
        const Wrench w = in_vector<AMINN_N_WRENCH>(w_e, "w_e");
        std::vector<CaseResult> one;
        {
            const nb::gil_scoped_release free;
            one.push_back(worker_.load(w));
        }
        nb::dict out;
        case_columns(out, one, [](const CaseResult &c) -> const CaseResult & { return c; });
        return out;
    }
    Array<double> draw_wrench()
    {
        return out_array(worker_.draw_wrench());
    }

    // Where the fingertip's material point that now touches the tool goes when the joints turn by dq (8), m, H.
    Array<double> fingertip_point(int b, const InVector &dq)
    {
        const JointVector turn = in_vector<kJoints>(dq, "dq");
        worker_.restore();
        const auto &row = contact(b);
        mjData &d = worker_.data();
        const Hand &hand = worker_.hand();
        const Pose H = hand.palm(d), tip = Hand::body_pose(d, hand.branches[b].tip_body);
        const Vec3 local = tip.R.transpose() * (H.p + H.R * row.position - tip.p);
        for (int j = 0; j < kJoints; ++j)
            d.qpos[hand.qpos[j]] += turn[j];
        guarded([&] { mj_kinematics(&worker_.model(), &d); });
        const Pose moved = Hand::body_pose(d, hand.branches[b].tip_body);
        return out_array(H.R.transpose() * (moved.p + moved.R * local - H.p));
    }
    // Where the tool's material point under contact b goes when the tool moves by dx (6), m, H.
    Array<double> tool_point(int b, const InVector &dx) const
    {
        const Wrench x = in_vector<AMINN_N_WRENCH>(dx, "dx");
        const auto &row = contact(b);
        const Vec3 p = worker_.state().tool_in_palm.p, turn = x.tail<3>();
        const Mat3 R(Eigen::AngleAxisd(turn.norm(), turn.norm() > 0 ? Vec3(turn.normalized()) : Vec3::UnitX()));
        return out_array(p + x.head<3>() + R * (row.position - p));
    }
    // The engine's own Jacobian of contact point b with respect to the 8 joints, 3x8, H.
    Array<double> engine_jacobian(int b)
    {
        worker_.restore();
        const auto &row = contact(b);
        const mjModel &m = worker_.model();
        mjData &d = worker_.data();
        const Hand &hand = worker_.hand();
        const Pose H = hand.palm(d);
        const Vec3 point = H.p + H.R * row.position;
        std::vector<double> jac(3 * static_cast<std::size_t>(m.nv));
        guarded([&] { mj_jac(&m, &d, jac.data(), nullptr, point.data(), hand.branches[b].tip_body); });
        Eigen::Matrix<double, 3, kJoints> out;
        for (int j = 0; j < kJoints; ++j)
            for (int i = 0; i < 3; ++i)
                out(i, j) = jac[static_cast<std::size_t>(i * m.nv + hand.dof[j])];
        return out_array(H.R.transpose() * out);
    }
    // The tool alone in the air: no gravity, hand out of reach, wrench w_e for `seconds`. Gives its velocity (linear at
    // the tool's origin, angular; H) at the end.
    Array<double> free_flight(const InVector &w_e, double seconds)
    {
        const Wrench w = in_vector<AMINN_N_WRENCH>(w_e, "w_e");
        worker_.restore();
        mjData &d = worker_.data();
        const Hand &hand = worker_.hand();
        d.qpos[hand.tool_qpos] += 10;
        mju_zero(d.qvel, worker_.model().nv);
        worker_.refresh();
        const mjtNum *g = worker_.model().opt.gravity, dt = worker_.model().opt.timestep;
        const int n = static_cast<int>(std::lround(seconds / dt));
        for (int i = 0; i < n; ++i) {
            worker_.apply(w, 1);
            for (int k = 0; k < 3; ++k)
                d.xfrc_applied[6 * hand.tool_body + k] -= worker_.state().tool.mass_kg * g[k];
            worker_.step();
        }
        const Pose H = hand.palm(d), T = Hand::body_pose(d, hand.tool_body);
        const mjtNum *v = d.qvel + hand.tool_dof;
        Wrench out;
        out << H.R.transpose() * Vec3(v[0], v[1], v[2]), H.R.transpose() * T.R * Vec3(v[3], v[4], v[5]);
        return out_array(out);
    }
    // Forces (N, negative = tension) that the tendon actuators give when every command is changed by dc (m).
    Array<double> tendon_forces(double dc)
    {
        worker_.restore();
        mjData &d = worker_.data();
        Eigen::Matrix<double, kTendons, 1> f;
        for (int i = 0; i < kTendons; ++i)
            d.ctrl[worker_.hand().tendons[i].actuator] += dc;
        worker_.refresh();
        for (int i = 0; i < kTendons; ++i)
            f[i] = d.actuator_force[worker_.hand().tendons[i].actuator];
        return out_array(f);
    }
    // Makes the engine report an error: a stack request that cannot be met.
    void provoke_engine_error()
    {
        mjData &d = worker_.data();
        guarded([&] { mj_stackAlloc(&d, d.nstack + 1); });
    }

  private:
    const ContactState::Row &contact(int b) const
    {
        if (b < 0 || b >= kBranches)
            throw std::invalid_argument("no branch " + std::to_string(b));
        return worker_.state().contacts.branch[b];
    }
    GraspWorker worker_;
};

} // namespace
} // namespace aminn::sim

NB_MODULE(_core, m)
{
    using namespace aminn::sim;
    m.doc() = "Grasps of a tendon hand in MuJoCo; see aminn_sim.simulate for the way in.";
    install_handlers();
    nb::exception<MujocoError>(m, "MujocoError", PyExc_RuntimeError);

    auto options = nb::class_<Options>(m, "Options", "All numbers of a simulation; fields of SimulationConfig.");
    options.def(nb::init<>());
    nb::list names;
#define AMINN_SIM_BIND(type, name, value)  \
    options.def_rw(#name, &Options::name); \
    names.append(#name);
    AMINN_SIM_OPTIONS(AMINN_SIM_BIND)
#undef AMINN_SIM_BIND
    m.attr("OPTION_NAMES") = nb::tuple(names);

    nb::list families, reasons;
    for (const char *name : kToolFamilyNames)
        families.append(name);
    for (const char *name : kReasonNames)
        reasons.append(name);
    m.attr("TOOL_FAMILIES") = nb::tuple(families);
    m.attr("REASONS") = nb::tuple(reasons);
    m.attr("DIMENSIONS") = nb::make_tuple(kBranches, kCoords, kJoints, AMINN_N_CONTACT_FEATURE, AMINN_N_WRENCH);
    m.attr("MUJOCO_VERSION") = std::string(mj_versionString());

    m.def(
        "psi_of", [](const InVector &q) { return out_array(Synergy().psi(in_vector<kJoints>(q, "q"))); }, "q"_a,
        "Synergy coordinates (size, spread, curl) of joint angles q (8, rad).");
    m.def(
        "posture_of", [](const InVector &psi) { return out_array(Synergy().posture(in_vector<3>(psi, "psi"))); },
        "psi"_a, "Joint angles (8, rad) of synergy coordinates.");

    nb::class_<Simulator>(m, "Simulator", "A compiled hand and tool.")
        .def(nb::init<const std::string &>(), "model_path"_a)
        .def(
            "shard", &Simulator::shard, "options"_a, "seed"_a, "shard"_a, "first_grasp_id"_a, "grasps"_a, "cases"_a,
            "threads"_a, "families"_a, "progress"_a = nb::none(),
            "Simulate a shard: dict of samples, grasps (dicts of arrays) and rejections. Same result for any number of "
            "threads. progress(cases done) is called from this thread; what it raises stops the simulation.")
        .def("hand", &Simulator::hand, "The manifest's entry `hand`, read from the compiled model.");

    nb::class_<Session>(m, "Session", "One grasp, to be loaded and examined.")
        .def(nb::init<const Simulator &, const Options &, std::uint64_t, std::uint64_t, std::uint64_t,
                      const std::vector<int> &>(),
             "simulator"_a, "options"_a, "seed"_a, "shard"_a, "index"_a, "families"_a)
        .def("grasp", &Session::grasp)
        .def("load", &Session::load, "w_e"_a)
        .def("draw_wrench", &Session::draw_wrench)
        .def("fingertip_point", &Session::fingertip_point, "branch"_a, "dq"_a)
        .def("tool_point", &Session::tool_point, "branch"_a, "dx"_a)
        .def("engine_jacobian", &Session::engine_jacobian, "branch"_a)
        .def("free_flight", &Session::free_flight, "w_e"_a, "seconds"_a)
        .def("tendon_forces", &Session::tendon_forces, "command_change_m"_a)
        .def("provoke_engine_error", &Session::provoke_engine_error);
}
