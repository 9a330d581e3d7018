/** The numbers beside the picture: what is predicted, the fingers, the recorded truth, and the sentence above it all. */

import { compliance } from "./scene.mjs";
import { angleOf, largestEigenvalue, norm, rotation, times, transposed } from "./vector.mjs";

export const byId = (id) => document.getElementById(id);
const DEGREES = 180 / Math.PI;
const MM = 1000;

/** A number with so many decimals, with a minus that is no hyphen, and none before zero. */
export function fixed(x, places) {
  const text = x.toFixed(places);
  return Number(text) === 0 ? (0).toFixed(places) : text.replace("-", "−");
}

/** A number with as many digits as one reads. */
export function digits(x) {
  const size = Math.abs(x);
  return fixed(x, size >= 100 ? 0 : size >= 10 ? 1 : 2);
}

const percent = (share) => (share > 0 && share < 5e-4 ? "< 0.1 %" : `${(100 * share).toFixed(share > 0 && share < 0.1 ? 1 : 0)} %`);
const motionText = (dx) => `${digits(MM * norm(Array.from(dx.slice(0, 3))))} mm, ${digits(DEGREES * norm(Array.from(dx.slice(3))))}°`;

/** A load in words: "3.2 N and 0.05 N·m". */
export function loadText(load) {
  const [force, moment] = [norm(load.slice(0, 3)), norm(load.slice(3))];
  const parts = [];
  if (force > 0.005) parts.push(`${force.toFixed(force < 1 ? 2 : 1)} N`);
  if (moment > 0.0005) parts.push(`${moment.toFixed(3)} N·m`);
  return parts.join(" and ") || "no load";
}

function setBar(id, share, colour) {
  const bar = byId(id);
  bar.style.width = `${100 * Math.max(0, Math.min(1, share))}%`;
  if (colour) bar.style.setProperty("--fill", colour);
}

/** Pose error of a displacement: translation over the hand's length and angle together, and both apart. */
export function poseError(dx, truth, length_m) {
  const away = norm([0, 1, 2].map((i) => dx[i] - truth[i]));
  const between = times(rotation(Array.from(dx.slice(3))), transposed(rotation(Array.from(truth.slice(3)))));
  return { whole: Math.hypot(away / length_m, angleOf(between)), away, angle: angleOf(between) };
}

export function showVerdict(given) {
  const { found, model, hand, outOfRange } = given;
  const held = found.stable === 1;
  byId("verdict").className = `verdict ${held ? "holds" : "fails"}`;
  byId("holds").textContent = held ? "Predicted to hold" : "Predicted to give way";
  byId("p-stable").textContent = percent(found.p_stable);
  setBar("p-stable-bar", found.p_stable, held ? "var(--good)" : "var(--bad)");
  byId("tau").style.left = `${100 * model.tau}%`;
  byId("tau").title = `it holds from ${model.tau.toFixed(2)} on`;
  byId("p-slide").textContent = percent(found.p_slide);
  setBar("p-slide-bar", found.p_slide);
  const condition = held ? "" : " if it held";
  byId("moves").textContent = motionText(found.dx_ht) + condition;
  const bound = found.bound_95 * hand.length_m * MM;
  byId("bound").textContent = `${digits(bound)} mm (1 rad counts as ${digits(MM * hand.length_m)} mm)`;
  byId("softest").textContent =
    `${digits(MM * largestEigenvalue(compliance(found.k_x, false)))} mm/N, ` +
    `${digits(0.1 * DEGREES * largestEigenvalue(compliance(found.k_x, true)))}° per 0.1 N·m`;
  const notes = [];
  if (outOfRange !== "none") notes.push(`The model has not seen such loads or grasps: ${outOfRange} lies outside of its training.`);
  if (found.notes & 2) notes.push("The stiffnesses lie so far apart that the motion may have few correct digits.");
  byId("notes").textContent = notes.join(" ");
}

export function showLargest({ kind, largest, size }) {
  const unit = kind === "moment" ? "N·m" : "N";
  const places = kind === "moment" ? 3 : 2;
  byId("largest-name").textContent = kind === "moment" ? "largest moment this way" : "largest force this way";
  byId("largest").textContent =
    largest === null
      ? "push first"
      : `${largest.scale.toFixed(places)} ${unit}, by ${largest.reason}; now ${size.toFixed(places)}`;
}

/** The cards of the fingers, made once for a hand. */
export function makeFingers(hand) {
  byId("fingers").innerHTML = hand.branches
    .map(
      (branch, b) => `<div class="finger" style="--fill: ${branch.colour}">
<span class="name"><i style="background: ${branch.colour}"></i>${branch.name}</span>
<div class="meter"><span>${branch.gated ? "tendon engaged" : "no gated tendon"}</span><b id="gate-${b}"></b><i class="bar"><i id="gate-bar-${b}"></i></i></div>
<div class="meter"><span>friction used</span><b id="use-${b}"></b><i class="bar"><i id="use-bar-${b}"></i></i></div>
<span class="more" id="more-${b}"></span></div>`,
    )
    .join("");
}

export function showFingers({ hand, found, branches, grasp }) {
  const { slides } = hand;
  hand.branches.forEach((branch, b) => {
    byId(`gate-${b}`).textContent = branch.gated ? percent(found.gate[b]) : "–";
    setBar(`gate-bar-${b}`, branch.gated ? found.gate[b] : 0, branch.colour);
    const use = found.friction_use[b];
    byId(`use-${b}`).textContent = slides ? percent(use) : "–";
    setBar(`use-bar-${b}`, use, use > 1 ? "var(--bad)" : branch.colour);
    const does = branches[b];
    const names = branch.coordinates.map((c) => c.short);
    const turns = does.turns.map((turn, k) => `${names[k]} ${digits(DEGREES * turn)}°`).join(", ");
    byId(`more-${b}`).textContent = does.flag
      ? `presses with ${digits(grasp.contacts[8 * b + 7])} → ${digits(does.presses)} N; joints turn: ${turns}`
      : "not in contact";
  });
}

export function showTruth({ truth, found, hand }) {
  const measured = hand.measured ? "measured" : "simulated";
  byId("truth-title").textContent = hand.measured ? "What was measured" : "Simulated truth";
  if (truth === null) {
    byId("truth-body").innerHTML = `<p class="note">This load is your own: it was not ${measured}. Choose a recorded load to compare.</p>`;
    return;
  }
  const row = (name, predicted, simulated) => `<tr><th scope="row">${name}</th><td>${predicted}</td><td>${simulated}</td></tr>`;
  const [held, holds] = [truth.stable ? "holds" : "gives way", found.stable ? "holds" : "gives way"];
  let lines = row("grasp", holds, held);
  let verdict = "";
  if (truth.stable) {
    lines += row("tool moves", `${digits(MM * norm(Array.from(found.dx_ht.slice(0, 3))))} mm`, `${digits(MM * norm(truth.dx_ht.slice(0, 3)))} mm`);
    lines += row("tool turns", `${digits(DEGREES * norm(Array.from(found.dx_ht.slice(3))))}°`, `${digits(DEGREES * norm(truth.dx_ht.slice(3)))}°`);
    const error = poseError(found.dx_ht, truth.dx_ht, hand.length_m);
    const within = error.whole <= found.bound_95 ? "within" : "beyond";
    verdict = `<p class="note">Off by ${digits(MM * error.away)} mm and ${digits(DEGREES * error.angle)}°: together ${digits(MM * hand.length_m * error.whole)} mm, ${within} the bound of ${digits(MM * hand.length_m * found.bound_95)} mm.</p>`;
  }
  byId("truth-body").innerHTML = `<table><thead><tr><th></th><th scope="col">predicted</th><th scope="col">${measured}</th></tr></thead><tbody>${lines}</tbody></table>${verdict}`;
}

/** What one sees, in a sentence or two. */
export function showSentence({ found, hand, grasp, load, factor, truth }) {
  const tool = grasp.tool.family;
  const pushed = norm(load) > 0 ? `Under ${loadText(load)} the ${tool}` : `Without a load the ${tool}`;
  const chance = percent(found.p_stable);
  let text;
  if (found.stable) {
    text = `${pushed} is predicted to stay in the hand (${chance}) and to move by ${motionText(found.dx_ht)}`;
    text += factor > 1 && norm(load) > 0 ? `, drawn ${factor} times as large.` : ".";
  } else {
    text = `${pushed} is predicted to leave the hand: it holds with ${chance} only, and ${percent(hand.tau)} are asked for.`;
  }
  const uses = Array.from(found.friction_use);
  const most = uses.indexOf(Math.max(...uses));
  if (hand.slides && norm(load) > 0) {
    const name = hand.branches[most].name;
    const capital = name[0].toUpperCase() + name.slice(1);
    text += uses[most] > 1 ? ` ${capital} slides: its friction is used up.` : ` ${capital} uses most of its friction, ${percent(uses[most])}.`;
  }
  if (truth) {
    text += ` ${hand.measured ? "Measured" : "Simulated"}: it ${truth.stable ? `holds and moves by ${motionText(truth.dx_ht)}` : "gives way"}.`;
  }
  if (byId("sentence").textContent !== text) byId("sentence").textContent = text;
}

/** What the colours of the picture mean. */
export function showLegend(entries) {
  byId("legend").innerHTML = entries.map(([colour, text]) => `<li><i style="background: ${colour}"></i>${text}</li>`).join("");
}
