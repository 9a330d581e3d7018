// Sensors: what they tell the networks and the layer of one prediction.
#include "parts.hpp"
#include "scene.hpp"

namespace aminn {
namespace {

constexpr float kFrictionSpread =
    0.3F; // relative deviation of a coefficient that says no more than that nothing is known

bool in_range(const aminn_sensors_t &sensors)
{
    constexpr int kNumbers = sizeof sensors / sizeof(float);
    static_assert(kNumbers == AMINN_N_SENSOR, "aminn_sensors_t is floats without gaps");
    bool ok = all_finite(sensors.friction, kNumbers);
    ok &= friction_in_range(sensors.friction);
    ok &= is_flag(sensors.tool_weight[0]);
#if AMINN_N_TENDON > 0
    ok &= is_flag(sensors.tendon_tension[0]);
#endif
    return ok;
}

// A flag and its n numbers, zeros where nothing is known; returns where the next ones go.
float *take(const float *sensor, int n, float *seen)
{
    for (int i = 0; i <= n; ++i) {
        *seen++ = sensor[0] != 0.0F ? sensor[i] : 0.0F;
    }
    return seen;
}

#if AMINN_N_SLIDE
// Of forces across the normals before the load, of force and moment that statics leaves: standard deviations.
constexpr float kTangential = 0.7F;   // N
constexpr float kLeftForce = 0.3F;    // N
constexpr float kLeftMoment = 0.008F; // N.m

// Forces across the normals that carry the tool's weight with the normal forces, small ones where many would: a ridge
// estimate T = P A y, of [W; 0] + sum_b c_b A_b^T (n N + T) and T together, made of rows across the normals.
void carry_weight(const aminn_model_t &model, const aminn_input_t &in, const float *weight, float (*preload)[3])
{
    Scene scene;
    make_scene(model, in, scene);
    Row a_s[3 * kBranch];
    take_rows(in, scene, a_s);
    Row rows[2 * kBranch + kMotion];
    float row_weight[2 * kBranch + kMotion];
    float directions[kBranch][3][3];
    float missing[kMotion] = {-weight[0], -weight[1], -weight[2]};
    for (int g = 0; g < kGroups; ++g) {
        Branches found[3][3];
        find_directions(in, g, found);
        for (int i = 0; i < 9; ++i) {
            scatter(found[i / 3][i % 3], &directions[g * kSideBySide][i / 3][i % 3], 9, in_group(g));
        }
    }
    for (int b = 0; b < kBranch; ++b) {
        const float c = in.contacts[b][0];
        Row along;
        for (int d = 0; d < 2; ++d) {
            combine(rows[2 * b + d], a_s + 3 * b, 3, directions[b][d]);
            row_weight[2 * b + d] = c;
        }
        combine(along, a_s + 3 * b, 3, directions[b][2]);
        const float pressing = c != 0.0F ? c * in.contacts[b][7] : 0.0F;
        for (int i = 0; i < kMotion; ++i) {
            missing[i] = subtract_product(missing[i], pressing, along[i]);
        }
    }
    for (int i = 0; i < kMotion; ++i) {
        const float ridge = (i < 3 ? kLeftForce : kLeftMoment * scene.scale[i]) / kTangential;
        row_weight[2 * kBranch + i] = ridge * ridge;
    }
    Row u[kMotion];
    float d[kMotion];
    float inv_d[kMotion];
    orthogonalise(rows, 2 * kBranch, kMotion, row_weight, u, d, inv_d);
    Row y;
    Row by_d;
    combine(y, rows + 2 * kBranch, kMotion, missing);
    load_row(by_d, inv_d);
    multiply(y, by_d);
    for (int b = 0; b < kBranch; ++b) {
        const float first = in.contacts[b][0] * dot(rows[2 * b], y);
        const float second = in.contacts[b][0] * dot(rows[2 * b + 1], y);
        for (int i = 0; i < 3; ++i) {
            preload[b][i] = add_product(first * directions[b][0][i], second, directions[b][1][i]);
        }
    }
}
#endif

// What ctx->sense does.
aminn_status_t sense(aminn_t *ctx, const aminn_input_t *in)
{
    const aminn_sensors_t &sensors = *ctx->sensors;
    const aminn_model_t &model = *ctx->model;
    forget_sensors(*ctx);
    if (!in_range(sensors)) {
        return AMINN_E_SENSORS;
    }
    float *seen = ctx->sensed;
    if (sensors.friction[0] != 0.0F) {
        const float share = sensors.friction[2] / (kFrictionSpread * sensors.friction[1]);
        seen[0] = 1.0F / (1.0F + share * share);
        seen[1] = seen[0] * logarithm(sensors.friction[1] / model.friction_nominal);
    }
    seen = take(sensors.tool_weight, 3, seen + 2);
#if AMINN_N_TENDON > 0
    take(sensors.tendon_tension, AMINN_N_TENDON, seen);
#endif
#if AMINN_N_SLIDE
    ctx->friction = model.friction_nominal * exponential(ctx->sensed[1]);
    if (sensors.tool_weight[0] != 0.0F) {
        carry_weight(model, *in, sensors.tool_weight + 1, ctx->preload);
    }
#else
    static_cast<void>(in);
#endif
    return AMINN_OK;
}

} // namespace
} // namespace aminn

aminn_status_t aminn_sense(aminn_t *ctx, const aminn_sensors_t *sensors)
{
    using namespace aminn;
    const aminn_status_t status = context_status(ctx);
    if (status != AMINN_OK) {
        return status;
    }
    if (sensors != nullptr && ctx->model->n_sensed == 0) {
        return AMINN_E_SENSORS;
    }
    ctx->sensors = sensors;
    ctx->sense = sensors != nullptr ? aminn::sense : nullptr;
    forget_sensors(*ctx);
    return AMINN_OK;
}
