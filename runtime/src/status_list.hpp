// The status codes' numbers, which the lists of names and of texts rest on.
#ifndef AMINN_SRC_STATUS_LIST_HPP
#define AMINN_SRC_STATUS_LIST_HPP

#include "aminn_rt.h"
#include "words.hpp"

namespace aminn {

#define AMINN_VALUE(name, value, text) value,
constexpr int kStatuses[] = {AMINN_STATUS_LIST(AMINN_VALUE)};
#undef AMINN_VALUE
constexpr unsigned kStatusCount = sizeof kStatuses / sizeof *kStatuses;

constexpr bool statuses_count_down()
{
    for (unsigned i = 0; i < kStatusCount; ++i) {
        if (kStatuses[i] != -static_cast<int>(i)) {
            return false;
        }
    }
    return true;
}
static_assert(statuses_count_down(), "0, -1, -2, ...: their place in the list is their number");

// of a list with one more text, for what is no status code
inline const char *status_word(const char *all, int status)
{
    return text_of(all, 0u - static_cast<unsigned>(status), kStatusCount);
}

} // namespace aminn

#endif
