#include "contact_shapes.hpp"

#include <mujoco/mujoco.h>

#include <algorithm>
#include <cmath>

namespace aminn::sim {

using Vec3 = Eigen::Vector3d;

// The nearest point is x_i = e_i^2 y_i / (t + e_i^2), with t the largest root of F(t) = sum (e_i y_i / (t + e_i^2))^2 - 1.
// F falls and is convex there, so that Newton's method from a point left of the root never overshoots.
SurfacePoint nearest_on_ellipsoid(const Vec3 &half, const Vec3 &point)
{
    const Vec3 square = half.cwiseProduct(half), y = point.cwiseAbs(), ey = half.cwiseProduct(y);
    double t = (ey - square).maxCoeff();
    Vec3 normal;
    if (y.isZero(0.0) || (t + square.minCoeff()) <= 0) { // on the longest axes' plane, well inside: out by the shortest
        Vec3::Index shortest;
        half.minCoeff(&shortest);
        normal = Vec3::Unit(shortest);
        return {normal, point.dot(normal) - half[shortest]};
    }
    for (int i = 0; i < 100; ++i) {
        const Vec3 d = (t + square.array()).matrix(), q = ey.cwiseQuotient(d);
        const double f = q.squaredNorm() - 1, slope = -2 * q.cwiseProduct(q).cwiseQuotient(d).sum(), step = -f / slope;
        if (!(step > 1e-16 * (std::abs(t) + square.maxCoeff())))
            break;
        t += step;
    }
    const Vec3 nearest = square.cwiseProduct(point).cwiseQuotient((t + square.array()).matrix());
    normal = nearest.cwiseQuotient(square).normalized();
    return {normal, (point - nearest).dot(normal)};
}

SurfacePoint nearest_on_cylinder(double radius, double half_length, const Vec3 &point)
{
    const double rho = std::hypot(point.x(), point.y());
    const Vec3 out = rho > 0 ? Vec3(point.x() / rho, point.y() / rho, 0) : Vec3(Vec3::UnitX());
    const Vec3 up = Vec3::UnitZ() * (point.z() < 0 ? -1.0 : 1.0);
    const double beside = rho - radius, above = std::abs(point.z()) - half_length;
    if (beside <= 0 || above <= 0)
        return above > beside ? SurfacePoint{up, above} : SurfacePoint{out, beside};
    const double distance = std::hypot(beside, above); // off the rim
    return {(beside * out + above * up) / distance, distance};
}

namespace {

// MuJoCo's interface: geom 1 is the sphere; the normal points from geom 1 to geom 2.
template <class Nearest>
int collide(const mjModel *m, const mjData *d, mjContact *contact, int sphere, int solid, mjtNum margin,
            Nearest &&nearest)
{
    using RowMajor = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
    const Vec3 centre = Eigen::Map<const Vec3>(d->geom_xpos + 3 * sphere);
    const Eigen::Map<const RowMajor> R(d->geom_xmat + 9 * solid);
    const Vec3 local = R.transpose() * (centre - Eigen::Map<const Vec3>(d->geom_xpos + 3 * solid));
    const SurfacePoint s = nearest(m->geom_size + 3 * solid, local);
    const double radius = m->geom_size[3 * sphere], distance = s.distance - radius;
    if (distance > margin)
        return 0;
    const Vec3 normal = -(R * s.normal), position = centre + normal * (radius + 0.5 * distance);
    contact->dist = distance;
    for (int i = 0; i < 3; ++i) {
        contact->pos[i] = position[i];
        contact->frame[i] = normal[i];
        contact->frame[3 + i] = 0; // the engine completes the frame
    }
    return 1;
}

int sphere_ellipsoid(const mjModel *m, const mjData *d, mjContact *contact, int g1, int g2, mjtNum margin)
{
    return collide(m, d, contact, g1, g2, margin, [](const mjtNum *size, const Vec3 &p) {
        return nearest_on_ellipsoid(Vec3(size[0], size[1], size[2]), p);
    });
}

int sphere_cylinder(const mjModel *m, const mjData *d, mjContact *contact, int g1, int g2, mjtNum margin)
{
    return collide(m, d, contact, g1, g2, margin,
                   [](const mjtNum *size, const Vec3 &p) { return nearest_on_cylinder(size[0], size[1], p); });
}

} // namespace

void install_contact_shapes()
{
    mjCOLLISIONFUNC[mjGEOM_SPHERE][mjGEOM_ELLIPSOID] = sphere_ellipsoid;
    mjCOLLISIONFUNC[mjGEOM_SPHERE][mjGEOM_CYLINDER] = sphere_cylinder;
}

} // namespace aminn::sim
