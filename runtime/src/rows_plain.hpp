// Rows as arrays, of any machine.
#ifndef AMINN_SRC_ROWS_PLAIN_HPP
#define AMINN_SRC_ROWS_PLAIN_HPP

#include "components.hpp"
#include "row_sums.hpp"

namespace aminn {
inline namespace AMINN_CORE {

using Row = Components<float, kMotion>;

} // namespace AMINN_CORE
} // namespace aminn

#endif
