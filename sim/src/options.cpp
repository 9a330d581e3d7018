#include "options.hpp"

#include <sstream>
#include <stdexcept>

namespace aminn::sim {

namespace {

struct Duration {
    const char *name;
    double Options::*value;
};
constexpr Duration kDurations[] = {
    {"close_s", &Options::close_s},
    {"dwell_s", &Options::dwell_s},
    {"release_s", &Options::release_s},
    {"grasp_settle_max_s", &Options::grasp_settle_max_s},
    {"ramp_s", &Options::ramp_s},
    {"hold_s", &Options::hold_s},
    {"hold_max_s", &Options::hold_max_s},
    {"drift_window_s", &Options::drift_window_s},
    {"lost_contact_s", &Options::lost_contact_s},
};

void check_range(const char *name, double value, double least, double greatest)
{
    if (value >= least && value <= greatest) // NaN is in no range
        return;
    std::ostringstream text;
    text << name << " is " << value << ", expected " << least << " to " << greatest;
    throw std::invalid_argument(text.str());
}

} // namespace

void check_options(const Options &options, double timestep_s)
{
    check_range("the model's time step, s,", timestep_s, kLeastTimestep_s, kGreatestTimestep_s);
#define AMINN_SIM_CHECK(type, name, value, least, greatest) check_range(#name, options.name, least, greatest);
    AMINN_SIM_OPTIONS(AMINN_SIM_CHECK)
#undef AMINN_SIM_CHECK
    for (const Duration &duration : kDurations) {
        if (options.*duration.value >= timestep_s)
            continue;
        std::ostringstream text;
        text << duration.name << " is " << options.*duration.value << ", expected at least the model's time step, "
             << timestep_s << " s";
        throw std::invalid_argument(text.str());
    }
}

} // namespace aminn::sim
