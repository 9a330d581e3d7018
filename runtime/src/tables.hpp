// The one list of a model's tables, in the order in which a blob holds them. Checking and loading both walk it.
#ifndef AMINN_SRC_TABLES_HPP
#define AMINN_SRC_TABLES_HPP

#include "aminn_rt.h"

namespace aminn {

// Calls f(table pointer, number of floats) for every table until f returns false; returns whether none did. Model is
// aminn_model_t, const or not. The widths in the model must be set.
template <class Model, class F>
bool for_each_table(Model &m, F f)
{
    const uint32_t hc = m.contact_width;
    const uint32_t h = m.width;
    const uint32_t hd = m.classifier_width;
    const uint32_t nb = AMINN_N_BRANCH;
    const uint32_t nc = AMINN_N_COORD;
    bool ok = f(m.wrench_log_scale, AMINN_N_WRENCH) && f(m.chol_nom, nb * 6) && f(m.tendon_dir_nom, nb * nc) &&
              f(m.tendon_gain_nom, nb) && f(m.gate_nom, 3) && f(m.coord_mask, nb * nc) && f(m.geom_base, nb * 3) &&
              f(m.geom_axis, nb * nc * 3) && f(m.geom_link_a, nb * 3);
    for (auto &s : m.stage) {
        ok = ok && f(s.contact_mean, AMINN_N_CONTACT_INPUT) && f(s.contact_inv_std, AMINN_N_CONTACT_INPUT) &&
             f(s.global_mean, AMINN_N_GLOBAL_INPUT) && f(s.global_inv_std, AMINN_N_GLOBAL_INPUT) &&
             f(s.contact_w, AMINN_N_CONTACT_INPUT * hc) && f(s.contact_b, hc) &&
             f(s.trunk1_w, (hc + AMINN_N_GLOBAL_INPUT) * h) && f(s.trunk1_b, h) && f(s.trunk2_w, h * h) &&
             f(s.trunk2_b, h) && f(s.head_w, h * AMINN_N_HEAD) && f(s.head_b, AMINN_N_HEAD);
    }
    return ok && f(m.aux_mean, AMINN_N_AUX) && f(m.aux_inv_std, AMINN_N_AUX) && f(m.cls1_w, (h + AMINN_N_AUX) * hd) &&
           f(m.cls1_b, hd) && f(m.cls2_w, hd) && f(m.cls2_b, 1);
}

} // namespace aminn

#endif
