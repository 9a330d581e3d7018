// A fuzz input, read from its first byte on. What it lacks stays as it was, so that a shortened input is a plausible one.
#ifndef AMINN_FUZZ_BYTES_HPP
#define AMINN_FUZZ_BYTES_HPP

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "aminn_rt.h"

namespace fuzz {

class Bytes {
  public:
    Bytes(const uint8_t *data, size_t size) : data_(data), left_(size)
    {
    }
    template <class T>
    void take(T &value)
    {
        const size_t n = std::min(left_, sizeof value);
        if (n > 0) {
            std::memcpy(&value, data_, n);
        }
        data_ += n;
        left_ -= n;
    }
    uint8_t byte()
    {
        uint8_t value = 0;
        take(value);
        return value;
    }
    size_t left() const
    {
        return left_;
    }

  private:
    const uint8_t *data_;
    size_t left_;
};

// Back to what is checked before the networks run: finite, flags in [0, 1], unit normals, a short rotation. T is a state or
// an input.
template <class T>
void repair(T &in)
{
    auto *values = reinterpret_cast<float *>(&in);
    for (size_t i = 0; i < sizeof in / sizeof *values; ++i) {
        values[i] = std::isfinite(values[i]) ? values[i] : 1.0F;
    }
    for (auto &contact : in.contacts) {
        contact[0] = std::min(std::fabs(contact[0]), 1.0F);
        const float length = std::hypot(contact[4], contact[5], contact[6]);
        for (int i = 4; i < 7; ++i) {
            contact[i] = length > 0.0F && std::isfinite(length) ? contact[i] / length : (i == 4 ? 1.0F : 0.0F);
        }
    }
    for (int i = 3; i < 6; ++i) {
        in.x_ht[i] = std::fmod(in.x_ht[i], 1.8F);
    }
}

// Whether theta is within its bounds, written once more.
inline aminn_status_t expected_of_theta(const float *theta)
{
    for (int i = 0; i < AMINN_N_THETA; ++i) {
        if (!std::isfinite(theta[i])) {
            return AMINN_E_NONFINITE;
        }
    }
    for (int i = 0; i < AMINN_N_THETA; ++i) {
        const float bound = i < AMINN_N_FACTOR      ? AMINN_MAX_LOG_FACTOR
                            : i < AMINN_N_THETA - 1 ? AMINN_MAX_ZERO
                                                    : AMINN_MAX_RADIUS;
        if (std::fabs(theta[i]) > bound) {
            return AMINN_E_CALIBRATION;
        }
    }
    return AMINN_OK;
}

// Likewise of sensors.
inline bool are_sensors(const aminn_sensors_t &s)
{
    const auto *numbers = reinterpret_cast<const float *>(&s);
    for (size_t i = 0; i < sizeof s / sizeof *numbers; ++i) {
        if (!std::isfinite(numbers[i])) {
            return false;
        }
    }
    const auto is_flag = [](float v) { return v == 0.0F || v == 1.0F; };
    return is_flag(s.friction[0]) && is_flag(s.tool_weight[0]) && is_flag(s.tendon_tension[0]) &&
           (s.friction[0] == 0.0F || (s.friction[1] > 0.0F && s.friction[2] >= 0.0F));
}

} // namespace fuzz

#endif
