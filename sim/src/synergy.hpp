// The synergy space psi = (size, spread, curl) of hand postures: psi = ((q - o) A) * delta, and its inverse.
#pragma once

#include "hand.hpp"

namespace aminn::sim {

struct Synergy {
    JointVector neutral;                     // o, rad
    Eigen::Matrix<double, kJoints, 3> basis; // A; columns size, spread, curl
    Vec3 scale;                              // delta, 1/rad: psi spans about -1 to 1
    Synergy();

    Vec3 psi(const JointVector &q) const
    {
        return (basis.transpose() * (q - neutral)).cwiseProduct(scale);
    }
    // The posture of psi that is nearest to the neutral one; psi(posture(x)) = x.
    JointVector posture(const Vec3 &psi) const;
};

} // namespace aminn::sim
