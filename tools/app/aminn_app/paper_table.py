"""The tables of the studies as Markdown, from their reports (`build/reports/paper.json`, `ablation.json`) alone."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import click

from aminn_base.files import write_atomically
from aminn_base.program import Messages

Report = dict[str, float | int | str | None]

SETS = {
    "iid": "new grasps",
    "new_family": "new tool family",
    "new_friction": "new friction",
    "larger_loads": "larger loads",
}
MODELS = {"aminn": "AMINN", "mlp": "MLP", "analytical": "analytical", "no_motion": "no motion"}
FRACTIONS = ("1", "3", "10", "30", "100")
# Column -> figure and form.
COLUMNS = {
    "F1": ("f1", "{:.3f}"),
    "AUROC": ("auroc", "{:.3f}"),
    "ECE": ("ece", "{:.3f}"),
    "RMSE_pose": ("rmse_pose", "{:.4f}"),
    "mm": ("rmse_mm", "{:.2f}"),
    "deg": ("rmse_deg", "{:.2f}"),
    "all stable": ("rmse_pose_all", "{:.4f}"),
    "relative, median": ("relative_error_median", "{:.3f}"),
    "p90": ("relative_error_p90", "{:.3f}"),
    "f.dp < 0": ("passivity_violation_translational", "{:.1%}"),
    "w.dx < 0": ("passivity_violation_full", "{:.2%}"),
}
LEARNING = ("F1", "RMSE_pose", "relative, median", "p90")
ABLATION = ("F1", "RMSE_pose", "all stable", "relative, median", "p90")


def _number(report: Report, key: str) -> float | None:
    value = report.get(key)
    return float(value) if isinstance(value, int | float) else None


def _cell(report: Report, row: str, figure: str, form: str) -> str:
    """Mean and standard deviation, or the one value of what has no seeds."""
    mean, sd = _number(report, f"{row}_{figure}_mean"), _number(report, f"{row}_{figure}_sd")
    if mean is None:
        value = _number(report, f"{row}_{figure}")
        return "-" if value is None else form.format(value)
    seeds = int(_number(report, f"{row}_seeds") or 1)
    return form.format(mean) + (f" ± {form.format(sd)}" if seeds > 1 and sd is not None else "")


def _table(head: list[str], rows: list[list[str]]) -> str:
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *rows))


def state(report: Report) -> str:
    """What the study has behind it."""
    count = lambda key: f"{int(_number(report, key) or 0)}"  # noqa: E731
    rows = [
        ["load cases of the data set", count("dataset_n_samples")],
        ["trained on", f"{count('train_n_samples')} load cases of {count('train_n_grasps')} grasps"],
        *(
            [
                f"tested on, {text}",
                f"{count(f'{k}_label_n_samples')} load cases of {count(f'{k}_label_n_grasps')} grasps",
            ]
            for k, text in SETS.items()
        ),
        ["parameters, AMINN / MLP", f"{count('iid_aminn_n_parameters_mean')} / {count('iid_mlp_n_parameters_mean')}"],
        ["seeds on all training grasps, AMINN / MLP", f"{count('iid_aminn_seeds')} / {count('iid_mlp_seeds')}"],
        ["runs done, of those planned", f"{count('runs')} of {count('runs_planned')}"],
        ["processor time of these runs' training", f"{(_number(report, 'seconds_of_training') or 0) / 60:.0f} min"],
    ]
    return _table(["study", ""], rows)


def comparison(report: Report) -> str:
    """Every model on every test set, the ground truth's own figures beside them."""
    rows = []
    for key, title in SETS.items():
        for model, name in MODELS.items():
            cells = [_cell(report, f"{key}_{model}", figure, form) for figure, form in COLUMNS.values()]
            rows.append([f"**{title}**" if model == "aminn" else "", name, *cells])
        label = f"{key}_label"
        noise = {"RMSE_pose": "noise_floor_rmse_pose", "relative, median": "noise_floor_relative_error_median",
                 "p90": "noise_floor_relative_error_p90", "F1": "noise_floor_f1"}  # fmt: skip
        own = {c: noise.get(c, figure) for c, (figure, _) in COLUMNS.items()}
        cells = [_cell(report, label, own[c], form) for c, (_, form) in COLUMNS.items()]
        share = _number(report, f"{label}_stable_share")
        rows.append(["", f"labels again ({share:.0%} stable)" if share is not None else "labels again", *cells])
    return _table(["test cases", "model", *COLUMNS], rows)


def learning_curve(report: Report) -> str:
    """Both models by share of the training grasps, on new grasps."""
    rows = []
    for fraction in FRACTIONS:
        for model in ("aminn", "mlp"):
            row = f"learning_{fraction}pc_{model}"
            cells = [_cell(report, row, *COLUMNS[c]) for c in LEARNING]
            rows.append([f"{fraction} %" if model == "aminn" else "", MODELS[model], *cells])
    return _table(["training grasps", "model", *LEARNING], rows)


def summary(report: Report) -> str:
    """The short table of the README: new grasps, all models."""
    kept = ("F1", "ECE", "RMSE_pose", "mm", "deg", "relative, median", "p90", "f.dp < 0", "w.dx < 0")
    rows = []
    for model, name in MODELS.items():
        cells = [_cell(report, f"iid_{model}", *COLUMNS[c]) for c in kept]
        rows.append([f"**{name}**" if model == "aminn" else name, *cells])
    return _table(["model", *kept], rows)


def _ratio(report: Report, figure: str, top: str, bottom: str) -> float | None:
    a, b = _number(report, f"{top}_{figure}_mean"), _number(report, f"{bottom}_{figure}_mean")
    return a / b if a is not None and b else None


def aims(report: Report) -> str:
    """What the project set out to show, and what was measured."""
    rows: list[list[str]] = []

    def aim(text: str, value: float | None, form: str, met: Callable[[float], bool]) -> None:
        rows.append([text, "-" if value is None else form.format(value), "" if value is None else _yes(met(value))])

    mean = lambda key: _number(report, f"{key}_mean")  # noqa: E731
    aim("F1 of AMINN at least 0.96", mean("iid_aminn_f1"), "{:.3f}", lambda v: v >= 0.96)
    f1, mlp = mean("iid_aminn_f1"), mean("iid_mlp_f1")
    behind = None if f1 is None or mlp is None else mlp - f1
    margin = max(_number(report, "iid_aminn_f1_sd") or 0, _number(report, "iid_mlp_f1_sd") or 0)
    aim(f"F1 not below the MLP's by more than the spread ({margin:.3f})", behind, "{:+.3f}", lambda v: v <= margin)
    for figure, text, bound in (
        ("relative_error_median", "relative error, median, to the MLP's at most", 0.35),
        ("relative_error_p90", "relative error, p90, to the MLP's at most", 0.4),
    ):
        ratio = _ratio(report, figure, "iid_aminn", "iid_mlp")
        aim(f"{text} {bound}", ratio, "{:.2f}", _at_most(bound))
    aim("relative error, median, under 0.10", mean("iid_aminn_relative_error_median"), "{:.3f}", lambda v: v < 0.1)
    for key, title in SETS.items():
        bound = 0.8 if key == "iid" else 0.7
        ratio = _ratio(report, "rmse_pose", f"{key}_aminn", f"{key}_mlp")
        aim(f"RMSE_pose to the MLP's at most {bound}, {title}", ratio, "{:.2f}", _at_most(bound))
    for figure, text in (
        ("rmse_pose", "RMSE_pose"),
        ("relative_error_median", "median"),
        ("relative_error_p90", "p90"),
    ):
        ratio = _ratio(report, figure, "learning_10pc_aminn", "learning_100pc_mlp")
        aim(f"{text} at 10 % of the grasps to the MLP's at 100 %, at most 1", ratio, "{:.2f}", lambda v: v <= 1)
    ratio = _ratio(report, "relative_error_median", "learning_3pc_aminn", "learning_100pc_mlp")
    aim("median at 3 % of the grasps to the MLP's at 100 %, at most 1", ratio, "{:.2f}", lambda v: v <= 1)
    for key, title in SETS.items():
        value = mean(f"{key}_aminn_passivity_violation_full")
        aim(f"full-work violations exactly 0, {title}", value, "{:.2%}", lambda v: v == 0)
    value, own = (
        mean("iid_aminn_passivity_violation_translational"),
        _number(report, "iid_label_passivity_violation_translational"),
    )
    gap = None if value is None or own is None else abs(value - own)
    aim("translational rate within 0.5 points of the ground truth's", gap, "{:.2%}", lambda v: v <= 0.005)
    rmse, floor = mean("iid_aminn_rmse_pose"), _number(report, "iid_label_noise_floor_rmse_pose")
    factor = None if rmse is None or not floor else rmse / floor
    aim("RMSE_pose to the labels' noise floor at most 3", factor, "{:.1f}", lambda v: v <= 3)
    aim("ECE of p_stable under 0.03", mean("iid_aminn_ece"), "{:.3f}", lambda v: v < 0.03)
    aim("gates against tendons, AUROC over 0.9", mean("iid_aminn_gate_auroc"), "{:.3f}", lambda v: v > 0.9)
    value = mean("iid_aminn_small_load_compliance_error_median")
    aim("compliance along small loads, median error (reported)", value, "{:.3f}", lambda v: True)
    return _table(["aim", "measured", "met"], rows)


def _at_most(bound: float) -> Callable[[float], bool]:
    return lambda value: value <= bound


def _yes(met: bool) -> str:
    return "yes" if met else "**no**"


def groups(report: Report) -> str:
    """AMINN and MLP by load, tool and tendon regime."""
    start, end = "iid_aminn_", "_n_mean"
    inner = [k.removeprefix(start).removesuffix(end) for k in report if k.startswith(start) and k.endswith(end)]
    names = [n for n in inner if f"{start}{n}_relative_error_median_all_mean" in report]
    texts = {"load0": "below 0.5 N", "load1": "0.5 to 2 N", "load2": "2 to 8 N", "load3": "above 8 N"}
    rows = []
    for name in names:
        cells = [f"{_number(report, f'iid_aminn_{name}_n_mean'):.0f}"]
        for figure, form in (
            ("f1", "{:.3f}"), ("rmse_pose_all", "{:.4f}"), ("relative_error_median_all", "{:.3f}"),
        ):  # fmt: skip
            pair = (_cell(report, f"iid_{m}", f"{name}_{figure}", form).split(" ")[0] for m in ("aminn", "mlp"))
            cells.append(" / ".join(pair))
        share = _cell(report, "iid_aminn", f"error_share_{name}", "{:.0%}").split(" ")[0]
        rows.append([texts.get(name, name.replace("_", " ")), *cells, share])
    head = ["load cases", "n", "F1, AMINN / MLP", "RMSE_pose, all stable", "relative error, median", "error's share"]
    return _table(head, rows)


def noise(report: Report) -> str:
    """Both models under noisy sensors."""
    rows = []
    for factor in ("0.5", "1", "2"):
        for model in ("aminn", "mlp"):
            kept = ("F1", "RMSE_pose", "relative, median", "p90")
            cells = [_cell(report, f"iid_{model}", f"noise{factor}_{COLUMNS[c][0]}", COLUMNS[c][1]) for c in kept]
            rows.append([factor if model == "aminn" else "", MODELS[model], *cells])
    return _table(["noise", "model", "F1", "RMSE_pose", "relative, median", "p90"], rows)


def ablation(report: Report) -> str:
    """Every variant, on validation grasps."""
    columns = {**{c: COLUMNS[c] for c in ABLATION}, "gates, AUROC": ("gate_auroc", "{:.3f}")}
    names = [k.removeprefix("iid_").removesuffix("_seeds") for k in report if k.endswith("_seeds")]
    order = sorted(names, key=lambda name: (name != "shipped", name.startswith("mlp"), "told" in name, name))
    rows = []
    for name in order:
        cells = [_cell(report, f"iid_{name}", *column) for column in columns.values()]
        rows.append([f"**{name}**" if name == "shipped" else name.replace("_", " "), *cells])
    return _table(["variant", *columns], rows)


TABLES: dict[str, dict[str, Callable[[Report], str]]] = {
    "paper": {
        "state": state,
        "comparison": comparison,
        "aims": aims,
        "learning": learning_curve,
        "groups": groups,
        "noise": noise,
        "summary": summary,
    },
    "ablation": {"ablation": ablation},
}
"""Study -> name of a table -> what makes it."""


def write_tables(study: str, report: Report, reports: Path) -> str:
    """Write the study's tables to `<study>.md` in `reports`; returns them."""
    text = "\n\n".join(table(report) for table in TABLES[study].values()) + "\n"
    write_atomically(reports / f"{study}.md", text.encode())
    return text


def filled(document: str, study: str, report: Report) -> str:
    """The document with the study's tables anew between `<!-- table: NAME -->` and `<!-- end of table -->`."""

    def anew(match: re.Match[str]) -> str:
        table = TABLES[study].get(match["name"])
        return match[0] if table is None else f"{match['start']}\n{table(report)}\n{match['end']}"

    return MARKED.sub(anew, document)


MARKED = re.compile(r"(?P<start><!-- table: (?P<name>[a-z]+) -->)\n.*?(?P<end><!-- end of table -->)", flags=re.DOTALL)


@click.command(cls=Messages)
@click.argument("documents", nargs=-1, type=click.Path(path_type=Path, exists=True, dir_okay=False))
@click.option("--reports", type=click.Path(path_type=Path, file_okay=False, exists=True), required=True)
def main(documents: tuple[Path, ...], reports: Path) -> None:
    """Put the tables of the studies in REPORTS into the documents, between their marks."""
    for study in TABLES:
        file = reports / f"{study}.json"
        if not file.is_file():
            click.echo(f"{file}: not there, its tables stay as they are")
            continue
        report = json.loads(file.read_text())
        for document in documents:
            write_atomically(document, filled(document.read_text(), study, report).encode())
    click.echo(f"tables: {', '.join(map(str, documents))}")


if __name__ == "__main__":
    main()
