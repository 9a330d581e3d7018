/*
 * aminn_rt.hpp - Eigen views of the runtime's inputs and outputs, for C++ users. Optional.
 *
 * Each function returns an Eigen::Map onto the given struct: no copy, no allocation; valid as long as the struct lives.
 * Pass a const struct to get a read-only view. Vectors are columns; matrices are row-major as in aminn_rt.h.
 *
 *     aminn_state_t state{};
 *     aminn::view::force(state) << 0.0F, 0.0F, -2.0F;     // N, axes of H
 *     ...
 *     Eigen::Vector3f shift = aminn::view::translation(out); // m, axes of H
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef AMINN_RT_HPP
#define AMINN_RT_HPP

#include <type_traits>

#include <Eigen/Core>

#include "aminn_rt.h"

namespace aminn {
namespace view {

// Eigen type of a matrix (R x C), row-major unless it is a column
template <int R, int C>
using Matrix = Eigen::Matrix<float, R, C, (C == 1 ? Eigen::ColMajor : Eigen::RowMajor)>;

// map that is const if T is
template <class T, int R, int C>
using Map = Eigen::Map<typename std::conditional<std::is_const<T>::value, const Matrix<R, C>, Matrix<R, C>>::type>;

/* ---- inputs: State is aminn_state_t or aminn_input_t ---- */

// joint angles, rad (J)
template <class State>
Map<State, AMINN_N_JOINT, 1> joints(State &state)
{
    return Map<State, AMINN_N_JOINT, 1>(state.q);
}

// position of the tool in H, m (3)
template <class State>
Map<State, 3, 1> tool_position(State &state)
{
    return Map<State, 3, 1>(state.x_ht);
}

// rotation vector of the tool in H, rad (3)
template <class State>
Map<State, 3, 1> tool_rotation(State &state)
{
    return Map<State, 3, 1>(state.x_ht + 3);
}

// load on the tool: force, N (3)
template <class State>
Map<State, 3, 1> force(State &state)
{
    return Map<State, 3, 1>(state.w_e);
}

// load on the tool: moment about its origin, N.m (3)
template <class State>
Map<State, 3, 1> moment(State &state)
{
    return Map<State, 3, 1>(state.w_e + 3);
}

// contact rows (B x 8)
template <class State>
Map<State, AMINN_N_BRANCH, AMINN_N_CONTACT_FEATURE> contacts(State &state)
{
    return Map<State, AMINN_N_BRANCH, AMINN_N_CONTACT_FEATURE>(&state.contacts[0][0]);
}

// closure Jacobian on the tool side of one branch (3 x 6)
template <class Input>
Map<Input, 3, AMINN_N_WRENCH> tool_jacobian(Input &input, int branch)
{
    return Map<Input, 3, AMINN_N_WRENCH>(&input.j_x[branch][0][0]);
}

// closure Jacobian on the joint side of one branch (3 x C), m/rad
template <class Input>
Map<Input, 3, AMINN_N_COORD> joint_jacobian(Input &input, int branch)
{
    return Map<Input, 3, AMINN_N_COORD>(&input.j_q[branch][0][0]);
}

/* ---- outputs: Output is aminn_output_t ---- */

// displacement of the tool in the hand (6): m, rad
template <class Output>
Map<Output, AMINN_N_WRENCH, 1> displacement(Output &out)
{
    return Map<Output, AMINN_N_WRENCH, 1>(out.dx_ht);
}

// its translation, m (3)
template <class Output>
Map<Output, 3, 1> translation(Output &out)
{
    return Map<Output, 3, 1>(out.dx_ht);
}

// its rotation vector, rad (3)
template <class Output>
Map<Output, 3, 1> rotation(Output &out)
{
    return Map<Output, 3, 1>(out.dx_ht + 3);
}

// stiffness of the grasped tool (6 x 6), SI
template <class Output>
Map<Output, AMINN_N_WRENCH, AMINN_N_WRENCH> stiffness(Output &out)
{
    return Map<Output, AMINN_N_WRENCH, AMINN_N_WRENCH>(&out.k_x[0][0]);
}

// engagement of the tendons (B)
template <class Output>
Map<Output, AMINN_N_BRANCH, 1> gates(Output &out)
{
    return Map<Output, AMINN_N_BRANCH, 1>(out.gate);
}

} // namespace view
} // namespace aminn

#endif
