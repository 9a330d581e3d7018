// Python module aminn_sim._core: the simulation with numpy arrays at its edges. It holds no policy: files, progress and
// configuration are Python's.
#include "columns.hpp"
#include "contact_shapes.hpp"
#include "engine.hpp"

#include <nanobind/stl/function.h>

#include <chrono>

using namespace nanobind::literals;

namespace aminn::sim {
namespace {

using InVector = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

// The manifest's `hand` entry.
nb::dict hand_dict(const mjModel &m, const Hand &hand)
{
    nb::dict out;
    nb::list branches, joints, branch_joints, base, axis, a, b, radius, stiffness, spring, reference, low, high,
        tendons;
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
        low.append(vector_list(branch.low_rad));
        high.append(vector_list(branch.high_rad));
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
    out["joint_low_rad"] = low;
    out["joint_high_rad"] = high;
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

// Fingertips that also pass on a moment about the contact's normal, up to `torsional_m` times the normal force.
void soften_fingertips(mjModel &m, const Hand &hand, double torsional_m)
{
    if (torsional_m <= 0)
        return;
    for (const Branch &branch : hand.branches) {
        m.geom_condim[branch.tip_geom] = 4;
        m.geom_friction[3 * branch.tip_geom + 1] = torsional_m;
    }
}

Synergy make_synergy(const InVector &neutral, const std::vector<InVector> &columns, const InVector &delta,
                     const InVector &low, const InVector &high)
{
    if (columns.size() != 3)
        throw std::invalid_argument("columns has " + std::to_string(columns.size()) + " entries, expected 3");
    Synergy s;
    s.neutral = in_vector<kJoints>(neutral, "neutral");
    for (int k = 0; k < 3; ++k)
        s.basis.col(k) = in_vector<kJoints>(columns[static_cast<std::size_t>(k)], "columns");
    s.delta = in_vector<3>(delta, "delta");
    s.low = in_vector<3>(low, "low");
    s.high = in_vector<3>(high, "high");
    return s;
}

double seconds_now()
{
    using Clock = std::chrono::steady_clock;
    return std::chrono::duration<double>(Clock::now().time_since_epoch()).count();
}

// A compiled model to simulate shards of.
class Simulator {
  public:
    // `files` by name, `scene` the one that the engine begins with. Below /dev/null the engine finds no others.
    Simulator(const std::map<std::string, std::string> &files, const std::string &scene, double torsional_friction_m,
              const Synergy &synergy)
        : Simulator(load_files(files, "/dev/null/" + scene), torsional_friction_m, synergy)
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
            result = simulate_shard(prototype_, options, request, poll);
        }
        return shard_arrays(result);
    }

    void check(const Options &options) const
    {
        check_options(options, prototype_.model->opt.timestep);
    }
    nb::dict hand() const
    {
        return hand_dict(*prototype_.model, prototype_.hand);
    }
    const Prototype &prototype() const
    {
        return prototype_;
    }
    // Distance of the fingertips' surfaces across the pinch (m) in the posture of psi.
    double gap(const InVector &psi) const
    {
        const mjModel *m = prototype_.model.get();
        const Hand &hand = prototype_.hand;
        const DataPtr data = make_data(*m);
        mjData *d = data.get();
        const JointVector q = prototype_.synergy.posture(in_vector<3>(psi, "psi"));
        guarded([&] { mj_resetData(m, d); });
        for (int j = 0; j < kJoints; ++j)
            d->qpos[hand.qpos[j]] = q[j];
        guarded([&] { mj_kinematics(m, d); });
        const Vec3 middle = 0.5 * (hand.tip_in_palm(*d, 0) + hand.tip_in_palm(*d, 1));
        return (middle - hand.tip_in_palm(*d, 2)).norm() - hand.branches[0].tip_radius_m -
               hand.branches[2].tip_radius_m;
    }
    Array<double> psi_of(const InVector &q) const
    {
        return out_array(prototype_.synergy.psi(in_vector<kJoints>(q, "q")));
    }
    Array<double> posture_of(const InVector &psi) const
    {
        return out_array(prototype_.synergy.posture(in_vector<3>(psi, "psi")));
    }

  private:
    Simulator(ModelPtr model, double torsional_friction_m, const Synergy &synergy)
        : prototype_{std::move(model), Hand(), synergy}
    {
        prototype_.hand = Hand(*prototype_.model);
        soften_fingertips(*prototype_.model, prototype_.hand, torsional_friction_m);
    }
    Prototype prototype_;
};

// One grasp in the hands of Python: for tests, fidelity and pictures.
class Session {
  public:
    Session(const Simulator &simulator, const Options &options, std::uint64_t seed, std::uint64_t shard,
            std::uint64_t index, std::int64_t grasp_id, const std::vector<int> &families)
        : worker_(simulator.prototype(), options, seed)
    {
        check_families(families);
        const nb::gil_scoped_release free;
        worker_.make(shard, index, grasp_id, families);
    }

    nb::dict grasp() const
    {
        const std::vector<GraspState> one{worker_.state()};
        nb::dict out;
        grasp_columns(out, one);
        state_columns(out, one, [](const GraspState &g) -> const GraspState & { return g; });
        return out;
    }
    nb::dict load(const InVector &w_e, bool recheck)
    {
        const Load load{in_vector<AMINN_N_WRENCH>(w_e, "w_e"), worker_.state().tool_in_palm.p};
        return run(load, recheck);
    }
    // The next load of this grasp in its data set: draws and runs it.
    nb::dict next_case()
    {
        const Load load = worker_.draw_load();
        return run(load, worker_.draw_recheck());
    }
    // Forces of the settled contacts on the tool, one row a branch, N, H.
    Array<double> contact_forces()
    {
        worker_.restore();
        Mat3 rows;
        const ContactState c = worker_.contacts();
        for (int b = 0; b < kBranches; ++b)
            rows.row(b) = c.branch[static_cast<std::size_t>(b)].force.transpose();
        return out_array(rows);
    }
    // The settled state, and the tool as it stands in the model.
    nb::dict scene()
    {
        worker_.restore();
        const mjModel &m = worker_.model();
        const mjData &d = worker_.data();
        const auto copy = [](const mjtNum *x, int n) { return out_array(Eigen::Map<const Eigen::VectorXd>(x, n)); };
        nb::dict out;
        out["qpos"] = copy(d.qpos, m.nq);
        out["qvel"] = copy(d.qvel, m.nv);
        out["ctrl"] = copy(d.ctrl, m.nu);
        nb::list geoms;
        for (const Primitive &g : worker_.state().tool.geoms) {
            if (!g.used)
                continue;
            nb::dict geom;
            const std::array<double, 4> quat = g.quaternion();
            geom["type"] = g.type;
            geom["size"] = vector_list(g.size);
            geom["pos"] = vector_list(Vec3(g.x_m, 0, 0));
            geom["quat"] = vector_list(Eigen::Vector4d(quat.data()));
            geoms.append(geom);
        }
        out["tool_geoms"] = geoms;
        const Tool &tool = worker_.state().tool;
        out["mass_kg"] = tool.mass_kg;
        out["inertia_kgm2"] = vector_list(tool.inertia_kgm2);
        out["friction"] = tool.friction;
        return out;
    }
    // Steps and seconds of the next `cases` loads by the label protocol, and of as many steps of the engine alone: from
    // the same state, under the same ramp of the same loads, so with the same contacts.
    nb::dict speed(int cases)
    {
        double protocol_s = 0, bare_s = 0;
        std::int64_t steps = 0;
        const nb::gil_scoped_release free;
        for (int i = 0; i < cases; ++i) {
            const Load load = worker_.draw_load();
            const std::int64_t before = worker_.steps();
            const double start = seconds_now();
            worker_.load(load, false);
            protocol_s += seconds_now() - start;
            const std::int64_t n = worker_.steps() - before;
            bare_s += bare_steps(load, n);
            steps += n;
        }
        const nb::gil_scoped_acquire gil;
        nb::dict out;
        out["steps"] = steps;
        out["protocol_s"] = protocol_s;
        out["bare_s"] = bare_s;
        return out;
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
    nb::dict run(const Load &load, bool recheck)
    {
        std::vector<CaseResult> one;
        {
            const nb::gil_scoped_release free;
            one.push_back(worker_.load(load, recheck));
        }
        nb::dict out;
        case_columns(out, one, [](const CaseResult &c) -> const CaseResult & { return c; });
        const std::vector<std::pair<const GraspState *, const CaseResult *>> sample{{nullptr, &one[0]}};
        out["noise"] = noise_columns(sample);
        return out;
    }
    // Seconds that n steps of the engine take under `load`, with nothing between them but the ramp.
    double bare_steps(const Load &load, std::int64_t n)
    {
        worker_.restore();
        const mjModel *m = &worker_.model();
        mjData *d = &worker_.data();
        const Mat3 R = worker_.hand().palm(*d).R;
        Wrench world;
        world << R * load.w_e.head<3>(), R * load.w_e.tail<3>();
        const int ramp = steps_of(worker_.options().ramp_s, m->opt.timestep);
        mjtNum *applied = d->xfrc_applied + 6 * worker_.hand().tool_body;
        const double start = seconds_now();
        guarded([&] {
            for (std::int64_t i = 0; i < n; ++i) {
                const double scale = smooth_ramp(static_cast<double>(i + 1) / ramp);
                for (int k = 0; k < AMINN_N_WRENCH; ++k)
                    applied[k] = scale * world[k];
                mj_step(m, d);
            }
        });
        return seconds_now() - start;
    }
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
    namespace nb = nanobind;
    m.doc() = "Grasps of a tendon hand in MuJoCo; see aminn_sim.simulate for the way in.";
    install_handlers();
    nb::exception<MujocoError>(m, "MujocoError", PyExc_RuntimeError);

    bind_engine(m);
    auto options = nb::class_<Options>(m, "Options", "All numbers of a simulation; fields of SimulationConfig.");
    options.def(nb::init<>());
    nb::dict ranges;
#define AMINN_SIM_BIND(type, name, value, least, greatest) \
    options.def_rw(#name, &Options::name);                 \
    ranges[#name] = nb::make_tuple(static_cast<type>(least), static_cast<type>(greatest));
    AMINN_SIM_OPTIONS(AMINN_SIM_BIND)
#undef AMINN_SIM_BIND
    m.attr("OPTION_RANGES") = ranges;

    nb::list families, reasons;
    for (const char *name : kToolFamilyNames)
        families.append(name);
    for (const char *name : kReasonNames)
        reasons.append(name);
    m.attr("TOOL_FAMILIES") = nb::tuple(families);
    m.attr("REASONS") = nb::tuple(reasons);
    m.attr("DIMENSIONS") = nb::make_tuple(kBranches, kCoords, kJoints, AMINN_N_CONTACT_FEATURE, AMINN_N_WRENCH);
    m.attr("MUJOCO_VERSION") = std::string(mj_versionString());

    nb::list rejections;
    for (const char *name : kRejectionNames)
        rejections.append(name);
    m.attr("REJECTIONS") = nb::tuple(rejections);
    m.def(
        "sobol_point",
        [](std::uint32_t index) {
            const Sobol::Point x = Sobol().point(index);
            return out_array(Eigen::Map<const Eigen::VectorXd>(x.data(), static_cast<Eigen::Index>(x.size())));
        },
        "index"_a, "Point of the Sobol' sequence that grasps are drawn from, before its shift by the seed.");
    m.def(
        "nearest_on_ellipsoid",
        [](const InVector &half, const InVector &point) {
            const SurfacePoint s = nearest_on_ellipsoid(in_vector<3>(half, "half"), in_vector<3>(point, "point"));
            return nb::make_tuple(out_array(s.normal), s.distance);
        },
        "half"_a, "point"_a, "Outward normal at the surface point nearest to `point`, and the distance along it.");
    m.def(
        "nearest_on_cylinder",
        [](double radius, double half_length, const InVector &point) {
            const SurfacePoint s = nearest_on_cylinder(radius, half_length, in_vector<3>(point, "point"));
            return nb::make_tuple(out_array(s.normal), s.distance);
        },
        "radius"_a, "half_length"_a, "point"_a, "The same for a cylinder about z.");

    nb::class_<Simulator>(m, "Simulator", "A compiled hand and tool.")
        .def(
            "__init__",
            [](Simulator *self, const nb::dict &files, const std::string &scene, double torsional_friction_m,
               const InVector &neutral, const std::vector<InVector> &columns, const InVector &delta,
               const InVector &low, const InVector &high) {
                std::map<std::string, std::string> content;
                for (const auto &[name, bytes] : files) {
                    const auto text = nb::cast<nb::bytes>(bytes);
                    content[nb::cast<std::string>(name)] = std::string(text.c_str(), text.size());
                }
                new (self)
                    Simulator(content, scene, torsional_friction_m, make_synergy(neutral, columns, delta, low, high));
            },
            "files"_a, "scene"_a, "torsional_friction_m"_a, "neutral"_a, "columns"_a, "delta"_a, "low"_a, "high"_a)
        .def("shard", &Simulator::shard, "options"_a, "seed"_a, "shard"_a, "first_grasp_id"_a, "grasps"_a, "cases"_a,
             "threads"_a, "families"_a, "progress"_a = nb::none(),
             "Simulate a shard: dict of samples, grasps and noise (dicts of arrays) and of the engine's steps. Same "
             "result "
             "for any number of threads. progress(cases done) is called from this thread; what it raises stops it.")
        .def("check", &Simulator::check, "options"_a,
             "Raise ValueError, with the option's name, where they cannot be simulated with this model.")
        .def("hand", &Simulator::hand, "The manifest's entry `hand`, read from the compiled model.")
        .def("gap", &Simulator::gap, "psi"_a, "Distance of the fingertips across the pinch (m) at psi.")
        .def("psi_of", &Simulator::psi_of, "q"_a,
             "Synergy coordinates (size, spread, curl) of joint angles q (8, rad).")
        .def("posture_of", &Simulator::posture_of, "psi"_a, "Joint angles (8, rad) of synergy coordinates.");

    nb::class_<Session>(m, "Session", "One grasp, to be loaded and examined.")
        .def(nb::init<const Simulator &, const Options &, std::uint64_t, std::uint64_t, std::uint64_t, std::int64_t,
                      const std::vector<int> &>(),
             "simulator"_a, "options"_a, "seed"_a, "shard"_a, "index"_a, "grasp_id"_a, "families"_a)
        .def("grasp", &Session::grasp)
        .def("load", &Session::load, "w_e"_a, "recheck"_a = false)
        .def("next_case", &Session::next_case)
        .def("contact_forces", &Session::contact_forces)
        .def("scene", &Session::scene)
        .def("speed", &Session::speed, "cases"_a)
        .def("fingertip_point", &Session::fingertip_point, "branch"_a, "dq"_a)
        .def("tool_point", &Session::tool_point, "branch"_a, "dx"_a)
        .def("engine_jacobian", &Session::engine_jacobian, "branch"_a)
        .def("free_flight", &Session::free_flight, "w_e"_a, "seconds"_a)
        .def("tendon_forces", &Session::tendon_forces, "command_change_m"_a)
        .def("provoke_engine_error", &Session::provoke_engine_error);
}
