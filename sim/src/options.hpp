// Every number that decides what a simulation does. The Python dataclass SimulationConfig has the same fields with the
// same defaults and says what each means; a test compares the two.
#pragma once

// X(type, name, default)
#define AMINN_SIM_OPTIONS(X)             \
    /* tools */                          \
    X(double, radius_min_m, 0.008)       \
    X(double, radius_max_m, 0.025)       \
    X(double, mass_min_kg, 0.02)         \
    X(double, mass_max_kg, 0.3)          \
    X(double, friction_min, 0.4)         \
    X(double, friction_max, 1.1)         \
    X(double, pinch_force_min_N, 3.0)    \
    X(double, pinch_force_max_N, 9.0)    \
    /* making a grasp */                 \
    X(double, close_s, 0.30)             \
    X(double, dwell_s, 0.10)             \
    X(double, release_s, 0.15)           \
    X(double, grasp_settle_max_s, 2.0)   \
    X(double, grasp_drift_max_m_s, 2e-6) \
    X(double, grasp_shift_max_m, 0.012)  \
    X(double, grasp_tilt_max_rad, 0.35)  \
    X(double, contact_force_min_N, 0.5)  \
    X(int, grasp_attempts, 500)          \
    /* loads */                          \
    X(double, force_min_N, 0.1)          \
    X(double, force_max_N, 20.0)         \
    X(double, moment_min_Nm, 0.0025)     \
    X(double, moment_max_Nm, 0.5)        \
    X(double, share_force, 0.25)         \
    X(double, share_moment, 0.20)        \
    X(double, share_point_force, 0.30)   \
    /* label protocol */                 \
    X(double, ramp_s, 0.20)              \
    X(double, hold_s, 0.15)              \
    X(double, hold_max_s, 2.0)           \
    X(double, drift_window_s, 0.05)      \
    X(double, drift_stop_m_s, 1e-6)      \
    X(double, drift_max_m_s, 2e-5)       \
    X(double, lost_contact_s, 0.02)      \
    X(double, translation_max_m, 0.010)  \
    X(double, rotation_max_rad, 0.35)    \
    X(double, stop_factor, 2.0)          \
    X(double, tool_left_m, 0.05)         \
    X(double, noise_share, 0.02)

namespace aminn::sim {

struct Options {
#define AMINN_SIM_FIELD(type, name, value) type name = value;
    AMINN_SIM_OPTIONS(AMINN_SIM_FIELD)
#undef AMINN_SIM_FIELD
};

} // namespace aminn::sim
