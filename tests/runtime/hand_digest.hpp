/* What a core computes of all inputs of hand_case.hpp, as one number. */
#ifndef HAND_DIGEST_HPP
#define HAND_DIGEST_HPP

#include "hand_case.hpp"
#include "vector_file.h"

namespace hand_case {

using Core = bool (*)(aminn_t &ctx, const aminn_input_t &in, aminn_output_t &out);

/* What sensors might tell of the contacts, some of it made up. */
inline void tell(aminn_t &ctx, const aminn_model_t &model)
{
    Random random(3);
    random.fill(ctx.sensed, AMINN_N_SENSED, -0.5F, 0.5F);
#if AMINN_N_SLIDE
    ctx.friction = 0.9F * model.friction_nominal;
    random.fill(ctx.preload[0], 3 * B, -0.3F, 0.3F);
#else
    (void)model;
#endif
}

/* A context as aminn_init() and sensors leave it. */
inline void begin(aminn_t &ctx, const aminn_model_t &model, uint32_t flags)
{
    std::memset(&ctx, 0, sizeof ctx);
    ctx.model = &model;
    ctx.flags = flags;
    ctx.varied = &model.nominal;
    tell(ctx, model);
}

inline uint32_t digest(Core core, Tables &tables, aminn_model_t &model, aminn_t &ctx)
{
    uint32_t crc = 0;
    make_model(tables, model);
    for (uint32_t i = 0; i < 12; ++i) {
        aminn_input_t in;
        aminn_output_t out = {};
        make_input(i, in);
        begin(ctx, model, AMINN_FLAG_ALWAYS_STAGE2 | AMINN_FLAG_DEBUG);
        out.notes = core(ctx, in, out) ? 1u : 0u;
        crc = vector_crc(vector_crc(crc, &out, sizeof out), ctx.stage, sizeof ctx.stage);
    }
    return crc;
}

} // namespace hand_case

#endif
