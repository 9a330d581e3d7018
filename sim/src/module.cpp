// Python module aminn_sim._core: the simulation with numpy arrays at its edges. It holds no policy: files, progress and
// configuration are Python's.
#include "columns.hpp"
#include "contact_shapes.hpp"
#include "engine.hpp"

#include <nanobind/stl/array.h>
#include <nanobind/stl/function.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/tuple.h>

#include <chrono>
#include <optional>
#include <tuple>

using namespace nanobind::literals;

namespace aminn::sim {
namespace {

using InVector = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using InRows = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

// A number or text of a Python object.
template <class T>
T field(const nb::handle &object, const char *name)
{
    return nb::cast<T>(object.attr(name));
}

Vec3 vec3_of(const nb::handle &object)
{
    const auto x = nb::cast<std::array<double, 3>>(object);
    return {x[0], x[1], x[2]};
}

// From a Python `Hand` and what the scene that it is in adds to it (see `scene.SceneParts`).
HandParts parts_of(const nb::handle &hand, const nb::handle &scene)
{
    HandParts out;
    out.prefix = field<std::string>(scene, "prefix");
    out.palm = field<std::string>(scene, "palm");
    out.forward = vec3_of(scene.attr("forward"));
    out.tool_axis = vec3_of(hand.attr("tool_axis"));
    out.torsional_friction_m = field<double>(hand.attr("contact"), "torsional_friction_m");
    std::tie(out.first_side, out.second_side) =
        nb::cast<std::pair<std::vector<int>, std::vector<int>>>(hand.attr("sides"));
    const auto tips = field<std::vector<std::vector<std::string>>>(scene, "tips");
    for (const nb::handle branch : hand.attr("branches")) {
        BranchParts part;
        part.name = field<std::string>(branch, "name");
        part.group = field<std::string>(branch, "group");
        part.tip_body = field<std::string>(branch, "tip");
        part.tip_point_m = vec3_of(branch.attr("tip_point_m"));
        part.tip_geoms = tips.at(out.branches.size());
        for (const nb::handle coordinate : branch.attr("coordinates"))
            part.joints.push_back(field<std::string>(coordinate, "joint"));
        for (const nb::handle tendon : branch.attr("tendons"))
            part.tendons.push_back(field<std::string>(tendon, "name"));
        out.branches.push_back(std::move(part));
    }
    return out;
}

// Of tuples (kind, part, place in theta).
std::vector<ParameterPart> parameters_of(const nb::handle &list)
{
    std::vector<ParameterPart> out;
    for (const auto &[kind, part, parameter] : nb::cast<std::vector<std::tuple<std::string, std::string, int>>>(list))
        out.push_back({kind, part, parameter});
    return out;
}

Synergy synergy_of(const nb::handle &synergy)
{
    const auto vector = [](const std::vector<double> &x) {
        return Vector(Eigen::Map<const Vector>(x.data(), static_cast<Eigen::Index>(x.size())));
    };
    Synergy s;
    s.neutral = vector(field<std::vector<double>>(synergy, "neutral_rad"));
    s.delta = vector(field<std::vector<double>>(synergy, "delta"));
    const auto columns = field<std::vector<std::vector<double>>>(synergy, "columns");
    const auto ranges = field<std::vector<std::array<double, 2>>>(synergy, "ranges");
    const auto n = static_cast<Eigen::Index>(columns.size());
    s.basis.resize(s.neutral.size(), n);
    s.low.resize(n), s.high.resize(n);
    for (Eigen::Index k = 0; k < n; ++k) {
        s.basis.col(k) = vector(columns[static_cast<std::size_t>(k)]);
        s.low[k] = ranges[static_cast<std::size_t>(k)][0];
        s.high[k] = ranges[static_cast<std::size_t>(k)][1];
    }
    return s;
}

Vector in_vector(const InVector &x, Eigen::Index n, const char *name)
{
    if (x.shape(0) != static_cast<std::size_t>(n))
        throw std::invalid_argument(std::string(name) + " has " + std::to_string(x.shape(0)) + " entries, expected " +
                                    std::to_string(n));
    Vector v = Eigen::Map<const Vector>(x.data(), n);
    if (!v.allFinite())
        throw std::invalid_argument(std::string(name) + " is not finite");
    return v;
}

void check_theta(const Eigen::Ref<const Eigen::MatrixXd> &theta, const Mechanics &mechanics)
{
    if (theta.cols() < mechanics.parameters())
        throw std::invalid_argument("theta has " + std::to_string(theta.cols()) + " numbers, expected at least " +
                                    std::to_string(mechanics.parameters()));
    if (!theta.allFinite())
        throw std::invalid_argument("theta is not finite");
}

// Mechanics parameters of so many grasps, a row each; no rows where none are given.
Eigen::MatrixXd in_theta(const std::optional<InRows> &theta, int grasps, const Mechanics &mechanics)
{
    if (!theta)
        return Eigen::MatrixXd();
    if (theta->shape(0) != static_cast<std::size_t>(grasps))
        throw std::invalid_argument("theta has " + std::to_string(theta->shape(0)) + " rows, expected " +
                                    std::to_string(grasps));
    using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
    Eigen::MatrixXd out = Eigen::Map<const RowMajor>(theta->data(), grasps, static_cast<Eigen::Index>(theta->shape(1)));
    check_theta(out, mechanics);
    return out;
}

// Those of one grasp; empty where none are given.
Vector in_theta(const std::optional<InVector> &theta, const Mechanics &mechanics)
{
    if (!theta)
        return Vector();
    Vector out = Eigen::Map<const Vector>(theta->data(), static_cast<Eigen::Index>(theta->shape(0)));
    check_theta(out.transpose(), mechanics);
    return out;
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

// Contacts of the tool that also pass on a moment about their normal, up to `torsional_m` times the normal force.
void soften(mjModel &m, const Hand &hand, double torsional_m)
{
    if (torsional_m <= 0)
        return;
    for (const int g : hand.tool_geoms) {
        m.geom_condim[g] = 4;
        m.geom_friction[3 * g + 1] = torsional_m;
    }
}

double seconds_now()
{
    using Clock = std::chrono::steady_clock;
    return std::chrono::duration<double>(Clock::now().time_since_epoch()).count();
}

Widths widths_of(const Hand &hand, const Synergy &synergy)
{
    return {hand.branches.size(), static_cast<std::size_t>(hand.coordinates), hand.qpos.size(), hand.tendons.size(),
            static_cast<std::size_t>(synergy.delta.size())};
}

// The arrays of the shard that the queue gives next. progress(cases done): a callable or None.
nb::dict next_arrays(ShardQueue &queue, const Widths &widths, const nb::object &progress)
{
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
        result = queue.next(poll);
    }
    return shard_arrays(result, widths);
}

void check_counts(int grasps, int cases, int threads)
{
    if (grasps < 1 || cases < 1 || threads < 1)
        throw std::invalid_argument("grasps, cases and threads must be at least 1");
}

// A compiled model to simulate shards of.
class Simulator {
  public:
    // `files` by name, `scene` the one that the engine begins with. Below /dev/null the engine finds no others.
    Simulator(const std::map<std::string, std::string> &files, const std::string &scene, const HandParts &parts,
              const Synergy &synergy, const std::vector<ParameterPart> &parameters)
        : prototype_{load_files(files, "/dev/null/" + scene), Hand(), synergy, Mechanics()}
    {
        prototype_.hand = Hand(*prototype_.model, parts);
        soften(*prototype_.model, prototype_.hand, parts.torsional_friction_m);
        prototype_.mechanics = Mechanics(*prototype_.model, prototype_.hand, parameters);
    }

    nb::dict shard(const Options &options, std::uint64_t seed, std::uint64_t shard, std::int64_t first_grasp_id,
                   int grasps, int cases, int threads, const std::vector<int> &families, const nb::object &progress,
                   const std::optional<InRows> &theta) const
    {
        check_counts(grasps, cases, threads);
        check_families(families);
        ShardQueue queue(prototype_, {options, seed, cases, families}, threads);
        queue.add({shard, first_grasp_id, grasps, in_theta(theta, grasps, prototype_.mechanics)});
        return next_arrays(queue, widths(), progress);
    }

    void check(const Options &options) const
    {
        check_options(options, prototype_.model->opt.timestep);
    }
    const Prototype &prototype() const
    {
        return prototype_;
    }
    Widths widths() const
    {
        return widths_of(prototype_.hand, prototype_.synergy);
    }
    // What theta makes of the model: array, index, value.
    nb::list numbers(const InVector &theta) const
    {
        const Vector drawn = in_theta(theta, prototype_.mechanics);
        nb::list out;
        for (const Mechanics::Number &n : prototype_.mechanics.numbers())
            out.append(nb::make_tuple(n.name, n.index, n.at(drawn)));
        return out;
    }
    // Distance of the fingertips' surfaces across the pinch (m) in the posture of psi.
    double gap(const InVector &psi) const
    {
        const mjModel *m = prototype_.model.get();
        const Hand &hand = prototype_.hand;
        const DataPtr data = make_data(*m);
        mjData *d = data.get();
        const Vector q = prototype_.synergy.posture(in_vector(psi, prototype_.synergy.delta.size(), "psi"));
        guarded([&] { mj_resetData(m, d); });
        for (int j = 0; j < hand.joint_count(); ++j)
            d->qpos[hand.qpos[static_cast<std::size_t>(j)]] = q[j];
        guarded([&] { mj_kinematics(m, d); });
        const Pinch pinch = hand.pinch(*m, *d);
        return (pinch.first - pinch.second).norm() - pinch.first_reach - pinch.second_reach;
    }
    Array<double> psi_of(const InVector &q) const
    {
        return out_array(prototype_.synergy.psi(in_vector(q, prototype_.synergy.neutral.size(), "q")));
    }
    Array<double> posture_of(const InVector &psi) const
    {
        return out_array(prototype_.synergy.posture(in_vector(psi, prototype_.synergy.delta.size(), "psi")));
    }

  private:
    Prototype prototype_;
};

// Shards in the hands of Python.
class Shards {
  public:
    Shards(const Simulator &simulator, const Options &options, std::uint64_t seed, int cases,
           const std::vector<int> &families, int threads)
        : mechanics_(simulator.prototype().mechanics), widths_(simulator.widths())
    {
        check_counts(1, cases, threads);
        check_families(families);
        queue_ =
            std::make_unique<ShardQueue>(simulator.prototype(), ShardOptions{options, seed, cases, families}, threads);
    }

    void add(std::uint64_t shard, std::int64_t first_grasp_id, int grasps, const std::optional<InRows> &theta)
    {
        check_counts(grasps, 1, 1);
        open().add({shard, first_grasp_id, grasps, in_theta(theta, grasps, mechanics_)});
    }

    nb::dict next(const nb::object &progress)
    {
        return next_arrays(open(), widths_, progress);
    }

    void close()
    {
        const nb::gil_scoped_release free;
        queue_.reset();
    }

  private:
    ShardQueue &open() const
    {
        if (!queue_)
            throw std::invalid_argument("closed");
        return *queue_;
    }

    const Mechanics &mechanics_;
    const Widths widths_;
    std::unique_ptr<ShardQueue> queue_;
};

// One grasp in the hands of Python: for tests, fidelity and pictures.
class Session {
  public:
    Session(const Simulator &simulator, const Options &options, std::uint64_t seed, std::uint64_t shard,
            std::uint64_t index, std::int64_t grasp_id, const std::vector<int> &families,
            const std::optional<InVector> &theta)
        : worker_(simulator.prototype(), options, seed), widths_(simulator.widths())
    {
        check_families(families);
        const Vector drawn = in_theta(theta, simulator.prototype().mechanics);
        const nb::gil_scoped_release free;
        worker_.make(shard, index, grasp_id, families, drawn);
    }

    nb::dict grasp() const
    {
        const std::vector<GraspState> one{worker_.state()};
        nb::dict out;
        grasp_columns(out, one, widths_);
        state_columns(out, one, widths_, [](const GraspState &g) -> const GraspState & { return g; });
        return out;
    }
    nb::dict load(const InVector &w_e, bool recheck)
    {
        const Load load{in_vector(w_e, kWrench, "w_e"), worker_.state().tool_in_palm.p};
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
        Eigen::MatrixXd rows(worker_.hand().count(), 3);
        const ContactState c = worker_.contacts();
        for (int b = 0; b < rows.rows(); ++b)
            rows.row(b) = c.branch[static_cast<std::size_t>(b)].force.transpose();
        return out_array(rows);
    }
    // What touches at contact b, as the engine has it: the fingertip geom's type, size, position and rotation in H, and
    // the give of the contact along its normal (m/N).
    nb::tuple fingertip(int b)
    {
        worker_.restore();
        const mjModel &m = worker_.model();
        const mjData &d = worker_.data();
        const int g = contact(b).geom;
        if (g < 0)
            throw std::invalid_argument("branch " + std::to_string(b) + " does not touch the tool");
        using RowMajor = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
        const Pose H = worker_.hand().palm(d);
        const Vec3 p = H.R.transpose() * (Eigen::Map<const Vec3>(d.geom_xpos + 3 * g) - H.p);
        const Mat3 R = H.R.transpose() * Eigen::Map<const RowMajor>(d.geom_xmat + 9 * g);
        return nb::make_tuple(m.geom_type[g], out_array(Eigen::Map<const Vec3>(m.geom_size + 3 * g)), out_array(p),
                              out_array(R), contact(b).give_m_N);
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

    // Where the fingertip's material point that now touches the tool goes when the joints turn by dq (J), m, H.
    Array<double> fingertip_point(int b, const InVector &dq)
    {
        const Hand &hand = worker_.hand();
        const Vector turn = in_vector(dq, hand.joint_count(), "dq");
        worker_.restore();
        const auto &row = contact(b);
        mjData &d = worker_.data();
        const int body = hand.branches[static_cast<std::size_t>(b)].tip_body;
        const Pose H = hand.palm(d), tip = Hand::body_pose(d, body);
        const Vec3 local = tip.R.transpose() * (H.p + H.R * row.position - tip.p);
        for (int j = 0; j < hand.joint_count(); ++j)
            d.qpos[hand.qpos[static_cast<std::size_t>(j)]] += turn[j];
        guarded([&] { mj_kinematics(&worker_.model(), &d); });
        const Pose moved = Hand::body_pose(d, body);
        return out_array(H.R.transpose() * (moved.p + moved.R * local - H.p));
    }
    // Where the tool's material point under contact b goes when the tool moves by dx (6), m, H.
    Array<double> tool_point(int b, const InVector &dx) const
    {
        const Wrench x = in_vector(dx, kWrench, "dx");
        const auto &row = contact(b);
        const Vec3 p = worker_.state().tool_in_palm.p, turn = x.tail<3>();
        const Mat3 R(Eigen::AngleAxisd(turn.norm(), turn.norm() > 0 ? Vec3(turn.normalized()) : Vec3::UnitX()));
        return out_array(p + x.head<3>() + R * (row.position - p));
    }
    // The engine's own Jacobian of contact point b with respect to the joints, 3xJ, H.
    Array<double> engine_jacobian(int b)
    {
        worker_.restore();
        const auto &row = contact(b);
        const mjModel &m = worker_.model();
        mjData &d = worker_.data();
        const Hand &hand = worker_.hand();
        const Pose H = hand.palm(d);
        const Vec3 point = H.p + H.R * row.position;
        const int body = hand.branches[static_cast<std::size_t>(b)].tip_body;
        std::vector<double> jac(3 * static_cast<std::size_t>(m.nv));
        guarded([&] { mj_jac(&m, &d, jac.data(), nullptr, point.data(), body); });
        Eigen::Matrix3Xd out(3, hand.joint_count());
        for (int j = 0; j < hand.joint_count(); ++j)
            for (int i = 0; i < 3; ++i)
                out(i, j) = jac[static_cast<std::size_t>(i * m.nv + hand.dof[static_cast<std::size_t>(j)])];
        return out_array(H.R.transpose() * out);
    }
    // The tool alone in the air: no gravity, hand out of reach, wrench w_e for `seconds`. Gives its velocity (linear at
    // the tool's origin, angular; H) at the end.
    Array<double> free_flight(const InVector &w_e, double seconds)
    {
        const Wrench w = in_vector(w_e, kWrench, "w_e");
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
    // Forces (N, negative = tension) of the tendons' actuators, tendon by tendon, when every command is changed by dc (m).
    Array<double> tendon_forces(double dc)
    {
        worker_.restore();
        mjData &d = worker_.data();
        std::vector<int> actuators;
        for (const Tendon &t : worker_.hand().tendons)
            actuators.insert(actuators.end(), t.actuators.begin(), t.actuators.end());
        for (const int a : actuators)
            d.ctrl[a] += dc;
        worker_.refresh();
        Vector f(static_cast<Eigen::Index>(actuators.size()));
        for (Eigen::Index i = 0; i < f.size(); ++i)
            f[i] = d.actuator_force[actuators[static_cast<std::size_t>(i)]];
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
        case_columns(out, one, widths_, [](const CaseResult &c) -> const CaseResult & { return c; });
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
                for (int k = 0; k < kWrench; ++k)
                    applied[k] = scale * world[k];
                mj_step(m, d);
            }
        });
        return seconds_now() - start;
    }
    const ContactState::Row &contact(int b) const
    {
        if (b < 0 || b >= worker_.hand().count())
            throw std::invalid_argument("no branch " + std::to_string(b));
        return worker_.state().contacts.branch[static_cast<std::size_t>(b)];
    }
    GraspWorker worker_;
    Widths widths_;
};

} // namespace
} // namespace aminn::sim

NB_MODULE(_core, m)
{
    using namespace aminn::sim;
    namespace nb = nanobind;
    m.doc() = "Grasps of a hand in MuJoCo; see aminn_sim.simulate for the way in.";
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
    m.attr("MUJOCO_VERSION") = std::string(mj_versionString());
    m.attr("MUJOCO_LIBRARY") = engine_library();

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
            const SurfacePoint s = nearest_on_ellipsoid(in_vector(half, 3, "half"), in_vector(point, 3, "point"));
            return nb::make_tuple(out_array(s.normal), s.distance);
        },
        "half"_a, "point"_a, "Outward normal at the surface point nearest to `point`, and the distance along it.");
    m.def(
        "nearest_on_cylinder",
        [](double radius, double half_length, const InVector &point) {
            const SurfacePoint s = nearest_on_cylinder(radius, half_length, in_vector(point, 3, "point"));
            return nb::make_tuple(out_array(s.normal), s.distance);
        },
        "radius"_a, "half_length"_a, "point"_a, "The same for a cylinder about z.");

    nb::class_<Simulator>(m, "Simulator", "A compiled hand and tool.")
        .def(
            "__init__",
            [](Simulator *self, const std::string &text, const nb::dict &assets, const nb::object &hand,
               const nb::object &scene, const nb::object &parameters) {
                static constexpr const char *kScene = "scene.xml";
                std::map<std::string, std::string> files = bytes_by_name(assets);
                files[kScene] = text;
                new (self) Simulator(files, kScene, parts_of(hand, scene), synergy_of(hand.attr("synergy")),
                                     parameters_of(parameters));
            },
            "text"_a, "assets"_a, "hand"_a, "scene"_a, "parameters"_a = nb::tuple(),
            "text: MJCF of hand, base and tool; assets: files that it names; hand: aminn_hand.Hand; scene: the names "
            "of the parts that are not the hand's (prefix, palm, tips, forward); parameters: (kind, part, place in "
            "theta) of what mechanics parameters act on.")
        .def("shard", &Simulator::shard, "options"_a, "seed"_a, "shard"_a, "first_grasp_id"_a, "grasps"_a, "cases"_a,
             "threads"_a, "families"_a, "progress"_a = nb::none(), "theta"_a = nb::none(),
             "Simulate one shard, as Shards does several.")
        .def("check", &Simulator::check, "options"_a,
             "Raise ValueError, with the option's name, where they cannot be simulated with this model.")
        .def("numbers", &Simulator::numbers, "theta"_a,
             "(array of mjModel, index, value) of every number that theta scales.")
        .def("gap", &Simulator::gap, "psi"_a, "Distance of the fingertips across the pinch (m) at psi.")
        .def("psi_of", &Simulator::psi_of, "q"_a, "Synergy coordinates of joint angles q (rad).")
        .def("posture_of", &Simulator::posture_of, "psi"_a, "Joint angles (rad) of synergy coordinates.");

    nb::class_<Shards>(m, "Shards", "Shards of a data set on worker threads; the results are the same for any number.")
        .def(nb::init<const Simulator &, const Options &, std::uint64_t, int, const std::vector<int> &, int>(),
             "simulator"_a, "options"_a, "seed"_a, "cases"_a, "families"_a, "threads"_a, nb::keep_alive<1, 2>())
        .def("add", &Shards::add, "shard"_a, "first_grasp_id"_a, "grasps"_a, "theta"_a = nb::none(),
             "Queue a shard; does not wait. theta: mechanics parameters, a row a grasp.")
        .def("next", &Shards::next, "progress"_a = nb::none(),
             "Wait for the shard that was added first: dict of samples, grasps and noise (dicts of arrays) and of the "
             "engine's steps. The shards after it are simulated meanwhile, and until they are waited for. "
             "progress(cases "
             "done of all shards) is called from this thread; what it raises goes on to the caller.")
        .def("close", &Shards::close, "Stop the workers; what is left is dropped.");

    nb::class_<Session>(m, "Session", "One grasp, to be loaded and examined.")
        .def(nb::init<const Simulator &, const Options &, std::uint64_t, std::uint64_t, std::uint64_t, std::int64_t,
                      const std::vector<int> &, const std::optional<InVector> &>(),
             "simulator"_a, "options"_a, "seed"_a, "shard"_a, "index"_a, "grasp_id"_a, "families"_a,
             "theta"_a = nb::none())
        .def("grasp", &Session::grasp)
        .def("load", &Session::load, "w_e"_a, "recheck"_a = false)
        .def("next_case", &Session::next_case)
        .def("contact_forces", &Session::contact_forces)
        .def("fingertip", &Session::fingertip, "branch"_a)
        .def("scene", &Session::scene)
        .def("speed", &Session::speed, "cases"_a)
        .def("fingertip_point", &Session::fingertip_point, "branch"_a, "dq"_a)
        .def("tool_point", &Session::tool_point, "branch"_a, "dx"_a)
        .def("engine_jacobian", &Session::engine_jacobian, "branch"_a)
        .def("free_flight", &Session::free_flight, "w_e"_a, "seconds"_a)
        .def("tendon_forces", &Session::tendon_forces, "command_change_m"_a)
        .def("provoke_engine_error", &Session::provoke_engine_error);
}
