"""The data card: one self-contained HTML page that says what a simulated data set holds and how good its labels are."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import combinations
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from numpy.typing import NDArray

from aminn_base.page import PANEL_IN, Picture, picture, write_page
from aminn_base.read import AnyPath, read_json
from aminn_hand.drawing import BRANCH_COLOURS, branch_key
from aminn_hand.hand import Hand
from aminn_hand.theta import Theta

from .build import in_words
from .quality import noise_figures
from .read import Array, SimulatedData, read_data
from .schema import Field, groups_of

Mask = NDArray[np.bool_]
BLUE = "#2563a8"
BINS = 40
LABEL = {"facecolor": "white", "alpha": 0.7, "edgecolor": "none", "pad": 1.0}
WIDE = 18.0  # 99th percentile over median from which sizes get a logarithmic axis
SMALL_IN = (1.75, 1.5)  # a panel among many
SPLITS = {6: (3,), 8: (1, 4, 7), 11: (1, 4, 7)}  # where the unit changes along a last axis of this length
PARTS = {
    "m, rad": ("translation", "rotation"),
    "N, N.m": ("force", "moment"),
    "1, m": ("of translation", "of rotation"),
    "1, m, 1, N": ("there", "position", "normal", "force"),
    "1, m, m, 1": ("shape", "size", "position", "quaternion"),
}
"""What the parts of a field are called, by its units."""
OF_BRANCHES, OF_JOINTS = ("contacts", "j_x", "j_q", "lost_time_s"), ("q", "q_after")
OF_TENDONS = ("tendon_tension_N", "tendon_tension_after_N")
STYLES = ("-", "--", ":")  # of x, y, z
SPHERE_CELLS = (12, 6)  # of equal area: around z, along z


def data_card(folder: AnyPath, report: AnyPath | None = None) -> Path:
    """Write folder/card.html for the finished data set in `folder`; returns it.

    report: figures of `make sim`; without one, reports/sim.json beside the folder, if it is there. Raises
    SimulationError where the folder holds no finished data set.
    """
    folder = Path(folder)
    data = read_data(folder)
    report = Path(report) if report is not None else folder.parent / "reports" / "sim.json"
    sections = [_yield(data), _loads(data), _quality(data), _coverage(data), _families(data)]
    sections += [_mechanics(data)] if "theta" in data.grasps else []
    sections.append(_variables(data))
    if report.is_file():
        sections.append(_report(read_json(report, "a report of `make sim`")))
    page = folder / "card.html"
    written = datetime.fromtimestamp((folder / "manifest.json").stat().st_mtime, UTC)
    summary = [*_summary(data), ("Folder", f"{folder}, written on {written:%Y-%m-%d}")]
    template = Path(__file__).with_name("card.html.j2")
    write_page(template, page, conclusion=_conclusion(data), summary=summary, sections=sections)
    return page


@dataclass(frozen=True)
class Section:
    """A part of the card."""

    picture: Picture
    tables: Sequence[dict] = ()

    @property
    def title(self) -> str:
        return self.picture.title


def _section(
    title: str, text: str, figures: Sequence[Figure] = (), tables: Sequence[dict] = (), **more: Any
) -> Section:
    return Section(picture(title, text, figures, **more), tables)


def _panel() -> tuple[Figure, Axes]:
    figure = Figure(PANEL_IN, layout="constrained")
    return figure, figure.subplots()


def _small() -> tuple[Figure, Axes]:
    figure = Figure(SMALL_IN)
    figure.subplots_adjust(0.05, 0.29, 0.95, 0.86)
    axes = figure.subplots()
    axes.set_yticks([])
    return figure, axes


def _table(head: list[str], rows: list[list]) -> dict:
    return {"head": head, "rows": [[_cell(value) for value in row] for row in rows]}


def _cell(value: object) -> str:
    if isinstance(value, (bool, str)):
        return str(value)
    if isinstance(value, (int, np.integer)):
        return f"{value:,}".replace(",", " ")
    return f"{value:.4g}"


def _percent(share: float) -> str:
    return f"{100 * share:.3g} %"


def _plain(axes: Axes, title: str = "", x: str = "", y: str = "") -> None:
    """Labels, and nothing drawn that says nothing."""
    axes.set_title(title, fontsize=9, loc="left")
    axes.set_xlabel(x, fontsize=8)
    axes.set_ylabel(y, fontsize=8)
    axes.tick_params(labelsize=7)
    axes.spines[["top", "right"]].set_visible(False)


def _summary(data: SimulatedData) -> list[tuple[str, str]]:
    m, config = data.manifest, data.manifest["config"]
    stable = data.samples["stable"].mean()
    return [
        ("Load cases", f"{_cell(m['n_samples'])} of {_cell(m['n_grasps'])} grasps"),
        ("Stable", _percent(float(stable))),
        ("Tool families", ", ".join(config["families"])),
        ("Simulator", f"{m['simulator']}, protocol {m['protocol_version']}, schema {m['schema_version']}"),
        ("Engine's build", in_words(m.get("simulator_build"))),
        ("Seed", str(m["seed"])),
        ("Configuration", m["config_sha256"][:16]),
        ("Bounds", ", ".join(f"{name} {value:g}" for name, value in m["bounds"].items())),
    ]


def _conclusion(data: SimulatedData) -> str:
    """What the card says, in a sentence."""
    noise = noise_figures(data)
    text = (
        f"{_cell(data.manifest['n_samples'])} load cases of {_cell(data.manifest['n_grasps'])} grasps, "
        f"{_percent(float(data.samples['stable'].mean()))} of them stable"
    )
    median = noise.get("noise_half_step_relative_median")
    if median is not None and np.isfinite(median):
        text += f"; simulated again at half the time step, displacements change by {_percent(median)} (median)"
    return f"{text}."


def _bars(axes: Axes, names: list[str], counts: list[float], colour: str) -> None:
    axes.barh(range(len(names)), counts, color=colour, height=0.7)
    axes.set_yticks(range(len(names)), [name.replace("_", " ") for name in names])
    axes.invert_yaxis()
    for k, count in enumerate(counts):
        axes.text(count, k, f" {count:,.0f}".replace(",", " "), va="center", fontsize=7)
    axes.margins(x=0.15)


def _yield(data: SimulatedData) -> Section:
    """Why attempts at a grasp were thrown away, and why loads were not held."""
    m = data.manifest
    rejections = dict(sorted(m.get("rejections", {}).items(), key=lambda item: -item[1]))
    attempts = m["n_grasps"] + sum(rejections.values())
    (tries, left), (labels, right) = _panel(), _panel()
    _bars(left, ["accepted", *rejections], [m["n_grasps"], *rejections.values()], BLUE)
    _plain(left, f"Attempts at a grasp: {_percent(m['n_grasps'] / attempts)} accepted", "attempts")
    counts = np.bincount(data.samples["reason"], minlength=len(m["reasons"]))
    _bars(right, m["reasons"], counts.tolist(), BLUE)
    _plain(right, f"Labels: {_percent(counts[0] / counts.sum())} stable", "load cases")
    text = (
        "An attempt is a posture, a tool and a wrist drawn together; most that fail do so before anything is simulated."
    )
    return _section("Yield", text, [tries, labels])


def _kinds(w_e: Array) -> dict[str, Mask]:
    force, moment = np.linalg.norm(w_e[:, :3], axis=1) > 0, np.linalg.norm(w_e[:, 3:], axis=1) > 0
    return {"force only": force & ~moment, "moment only": ~force & moment, "both": force & moment}


def _share_by_size(axes: Axes, size: Array, stable: Mask, kinds: dict[str, Mask], unit: str) -> None:
    for (name, mine), style in zip(kinds.items(), ("-", "--"), strict=True):
        used = mine & (size > 0)
        if used.sum() < 2:
            continue
        edges = np.geomspace(size[used].min(), size[used].max() * (1 + 1e-9), 11)
        index = np.digitize(size[used], edges) - 1
        total = np.bincount(index, minlength=10)[:10]
        held = np.bincount(index, stable[used], minlength=10)[:10]
        there = total > 0
        middle = np.sqrt(edges[:-1] * edges[1:])
        axes.plot(middle[there], held[there] / total[there], style, marker="o", ms=3, color=BLUE, label=name)
    axes.set_xscale("log")
    axes.set_ylim(0, 1.03)
    axes.grid(alpha=0.25)
    axes.legend(fontsize=7, frameon=False)
    _plain(axes, f"Stable share by size of the {unit.split(',')[0]}", unit, "stable share")


def _sphere(directions: Array, stable: Array, title: str) -> Figure:
    """Stable share over the sphere of directions, in cells of equal area (Mollweide projection; H, z up)."""
    figure = Figure(PANEL_IN, layout="constrained")
    axes = figure.add_subplot(projection="mollweide")
    around, along = SPHERE_CELLS
    angle = np.arctan2(directions[:, 1], directions[:, 0])
    column = np.clip(((angle + np.pi) / (2 * np.pi) * around).astype(int), 0, around - 1)
    row = np.clip(((directions[:, 2] + 1) / 2 * along).astype(int), 0, along - 1)
    total, held = np.zeros((along, around)), np.zeros((along, around))
    np.add.at(total, (row, column), 1)
    np.add.at(held, (row, column), stable)
    share = np.divide(held, total, out=np.full_like(held, np.nan), where=total > 0)
    longitude, latitude = np.linspace(-np.pi, np.pi, around + 1), np.arcsin(np.linspace(-1, 1, along + 1))
    mesh = axes.pcolormesh(longitude, latitude, share, cmap="RdYlBu", vmin=0, vmax=1)
    for name, x, y in (("+x", 0, 0), ("+y", np.pi / 2, 0), ("−y", -np.pi / 2, 0), ("+z", 0, 1.45), ("−z", 0, -1.45)):
        axes.text(x, y, name, fontsize=8, ha="center", va="center", bbox=LABEL)
    axes.set_xticklabels([])
    axes.set_yticklabels([])
    axes.grid(alpha=0.15)
    axes.set_title(title, fontsize=9, loc="left")
    figure.colorbar(mesh, ax=axes, shrink=0.7).ax.tick_params(labelsize=7)
    return figure


def _loads(data: SimulatedData) -> Section:
    """Stable share by size and direction of force and moment."""
    w, stable = data.samples["w_e"], data.samples["stable"] == 1
    kinds = _kinds(w)
    figures, rows = [], []
    for name, part, unit in (("force", slice(0, 3), "N"), ("moment", slice(3, 6), "N·m")):
        size = np.linalg.norm(w[:, part], axis=1)
        mine = {kind: used for kind, used in kinds.items() if kind in (f"{name} only", "both")}
        figure, axes = _panel()
        _share_by_size(axes, size, stable, mine, f"{name}, {unit}")
        pure = kinds[f"{name} only"]
        title = f"Stable share by direction, {name} only ({_cell(pure.sum())} cases)"
        figures += [figure, _sphere(w[pure, part] / size[pure, None], stable[pure], title)]
        if pure.any():
            low, middle, high = np.percentile(size[pure], (0, 50, 100))
            rows.append([f"{name} only", int(pure.sum()), low, middle, high, unit, _percent(stable[pure].mean())])
    both = kinds["both"]
    if both.any():
        rows.append(["both", int(both.sum()), "", "", "", "", _percent(float(stable[both].mean()))])
    text = "Directions are those of the palm frame H."
    table = _table(["load", "cases", "least", "median", "greatest", "", "stable"], rows)
    return _section("Stable share by load", text, figures, [table])


@dataclass(frozen=True)
class Line:
    """Values of one part of a field, and how they are drawn; alone they are filled."""

    values: Array
    colour: str = BLUE
    style: str = "-"


def _histogram(axes: Axes, lines: Sequence[Line]) -> str:
    """Draw; returns a note on what the axis does not show. Values that span decades are drawn by their size."""
    parts = [line.values[np.isfinite(line.values)].astype(float).ravel() for line in lines]
    values = np.concatenate(parts)
    size = np.abs(values[values != 0])
    logarithmic = len(size) > 0 and size.min() < size.max() and np.percentile(size, 99) >= WIDE * np.median(size)
    if logarithmic:
        axes.set_xscale("log")
        edges = np.geomspace(size.min(), size.max(), BINS)
        parts = [np.abs(part[part != 0]) for part in parts]
    else:
        edges = np.histogram_bin_edges(values, BINS)
        axes.locator_params(axis="x", nbins=3)
    for part, line in zip(parts, lines, strict=True):
        kind: Literal["bar", "step"] = "step" if len(lines) > 1 else "bar"
        axes.hist(part, edges.tolist(), histtype=kind, color=line.colour, linestyle=line.style)
    if not logarithmic:
        return ""
    notes = ["size"] if values.min() < 0 else []
    notes += [f"{_percent(1 - len(size) / len(values))} are 0"] if len(size) < len(values) else []
    return ", ".join(notes)


def _plain_small(axes: Axes, title: str, x: str) -> None:
    """Labels of a small panel; long ones are broken."""
    _plain(axes, textwrap.fill(title, 24), textwrap.fill(x, 26))
    axes.title.set_fontsize(6.5)
    axes.xaxis.label.set_fontsize(6.5)
    axes.tick_params(labelsize=6)
    axes.minorticks_off()
    axes.xaxis.get_offset_text().set_fontsize(5)
    axes.set_yticks([])


def _quality(data: SimulatedData) -> Section:
    """How far the stable labels can be trusted."""
    s, stable = data.samples, data.samples["stable"] == 1
    shown = {
        "creep_rate_m_s": ("creep at the end, µm/s", 1e6),
        "worst_penetration_m": ("deepest penetration, µm", 1e6),
        "equilibrium_residual": ("what contact forces leave of the load", 1.0),
        "settle_time_s": ("time until at rest, s", 1.0),
        "hold_time_s": ("time at full load, s", 1.0),
        "solver_residual": ("solver residual", 1.0),
    }
    figures, rows = [], []
    for name, (title, factor) in shown.items():
        values = factor * s[name][stable]
        figure, axes = _small()
        figures.append(figure)
        _plain_small(axes, title, _histogram(axes, [Line(values)]))
        if len(values):
            rows.append([title, *(float(np.percentile(values, p)) for p in (50, 90, 99)), float(values.max())])
    noise, lines = noise_figures(data), []
    for name, meaning in (("half_step", "half the time step"), ("impratio", "ten times impratio")):
        if f"noise_{name}_relative_median" in noise:
            relative = [_percent(noise[f"noise_{name}_relative_{p}"]) for p in ("median", "p90", "p99")]
            changed = _percent(noise[f"noise_{name}_labels_changed_share"])
            lines.append([meaning, *relative, f"{noise[f'noise_{name}_rmse_pose']:.2g}", changed])
    head = ["simulated again with", "change of the displacement, median", "90th", "99th", "RMSE_pose", "labels changed"]
    tables = [_table(["stable cases", "median", "90th percentile", "99th", "greatest"], rows)]
    if lines:
        tables.append(_table(head, lines))
    again = _cell(int(noise.get("noise_cases", 0)))
    text = f"Stable cases alone. The noise floor comes from {again} cases simulated again."
    return _section("Quality of the labels", text, figures, tables, small=True)


def _coverage(data: SimulatedData) -> Section:
    """The sampled synergy space, pair by pair."""
    synergy = data.hand.synergy
    assert synergy is not None
    psi, names, ranges = data.grasps["psi"], synergy.axes, synergy.ranges
    pairs = list(combinations(range(len(names)), 2)) or [(0, 0)]
    families, figures = data.manifest["tool_families"], []
    colours = [f"C{index}" for index in range(len(families))]
    for i, j in pairs:
        figure, axes = _panel()
        figures.append(figure)
        for index, colour in enumerate(colours):
            mine = data.grasps["tool_family"] == index
            size = max(1.5, 200 / np.sqrt(len(psi)))
            axes.scatter(psi[mine, i], psi[mine, j], s=size, alpha=0.6, color=colour, lw=0)
        axes.set_xlim(*ranges[i])
        axes.set_ylim(*ranges[j])
        axes.locator_params(nbins=5)
        _plain(axes, "", names[i], names[j])
    text = (
        "Each point is an accepted grasp. The space is sampled evenly; what is missing was rejected, as in Yield: "
        "a family fits only where the fingertips are as far apart as its tools are thick."
    )
    key = [(family, to_hex(colour)) for family, colour in zip(families, colours, strict=True)]
    return _section("Coverage of the synergy space", text, figures, key=key)


def _families(data: SimulatedData) -> Section:
    """Each tool family in a row."""
    family, stable = data.of_grasp("tool_family"), data.samples["stable"] == 1
    dx, rows = data.samples["dx_ht"], []
    for index, name in enumerate(data.manifest["tool_families"]):
        grasps, mine = data.grasps["tool_family"] == index, family == index
        held = mine & stable
        if not held.any():
            continue
        half, mass, friction = (data.grasps[k][grasps] for k in ("tool_size_m", "tool_mass_kg", "friction"))
        rows.append(
            [
                name,
                int(grasps.sum()),
                int(mine.sum()),
                _percent(float(stable[mine].mean())),
                1e3 * float(np.median(np.linalg.norm(dx[held, :3], axis=1))),
                float(np.degrees(np.median(np.linalg.norm(dx[held, 3:], axis=1)))),
                *(
                    f"{f * v.min():.3g} to {f * v.max():.3g}"
                    for f, v in ((1e3, half[:, 1]), (1e3, mass), (1, friction))
                ),
                1e6 * float(np.median(data.samples["worst_penetration_m"][held])),
            ]
        )
    head = ["tool", "grasps", "cases", "stable", "moved, mm", "turned, °"]
    head += ["half thickness, mm", "mass, g", "friction", "penetration, µm"]
    text = "Medians are those of the stable cases."
    return _section("Tool families", text, tables=[_table(head, rows)])


def _mechanics(data: SimulatedData) -> Section:
    """By how much the hands differ from their description."""
    theta, config = Theta(data.hand), data.manifest["config"]
    _, first = np.unique(data.grasps["hand_id"], return_index=True)
    drawn = data.grasps["theta"][first]
    figures, table = [], []
    for p, values in zip(theta.parameters[: theta.factors], drawn.T, strict=False):
        figure, axes = _small()
        figures.append(figure)
        axes.hist(values, max(5, min(BINS, len(values) // 20)), color=BLUE)
        _plain_small(axes, p.name.replace("_", " "), "")
        factors = np.exp([values.min(), np.median(values), values.max()])
        table.append([p.name, ", ".join(p.parts), config["mechanics"].get(p.name, 0.0), *factors.tolist()])
    text = (
        f"Stiffnesses and contact compliances of {_cell(len(first))} hands are those described, times exp(u). Each "
        f"hand and parameter has its own u, uniform within {config['vary_mechanics']:g} on either side of the middle; "
        f"grasps of a hand: {_cell(config['grasps_per_hand'])}, in a row. The pictures show u. Joint zeros and the "
        "tips' radius are as described (0 in grasps/theta)."
    )
    head = ["parameter", "acts on", "middle", "least factor", "median", "greatest"]
    return _section("Mechanics", text, figures, [_table(head, table)], small=True)


def _counts(axes: Axes, values: Array, names: list[str] | None) -> None:
    """Bars of a flag or of an index into `names`."""
    every = range(len(names) if names else 2)
    axes.bar(every, [int((values == k).sum()) for k in every], color=BLUE)
    labels = names or ["no", "yes"]
    axes.set_xticks(every, [str(k) for k in every] if names else labels)


def _parts(name: str, field: Field, values: Array) -> list[tuple[str, str, Array]]:
    """Title, unit and values of what belongs into one picture: a field, or its parts of one unit each."""
    units, width = field.unit.split(", "), field.shape[-1] if field.shape else 0
    if field.unit not in PARTS or width not in SPLITS:
        return [(name, field.unit, values)]
    bounds = [0, *SPLITS[width], width]
    return [
        (f"{name}, {part}", unit, values[..., first:last])
        for part, first, last, unit in zip(PARTS[field.unit], bounds[:-1], bounds[1:], units, strict=True)
    ]


def _lines(hand: Hand, name: str, frame: str, values: Array) -> Iterator[Line]:
    """The values of a field or of a part of it: one line per branch in its colour, one line per axis, or all in one."""
    name = name.rpartition("/")[2]
    if name in OF_BRANCHES:
        yield from (Line(values[:, b], BRANCH_COLOURS[b]) for b in range(len(hand.branches)))
    elif name in OF_JOINTS:
        yield from (Line(values[:, at], BRANCH_COLOURS[b]) for b, at in enumerate(hand.branch_joints))
    elif name in OF_TENDONS:
        ends = np.cumsum([len(branch.tendons) for branch in hand.branches])
        parts = np.split(values, ends[:-1], axis=1)
        yield from (Line(part, BRANCH_COLOURS[b]) for b, part in enumerate(parts) if part.size)
    elif frame and values.ndim == 2 and values.shape[1] == len(STYLES):
        yield from (Line(column, "#333333", style) for column, style in zip(values.T, STYLES, strict=True))
    else:
        yield Line(values)


def _variables(data: SimulatedData) -> Section:
    """A histogram of every field of the schema."""
    arrays = {"samples": data.samples, "grasps": data.grasps, "noise": data.noise}
    names = {"reason": data.manifest["reasons"], "tool_family": data.manifest["tool_families"]}
    figures = []
    for group, fields in groups_of(data.hand).items():
        for name, field in fields.items():
            if not arrays[group].get(name, np.empty(0)).size:
                continue
            whole = name if group == "samples" else f"{group}/{name}"
            for title, unit, values in _parts(whole, field, arrays[group][name]):
                figure, axes = _small()
                figures.append(figure)
                note = ""
                if field.dtype in ("u1", "i1"):
                    _counts(axes, values, names.get(name))
                else:
                    note = _histogram(axes, list(_lines(data.hand, name, field.frame, values)))
                _plain_small(axes, title, ", ".join(filter(None, (unit.replace("1", ""), note))))
    text = (
        "Every field of the schema, all rows. Colours: fingers. Solid, dashed, dotted: x, y, z. Logarithmic where "
        "values span decades. Numbers below bars are places in the manifest's lists, from 0."
    )
    return _section("Variables", text, figures, key=branch_key(data.hand), small=True)


def _report(figures: dict) -> Section:
    rows = [[name.replace("_", " "), value] for name, value in sorted(figures.items())]
    text = "Theory against simulation, labels against waiting, speed: measured by make sim, build/reports/sim.json."
    return _section("Figures of the simulation", text, tables=[_table(["figure", "value"], rows)])
