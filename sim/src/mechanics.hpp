// A hand's mechanics parameters in the compiled model: the numbers that each of them scales. Which parameter acts on which
// part comes from Python (`aminn_hand.theta`).
#pragma once

#include "hand.hpp"

namespace aminn::sim {

// What one parameter acts on.
struct ParameterPart {
    std::string kind; // spring, servo, tendon or contact
    std::string part; // joint, tendon or branch
    int parameter;    // place in theta
};

class Mechanics {
  public:
    Mechanics() = default;
    // Keeps the model's present numbers as those of theta = 0. Throws MujocoError for a part that the model has nothing of.
    Mechanics(const mjModel &m, const Hand &hand, const std::vector<ParameterPart> &parts);

    // A number of the model: what it is at theta = 0, times exp(power theta).
    struct Number {
        const char *name; // of the array in mjModel
        mjtNum *mjModel::*array;
        int index, parameter;
        double nominal, power;

        double at(const Vector &theta) const;
    };
    const std::vector<Number> &numbers() const
    {
        return numbers_;
    }
    // How many entries of theta count; further ones change nothing.
    int parameters() const
    {
        return parameters_;
    }

    // Writes what theta makes of the numbers; what was written before is forgotten.
    void write(mjModel &m, const Vector &theta) const;
    // Lets the fingertips' contact parameters count in place of the tool's, of which they have all but the time constant.
    // To be called whenever the tool has changed.
    void rule_contacts(mjModel &m, const Hand &hand) const;

  private:
    void add(const mjModel &m, const char *name, mjtNum *mjModel::*array, int index, int parameter);
    void add_actuators(const mjModel &m, mjtTrn kind, int target, int parameter);
    std::vector<Number> numbers_;
    std::vector<int> tips_;
    int parameters_ = 0;
};

} // namespace aminn::sim
