// What the statics need of an input, and how they factorise rows. mechanics.hpp has the method.
#ifndef AMINN_SRC_SCENE_HPP
#define AMINN_SRC_SCENE_HPP

#include "lanes.hpp"

namespace aminn {
inline namespace AMINN_CORE {

// What the statics need of an input, the same for both stages. "Scaled": lengths divided by length_scale.
struct Scene {
#if AMINN_LANES
    Row a_s[3 * kBranch]; // rows of j_x S; without vector registers they are as soon made as copied
#endif
    float w_s[kMotion];   // S w_e
    float scale[kMotion]; // S
    float inv_scale[kMotion];
};

// n rows of j_x S
AMINN_FUNCTION void scaled_rows(const aminn_input_t &in, const float scale[kMotion], int first, int n, Row *rows)
{
    const auto *j_x = reinterpret_cast<const float *>(in.j_x) + kMotion * first;
    Row to_scaled;
    load_row(to_scaled, scale);
    for (int r = 0; r < n; ++r) {
        load_row(rows[r], j_x + kMotion * r);
        multiply(rows[r], to_scaled);
    }
}

// the rows of j_x S of all branches
AMINN_INLINE void take_rows(const aminn_input_t &in, const Scene &scene, Row rows[3 * kBranch])
{
#if AMINN_LANES
    static_cast<void>(in);
    AMINN_UNROLL_ROWS
    for (int r = 0; r < 3 * kBranch; ++r) { // no call of memcpy, nor its instruction, which is slow to start
        rows[r] = scene.a_s[r];
    }
#else
    scaled_rows(in, scene.scale, 0, 3 * kBranch, rows);
#endif
}

AMINN_INLINE void make_scene(const aminn_model_t &model, const aminn_input_t &in, Scene &scene)
{
    const float inv_length = 1.0F / model.length_scale;
    for (int i = 0; i < 3; ++i) {
        scene.scale[i] = 1.0F;
        scene.inv_scale[i] = 1.0F;
        scene.w_s[i] = in.w_e[i];
        scene.scale[3 + i] = inv_length;
        scene.inv_scale[3 + i] = model.length_scale;
        scene.w_s[3 + i] = in.w_e[3 + i] * inv_length;
    }
#if AMINN_LANES
    scaled_rows(in, scene.scale, 0, 3 * kBranch, scene.a_s);
#endif
}

// The first columns of rows with an identity as wide below, which this writes: rows becomes Q, and D and U come out.
template <class AnyRow, class Number>
AMINN_FUNCTION void orthogonalise(AnyRow *rows, int above, int columns, const Number *weight, AnyRow *u, Number *d,
                                  Number *inv_d)
{
    AMINN_UNROLL_ROWS
    for (int j = 0; j < columns; ++j) {
        const int n = above + j + 1; // further down, column j is zero
        clear(rows[above + j]);
        set_component(rows[above + j], j, 1.0F);
        inner_products(u[j], rows, n, weight, rows, j);
        d[j] = u[j][j];
        inv_d[j] = scale_by_component(u[j], j);
        clear_up_to(u[j], j);
        if (j < kMotion - 1) { // behind the last there is nothing
            eliminate(rows, n, rows, j, u[j]);
        }
        set_component(u[j], j, 1.0F);
    }
}

#if AMINN_N_SLIDE
// Two unit vectors across the normals of a group, and these; of a branch out of contact any three. The first two have no
// components that cancel, whichever way a normal points.
AMINN_FUNCTION void find_directions(const aminn_input_t &in, int g, Branches directions[3][3])
{
    const float *contact = in.contacts[g * kSideBySide];
    const int n = in_group(g);
    const Branches c = gather(contact, AMINN_N_CONTACT_FEATURE, n);
    Branches *normal = directions[2];
    for (int i = 0; i < 3; ++i) {
        normal[i] = where_not_zero(c, gather(contact + 4 + i, AMINN_N_CONTACT_FEATURE, n));
    }
    const Branches side = normal[2] < 0.0F ? broadcast(-1.0F) : broadcast(1.0F);
    const Branches share = -1.0F / (side + normal[2]);
    const Branches mixed = (normal[0] * normal[1]) * share;
    directions[0][0] = 1.0F + side * ((normal[0] * normal[0]) * share);
    directions[0][1] = side * mixed;
    directions[0][2] = -(side * normal[0]);
    directions[1][0] = mixed;
    directions[1][1] = side + (normal[1] * normal[1]) * share;
    directions[1][2] = -normal[1];
}
#endif

} // namespace AMINN_CORE
} // namespace aminn

#endif
