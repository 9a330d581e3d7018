#include "mechanics.hpp"

#include <cmath>

namespace aminn::sim {

double Mechanics::Number::at(const Vector &theta) const
{
    return nominal * std::exp(power * theta[parameter]);
}

Mechanics::Mechanics(const mjModel &m, const Hand &hand, const std::vector<ParameterPart> &parts)
{
    for (const ParameterPart &p : parts) {
        const std::size_t before = numbers_.size();
        parameters_ = std::max(parameters_, p.parameter + 1);
        if (p.kind == "spring") {
            add(m, "jnt_stiffness", &mjModel::jnt_stiffness, id_of(m, mjOBJ_JOINT, p.part), p.parameter);
        } else if (p.kind == "servo") {
            add_actuators(m, mjTRN_JOINT, id_of(m, mjOBJ_JOINT, p.part), p.parameter);
        } else if (p.kind == "tendon") {
            const int tendon = id_of(m, mjOBJ_TENDON, p.part);
            add(m, "tendon_stiffness", &mjModel::tendon_stiffness, tendon, p.parameter);
            add_actuators(m, mjTRN_TENDON, tendon, p.parameter);
        } else {
            for (const Branch &branch : hand.branches) {
                if (p.kind != "contact" || branch.name != p.part)
                    continue;
                // a contact gives way by the square of its time constant
                const double tool_s = m.geom_solref[mjNREF * hand.tool_geoms[0]];
                for (const int g : branch.tip_geoms) {
                    tips_.push_back(g);
                    numbers_.push_back({"geom_solref", &mjModel::geom_solref, mjNREF * g, p.parameter, tool_s, 0.5});
                }
            }
        }
        if (numbers_.size() == before)
            throw MujocoError("the model has nothing that is the " + p.kind + " of " + p.part);
    }
}

void Mechanics::add(const mjModel &m, const char *name, mjtNum *mjModel::*array, int index, int parameter)
{
    const double nominal = (m.*array)[index];
    if (nominal != 0)
        numbers_.push_back({name, array, index, parameter, nominal, 1});
}

// The force law of each actuator that is a spring.
void Mechanics::add_actuators(const mjModel &m, mjtTrn kind, int target, int parameter)
{
    for (int a = 0; a < m.nu; ++a) {
        const bool spring = m.actuator_biastype[a] == mjBIAS_AFFINE && m.actuator_biasprm[a * mjNBIAS + 1] < 0;
        if (!spring || m.actuator_trntype[a] != kind || m.actuator_trnid[2 * a] != target)
            continue;
        add(m, "actuator_gainprm", &mjModel::actuator_gainprm, a * mjNGAIN, parameter);
        for (const int i : {0, 1})
            add(m, "actuator_biasprm", &mjModel::actuator_biasprm, a * mjNBIAS + i, parameter);
    }
}

void Mechanics::write(mjModel &m, const Vector &theta) const
{
    for (const Number &n : numbers_)
        (m.*n.array)[n.index] = n.at(theta);
}

void Mechanics::rule_contacts(mjModel &m, const Hand &hand) const
{
    const int tool = hand.tool_geoms[0];
    for (const int g : tips_) {
        m.geom_priority[g] = m.geom_priority[tool] + 1;
        m.geom_condim[g] = m.geom_condim[tool];
        mju_copy(m.geom_friction + 3 * g, m.geom_friction + 3 * tool, 3);
        mju_copy(m.geom_solimp + mjNIMP * g, m.geom_solimp + mjNIMP * tool, mjNIMP);
        mju_copy(m.geom_solref + mjNREF * g + 1, m.geom_solref + mjNREF * tool + 1, mjNREF - 1);
    }
}

} // namespace aminn::sim
