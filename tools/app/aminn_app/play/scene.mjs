/** What the picture shows of a grasp under load, as items for the view. */

import {
  branchPose, closing, frameAlong, jointsUnderLoad, toolParts, toolPose,
} from "./hand.mjs";
import { CONE, CYLINDER, FUNNEL, SPHERE, TUBE, capsule, ring, surface } from "./shapes.mjs";
import { add, inverse, largestEigenvalue, norm, scaled, subtract, times, transposed, unit } from "./vector.mjs";
import { placed, rgb } from "./view.mjs";

const REACH_M = 0.1; // length of the arrow of a hand's largest load
const CONTACT_M_N = 0.005; // of a contact's newton
const LINK_SHARE = 0.6; // a link's radius, of its tip's
const PLAIN_TIP_M = 0.008; // radius of a tip that is not round
const PALM_M = 0.009;
const ELLIPSOID_M = 0.035; // longest half axis
const RING = ring(0.2);
const [TURN, TURN_SHARE] = [0.024, 0.75]; // the curved arrow of a moment: radius in m, share of a whole turn
const TURN_ARROW = ring(0.055, TURN_SHARE);
const PALM = [0.68, 0.7, 0.73];
const SLACK = [0.62, 0.63, 0.65];
const WOUND = rgb("#e8590c");
const MOST_WOUND_NM = 0.03; // torque of a spring that is drawn in that colour
/** Colours of the admissible load's surface, by LIMITED_BY. */
export const LIMIT_COLOURS = ["#8d99ae", "#d1495b", "#2e86ab", "#3c9d9b", "#edae49", "#8d99ae"];

const mixed = (a, b, share) => a.map((x, i) => x + (b[i] - x) * Math.max(0, Math.min(1, share)));

function between(mesh, start, end, radius, colour, alpha) {
  const along = subtract(end, start);
  const [x, y] = frameAlong(along);
  return { mesh, matrix: placed(start, [scaled(x, radius), scaled(y, radius), along]), colour, alpha };
}

function ball(centre, radius, colour, alpha) {
  return { mesh: SPHERE, matrix: placed(centre, [[radius, 0, 0], [0, radius, 0], [0, 0, radius]]), colour, alpha };
}

/** An arrow of a shaft and a head; nothing where it has no length. */
export function arrow(start, vector, radius, colour, alpha) {
  const size = norm(vector);
  if (size < 1e-5) return [];
  const head = Math.min(5.5 * radius, 0.6 * size);
  const neck = add(start, scaled(vector, 1 - head / size));
  return [
    between(CYLINDER, start, neck, radius, colour, alpha),
    between(CONE, neck, add(start, vector), 2.4 * radius, colour, alpha),
  ];
}

/** A curved arrow about an axis through a point, by the right hand. */
function turning(centre, axis, colour) {
  const [x, y, z] = frameAlong(axis).map((v) => scaled(v, TURN));
  const angle = 2 * Math.PI * TURN_SHARE;
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  const end = add(centre, add(scaled(x, c), scaled(y, s)));
  const onward = unit(add(scaled(x, -s), scaled(y, c)));
  return [
    { mesh: TURN_ARROW, matrix: placed(centre, [x, y, z]), colour },
    between(CONE, subtract(end, scaled(onward, 0.002)), add(end, scaled(onward, 0.008)), 0.0036, colour),
  ];
}

/** Lengths that stand for a newton of the load's force, and for a newton metre of its moment. */
export function scaleOf(hand) {
  const [force, moment] = hand.largest_load.map((largest) => REACH_M / largest);
  return { force, moment };
}

const meshes = new WeakMap();

/** Meshes of a tool's primitives in the tool's frame, made once. */
function toolMeshes(grasp) {
  if (!meshes.has(grasp)) {
    const made = toolParts(grasp.tool.geoms).map(({ kind, size, origin, turn }) => {
      const [x, y, z] = [0, 1, 2].map((i) => [turn[i], turn[3 + i], turn[6 + i]]);
      const [radius, half] = size;
      if (kind === "capsule") return { mesh: capsule(radius, half), origin, axes: [x, y, z] };
      if (kind === "cylinder") {
        const bottom = subtract(origin, scaled(z, half));
        return { mesh: CYLINDER, origin: bottom, axes: [scaled(x, radius), scaled(y, radius), scaled(z, 2 * half)] };
      }
      const half3 = kind === "sphere" ? [radius, radius, radius] : size;
      return { mesh: SPHERE, origin, axes: [scaled(x, half3[0]), scaled(y, half3[1]), scaled(z, half3[2])] };
    });
    meshes.set(grasp, made);
  }
  return meshes.get(grasp);
}

function tool(grasp, pose, colour, alpha) {
  return toolMeshes(grasp).map(({ mesh, origin, axes }) => ({
    mesh,
    matrix: placed(add(pose.origin, times(pose.turn, origin)), axes.map((axis) => times(pose.turn, axis))),
    colour,
    alpha,
  }));
}

/** A branch: links, tip, a ring for each joint's spring, and its gated tendon. */
function finger(branch, q, does, gate) {
  const [colour, pose] = [rgb(branch.colour), branchPose(branch, q)];
  const tip = branch.tip_radius_m || PLAIN_TIP_M;
  const [radius, last] = [LINK_SHARE * tip, pose.points.length - 1];
  const items = pose.points.map((point, k) => ball(point, k === last ? tip : radius, colour));
  for (let k = 0; k < last; k++) {
    items.push(between(TUBE, pose.points[k], pose.points[k + 1], k === last - 1 ? 0.92 * radius : radius, colour));
  }
  pose.axes.forEach((axis, k) => {
    const [x, y, z] = frameAlong(axis).map((v) => scaled(v, 1.3 * radius));
    const wound = mixed(SLACK, WOUND, Math.abs(does.torques[k]) / MOST_WOUND_NM);
    items.push({ mesh: RING, matrix: placed(pose.anchors[k], [x, y, z]), colour: wound });
  });
  if (branch.gated) {
    const taut = mixed(SLACK, scaled(colour, 0.62), gate);
    const thickness = 0.0009 + 0.0015 * gate;
    const side = closing(pose);
    const path = pose.points.map((point, k) => add(point, scaled(side, (k === last ? 0.8 : 1.35) * radius)));
    for (let k = 0; k < last; k++) {
      items.push(between(TUBE, path[k], path[k + 1], thickness, taut), ball(path[k], thickness, taut));
    }
  }
  return { items, pose };
}

/** How a contact presses: the force on the tool, and the cone that friction keeps it in. */
function contact(branch, does, friction, use) {
  if (does.flag === 0) return { solid: [], clear: [] };
  const colour = rgb(branch.colour);
  const length = CONTACT_M_N * Math.max(does.presses, 0.2);
  const [x, y] = frameAlong(does.normal).map((v) => scaled(v, friction * length));
  const over = mixed(colour, rgb("#d00000"), use > 1 ? 0.8 : 0);
  const cone = { mesh: FUNNEL, matrix: placed(does.point, [x, y, scaled(does.normal, length)]), colour: over, alpha: 0.34 };
  return {
    solid: arrow(does.point, scaled(does.force, CONTACT_M_N), 0.0011, scaled(colour, 0.75)),
    clear: friction > 0 ? [cone] : [],
  };
}

/** Compliance of the grasped tool (m/N, or rad/(N.m) of rotations), 3 x 3. */
export function compliance(k_x, rotations) {
  const whole = inverse(Array.from(k_x), 6);
  const start = rotations ? 3 : 0;
  return [0, 1, 2].flatMap((i) => whole.slice(6 * (start + i) + start, 6 * (start + i) + start + 3));
}

function ellipsoid(origin, k_x, rotations, colour) {
  const c = compliance(k_x, rotations);
  const size = ELLIPSOID_M / largestEigenvalue(c);
  const columns = transposed(c);
  const axes = [0, 1, 2].map((i) => scaled(columns.slice(3 * i, 3 * i + 3), size));
  return { mesh: SPHERE, matrix: placed(origin, axes), colour, alpha: 0.3 };
}

/** The mesh of largest loads {scale, limited_by} along the directions, so many metres a unit, about the tool's origin. */
export function loadSurface({ corners, faces }, loads, scale) {
  const points = corners.map((direction, i) => scaled(direction, scale * loads[i].scale));
  return surface(points, faces, loads.map(({ limited_by }) => rgb(LIMIT_COLOURS[limited_by])));
}

/**
 * All items of a picture. `given`: hand, grasp, load (6), found (the prediction), branches (branchesUnderLoad), factor of
 * the motion, truth (a recorded load case or null), surface (a mesh or null), show (what is ticked), colours.
 */
export function sceneOf(given) {
  const { hand, grasp, load, found, branches, factor, truth, show, colours } = given;
  const [solid, clear, front] = [[], [], []];
  const q = jointsUnderLoad(hand, grasp.q, branches, factor);
  const bases = [];
  hand.branches.forEach((branch, b) => {
    const { items, pose } = finger(branch, q, branches[b], found.gate[b]);
    solid.push(...items);
    bases.push(pose.points[0]);
    if (show.contacts) {
      const stage = found.stages[1];
      const shown = contact(branch, branches[b], stage.friction[b], found.friction_use[b]);
      solid.push(...shown.solid);
      clear.push(...shown.clear);
    }
  });
  const middle = scaled(bases.reduce(add), 1 / bases.length);
  solid.push(ball(middle, PALM_M, PALM));
  for (const base of bases) solid.push(between(TUBE, middle, base, PALM_M, PALM), ball(base, PALM_M, PALM));
  const pose = toolPose(grasp.x_ht, found.dx_ht, factor);
  if (show.before) clear.push(...tool(grasp, toolPose(grasp.x_ht, found.dx_ht, 0), rgb(colours.ghost), 0.12));
  if (truth) clear.push(...tool(grasp, toolPose(grasp.x_ht, truth.dx_ht, factor), rgb(colours.truth), 0.3));
  clear.push(...tool(grasp, pose, rgb(colours.tool), 0.5));
  if (show.compliance !== "none") {
    clear.push(ellipsoid(pose.origin, found.k_x, show.compliance === "rotation", rgb(colours.compliance)));
  }
  if (given.surface) {
    const axes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
    clear.push({ mesh: given.surface, matrix: placed(pose.origin, axes), alpha: 0.2 });
  }
  const red = rgb(colours.load);
  const [force, moment, scale] = [load.slice(0, 3), load.slice(3), scaleOf(hand)];
  front.push(...arrow(pose.origin, scaled(force, scale.force), 0.0016, red));
  if (norm(moment) > 1e-4) {
    const end = add(pose.origin, scaled(moment, scale.moment));
    front.push(...turning(pose.origin, moment, red), between(CYLINDER, pose.origin, end, 0.0007, red));
  }
  front.push(...triad());
  const tips = hand.branches.map((branch) => branchPose(branch, q).points.at(-1));
  return { solid, clear, front, origin: pose.origin, tips };
}

/** The axes of the palm frame, small, in its origin. */
function triad() {
  const colours = [[0.75, 0.3, 0.3], [0.3, 0.6, 0.35], [0.3, 0.42, 0.75]];
  return colours.flatMap((colour, i) => {
    const axis = [0, 0, 0];
    axis[i] = TRIAD_M;
    return arrow([0, 0, 0], axis, 0.0008, colour);
  });
}
export const TRIAD_M = 0.022;
