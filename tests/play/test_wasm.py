"""The runtime compiled to WebAssembly, in Node: the bits of the C replay, and what it says of damaged files."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from aminn_base.errors import AminnError
from aminn_export.replay.runtime_place import find_runtime
from aminn_export.replay.wasm import replay_wasm

ROOT = Path(__file__).resolve().parents[2]
GOLDEN = ROOT / "tests" / "golden"
BLOB, VECTORS = GOLDEN / "aminn_model.bin", GOLDEN / "golden.bin"


def test_the_bits_are_those_of_the_c_replay(module: Path, tmp_path: Path) -> None:
    said = replay_wasm(module, BLOB, VECTORS, tmp_path / "wasm.bin")
    replay = [str(find_runtime(ROOT / "build" / "host").replay), str(BLOB), str(VECTORS), str(tmp_path / "c.bin")]
    told = subprocess.run(replay, check=True, capture_output=True, text=True).stdout
    assert (tmp_path / "wasm.bin").read_bytes() == (tmp_path / "c.bin").read_bytes()
    assert "self-test AMINN_OK" in said
    figures = next(line for line in said.splitlines() if line.startswith("pushes"))
    assert figures in told, "theta and the largest loads have the same bits too"


def test_single_predictions_have_the_bits_of_the_replay(module: Path, tmp_path: Path) -> None:
    """One state after the other through the JavaScript side: its views of the structs are those of the header."""
    script = f"""
import {{ readFileSync }} from "node:fs";
import {{ Model }} from "{(ROOT / "runtime" / "wasm" / "aminn.mjs").as_uri()}";
const model = await Model.load(readFileSync("{module}"), readFileSync("{BLOB}"));
const vectors = readFileSync("{VECTORS}");
const {{ result }} = model.replay(vectors);
const [n, nIn, nOut, also] = [2, 3, 4, 5].map((i) => vectors.readUInt32LE(4 * i));
const nSensor = (also >> 8) & 0xff, size = nIn + (also >> 16) + nSensor;
const inputs = new Float32Array(vectors.buffer.slice(vectors.byteOffset + 32, vectors.byteOffset + 32 + 4 * n * size));
const rows = new Uint32Array(result.buffer, 32);
let different = 0;
for (let i = 0; i < n; i++) {{
  const row = inputs.subarray(i * size, (i + 1) * size), input = {{}};
  for (const [name, [start, length]] of Object.entries(model.structs.input.places)) {{
    input[name] = row.slice(start, start + length);
  }}
  const told = {{}};
  for (const [name, [start, length]] of Object.entries(model.structs.sensors.places)) {{
    const sensor = row.slice(size - nSensor + start, size - nSensor + start + length);
    if (sensor[0]) told[name] = sensor.slice(1);
  }}
  model.sense(told);
  const found = model.predict(input);
  const numbers = Object.keys(model.structs.output.places).slice(0, 7).flatMap((name) => [found[name]].flat(1));
  const flat = new Uint32Array(Float32Array.from(numbers.flatMap((x) => (x.length ? [...x] : [x]))).buffer);
  different += flat.length !== nOut || flat.some((word, k) => word !== rows[i * (nOut + 1) + k]);
}}
console.log(JSON.stringify({{ n, different, senses: model.senses, range: model.outOfRange({{ q: Array(8).fill(9),
  x_ht: Array(6).fill(0), w_e: Array(6).fill(0), contacts: Array(24).fill(0) }}) }}));
"""
    (tmp_path / "single.mjs").write_text(script)
    done = subprocess.run(["node", str(tmp_path / "single.mjs")], check=True, capture_output=True, text=True)
    n, sensors = (int.from_bytes(VECTORS.read_bytes()[at:end], "little") for at, end in ((8, 12), (21, 22)))
    expected = {"n": n, "different": 0, "senses": sensors > 0, "range": "q.finger1_roll_rad"}
    assert n > 0 and json.loads(done.stdout) == expected


@pytest.mark.parametrize(
    ("of", "at", "says"),
    [
        (VECTORS, 500, "damaged: its CRC-32 does not match"),
        (VECTORS, 0, "not a vector file"),
        (BLOB, 5000, "AMINN_E_CRC"),
        (BLOB, 0, "AMINN_E_MAGIC"),
    ],
)
def test_damaged_files_are_refused(module: Path, tmp_path: Path, of: Path, at: int, says: str) -> None:
    content = bytearray(of.read_bytes())
    content[at] ^= 0x40
    (tmp_path / "damaged.bin").write_bytes(content)
    blob, vectors = (tmp_path / "damaged.bin" if file == of else file for file in (BLOB, VECTORS))
    with pytest.raises(AminnError, match=says):
        replay_wasm(module, blob, vectors, tmp_path / "out.bin")
    assert not (tmp_path / "out.bin").exists()


def test_the_module_imports_nothing(module: Path) -> None:
    script = f"const m = new WebAssembly.Module(require('fs').readFileSync('{module}'));"
    script += "console.log(WebAssembly.Module.imports(m).length)"
    done = subprocess.run(["node", "-e", script], check=True, capture_output=True, text=True)
    assert done.stdout.strip() == "0"
