// The synergy space psi = (size, spread, curl) of hand postures: psi = ((q - o) A) * delta, and its inverse.
#pragma once

#include "hand.hpp"

namespace aminn::sim {

// Values come from the hand file.
struct Synergy {
    JointVector neutral = JointVector::Zero();                                               // o, rad
    Eigen::Matrix<double, kJoints, 3> basis = Eigen::Matrix<double, kJoints, 3>::Identity(); // A
    Vec3 delta = Vec3::Ones();                                                               // 1/rad
    Vec3 low = -Vec3::Ones(), high = Vec3::Ones();                                           // sampled range of psi

    Vec3 psi(const JointVector &q) const
    {
        return (basis.transpose() * (q - neutral)).cwiseProduct(delta);
    }
    // The posture of psi that is nearest to the neutral one; psi(posture(x)) = x.
    JointVector posture(const Vec3 &psi) const
    {
        const Mat3 gram = basis.transpose() * basis;
        return neutral + basis * gram.ldlt().solve(psi.cwiseQuotient(delta));
    }
};

} // namespace aminn::sim
