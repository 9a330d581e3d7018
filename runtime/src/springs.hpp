// The mechanics head: raw numbers become corrections to the nominal springs, tendons and gates.
#ifndef AMINN_SRC_SPRINGS_HPP
#define AMINN_SRC_SPRINGS_HPP

#include "lanes.hpp"

namespace aminn {
inline namespace AMINN_CORE {

// The head's outputs, in this order, each for all branches. What tanh bounds stands first, what exp of that makes a factor
// before the rest of it: so both run over whole arrays. Without gates, soft fingertips and contacts that slide there is the
// Cholesky factor alone.
enum Head {
    kDiag = 0,                             // C: the Cholesky factor's diagonal
    kGain = kCoord,                        // the tendon's
    kAlpha,                                // the gate's
    kTwist = kGated ? kAlpha + 1 : kCoord, // of a soft fingertip: how much it resists twisting about the normal
    kFactors = kTwisted ? kTwist + 1 : kTwist,
    kOff = kFactors,           // below the diagonal, row by row: 10, 20, 21, 30 ..
    kFriction = kOff + kBelow, // of the contact: logarithm of a factor
    kBounded = kSliding ? kFriction + 1 : kFriction,
    kDir = kBounded, // C: direction of the tendon
    kBeta = kDir + kCoord,
    kRho,
    kPreload = kGated ? kRho + 1 : kBounded, // 3: force across the contact's normal before the load, N
    kEnd = kSliding ? kPreload + 3 : kPreload
};
static_assert(kEnd == AMINN_N_BRANCH_HEAD && kEnd * kBranch == AMINN_N_HEAD, "head layout");

// Place of an entry of the Cholesky factor among those below its diagonal.
constexpr int below(int row, int column)
{
    return row * (row - 1) / 2 + column;
}

// What becomes of the head's outputs, the "springs" of a stage: in the same order, and of the joint springs K = L L^T the
// entries of L up to its diagonal. Without vector registers they take the place of the head's numbers. With them they are
// an array of vectors: one that is loaded from what several stores have just written waits for all of them to retire.
constexpr int at(int output, int group)
{
    return output * kGroups + group;
}
AMINN_INLINE float of_branch(const Branches *springs, int output, int b)
{
#if AMINN_LANES
    return springs[at(output, b / kSideBySide)][b % kSideBySide];
#else
    return springs[at(output, b)];
#endif
}

// With vector registers a whole number of them is computed at once; what is beyond the factors is not used.
constexpr int kComputed = AMINN_LANES ? (kFactors * kBranch + 7) / 8 * 8 : kFactors * kBranch;
static_assert(kComputed <= AMINN_N_HEAD_STORED, "there are so many numbers");

// head is overwritten, and may be springs. Of contacts that slide: what is told of their friction, and of the forces across
// their normals before the load, N.
[[gnu::noinline]] static void springs_from_head(const aminn_model_t &model, const aminn_varied_t &varied,
                                                float friction, const float (*preload)[3], float *head,
                                                Branches *springs)
{
    hyperbolic_tangents(head, kBounded * kBranch);
    float factor[kComputed];
    for (int i = 0; i < kComputed; ++i) {
        factor[i] = model.log_range * head[i];
    }
    exponentials(factor, kComputed);
    for (int g = 0; g < kGroups; ++g) {
        const int b = g * kSideBySide;
        const int n = in_group(g);
        const auto raw = [&](int output) AMINN_ALWAYS { return gather(head + output * kBranch + b, 1, n); };
        // cppcheck-suppress uninitvar ; the loop above fills all of it
        const auto scaling = [&](int output) AMINN_ALWAYS { return gather(factor + output * kBranch + b, 1, n); };
        const float *chol = varied.chol + AMINN_N_CHOLESKY * b;
        Branches nominal[kCoord];
        Branches mask[kCoord];
        Branches direction[kCoord];
        for (int c = 0; c < kCoord; ++c) {
            nominal[c] = gather(chol + c, AMINN_N_CHOLESKY, n);
            mask[c] = gather(model.coord_mask + kCoord * b + c, kCoord, n);
            springs[at(kDiag + c, g)] = mask[c] != 0.0F ? nominal[c] * scaling(kDiag + c) : nominal[c];
            if constexpr (kGated) {
                direction[c] = (gather(model.tendon_dir_nom + kCoord * b + c, kCoord, n) + raw(kDir + c)) * mask[c];
            }
        }
        int row = 1;
        int column = 0;
        for (int i = 0; i < kBelow; ++i) {
            const Branches size = root(nominal[row] * nominal[column]);
            const Branches entry = gather(chol + kCoord + i, AMINN_N_CHOLESKY, n);
            springs[at(kOff + i, g)] = (entry + size * raw(kOff + i)) * (mask[row] * mask[column]);
            if (++column == row) {
                column = 0;
                ++row;
            }
        }
        if constexpr (kTwisted) { // within exp(+-2 log_range)
            springs[at(kTwist, g)] = gather(varied.twist + b, 1, n) * (scaling(kTwist) * scaling(kTwist));
        }
        if constexpr (kGated) {
            const Branches gain = gather(varied.tendon_gain + b, 1, n);
            Branches inv_norm = 1.0F / root(dot_of<kCoord>(direction, direction) + 1e-12F);
            if constexpr (kSomeLack) { // then the branch adds nothing at all
                inv_norm = where_not_zero(gain, inv_norm);
            }
            for (int c = 0; c < kCoord; ++c) {
                springs[at(kDir + c, g)] = direction[c] * inv_norm;
            }
            const float *gate = model.gate_nom;
            springs[at(kGain, g)] = gain * scaling(kGain);
            springs[at(kAlpha, g)] = gate[0] * scaling(kAlpha);
            springs[at(kBeta, g)] = gate[1] * raw(kBeta);
            springs[at(kRho, g)] = gate[2] + raw(kRho);
        }
        if constexpr (kSliding) {
            springs[at(kFriction, g)] = friction * exponential(raw(kFriction));
            for (int i = 0; i < 3; ++i) {
                springs[at(kPreload + i, g)] = gather(&preload[b][i], 3, n) + raw(kPreload + i);
            }
        }
    }
}

// Where an output stands in aminn_stage_debug_t, and how far apart its branches are there, in floats.
struct Place {
    uint8_t first;
    uint8_t stride;
};
constexpr Place place(size_t field, int i, int stride)
{
    return {static_cast<uint8_t>(static_cast<int>(field / sizeof(float)) + i), static_cast<uint8_t>(stride)};
}
constexpr Place in_spring(int row, int column)
{
    return place(offsetof(aminn_stage_debug_t, k_spring), AMINN_N_COORD * row + column, AMINN_N_COORD * AMINN_N_COORD);
}
constexpr Place in_dir(int i)
{
    return place(offsetof(aminn_stage_debug_t, tendon_dir), i, AMINN_N_COORD);
}
constexpr Place in_gate(int i)
{
    return place(offsetof(aminn_stage_debug_t, gate_params), i, 3);
}
struct Places {
    Place of[kEnd];
};
constexpr Places all_places()
{
    Places places{};
    for (int r = 0; r < kCoord; ++r) {
        places.of[kDiag + r] = in_spring(r, r);
        for (int c = 0; c < r; ++c) {
            places.of[kOff + below(r, c)] = in_spring(r, c);
        }
        if constexpr (kGated) {
            places.of[kDir + r] = in_dir(r);
        }
    }
    if constexpr (kGated) {
        places.of[kGain] = place(offsetof(aminn_stage_debug_t, tendon_gain), 0, 1);
        places.of[kAlpha] = in_gate(0);
        places.of[kBeta] = in_gate(1);
        places.of[kRho] = in_gate(2);
    }
    if constexpr (kSliding) {
        places.of[kFriction] = place(offsetof(aminn_stage_debug_t, friction), 0, 1);
    }
    return places;
}
static_assert(offsetof(aminn_stage_debug_t, dx0) <= UINT8_MAX * sizeof(float), "a place is a byte");

// The first fields of out.
static void store_springs(const Branches *springs, aminn_stage_debug_t &out)
{
    static constexpr Places kPlaces = all_places();
    float *first = reinterpret_cast<float *>(&out);
    for (int output = 0; output < kEnd; ++output) {
        if ((kTwisted && output == kTwist) ||
            (kSliding && output >= kPreload)) { // not shown, or shown by what became of it
            continue;
        }
        for (int b = 0; b < kBranch; ++b) {
            first[kPlaces.of[output].first + b * kPlaces.of[output].stride] = of_branch(springs, output, b);
        }
    }
    for (auto &k : out.k_spring) { // K in the place of L, from the end: an entry needs nothing of L behind it
        for (int i = kCoord - 1; i >= 0; --i) {
            for (int j = i; j >= 0; --j) {
                float sum = 0.0F;
                for (int m = 0; m <= j; ++m) {
                    sum = add_product(sum, k[i][m], k[j][m]);
                }
                k[i][j] = k[j][i] = sum;
            }
        }
    }
}

} // namespace AMINN_CORE
} // namespace aminn

#endif
