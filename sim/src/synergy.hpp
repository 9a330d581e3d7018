// The synergy space psi of hand postures, of one to three axes: psi = ((q - o) A) * delta, and its inverse.
#pragma once

#include "hand.hpp"

namespace aminn::sim {

struct Synergy {
    Vector neutral;        // o, rad
    Eigen::MatrixXd basis; // A, one column an axis
    Vector delta;          // 1/rad
    Vector low, high;      // sampled range of psi

    Vector psi(const Vector &q) const
    {
        return (basis.transpose() * (q - neutral)).cwiseProduct(delta);
    }
    // The posture of psi that is nearest to the neutral one; psi(posture(x)) = x.
    Vector posture(const Vector &psi) const
    {
        const Eigen::MatrixXd gram = basis.transpose() * basis;
        return neutral + basis * gram.ldlt().solve(psi.cwiseQuotient(delta));
    }
};

} // namespace aminn::sim
