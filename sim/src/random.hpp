// Random numbers whose values depend on the seed alone: not on the thread, the compiler or the standard library.
#pragma once

#include <cmath>
#include <cstdint>

#include <Eigen/Dense>

namespace aminn::sim {

// xoshiro256** (Blackman and Vigna), state filled by SplitMix64 from a chain of keys.
class Random {
  public:
    // One stream for each (seed, shard, grasp).
    Random(std::uint64_t seed, std::uint64_t shard, std::uint64_t grasp)
    {
        std::uint64_t mix = seed;
        for (const std::uint64_t key : {shard, grasp})
            mix = split_mix(mix) ^ (key * 0xD1342543DE82EF95ULL + 1);
        for (auto &word : state_)
            word = split_mix(mix);
    }

    // Uniform in [0, 1).
    double uniform()
    {
        return static_cast<double>(next() >> 11) * 0x1.0p-53;
    }
    double uniform(double low, double high)
    {
        return low + (high - low) * uniform();
    }
    double log_uniform(double low, double high)
    {
        return low * std::pow(high / low, uniform());
    }
    // Uniform integer in [0, n).
    int index(int n)
    {
        return static_cast<int>(uniform() * n);
    }

    // Uniform on the unit sphere.
    Eigen::Vector3d direction()
    {
        const double z = uniform(-1, 1), angle = uniform(0, 2 * M_PI), s = std::sqrt(1 - z * z);
        return {s * std::cos(angle), s * std::sin(angle), z};
    }

  private:
    static std::uint64_t split_mix(std::uint64_t &x)
    {
        std::uint64_t z = (x += 0x9E3779B97F4A7C15ULL);
        z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ULL;
        z = (z ^ (z >> 27)) * 0x94D049BB133111EBULL;
        return z ^ (z >> 31);
    }
    static std::uint64_t rotl(std::uint64_t x, int k)
    {
        return (x << k) | (x >> (64 - k));
    }
    std::uint64_t next()
    {
        const std::uint64_t result = rotl(state_[1] * 5, 7) * 9, t = state_[1] << 17;
        state_[2] ^= state_[0];
        state_[3] ^= state_[1];
        state_[1] ^= state_[2];
        state_[0] ^= state_[3];
        state_[2] ^= t;
        state_[3] = rotl(state_[3], 45);
        return result;
    }
    std::uint64_t state_[4];
};

} // namespace aminn::sim
