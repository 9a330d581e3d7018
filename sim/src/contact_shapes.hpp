// Contacts of a spherical fingertip with ellipsoids and cylinders in closed form. MuJoCo 2.2 finds these by a general
// convex search that leaves about 1 um of error, one per cent of a usual penetration, and that error wanders.
#pragma once

#include <Eigen/Dense>

namespace aminn::sim {

// Where a solid's surface is nearest to a point, in the solid's frame.
struct SurfacePoint {
    Eigen::Vector3d normal; // unit, out of the solid
    double distance;        // of the point along `normal`, m; negative inside
};

// Ellipsoid with semi-axes `half` (m).
SurfacePoint nearest_on_ellipsoid(const Eigen::Vector3d &half, const Eigen::Vector3d &point);
// Cylinder about z.
SurfacePoint nearest_on_cylinder(double radius, double half_length, const Eigen::Vector3d &point);

// Registers both with the engine, for every model of this process.
void install_contact_shapes();

} // namespace aminn::sim
