#include "synergy.hpp"

namespace aminn::sim {

Synergy::Synergy()
{
    // joint order: roll, proximal, distal of two fingers; proximal, distal of the thumb
    neutral << 0.0, 0.15, 0.55, 0.0, 0.15, 0.55, 0.15, 0.55;
    // size opens the proximal joints (and a little the distal ones); curl bends the distal joints and straightens the
    // proximal ones by as much as keeps the columns orthogonal
    const double minor = 0.25;
    basis.col(0) << 0, -1, -minor, 0, -1, -minor, -1, -minor;
    basis.col(1) << 1, 0, 0, 1, 0, 0, 0, 0;
    basis.col(2) << 0, -minor, 1, 0, -minor, 1, -minor, 1;
    basis.colwise().normalize();
    // at psi = 1: size opens each proximal joint by 0.22 rad, spread rolls by 0.25 rad, curl bends by 0.30 rad
    const Vec3 joint_at_one(0.22, 0.25, 0.30), main_entry(-basis(1, 0), basis(0, 1), basis(2, 2));
    scale = main_entry.cwiseQuotient(joint_at_one);
}

JointVector Synergy::posture(const Vec3 &psi) const
{
    const Mat3 gram = basis.transpose() * basis;
    return neutral + basis * gram.ldlt().solve(psi.cwiseQuotient(scale));
}

} // namespace aminn::sim
