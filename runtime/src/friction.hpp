// Contacts that slide: how much each gives along its tangents once the load has used up its friction.
//
// A contact that is pressed with N and carries T0 across its normal n before the load holds |T0 - t| <= mu N, t what the load
// adds. Where more is asked for, it gives with a compliance s of its own, in series with its finger: M_b + s (I - n n^T).
// A step of a secant finds s from the largest share 1 / v of t that friction bears, a few steps do. s >= 0, so K_x stays
// positive definite and w.dx >= 0, whatever mu and T0 are.
//
// Nothing of the tool is factorised again. A slide sigma along the two tangents T_b of each contact moves it by e sigma in
// branch b's rows of V, e_b = U_b^-T T_b; what stays of it as strain of all springs, where the tool and the tendons follow
// freely, is G sigma, with weights W of all rows. All else happens among the slides (2 B numbers):
//
//   C = (D + H gamma H^T)^-1 (Q^T W e + H gamma t.e)   how the tool follows a slide, in U x
//   G = e - Q C,  p = gamma (t.e - H^T C)              strain of the rows; what each tendon loses
//   E = G^T W G + p^T p / gamma                        the stiffness that slides meet, a sum of squares
//   F = n.(W (e - Q C)) + n.t p                        what the pressing gains, n in the rows of V
//   t0 = C^T y                                         tangential forces if nothing slides
//   (1 + E S) t = t0,  sigma = S t,  S = diag(s)       forces and slides of contacts that give
//
// The rows of G are those of contacts, the identity below them, and p. Tangents are numbered so: the first one of every
// contact, then the second one of every contact.
#ifndef AMINN_SRC_FRICTION_HPP
#define AMINN_SRC_FRICTION_HPP

#include "grasp.hpp"

#if AMINN_N_SLIDE
namespace aminn {
inline namespace AMINN_CORE {

constexpr int kSteps = 3;
constexpr float kMostSlide = 5e-3F;    // m/N: what gives more than this holds nothing
constexpr float kLeastReserve = 0.01F; // of (mu N)^2, which a contact is believed to have left, whatever T0 uses of it
constexpr float kMostUse = 100.0F;
constexpr float kNoStiffness = 1e-30F; // N/m, whose inverse is a number
constexpr float kNoForce = 1e-12F;     // N^2, whose root is that of no force at all

constexpr int kSlides = 2 * kBranch;
constexpr int kYielding = kHeld + kMotion + kTendons; // rows of G
constexpr int kSlideRoom = sizeof(SlideRow) / sizeof(float);

// What is seen of friction in a stage, of each branch.
struct Friction {
    float use[kBranch];      // share of its friction that a contact would use if none slid
    float share[kBranch];    // s, by what the finger itself gives there
    float pressing[kBranch]; // N, if none slid
};

// What slides do.
struct Slides {
    SlideRow follow[kMotion];              // C
    SlideRow loosened[kMotion + kTendons]; // - H p, - p
    SlideRow strain[kYielding];            // G
    SlideRow meets[kSlides];               // E
    SlideRow taken[kBranch];               // - F
    SlideRow held;                         // t0
};

// What pass 2 found of the tendons: H as orthogonalised columns, below them the inverse of their factor.
struct Tendons {
    TendonRow rows[kMotion + kBranch]; // behind H: what they leave of y, and minus their forces
    float d[kBranch];
    float inv_d[kBranch];
};

// The contacts of a group.
struct Footing {
    Branches friction;
    Branches pressing;   // N0, then N if nothing slides
    Branches now;        // N
    Branches preload[2]; // T0
    Branches preload_square;
    Branches normal[3]; // W n
    Branches pull;      // n.t
    Branches give;      // what the finger itself gives there without its tendon: the mean of both tangents
    Branches slide;     // s
    Branches e[2][3];
};

constexpr int tangent_of(int direction, int b)
{
    return direction * kBranch + b;
}

// out[r] = the sum of the products of the components of each of the rows and z
AMINN_FUNCTION void slide_dots(const SlideRow *rows, int n, const SlideRow &z, float *out)
{
#if AMINN_N_BRANCH == 3
    dots(rows, n, z, out);
#else
    AMINN_UNROLL_ROWS
    for (int r = 0; r < n; ++r) {
        SlideRow product = rows[r];
        multiply(product, z);
        float sum = (product[0] + product[1]) + (product[2] + product[3]);
        for (int i = 4; i < kSlides; i += 2) {
            sum = sum + (product[i] + product[i + 1]);
        }
        out[r] = sum;
    }
#endif
}

AMINN_INLINE Branches in_tangent(const float *of_slides, int direction, int g)
{
    return gather(of_slides + tangent_of(direction, g * kSideBySide), 1, in_group(g));
}

// e, a direction in the rows of V
AMINN_FUNCTION void in_rows(const Contact &contact, const Branches direction[3], Branches e[3])
{
    e[0] = direction[0];
    e[1] = direction[1] + contact.minus_u[0] * e[0];
    e[2] = (direction[2] + contact.minus_u[1] * e[0]) + contact.minus_u[2] * e[1];
}

// The slides' rows e of a group, and pressing = W n, pull = n.t of its contacts.
AMINN_FUNCTION void place_contacts(const Branches *springs, const aminn_input_t &in, const Grasp &grasp, int g,
                                   bool debug, Slides &slides, Footing &footing, float (*preload)[3])
{
    const int b = g * kSideBySide;
    const int n = in_group(g);
    const Contact &contact = grasp.contact[g];
    const float *place = in.contacts[b];
    const Branches c = gather(place, AMINN_N_CONTACT_FEATURE, n);
    const Branches believed[3] = {springs[at(kPreload, g)], springs[at(kPreload + 1, g)], springs[at(kPreload + 2, g)]};
    Branches directions[3][3];
    find_directions(in, g, directions);
    footing.give = Branches{};
    for (int d = 0; d < 2; ++d) {
        const Branches *across = directions[d];
        const Branches *e = footing.e[d];
        in_rows(contact, across, footing.e[d]);
        const Branches u_across[3] = {
            // of U
            subtract_product(subtract_product(across[0], contact.minus_u[0], across[1]), contact.minus_u[1], across[2]),
            subtract_product(across[1], contact.minus_u[2], across[2]), across[2]};
        for (int i = 0; i < 3; ++i) {
            footing.give = add_product(footing.give, 0.5F * contact.d[i], u_across[i] * u_across[i]);
        }
        for (int k = 0; k < n; ++k) {
            SlideRow *rows = slides.strain + 3 * (b + k);
            const int tangent = tangent_of(d, b + k);
            set_component(rows[0], tangent, branch_of(e[0], k));
            set_component(rows[1], tangent, branch_of(e[1], k));
            set_component(rows[2], tangent, branch_of(e[2], k));
        }
        footing.preload[d] = c * dot_of<3>(across, believed);
    }
    Branches e[3];
    in_rows(contact, directions[2], e);
    if constexpr (kGated) {
        footing.pull = dot_of<3>(e, contact.t);
    }
    for (int i = 0; i < 3; ++i) {
        footing.normal[i] = gather(grasp.weight + 3 * b + i, 3, n) * e[i];
    }
    footing.preload_square = dot_of<2>(footing.preload, footing.preload);
    footing.friction = springs[at(kFriction, g)];
    footing.pressing = where_not_zero(c, gather(place + 7, AMINN_N_CONTACT_FEATURE, n));
    footing.slide = Branches{};
    if (debug) {
        for (int i = 0; i < 3; ++i) {
            const Branches force = footing.preload[0] * directions[0][i] + footing.preload[1] * directions[1][i];
            scatter(force, &preload[b][i], 3, n);
        }
    }
}

// C, G, E and t0 from e, and what tendons change of them.
AMINN_FUNCTION void follow_slides(Grasp &grasp, const Tendons &tendons, const Row &y, Slides &slides)
{
    SlideRow *follow = slides.follow;
    SlideRow *strain = slides.strain;
    const WeightedRows<kHeld + kMotion> weighted(grasp.rows, grasp.weight);
    AMINN_UNROLL_ROWS
    for (int i = 0; i < kMotion; ++i) {
        const int n = kHeld + i; // further down, column i of the rows is zero, or the strain
        weighted.products_with(strain, n, i, follow[i]);
        scale(follow[i], grasp.inv_d[i], follow[i]);
        eliminate(strain, n + 1, grasp.rows, i, follow[i]);
    }
    if constexpr (kGated) {
        SlideRow stretch[kBranch];
        SlideRow *share = strain + kHeld + kMotion;
        for (int g = 0; g < kGroups; ++g) {
            combine_branches(stretch + g * kSideBySide, strain + 3 * g * kSideBySide, grasp.contact[g].t, g);
        }
        AMINN_UNROLL_ROWS
        for (int j = 0; j < kBranch; ++j) {
            inner_products(share[j], stretch, kBranch, kOnes, tendons.rows + kMotion, j);
            scale(share[j], tendons.inv_d[j], share[j]);
            eliminate(slides.loosened, kMotion + j + 1, tendons.rows, j, share[j]);
            grasp.weight[kHeld + kMotion + j] = tendons.d[j];
        }
        for (int i = 0; i < kMotion; ++i) {
            add_scaled(follow[i], -grasp.inv_d[i], slides.loosened[i]);
        }
    }
    squares<kSlides, kYielding>(slides.meets, strain, grasp.weight);
    combine_by(slides.held, follow, y);
}

// Tangential forces of contacts that give by s, and their slides: one slide after the other is let go, whereupon E is what is
// left of the stiffness for those that follow.
#if AMINN_CORTEX_M && AMINN_N_BRANCH == 3
AMINN_INLINE void find_forces(const Slides &slides, const float *s, float *force, float *sigma)
{
    six_forces(slides.meets, slides.held, s, force, sigma);
}
#else
AMINN_FUNCTION void find_forces(const Slides &slides, const float *s, float *force, float *sigma)
{
    SlideRow rows[kSlides];
    SlideRow left = slides.held;
    float share[kSlides];
    for (int j = 0; j < kSlides; ++j) {
        rows[j] = slides.meets[j];
    }
    AMINN_UNROLL_ROWS
    for (int j = 0; j < kSlides; ++j) {
        SlideRow taken;
        share[j] = 1.0F / add_product(1.0F, s[j], rows[j][j]);
        scale(taken, s[j] * share[j], rows[j]);
        clear_up_to(taken, j);
        AMINN_UNROLL_ROWS
        for (int i = j + 1; i < kSlides; ++i) {
            subtract_scaled(rows[i], taken[i], rows[j]);
        }
        subtract_scaled(left, left[j], taken);
    }
    float rest[kSlides];
    AMINN_UNROLL_ROWS
    for (int j = 0; j < kSlides; ++j) {
        rest[j] = left[j];
    }
    AMINN_UNROLL_ROWS
    for (int k = kSlides - 1; k >= 0; --k) {
        force[k] = share[k] * rest[k];
        sigma[k] = s[k] * force[k];
        AMINN_UNROLL_ROWS
        for (int j = 0; j < k; ++j) {
            rest[j] = subtract_product(rest[j], rows[j][k], sigma[k]);
        }
    }
}
#endif

// A step of the secant: s of a group's contacts from the forces of the last step.
AMINN_FUNCTION void soften(Footing &footing, Branches first, Branches second)
{
    const Branches force[2] = {first, second};
    const Branches most = footing.friction * footing.now;
    const Branches limit = most * most;
    const Branches reserve = largest(kLeastReserve * limit, limit - footing.preload_square);
    const Branches along = dot_of<2>(footing.preload, force);
    const Branches square = dot_of<2>(force, force);
    const Branches size = root(add_product(along * along, square, reserve));
    const Branches over = (along > 0.0F ? square : size - along) / (along > 0.0F ? size + along : reserve);
    const Branches more = (footing.give + footing.slide) * over - footing.give;
    footing.slide = least(broadcast(kMostSlide), largest(Branches{}, more));
}

// What a group's contacts use of their friction if none slides.
AMINN_FUNCTION void judge(const aminn_input_t &in, int g, const float *force, Footing &footing, Friction &friction)
{
    const int b = g * kSideBySide;
    const int n = in_group(g);
    footing.now = largest(broadcast(kLeastPressing), footing.pressing);
    const Branches borne[2] = {footing.preload[0] - in_tangent(force, 0, g),
                               footing.preload[1] - in_tangent(force, 1, g)};
    const Branches c = gather(in.contacts[b], AMINN_N_CONTACT_FEATURE, n);
    const Branches use = c * root(dot_of<2>(borne, borne) + kNoForce) / (footing.friction * footing.now);
    scatter(least(broadcast(kMostUse), use), friction.use + b, 1, n);
    scatter(footing.now, friction.pressing + b, 1, n);
}

// From the motion z without slides to that with them.
static void slide(const Branches *springs, const aminn_input_t &in, Grasp &grasp, const Tendons &tendons, const Row &y,
                  bool debug, Slides &slides, Footing footings[kGroups], Row &z, aminn_stage_debug_t &out,
                  Friction &friction)
{
    Row normals[kBranch];    // Q^T W n
    float along[kBranch];    // of them what moves
    float slide[kSlideRoom]; // of all tangents
    float force[kSlideRoom];
    float sigma[kSlideRoom] = {};
    clear_rows(slides.strain, kHeld + kMotion);
    if constexpr (kGated) {
        clear_rows(slides.loosened, kMotion + kTendons);
    }
    for (int g = 0; g < kGroups; ++g) {
        const int b = g * kSideBySide;
        place_contacts(springs, in, grasp, g, debug, slides, footings[g], out.preload);
        combine_branches(normals + b, grasp.rows + 3 * b, footings[g].normal, g);
    }
    dots(normals, kBranch, z, along);
    follow_slides(grasp, tendons, y, slides);
    __builtin_memcpy(force, &slides.held, sizeof slides.held);
    for (int g = 0; g < kGroups; ++g) {
        const int b = g * kSideBySide;
        const int n = in_group(g);
        Footing &footing = footings[g];
        footing.pressing = footing.pressing - gather(along + b, 1, n);
        if constexpr (kGated) {
            float pulled[kSideBySide] = {};
            for (int k = 0; k < n; ++k) {
                pulled[k] = tendons.rows[kMotion + b + k][kBranch];
            }
            footing.pressing = add_product(footing.pressing, footing.pull, gather(pulled, 1, n));
        }
        judge(in, g, force, footing, friction);
        const Branches own[2] = {dot_of<3>(footing.normal, footing.e[0]), dot_of<3>(footing.normal, footing.e[1])};
        for (int k = 0; k < n; ++k) {
            SlideRow &taken = slides.taken[b + k];
            combine_by(taken, slides.follow, normals[b + k]);
            if constexpr (kGated) {
                add_scaled(taken, branch_of(footing.pull, k), slides.loosened[kMotion + b + k]);
            }
            for (int d = 0; d < 2; ++d) {
                const int tangent = tangent_of(d, b + k);
                set_component(taken, tangent, taken[tangent] - branch_of(own[d], k));
            }
        }
    }
    for (int step = 0;; ++step) {
        for (int g = 0; g < kGroups; ++g) {
            const int b = g * kSideBySide;
            const int n = in_group(g);
            soften(footings[g], in_tangent(force, 0, g), in_tangent(force, 1, g));
            scatter(footings[g].slide, slide + tangent_of(0, b), 1, n);
            scatter(footings[g].slide, slide + tangent_of(1, b), 1, n);
        }
        find_forces(slides, slide, force, sigma);
        SlideRow moved;
        load_slides(moved, sigma);
        if (step == kSteps - 1) {
            float follow[kMotion];
            Row move;
            slide_dots(slides.follow, kMotion, moved, follow);
            load_row(move, follow);
            add_scaled(z, 1.0F, move);
            break;
        }
        slide_dots(slides.taken, kBranch, moved, along);
        for (int g = 0; g < kGroups; ++g) {
            const int b = g * kSideBySide;
            Footing &footing = footings[g];
            footing.now = largest(broadcast(kLeastPressing), footing.pressing - gather(along + b, 1, in_group(g)));
        }
    }
    for (int g = 0; g < kGroups; ++g) {
        const int b = g * kSideBySide;
        scatter(footings[g].slide, out.slide + b, 1, in_group(g));
        scatter(footings[g].slide / footings[g].give, friction.share + b, 1, in_group(g));
    }
}

// L D L^T + share v v^T, which become those factors: nothing is subtracted from D
AMINN_FUNCTION void add_square(Branches d[3], Branches l[3], Branches share, Branches v[3])
{
    for (int i = 0; i < 3; ++i) {
        const Branches before = d[i];
        const Branches part = share * v[i];
        d[i] = add_product(before, part, v[i]);
        const Branches inv = 1.0F / d[i];
        for (int r = i + 1; r < 3; ++r) {
            Branches &entry = l[below(r, i)];
            v[r] = subtract_product(v[r], v[i], entry);
            entry = add_product(entry, part * inv, v[r]);
        }
        share = share * (before * inv);
    }
}

// Scaled K_x with contacts that give along their tangents, without the floor: a sum of squares. Behind a contact's rows V
// with weights W lies (W + gamma t t^T)^-1 + s e e^T = L'^-T D' L'^-1, all of whose factors are made of sums.
AMINN_FUNCTION void soften_stiffness(const aminn_input_t &in, const Scene &scene, const Footing footings[kGroups],
                                     Grasp &grasp, Row k_s[kMotion])
{
    take_rows(in, scene, grasp.rows);
    for (int g = 0; g < kGroups; ++g) {
        const int b = g * kSideBySide;
        const int n = in_group(g);
        const Contact &contact = grasp.contact[g];
        const Branches flag = gather(in.contacts[b], AMINN_N_CONTACT_FEATURE, n);
        Branches d[3];
        Branches l[3] = {};
        Branches softer[3] = {};
        for (int i = 0; i < 3; ++i) {
            d[i] = largest(broadcast(kNoStiffness), gather(grasp.weight + 3 * b + i, 3, n));
        }
        if constexpr (kGated) {
            Branches t[3] = {contact.t[0], contact.t[1], contact.t[2]};
            add_square(d, l, gather(grasp.d + kMotion + b, 1, n), t);
        }
        for (Branches &number : d) {
            number = 1.0F / number;
        }
        for (int k = 0; k < 2; ++k) {
            const Branches *e = footings[g].e[k];
            Branches v[3] = {(e[0] + l[0] * e[1]) + l[1] * e[2], e[1] + l[2] * e[2], e[2]};
            add_square(d, softer, footings[g].slide, v);
        }
        for (int i = 0; i < 3; ++i) {
            scatter(where_not_zero(flag, 1.0F / d[i]), grasp.weight + 3 * b + i, 3, n);
            softer[i] = -softer[i];
        }
        for (int k = 0; k < n; ++k) {
            float room[3];
            Row *rows = grasp.rows + 3 * (b + k);
            substitute<3>(rows, three_of(contact.minus_u, k, room));
            if constexpr (kGated) {
                const float *stiffer = three_of(l, k, room);
                add_scaled(rows[0], stiffer[0], rows[1]);
                add_scaled(rows[0], stiffer[1], rows[2]);
                add_scaled(rows[1], stiffer[2], rows[2]);
            }
            substitute<3>(rows, three_of(softer, k, room));
        }
    }
    if constexpr (kTwisted) {
        twist_rows(in, scene, grasp);
    }
    squares<kMotion, kHeld>(k_s, grasp.rows, grasp.weight);
}

} // namespace AMINN_CORE
} // namespace aminn
#endif

#endif
