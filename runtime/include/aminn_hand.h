/*
 * aminn_hand.h - the hand that library and programs are compiled for: here the reference hand, three branches.
 *
 * For another hand define AMINN_HAND_HEADER as the path of a header with the same macros, in quotes, where library and
 * users are compiled. A model of another hand is refused (AMINN_E_DIMS). SPDX-License-Identifier: Apache-2.0
 */
#ifndef AMINN_HAND_H
#define AMINN_HAND_H

#define AMINN_HAND_NAME "three_finger_hand"
#define AMINN_N_BRANCH 3 /* fingers and thumb, 2 .. 5 */
#define AMINN_N_COORD 3  /* coordinates of the longest branch, 1 .. 5; a shorter one lacks those next to the palm */
#define AMINN_N_JOINT 8  /* joints of the hand: coordinates that branches have */
#define AMINN_N_GATED 3  /* branches with a gated tendon; 0: the hand has no gates, its models none of their numbers */
#define AMINN_N_TWIST 0  /* branches with a soft fingertip, which resists twisting about its normal: all or none */
#define AMINN_N_STIFF 10 /* stiffnesses of springs, servos and tendons that theta tells apart: like parts share one */
#define AMINN_N_TENDON 6 /* tendons of the hand, whose tensions may be measured */
#define AMINN_N_SLIDE 1  /* 1: contacts of the layer can slide; its models give friction and preload of each */

/* Names of the joints in the order of q, for aminn_field_name(). */
#define AMINN_JOINT_NAMES(X) \
    X("finger1_roll")        \
    X("finger1_proximal")    \
    X("finger1_distal")      \
    X("finger2_roll")        \
    X("finger2_proximal")    \
    X("finger2_distal")      \
    X("thumb_proximal")      \
    X("thumb_distal")

/* Names of the numbers of theta (aminn_calibration_t), for aminn_theta_name(): stiffnesses, contacts, joint zeros, radius. */
#define AMINN_THETA_NAMES(X)            \
    X("spring_finger1_roll")            \
    X("spring_finger1_proximal")        \
    X("spring_finger1_distal")          \
    X("spring_thumb_proximal")          \
    X("spring_thumb_distal")            \
    X("servo_finger1_roll")             \
    X("tendon_finger1_proximal_flexor") \
    X("tendon_finger1_distal_flexor")   \
    X("tendon_thumb_proximal_flexor")   \
    X("tendon_thumb_distal_flexor")     \
    X("contact_finger1")                \
    X("contact_finger2")                \
    X("contact_thumb")                  \
    X("zero_finger1_roll")              \
    X("zero_finger1_proximal")          \
    X("zero_finger1_distal")            \
    X("zero_finger2_roll")              \
    X("zero_finger2_proximal")          \
    X("zero_finger2_distal")            \
    X("zero_thumb_proximal")            \
    X("zero_thumb_distal")              \
    X("radius_tips")

#endif
