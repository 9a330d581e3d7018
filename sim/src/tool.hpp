// Tools: families of shapes with random size, mass and friction, set into a compiled model.
#pragma once

#include "hand.hpp"
#include "options.hpp"
#include "random.hpp"

namespace aminn::sim {

// The order is that of `tool_family` in a data set.
enum class ToolFamily : int { cylinder = 0, capsule = 1, ellipsoid = 2, screwdriver = 3 };
inline constexpr int kToolFamilies = 4;
extern const std::array<const char *, kToolFamilies> kToolFamilyNames;

// One geom of a tool, in the tool's frame. Cylinders and capsules lie along x.
struct Primitive {
    int type = mjGEOM_SPHERE;
    bool used = false;
    Vec3 size = Vec3::Constant(0.001); // as MuJoCo has it
    double x_m = 0;                    // position along the tool's axis

    std::array<double, 4> quaternion() const; // of the geom in the tool's frame; w x y z
    double reach_m() const;                   // radius of a sphere about its centre that holds it
};

// The tool's frame: origin in the centre of mass, x its long axis, y its thickness between the fingers.
struct Tool {
    ToolFamily family = ToolFamily::cylinder;
    Vec3 half_m = Vec3::Zero(); // half extents of the part that is held
    double grip_x_m = 0;        // centre of the part that is held, along x
    std::array<Primitive, kToolGeoms> geoms;
    double mass_kg = 0, friction = 0;
    Vec3 inertia_kgm2 = Vec3::Zero();         // about the centre of mass
    double reach_low_m = 0, reach_high_m = 0; // ends of the whole tool along x

    // A point of the surface, uniform along the tool's axis: `along` in [0, 1), `angle` about the axis (rad).
    Vec3 surface_point(double along, double angle) const;
};

// Where in the gap a tool goes, each in [0, 1): the part of a grasp that is sampled evenly.
struct Placement {
    double shift_x, shift_z;
    Vec3 tilt;
};

// Draws the shape and puts it between the fingertips. Gives false where no tool of this family fits.
bool draw_tool(Random &random, const Options &options, ToolFamily family, const Placement &placement,
               const Pinch &pinch, Tool &tool, Pose &tool_in_palm);

// Writes the tool into the model and recomputes what depends on it. `d` is scratch and is left reset.
void install_tool(mjModel &m, mjData &d, const Hand &hand, const Tool &tool);

} // namespace aminn::sim
