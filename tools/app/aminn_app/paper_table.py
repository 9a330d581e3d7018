"""The tables of the studies as Markdown, from their rows (`build/studies/STUDY/rows.json`) alone."""

from __future__ import annotations

import re
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import click

from aminn.evaluation.analysis import MAGNITUDE_EDGES_N, NOISE_FACTORS, noise_part
from aminn_base.files import write_atomically
from aminn_base.program import Messages
from aminn_base.read import read_json

from .records import Row, Study

SETS = {
    "iid": "new grasps",
    "new_family": "new tool family",
    "new_friction": "new friction",
    "larger_loads": "larger loads",
}
MODELS = {"aminn": "AMINN", "mlp": "MLP", "analytical": "analytical", "no_motion": "no motion"}
SHARES = (1.0, 3.0, 10.0, 30.0, 100.0)
# Column -> figure and form.
COLUMNS = {
    "F1": ("f1", "{:.3f}"),
    "AUROC": ("auroc", "{:.3f}"),
    "ECE": ("ece", "{:.3f}"),
    "all stable": ("rmse_pose_all", "{:.4f}"),
    "stuck": ("rmse_pose_stuck", "{:.4f}"),
    "slid": ("rmse_pose_slid", "{:.3f}"),
    "mm": ("rmse_mm_all", "{:.2f}"),
    "deg": ("rmse_deg_all", "{:.2f}"),
    "relative, median": ("relative_error_median_all", "{:.3f}"),
    "p90": ("relative_error_p90_all", "{:.3f}"),
    "over 0.01": ("large_error_share", "{:.1%}"),
    "5 % refused": ("rmse_pose_refused_5pc", "{:.4f}"),
    "10 % refused": ("rmse_pose_refused_10pc", "{:.4f}"),
    "f.dp < 0": ("passivity_violation_translational", "{:.1%}"),
    "w.dx < 0": ("passivity_violation_full", "{:.2%}"),
    "passed": ("rmse_pose", "{:.4f}"),
}
LEARNING = ("F1", "all stable", "slid", "relative, median", "p90")
ABLATION = ("F1", "all stable", "stuck", "slid", "relative, median", "p90", "passed")


def _cell(row: Row, figure: str, form: str) -> str:
    """Mean and standard deviation, or the one value of what has no seeds."""
    value, sd = row.mean.get(figure), row.sd.get(figure)
    if value is None:
        return "-"
    return form.format(value) + (f" ± {form.format(sd)}" if row.seeds > 1 and sd is not None else "")


def _value(row: Row, figure: str, form: str) -> str:
    """The mean alone."""
    value = row.mean.get(figure)
    return "-" if value is None else form.format(value)


def _table(head: list[str], rows: list[list[str]]) -> str:
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *rows))


def state(study: Study) -> str:
    """What the study has behind it."""

    def fact(name: str) -> str:
        return f"{int(study.facts.get(name, 0))}"

    def count(row: Row, figure: str) -> str:
        return f"{int(row.mean.get(figure) or 0)}"

    aminn, mlp = study.row("iid", "aminn"), study.row("iid", "mlp")
    labels = {title: study.row(test, "label") for test, title in SETS.items()}
    rows = [
        ["load cases of the data set", fact("dataset_n_samples")],
        ["trained on", f"{fact('train_n_samples')} load cases of {fact('train_n_grasps')} grasps"],
        *(
            [f"tested on, {title}", f"{count(row, 'n_samples')} load cases of {count(row, 'n_grasps')} grasps"]
            for title, row in labels.items()
        ),
        ["parameters, AMINN / MLP", f"{count(aminn, 'n_parameters')} / {count(mlp, 'n_parameters')}"],
        ["seeds on all training grasps, AMINN / MLP", f"{aminn.seeds} / {mlp.seeds}"],
        ["runs done, of those planned", f"{fact('runs')} of {fact('runs_planned')}"],
        ["processor time of these runs' training", f"{float(study.facts.get('seconds_of_training', 0)) / 60:.0f} min"],
    ]
    return _table(["study", ""], rows)


def comparison(study: Study) -> str:
    """Every model on every test set, the ground truth's own figures beside them."""
    rows = []
    for test, title in SETS.items():
        for model, name in MODELS.items():
            cells = [_cell(study.row(test, model), figure, form) for figure, form in COLUMNS.values()]
            rows.append([f"**{title}**" if model == "aminn" else "", name, *cells])
        label = study.row(test, "label")
        noise = {"all stable": "noise_floor_rmse_pose", "relative, median": "noise_floor_relative_error_median",
                 "p90": "noise_floor_relative_error_p90", "F1": "noise_floor_f1"}  # fmt: skip
        own = {c: noise.get(c, figure) for c, (figure, _) in COLUMNS.items()}
        cells = [_cell(label, own[c], form) for c, (_, form) in COLUMNS.items()]
        share = label.mean.get("stable_share")
        rows.append(["", f"labels again ({share:.0%} stable)" if share is not None else "labels again", *cells])
    return _table(["test cases", "model", *COLUMNS], rows)


def learning_curve(study: Study) -> str:
    """Both models by share of the training grasps, on new grasps."""
    rows = []
    for share in SHARES:
        for model in ("aminn", "mlp"):
            cells = [_cell(study.row("iid", model, share), *COLUMNS[c]) for c in LEARNING]
            rows.append([f"{share:g} %" if model == "aminn" else "", MODELS[model], *cells])
    return _table(["training grasps", "model", *LEARNING], rows)


def summary(study: Study) -> str:
    """The short table of the README: new grasps, all models."""
    kept = ("F1", "ECE", "all stable", "stuck", "slid", "relative, median", "p90", "5 % refused", "w.dx < 0")
    rows = []
    for model, name in MODELS.items():
        cells = [_cell(study.row("iid", model), *COLUMNS[c]) for c in kept]
        rows.append([f"**{name}**" if model == "aminn" else name, *cells])
    return _table(["model", *kept], rows)


def _ratio(top: float | None, bottom: float | None) -> float | None:
    return top / bottom if top is not None and bottom else None


def aims(study: Study) -> str:
    """What the project set out to show, and what was measured."""
    rows: list[list[str]] = []

    def aim(text: str, value: float | None, form: str, met: Callable[[float], bool]) -> None:
        rows.append([text, "-" if value is None else form.format(value), "" if value is None else _yes(met(value))])

    def aminn(figure: str, test: str = "iid", share: float = 100.0) -> float | None:
        return study.mean(test, "aminn", figure, share)

    def mlp(figure: str, test: str = "iid") -> float | None:
        return study.mean(test, "mlp", figure)

    label = study.row("iid", "label").mean
    aim("F1 of AMINN at least 0.96", aminn("f1"), "{:.3f}", lambda v: v >= 0.96)
    f1, other = aminn("f1"), mlp("f1")
    behind = None if f1 is None or other is None else other - f1
    margin = max(study.row("iid", model).sd.get("f1", 0.0) for model in ("aminn", "mlp"))
    aim(f"F1 not below the MLP's by more than the spread ({margin:.3f})", behind, "{:+.3f}", lambda v: v <= margin)
    for figure, text, bound in (
        ("relative_error_median", "relative error, median, to the MLP's at most", 0.35),
        ("relative_error_p90", "relative error, p90, to the MLP's at most", 0.4),
    ):
        aim(f"{text} {bound}", _ratio(aminn(figure), mlp(figure)), "{:.2f}", _at_most(bound))
    aim("relative error, median, under 0.10", aminn("relative_error_median"), "{:.3f}", lambda v: v < 0.1)
    for test, title in SETS.items():
        bound = 0.8 if test == "iid" else 0.7
        ratio = _ratio(aminn("rmse_pose", test), mlp("rmse_pose", test))
        aim(f"RMSE_pose to the MLP's at most {bound}, {title}", ratio, "{:.2f}", _at_most(bound))
    for figure, text in (
        ("rmse_pose", "RMSE_pose"),
        ("relative_error_median", "median"),
        ("relative_error_p90", "p90"),
    ):
        ratio = _ratio(aminn(figure, share=10.0), mlp(figure))
        aim(f"{text} at 10 % of the grasps to the MLP's at 100 %, at most 1", ratio, "{:.2f}", _at_most(1))
    ratio = _ratio(aminn("relative_error_median", share=3.0), mlp("relative_error_median"))
    aim("median at 3 % of the grasps to the MLP's at 100 %, at most 1", ratio, "{:.2f}", _at_most(1))
    for test, title in SETS.items():
        value = aminn("passivity_violation_full", test)
        aim(f"full-work violations exactly 0, {title}", value, "{:.2%}", lambda v: v == 0)
    value, own = aminn("passivity_violation_translational"), label.get("passivity_violation_translational")
    gap = None if value is None or own is None else abs(value - own)
    aim("translational rate within 0.5 points of the ground truth's", gap, "{:.2%}", _at_most(0.005))
    factor = _ratio(aminn("rmse_pose"), label.get("noise_floor_rmse_pose"))
    aim("RMSE_pose to the labels' noise floor at most 3", factor, "{:.1f}", _at_most(3))
    aim("ECE of p_stable under 0.03", aminn("ece"), "{:.3f}", lambda v: v < 0.03)
    aim("gates against tendons, AUROC over 0.9", aminn("gate_auroc"), "{:.3f}", lambda v: v > 0.9)
    value = aminn("small_load_compliance_error_median")
    aim("compliance along small loads, median error (reported)", value, "{:.3f}", lambda v: True)
    return _table(["aim", "measured", "met"], rows)


def _at_most(bound: float) -> Callable[[float], bool]:
    return lambda value: value <= bound


def _yes(met: bool) -> str:
    return "yes" if met else "**no**"


def _load_titles() -> dict[str, str]:
    """What the groups of load cases by the size of the load are called."""
    first, *_, last = MAGNITUDE_EDGES_N
    between = [f"{a:g} to {b:g} N" for a, b in pairwise(MAGNITUDE_EDGES_N)]
    return {f"load{k}": text for k, text in enumerate([f"below {first:g} N", *between, f"above {last:g} N"])}


def groups(study: Study) -> str:
    """AMINN and MLP by load, tool and tendon regime."""
    texts, rows = _load_titles(), []
    for row in study.rows:
        if (row.test, row.model) != ("iid", "aminn") or "error_share" not in row.mean:
            continue
        other = study.row("iid", "mlp", row.share, row.part)
        cells = [_value(row, "n", "{:.0f}")]
        for figure, form in (
            ("f1", "{:.3f}"), ("rmse_pose_all", "{:.4f}"), ("relative_error_median_all", "{:.3f}"),
        ):  # fmt: skip
            cells.append(" / ".join(_value(r, figure, form) for r in (row, other)))
        share = _value(row, "error_share", "{:.0%}")
        rows.append([texts.get(row.part, row.part.replace("_", " ")), *cells, share])
    head = ["load cases", "n", "F1, AMINN / MLP", "RMSE_pose, all stable", "relative error, median", "error's share"]
    return _table(head, rows)


def noise(study: Study) -> str:
    """Both models under noisy sensors."""
    kept, rows = ("F1", "all stable", "relative, median", "p90"), []
    for factor in NOISE_FACTORS:
        for model in ("aminn", "mlp"):
            row = study.row("iid", model, part=noise_part(factor))
            cells = [_cell(row, *COLUMNS[c]) for c in kept]
            rows.append([f"{factor:g}" if model == "aminn" else "", MODELS[model], *cells])
    return _table(["noise", "model", *kept], rows)


def ablation(study: Study) -> str:
    """Every variant, on validation grasps."""
    columns = {**{c: COLUMNS[c] for c in ABLATION}, "gates, AUROC": ("gate_auroc", "{:.3f}")}
    names = {row.model: row for row in study.rows if row.test == "iid" and row.seeds and not row.part}
    order = sorted(names, key=lambda name: (name != "shipped", name.startswith("mlp"), "told" in name, name))
    rows = []
    for name in order:
        cells = [_cell(names[name], *column) for column in columns.values()]
        rows.append([f"**{name}**" if name == "shipped" else name.replace("_", " "), *cells])
    return _table(["variant", *columns], rows)


TABLES: dict[str, dict[str, Callable[[Study], str]]] = {
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


def write_tables(name: str, study: Study, reports: Path) -> str:
    """Write the study's tables to `<name>.md` in `reports`; returns them."""
    text = "\n\n".join(table(study) for table in TABLES[name].values()) + "\n"
    write_atomically(reports / f"{name}.md", text.encode())
    return text


def filled(document: str, name: str, study: Study) -> str:
    """The document with the study's tables anew between `<!-- table: NAME -->` and `<!-- end of table -->`."""

    def anew(match: re.Match[str]) -> str:
        table = TABLES[name].get(match["name"])
        return match[0] if table is None else f"{match['start']}\n{table(study)}\n{match['end']}"

    return MARKED.sub(anew, document)


def read_study(folder: Path) -> Study:
    """The rows that a study left in its folder. Raises AminnError."""
    return Study.from_json(read_json(folder / "rows.json", "the rows of a study"))


MARKED = re.compile(r"(?P<start><!-- table: (?P<name>[a-z]+) -->)\n.*?(?P<end><!-- end of table -->)", flags=re.DOTALL)


@click.command(cls=Messages)
@click.argument("documents", nargs=-1, type=click.Path(path_type=Path, exists=True, dir_okay=False))
@click.option("--studies", type=click.Path(path_type=Path, file_okay=False, exists=True), required=True)
def main(documents: tuple[Path, ...], studies: Path) -> None:
    """Put the tables of the studies in folder STUDIES into the documents, between their marks."""
    for name in TABLES:
        if not (studies / name / "rows.json").is_file():
            click.echo(f"{studies / name}: no rows.json there, its tables stay as they are")
            continue
        study = read_study(studies / name)
        for document in documents:
            write_atomically(document, filled(document.read_text(), name, study).encode())
    click.echo(f"tables: {', '.join(map(str, documents))}")


if __name__ == "__main__":
    main()
