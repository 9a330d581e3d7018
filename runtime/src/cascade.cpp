// The cascade: does it hold (stage 1), and if it does, how far does it move (stage 2)?
#include "network.hpp"
#include "parts.hpp"
#include "probe.hpp"

namespace aminn {
inline namespace AMINN_CORE {
namespace {

// Nothing overflowed, and the load gives its energy to the grasp (w.dx >= 0). The statics ensure the latter unless the
// stiffnesses lie further apart than float32 can tell, with a tool 1e8 m away for instance: then dx is noise. A gate or a
// displacement that is no number makes one of these two no number: the condition holds K_x's diagonal, which bounds its
// other entries, and 0 times infinity is NaN. With contacts that slide it is that of another K_x: theirs counts, too.
bool sound(const aminn_input_t &in, unsigned wanted, const aminn_stage_debug_t &stage, const StaticsSummary &summary)
{
#if AMINN_N_SLIDE
    float trace = 0.0F;
    if ((wanted & kWantStiffness) != 0) {
        for (int i = 0; i < AMINN_N_WRENCH; ++i) {
            trace = trace + stage.k_x[i][i];
        }
    }
    if (!within(trace, 0, kLargestBits)) {
        return false;
    }
#else
    (void)wanted;
#endif
    float work = 0.0F;
    for (int i = 0; i < AMINN_N_WRENCH; ++i) {
        work = work + in.w_e[i] * stage.dx[i];
    }
    return within(work, 0, kLargestBits) && within(summary.condition, 0, kLargestBits);
}

// displacement, stiffness and gates stand side by side in both
constexpr size_t kMotionBytes =
    sizeof(aminn_output_t::dx_ht) + sizeof(aminn_output_t::k_x) + sizeof(aminn_output_t::gate);
static_assert(offsetof(aminn_output_t, p_slide) - offsetof(aminn_output_t, dx_ht) == kMotionBytes &&
                  sizeof(aminn_stage_debug_t) - offsetof(aminn_stage_debug_t, dx) == kMotionBytes &&
                  offsetof(aminn_output_t, gate) - offsetof(aminn_output_t, dx_ht) ==
                      offsetof(aminn_stage_debug_t, gate) - offsetof(aminn_stage_debug_t, dx),
              "copied as a whole");

// What both stages share of an input.
AMINN_INLINE void prepare(aminn_t &ctx, const aminn_input_t &in, Scene &scene)
{
    make_network_input(*ctx.model, in, ctx);
    make_scene(*ctx.model, in, scene);
}

// where layers work before statics does
float *room_of(aminn_t &ctx)
{
    static_assert(offsetof(aminn_t, layer_out) - offsetof(aminn_t, layer_in) == AMINN_N_LAYER_IN * sizeof(float) &&
                      AMINN_N_LAYER_IN + AMINN_N_LAYER_OUT >= AMINN_N_ROOM,
                  "side by side");
    return reinterpret_cast<float *>(reinterpret_cast<char *>(&ctx) + offsetof(aminn_t, layer_in));
}

// False if its results are not sound.
bool run_stage(aminn_t &ctx, int i, const Scene &scene, const aminn_input_t &in, StaticsSummary &summary)
{
    const aminn_model_t &model = *ctx.model;
    run_backbone(model, i, in, ctx);
#if AMINN_LANES
    Branches springs[kEnd * kGroups];
#else
    Branches *springs = ctx.head;
#endif
#if AMINN_N_SLIDE
    springs_from_head(model, *ctx.varied, ctx.friction, ctx.preload, ctx.head, springs);
#else
    springs_from_head(model, *ctx.varied, 0.0F, nullptr, ctx.head, springs);
#endif
    const bool debug = (ctx.flags & AMINN_FLAG_DEBUG) != 0;
    const unsigned wanted = debug ? kWantStiffness | kWantDeflection : i == 0 ? 0u : kWantStiffness;
    two_pass(model, model.stage[i], ctx.varied->eps_m[i], scene, in, springs, wanted, room_of(ctx), ctx.stage[i],
             summary);
    if (debug) {
        store_springs(springs, ctx.stage[i]);
        ctx.stages_done |= 1u << i;
        if constexpr (kTwisted) { // which is not shown, for find_slopes()
            for (int b = 0; b < kBranch; ++b) {
                ctx.layer_in[b] = of_branch(springs, kTwist, b);
            }
        }
    }
    return sound(in, wanted, ctx.stage[i], summary);
}

} // namespace

aminn_status_t probe_arithmetic()
{
    return judged(probe());
}

bool run_cascade(aminn_t &ctx, const aminn_input_t &in, aminn_output_t &out)
{
    const aminn_model_t &model = *ctx.model;
    Scene scene;
    StaticsSummary summary;
    prepare(ctx, in, scene);
    if (!run_stage(ctx, 0, scene, in, summary)) {
        return false;
    }
    out.p_stable = classify(model, summary, ctx.stage[0].gate, ctx);
    out.stable = out.p_stable >= model.tau ? 1 : 0;
#if AMINN_N_SLIDE
    __builtin_memcpy(out.friction_use, summary.friction.use, sizeof out.friction_use);
#else
    __builtin_memset(out.friction_use, 0, sizeof out.friction_use);
#endif
    bool sound = true;
    if (out.stable != 0 || (ctx.flags & AMINN_FLAG_ALWAYS_STAGE2) != 0) {
        const aminn_stage_debug_t &stage = ctx.stage[1];
        if (!run_stage(ctx, 1, scene, in, summary)) {
            return false;
        }
        __builtin_memcpy(out.dx_ht, stage.dx, kMotionBytes);
        sound = doubt(model, summary, ctx, out);
    }
    out.condition = summary.condition;
    return sound & (out.p_stable >= 0.0F); // a number
}

bool run_motion(aminn_t &ctx, const aminn_input_t &in)
{
    Scene scene;
    StaticsSummary summary;
    prepare(ctx, in, scene);
    return run_stage(ctx, 1, scene, in, summary);
}

} // namespace AMINN_CORE
} // namespace aminn
