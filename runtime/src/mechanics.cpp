// The two-pass statics layer.
//
//   K_x = sum_b c_b A_b^T M_b^-1 A_b + eps_kx I,   M_b = B_b K_b^-1 B_b^T + eps_m I
//
// in square-root form: instead of the symmetric matrices only their triangular roots R (R^T R) are computed, each by
// Gram-Schmidt from stacked rows:
//
//   K_b = R_K^T R_K     G = R_K^-T B^T                       B K^-1 B^T = G^T G
//   M_b = R_M^T R_M     R_M from [ G ; sqrt(eps_m) I ]       Y = R_M^-T A,  A^T M^-1 A = Y^T Y
//   K_x = R_X^T R_X     R_X from V = [ sqrt(c_b) Y_b ; sqrt(eps_kx) I ]
//
// With V = Q R_X the strain of the stacked springs is V x = Q R_X^-T w, without the cancellation that Y x has when the
// tool moves far in a soft direction; the deflection of the joints follows from it.
//
// Forming K_x would lose half of float32's digits: its stiffest direction is 1/eps_m, its softest the springs'. All on
// lengths divided by length_scale (S = diag(1, 1, 1, 1/L, 1/L, 1/L)).
#include "parts.hpp"

namespace aminn {
namespace {

constexpr int kStacked = 3 * kBranch + AMINN_N_WRENCH;
constexpr int kRows = 16; // kStacked and rows of zeros, so that columns are whole vector registers
static_assert(kStacked <= kRows, "stacked rows");

using Stacked = Mat<kRows, 6>;

struct Pass {
    Root<3> r_k[kBranch];
    Mat3 q_m[kBranch]; // G R_M^-1
    Stacked v;         // V^T V is the scaled stiffness
    Stacked q;         // V = Q R_X
    Vec6 t;            // R_X^-T w
    Vec6 x_s;          // scaled displacement
};

Root<3> root_of_cholesky(const Mat3 &l)
{
    Root<3> root;
    root.r = l.transpose();
    root.inv_diag = l.diagonal().cwiseInverse();
    return root;
}

// root of K + gain d d^T from K's Cholesky factor
Root<3> root_with_tendon(const Mat3 &l, const Vec3 &d, float gain)
{
    Mat<4, 3> stacked;
    stacked.topRows<3>() = l.transpose();
    stacked.row(3) = std::sqrt(gain) * d.transpose();
    return gram_schmidt(stacked);
}

// one branch: joints and contact compliance in series, seen from the contact; returns Y
Mat<3, 6> solve_branch(const Scene &scene, int b, float root_eps_m, Pass &p)
{
    Mat3 g = scene.b_t[b];
    solve_forward(p.r_k[b], g);
    Mat<6, 3> stacked;
    stacked.topRows<3>() = g;
    stacked.bottomRows<3>() = root_eps_m * Mat3::Identity();
    const Root<3> r_m = gram_schmidt(stacked);
    p.q_m[b] = stacked.topRows<3>();
    Mat<3, 6> y = scene.a_s[b];
    solve_forward(r_m, y);
    return y;
}

// branches in parallel; p.r_k is given, all else is computed
void solve_pass(const Scene &scene, float length_scale, float eps_m, float eps_kx, Pass &p)
{
    const float root_eps_m = std::sqrt(eps_m);
    const float root_eps_kx = std::sqrt(eps_kx);
    p.v.setZero();
    for (int b = 0; b < kBranch; ++b) {
        p.v.middleRows<3>(3 * b) = scene.root_contact[b] * solve_branch(scene, b, root_eps_m, p);
    }
    for (int i = 0; i < 6; ++i) {
        p.v(3 * kBranch + i, i) = i < 3 ? root_eps_kx : root_eps_kx / length_scale;
    }
    p.q = p.v;
    const Root<6> r_x = gram_schmidt(p.q);
    p.t = scene.w_s;
    solve_forward(r_x, p.t);
    p.x_s = p.t;
    solve_backward(r_x, p.x_s);
}

// deflection of a branch's coordinates from its part of the strain; 0 for a branch out of contact
Vec3 deflection_by_statics(const Scene &scene, const Pass &p, const Mat<kRows, 1> &strain, int b)
{
    Vec3 dq = p.q_m[b].lazyProduct(scene.root_contact[b] * strain.segment<3>(3 * b));
    solve_backward(p.r_k[b], dq);
    return dq;
}

// the same as the paper writes it, from the regularised inverse of j_q
Vec3 deflection_by_inverse(const aminn_input_t &in, int b, const Vec6 &dx0, float eps_jq)
{
    const Vec3 motion = ConstMat36Map(&in.j_x[b][0][0]).lazyProduct(dx0);
    const Mat3 j_q = ConstMat3Map(&in.j_q[b][0][0]) + eps_jq * Mat3::Identity();
    return -in.contacts[b][0] * inverse_by_cofactors(j_q).lazyProduct(motion);
}

Vec6 unscaled(const Vec6 &x_s, float length_scale)
{
    Vec6 x = x_s;
    x.tail<3>() /= length_scale;
    return x;
}

// scaled stiffness V^T V; stores it in SI, returns its diagonal
Vec6 store_stiffness(const Stacked &v, float length_scale, aminn_stage_debug_t &out)
{
    Vec6 diag;
    for (int i = 0; i < 6; ++i) {
        const float s_i = i < 3 ? 1.0F : length_scale;
        for (int j = 0; j <= i; ++j) {
            const float s_j = j < 3 ? 1.0F : length_scale;
            const float k = v.col(i).dot(v.col(j));
            if (i == j) {
                diag(i) = k;
            }
            out.k_x[i][j] = out.k_x[j][i] = k * s_i * s_j;
        }
    }
    return diag;
}

} // namespace

Scene make_scene(const aminn_model_t &model, const aminn_input_t &in)
{
    Scene scene;
    const float inv_length = 1.0F / model.length_scale;
    for (int b = 0; b < kBranch; ++b) {
        scene.a_s[b] = ConstMat36Map(&in.j_x[b][0][0]);
        scene.a_s[b].rightCols<3>() *= inv_length;
        scene.b_t[b] = -ConstMat3Map(&in.j_q[b][0][0]).transpose();
        scene.root_contact[b] = std::sqrt(in.contacts[b][0]);
    }
    scene.w_s = ConstVec6Map(in.w_e);
    scene.w_s.tail<3>() *= inv_length;
    return scene;
}

StaticsSummary two_pass(const aminn_model_t &model, const aminn_stage_model_t &stage, const Springs &springs,
                        const Scene &scene, const aminn_input_t &in, aminn_stage_debug_t &out)
{
    Pass p;
    const float length = model.length_scale;

    // pass 1: springs alone
    for (int b = 0; b < kBranch; ++b) {
        p.r_k[b] = root_of_cholesky(springs.chol[b]);
    }
    solve_pass(scene, length, stage.eps_m, stage.eps_kx, p);
    const Vec6 dx0 = unscaled(p.x_s, length);
    Vec6Map(out.dx0) = dx0;

    // how far each tendon would be stretched decides how much it engages
    const Mat<kRows, 1> strain = apply_q(p.q, p.t);
    for (int b = 0; b < kBranch; ++b) {
        const bool statics = model.dq0 == AMINN_DQ0_STATICS;
        Vec3 dq =
            statics ? deflection_by_statics(scene, p, strain, b) : deflection_by_inverse(in, b, dx0, stage.eps_jq);
        dq = dq.cwiseProduct(ConstVec3Map(model.coord_mask + 3 * b));
        Vec3Map(out.dq0[b]) = dq;
        const Vec3 &gate = springs.gate_params[b];
        out.gate[b] = sigmoid(gate(0) * (dq.dot(springs.tendon_dir[b]) - gate(1)) + gate(2));
    }

    // pass 2: springs and engaged tendons
    for (int b = 0; b < kBranch; ++b) {
        p.r_k[b] = root_with_tendon(springs.chol[b], springs.tendon_dir[b], springs.tendon_gain[b] * out.gate[b]);
    }
    solve_pass(scene, length, stage.eps_m, stage.eps_kx, p);
    Vec6Map(out.dx) = unscaled(p.x_s, length);
    return {p.x_s, store_stiffness(p.v, length, out)};
}

} // namespace aminn
