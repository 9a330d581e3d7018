#include "contact_shapes.hpp"

#include <mujoco/mujoco.h>

#include <algorithm>
#include <cmath>

namespace aminn::sim {

using Vec3 = Eigen::Vector3d;
using Mat3 = Eigen::Matrix3d;

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

// Gap (m) beyond which the general search cannot find a contact: many times its tolerance.
constexpr double kClearGap = 1e-4;

// A solid that is known by how far it reaches in a direction.
struct Solid {
    Vec3 centre;
    Mat3 R;
    int type;
    Vec3 size;

    Solid(const mjModel *m, const mjData *d, int g)
        : centre(Eigen::Map<const Vec3>(d->geom_xpos + 3 * g)),
          R(Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(d->geom_xmat + 9 * g)),
          type(m->geom_type[g]), size(Eigen::Map<const Vec3>(m->geom_size + 3 * g))
    {
    }

    // From the centre along a unit vector.
    double reach(const Vec3 &direction) const
    {
        const Vec3 n = R.transpose() * direction;
        switch (type) {
        case mjGEOM_CAPSULE:
            return size[0] + size[1] * std::abs(n.z());
        case mjGEOM_CYLINDER:
            return size[0] * std::hypot(n.x(), n.y()) + size[1] * std::abs(n.z());
        case mjGEOM_ELLIPSOID:
            return size.cwiseProduct(n).norm();
        default: // a box
            return size.dot(n.cwiseAbs());
        }
    }
    // Half length of the axis, along z, that the solid lies around.
    double axis() const
    {
        return type == mjGEOM_CAPSULE || type == mjGEOM_CYLINDER ? size[1] : 0;
    }
};

// From the nearest point of one solid's axis to that of the other's.
Vec3 between_axes(const Solid &a, const Solid &b)
{
    const Vec3 u = a.R.col(2), v = b.R.col(2), apart = b.centre - a.centre;
    const double uv = u.dot(v), across = 1 - uv * uv;
    const auto within = [](double x, double half) { return std::min(std::max(x, -half), half); };
    double s = across > 0 ? within((apart.dot(u) - uv * apart.dot(v)) / across, a.axis()) : 0;
    const double t = within(s * uv - apart.dot(v), b.axis());
    s = within(t * uv + apart.dot(u), a.axis());
    return apart + t * v - s * u;
}

// Whether a plane lies between the solids with room to spare. It is looked for where it is found at once: across the line
// between their axes, and along the faces of a box. That it is not found means nothing.
bool clearly_apart(const Solid &a, const Solid &b, double margin)
{
    const Vec3 apart = b.centre - a.centre;
    const auto divides = [&](const Vec3 &n) {
        return std::abs(apart.dot(n)) - a.reach(n) - b.reach(n) > margin + kClearGap;
    };
    const Vec3 line = between_axes(a, b);
    const double length = line.norm();
    if (length > 0 && divides(line / length))
        return true;
    for (const Solid *solid : {&a, &b})
        for (int i = 0; i < 3 && solid->type == mjGEOM_BOX; ++i)
            if (divides(solid->R.col(i)))
                return true;
    return false;
}

mjfCollision general_search = nullptr;

int search_near(const mjModel *m, const mjData *d, mjContact *contact, int g1, int g2, mjtNum margin)
{
    return clearly_apart(Solid(m, d, g1), Solid(m, d, g2), margin) ? 0 : general_search(m, d, contact, g1, g2, margin);
}

} // namespace

void install_contact_shapes()
{
    general_search = mjCOLLISIONFUNC[mjGEOM_CAPSULE][mjGEOM_CYLINDER];
    for (const int a : {mjGEOM_CAPSULE, mjGEOM_ELLIPSOID, mjGEOM_CYLINDER, mjGEOM_BOX})
        for (const int b : {mjGEOM_CAPSULE, mjGEOM_ELLIPSOID, mjGEOM_CYLINDER, mjGEOM_BOX})
            if (mjCOLLISIONFUNC[a][b] == general_search)
                mjCOLLISIONFUNC[a][b] = search_near;
    mjCOLLISIONFUNC[mjGEOM_SPHERE][mjGEOM_ELLIPSOID] = sphere_ellipsoid;
    mjCOLLISIONFUNC[mjGEOM_SPHERE][mjGEOM_CYLINDER] = sphere_cylinder;
}

} // namespace aminn::sim
