// Constant texts by number, one behind the other: a list of pointers to them would be as long again.
#ifndef AMINN_SRC_WORDS_HPP
#define AMINN_SRC_WORDS_HPP

#include "compiler.hpp" // first

namespace aminn {

// How many texts there are.
template <unsigned size>
constexpr int texts_in(const char (&all)[size])
{
    int n = 0;
    for (const char c : all) {
        n += c == '\0';
    }
    return n;
}

// Text number n of those in `all`, each of which ends with a zero; the last one, number `last`, stands for all beyond.
inline const char *text_of(const char *all, unsigned n, unsigned last)
{
    for (n = n < last ? n : last; n > 0; --n) {
        while (*all++ != '\0') {
        }
    }
    return all;
}

} // namespace aminn

#endif
