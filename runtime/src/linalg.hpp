// Small dense linear algebra: Eigen types of fixed size, Gram-Schmidt, triangular solves.
//
// Everything here is inline, works on registers and the stack, and never allocates. Eigen's own factorisations are not
// used: on a microcontroller they link an allocator.
#ifndef AMINN_SRC_LINALG_HPP
#define AMINN_SRC_LINALG_HPP

#define EIGEN_NO_DEBUG
#define EIGEN_NO_IO
#define EIGEN_DONT_PARALLELIZE
#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>

namespace aminn {

template <int M, int N>
using Mat = Eigen::Matrix<float, M, N>;
using Mat3 = Mat<3, 3>;
using Vec3 = Mat<3, 1>;
using Vec6 = Mat<6, 1>;

using ConstMat3Map = Eigen::Map<const Eigen::Matrix<float, 3, 3, Eigen::RowMajor>>;
using ConstMat36Map = Eigen::Map<const Eigen::Matrix<float, 3, 6, Eigen::RowMajor>>;
using ConstVec3Map = Eigen::Map<const Vec3>;
using ConstVec6Map = Eigen::Map<const Vec6>;
using Mat3Map = Eigen::Map<Eigen::Matrix<float, 3, 3, Eigen::RowMajor>>;
using Mat36Map = Eigen::Map<Eigen::Matrix<float, 3, 6, Eigen::RowMajor>>;
using Mat6Map = Eigen::Map<Eigen::Matrix<float, 6, 6, Eigen::RowMajor>>;
using Vec3Map = Eigen::Map<Vec3>;
using Vec6Map = Eigen::Map<Vec6>;

// Upper triangular R with R^T R = K; the diagonal is stored as its reciprocal as well.
template <int N>
struct Root {
    Mat<N, N> r;        // strictly upper part is valid
    Mat<N, 1> inv_diag; // 1 / R_jj
};

// R with R^T R = V^T V by modified Gram-Schmidt; V is overwritten with Q, V = Q R. V^T V itself is never formed: that
// would square the condition number, which float32 cannot afford here (docs/runtime.md has the measured difference).
template <int M, int N>
inline Root<N> gram_schmidt(Mat<M, N> &v)
{
    Root<N> root;
    for (int j = 0; j < N; ++j) {
        const float norm = std::sqrt(v.col(j).squaredNorm());
        const float inv = 1.0F / norm;
        root.r(j, j) = norm;
        root.inv_diag(j) = inv;
        v.col(j) *= inv;
        for (int k = j + 1; k < N; ++k) {
            const float t = v.col(j).dot(v.col(k));
            root.r(j, k) = t;
            v.col(k) -= t * v.col(j);
        }
    }
    return root;
}

// x := R^-T x, column by column
template <int N, int K>
inline void solve_forward(const Root<N> &root, Mat<N, K> &x)
{
    for (int i = 0; i < N; ++i) {
        for (int k = 0; k < i; ++k) {
            x.row(i) -= root.r(k, i) * x.row(k);
        }
        x.row(i) *= root.inv_diag(i);
    }
}

// x := R^-1 x
template <int N>
inline void solve_backward(const Root<N> &root, Mat<N, 1> &x)
{
    for (int i = N - 1; i >= 0; --i) {
        for (int k = i + 1; k < N; ++k) {
            x(i) -= root.r(i, k) * x(k);
        }
        x(i) *= root.inv_diag(i);
    }
}

// Q t for the Q of gram_schmidt, so ordered that Q's rounded orthogonality does not matter (Bjorck)
template <int M, int N>
inline Mat<M, 1> apply_q(const Mat<M, N> &q, const Mat<N, 1> &t)
{
    Mat<M, 1> z = Mat<M, 1>::Zero();
    for (int j = N - 1; j >= 0; --j) {
        z += (t(j) - q.col(j).dot(z)) * q.col(j);
    }
    return z;
}

// inverse of a 3x3 matrix by cofactors
inline Mat3 inverse_by_cofactors(const Mat3 &m)
{
    Mat3 out;
    out.row(0) = m.col(1).cross(m.col(2)).transpose();
    out.row(1) = m.col(2).cross(m.col(0)).transpose();
    out.row(2) = m.col(0).cross(m.col(1)).transpose();
    const float det = out.row(0).transpose().dot(m.col(0));
    return out / det;
}

} // namespace aminn

#endif
