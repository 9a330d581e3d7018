"""Every dimension and name order of the Python side. `aminn_rt.h` has the C side's; a test compares the two."""

from __future__ import annotations

BRANCHES = ("finger1", "finger2", "thumb")
JOINTS = (
    "finger1_roll",
    "finger1_proximal",
    "finger1_distal",
    "finger2_roll",
    "finger2_proximal",
    "finger2_distal",
    "thumb_proximal",
    "thumb_distal",
)
COORDS = ("roll", "proximal", "distal")

# Joint that drives each branch coordinate; -1 where the coordinate does not exist (the thumb has no roll).
BRANCH_JOINTS = ((0, 1, 2), (3, 4, 5), (-1, 6, 7))

N_BRANCH = len(BRANCHES)
N_COORD = len(COORDS)
N_JOINT = len(JOINTS)
N_WRENCH = 6
N_TENDON = 2 * N_BRANCH  # a branch has the proximal flexor, then the one across both joints
N_CONTACT_FEATURE = 8  # in contact, position (3), normal (3), normal force

# What the networks see and give.
N_BRANCH_FEATURE = N_CONTACT_FEATURE + 3 * N_COORD  # contact row and the branch's block of J_q
N_CONTACT_INPUT = N_BRANCH * N_BRANCH_FEATURE
N_GLOBAL_INPUT = N_JOINT + 3 * N_WRENCH  # q, x_ht, w_e, w_e in signed logarithm
N_BRANCH_HEAD = 13  # 3 + 3 of the Cholesky factor, 3 direction, gain, alpha, beta, rho
N_HEAD = N_BRANCH * N_BRANCH_HEAD
N_AUX = 2 * N_WRENCH + N_BRANCH  # what stage 1's classifier sees of the statics: motion, diagonal of K_x, gates

# Length that makes rotations comparable with translations, in the 6x6 solve and in every pose error (m).
LENGTH_SCALE_M = 0.1
# Least size of a motion that is divided by, so that no motion at all can be (m).
LEAST_MOTION_M = 1e-12

INPUT_SHAPES: dict[str, tuple[int, ...]] = {
    "q": (N_JOINT,),
    "x_ht": (N_WRENCH,),
    "w_e": (N_WRENCH,),
    "contacts": (N_BRANCH, N_CONTACT_FEATURE),
    "j_x": (N_BRANCH, 3, N_WRENCH),
    "j_q": (N_BRANCH, 3, N_COORD),
}
OUTPUT_SHAPES: dict[str, tuple[int, ...]] = {
    "p_stable": (),
    "dx_ht": (N_WRENCH,),
    "k_x": (N_WRENCH, N_WRENCH),
    "gate": (N_BRANCH,),
}
# Intermediate values of one stage; `aminn_debug.onnx` and the runtime's debug view carry them for both stages.
DEBUG_SHAPES: dict[str, tuple[int, ...]] = {
    "k_spring": (N_BRANCH, N_COORD, N_COORD),
    "tendon_dir": (N_BRANCH, N_COORD),
    "tendon_gain": (N_BRANCH,),
    "gate_params": (N_BRANCH, 3),
    "dx0": (N_WRENCH,),
    "dq0": (N_BRANCH, N_COORD),
    "dx": (N_WRENCH,),
    "k_x": (N_WRENCH, N_WRENCH),
    "gate": (N_BRANCH,),
}
