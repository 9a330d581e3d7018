// Tools: families of shapes with random size, mass and friction, set into a compiled model.
#pragma once

#include "hand.hpp"
#include "options.hpp"
#include "random.hpp"

namespace aminn::sim {

// The order is that of `tool_family` in a data set. Box against capsule and sphere or capsule against capsule have
// closed-form contacts in MuJoCo 2.2; general convex shapes do not.
enum class ToolFamily : int { handle = 0, block = 1, ball = 2 };
inline constexpr int kToolFamilies = 3;
extern const std::array<const char *, kToolFamilies> kToolFamilyNames;

struct Tool {
    ToolFamily family = ToolFamily::handle;
    Vec3 half_m =
        Vec3::Zero(); // half extents along the tool's axes; x is its long axis, y its thickness between the fingers
    double mass_kg = 0, friction = 0;
    Vec3 inertia_kgm2() const; // about the centre of mass, uniform density
};

// Draws shape and placement so that the tool fits between the fingertips at `tip` (m, H) of radius `tip_radius`.
// Gives false where no tool of this family fits.
bool draw_tool(Random &random, const Options &options, ToolFamily family, const std::array<Vec3, kBranches> &tip,
               const std::array<double, kBranches> &tip_radius, Tool &tool, Pose &tool_in_palm);

// Writes the tool into the model and recomputes what depends on it. `d` is scratch and is left reset.
void install_tool(mjModel &m, mjData &d, const Hand &hand, const Tool &tool);

} // namespace aminn::sim
