#include "tool.hpp"

namespace aminn::sim {

const std::array<const char *, kToolFamilies> kToolFamilyNames = {"handle", "block", "ball"};

namespace {

struct Range {
    double low, high;
    bool holds(double x) const
    {
        return low <= x && x <= high;
    }
    double draw(Random &random) const
    {
        return random.uniform(low, high);
    }
};

// Half thickness (or radius) that a family may have, and its other half extents, m.
constexpr Range kHandleRadius{0.008, 0.022}, kHandleHalfLength{0.045, 0.080};
constexpr Range kBlockHalfThickness{0.007, 0.022}, kBlockHalfLength{0.040, 0.070}, kBlockHalfWidth{0.014, 0.022};
constexpr Range kBallRadius{0.013, 0.026};
constexpr Range kClearance{0.0015, 0.0035}; // between a fingertip and the tool before closing

double capsule_volume(double r, double h)
{
    return M_PI * r * r * h + 4.0 / 3.0 * M_PI * r * r * r;
}

} // namespace

Vec3 Tool::inertia_kgm2() const
{
    switch (family) {
    case ToolFamily::handle: {
        const double r = half_m.y(), h = 2 * (half_m.x() - r); // cylinder of length h with hemispherical caps
        const double density = mass_kg / capsule_volume(r, h);
        const double mc = density * M_PI * r * r * h, ms = mass_kg - mc;
        const double axial = 0.5 * mc * r * r + 0.4 * ms * r * r;
        const double across = mc * (h * h / 12 + r * r / 4) + ms * (0.4 * r * r + h * h / 4 + 0.375 * h * r);
        return {axial, across, across};
    }
    case ToolFamily::block: {
        const Vec3 s = half_m.cwiseProduct(half_m) * (mass_kg / 3);
        return {s.y() + s.z(), s.x() + s.z(), s.x() + s.y()};
    }
    case ToolFamily::ball:
        break;
    }
    return Vec3::Constant(0.4 * mass_kg * half_m.x() * half_m.x());
}

bool draw_tool(Random &random, const Options &options, ToolFamily family, const std::array<Vec3, kBranches> &tip,
               const std::array<double, kBranches> &tip_radius, Tool &tool, Pose &tool_in_palm)
{
    tool.family = family;
    tool.mass_kg = random.log_uniform(options.mass_min_kg, options.mass_max_kg);
    tool.friction = random.uniform(options.friction_min, options.friction_max);
    const double clearance = kClearance.draw(random);

    // the pinch axis runs from the thumb to the middle between the fingers
    const Vec3 middle = 0.5 * (tip[0] + tip[1]), span = middle - tip[2];
    const double gap = span.norm(), thumb = tip_radius[2] + clearance, finger = tip_radius[0] + clearance;
    if (span.y() < 0)
        return false; // the fingers have passed the thumb
    const Vec3 y = span / gap, x = (Vec3::UnitX() - y.x() * y).normalized();
    Mat3 R;
    R << x, y, x.cross(y);

    double half_thickness = 0.5 * (gap - thumb - finger);
    Vec3 tilt = Vec3::Zero(); // small turns about the tool's own axes
    Vec3 shift = Vec3::Zero();
    switch (family) {
    case ToolFamily::handle:
        if (!kHandleRadius.holds(half_thickness))
            return false;
        tool.half_m << kHandleHalfLength.draw(random) + half_thickness, half_thickness, half_thickness;
        tilt << 0, random.uniform(-0.12, 0.12), random.uniform(-0.10, 0.10);
        shift << random.uniform(-0.012, 0.012), 0, random.uniform(-0.2, 0.2) * half_thickness;
        break;
    case ToolFamily::block:
        if (!kBlockHalfThickness.holds(half_thickness))
            return false;
        tool.half_m << kBlockHalfLength.draw(random), half_thickness, kBlockHalfWidth.draw(random);
        tilt << random.uniform(-0.10, 0.10), random.uniform(-0.25, 0.25), random.uniform(-0.10, 0.10);
        shift << random.uniform(-0.012, 0.012), 0, random.uniform(-0.005, 0.005);
        break;
    case ToolFamily::ball: {
        // the fingertips sit beside the pinch axis: the sphere that all three tips are equally far from
        const double half_span = 0.5 * (tip[0] - tip[1]).norm();
        const double radius = (gap * (gap - 2 * thumb) + thumb * thumb + half_span * half_span - finger * finger) /
                              (2 * (gap - thumb + finger));
        if (!kBallRadius.holds(radius) || half_span > 0.6 * (radius + tip_radius[0]))
            return false;
        half_thickness = radius;
        tool.half_m.setConstant(radius);
        shift << random.uniform(-0.0015, 0.0015), 0, random.uniform(-0.0015, 0.0015);
        break;
    }
    }
    tool_in_palm.p = tip[2] + (thumb + half_thickness) * y + R * shift;
    tool_in_palm.R = R * Eigen::AngleAxisd(tilt.norm(), tilt.norm() > 0 ? Vec3(tilt.normalized()) : Vec3::UnitX());
    return true;
}

void install_tool(mjModel &m, mjData &d, const Hand &hand, const Tool &tool)
{
    const int g = hand.tool_geom, b = hand.tool_body;
    mjtNum *size = m.geom_size + 3 * g, *quat = m.geom_quat + 4 * g;
    const mjtNum turned[4] = {std::sqrt(0.5), 0, std::sqrt(0.5), 0}; // a capsule's own axis is z; the tool's is x
    mju_zero3(size);
    mju_unit4(quat);
    m.geom_sameframe[g] = 0;
    switch (tool.family) {
    case ToolFamily::handle:
        m.geom_type[g] = mjGEOM_CAPSULE;
        size[0] = tool.half_m.y();
        size[1] = tool.half_m.x() - tool.half_m.y();
        mju_copy4(quat, turned);
        m.geom_rbound[g] = tool.half_m.x();
        break;
    case ToolFamily::block:
        m.geom_type[g] = mjGEOM_BOX;
        for (int i = 0; i < 3; ++i)
            size[i] = tool.half_m[i];
        m.geom_rbound[g] = tool.half_m.norm();
        break;
    case ToolFamily::ball:
        m.geom_type[g] = mjGEOM_SPHERE;
        size[0] = m.geom_rbound[g] = tool.half_m.x();
        break;
    }
    m.geom_friction[3 * g] = tool.friction;
    m.body_mass[b] = tool.mass_kg;
    const Vec3 inertia = tool.inertia_kgm2();
    for (int i = 0; i < 3; ++i)
        m.body_inertia[3 * b + i] = inertia[i];
    guarded([&] { mj_setConst(&m, &d), mj_resetData(&m, &d); });
}

} // namespace aminn::sim
