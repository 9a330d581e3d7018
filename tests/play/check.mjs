/**
 * What the page's own code makes of the loads in it, as JSON, without a browser: node check.mjs PAGE.html
 * Of each load: the state, of each branch the points of its chain, and what it bears of the load (N).
 */
import { readFileSync } from "node:fs";
import { Model } from "../../runtime/wasm/aminn.mjs";
import { branchPose, branchesUnderLoad } from "../../tools/app/aminn_app/play/hand.mjs";

const page = readFileSync(process.argv[2], "utf8");
const given = JSON.parse(page.match(/id="given">\n([\s\S]*?)\n<\/script>/)[1]);
const found = [];
for (const hand of given.hands) {
  const bytes = (text) => Buffer.from(text, "base64");
  const model = await Model.load(bytes(given.modules[hand.module]), bytes(hand.model.blob));
  for (const grasp of hand.grasps) {
    const chains = hand.branches.map((branch) => branchPose(branch, grasp.q).points);
    for (const { w_e } of grasp.cases) {
      const state = { q: grasp.q, x_ht: grasp.x_ht, contacts: grasp.contacts, w_e };
      const { stages } = model.predict(state);
      const bears = branchesUnderLoad(hand, state, stages[1]).map(({ force, normal, point }, b) => {
        const preload = stages[1].preload.slice(3 * b, 3 * b + 3);
        const share = force.map((f, i) => grasp.contacts[8 * b + 7] * normal[i] + preload[i] - f);
        return { share, point };
      });
      found.push({ ...state, chains, bears });
    }
  }
}
console.log(JSON.stringify(found));
