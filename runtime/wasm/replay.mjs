/** The program aminn_replay on WebAssembly: node replay.mjs AMINN.wasm MODEL.bin VECTORS.bin OUT.bin */
import { readFileSync, renameSync, writeFileSync } from "node:fs";
import { Model } from "./aminn.mjs";

const [wasm, blob, vectors, out] = process.argv.slice(2);
if (out === undefined) {
  console.error("usage: node replay.mjs AMINN.wasm MODEL.bin VECTORS.bin OUT.bin");
  process.exit(2);
}
try {
  const model = await Model.load(readFileSync(wasm), readFileSync(blob));
  const { result, pushes, calibration_crc, loads_crc } = model.replay(readFileSync(vectors));
  writeFileSync(`${out}.partial`, result);
  renameSync(`${out}.partial`, out);
  console.log(`aminn ${model.version} on node ${process.version}; self-test ${model.selfTest()}`);
  console.log(`pushes ${pushes}, calibration_crc ${calibration_crc}, loads_crc ${loads_crc}`);
} catch (error) {
  console.error(`aminn_replay: ${error.message}`);
  process.exit(1);
}
