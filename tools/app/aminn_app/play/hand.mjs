/** The hand and its tool: where they are, and what fingers do under a load. SI, palm frame H. */

import {
  acrossOf, add, cross, dot, inverse, norm, ofQuaternion, rotation, scaled, subtract, times, transposed, unit,
} from "./vector.mjs";

const SAME_POINT_M = 1e-6;
const IDENTITY = [1, 0, 0, 0, 1, 0, 0, 0, 1];

/** A branch at the joint angles q of the hand: its axes and anchors, and its points from the palm to the tip. */
export function branchPose(branch, q) {
  let [turn, origin] = [IDENTITY, [0, 0, 0]];
  const [axes, anchors] = [[], []];
  for (const { axis, anchor_m, joint } of branch.coordinates) {
    const [turned, anchor] = [times(turn, axis), add(origin, times(turn, anchor_m))];
    const step = rotation(scaled(turned, q[joint]));
    origin = add(anchor, times(step, subtract(origin, anchor)));
    turn = times(step, turn);
    axes.push(turned);
    anchors.push(anchor);
  }
  const points = [];
  for (const point of [...anchors, add(origin, times(turn, branch.tip_point_m))]) {
    if (!points.length || norm(subtract(point, points.at(-1))) > SAME_POINT_M) points.push(point);
  }
  return { axes, anchors, points };
}

/** Pose (6) of the tool after a displacement that is drawn so many times as large: {origin, turn}. */
export function toolPose(x_ht, dx, factor) {
  const more = Array.from(dx, (x) => x * factor);
  return {
    origin: add(x_ht.slice(0, 3), more.slice(0, 3)),
    turn: times(rotation(more.slice(3)), rotation(x_ht.slice(3))),
  };
}

/**
 * What each branch does under the load of a prediction `stage`, by the statics that the model predicts springs and tendons for. Where
 * the model has cut the motion, forces are those of the whole load and turns those of the motion that is left.
 * Of each branch: turns of its coordinates (rad), torques of its springs there (N.m), the force on the tool (N) and where.
 */
export function branchesUnderLoad(hand, state, stage) {
  const c = hand.coordinates;
  const dx = Array.from(stage.dx);
  const work = dot(state.w_e, dx);
  const drawn = work > 0 ? Math.min(1, dot(dx, times(Array.from(stage.k_x), dx, 6)) / work) : 1;
  const whole = scaled(dx, 1 / drawn);
  return hand.branches.map((branch, b) => {
    const [flag, ...place] = state.contacts.slice(8 * b, 8 * b + 7);
    const [point, normal, pressing] = [place.slice(0, 3), place.slice(3), state.contacts[8 * b + 7]];
    const n = branch.coordinates.length;
    if (flag === 0) return { turns: Array(n).fill(0), torques: Array(n).fill(0), force: [0, 0, 0], point, normal, flag };
    const { axes, anchors } = branchPose(branch, state.q);
    const columns = axes.map((axis, k) => cross(axis, subtract(point, anchors[k])));
    const jacobian = [0, 1, 2].flatMap((row) => columns.map((column) => column[row])); // 3 x n
    const spring = (i, j) => {
      const [row, column] = [i + c - n, j + c - n];
      const direction = stage.tendon_dir;
      const tendon = stage.tendon_gain[b] * stage.gate[b] * direction[b * c + row] * direction[b * c + column];
      return stage.k_spring[b * c * c + row * c + column] + tendon;
    };
    const springs = Array.from({ length: n * n }, (_, k) => spring(Math.floor(k / n), k % n));
    const bends = times(inverse(springs, n), transposed(jacobian), n); // n x 3: turns by a force
    const gives = times(jacobian, bends).map((value, k) => {
      const [i, j] = [Math.floor(k / 3), k % 3];
      const across = (i === j ? 1 : 0) - normal[i] * normal[j];
      return value + (i === j ? branch.eps_m : 0) + stage.slide[b] * across;
    });
    const arm = subtract(point, state.x_ht.slice(0, 3));
    const motion = add(whole.slice(0, 3), cross(whole.slice(3), arm));
    const share = scaled(times(inverse(gives), motion), flag); // what the finger bears of the load
    const turns = scaled(times(bends, share, n), drawn);
    const preload = Array.from(stage.preload.slice(3 * b, 3 * b + 3));
    const force = subtract(add(scaled(normal, pressing), preload), share);
    return { turns, torques: times(springs, turns, n), force, point, normal, flag, presses: dot(force, normal) };
  });
}

/** Joint angles with the turns of all branches, drawn so many times as large. */
export function jointsUnderLoad(hand, q, branches, factor) {
  const found = Array.from(q);
  hand.branches.forEach((branch, b) => {
    branch.coordinates.forEach(({ joint }, k) => (found[joint] += factor * branches[b].turns[k]));
  });
  return found;
}

/** Which way a finger closes at its tip: the direction in which its last joint moves the last link. */
export function closing(pose) {
  const [start, end] = pose.points.slice(-2);
  return unit(cross(pose.axes.at(-1), subtract(end, start)));
}

/** The primitives of a tool, as data sets have them: {kind, size, origin, turn}, each in the tool's frame. */
export function toolParts(geoms) {
  const kinds = { 2: "sphere", 3: "capsule", 4: "ellipsoid", 5: "cylinder" };
  return geoms
    .filter(([kind]) => kind >= 0)
    .map(([kind, ...rest]) => ({
      kind: kinds[kind],
      size: rest.slice(0, 3),
      origin: rest.slice(3, 6),
      turn: ofQuaternion(rest.slice(6)),
    }));
}

/** A frame whose z is along a vector: the columns x, y, z of unit length. */
export function frameAlong(vector) {
  const z = unit(vector);
  return [...acrossOf(z), z];
}
