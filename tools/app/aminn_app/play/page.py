"""The page to play with: what stands in it of models and data, and the one file that it is."""

from __future__ import annotations

import base64
import json
import re
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from numpy.typing import NDArray

from aminn.data.dataset import Dataset, load_dataset
from aminn.data.origin import differences
from aminn.data.sensors import truth
from aminn.hand.nominal import nominal_of
from aminn.model.checkpoint import load_checkpoint
from aminn.pages.grasp_picture import GHOST, TOOL_COLOUR, tool_of
from aminn_base.errors import AminnError
from aminn_base.files import check_outputs, write_atomically
from aminn_export.export import export
from aminn_export.files.bin_model import BinModel, read_bin_model
from aminn_export.files.hand_header import HAND_HEADER, header_beside
from aminn_export.files.tables import STAGES, dims_of
from aminn_export.replay.wasm import build_wasm, javascript_side
from aminn_hand import Hand
from aminn_hand.drawing import BRANCH_COLOURS, LOAD_COLOUR
from aminn_hand.hand import N_WRENCH
from aminn_rt.hand_header import counts_of, hand_header
from aminn_rt.model import model_file

FOLDER = Path(__file__).parent
PARTS = ("vector.mjs", "shapes.mjs", "view.mjs", "hand.mjs", "scene.mjs", "panel.mjs")
MAIN = "main.mjs"
GRASPS = 12
"""That a page shows of a hand."""
TRUTH_COLOUR, COMPLIANCE_COLOUR = "#2f6fb2", "#8a5aa6"
REACH = 0.9
"""Share of the recorded loads that handles and sliders reach."""
LEAST_LOAD = (1.0, 0.02)
"""That they reach at least, N and N.m."""
SAME_PLACE = 1e-6
HEX_DIGITS = 12
NOTE = "It needs no network and sends nothing."


def play(
    out: Path, runs: Sequence[Path], exports: Sequence[Path], data: Sequence[Path], grasps: int = GRASPS
) -> list[str]:
    """Write the page for models of hands; returns a line for each.

    runs, exports: folders of checkpoints and of exported models. data: data sets to show grasps of, one for each hand;
    of a run the one that it was trained on. Raises AminnError where a model has no data of its hand, or no module can
    be compiled.
    """
    check_outputs([out], [*runs, *exports, *data])
    sets = {folder: load_dataset(folder) for folder in data}
    hands, modules, lines = [], {}, []
    with tempfile.TemporaryDirectory(prefix="aminn-play-") as work:
        folders = [*exports, *_exported(runs, sets, Path(work))]
        for folder in folders:
            file = model_file(folder)
            model = read_bin_model(file)
            source = _data_of(model, folder, sets)
            shown = _hand(model, file.read_bytes(), source, grasps)
            if shown["module"] not in modules:
                modules[shown["module"]] = _module(model, file.parent, source.hand, Path(work))
            hands.append(shown)
            lines.append(f"{shown['title']}: {len(shown['grasps'])} grasps of {source.manifest['n_grasps']}")
    colours = {"tool": TOOL_COLOUR, "load": LOAD_COLOUR, "ghost": GHOST}
    colours |= {"truth": TRUTH_COLOUR, "compliance": COMPLIANCE_COLOUR}
    given = {"hands": hands, "modules": modules, "colours": colours, "note": NOTE}
    write_atomically(out, page_of(given).encode())
    return lines


def scripts() -> list[Path]:
    """The page's scripts; each imports only what stands before it."""
    return [*(FOLDER / name for name in PARTS), javascript_side(), FOLDER / MAIN]


def page_of(given: dict[str, Any]) -> str:
    """The file's text."""
    text = json.dumps(given, separators=(",", ":"), allow_nan=False).replace("</", "<\\/")
    template = jinja2.Environment(autoescape=False).from_string((FOLDER / "page.html").read_text())
    title = "A grasp under load: " + ", ".join(hand["title"] for hand in given["hands"])
    return template.render(
        title=title, style=(FOLDER / "style.css").read_text().strip(), given=text, script=inlined(scripts())
    )


IMPORT = re.compile(r'^import \{[^}]*\} from "\./([\w.]+)";\n', re.MULTILINE)
EXPORT = re.compile(r"^export (?=(?:async )?(?:const|let|class|function)\b)", re.MULTILINE)


def inlined(files: Iterable[Path]) -> str:
    """ES modules as one: each file after those that it imports. All names share one scope, so none may be there twice.

    Raises ValueError where a file imports one that does not stand before it, or in another form than `IMPORT`.
    """
    parts: list[str] = []
    before: set[str] = set()
    for file in files:
        text = file.read_text()
        missing = set(IMPORT.findall(text)) - before
        text = EXPORT.sub("", IMPORT.sub("", text))
        if missing or re.search(r"^(import|export)\b", text, re.MULTILINE):
            raise ValueError(f"{file.name}: imports {sorted(missing) or 'or exports in another form'}")
        before.add(file.name)
        parts.append(f"// --- {file.name} ---\n{text.strip()}\n")
    return "\n".join(parts).replace("</script", "<\\/script")


# --- models -----------------------------------------------------------------------------------------------------------


def _exported(runs: Sequence[Path], sets: dict[Path, Dataset], work: Path) -> list[Path]:
    """The runs' models, exported with the data that they were trained on."""
    folders = []
    for i, run in enumerate(runs):
        hand = load_checkpoint(run).model.hand
        mine = [folder for folder, data in sets.items() if not differences(hand, data.hand)]
        if not mine:
            raise AminnError(f"{run}: is of hand {hand.name}, and no --data is; give the data that it was trained on")
        folders.append(work / f"export-{i}")
        export(run, folders[-1], data_dir=mine[0])
    return folders


def _data_of(model: BinModel, folder: Path, sets: dict[Path, Dataset]) -> Dataset:
    """The data set of the model's hand: with its joints where it has them."""
    dims = dims_of(model)
    for data in sets.values():
        own = data.hand.dims
        if (own.inputs, own.tendons) == (dims.inputs, dims.tendons):
            nominal = nominal_of(data.hand)
            pairs = ((nominal.axis, "geom_axis"), (nominal.anchor, "geom_anchor"))
            if all(np.allclose(mine, model.tensors[name], atol=SAME_PLACE) for mine, name in pairs):
                return data
    raise AminnError(f"{folder}: is of hand {model.meta['hand']}, and no --data is; give a data set of it")


def _module(model: BinModel, folder: Path, hand: Hand, work: Path) -> str:
    """The compiled module of a model's hand, base64."""
    header = header_beside(folder)
    if header is None:
        header = work / HAND_HEADER
        joints = [c.joint for branch in hand.branches for c in branch.coordinates]
        write_atomically(header, hand_header(hand.name, dims_of(model), joints).encode())
    return _base64(build_wasm(work / "aminn.wasm", header).read_bytes())


def _base64(content: bytes) -> str:
    return base64.b64encode(content).decode()


def _hand(model: BinModel, blob: bytes, data: Dataset, grasps: int) -> dict[str, Any]:
    """All that the page has to know of a model, its hand, and the grasps that are shown."""
    hand, dims, meta = data.hand, dims_of(model), model.meta
    unseen = meta["data_sha256"] == data.manifest["config_sha256"] and len(data.split("test")) > 0
    shown = data.split("test") if unseen else data
    eps_m = model.tensors[f"{STAGES[1]}.eps_m"]
    branches = [
        {
            "name": _words(branch.name),
            "colour": BRANCH_COLOURS[b],
            "tip_radius_m": branch.tip_radius_m,
            "tip_point_m": branch.tip_point_m,
            "eps_m": _number(eps_m[b]),
            "gated": dims.gates > 0 and branch.gated_tendon is not None,
            "coordinates": [
                {
                    "axis": c.axis,
                    "anchor_m": c.anchor_m,
                    "joint": at,
                    "short": _words(c.joint.removeprefix(branch.name).strip("_") or c.joint),
                }
                for c, at in zip(branch.coordinates, range(*hand.branch_joints[b].indices(dims.joints)), strict=True)
            ],
        }
        for b, branch in enumerate(hand.branches)
    ]
    return {
        "title": _words(hand.name),
        "name": hand.name,
        "length_m": hand.length_m,
        "coordinates": dims.coordinates,
        "slides": dims.slides,
        "measured": data.measured,
        "tau": _number(meta["tau"]),
        "largest_load": _largest_load(data),
        "branches": branches,
        "model": {
            "name": meta["name"],
            "made_by": meta["made_by"],
            "checkpoint": meta["checkpoint_sha256"][:HEX_DIGITS],
            "data": meta["data_sha256"][:HEX_DIGITS],
            "blob": _base64(blob),
        },
        "module": "-".join(map(str, counts_of(dims).values())),
        "grasps_are": "The model was not trained on the grasps shown." if unseen
        else "The grasps shown may be some that the model was trained on.",
        "grasps": [_grasp(shown, rows) for rows in _chosen(shown, grasps)],
    }  # fmt: skip


def _largest_load(data: Dataset) -> list[float]:
    """The largest force (N) and moment (N.m) of handles and sliders, to two digits."""
    w_e = data.samples["w_e"]
    parts = [np.linalg.norm(w_e[:, part], axis=1) for part in (slice(0, 3), slice(3, N_WRENCH))]
    known = (max(float(np.quantile(part, REACH)), least) for part, least in zip(parts, LEAST_LOAD, strict=True))
    return [float(f"{x:.2g}") for x in known]


# --- grasps -----------------------------------------------------------------------------------------------------------


def _chosen(data: Dataset, count: int) -> list[NDArray[np.intp]]:
    """Samples of `count` grasps; tool families in turn."""
    ids, first = np.unique(data.samples["grasp_id"], return_index=True)
    families = data.grasps["tool_family"][data.grasp_rows()[first]] if not data.measured else np.zeros(len(ids), int)
    turn = [int(np.sum(families[:i] == family)) for i, family in enumerate(families)]
    order = sorted(range(len(ids)), key=lambda i: (turn[i], families[i]))
    return [np.flatnonzero(data.samples["grasp_id"] == ids[i]) for i in order[:count]]


def _grasp(data: Dataset, rows: NDArray[np.intp]) -> dict[str, Any]:
    """A grasp and its loads."""
    first, s = int(rows[0]), data.samples
    family, geoms, half_m = tool_of(data, first)
    sensors = {name: _numbers(values[first][1:]) for name, values in truth(data).items() if values[first][0] > 0}
    title = f"{int(s['grasp_id'][first])}"
    if not data.measured:
        title += f": {' × '.join(f'{2e3 * x:.0f}' for x in half_m)} mm, friction {sensors['friction'][0]:.2f}"
    fields = ("w_e", "dx_ht")
    return {
        "title": title,
        "tool": {"family": _words(family.strip(",")), "geoms": [_numbers(row) for row in geoms]},
        "q": _numbers(s["q"][first]),
        "x_ht": _numbers(s["x_ht"][first]),
        "contacts": _numbers(s["contacts"][first].ravel()),
        "sensors": sensors,
        "cases": [
            {name: _numbers(s[name][row]) for name in fields} | {"stable": bool(s["stable"][row])} for row in rows
        ],
    }


def _number(x: float) -> float:
    """A float32, with as many digits as tell it."""
    return float(f"{np.float32(x):.9g}")


def _numbers(values: NDArray[np.floating]) -> list[float]:
    return [_number(x) for x in values]


def _words(name: str) -> str:
    """A name as one reads it: "finger1" is finger 1. What would be markup in the page is left out."""
    return re.sub(r"(?<=[a-z])(?=\d)", " ", re.sub(r"""[<>&"'`]""", "", name).replace("_", " ")).strip()
