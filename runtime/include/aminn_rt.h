/*
 * aminn_rt.h - AMINN runtime: does the grasp hold, and how far does the tool move in the hand?
 *
 * C99. It includes aminn_hand.h, which lies beside it. SPDX-License-Identifier: Apache-2.0
 *
 * WHAT IT COMPUTES
 *   It takes one state of the hand: joint angles, tool pose, load, contacts. It gives the probability that the grasp holds
 *   under the load (p_stable), and the displacement of the tool in the hand that the load causes (dx_ht, 6 numbers). Inside,
 *   two small neural networks predict joint springs and tendons, and a statics layer turns these into the 6x6 stiffness of
 *   the grasped tool. docs/mechanics.md has the method, docs/model-format.md the model's bytes.
 *
 * UNITS
 *   SI everywhere: m, rad, N, N.m. Poses are a position (m) and a rotation vector (rad): the axis times the angle, not a
 *   quaternion's vector part. Matrices are row-major C arrays: a[row][column]. All numbers are float (IEEE binary32).
 *
 * FRAMES, SIGNS, TIMES (drawn: the reference hand; docs/runtime.md has what misreadings cost, and how to find them)
 *
 *   from finger 1's side, along -x                onto the palm, along -z
 *                                                     roll                 roll
 *                 z ^                             + <-- o        y ^         o --> +    y = +60 mm
 *        __         |         __                         \         |        /
 *       /  O )     T|      ( O  \                 finger 2O        |       O finger 1   fingertips, r = 10 mm
 *      /            |            \                   =================================
 *     o   + -->     |     <-- +   o   distal                       H T --------------> x   (T above H)
 *     |             |             |   joints         =================================  tool, x along it
 *     |   + -->     |     <-- +   |                                O                    thumb's tip
 *   --o-------------H-------------o--> y                           |
 *   thumb         palm       finger 1, and                         o                    y = -60 mm
 *                        finger 2 behind it
 *
 *   Base joints at z = 0 and x = +22 mm (finger 1), -22 mm (finger 2), 0 (thumb); links 55 mm, and 45 mm to the fingertip's
 *   centre.
 *
 *   H, palm    origin in the middle of the palm's face, z out of the palm, y from the thumb to the fingers, x from finger 2
 *              to finger 1. Every vector of every struct is expressed in H. H moves with the palm.
 *   branches   finger 1 is at x > 0, finger 2 at x < 0, both at y > 0; the thumb at y < 0.
 *   joints     0: straight along z. Proximal and distal, of thumb and fingers: positive bends towards the other side, so a
 *              hand that closes counts up. Roll: positive turns a bent finger's tip away from the other finger, finger 1
 *              about +z, finger 2 about -z.
 *   T, tool    origin in its centre of mass, x along the tool, from a screwdriver's butt to its blade. In x_ht rotation
 *              vector 0 means axes parallel to H's.
 *   contact    position: on the tool's surface, where it is touched; not the fingertip's centre, which lies 10 mm further
 *              out. Normal: from the fingertip into the tool, near -y for the fingers, near +y for the thumb. Normal force:
 *              what the fingertip presses with along it, >= 0.
 *   w_e        what the outside does to the tool, not what the tool does to it: force, then moment about T's origin, both
 *              in axes of H. A force f at a point p has the moment (p - x_ht) x f. The grasp is at rest under gravity, so
 *              w_e leaves the tool's weight out. w_e . dx_ht is never negative.
 *   times      q, x_ht and contacts are those at rest before w_e acts; w_e is the load to come. dx_ht leads from there to rest
 *              under w_e: displacement of T's origin, then the rotation vector of R_after R_before^T, in axes of H.
 *
 * ORDERS (of the reference hand in brackets)
 *   branches:            as the hand's description has them [0 finger 1, 1 finger 2, 2 thumb]
 *   branch coordinates:  from the palm outwards. A branch that has fewer than the longest lacks the first ones; their
 *                        numbers are unused [0 roll, 1 proximal, 2 distal; the thumb has no roll]
 *   joints (q):          branch by branch, from the palm outwards; aminn_field_name() has their names [finger 1 roll, proximal,
 *                        distal; finger 2 roll, proximal, distal; thumb proximal, distal]
 *
 * OTHER HANDS
 *   Library and users are compiled for one hand. aminn_hand.h has its counts; `aminn export` writes it beside the model
 *   (cmake -DAMINN_HAND=, docs/runtime.md). Frames, signs and times are as above, except where it says finger or thumb.
 *
 * MEMORY AND LIFETIME
 *   - The library allocates nothing and keeps no state of its own: no heap, no globals that change, no files, no locks.
 *   - The model (aminn_model_t and its tables) is read only and stays where it is, normally in flash. It must outlive
 *     every context that was initialised with it. A model from aminn_model_from_blob() points into the blob, which must
 *     outlive it, unchanged.
 *   - The context (aminn_t) belongs to the caller: static, on a stack, wherever. sizeof(aminn_t) is a compile-time
 *     constant and is all the working memory that a prediction needs beside its stack (about 2 kB on a Cortex-M7, 3 kB
 *     with contacts that slide; docs/runtime.md has the measured figure). It may be moved or copied with memcpy between
 *     calls. There is nothing to free.
 *   - Alignment: natural alignment of float and of pointers. No stricter alignment is ever assumed.
 *
 * REENTRANCY, THREADS AND INTERRUPTS
 *   - Functions that take a `aminn_t *` write to that context. One context must not be used by two callers at once; two
 *     contexts may, also with the same model. To predict in an interrupt handler and in the background, give each its
 *     own context.
 *   - All other functions are reentrant.
 *   - Many predictions at once, on all cores of a host: aminn_batch.h, in a library of its own.
 *   - Nothing blocks, waits or disables interrupts. No loop iterates to convergence. Run time depends on the input in two
 *     ways only: stage 2 is skipped if the grasp is predicted not to hold (see AMINN_FLAG_ALWAYS_STAGE2), and a rejected
 *     input returns early. So the worst case is one prediction with both stages.
 *   - On a core with an FPU the FPU must be enabled, and its registers must be saved around an interrupt that predicts.
 *
 * DETERMINISM
 *   The same model and input give the same 32-bit patterns on every target, with every compiler and optimisation level.
 *   The order of all operations is fixed and none is fused. The only function of math.h is the square root, which IEEE 754
 *   rounds correctly. This needs IEEE binary32 with subnormal numbers and round to nearest: leave FPSCR.FZ clear on
 *   Cortex-M, MXCSR.FTZ and DAZ on x86.
 *
 * ERRORS
 *   Functions return an aminn_status_t: AMINN_OK is 0, every error is negative. Each function says below what its
 *   outputs hold after an error. The rule: nothing that could pass for a prediction. After an error of a predict
 *   function `stable` and `p_stable` are 0 ("does not hold") and all other outputs are NaN. So no number of an earlier
 *   call can pass for a current one.
 *
 * EXAMPLE (all static; compiled and run by the tests as tests/runtime/test_example.c; runtime/examples/controller.c fills
 * the state from encoders, a quaternion and contact sensors)
 *
 *     #include "aminn_model.h"                      // generated by `aminn export`, includes aminn_rt.h
 *
 *     static aminn_t ctx;                           // working memory, .bss
 *     static aminn_state_t state;                   // filled from encoders, hand pose and contact sensors
 *     static aminn_output_t out;
 *
 *     int controller_start(void)
 *     {
 *         aminn_status_t status = aminn_init(&ctx, &aminn_model, 0);
 *         return status != AMINN_OK ? status : aminn_self_test(&ctx);
 *     }
 *
 *     // 1: the grasp holds and the tool will move by out.dx_ht; 0: it will not hold, or the model does not know such
 *     // states (aminn_first_out_of_range); negative: status code
 *     int controller_step(void)
 *     {
 *         aminn_status_t status = aminn_predict_state(&ctx, &state, &out);
 *         return status != AMINN_OK ? (int)status : out.stable && out.notes == 0;
 *     }
 */
#ifndef AMINN_RT_H
#define AMINN_RT_H

#include <stddef.h>
#include <stdint.h>

#ifdef AMINN_HAND_HEADER
#include AMINN_HAND_HEADER
#else
#include "aminn_hand.h"
#endif

#ifdef __cplusplus
extern "C" {
#endif

/* Structs must lie in memory as in the library: an array of negative size here is -fpack-struct, or a #pragma pack. */
struct aminn_layout {
    char c;
    void *p;
};
typedef char aminn_compile_without_fpack_struct[sizeof(struct aminn_layout) == 2 * sizeof(void *) ? 1 : -1];

/* ---- Version --------------------------------------------------------------------------------------------------- */

#define AMINN_VERSION_MAJOR 0
#define AMINN_VERSION_MINOR 1
#define AMINN_VERSION_PATCH 0
#define AMINN_VERSION_STRING "0.1.0"

/* Version of the model's layout, in memory and as a blob. A model of another version is refused. */
#define AMINN_FORMAT_VERSION 11u

/* ---- Dimensions ------------------------------------------------------------------------------------------------ */

/* AMINN_N_BRANCH, AMINN_N_COORD, AMINN_N_JOINT, AMINN_N_GATED, AMINN_N_TWIST, AMINN_N_STIFF and AMINN_N_TENDON are the hand's,
 * AMINN_N_SLIDE says which layer its models have (aminn_hand.h). In comments B, C and J are the first three, S is
 * AMINN_N_STIFF, T is AMINN_N_TENDON. */
#if !defined(AMINN_N_STIFF) || !defined(AMINN_N_TENDON) || !defined(AMINN_N_SLIDE)
#error "aminn_hand.h is of an earlier version: export the model again, which writes it"
#endif
#ifndef AMINN_N_TWIST
#define AMINN_N_TWIST 0 /* contacts are points: none resists twisting */
#endif
#define AMINN_N_CONTACT_FEATURE 8 /* in contact, position 3, normal 3, normal force */
#define AMINN_N_WRENCH 6          /* force 3, moment 3; also position 3, rotation vector 3 */
#define AMINN_N_STAGE 2           /* stage 1: does it hold? stage 2: how far does it move? */

/* Derived from the above; the number behind each is that of the reference hand. A branch's joint springs are a packed Cholesky
 * factor. The mechanics head corrects it, and where the hand has gates also the tendons: direction, gain, alpha, beta, rho.
 * Rows of the head's weights end with zeros, so that 8 weights that are loaded together lie in one line of a processor's
 * cache. In a row the numbers of all branches stand side by side, in this order: diagonal C, gain, alpha, twist, entries below
 * the diagonal C (C - 1) / 2, friction, direction C, beta, rho, preload 3; without gates: diagonal, twist, entries below it,
 * friction, preload. Only soft fingertips have a twist: they resist turning about the normal of their contact. Only contacts
 * that can slide have friction and preload. */
#define AMINN_N_CHOLESKY (AMINN_N_COORD * (AMINN_N_COORD + 1) / 2)           /* 6 */
#define AMINN_N_BRANCH_FEATURE (AMINN_N_CONTACT_FEATURE + 3 * AMINN_N_COORD) /* 17 */
#define AMINN_N_CONTACT_INPUT (AMINN_N_BRANCH * AMINN_N_BRANCH_FEATURE)      /* 51 */
#define AMINN_N_GLOBAL_INPUT (AMINN_N_JOINT + 3 * AMINN_N_WRENCH)            /* 26 */
#define AMINN_N_BRANCH_HEAD \
    (AMINN_N_CHOLESKY + (AMINN_N_GATED > 0) * (AMINN_N_COORD + 4) + (AMINN_N_TWIST > 0) + 4 * AMINN_N_SLIDE) /* 17 */
#define AMINN_N_HEAD (AMINN_N_BRANCH * AMINN_N_BRANCH_HEAD)                                                  /* 51 */
#define AMINN_N_HEAD_STORED ((AMINN_N_HEAD + 7) / 8 * 8)                                                     /* 56 */
#define AMINN_N_SLID (3 * AMINN_N_SLIDE * AMINN_N_BRANCH)                                                    /* 9 */
#define AMINN_N_AUX (2 * AMINN_N_WRENCH + (AMINN_N_GATED > 0) * AMINN_N_BRANCH + AMINN_N_SLID)               /* 24 */
#define AMINN_N_SURE (1 + AMINN_N_SLID)                                                                      /* 10 */
#define AMINN_N_STATE (AMINN_N_JOINT + 2 * AMINN_N_WRENCH + AMINN_N_BRANCH * AMINN_N_CONTACT_FEATURE)        /* 44 */
#define AMINN_N_INPUT (AMINN_N_STATE + AMINN_N_BRANCH * 3 * (AMINN_N_WRENCH + AMINN_N_COORD))                /* 125 */
#define AMINN_N_OUTPUT (3 + AMINN_N_WRENCH + AMINN_N_WRENCH * AMINN_N_WRENCH + 2 * AMINN_N_BRANCH)           /* 51 */

/* Sensors that a model may use (aminn_sensors_t): how many numbers they have, and how many of these the networks see, at the
 * end of the global input. */
#define AMINN_N_SENSOR (3 + 4 + (AMINN_N_TENDON > 0) + AMINN_N_TENDON) /* 14 */
#define AMINN_N_SENSED (AMINN_N_SENSOR - 1)                            /* 13 */

/* Theta: by how much one hand differs from its description (aminn_calibration_t). First F factors: on stiffnesses, and on the
 * compliance of each branch's contact. A told model sees these, at the end of its global input. */
#define AMINN_N_FACTOR (AMINN_N_STIFF + AMINN_N_BRANCH)    /* 13 */
#define AMINN_N_THETA (AMINN_N_FACTOR + AMINN_N_JOINT + 1) /* 22 */
#define AMINN_N_TERM (AMINN_N_CHOLESKY + 1)                /* 7: what a stiffness adds to a branch's springs and gain */
#define AMINN_N_TOLD_INPUT (AMINN_N_GLOBAL_INPUT + AMINN_N_FACTOR + AMINN_N_SENSED) /* 52: at most */
#define AMINN_N_STATICS (AMINN_N_AUX > AMINN_N_SURE ? AMINN_N_AUX : AMINN_N_SURE)   /* that either sees: at most */
#define AMINN_N_LAST_INPUT (AMINN_N_CONTACT_INPUT > AMINN_N_TOLD_INPUT ? AMINN_N_CONTACT_INPUT : AMINN_N_TOLD_INPUT)

/* Room that statics needs beside its stack, and what layer_out takes for it: what slides do, or the contacts' joints. */
#define AMINN_N_ROOM_JOINTS (AMINN_N_BRANCH * (AMINN_N_COORD * (AMINN_N_COORD + 9) / 2 + 1))
#define AMINN_N_ROOM_SLIDES (2 * AMINN_N_BRANCH * (3 * AMINN_N_WRENCH + 8 * AMINN_N_BRANCH + AMINN_N_TWIST + 1))
#define AMINN_N_ROOM (AMINN_N_SLIDE ? AMINN_N_ROOM_SLIDES : AMINN_N_ROOM_JOINTS)
#define AMINN_N_LAYER_IN (AMINN_MAX_WIDTH + AMINN_N_LAST_INPUT)
#define AMINN_N_LAYER_OUT \
    (AMINN_N_ROOM > AMINN_N_LAYER_IN + AMINN_MAX_WIDTH ? AMINN_N_ROOM - AMINN_N_LAYER_IN : AMINN_MAX_WIDTH)

/* The hand that the library is compiled for, as a symbol whose name has the counts. A C model asks for that of its hand.
 * Where the library is compiled for another, the linker says which one is missing. Two libraries in one program define the
 * same functions. */
#define AMINN_JOINED(b, c, j, g, t, s, n, l) \
    aminn_library_of_##b##_branches_##c##_coordinates_##j##_joints_##g##_gated_##t##_twisted_##s##_stiff_##n##_tendons_##l##_slide
#define AMINN_LIBRARY_OF(b, c, j, g, t, s, n, l) AMINN_JOINED(b, c, j, g, t, s, n, l)
#define AMINN_LIBRARY                                                                                           \
    AMINN_LIBRARY_OF(AMINN_N_BRANCH, AMINN_N_COORD, AMINN_N_JOINT, AMINN_N_GATED, AMINN_N_TWIST, AMINN_N_STIFF, \
                     AMINN_N_TENDON, AMINN_N_SLIDE)
extern const char AMINN_LIBRARY[];

/* Largest contact_width, width of a stage and classifier_width that a context has room for. Define it before the library
 * and its users are compiled (the same for both) to save memory. sizeof(aminn_t) shrinks by 12 bytes for each unit. Where
 * contacts can slide it shrinks by 4 below about a hundred units, since statics then needs more room than layers. */
#ifndef AMINN_MAX_WIDTH
#define AMINN_MAX_WIDTH 128
#endif

/* ---- Status codes ---------------------------------------------------------------------------------------------- */

/* clang-format off */
/* The one list of status codes: X(name, value, meaning). The enum and the functions that name a code come from it. */
#define AMINN_STATUS_LIST(X)                                                                                          \
    X(AMINN_OK, 0, "no error")                                                                                        \
    X(AMINN_E_NULL, -1, "a pointer argument is null")                                                                 \
    X(AMINN_E_NOT_INITIALISED, -2, "the context was not initialised with aminn_init, or that failed")                 \
    X(AMINN_E_FLAGS, -3, "an unknown flag is set")                                                                    \
    X(AMINN_E_NONFINITE, -4, "an input is NaN or infinite")                                                           \
    X(AMINN_E_CONTACT_FLAG, -5, "a contact flag lies outside [0, 1]")                                                 \
    X(AMINN_E_NORMAL, -6, "the contact normal of a branch in contact is not a unit vector")                           \
    X(AMINN_E_ROTATION, -7, "the rotation vector of x_ht is longer than pi")                                          \
    X(AMINN_E_NO_CONTACT, -8, "no branch is in contact: there is no grasp to judge")                                  \
    X(AMINN_E_NUMERIC, -9, "the prediction overflowed or lost all digits: inputs far outside the physical range")     \
    X(AMINN_E_DIMS, -10, "the model is of another hand than the library, or a width exceeds AMINN_MAX_WIDTH")         \
    X(AMINN_E_MODEL, -11, "a table of the model is missing, or a constant is NaN or out of its range")                \
    X(AMINN_E_MAGIC, -12, "the blob is not an AMINN model")                                                           \
    X(AMINN_E_VERSION, -13, "the model has another format version than this runtime: export it again")                \
    X(AMINN_E_SIZE, -14, "the blob is truncated, or its length does not fit its dimensions")                          \
    X(AMINN_E_CRC, -15, "the model's CRC-32 does not match: it is damaged")                                           \
    X(AMINN_E_ALIGN, -16, "the blob is not aligned to 4 bytes")                                                       \
    X(AMINN_E_CONTEXT_SIZE, -17, "sizeof(aminn_t) differs from the library's: compiled with another AMINN_MAX_WIDTH") \
    X(AMINN_E_BYTE_ORDER, -18, "the blob is little endian, this processor is not: compile the C model in its place")  \
    X(AMINN_E_ROUNDING, -19, "the processor does not round to nearest: set its rounding mode back")                   \
    X(AMINN_E_FLUSH, -20, "subnormal numbers are flushed to zero: clear FPSCR.FZ, or MXCSR.FTZ and DAZ")              \
    X(AMINN_E_CONTRACTED, -21, "products and sums are fused: compile the library with -ffp-contract=off")             \
    X(AMINN_E_FAST_MATH, -22, "arithmetic is reordered or approximated: compile without -ffast-math and its parts")   \
    X(AMINN_E_KNOWN_ANSWER, -23, "the library computes other bits than it must: miscompiled, or memory is damaged")   \
    X(AMINN_E_CALIBRATION, -24, "theta is beyond its bounds, or the calibration was not set for the context's model") \
    X(AMINN_E_SENSORS, -25, "a sensor's number is out of its range, or the model was not trained to see sensors")      \
    X(AMINN_E_LIMITS, -26, "a limit of the load is NaN, negative, or zero where it may not be")

/* clang-format on */

/* AMINN_STATUS_WIDTH is no status. It makes the type 32 bits wide: -fshort-enums, which most compilers for Cortex-M have on,
 * would make it a byte. Library and caller may be compiled either way. */
#define AMINN_STATUS_ENUM(name, value, text) name = (value),
typedef enum aminn_status { AMINN_STATUS_LIST(AMINN_STATUS_ENUM) AMINN_STATUS_WIDTH = -2147483647 - 1 } aminn_status_t;
#undef AMINN_STATUS_ENUM

/* ---- Model ----------------------------------------------------------------------------------------------------- */

/* How pass 1 finds the joints' deflection (aminn_model_t.dq0). */
#define AMINN_DQ0_STATICS 0u /* from the contact forces: K^-1 B^T f */
#define AMINN_DQ0_INVERSE 1u /* from the inverse of j_q + eps_jq I */

/* Type of the weights' elements (aminn_model_t.weight_type). */
#define AMINN_WEIGHTS_FLOAT32 0u /* float */
#define AMINN_WEIGHTS_FLOAT16 1u /* uint16_t that holds an IEEE binary16: half the flash, same arithmetic in float */
#define AMINN_WEIGHTS_INT8 2u /* int8_t, steps of a size of each output's own: a quarter of the flash, sums in float */

/* What the library does with weights that are not float. A C model names its own, and a linker leaves out the others. */
typedef struct aminn_storage aminn_storage_t;
extern const aminn_storage_t aminn_storage_float16;
extern const aminn_storage_t aminn_storage_int8;

/* Tables that theta changes: a model's own are of the nominal hand, a calibration's of one hand. */
typedef struct aminn_varied {
    const float *chol;        /* (B x CHOLESKY)  springs, Cholesky factor 00 11 22 .. 10 20 21 .. of K_b, N.m/rad */
    const float *tendon_gain; /* (B)             N.m/rad, >= 0; 0: the branch has no gated tendon; null without gates */
    const float *twist;       /* (B)             N.m/rad, > 0: of soft fingertips; null without */
    const float *told;        /* (n_told)        logarithms of factors that networks see; null unless told */
    const float *eps_m[AMINN_N_STAGE]; /* (B)             isotropic contact compliance of each stage, m/N, > 0 */
} aminn_varied_t;

/* Tables and constants of one stage. HC is contact_width, H the stage's width, G the length of the global input:
 * AMINN_N_GLOBAL_INPUT + n_told + n_sensed. Lengths of the reference model are in brackets. Weights are stored
 * [input][output], so that the product is a sum of contiguous rows. Where they are int8, the tables that end in _b are twice
 * as long: behind the biases they have the size of each output's steps, > 0. Every pointer is to read-only tables, normally
 * in flash, aligned to 4 bytes. */
typedef struct aminn_stage_model {
    float eps_kx;                 /* added stiffness, N/m and N.m/rad, > 0 */
    float eps_jq;                 /* regularisation of j_q in AMINN_DQ0_INVERSE, m/rad, >= 0 */
    const float *contact_mean;    /* (CONTACT_INPUT) [51]         normalisation of the contact input */
    const float *contact_inv_std; /* (CONTACT_INPUT) */
    const float *global_mean;     /* (G) [39]                     normalisation of q, x_ht, w_e, signed log of w_e, */
    const float *global_inv_std;  /* (G)                          then n_told factors, n_sensed numbers of sensors */
    const void *contact_w;        /* (CONTACT_INPUT x HC)         contact summary */
    const float *contact_b;       /* (HC) */
    const void *trunk1_w;         /* ((HC + G) x H)               input: contact summary, then global input */
    const float *trunk1_b;        /* (H) */
    const void *trunk2_w;         /* (H x H) */
    const float *trunk2_b;        /* (H) */
    const void *head_w;           /* (H x HEAD_STORED) [H x 56]   mechanics head: corrections for each branch, zeros */
    const float *head_b;          /* (HEAD_STORED) */
} aminn_stage_model_t;

/* A trained model: constants and pointers to its tables. `aminn export` writes it as C source, or aminn_model_from_blob()
 * fills it in. Do not write it by hand. HD is classifier_width. */
typedef struct aminn_model {
    uint32_t format_version; /* AMINN_FORMAT_VERSION */
    uint32_t content_crc;    /* CRC-32 of what follows but for the names (docs/model-format.md): aminn_self_test() */
    uint32_t n_branch;       /* AMINN_N_BRANCH, and so on: a model made for another hand is refused */
    uint32_t n_coord;
    uint32_t n_joint;
    uint32_t n_contact_feature;
    uint32_t n_wrench;
    uint32_t n_gated;
    uint32_t n_twist;
    uint32_t n_stiff;
    uint32_t n_tendon;
    uint32_t n_slide;
    uint32_t n_told;               /* factors that the networks see: AMINN_N_FACTOR of a told model, else 0 */
    uint32_t n_sensed;             /* numbers of sensors that they see: AMINN_N_SENSED of one that sees them, else 0 */
    uint32_t contact_width;        /* HC, 1 .. AMINN_MAX_WIDTH */
    uint32_t width[AMINN_N_STAGE]; /* H of each stage, 1 .. AMINN_MAX_WIDTH */
    uint32_t classifier_width;     /* HD, 1 .. AMINN_MAX_WIDTH */
    uint32_t dq0;                  /* AMINN_DQ0_STATICS or AMINN_DQ0_INVERSE */
    uint32_t weight_type;          /* AMINN_WEIGHTS_FLOAT32, _FLOAT16 or _INT8: of the tables that end in _w */
    uint32_t stages_crc;           /* CRC-32 of both stages' aminn_stage_debug_t for the known answer's state */
    float length_scale;            /* makes rotations and translations comparable, m, > 0 */
    float log_range;               /* springs stay within exp(+-log_range) of nominal, >= 0 */
    float displacement_log_scale;  /* m, > 0 */
    float tau;                     /* the grasp holds if p_stable >= tau, 0 .. 1 */
    float friction_nominal;        /* coefficient of friction where nothing is known of it, > 0 */
    float max_translation;         /* a motion of contacts that can slide is cut to these, m and rad, > 0 */
    float max_rotation;
    float bound_edge[3];           /* bins of p_slide, ascending */
    float bound_factor[4];         /* that bound_95 is multiplied with in each bin, > 0 */
    uint8_t checkpoint_sha256[32]; /* which model: SHA-256 of the checkpoint it was exported from */
    uint8_t data_sha256[32];       /* trained on which data set: config_sha256 of its manifest; zeros: not known */
    const char *name;              /* given at export, else the symbol prefix; at most 55 characters, as hand */
    const char *hand;              /* name of the hand, and 8 digits of its constants' SHA-256 */
    const char *made_by;           /* program and version that exported it, "aminn 0.1.0"; at most 39 characters */
    const char *library;           /* AMINN_LIBRARY; null in a model that a blob holds */
    aminn_varied_t nominal;        /* of the hand as its description has it */
    const float *wrench_log_scale; /* (6)             N, N.m; > 0 */
    const float *tendon_dir_nom;   /* (B x C)         nominal tendon direction; null without gates, as the next */
    const float *gate_nom;         /* (3)             alpha 1/rad, beta rad, rho */
    /* Springs of each branch (entries of K in the order of chol) and gain of its gated tendon: first the part that theta
     * leaves as it is, then the part of each stiffness, which its factor multiplies. */
    const float *theta_terms;  /* ((1 + S) x B x TERM) [11 x 3 x 7], N.m/rad */
    const float *coord_mask;   /* (B x C)         1 where a branch has the coordinate, else 0: it lacks the first */
    const float *geom_axis;    /* (B x C x 3)     unit, H: joint axes at q = 0; zeros where absent */
    const float *geom_anchor;  /* (B x C x 3)     m, H: a point on each axis at q = 0; zeros where absent */
    const float *range_min;    /* (STATE) [44]    smallest value of each field of aminn_state_t in training, */
    const float *range_max;    /* (STATE)         and largest; both widened by 5 % of the range */
    const float *aux_mean;     /* (AUX) [24]      stage 1's classifier: normalisation of what statics gives */
    const float *aux_inv_std;  /* (AUX) */
    const void *cls1_w;        /* ((H + AUX) x HD) input: stage 1's trunk, then statics */
    const float *cls1_b;       /* (HD) */
    const void *cls2_w;        /* (HD) */
    const float *cls2_b;       /* (1) */
    const float *sure_mean;    /* (SURE) [10]     how sure stage 2 is: normalisation of what statics gives */
    const float *sure_inv_std; /* (SURE) */
    const void *sure_w;  /* ((H + SURE) x 2) input: stage 2's trunk, then statics; logit of p_slide, log of bound_95 */
    const float *sure_b; /* (2) */
    const struct aminn_known_answer *known_answer; /* a state, and the bits of its prediction */
    const aminn_storage_t *storage;                /* that of weight_type; null: float */
    aminn_stage_model_t stage[AMINN_N_STAGE];      /* 0: stage 1, 1: stage 2 */
} aminn_model_t;

/* ---- Inputs and outputs ---------------------------------------------------------------------------------------- */

/* State of hand, tool and load. Every number must be finite. */
typedef struct aminn_state {
    /* joint angles, rad */
    float q[AMINN_N_JOINT];

    /* pose of T in H before the load: position of the centre of mass (m), rotation vector (rad, length <= pi) */
    float x_ht[AMINN_N_WRENCH];

    /* load on the tool without its weight: force (N), moment about T's origin (N.m), axes of H */
    float w_e[AMINN_N_WRENCH];

    /* one row per branch: in contact (0 .. 1), position on the tool's surface (m, H), unit normal into the tool (H), normal
     * force (N, >= 0; not checked). At least one branch must be in contact. A row whose flag is 0 has no influence; a flag
     * between 0 and 1 fades the branch in. The reference model has seen only grasps with three contacts. */
    float contacts[AMINN_N_BRANCH][AMINN_N_CONTACT_FEATURE];
} aminn_state_t;

/* The same and the closure Jacobians, for callers that have them: j_x dx + j_q dq = 0 with dx the tool's motion and dq
 * that of the branch coordinates. In memory these are AMINN_N_INPUT floats in this order (vector files hold them so). */
typedef struct aminn_input {
    /* as in aminn_state_t */
    float q[AMINN_N_JOINT];
    float x_ht[AMINN_N_WRENCH];
    float w_e[AMINN_N_WRENCH];
    float contacts[AMINN_N_BRANCH][AMINN_N_CONTACT_FEATURE];

    /* tool side, one block per branch: [ I3 | -[r]x ], r (m) from the tool's origin to the contact */
    float j_x[AMINN_N_BRANCH][3][AMINN_N_WRENCH];

    /* joint side, one block per branch, m/rad: minus the velocity of the contact point at unit rate of each coordinate; a
     * zero column where the branch lacks the coordinate */
    float j_q[AMINN_N_BRANCH][3][AMINN_N_COORD];
} aminn_input_t;

/* What a caller should know about a prediction: bits of aminn_output_t.notes. */
#define AMINN_NOTE_OUT_OF_RANGE 1u    /* a field of the state lies outside what the model was trained on: a guess */
#define AMINN_NOTE_ILL_CONDITIONED 2u /* condition exceeds AMINN_ILL_CONDITIONED: dx_ht may have few correct digits */
#define AMINN_NOTE_NO_CONTACT 4u      /* no branch is in contact; with AMINN_E_NO_CONTACT */

/* Bound of aminn_output_t.condition beyond which a displacement is noted as ill-conditioned. */
#define AMINN_ILL_CONDITIONED 1e8F

/* What other sensors know; all zeros: nothing. A number of a sensor that is not known (flag 0) has no influence. */
typedef struct aminn_sensors {
    /* known (0 or 1); coefficient of friction between fingertips and tool, > 0; its standard deviation, >= 0 */
    float friction[3];

    /* known (0 or 1); force of gravity on the tool, N, axes of H */
    float tool_weight[4];

#if AMINN_N_TENDON > 0
    /* known (0 or 1); tension of each tendon, N */
    float tendon_tension[1 + AMINN_N_TENDON];
#endif
} aminn_sensors_t;

/* Classes of friction, as initialisers of aminn_sensors_t.friction: thirds of 0.4 .. 1.1. */
#define AMINN_FRICTION_LOW {1.0F, 0.516666667F, 0.0673575314F}
#define AMINN_FRICTION_MID {1.0F, 0.75F, 0.0673575314F}
#define AMINN_FRICTION_HIGH {1.0F, 0.983333333F, 0.0673575314F}

/* A prediction. dx_ht, k_x, gate, p_slide and bound_95 are NaN if the grasp is predicted not to hold: it has no displacement
 * to predict. With AMINN_FLAG_ALWAYS_STAGE2 they are always numbers. Springs and tendons: AMINN_FLAG_DEBUG. */
typedef struct aminn_output {
    /* probability that the grasp holds, 0 .. 1 */
    float p_stable;

    /* displacement of the tool in the hand: translation (m), rotation vector (rad), axes of H; where contacts can slide
     * cut as a whole to the model's max_translation and max_rotation */
    float dx_ht[AMINN_N_WRENCH];

    /* stiffness of the grasped tool, symmetric positive definite: N/m, N/rad, N.m/m, N.m/rad by block; of contacts that
     * slide the secant from rest: without the cut k_x dx_ht = w_e */
    float k_x[AMINN_N_WRENCH][AMINN_N_WRENCH];

    /* engagement of each branch's tendon, 0 .. 1 */
    float gate[AMINN_N_BRANCH];

    /* probability that a contact slides, by more than 0.5 mm, if the grasp holds, 0 .. 1 */
    float p_slide;

    /* what the error of dx_ht does not exceed in 95 of 100: sqrt((|translation error| / length_scale)^2 + angle^2), angle the
     * rotation error in rad */
    float bound_95;

    /* share of its friction that each contact uses under the load if none slides: 1 is all of it, more is cut to 100; 0 out
     * of contact, and where contacts cannot slide (AMINN_N_SLIDE 0) */
    float friction_use[AMINN_N_BRANCH];

    /* how far apart the stiffnesses of the grasped tool lie: trace(K) trace(K0^-1), K the stiffness with lengths divided by
     * length_scale, K0 the same without tendons, of the last stage that ran. At least K's condition number. */
    float condition;

    /* 1: the grasp holds (p_stable >= tau); 0: it does not */
    int32_t stable;

    /* AMINN_NOTE_... bits */
    uint32_t notes;
} aminn_output_t;

/* A state and the bits that aminn_predict_state() must give for it on every machine, with AMINN_FLAG_ALWAYS_STAGE2. The state
 * is of the training data, where the model was exported with them. */
typedef struct aminn_known_answer {
    aminn_state_t state;
    aminn_output_t output;
} aminn_known_answer_t;

/* What one stage computed on its way, for logging and for comparing runtimes. */
typedef struct aminn_stage_debug {
    float k_spring[AMINN_N_BRANCH][AMINN_N_COORD][AMINN_N_COORD]; /* joint springs, SPD, N.m/rad */
    float tendon_dir[AMINN_N_BRANCH][AMINN_N_COORD];              /* tendon direction in branch coordinates, unit */
    float tendon_gain[AMINN_N_BRANCH];                            /* tendon stiffness, N.m/rad, > 0 */
    float gate_params[AMINN_N_BRANCH][3];                         /* alpha (1/rad), beta (rad), rho */
    float friction[AMINN_N_BRANCH];   /* coefficient of each contact; 0 where contacts cannot slide, as the next two */
    float preload[AMINN_N_BRANCH][3]; /* tangential force of each contact on the tool before the load, N, axes of H */
    float slide[AMINN_N_BRANCH];      /* compliance of each contact's sliding, m/N */
    float dx0[AMINN_N_WRENCH];        /* displacement with springs alone, m and rad */
    float dq0[AMINN_N_BRANCH][AMINN_N_COORD];  /* deflection of the branch coordinates with springs alone, rad */
    float dx[AMINN_N_WRENCH];                  /* displacement with tendons, and with contacts that slid; m and rad */
    float k_x[AMINN_N_WRENCH][AMINN_N_WRENCH]; /* stiffness with both, SI */
    float gate[AMINN_N_BRANCH];                /* tendon engagement, 0 .. 1 */
} aminn_stage_debug_t;

/* ---- Calibration ----------------------------------------------------------------------------------------------- */

/* Bounds of theta: of the logarithm of a factor, of a joint's zero (rad), of what is added to the tips' radius (m). */
#define AMINN_MAX_LOG_FACTOR 3.0F
#define AMINN_MAX_ZERO 1.0F
#define AMINN_MAX_RADIUS 0.05F

/* By how much a hand differs from its description, and what follows from that for one model. The caller owns it, like a
 * context. Only aminn_calibration_set() fills it in. It must then stay where it is: it points into itself, and
 * aminn_calibrate() refuses one that was moved. aminn_theta_name() has the names of theta; zeros are nominal:
 *
 *   S   logarithms of factors on joint springs, servos and tendons; like parts share one
 *   B   logarithms of factors on the compliance of each branch's contact
 *   J   offsets of the joints' zeros, rad: true angle minus measured one
 *   1   radius of the tips beyond that which contacts were computed with, m
 */
typedef struct aminn_calibration {
    aminn_varied_t varied;      /* the arrays below */
    const aminn_model_t *model; /* that it was set for */
    float theta[AMINN_N_THETA];
    float chol[AMINN_N_BRANCH][AMINN_N_CHOLESKY];
    float tendon_gain[AMINN_N_BRANCH];
    float twist[AMINN_N_BRANCH];
    float eps_m[AMINN_N_STAGE][AMINN_N_BRANCH];
} aminn_calibration_t;

/* Assumptions of a calibrator; aminn_calibrator_defaults has the numbers in brackets. */
typedef struct aminn_calibrator_settings {
    float prior;       /* standard deviation of each factor's logarithm before any push, 1e-9 .. 1 [0.5] */
    float noise_m;     /* of each measured number, rotations times length_scale, m, 1e-9 .. 1 [5e-5] */
    float model_share; /* of the model's own error, as a share of the smaller of both motions, 0 .. 1 [0.08] */
    float step;        /* by which a push changes a logarithm at most, 1e-9 .. AMINN_MAX_LOG_FACTOR [0.5] */
    float bound;       /* of each logarithm, either way, likewise [1.5] */
    float memory;      /* share of what is known that a push leaves; below 1 old pushes are forgotten, 1e-9 .. 1 [1] */
} aminn_calibrator_settings_t;
extern const aminn_calibrator_settings_t aminn_calibrator_defaults;

/* Outcome of the latest push (aminn_calibrator_t.outcome). */
#define AMINN_PUSH_NONE 0u    /* there was none */
#define AMINN_PUSH_LEARNED 1u /* theta has changed */
#define AMINN_PUSH_DOUBTED 2u /* it surprises, and counted for less */
#define AMINN_PUSH_SLIPPED 3u /* no hand within the bounds moves so: not used */
#define AMINN_PUSH_WORSE 4u   /* theta would have predicted this very push worse than before, and stays as it is */

/* Coefficients of friction, evenly from 0.4 to 1.1, whose likelihood a calibrator keeps. */
#define AMINN_N_COEFFICIENT 16

/* Learns theta's factors from pushes, one at a time, and the friction of the present grasp. The caller owns it; it must stay
 * where it was initialised. Read any member, write none. */
typedef struct aminn_calibrator {
    aminn_calibration_t calibration; /* so far, for aminn_calibrate() */
    aminn_calibrator_settings_t settings;
    uint32_t pushes;                                             /* seen */
    uint32_t in_grasp;                                           /* of these in the present grasp, one after another */
    uint32_t outcome;                                            /* AMINN_PUSH_... of the latest */
    float grasp[AMINN_N_JOINT + AMINN_N_WRENCH];                 /* q and x_ht of the present grasp's first push */
    float covariance[AMINN_N_FACTOR * (AMINN_N_FACTOR + 1) / 2]; /* of the logarithms: 00 10 11 20 21 22 .. */
#if AMINN_N_SLIDE
    float friction[AMINN_N_COEFFICIENT]; /* likelihood of each coefficient in the present grasp, the largest is 1 */
#endif
} aminn_calibrator_t;

/* ---- Largest load ---------------------------------------------------------------------------------------------- */

/* When a load is admissible (aminn_admissible_load()). Besides, the model must know such loads, and predict that the grasp
 * holds. */
typedef struct aminn_load_limits {
    float max_translation; /* of the tool in the hand, as predicted, m, > 0; INFINITY: no bound */
    float max_rotation;    /* likewise, rad */
    float margin;    /* how much of bound_95 is added to both, as length and as angle; 1: as it is, 0: nothing, >= 0 */
    float p_stable;  /* least probability that the grasp holds, 0 .. 1; below the model's tau, tau counts */
    float p_slide;   /* largest probability that a contact slides, 0 .. 1; 1: no bound */
    float max_scale; /* of the direction that is of interest, > 0; FLT_MAX: as far as the model knows loads */
} aminn_load_limits_t;

/* What keeps a load from being larger. */
#define AMINN_LIMITED_NOT 0u            /* nothing: max_scale is admissible */
#define AMINN_LIMITED_BY_HOLD 1u        /* p_stable */
#define AMINN_LIMITED_BY_TRANSLATION 2u /* max_translation */
#define AMINN_LIMITED_BY_ROTATION 3u    /* max_rotation */
#define AMINN_LIMITED_BY_SLIDE 4u       /* p_slide */
#define AMINN_LIMITED_BY_RANGE 5u /* larger ones lie beyond what the model was trained on, or are ill-conditioned */

/* Most predictions that aminn_admissible_load() makes. */
#define AMINN_LOAD_PREDICTIONS 13

/* The largest admissible load along a direction. */
typedef struct aminn_admissible {
    float scale;         /* 0 .. max_scale; 0 also where not even that is admissible */
    int32_t admissible;  /* 1: the load with `scale` is; 0: not even the one with scale 0 is */
    uint32_t limited_by; /* AMINN_LIMITED_... */
    aminn_output_t at;   /* what is predicted with `scale` */
} aminn_admissible_t;

/* ---- Context --------------------------------------------------------------------------------------------------- */

/* Working memory of one predictor. Public only so that its size is a constant: do not read or write its members. */
typedef struct aminn_context {
    const aminn_model_t *model;
    uint32_t tag; /* set by aminn_init */
    uint32_t flags;
    uint32_t stages_done;         /* bit i: stage[i] holds values of the latest prediction */
    const aminn_varied_t *varied; /* in use: the model's, or a calibration's */
    aminn_status_t (*correct)(const aminn_calibration_t *, aminn_state_t *); /* null without a calibration */
    aminn_stage_debug_t stage[AMINN_N_STAGE];
    aminn_input_t input;            /* of aminn_predict_state: the state and its closure */
    const aminn_sensors_t *sensors; /* null: nothing is known but the state */
    aminn_status_t (*sense)(struct aminn_context *, const aminn_input_t *); /* null likewise */
    float sensed[AMINN_N_SENSED];                                           /* what networks see of the sensors */
#if AMINN_N_SLIDE
    float friction; /* coefficient that the layer starts from */
    float preload[AMINN_N_BRANCH]
                 [3]; /* tangential forces that carry the tool's weight, N; zeros where it is not known */
#endif
    float contact_input[AMINN_N_CONTACT_INPUT];
    float slog_w[AMINN_N_WRENCH];
    float layer_in[AMINN_N_LAYER_IN];
    float layer_out[AMINN_N_LAYER_OUT]; /* statics works in AMINN_N_ROOM numbers from layer_in on */
    float feature[AMINN_MAX_WIDTH + AMINN_N_STATICS];
    float head[AMINN_N_HEAD_STORED];
} aminn_t;

/* Compute stage 2 also when stage 1 says that the grasp does not hold, so that dx_ht, k_x and gate are always numbers.
 * They then answer "how far would it move if it held". For comparisons; a controller does not need it. */
#define AMINN_FLAG_ALWAYS_STAGE2 1u

/* Keep what aminn_debug() shows. This takes about a tenth of a prediction's time on a Cortex-M, a twentieth on a host; the
 * outputs are the same. */
#define AMINN_FLAG_DEBUG 2u

/* ---- Functions ------------------------------------------------------------------------------------------------- */

/*
 * Prepare a context for a model.
 *
 *   ctx    written. May be uninitialised memory. After an error it is marked not initialised.
 *   model  checked with aminn_model_check(), kept by reference: must outlive the context.
 *   flags  0, or AMINN_FLAG_ALWAYS_STAGE2, AMINN_FLAG_DEBUG, or both joined by |.
 *
 * Returns AMINN_OK, AMINN_E_NULL, AMINN_E_FLAGS, AMINN_E_CONTEXT_SIZE, or what aminn_model_check() returns. Reads all
 * of the model once: call it at start, not in the control loop.
 */
static inline aminn_status_t aminn_init(aminn_t *ctx, const aminn_model_t *model, uint32_t flags);

/*
 * What aminn_init() calls, for other languages. ctx_size is sizeof(aminn_t) as the caller was compiled. With another
 * AMINN_MAX_WIDTH than the library's it differs: AMINN_E_CONTEXT_SIZE is returned and *ctx is left untouched.
 */
aminn_status_t aminn_init_sized(aminn_t *ctx, size_t ctx_size, const aminn_model_t *model, uint32_t flags);

static inline aminn_status_t aminn_init(aminn_t *ctx, const aminn_model_t *model, uint32_t flags)
{
    return aminn_init_sized(ctx, sizeof(aminn_t), model, flags);
}

/*
 * Check that this library, on this processor, computes the bits that it must. Two lines at boot:
 *
 *     aminn_status_t status = aminn_init(&ctx, &aminn_model, 0);
 *     status = status == AMINN_OK ? aminn_self_test(&ctx) : status;
 *
 *   ctx  initialised context. Its flags and its calibration stay; the test is of the nominal hand. What aminn_debug() showed
 *        is gone.
 *
 * Checks the arithmetic of the code that predicts, then the CRC-32 of the model's constants and tables. Then it predicts the
 * model's known answer and compares every word of the output and of both stages. Takes as long as a prediction and a CRC-32
 * of the whole model: call it at start, not in the control loop. No output but the status.
 *
 * Returns AMINN_OK; AMINN_E_NULL; AMINN_E_NOT_INITIALISED; in this order AMINN_E_ROUNDING, AMINN_E_FAST_MATH,
 * AMINN_E_CONTRACTED, AMINN_E_FLUSH: what is wrong with the arithmetic, by compiler option or processor state;
 * AMINN_E_CRC: the model is damaged; AMINN_E_KNOWN_ANSWER: neither, and yet other bits. After an error predictions may be
 * wrong in any digit. The context still predicts; do not use it.
 */
aminn_status_t aminn_self_test(aminn_t *ctx);

/*
 * Predict from a state and its closure Jacobians.
 *
 *   ctx  initialised context, written.
 *   in   not changed; must not lie inside ctx.
 *   out  written.
 *
 * Returns AMINN_OK; AMINN_E_NULL; AMINN_E_NOT_INITIALISED; for a bad input, in this order of precedence,
 * AMINN_E_NONFINITE, AMINN_E_CONTACT_FLAG, AMINN_E_NORMAL (length differs from 1 by more than 1e-3), AMINN_E_ROTATION
 * (length exceeds pi by more than 0.1 %), AMINN_E_NO_CONTACT; AMINN_E_SENSORS for a bad sensor (aminn_sense());
 * AMINN_E_NUMERIC if a result is not finite, or if by it the load would take energy out of the grasp (w_e . dx < 0 in
 * either stage: float32 has lost all digits).
 * After any error, if out is not null: stable 0, p_stable 0, all else NaN; aminn_debug() returns null. The context
 * stays initialised: the next call with a good input works.
 */
aminn_status_t aminn_predict(aminn_t *ctx, const aminn_input_t *in, aminn_output_t *out);

/*
 * Predict from a state. The context's calibration, if it has one, corrects a copy of the state. Then the closure Jacobians are
 * computed from the hand's geometry in the model, as aminn_closure() does.
 *
 * Arguments, returned values and outputs after an error as for aminn_predict().
 */
aminn_status_t aminn_predict_state(aminn_t *ctx, const aminn_state_t *state, aminn_output_t *out);

/*
 * Give the model what sensors know beside the state.
 *
 *   ctx      initialised context of a model that sees sensors (n_sensed is not 0).
 *   sensors  kept by reference, read and checked at each prediction from then on: must outlive its use, and may change between
 *            predictions. Null: nothing is known, as after aminn_init().
 *
 * A sensor that is not known (flag 0) is not the same as one that reads zero. Where contacts can slide, friction moves the
 * coefficient that they start from, as far as its deviation allows, and the tool's weight gives what they carry before the
 * load. Where they cannot, only the networks see the sensors.
 *
 * Returns AMINN_OK; AMINN_E_NULL; AMINN_E_NOT_INITIALISED; AMINN_E_SENSORS where the model sees none, after which ctx is as
 * before. A prediction returns AMINN_E_SENSORS where a number is not finite, known or not, a flag is neither 0 nor 1, a known
 * coefficient of friction is not above 0, or its standard deviation is negative; a bad state comes first. A known weight makes
 * a prediction about 7 % longer. Nothing of it is linked unless called.
 */
aminn_status_t aminn_sense(aminn_t *ctx, const aminn_sensors_t *sensors);

/*
 * Fill in a calibration from theta, for a model.
 *
 *   cal    written; may be in use by contexts, none of which predicts meanwhile. After an error it is as it was.
 *   model  checked model, kept by reference: must outlive the calibration.
 *   theta  AMINN_N_THETA numbers in the order of aminn_theta_name(); null: nominal, as zeros are. Nominal gives the bits of
 *          a prediction without a calibration.
 *
 * Returns AMINN_OK; AMINN_E_NULL; AMINN_E_NONFINITE; AMINN_E_CALIBRATION where a number is beyond AMINN_MAX_LOG_FACTOR,
 * AMINN_MAX_ZERO or AMINN_MAX_RADIUS, either way; AMINN_E_MODEL where the model's springs do not hold with theta: its
 * theta_terms are not those of its springs. Takes about a ninth of a prediction on a Cortex-M, a fifth on a host.
 */
aminn_status_t aminn_calibration_set(aminn_calibration_t *cal, const aminn_model_t *model,
                                     const float theta[AMINN_N_THETA]);

/*
 * Predict for the hand that a calibration describes.
 *
 *   ctx  initialised context.
 *   cal  set for the model of ctx, kept by reference: must outlive its use. If aminn_calibration_set() changes it later, that
 *        counts from the next prediction on. Null: nominal again, as after aminn_init().
 *
 * From then on the layer's springs, tendons and contacts are the calibration's, and a told model's networks see its factors.
 * aminn_predict_state() corrects the state (aminn_correct()); aminn_predict() takes a corrected one with its Jacobians.
 * Returns AMINN_OK, AMINN_E_NULL, AMINN_E_NOT_INITIALISED, or AMINN_E_CALIBRATION where cal was not set for the context's
 * model; after an error what ctx used stays in use.
 */
aminn_status_t aminn_calibrate(aminn_t *ctx, const aminn_calibration_t *cal);

/*
 * Correct a measured state: add the joints' zeros to q, and move contacts by the tips' radius along their normals.
 *
 *   cal    filled in by aminn_calibration_set().
 *   state  q and contacts changed.
 *
 * aminn_predict_state() does it to a copy by itself. Returns AMINN_OK or AMINN_E_NULL.
 */
aminn_status_t aminn_correct(const aminn_calibration_t *cal, aminn_state_t *state);

/*
 * Prepare a calibrator.
 *
 *   calibrator  written. After an error it is as it was.
 *   model       checked model, kept by reference: must outlive the calibrator.
 *   theta       where to begin, AMINN_N_THETA numbers; null: nominal. Joint zeros and radius stay as they are here.
 *   settings    copied; null: aminn_calibrator_defaults.
 *
 * Returns AMINN_OK, AMINN_E_NULL, AMINN_E_CALIBRATION where a setting is out of its range or a factor of theta beyond the
 * setting `bound`, or what aminn_calibration_set() returns.
 */
aminn_status_t aminn_calibrator_init(aminn_calibrator_t *calibrator, const aminn_model_t *model,
                                     const float theta[AMINN_N_THETA], const aminn_calibrator_settings_t *settings);

/*
 * Learn from one push: a known load on a grasp at rest, and how far the tool moved in the hand until it rested again.
 *
 *   ctx         initialised context of the calibrator's model, written. What it predicts for stays: aminn_calibrate() it with
 *               &calibrator->calibration once, and each push counts from the next prediction on. What aminn_debug() showed is gone.
 *   calibrator  written; contexts that use its calibration must not predict meanwhile. After an error it is as it was.
 *   before      measured state before the load, and the load (w_e).
 *   dx_ht       measured displacement (6): m, rotation vector, rad. Of a grasp that held.
 *
 * Give all pushes of one grasp one after another. Each further one of a grasp counts less, since the model errs alike on
 * them. A grasp is the same where no joint has turned by more than 0.02 rad, nor the tool moved by more than 2 mm.
 *
 * Where contacts can slide (AMINN_N_SLIDE) and ctx has sensors (aminn_sense()), each push also says something about the
 * friction of its grasp, whatever becomes of theta: aminn_calibrator_friction(). This starts again with each grasp.
 *
 * Takes about as long as two predictions. Returns AMINN_OK: see calibrator->outcome; AMINN_E_NULL; AMINN_E_NOT_INITIALISED;
 * AMINN_E_CALIBRATION where the calibrator is not of the context's model, or was moved; for a bad state or displacement what
 * aminn_predict_state() returns; AMINN_E_NUMERIC where the statics or the fit are not finite.
 */
aminn_status_t aminn_calibrate_push(aminn_t *ctx, aminn_calibrator_t *calibrator, const aminn_state_t *before,
                                    const float dx_ht[AMINN_N_WRENCH]);

/*
 * Friction as the pushes of the present grasp and a sensor know it, in the form of aminn_sensors_t.friction.
 *
 *   calibrator  as aminn_calibrate_push() left it.
 *   state       the grasp in question. If it is another grasp than that of the latest push, only the sensor counts.
 *   sensor      what else is known of friction, in the form of aminn_sensors_t.friction; null: nothing. Do not pass what this
 *               function has written: that would count the pushes twice.
 *   friction    written (3): known (0 or 1), coefficient, standard deviation. All zeros where nothing is known.
 *
 * Returns AMINN_OK, AMINN_E_NULL, or AMINN_E_SENSORS for a sensor that aminn_sense() would refuse; after an error friction is
 * as it was.
 */
aminn_status_t aminn_calibrator_friction(const aminn_calibrator_t *calibrator, const aminn_state_t *state,
                                         const float sensor[3], float friction[3]);

/* Standard deviation of the logarithm of factor i, 0 .. AMINN_N_FACTOR - 1, so far. One near the setting `prior` means that
 * no push said anything about it. 0 for another i, or null. */
float aminn_calibrator_sd(const aminn_calibrator_t *calibrator, int i);

/*
 * The largest load along a direction that the grasp is predicted to bear.
 *
 *   ctx        initialised context; its calibration counts. What aminn_debug() showed is gone.
 *   state      as for aminn_predict_state(); its w_e is the part of the load that acts in any case, zero if none does.
 *   direction  the load with scale is w_e + scale * direction (6: N, N.m, axes of H): a unit force, or a commanded load.
 *   limits     when a load is admissible. max_translation is compared with the length of the predicted translation plus
 *              margin * bound_95 * length_scale, max_rotation with the angle plus margin * bound_95.
 *   found      written.
 *
 * A prediction need not be monotonic in the load. So the scale is the end of the stretch of admissible loads that begins at
 * zero. Predictions are made at zero and at (1/8)^2, (2/8)^2 .. 1 of max_scale, or of the smaller scale with which the load
 * leaves the range that the model was trained on. Four halvings then narrow down where the stretch ends. The scale is on average
 * 2 % below that end, by a sixteenth of the last step at most. Every load that was tried and is not larger is admissible.
 *
 * Takes at most AMINN_LOAD_PREDICTIONS predictions, nearly all of its time, and 1 kB of stack beside them. No prediction with
 * a load is as certain as it says: choose p_stable and margin for the risk that you accept (docs/runtime.md has figures).
 *
 * Returns AMINN_OK; AMINN_E_NULL; AMINN_E_NOT_INITIALISED; AMINN_E_NONFINITE for the direction; AMINN_E_LIMITS; what
 * aminn_predict_state() returns for the state or for one of the loads. After an error, if found is not null: scale 0, admissible
 * 0, `at` as after an error of a prediction.
 */
aminn_status_t aminn_admissible_load(aminn_t *ctx, const aminn_state_t *state, const float direction[AMINN_N_WRENCH],
                                     const aminn_load_limits_t *limits, aminn_admissible_t *found);

/*
 * Closure Jacobians from joint angles, tool position and contacts.
 *
 *   model     checked model (aminn_init or aminn_model_check returned AMINN_OK); its geom_* tables are used.
 *   q         joint angles, rad (J).
 *   x_ht      tool pose in H (6); only the position is used.
 *   contacts  rows of aminn_state_t.contacts (B x 8); only flag and position are used.
 *   j_x, j_q  written (B x 3 x 6) and (B x 3 x C); the blocks of a branch whose contact flag is 0 are zero.
 *
 * Returns AMINN_OK, AMINN_E_NULL, AMINN_E_NONFINITE, or AMINN_E_NUMERIC where a joint angle exceeds 8192 rad: its sine has
 * no digits. After an error j_x and j_q are NaN throughout (where not null).
 */
aminn_status_t aminn_closure(const aminn_model_t *model, const float q[AMINN_N_JOINT], const float x_ht[AMINN_N_WRENCH],
                             const float contacts[AMINN_N_BRANCH][AMINN_N_CONTACT_FEATURE],
                             float j_x[AMINN_N_BRANCH][3][AMINN_N_WRENCH], float j_q[AMINN_N_BRANCH][3][AMINN_N_COORD]);

/*
 * Intermediate values of the latest prediction of a context.
 *
 *   ctx    context, read; initialised with AMINN_FLAG_DEBUG.
 *   stage  0: stage 1, 1: stage 2.
 *
 * Returns a view into the context, valid until its next use; null if ctx is null, not initialised, or without that flag,
 * if there is no such stage, if the latest prediction failed, or if it skipped that stage.
 */
const aminn_stage_debug_t *aminn_debug(const aminn_t *ctx, int stage);

/*
 * Check a model: version, dimensions, no missing table, every number finite, constants in their ranges.
 *
 * Returns AMINN_OK, AMINN_E_NULL, AMINN_E_VERSION, AMINN_E_DIMS, or AMINN_E_MODEL.
 */
aminn_status_t aminn_model_check(const aminn_model_t *model);

/*
 * Use a model that lies in memory as the bytes of an aminn_model.bin (a flash partition, a file read or mapped).
 *
 *   bytes      start of the blob, aligned to 4 bytes, little endian. Not copied: must stay while the model is used. On a
 *              processor with caches a prediction is fastest if it is aligned to 64 bytes.
 *   len        number of bytes there; exactly the blob's own length.
 *   model_out  written: constants and pointers into bytes.
 *
 * Returns AMINN_OK, AMINN_E_NULL, AMINN_E_ALIGN, AMINN_E_SIZE, AMINN_E_BYTE_ORDER, AMINN_E_MAGIC, AMINN_E_VERSION,
 * AMINN_E_CRC, or what aminn_model_check() returns. After an error *model_out is all zero, which every other function refuses.
 */
aminn_status_t aminn_model_from_blob(const void *bytes, size_t len, aminn_model_t *model_out);

/*
 * Find the first number of a state that lies outside what the model was trained on: why AMINN_NOTE_OUT_OF_RANGE is set.
 *
 *   model  checked model.
 *   state  AMINN_N_STATE numbers in the order of its fields: q, x_ht, w_e, contacts.
 *
 * Returns its index into range_min and range_max, which aminn_field_name() names; -1 if there is none or a pointer is null.
 * It is not -1 exactly where a prediction from that state is noted as out of range. Of a branch out of contact only the flag
 * counts.
 */
int aminn_first_out_of_range(const aminn_model_t *model, const aminn_state_t *state);

/* Name of such a number with its unit, for instance "contacts[2].normal_force_N"; "none" for any other index. A constant,
 * never null. */
const char *aminn_field_name(int index);

/* Name of a number of theta, for instance "spring_finger1_roll"; "none" for any other index. Units: zero_ are rad, radius_ m, all
 * others logarithms. A constant, never null. */
const char *aminn_theta_name(int index);

/* Name of a status code, for instance "AMINN_E_CRC"; "AMINN_E_UNKNOWN" for any other number. A constant, never null. */
const char *aminn_status_name(int status);

/* Meaning of a status code in one sentence part. A constant, never null. */
const char *aminn_status_text(int status);

/* Version of the library that is linked, for instance "0.1.0"; compare with AMINN_VERSION_STRING. */
const char *aminn_version(void);

#ifdef __cplusplus
}
#endif

#endif /* AMINN_RT_H */
