#include "tool.hpp"

#include "contact_shapes.hpp"

#include <algorithm>

namespace aminn::sim {

const std::array<const char *, kToolFamilies> kToolFamilyNames = {"cylinder", "capsule", "ellipsoid", "screwdriver"};

namespace {

struct Range {
    double low, high;
    // u in [0, 1)
    double at(double u) const
    {
        return low + (high - low) * u;
    }
    double draw(Random &random) const
    {
        return at(random.uniform());
    }
};

// m, unless said otherwise.
constexpr Range kCylinderHalfLength{0.045, 0.080}, kCapsuleHalfLength{0.040, 0.070}; // of a capsule: without its caps
constexpr Range kEllipsoidHalfLength{0.035, 0.060}, kEllipsoidWidthRatio{0.8, 1.25}; // half width over half thickness
constexpr Range kGripHalfLength{0.040, 0.055}, kShaftLength{0.060, 0.110}, kShaftRadius{0.0025, 0.004};
constexpr double kShaftDensityRatio = 6.5;                  // steel (7800 kg/m^3) over the grip's plastic (1200 kg/m^3)
constexpr Range kClearance{0.0015, 0.0035};                 // between a fingertip and the tool before closing
constexpr Range kShiftX{-0.012, 0.012}, kShiftZ{-0.2, 0.2}; // the latter in units of the half thickness
constexpr double kTilt[3] = {0.0, 0.15, 0.10};              // rad, greatest, about the tool's own axes
constexpr double kEllipsoidTilt[3] = {0.10, 0.15, 0.10};
constexpr double kEllipsoidShift = 0.25; // of the shifts of the other families: its surface curves away
constexpr double kEllipsoidSpan = 0.6;   // half distance of the fingers, at most, in units of the half length
constexpr int kTouchesAll = 0x7fffffff;  // bits of what a geom of the tool collides with

// A solid of revolution about x, of density 1: moments are about its own centre of mass.
struct Solid {
    double mass, x, axial, across;
};

Solid cylinder(double r, double half, double x)
{
    const double m = 2 * M_PI * r * r * half;
    return {m, x, 0.5 * m * r * r, m * (0.25 * r * r + half * half / 3)};
}
// The dome points along +x (side 1) or -x (side -1) from its flat face at x.
Solid hemisphere(double r, double x, double side)
{
    const double m = 2.0 / 3.0 * M_PI * r * r * r;
    return {m, x + side * 0.375 * r, 0.4 * m * r * r, 83.0 / 320.0 * m * r * r};
}

struct MassProperties {
    double mass = 0, x = 0;
    Vec3 inertia = Vec3::Zero();
};

MassProperties combine(const std::vector<Solid> &solids)
{
    MassProperties out;
    for (const Solid &s : solids)
        out.mass += s.mass, out.x += s.mass * s.x;
    out.x /= out.mass;
    for (const Solid &s : solids) {
        const double across = s.across + s.mass * (s.x - out.x) * (s.x - out.x);
        out.inertia += Vec3(s.axial, across, across);
    }
    return out;
}

// Sets mass and inertia from the solids and moves the origin into the centre of mass.
void weigh(Tool &tool, const std::vector<Solid> &solids)
{
    const MassProperties p = combine(solids);
    tool.inertia_kgm2 = p.inertia * (tool.mass_kg / p.mass);
    tool.grip_x_m -= p.x;
    tool.reach_low_m -= p.x;
    tool.reach_high_m -= p.x;
    for (Primitive &g : tool.geoms)
        g.x_m -= g.used ? p.x : 0;
}

void make_cylinder(Tool &tool, double r, double half)
{
    tool.half_m << half, r, r;
    tool.geoms[0] = {mjGEOM_CYLINDER, true, Vec3(r, half, 0), 0};
    tool.reach_low_m = -half, tool.reach_high_m = half;
    weigh(tool, {cylinder(r, half, 0)});
}

void make_capsule(Tool &tool, double r, double half)
{
    tool.half_m << half + r, r, r;
    tool.geoms[0] = {mjGEOM_CAPSULE, true, Vec3(r, half, 0), 0};
    tool.reach_low_m = -half - r, tool.reach_high_m = half + r;
    weigh(tool, {cylinder(r, half, 0), hemisphere(r, half, 1), hemisphere(r, -half, -1)});
}

void make_ellipsoid(Tool &tool, const Vec3 &half)
{
    tool.half_m = half;
    tool.geoms[0] = {mjGEOM_ELLIPSOID, true, half, 0};
    tool.reach_low_m = -half.x(), tool.reach_high_m = half.x();
    const Vec3 s = half.cwiseProduct(half) * (tool.mass_kg / 5);
    tool.inertia_kgm2 << s.y() + s.z(), s.x() + s.z(), s.x() + s.y();
}

// A grip (cylinder) with a round butt and a shaft; x runs from the butt to the blade.
void make_screwdriver(Tool &tool, double r, double half, double shaft_length, double shaft_radius)
{
    tool.half_m << half, r, r;
    const double shaft_half = 0.5 * shaft_length - shaft_radius, shaft_x = half + 0.5 * shaft_length - shaft_radius;
    tool.geoms[0] = {mjGEOM_CYLINDER, true, Vec3(r, half, 0), 0};
    tool.geoms[1] = {mjGEOM_SPHERE, true, Vec3(r, 0, 0), -half};
    tool.geoms[2] = {mjGEOM_CAPSULE, true, Vec3(shaft_radius, shaft_half, 0), shaft_x};
    tool.reach_low_m = -half - r, tool.reach_high_m = shaft_x + shaft_half + shaft_radius;
    Solid shaft = cylinder(shaft_radius, 0.5 * shaft_length, half + 0.5 * shaft_length);
    for (double *x : {&shaft.mass, &shaft.axial, &shaft.across})
        *x *= kShaftDensityRatio;
    weigh(tool, {cylinder(r, half, 0), hemisphere(r, -half, -1), shaft});
}

// Half thickness of an ellipsoid that has `clearance` to the thumb, at the origin, and to a finger beside the y axis.
// Negative where there is none in the range.
double ellipsoid_thickness(const Range &range, double half_length, double ratio, double gap, double half_span,
                           double thumb, double finger)
{
    const auto room = [&](double b) { // at the finger, more than asked
        const Vec3 point(half_span, gap - thumb - b, 0);
        return nearest_on_ellipsoid(Vec3(half_length, b, ratio * b), point).distance - finger;
    };
    double low = range.low, high = range.high;
    if (room(low) < 0 || room(high) > 0)
        return -1;
    for (int i = 0; i < 60; ++i) {
        const double middle = 0.5 * (low + high);
        (room(middle) > 0 ? low : high) = middle;
    }
    return low;
}

} // namespace

std::array<double, 4> Primitive::quaternion() const
{
    if (type != mjGEOM_CYLINDER && type != mjGEOM_CAPSULE)
        return {1, 0, 0, 0};
    return {std::sqrt(0.5), 0, std::sqrt(0.5), 0}; // MuJoCo has their axis along z
}

double Primitive::reach_m() const
{
    switch (type) {
    case mjGEOM_CYLINDER:
        return std::hypot(size[0], size[1]);
    case mjGEOM_CAPSULE:
        return size[0] + size[1];
    default:
        return size.maxCoeff();
    }
}

Vec3 Tool::surface_point(double along, double angle) const
{
    const double x = reach_low_m + along * (reach_high_m - reach_low_m);
    Vec3 radius = half_m;
    if (family == ToolFamily::ellipsoid)
        radius *= std::sqrt(std::max(0.0, 1 - x * x / (half_m.x() * half_m.x())));
    else if (geoms[2].used && x > grip_x_m + half_m.x())
        radius.setConstant(geoms[2].size[0]);
    return {x, radius.y() * std::cos(angle), radius.z() * std::sin(angle)};
}

bool draw_tool(Random &random, const Options &options, ToolFamily family, const Placement &placement,
               const Pinch &pinch, Tool &tool, Pose &tool_in_palm)
{
    tool = Tool();
    tool.family = family;
    tool.mass_kg = random.log_uniform(options.mass_min_kg, options.mass_max_kg);
    tool.friction = random.uniform(options.friction_min, options.friction_max);
    const double clearance = kClearance.draw(random);

    // the pinch axis runs from the middle of the second side (a thumb) to that of the first (fingers)
    const Vec3 span = pinch.first - pinch.second;
    const double gap = span.norm(), thumb = pinch.second_reach + clearance, finger = pinch.first_reach + clearance;
    if (span.dot(pinch.forward) < 0)
        return false; // the sides have passed each other
    const Vec3 y = span / gap, x = (pinch.tool_axis - pinch.tool_axis.dot(y) * y).normalized();
    Mat3 R;
    R << x, y, x.cross(y);

    const Range radius{options.radius_min_m, options.radius_max_m};
    double thickness = 0.5 * (gap - thumb - finger), shift_scale = 1;
    const double *tilt_max = kTilt;
    const bool fits = radius.low <= thickness && thickness <= radius.high;
    switch (family) {
    case ToolFamily::cylinder:
        if (!fits)
            return false;
        make_cylinder(tool, thickness, kCylinderHalfLength.draw(random));
        break;
    case ToolFamily::capsule:
        if (!fits)
            return false;
        make_capsule(tool, thickness, kCapsuleHalfLength.draw(random));
        break;
    case ToolFamily::screwdriver: {
        if (!fits)
            return false;
        const double half = kGripHalfLength.draw(random), shaft = kShaftLength.draw(random);
        make_screwdriver(tool, thickness, half, shaft, kShaftRadius.draw(random));
        break;
    }
    case ToolFamily::ellipsoid: {
        const double half_span = pinch.half_span, half = kEllipsoidHalfLength.draw(random);
        const double ratio = kEllipsoidWidthRatio.draw(random);
        thickness = ellipsoid_thickness(radius, half, ratio, gap, half_span, thumb, finger);
        if (thickness < 0 || half_span > kEllipsoidSpan * half)
            return false;
        make_ellipsoid(tool, Vec3(half, thickness, ratio * thickness));
        tilt_max = kEllipsoidTilt;
        shift_scale = kEllipsoidShift;
        break;
    }
    }
    const Vec3 shift(shift_scale * kShiftX.at(placement.shift_x) - tool.grip_x_m, 0,
                     shift_scale * kShiftZ.at(placement.shift_z) * thickness);
    const Vec3 tilt = (2 * placement.tilt - Vec3::Ones()).cwiseProduct(Vec3(tilt_max[0], tilt_max[1], tilt_max[2]));
    const Mat3 turn(Eigen::AngleAxisd(tilt.norm(), tilt.norm() > 0 ? Vec3(tilt.normalized()) : Vec3::UnitX()));
    // turned about the grip's centre
    const Vec3 grip(tool.grip_x_m, 0, 0);
    tool_in_palm.R = R * turn;
    tool_in_palm.p = pinch.second + (thumb + thickness) * y + R * (shift + grip) - tool_in_palm.R * grip;
    return true;
}

void install_tool(mjModel &m, mjData &d, const Hand &hand, const Tool &tool)
{
    for (int k = 0; k < kToolGeoms; ++k) {
        const Primitive &primitive = tool.geoms[static_cast<std::size_t>(k)];
        const int g = hand.tool_geoms[static_cast<std::size_t>(k)];
        m.geom_type[g] = primitive.type;
        m.geom_contype[g] = m.geom_conaffinity[g] = primitive.used ? kTouchesAll : 0;
        m.geom_sameframe[g] = 0;
        m.geom_rbound[g] = primitive.reach_m();
        m.geom_friction[3 * g] = tool.friction;
        const std::array<double, 4> quaternion = primitive.quaternion();
        for (int i = 0; i < 3; ++i) {
            m.geom_size[3 * g + i] = primitive.size[i];
            m.geom_pos[3 * g + i] = i == 0 ? primitive.x_m : 0;
        }
        std::copy(quaternion.begin(), quaternion.end(), m.geom_quat + 4 * g);
    }
    m.body_mass[hand.tool_body] = tool.mass_kg;
    for (int i = 0; i < 3; ++i)
        m.body_inertia[3 * hand.tool_body + i] = tool.inertia_kgm2[i];
    guarded([&] { mj_setConst(&m, &d), mj_resetData(&m, &d); });
}

} // namespace aminn::sim
