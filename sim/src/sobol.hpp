// Sobol' points: they fill the unit cube more evenly than random ones, each by its index alone.
#pragma once

#include "random.hpp"

#include <array>
#include <cstddef>
#include <cstdint>

namespace aminn::sim {

// Primitive polynomials and initial direction numbers: S. Joe and F. Y. Kuo, Constructing Sobol sequences with better
// two-dimensional projections, SIAM J. Sci. Comput. 30 (2008), table new-joe-kuo-6; the first dimension has none.
struct SobolDimension {
    int degree;
    std::uint32_t polynomial; // inner coefficients as bits
    std::array<std::uint32_t, 5> initial;
};
inline constexpr std::array<SobolDimension, 9> kSobolDimensions = {{{1, 0, {1}},
                                                                    {2, 1, {1, 3}},
                                                                    {3, 1, {1, 3, 1}},
                                                                    {3, 2, {1, 1, 1}},
                                                                    {4, 1, {1, 1, 3, 3}},
                                                                    {4, 4, {1, 3, 5, 13}},
                                                                    {5, 2, {1, 1, 5, 5, 17}},
                                                                    {5, 4, {1, 1, 5, 5, 5}},
                                                                    {5, 7, {1, 1, 7, 11, 19}}}};

class Sobol {
  public:
    static constexpr std::size_t kDimensions = kSobolDimensions.size() + 1;
    using Point = std::array<double, kDimensions>;

    Sobol()
    {
        for (std::size_t i = 0; i < 32; ++i)
            direction_[0][i] = 1U << (31 - i);
        for (std::size_t k = 1; k < kDimensions; ++k)
            fill(direction_[k], kSobolDimensions[k - 1]);
    }

    // Point number `index`, in [0, 1).
    Point point(std::uint32_t index) const
    {
        return shifted(index, {});
    }
    // The same under a random digital shift, which keeps the points' evenness.
    Point point(std::uint32_t index, Random shift) const
    {
        Bits by;
        for (auto &s : by)
            s = static_cast<std::uint32_t>(shift.uniform() * 0x1.0p32);
        return shifted(index, by);
    }

  private:
    using Directions = std::array<std::uint32_t, 32>;
    using Bits = std::array<std::uint32_t, kDimensions>;

    Point shifted(std::uint32_t index, const Bits &shift) const
    {
        Point x;
        for (std::size_t k = 0; k < kDimensions; ++k) {
            std::uint32_t bits = shift[k];
            for (std::size_t i = 0; i < 32; ++i)
                bits ^= ((index >> i) & 1U) * direction_[k][i];
            x[k] = bits * 0x1.0p-32;
        }
        return x;
    }

    static void fill(Directions &v, const SobolDimension &dimension)
    {
        const auto s = static_cast<std::size_t>(dimension.degree);
        for (std::size_t i = 0; i < s; ++i)
            v[i] = dimension.initial[i] << (31 - i);
        for (std::size_t i = s; i < 32; ++i) {
            v[i] = v[i - s] ^ (v[i - s] >> s);
            for (std::size_t k = 1; k < s; ++k)
                v[i] ^= ((dimension.polynomial >> (s - 1 - k)) & 1U) * v[i - k];
        }
    }

    std::array<Directions, kDimensions> direction_{};
};

} // namespace aminn::sim
