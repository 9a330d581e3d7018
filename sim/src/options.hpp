// Every number that decides what a simulation does, and its range: outside of it a loop would not end, a division would
// have no result, or the engine would give up. The Python dataclass SimulationConfig has the same fields with the same
// defaults and says what each means; a test compares the two.
#pragma once

// X(type, name, default, least, greatest)
#define AMINN_SIM_OPTIONS(X)                        \
    /* tools */                                     \
    X(double, radius_min_m, 0.008, 1e-4, 1)         \
    X(double, radius_max_m, 0.025, 1e-4, 1)         \
    X(double, mass_min_kg, 0.02, 1e-4, 100)         \
    X(double, mass_max_kg, 0.3, 1e-4, 100)          \
    X(double, friction_min, 0.4, 1e-3, 10)          \
    X(double, friction_max, 1.1, 1e-3, 10)          \
    X(double, pinch_force_min_N, 3.0, 1e-3, 1e4)    \
    X(double, pinch_force_max_N, 9.0, 1e-3, 1e4)    \
    /* making a grasp */                            \
    X(double, close_s, 0.30, 1e-3, 60)              \
    X(double, dwell_s, 0.10, 1e-3, 60)              \
    X(double, release_s, 0.15, 1e-3, 60)            \
    X(double, grasp_settle_max_s, 2.0, 1e-3, 600)   \
    X(double, grasp_drift_max_m_s, 2e-6, 1e-12, 10) \
    X(double, grasp_shift_max_m, 0.012, 1e-9, 10)   \
    X(double, grasp_tilt_max_rad, 0.35, 1e-9, 4)    \
    X(double, contact_force_min_N, 0.5, 1e-9, 1e6)  \
    X(int, grasp_attempts, 500, 1, 1000000)         \
    /* loads */                                     \
    X(double, force_min_N, 0.1, 1e-6, 1e4)          \
    X(double, force_max_N, 20.0, 1e-6, 1e4)         \
    X(double, moment_min_Nm, 0.0025, 1e-9, 1e3)     \
    X(double, moment_max_Nm, 0.5, 1e-9, 1e3)        \
    X(double, share_force, 0.25, 0, 1)              \
    X(double, share_moment, 0.20, 0, 1)             \
    X(double, share_point_force, 0.30, 0, 1)        \
    /* label protocol */                            \
    X(double, ramp_s, 0.20, 1e-3, 60)               \
    X(double, hold_s, 0.15, 1e-3, 600)              \
    X(double, hold_max_s, 2.0, 1e-3, 600)           \
    X(double, drift_window_s, 0.05, 1e-3, 60)       \
    X(double, drift_stop_m_s, 1e-6, 1e-12, 10)      \
    X(double, drift_max_m_s, 2e-5, 1e-12, 10)       \
    X(double, lost_contact_s, 0.02, 1e-3, 600)      \
    X(double, translation_max_m, 0.010, 1e-9, 10)   \
    X(double, rotation_max_rad, 0.35, 1e-9, 4)      \
    X(double, stop_factor, 2.0, 1, 1e6)             \
    X(double, tool_left_m, 0.05, 1e-9, 10)          \
    X(double, noise_share, 0.02, 0, 1)

namespace aminn::sim {

struct Options {
#define AMINN_SIM_FIELD(type, name, value, least, greatest) type name = value;
    AMINN_SIM_OPTIONS(AMINN_SIM_FIELD)
#undef AMINN_SIM_FIELD
};

// The engine's time steps that are taken, s.
inline constexpr double kLeastTimestep_s = 1e-5, kGreatestTimestep_s = 0.05;

// Throws std::invalid_argument that names the first option that cannot be simulated with this time step (s).
void check_options(const Options &options, double timestep_s);

} // namespace aminn::sim
