// Simulated grasps and cases as numpy arrays: one column a field of a data set.
#pragma once

#include "shard.hpp"

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <map>

namespace aminn::sim {

namespace nb = nanobind;

using Shape = std::vector<std::size_t>;
template <class T>
using Array = nb::ndarray<nb::numpy, T>;

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
inline void put(const std::vector<double> &x, double *p)
{
    std::copy(x.begin(), x.end(), p);
}

// Sizes of a data set's rows.
struct Widths {
    std::size_t branches, coordinates, joints, tendons, synergies;
};

inline Wrench pose_vector(const Pose &pose)
{
    Wrench x;
    x << pose.p, rotation_vector(pose.R);
    return x;
}

inline void put_contacts(const ContactState &c, std::size_t branches, double *p)
{
    for (std::size_t b = 0; b < branches; ++b, p += kContactFeatures) {
        const ContactState::Row &row = c.branch[b];
        if (!row.in_contact)
            continue;
        p[0] = 1;
        put(row.position, p + 1);
        put(row.normal, p + 4);
        p[7] = row.normal_force;
    }
}

inline constexpr std::size_t kXCols = kWrench;

template <class Items, class State>
void state_columns(nb::dict &out, const Items &items, const Widths &n, State &&state)
{
    column<double>(out, "q", items, {n.joints}, [&](const auto &i, double *p) { put(state(i).q, p); });
    column<double>(out, "x_ht", items, {kXCols},
                   [&](const auto &i, double *p) { put(pose_vector(state(i).tool_in_palm), p); });
    column<double>(out, "contacts", items, {n.branches, kContactFeatures},
                   [&](const auto &i, double *p) { put_contacts(state(i).contacts, n.branches, p); });
    column<double>(out, "j_x", items, {n.branches, 3, kXCols}, [&](const auto &i, double *p) {
        for (std::size_t b = 0; b < n.branches; ++b)
            put(state(i).j_x[b], p + b * 3 * kXCols);
    });
    column<double>(out, "j_q", items, {n.branches, 3, n.coordinates}, [&](const auto &i, double *p) {
        for (std::size_t b = 0; b < n.branches; ++b)
            put(state(i).j_q[b], p + b * 3 * n.coordinates);
    });
    column<std::int64_t>(out, "grasp_id", items, {}, [&](const auto &i, std::int64_t *p) { *p = state(i).grasp_id; });
}

template <class Items, class Case>
void case_columns(nb::dict &out, const Items &items, const Widths &n, Case &&get)
{
    const auto number = [&](const char *name, double CaseResult::*member) {
        column<double>(out, name, items, {}, [&](const auto &i, double *p) { *p = get(i).*member; });
    };
    const auto flag = [&](const char *name, bool CaseResult::*member) {
        column<std::uint8_t>(out, name, items, {}, [&](const auto &i, std::uint8_t *p) { *p = get(i).*member; });
    };
    column<double>(out, "w_e", items, {kXCols}, [&](const auto &i, double *p) { put(get(i).load.w_e, p); });
    column<double>(out, "load_point_m", items, {3}, [&](const auto &i, double *p) { put(get(i).load.point, p); });
    column<double>(out, "dx_ht", items, {kXCols}, [&](const auto &i, double *p) { put(get(i).dx, p); });
    column<double>(out, "q_after", items, {n.joints}, [&](const auto &i, double *p) { put(get(i).q_after, p); });
    column<double>(out, "tendon_tension_after_N", items, {n.tendons},
                   [&](const auto &i, double *p) { put(get(i).tension_after_N, p); });
    column<double>(out, "lost_time_s", items, {n.branches},
                   [&](const auto &i, double *p) { std::copy_n(get(i).lost_time_s.begin(), n.branches, p); });
    number("creep_rate_m_s", &CaseResult::creep_rate_m_s);
    number("drift_m_s", &CaseResult::drift_m_s);
    number("max_translation_m", &CaseResult::max_translation_m);
    number("max_rotation_rad", &CaseResult::max_rotation_rad);
    number("worst_penetration_m", &CaseResult::worst_penetration_m);
    number("solver_residual", &CaseResult::solver_residual);
    number("equilibrium_residual", &CaseResult::equilibrium_residual);
    number("hold_time_s", &CaseResult::hold_time_s);
    number("settle_time_s", &CaseResult::settle_time_s);
    flag("settled", &CaseResult::settled);
    flag("contact_lost", &CaseResult::contact_lost);
    flag("tool_left", &CaseResult::tool_left);
    flag("other_contact", &CaseResult::other_contact);
    column<std::uint8_t>(out, "stable", items, {},
                         [&](const auto &i, std::uint8_t *p) { *p = get(i).reason == Reason::stable; });
    column<std::int8_t>(out, "reason", items, {},
                        [&](const auto &i, std::int8_t *p) { *p = static_cast<std::int8_t>(get(i).reason); });
}

// The cases that were simulated again, by their number among `samples`.
template <class Samples>
nb::dict noise_columns(const Samples &samples)
{
    std::vector<std::pair<std::int64_t, const CaseResult *>> again;
    for (std::size_t i = 0; i < samples.size(); ++i)
        if (samples[i].second->rechecked)
            again.emplace_back(static_cast<std::int64_t>(i), samples[i].second);
    nb::dict out;
    column<std::int64_t>(out, "sample", again, {}, [](const auto &i, std::int64_t *p) { *p = i.first; });
    const auto recheck = [&](const std::string &name, Recheck CaseResult::*member) {
        column<double>(out, ("dx_" + name).c_str(), again, {kXCols},
                       [&](const auto &i, double *p) { put((i.second->*member).dx, p); });
        column<std::uint8_t>(out, ("stable_" + name).c_str(), again, {},
                             [&](const auto &i, std::uint8_t *p) { *p = (i.second->*member).stable; });
    };
    recheck("half_step", &CaseResult::half_step);
    recheck("impratio", &CaseResult::impratio);
    return out;
}

// A geom of a tool as one row: MuJoCo's type (-1: not used), size (3), position (3) and quaternion (4) in T.
inline constexpr int kGeomColumns = 11;
inline void put_geom(const Primitive &g, double *p)
{
    if (!g.used) {
        p[0] = -1;
        return;
    }
    p[0] = g.type;
    put(g.size, p + 1);
    p[4] = g.x_m;
    put(g.quaternion(), p + 7);
}

template <class Items>
void grasp_columns(nb::dict &out, const Items &grasps, const Widths &n)
{
    column<std::int64_t>(out, "grasp_id", grasps, {}, [](const GraspState &g, std::int64_t *p) { *p = g.grasp_id; });
    column<double>(out, "psi", grasps, {n.synergies}, [](const GraspState &g, double *p) { put(g.psi, p); });
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
    column<double>(out, "tendon_tension_N", grasps, {n.tendons},
                   [](const GraspState &g, double *p) { put(g.tension_N, p); });
    column<double>(out, "base_pose", grasps, {kBaseJoints},
                   [](const GraspState &g, double *p) { put(g.base_pose, p); });
    column<double>(out, "gravity_m_s2", grasps, {3}, [](const GraspState &g, double *p) { put(g.gravity_m_s2, p); });
    column<double>(out, "tool_geoms", grasps, {kToolGeoms, kGeomColumns}, [](const GraspState &g, double *p) {
        for (std::size_t k = 0; k < kToolGeoms; ++k)
            put_geom(g.tool.geoms[k], p + k * kGeomColumns);
    });
    column<double>(out, "tool_inertia_kg_m2", grasps, {3},
                   [](const GraspState &g, double *p) { put(g.tool.inertia_kgm2, p); });
    column<std::int32_t>(out, "rejections", grasps, {kRejections}, [](const GraspState &g, std::int32_t *p) {
        std::copy(g.rejections.begin(), g.rejections.end(), p);
    });
}

inline nb::dict shard_arrays(const ShardResult &r, const Widths &n)
{
    using Sample = std::pair<const GraspState *, const CaseResult *>;
    std::vector<Sample> samples;
    for (std::size_t g = 0; g < r.grasps.size(); ++g)
        for (const CaseResult &c : r.cases[g])
            samples.emplace_back(&r.grasps[g], &c);
    nb::dict arrays, grasps, out;
    state_columns(arrays, samples, n, [](const Sample &s) -> const GraspState & { return *s.first; });
    case_columns(arrays, samples, n, [](const Sample &s) -> const CaseResult & { return *s.second; });
    grasp_columns(grasps, r.grasps, n);
    state_columns(grasps, r.grasps, n, [](const GraspState &g) -> const GraspState & { return g; });
    out["samples"] = arrays;
    out["grasps"] = grasps;
    out["noise"] = noise_columns(samples);
    out["steps"] = r.steps;
    return out;
}

// Files by name: a Python dict of bytes.
inline std::map<std::string, std::string> bytes_by_name(const nb::dict &files)
{
    std::map<std::string, std::string> out;
    for (const auto &[name, bytes] : files) {
        const auto content = nb::cast<nb::bytes>(bytes);
        out[nb::cast<std::string>(name)] = std::string(content.c_str(), content.size());
    }
    return out;
}

inline nb::list vector_list(const Eigen::Ref<const Eigen::VectorXd> &x)
{
    nb::list l;
    for (Eigen::Index i = 0; i < x.size(); ++i)
        l.append(x[i]);
    return l;
}

} // namespace aminn::sim
