// Any model in the engine: its arrays, and single calls. For reading a hand's description and holding it against the
// engine; the labelled simulation has its own, faster ways (grasp.hpp).
#pragma once

#include <nanobind/nanobind.h>

namespace aminn::sim {

void bind_engine(nanobind::module_ &m);

} // namespace aminn::sim
