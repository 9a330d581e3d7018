#include "engine.hpp"

#include "columns.hpp"

#include <mujoco/mjxmacro.h>

#include <cstring>
#include <type_traits>

using namespace nanobind::literals;

namespace aminn::sim {
namespace {

using Numbers = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

// The names that follow the fields' own: of X(type, name, rows, columns).
template <class T>
nb::object rows_of(const T *values, int n_rows, int n_columns)
{
    using Stored = std::conditional_t<std::is_floating_point_v<T>, double, int>;
    Shape shape{static_cast<std::size_t>(n_rows)};
    if (n_columns != 1)
        shape.push_back(static_cast<std::size_t>(n_columns));
    Array<Stored> out = make_array<Stored>(shape);
    const std::size_t n = static_cast<std::size_t>(n_rows) * static_cast<std::size_t>(n_columns);
    for (std::size_t i = 0; i < n; ++i)
        out.data()[i] = static_cast<Stored>(values[i]);
    return out.cast();
}

ModelPtr load_text(const std::string &text, const nb::dict &assets)
{
    static constexpr const char *kName = "scene.xml";
    std::map<std::string, std::string> files = bytes_by_name(assets);
    files[kName] = text;
    return load_files(files, std::string("/dev/null/") + kName); // below that the engine finds no other files
}

class Engine {
  public:
    Engine(const std::string &text, const nb::dict &assets) : model_(load_text(text, assets)), data_(make_data(*model_))
    {
    }

    // Array of mjModel, a copy.
    nb::object model(const std::string &field) const
    {
        const mjModel *m = model_.get();
        MJMODEL_POINTERS_PREAMBLE(m)
#define X(type, name, rows, columns) \
    if (field == #name)              \
        return rows_of(m->name, m->rows, columns);
        MJMODEL_POINTERS
#undef X
        throw nb::key_error(("mjModel has no array " + field).c_str());
    }

    // Array of mjData, a copy.
    nb::object data(const std::string &field) const
    {
        const mjModel *m = model_.get();
        const mjData *d = data_.get();
        if (field == "qpos")
            return rows_of(d->qpos, m->nq, 1);
        if (field == "qvel")
            return rows_of(d->qvel, m->nv, 1);
        if (field == "xpos")
            return rows_of(d->xpos, m->nbody, 3);
        if (field == "xmat")
            return rows_of(d->xmat, m->nbody, 9);
        if (field == "geom_xpos")
            return rows_of(d->geom_xpos, m->ngeom, 3);
        if (field == "geom_xmat")
            return rows_of(d->geom_xmat, m->ngeom, 9);
        if (field == "xaxis")
            return rows_of(d->xaxis, m->njnt, 3);
        if (field == "xanchor")
            return rows_of(d->xanchor, m->njnt, 3);
        if (field == "ten_length")
            return rows_of(d->ten_length, m->ntendon, 1);
        if (field == "actuator_length")
            return rows_of(d->actuator_length, m->nu, 1);
        if (field == "actuator_moment")
            return rows_of(d->actuator_moment, m->nu, m->nv);
        if (field == "actuator_force")
            return rows_of(d->actuator_force, m->nu, 1);
        if (field == "qfrc_passive")
            return rows_of(d->qfrc_passive, m->nv, 1);
        if (field == "qfrc_actuator")
            return rows_of(d->qfrc_actuator, m->nv, 1);
        if (field == "qfrc_constraint")
            return rows_of(d->qfrc_constraint, m->nv, 1);
        if (field == "qfrc_bias")
            return rows_of(d->qfrc_bias, m->nv, 1);
        if (field == "efc_type")
            return rows_of(d->efc_type, d->nefc, 1);
        if (field == "efc_id")
            return rows_of(d->efc_id, d->nefc, 1);
        if (field == "efc_R")
            return rows_of(d->efc_R, d->nefc, 1);
        if (field == "efc_KBIP")
            return rows_of(d->efc_KBIP, d->nefc, 4);
        throw nb::key_error(("no array " + field + " of mjData is offered").c_str());
    }

    // Writes an input of the dynamics.
    void set(const std::string &field, const Numbers &values)
    {
        const mjModel *m = model_.get();
        mjData *d = data_.get();
        struct Input {
            const char *name;
            mjtNum *values;
            int n;
        };
        const Input inputs[] = {{"qpos", d->qpos, m->nq},
                                {"qvel", d->qvel, m->nv},
                                {"ctrl", d->ctrl, m->nu},
                                {"qfrc_applied", d->qfrc_applied, m->nv},
                                {"xfrc_applied", d->xfrc_applied, 6 * m->nbody}};
        for (const Input &input : inputs) {
            if (field != input.name)
                continue;
            if (values.shape(0) != static_cast<std::size_t>(input.n))
                throw std::invalid_argument(field + " has " + std::to_string(values.shape(0)) + " entries, expected " +
                                            std::to_string(input.n));
            std::memcpy(input.values, values.data(), sizeof(mjtNum) * static_cast<std::size_t>(input.n));
            return;
        }
        throw nb::key_error((field + " is no input").c_str());
    }

    void reset()
    {
        guarded([&] { mj_resetData(model_.get(), data_.get()); });
    }
    void forward()
    {
        guarded([&] { mj_forward(model_.get(), data_.get()); });
    }
    // Steps; false if the state became unusable.
    bool step(int n)
    {
        const mjModel *m = model_.get();
        mjData *d = data_.get();
        const nb::gil_scoped_release free;
        for (int i = 0; i < n; ++i) {
            guarded([&] { mj_step(m, d); });
            for (const int w : {mjWARN_BADQPOS, mjWARN_BADQVEL, mjWARN_BADQACC})
                if (d->warning[w].number > 0)
                    return false;
        }
        return true;
    }

    // Jacobian (3 x nv) of a world point that a body holds.
    nb::object jacobian(int body, const Numbers &point) const
    {
        if (body < 0 || body >= model_->nbody || point.shape(0) != 3)
            throw std::invalid_argument("a body of the model and a point of 3 numbers are expected");
        std::vector<mjtNum> jac(3 * static_cast<std::size_t>(model_->nv));
        guarded([&] { mj_jac(model_.get(), data_.get(), jac.data(), nullptr, point.data(), body); });
        return rows_of(jac.data(), 3, model_->nv);
    }

    // Change of each tendon's length by each degree of freedom, (ntendon, nv), of the latest forward().
    nb::object tendon_jacobian() const
    {
        const mjModel *m = model_.get();
        const mjData *d = data_.get();
        if (!mj_isSparse(m))
            return rows_of(d->ten_J, m->ntendon, m->nv);
        std::vector<mjtNum> dense(static_cast<std::size_t>(m->ntendon) * static_cast<std::size_t>(m->nv));
        for (int t = 0; t < m->ntendon; ++t)
            for (int k = 0; k < d->ten_J_rownnz[t]; ++k) {
                const int at = d->ten_J_rowadr[t] + k;
                dense[static_cast<std::size_t>(t * m->nv + d->ten_J_colind[at])] = d->ten_J[at];
            }
        return rows_of(dense.data(), m->ntendon, m->nv);
    }

    // Contacts: geoms, distance, point, frame (normal from geom1 to geom2 first), force in that frame. Those that are
    // within a geom's gap carry none and are listed with `near` alone.
    nb::list contacts(bool near) const
    {
        nb::list out;
        const mjData *d = data_.get();
        for (int i = 0; i < d->ncon; ++i) {
            const mjContact &c = d->contact[i];
            const bool carries = c.exclude == 0 && c.efc_address >= 0;
            if (!carries && !(near && c.exclude == 1))
                continue;
            mjtNum force[6] = {};
            if (carries)
                mj_contactForce(model_.get(), d, i, force);
            nb::dict one;
            one["geoms"] = nb::make_tuple(c.geom1, c.geom2);
            one["distance_m"] = c.dist;
            one["efc_address"] = c.efc_address;
            one["point"] = rows_of(c.pos, 3, 1);
            one["frame"] = rows_of(c.frame, 3, 3);
            one["force"] = rows_of(force, 3, 1);
            out.append(one);
        }
        return out;
    }

    // Names of the objects of a kind, "" where an object has none.
    std::vector<std::string> names(const std::string &kind) const
    {
        const int type = mju_str2Type(kind.c_str());
        const mjModel *m = model_.get();
        int n = 0;
        switch (type) {
        case mjOBJ_BODY:
            n = m->nbody;
            break;
        case mjOBJ_JOINT:
            n = m->njnt;
            break;
        case mjOBJ_GEOM:
            n = m->ngeom;
            break;
        case mjOBJ_TENDON:
            n = m->ntendon;
            break;
        case mjOBJ_ACTUATOR:
            n = m->nu;
            break;
        case mjOBJ_EQUALITY:
            n = m->neq;
            break;
        case mjOBJ_KEY:
            n = m->nkey;
            break;
        default:
            throw nb::key_error((kind + " is no kind of object whose names are offered").c_str());
        }
        std::vector<std::string> out;
        for (int i = 0; i < n; ++i) {
            const char *name = mj_id2name(m, type, i);
            out.emplace_back(name != nullptr ? name : "");
        }
        return out;
    }

  private:
    ModelPtr model_;
    DataPtr data_;
};

} // namespace

void bind_engine(nb::module_ &m)
{
    nb::class_<Engine>(m, "Engine", "A model in the engine: copies of its arrays, and single calls of the engine.")
        .def(nb::init<const std::string &, const nb::dict &>(), "text"_a, "assets"_a = nb::dict(),
             "Compile MJCF from a text and the files that it names, by name (bytes); others are not found.")
        .def("model", &Engine::model, "field"_a, "Array of mjModel by the engine's name, rows first.")
        .def("data", &Engine::data, "field"_a, "Array of mjData by the engine's name, rows first.")
        .def("set", &Engine::set, "field"_a, "values"_a, "Write qpos, qvel, ctrl, qfrc_applied or xfrc_applied, flat.")
        .def("reset", &Engine::reset)
        .def("forward", &Engine::forward)
        .def("step", &Engine::step, "n"_a, "Step n times; false if the state became unusable.")
        .def("jacobian", &Engine::jacobian, "body"_a, "point"_a, "(3, nv) of a world point that the body holds.")
        .def("tendon_jacobian", &Engine::tendon_jacobian, "(ntendon, nv) change of length by degree of freedom.")
        .def("contacts", &Engine::contacts, "near"_a = false,
             "Contacts that carry force, and with `near` those within a gap; force on geom2 in the contact's frame, N.")
        .def("names", &Engine::names, "kind"_a,
             "Names of bodies, joints, geoms, tendons, actuators, equalities, keys.");
}

} // namespace aminn::sim
