"""The data card: one self-contained HTML page that says what a simulated data set holds and how good its labels are."""

from __future__ import annotations

import base64
import io
import textwrap
from itertools import combinations
from pathlib import Path

import jinja2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from aminn_base.files import write_atomically
from aminn_base.read import AnyPath, read_json
from aminn_hand.theta import Theta

from .build import in_words
from .quality import noise_figures
from .read import Array, SimulatedData, read_data
from .schema import Field, groups_of

Mask = NDArray[np.bool_]
BLUE = "#2563a8"
BINS = 40
WIDE = 18.0  # 99th percentile over median from which sizes get a logarithmic axis
SPLITS = {6: (3,), 8: (1, 4, 7), 11: (1, 4, 7)}  # where the unit changes along a last axis of this length
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
    write_atomically(page, _TEMPLATE.render(summary=_summary(data), sections=sections).encode())
    return page


def _picture(figure: Figure) -> str:
    """The figure as a data URI."""
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=110, metadata={"Software": None})
    return "data:image/png;base64," + base64.b64encode(out.getvalue()).decode()


def _section(title: str, text: str, figure: Figure | None = None, tables: list[dict] | None = None) -> dict:
    return {
        "title": title,
        "text": text,
        "picture": _picture(figure) if figure else None,
        "tables": tables or [],
    }


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


def _bars(axes: Axes, names: list[str], counts: list[float], colour: str) -> None:
    axes.barh(range(len(names)), counts, color=colour, height=0.7)
    axes.set_yticks(range(len(names)), [name.replace("_", " ") for name in names])
    axes.invert_yaxis()
    for k, count in enumerate(counts):
        axes.text(count, k, f" {count:,.0f}".replace(",", " "), va="center", fontsize=7)
    axes.margins(x=0.15)


def _yield(data: SimulatedData) -> dict:
    """Why attempts at a grasp were thrown away, and why loads were not held."""
    m = data.manifest
    rejections = dict(sorted(m.get("rejections", {}).items(), key=lambda item: -item[1]))
    attempts = m["n_grasps"] + sum(rejections.values())
    figure = Figure((10, 2.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    _bars(left, ["accepted", *rejections], [m["n_grasps"], *rejections.values()], BLUE)
    _plain(left, f"Attempts at a grasp: {_percent(m['n_grasps'] / attempts)} accepted", "attempts")
    counts = np.bincount(data.samples["reason"], minlength=len(m["reasons"]))
    _bars(right, m["reasons"], counts.tolist(), BLUE)
    _plain(right, f"Labels: {_percent(counts[0] / counts.sum())} stable", "load cases")
    text = (
        "An attempt is a posture, a tool and a wrist drawn together; most that fail do so before anything is simulated."
    )
    return _section("Yield", text, figure)


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
    _plain(axes, "Stable share by size of the load", unit, "stable share")


def _sphere(figure: Figure, place: int, directions: Array, stable: Array, title: str) -> None:
    """Stable share over the sphere of directions, in cells of equal area (Mollweide projection; H, z up)."""
    axes = figure.add_subplot(2, 2, place, projection="mollweide")
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
        axes.text(x, y, name, fontsize=8, ha="center", va="center")
    axes.set_xticklabels([])
    axes.set_yticklabels([])
    axes.grid(alpha=0.15)
    axes.set_title(title, fontsize=9, loc="left")
    figure.colorbar(mesh, ax=axes, shrink=0.7).ax.tick_params(labelsize=7)


def _loads(data: SimulatedData) -> dict:
    """Stable share by size and direction of force and moment."""
    w, stable = data.samples["w_e"], data.samples["stable"] == 1
    kinds = _kinds(w)
    figure = Figure((10, 6), layout="constrained")
    rows = []
    for k, (name, part, unit) in enumerate((("force", slice(0, 3), "N"), ("moment", slice(3, 6), "N·m"))):
        size = np.linalg.norm(w[:, part], axis=1)
        mine = {kind: used for kind, used in kinds.items() if kind in (f"{name} only", "both")}
        _share_by_size(figure.add_subplot(2, 2, 2 * k + 1), size, stable, mine, f"{name}, {unit}")
        pure = kinds[f"{name} only"]
        title = f"Stable share by direction, {name} only ({_cell(pure.sum())} cases)"
        _sphere(figure, 2 * k + 2, w[pure, part] / size[pure, None], stable[pure], title)
        if pure.any():
            low, middle, high = np.percentile(size[pure], (0, 50, 100))
            rows.append([f"{name} only", int(pure.sum()), low, middle, high, unit, _percent(stable[pure].mean())])
    both = kinds["both"]
    if both.any():
        rows.append(["both", int(both.sum()), "", "", "", "", _percent(float(stable[both].mean()))])
    text = "Directions are those of the palm frame H."
    table = _table(["load", "cases", "least", "median", "greatest", "", "stable"], rows)
    return _section("Stable share by load", text, figure, [table])


def _histogram(axes: Axes, values: Array) -> str:
    """Draw; returns a note on what the axis does not show. Values that span decades are drawn by their size."""
    values = values[np.isfinite(values)].astype(float).ravel()
    size = np.abs(values[values != 0])
    if len(size) == 0 or np.percentile(size, 99) < WIDE * np.median(size) or size.min() == size.max():
        axes.hist(values, BINS, color=BLUE)
        axes.locator_params(axis="x", nbins=4)
        return ""
    axes.set_xscale("log")
    axes.hist(size, np.geomspace(size.min(), size.max(), BINS).tolist(), color=BLUE)
    notes = ["size"] if values.min() < 0 else []
    notes += [f"{_percent(1 - len(size) / len(values))} are 0"] if len(size) < len(values) else []
    return ", ".join(notes)


def _quality(data: SimulatedData) -> dict:
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
    figure, rows = Figure((10, 4.4), layout="constrained"), []
    for axes, (name, (title, factor)) in zip(figure.subplots(2, 3).ravel(), shown.items(), strict=True):
        values = factor * s[name][stable]
        note = _histogram(axes, values)
        _plain(axes, title, note, "cases")
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
    return _section("Quality of the labels", text, figure, tables)


def _coverage(data: SimulatedData) -> dict:
    """The sampled synergy space, pair by pair."""
    synergy = data.hand.synergy
    assert synergy is not None
    psi, names, ranges = data.grasps["psi"], synergy.axes, synergy.ranges
    pairs = list(combinations(range(len(names)), 2)) or [(0, 0)]
    figure = Figure((10, 3.2), layout="constrained")
    families = data.manifest["tool_families"]
    for axes, (i, j) in zip(figure.subplots(1, len(pairs), squeeze=False)[0], pairs, strict=True):
        for index, family in enumerate(families):
            mine = data.grasps["tool_family"] == index
            if mine.any():
                axes.scatter(
                    psi[mine, i], psi[mine, j], s=max(1.5, 200 / np.sqrt(len(psi))), alpha=0.6, label=family, lw=0
                )
        axes.set_aspect("equal")
        axes.set_xlim(ranges[i])
        axes.set_ylim(ranges[j])
        _plain(axes, "", names[i], names[j])
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    text = (
        "Each point is an accepted grasp. The space is sampled evenly; what is missing was rejected, as in Yield: "
        "a family fits only where the fingertips are as far apart as its tools are thick."
    )
    return _section("Coverage of the synergy space", text, figure)


def _families(data: SimulatedData) -> dict:
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
    return _section("Tool families", text, None, [_table(head, rows)])


def _mechanics(data: SimulatedData) -> dict:
    """By how much the hands differ from their description."""
    theta, config = Theta(data.hand), data.manifest["config"]
    _, first = np.unique(data.grasps["hand_id"], return_index=True)
    drawn, columns = data.grasps["theta"][first], 5
    rows = -(-theta.factors // columns)
    figure = Figure((10, 1.5 * rows), layout="constrained")
    grid, table = figure.subplots(rows, columns, squeeze=False).ravel(), []
    for axes, p, values in zip(grid, theta.parameters[: theta.factors], drawn.T, strict=False):
        axes.hist(values, max(5, min(BINS, len(values) // 20)), color=BLUE)
        _plain(axes, textwrap.fill(p.name.replace("_", " "), 24))
        axes.title.set_fontsize(7)
        factors = np.exp([values.min(), np.median(values), values.max()])
        table.append([p.name, ", ".join(p.parts), config["mechanics"].get(p.name, 0.0), *factors.tolist()])
    for axes in grid[theta.factors :]:
        axes.set_visible(False)
    text = (
        f"Stiffnesses and contact compliances of {_cell(len(first))} hands are those described, times exp(u). Each "
        f"hand and parameter has its own u, uniform within {config['vary_mechanics']:g} on either side of the middle; "
        f"grasps of a hand: {_cell(config['grasps_per_hand'])}, in a row. The pictures show u. Joint zeros and the "
        "tips' radius are as described (0 in grasps/theta)."
    )
    head = ["parameter", "acts on", "middle", "least factor", "median", "greatest"]
    return _section("Mechanics", text, figure, [_table(head, table)])


def _counts(axes: Axes, values: Array, names: list[str] | None) -> str:
    """Bars of a flag or of an index into `names`."""
    every = range(len(names) if names else 2)
    axes.bar(every, [int((values == k).sum()) for k in every], color=BLUE)
    labels = [name.replace("_", " ") for name in names] if names else ["no", "yes"]
    axes.set_xticks(every, labels, rotation=30 if names else 0, ha="right" if names else "center")
    return ""


def _parts(name: str, field: Field, values: Array) -> list[tuple[str, str, Array]]:
    """Title, unit and values of what belongs into one picture: a field, or its parts of one unit each."""
    units, width = field.unit.split(", "), field.shape[-1] if field.shape else 0
    if len(units) == 1 or width not in SPLITS:
        return [(name, field.unit, values)]
    bounds = [0, *SPLITS[width], width]
    return [
        (f"{name} {first + 1} to {last}" if last > first + 1 else f"{name} {last}", unit, values[..., first:last])
        for first, last, unit in zip(bounds[:-1], bounds[1:], units, strict=True)
    ]


def _variables(data: SimulatedData) -> dict:
    """A histogram of every field of the schema; components of one field and unit in one picture."""
    arrays = {"samples": data.samples, "grasps": data.grasps, "noise": data.noise}
    names, columns = {"reason": data.manifest["reasons"], "tool_family": data.manifest["tool_families"]}, 5
    shown = [
        (name, field, *part)
        for group, fields in groups_of(data.hand).items()
        for name, field in fields.items()
        if len(arrays[group].get(name, ()))
        for part in _parts(name if group == "samples" else f"{group}/{name}", field, arrays[group][name])
    ]
    rows = -(-len(shown) // columns)
    figure = Figure((10, 1.45 * rows))
    figure.subplots_adjust(0.02, 0.5 / (1.45 * rows), 0.99, 1 - 0.3 / (1.45 * rows), 0.12, 0.75)
    grid = figure.subplots(rows, columns).ravel()
    for axes, (name, field, title, unit, values) in zip(grid, shown, strict=False):
        note = _counts(axes, values, names.get(name)) if field.dtype in ("u1", "i1") else _histogram(axes, values)
        _plain(axes, title, ", ".join(filter(None, (unit.replace("1", ""), note))))
        axes.title.set_fontsize(7)
        axes.tick_params(labelsize=5)
        axes.xaxis.label.set_fontsize(6)
        axes.xaxis.get_offset_text().set_fontsize(5)
        axes.set_yticks([])
    for axes in grid[len(shown) :]:
        axes.set_visible(False)
    text = (
        "Every field of the schema, all rows; components of one unit together, numbered from 1 along the last axis. "
        "Logarithmic where values span decades."
    )
    return _section("Variables", text, figure)


def _report(figures: dict) -> dict:
    rows = [[name.replace("_", " "), value] for name, value in sorted(figures.items())]
    text = "Theory against simulation, labels against waiting, speed: measured by make sim, build/reports/sim.json."
    return _section("Figures of the simulation", text, None, [_table(["figure", "value"], rows)])


_TEMPLATE = jinja2.Environment(
    loader=jinja2.FileSystemLoader(Path(__file__).parent), autoescape=True, trim_blocks=True, lstrip_blocks=True
).get_template("card.html.j2")
