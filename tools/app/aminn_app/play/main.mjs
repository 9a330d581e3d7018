/** The page: what is chosen, what follows from it, and what the user does. */

import { LIMITED_BY, Model } from "./aminn.mjs";
import { branchesUnderLoad } from "./hand.mjs";
import {
  byId, digits, fixed, loadText, makeFingers, showFingers, showLargest, showLegend, showSentence, showTruth, showVerdict,
} from "./panel.mjs";
import { LIMIT_COLOURS, TRIAD_M, loadSurface, scaleOf, sceneOf } from "./scene.mjs";
import { directions } from "./shapes.mjs";
import { add, norm, scaled, subtract } from "./vector.mjs";
import { Camera, View } from "./view.mjs";

const given = JSON.parse(document.getElementById("given").textContent);
const [COARSE, FINE] = [directions(2), directions(3)];
const REFINE_MS = 180; // after the last change
const [KEY_FORCE, KEY_MOMENT, KEY_TURN] = [0.1, 0.002, 0.08]; // N, N.m, rad a key
const VISIBLE_M = 0.006; // smaller motions are drawn larger
const FACTORS = [1, 2, 5, 10, 20];
const HANDLE_PX = 20; // least distance of a handle from the tool's origin
const [EDGE_PX, NAME_PX, LINE_PX] = [24, 46, 17]; // of handles from the canvas's edge, of names from tips and from each other
const REASONS = {
  hold: "p_stable", translation: "the motion", rotation: "the rotation", slide: "sliding", range: "what the model knows", nothing: "nothing",
};
const LIMIT_TEXTS = {
  hold: "the tool is lost", translation: "it moves too far", rotation: "it turns too far", slide: "it slides", range: "the model knows none",
};
const bytesOf = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
const AXES = ["x", "y", "z"];

const view = new View(byId("canvas"));
const camera = new Camera([0, 0.002, 0.05], 0.37, 0.42, 0.3);
const HOME = { ...camera };
const models = []; // loaded, by hand
const at = { hand: 0, grasp: 0, case: -1, load: [0, 0, 0, 0, 0, 0], surface: null, loads: [] };
let shown = null; // what the picture shows
let [frame, refining] = [0, 0];

const hand = () => given.hands[at.hand];
const grasp = () => hand().grasps[at.grasp];
const truth = () => (at.case < 0 ? null : grasp().cases[at.case]);
const stateWith = (load) => ({ q: grasp().q, x_ht: grasp().x_ht, contacts: grasp().contacts, w_e: load });
const kindShown = () => byId("surface").value;

// --- what follows from what is chosen -------------------------------------------------------------------------------

/** Predict, and draw in the browser's next frame. */
function update() {
  frame ||= requestAnimationFrame(() => {
    frame = 0;
    show();
  });
}

function told() {
  const ticked = [...document.querySelectorAll("#told input:checked")].map((box) => box.value);
  return Object.fromEntries(ticked.map((name) => [name, grasp().sensors[name]]));
}

function limits() {
  return {
    max_translation: Number(byId("limit-mm").value) / 1000,
    max_rotation: (Number(byId("limit-deg").value) * Math.PI) / 180,
    margin: byId("limit-margin").checked ? 1 : 0,
    p_stable: Number(byId("limit-p").value),
    p_slide: 1,
    max_scale: 2 * hand().largest_load[kindShown() === "moment" ? 1 : 0],
  };
}

/** A direction of forces or moments as a load. */
const asLoad = (kind, direction) => (kind === "moment" ? [0, 0, 0, ...direction] : [...direction, 0, 0, 0]);
/** The part of the load that stays as it is while the other one is made larger. */
const others = (kind) => at.load.map((x, i) => ((kind === "moment") === i < 3 ? x : 0));

function findSurface(cover) {
  const kind = kindShown();
  if (kind === "none") return void ([at.surface, at.loads] = [null, []]);
  const model = models[at.hand];
  let first = true;
  at.loads = cover.corners.map((direction) => {
    const load = asLoad(kind, direction);
    const found = first ? model.admissible(stateWith(others(kind)), load, limits()) : model.admissibleAgain(load);
    first = false;
    return found;
  });
  at.surface = loadSurface(cover, at.loads, scaleOf(hand())[kind]);
}

/** The surface depends on the grasp, on what is told, on limits and on the other part of the load: find it again. */
function updateSurface() {
  findSurface(COARSE);
  clearTimeout(refining);
  refining = setTimeout(() => {
    findSurface(FINE);
    update();
  }, REFINE_MS);
  update();
}

function factorOf(dx) {
  const chosen = byId("factor").value;
  if (chosen !== "auto") return Number(chosen);
  const size = Math.max(norm(Array.from(dx.slice(0, 3))), 0.04 * norm(Array.from(dx.slice(3))));
  return size < 1e-6 ? 1 : FACTORS.find((factor) => factor * size >= VISIBLE_M) ?? FACTORS.at(-1);
}

function show() {
  const model = models[at.hand];
  const state = stateWith(at.load);
  const found = model.predict(state);
  const outOfRange = model.outOfRange(state);
  const branches = branchesUnderLoad(hand(), state, found.stages[1]);
  const recorded = truth();
  const factor = factorOf(recorded?.stable ? recorded.dx_ht : found.dx_ht);
  const about = { found, model: hand(), hand: hand(), grasp: grasp(), load: at.load, branches, factor, truth: recorded, outOfRange };
  showVerdict(about);
  showFingers(about);
  showTruth(about);
  showSentence(about);
  showLargest(largestThisWay());
  const ticked = { contacts: byId("contacts").checked, before: byId("before").checked, compliance: byId("compliance").value };
  const scene = sceneOf({ ...about, truth: recorded?.stable ? recorded : null, surface: at.surface, show: ticked, colours: given.colours });
  view.draw(camera, scene);
  showHandles(scene);
  legend(recorded);
  byId("factor-badge").textContent = factor > 1 ? `motion drawn ${factor} times as large` : "motion true to scale";
  shown = { ...about, scene };
}

function largestThisWay() {
  const kind = kindShown() === "moment" ? "moment" : "force";
  const part = kind === "moment" ? at.load.slice(3) : at.load.slice(0, 3);
  const size = norm(part);
  if (size < 1e-6) return { kind, largest: null, size };
  const along = asLoad(kind, scaled(part, 1 / size));
  const found = models[at.hand].admissible(stateWith(others(kind)), along, limits());
  return { kind, size, largest: { scale: found.scale, reason: REASONS[LIMITED_BY[found.limited_by]] } };
}

function legend(recorded) {
  const entries = [[given.colours.tool, "tool, as predicted"], [given.colours.load, "load"]];
  if (byId("before").checked) entries.push([given.colours.ghost, "tool before the load"]);
  if (recorded?.stable) entries.push([given.colours.truth, hand().measured ? "tool, measured" : "tool, simulated"]);
  if (byId("compliance").value !== "none") {
    const what = byId("compliance").value === "rotation" ? "turns under equal moments of all directions" : "moves under equal forces of all directions";
    entries.push([given.colours.compliance, `how the tool ${what}`]);
  }
  if (at.surface) {
    const kind = kindShown();
    for (const i of new Set(at.loads.map((load) => load.limited_by))) {
      if (i) entries.push([LIMIT_COLOURS[i], `largest ${kind}: beyond it ${LIMIT_TEXTS[LIMITED_BY[i]]}`]);
    }
  }
  showLegend(entries);
}

// --- handles over the picture -----------------------------------------------------------------------------------------

const SVG = "http://www.w3.org/2000/svg";
const handles = ["force", "moment"].map((kind, i) => {
  const group = document.createElementNS(SVG, "g");
  group.innerHTML = `<circle class="reach" r="20"></circle><circle class="grip" r="${i ? 7 : 8}"></circle>`;
  const name = kind === "force" ? "Force, N" : "Moment, newton metres";
  for (const [key, value] of Object.entries({ class: "handle", id: kind, tabindex: 0, role: "slider", "aria-label": name, "aria-valuemin": 0 })) {
    group.setAttribute(key, value);
  }
  return { kind, group, start: 3 * i };
});
const texts = document.createElementNS(SVG, "g");
texts.setAttribute("aria-hidden", "true");
byId("overlay").append(texts, ...handles.map((handle) => handle.group));

function label(place, text, kind, dx = 0, dy = 0) {
  return `<text class="${kind}" x="${(place[0] + dx).toFixed(1)}" y="${(place[1] + dy).toFixed(1)}" text-anchor="middle">${text}</text>`;
}

/** The nearest place of the canvas that a finger reaches. */
const inside = ([x, y]) => [Math.max(EDGE_PX, Math.min(camera.width - EDGE_PX, x)), Math.max(EDGE_PX, Math.min(camera.height - EDGE_PX, y))];

/** The fingers' names beside their tips, away from the tool, and apart from each other. */
function names(scene, origin) {
  const places = scene.tips.map((tip) => {
    const [x, y] = camera.project(tip);
    return { x: x + (x < origin[0] ? -NAME_PX : NAME_PX), y };
  });
  const order = places.map((_, b) => b).sort((a, b) => places[a].y - places[b].y);
  order.forEach((b, k) => {
    for (const other of order.slice(0, k)) {
      const near = Math.abs(places[b].x - places[other].x) < 2 * NAME_PX;
      if (near) places[b].y = Math.max(places[b].y, places[other].y + LINE_PX);
    }
  });
  return places.map(({ x, y }, b) => label([x, y], hand().branches[b].name, "name")).join("");
}

function showHandles(scene) {
  const origin = camera.project(scene.origin);
  let written = "";
  let [other, above] = [null, false]; // the handle before, and on which side of it its text is
  for (const { kind, group, start } of handles) {
    const part = at.load.slice(start, start + 3);
    const size = norm(part);
    const tip = camera.project(add(scene.origin, scaled(part, scaleOf(hand())[kind])));
    let off = subtract(tip, origin);
    if (norm(off) < HANDLE_PX) off = size > 0 && norm(off) > 1 ? scaled(off, HANDLE_PX / norm(off)) : [start ? -HANDLE_PX : HANDLE_PX, 0];
    const place = inside(add(origin, off));
    group.setAttribute("transform", `translate(${place[0].toFixed(1)} ${place[1].toFixed(1)})`);
    const text = start ? `${size.toFixed(3)} N·m` : `${size.toFixed(2)} N`;
    const [x, y, z] = part.map((value) => fixed(value, start ? 3 : 2));
    group.setAttribute("aria-valuemax", hand().largest_load[start ? 1 : 0]);
    group.setAttribute("aria-valuenow", size.toFixed(3));
    group.setAttribute("aria-valuetext", `${text}: x ${x}, y ${y}, z ${z}`);
    above = other && norm(subtract(place, other)) < 2 * HANDLE_PX ? !above : off[1] <= 0;
    other = place;
    if (size > 0) written += label(place, text, "load", 0, above ? -14 : 26);
  }
  written += names(scene, origin);
  AXES.forEach((name, i) => {
    const axis = [0, 0, 0];
    axis[i] = 1.25 * TRIAD_M;
    written += label(camera.project(axis), name, "axis", 0, 4);
  });
  texts.innerHTML = written;
}

/** Change the force or the moment by a vector; the load is then the user's own, no recorded one. */
function change(start, part) {
  const largest = hand().largest_load[start ? 1 : 0];
  const size = norm(part);
  const kept = size > largest ? scaled(part, largest / size) : part;
  setLoad(at.load.map((x, i) => (i >= start && i < start + 3 ? kept[i - start] : x)), -1);
}

function setLoad(load, recorded) {
  const before = others(kindShown());
  [at.load, at.case] = [Array.from(load), recorded];
  byId("case").value = String(recorded);
  showSliders();
  const same = others(kindShown()).every((x, i) => x === before[i]);
  if (same) update();
  else updateSurface();
}

for (const { kind, group, start } of handles) {
  let from = null;
  group.addEventListener("pointerdown", (event) => {
    group.setPointerCapture(event.pointerId);
    from = { x: event.clientX, y: event.clientY, part: at.load.slice(start, start + 3) };
    event.preventDefault();
    group.focus();
  });
  group.addEventListener("pointermove", (event) => {
    if (!from) return;
    const per = 1 / (camera.pixels(shown.scene.origin) * scaleOf(hand())[kind]);
    const [right, up] = camera.axes;
    const more = add(scaled(right, per * (event.clientX - from.x)), scaled(up, -per * (event.clientY - from.y)));
    change(start, add(from.part, more));
  });
  for (const end of ["pointerup", "pointercancel"]) group.addEventListener(end, () => (from = null));
  group.addEventListener("keydown", (event) => {
    const [right, up, towards] = camera.axes;
    const ways = { ArrowRight: right, ArrowLeft: scaled(right, -1), ArrowUp: up, ArrowDown: scaled(up, -1), PageDown: towards, PageUp: scaled(towards, -1) };
    const way = ways[event.key];
    if (!way) return;
    event.preventDefault();
    const step = (start ? KEY_MOMENT : KEY_FORCE) * (event.shiftKey ? 10 : 1);
    change(start, add(at.load.slice(start, start + 3), scaled(way, step)));
  });
}

// --- the camera -------------------------------------------------------------------------------------------------------

const pointers = new Map();
const canvas = byId("canvas");
const apart = () => {
  const [a, b] = [...pointers.values()];
  return Math.hypot(a[0] - b[0], a[1] - b[1]);
};
canvas.addEventListener("pointerdown", (event) => {
  canvas.setPointerCapture(event.pointerId);
  pointers.set(event.pointerId, [event.clientX, event.clientY]);
});
canvas.addEventListener("pointermove", (event) => {
  const last = pointers.get(event.pointerId);
  if (!last) return;
  const before = pointers.size === 2 ? apart() : 0;
  pointers.set(event.pointerId, [event.clientX, event.clientY]);
  if (pointers.size === 2) camera.zoom(before / Math.max(1, apart()));
  else camera.turn(0.008 * (event.clientX - last[0]), 0.008 * (event.clientY - last[1]));
  update();
});
for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => pointers.delete(event.pointerId));
canvas.addEventListener("wheel", (event) => {
  if (!event.ctrlKey) return; // the page scrolls
  event.preventDefault();
  zoom(Math.exp(0.01 * event.deltaY));
}, { passive: false });
canvas.addEventListener("keydown", (event) => {
  const turns = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
  if (turns[event.key]) camera.turn(...scaled(turns[event.key], KEY_TURN));
  else if (event.key === "+" || event.key === "=") camera.zoom(0.9);
  else if (event.key === "-") camera.zoom(1 / 0.9);
  else if (event.key === "Home") Object.assign(camera, HOME);
  else return;
  event.preventDefault();
  update();
});
function zoom(factor) {
  camera.zoom(factor);
  update();
}
byId("closer").onclick = () => zoom(0.85);
byId("further").onclick = () => zoom(1 / 0.85);
byId("upright").onclick = () => {
  Object.assign(camera, HOME);
  update();
};

// --- controls ---------------------------------------------------------------------------------------------------------

const sliders = [];
for (let i = 0; i < 6; i++) {
  const field = document.createElement("div");
  const name = `${i < 3 ? "force" : "moment"} ${AXES[i % 3]}, ${i < 3 ? "N" : "N·m"}`;
  field.innerHTML = `<span>${i < 3 ? "force" : "moment"} ${AXES[i % 3]}</span><output></output><input type="range" aria-label="${name}">`;
  field.style.order = 2 * (i % 3) + (i < 3 ? 0 : 1);
  byId("sliders").append(field);
  const [output, input] = [field.querySelector("output"), field.querySelector("input")];
  input.addEventListener("input", () => {
    const start = i < 3 ? 0 : 3;
    const part = at.load.slice(start, start + 3);
    part[i - start] = Number(input.value);
    change(start, part);
  });
  sliders.push({ input, output });
}

function showSliders() {
  sliders.forEach(({ input, output }, i) => {
    if (document.activeElement !== input) input.value = String(at.load[i]);
    output.textContent = `${fixed(at.load[i], i < 3 ? 2 : 3)} ${i < 3 ? "N" : "N·m"}`;
  });
}

function option(value, text) {
  const element = document.createElement("option");
  [element.value, element.textContent] = [String(value), text];
  return element;
}

function chooseHand(index) {
  at.hand = index;
  makeFingers(hand());
  const families = [...new Set(hand().grasps.map((g) => g.tool.family))];
  byId("tool").replaceChildren(...families.map((family) => option(family, family)));
  sliders.forEach(({ input }, i) => {
    const largest = hand().largest_load[i < 3 ? 0 : 1];
    Object.assign(input, { min: -largest, max: largest, step: i < 3 ? 0.05 : 0.001 });
  });
  byId("limit-p").value = hand().tau.toFixed(2);
  const { name, made_by, checkpoint, data } = hand().model;
  const self = models[index].selfTest();
  byId("origin").textContent =
    `Model ${name} (checkpoint ${checkpoint}, trained on data ${data}), exported by ${made_by}, for the hand ${hand().name}. ` +
    `It runs here, in the browser, by the C runtime ${models[index].version} compiled to WebAssembly; its self-test says ${self}: ` +
    `${self === "AMINN_OK" ? "the bits are those that a controller computes" : "this browser computes other bits"}. ${hand().grasps_are} ${given.note}`;
  chooseTool(families[0]);
}

function chooseTool(family) {
  const mine = hand().grasps.map((g, i) => [g, i]).filter(([g]) => g.tool.family === family);
  byId("grasp").replaceChildren(...mine.map(([g, i]) => option(i, g.title)));
  chooseGrasp(mine[0][1]);
}

function chooseGrasp(index) {
  at.grasp = index;
  const cases = grasp().cases;
  byId("case").replaceChildren(
    option(-1, "your own: drag the arrow"),
    ...cases.map((c, i) => option(i, `recorded ${i + 1}: ${loadText(c.w_e)}, ${c.stable ? "held" : "gave way"}`)),
  );
  const sensors = models[at.hand].senses ? grasp().sensors : {};
  const names = { friction: "friction", tool_weight: "the tool's weight", tendon_tension: "tendon tensions" };
  const values = { friction: ([mu]) => digits(mu), tool_weight: (w) => `${digits(norm(w))} N`, tendon_tension: (t) => `${digits(Math.max(...t))} N at most` };
  const ticked = [...document.querySelectorAll("#told input:checked")].map((box) => box.value);
  byId("told").innerHTML = Object.entries(sensors)
    .map(([name, value]) => `<label class="tick"><input type="checkbox" value="${name}"${ticked.includes(name) ? " checked" : ""}> ${names[name]}: ${values[name](value)}</label>`)
    .join("");
  models[at.hand].sense(told());
  const size = (i) => norm(cases[i].w_e.slice(0, 3)) + 1e-3 * norm(cases[i].w_e);
  const held = cases.map((_, i) => i).filter((i) => cases[i].stable && size(i) <= hand().largest_load[0]);
  const start = held.length ? held.reduce((a, b) => (size(b) > size(a) ? b : a)) : 0; // the largest force that it bore
  byId("case").value = String(start);
  [at.load, at.case] = [cases[start].w_e.slice(), start];
  showSliders();
  updateSurface();
}

byId("hand").addEventListener("change", (event) => chooseHand(Number(event.target.value)));
byId("tool").addEventListener("change", (event) => chooseTool(event.target.value));
byId("grasp").addEventListener("change", (event) => chooseGrasp(Number(event.target.value)));
byId("case").addEventListener("change", (event) => {
  const index = Number(event.target.value);
  setLoad(index < 0 ? at.load : grasp().cases[index].w_e, index);
});
byId("no-load").addEventListener("click", () => setLoad([0, 0, 0, 0, 0, 0], -1));
byId("told").addEventListener("change", () => {
  models[at.hand].sense(told());
  updateSurface();
});
for (const id of ["limit-mm", "limit-deg", "limit-p", "limit-margin", "surface"]) byId(id).addEventListener("change", updateSurface);
for (const id of ["factor", "compliance", "contacts", "before"]) byId(id).addEventListener("change", update);

for (const [name, colour] of Object.entries(given.colours)) document.documentElement.style.setProperty(`--${name}`, colour);
for (const each of given.hands) models.push(await Model.load(bytesOf(given.modules[each.module]), bytesOf(each.model.blob)));
byId("hand").replaceChildren(...given.hands.map((each, i) => option(i, each.title)));
byId("hand-choice").hidden = given.hands.length < 2;
chooseHand(0);
new ResizeObserver(update).observe(byId("stage")); // from now on there is something to show
/** For tests, and for whoever looks at the page's console. */
globalThis.aminnPlay = { models, at, shown: () => shown };
