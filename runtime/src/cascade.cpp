// The cascade: does it hold (stage 1), and if it does, how far does it move (stage 2)?
#include "parts.hpp"

namespace aminn {
inline namespace AMINN_CORE {
namespace {

void run_stage(aminn_t &ctx, int i, const Scene &scene, const aminn_input_t &in, StaticsSummary &summary)
{
    const aminn_model_t &model = *ctx.model;
    Springs springs;
    run_backbone(model, model.stage[i], ctx);
    springs_from_head(model, ctx.head, springs);
    unsigned wanted = i == 0 ? 0u : kStiffness;
    if ((ctx.flags & AMINN_FLAG_DEBUG) != 0) {
        wanted = kStiffness | kDeflection;
        store_springs(springs, ctx.stage[i]);
        ctx.stages_done |= 1u << i;
    }
    two_pass(model, model.stage[i], springs, scene, in, wanted, ctx.stage[i], summary);
}

// Nothing overflowed, and the load gives its energy to the grasp (w.dx >= 0). The statics ensure the latter unless the
// stiffnesses lie further apart than float32 can tell, with a tool 1e8 m away for instance: then dx is noise. A gate or a
// displacement that is no number makes one of these two no number: the condition holds K_x's diagonal, which bounds its
// other entries, and 0 times infinity is NaN.
bool sound(const aminn_input_t &in, const aminn_stage_debug_t &stage, const StaticsSummary &summary)
{
    float work = 0.0F;
    for (int i = 0; i < AMINN_N_WRENCH; ++i) {
        work = work + in.w_e[i] * stage.dx[i];
    }
    return work >= 0.0F && work <= FLT_MAX && summary.condition <= FLT_MAX;
}

} // namespace

bool run_cascade(aminn_t &ctx, const aminn_input_t &in, aminn_output_t &out)
{
    const aminn_model_t &model = *ctx.model;
    Scene scene;
    StaticsSummary summary;
    make_network_input(model, in, ctx);
    make_scene(model, in, scene);
    run_stage(ctx, 0, scene, in, summary);
    out.p_stable = classify(model, summary, ctx.stage[0].gate, ctx);
    if (!(out.p_stable >= 0.0F) || !sound(in, ctx.stage[0], summary)) {
        return false;
    }
    out.stable = out.p_stable >= model.tau ? 1 : 0;
    const bool both = out.stable != 0 || (ctx.flags & AMINN_FLAG_ALWAYS_STAGE2) != 0;
    if (both) {
        const aminn_stage_debug_t &stage = ctx.stage[1];
        run_stage(ctx, 1, scene, in, summary);
        std::memcpy(out.dx_ht, stage.dx, sizeof out.dx_ht);
        std::memcpy(out.k_x, stage.k_x, sizeof out.k_x);
        std::memcpy(out.gate, stage.gate, sizeof out.gate);
        if (!sound(in, stage, summary)) {
            return false;
        }
    }
    out.condition = summary.condition;
    return true;
}

} // namespace AMINN_CORE
} // namespace aminn
