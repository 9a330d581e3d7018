"""The tables of the studies as Markdown, from their rows (`build/studies/STUDY/rows.json`) alone."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np

from aminn.evaluation.analysis import MAGNITUDE_EDGES_N, NOISE_FACTORS, noise_part
from aminn_base.files import write_atomically
from aminn_base.program import Messages
from aminn_base.read import read_json

from .records import Row, Study, against

SETS = {
    "iid": "new grasps",
    "new_family": "new tool family",
    "new_friction": "new friction",
    "larger_loads": "larger loads",
}
TRAINED = {"aminn": "AMINN", "paper_layer": "AMINN, paper's layer", "mlp": "MLP", "mlp_norm": "MLP, plain norms"}
MODELS = TRAINED | {"analytical": "analytical", "analytical_stick": "the same, no sliding", "no_motion": "no motion"}
INPUTS = {"": "nothing", "class_weight": "class and weight", "friction_weight": "friction and weight"}
"""What optional sensors told."""


BOTH = ("aminn", "mlp")


class Wanted(NamedTuple):
    """What was to be shown of AMINN; ratios are to the MLP with the same inputs."""

    f1: float
    rmse_ratio: float
    median: float
    p90_ratio: float


WANTED = {
    "": Wanted(0.957, 0.72, 0.023, 0.40),
    "class_weight": Wanted(0.972, 0.68, 0.023, 0.40),
    "friction_weight": Wanted(0.980, 0.60, 0.022, 0.38),
}
LEAST_AUROC = {"": 0.92, "friction_weight": 0.97}
"""Of p_slide."""
COVERAGE, LEAST_COVERAGE_SLID = (0.94, 0.96), 0.88
LOST_TO_NOISE = 0.008
"""Of F1, at noise 1, at most."""


class Bound(NamedTuple):
    """What no model can pass on load cases of the built-in hand, friction drawn evenly from 0.4 to 1.1."""

    f1: float
    rmse_pose_all: float
    rmse_pose_slid: float


BOUNDS = {
    "": Bound(0.960, 0.0091, 0.048),
    "class_weight": Bound(0.976, 0.008, 0.042),
    "friction_weight": Bound(0.992, 0.0074, 0.042),
}
"""By what is known of friction. From 1000 load cases, weighted to the population (300 of them slid, 350 stuck, 350 did
not hold): each was solved as a quasi-static problem with friction, with its true springs, kinematics and preload, for
eleven coefficients of friction; the bound is what the best guess gets that knows all but friction."""
BOUND_F1_ERROR = 0.004
"""Standard error of the bounds of F1."""
SHARES = (1.0, 3.0, 10.0, 30.0, 100.0)
# Column -> figure and form.
COLUMNS = {
    "F1": ("f1", "{:.3f}"),
    "AUROC": ("auroc", "{:.3f}"),
    "ECE": ("ece", "{:.3f}"),
    "RMSE_pose": ("rmse_pose_all", "{:.4f}"),
    "of stuck": ("rmse_pose_stuck", "{:.4f}"),
    "of slid": ("rmse_pose_slid", "{:.3f}"),
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
LEARNING = ("F1", "RMSE_pose", "of slid", "relative, median", "p90")
ABLATION_TOLD = ("F1", "RMSE_pose", "of slid")
ABLATION = ("F1", "RMSE_pose", "of stuck", "of slid", "relative, median", "p90", "passed")


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

    aminn, mlp = (study.row("iid", model) for model in BOTH)
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
    """Every model on every test set with nothing told, the ground truth's own figures beside them."""
    rows = []
    for test, title in SETS.items():
        for model, name in MODELS.items():
            cells = [_cell(study.row(test, model), figure, form) for figure, form in COLUMNS.values()]
            rows.append([f"**{title}**" if model == "aminn" else "", name, *cells])
        label = study.row(test, "label")
        noise = {"RMSE_pose": "noise_floor_rmse_pose", "relative, median": "noise_floor_relative_error_median",
                 "p90": "noise_floor_relative_error_p90", "F1": "noise_floor_f1"}  # fmt: skip
        own = {c: noise.get(c, figure) for c, (figure, _) in COLUMNS.items() if c not in ("passed", "5 % refused")}
        cells = [_cell(label, own.get(c, ""), form) for c, (_, form) in COLUMNS.items()]
        share = label.mean.get("stable_share")
        rows.append(["", f"labels again ({share:.0%} stable)" if share is not None else "labels again", *cells])
    return _table(["test cases", "model", *COLUMNS], rows)


def told(study: Study) -> str:
    """Trained models on every test set, by what optional sensors tell them."""
    kept = [c for c in COLUMNS if c not in ("ECE", "mm", "deg", "10 % refused", "f.dp < 0", "w.dx < 0")]
    rows = []
    for test, title in SETS.items():
        for inputs, text in INPUTS.items():
            for model, name in TRAINED.items():
                row = study.row(test, model, inputs=inputs)
                first = [f"**{title}**" if (model, inputs) == ("aminn", "") else "", text if model == "aminn" else ""]
                rows.append([*first, name, *(_cell(row, *COLUMNS[c]) for c in kept)])
    return _table(["test cases", "told", "model", *kept], rows)


RATIOS = ("RMSE_pose", "of stuck", "of slid", "relative, median", "p90", "over 0.01", "passed")


def ratios(study: Study) -> str:
    """AMINN's figures against other models' on new grasps, with the interval of the bootstrap; F1 as a difference."""
    rows = []
    others = [model for model in TRAINED if model != "aminn"]
    for inputs, text in INPUTS.items():
        for other in others:
            row = study.row("iid", against("aminn", other), inputs=inputs)
            cells = [_between(row, COLUMNS[c][0], "{:.2f}") for c in RATIOS]
            rows.append([text if other == others[0] else "", TRAINED[other], *cells, _between(row, "f1", "{:+.4f}")])
    return _table(["told", "to", *RATIOS, "F1, difference"], rows)


def _between(row: Row, figure: str, form: str) -> str:
    value, interval = row.mean.get(figure), row.interval.get(figure)
    if value is None or interval is None:
        return "-"
    return f"{form.format(value)} [{', '.join(map(form.format, interval))}]"


def bounds(study: Study) -> str:
    """What no model can pass, beside AMINN on new grasps."""
    rows = []
    for inputs, text in {"": "no", "class_weight": "its class, of three", "friction_weight": "exactly"}.items():
        row, bound = study.row("iid", "aminn", inputs=inputs), BOUNDS[inputs]
        pairs = (("f1", bound.f1, "{:.3f}"), ("rmse_pose_all", bound.rmse_pose_all, "{:.4f}"),
                 ("rmse_pose_slid", bound.rmse_pose_slid, "{:.3f}"))  # fmt: skip
        rows.append([text, *(text for figure, v, form in pairs for text in (form.format(v), _cell(row, figure, form)))])
    floor = study.row("iid", "label")
    own = [_value(floor, f"noise_floor_{f}", form) for f, form in (("f1", "{:.3f}"), ("rmse_pose", "{:.4f}"))]
    rows.append(["labels again", own[0], "", own[1], "", "", ""])
    names = ("F1", "RMSE_pose, all stable", "of slid")
    head = [text for name in names for text in (f"{name}, at best", "AMINN")]
    return _table(["friction known", *head], rows)


def sure(study: Study) -> str:
    """How well models say what slides and how wrong they may be, on every test set."""
    columns = {"p_slide, AUROC": ("slide_auroc", "{:.3f}"), "ECE": ("slide_ece", "{:.3f}"),
               "within bound_95": ("bound_coverage", "{:.3f}"), "of slid": ("bound_coverage_slid", "{:.3f}"),
               "width": ("bound_width", "{:.2f}"), "slid": ("slid_share", "{:.1%}"),
               "none refused": COLUMNS["RMSE_pose"], "5 %": COLUMNS["5 % refused"],
               "10 %": COLUMNS["10 % refused"]}  # fmt: skip
    rows = []
    for test, title in SETS.items():
        for inputs, text in INPUTS.items():
            for model in BOTH:
                row = study.row(test, model, inputs=inputs)
                first = [f"**{title}**" if (model, inputs) == ("aminn", "") else "", text if model == "aminn" else ""]
                rows.append([*first, TRAINED[model], *(_cell(row, *column) for column in columns.values())])
    return _table(["test cases", "told", "model", *columns], rows)


def learning_curve(study: Study) -> str:
    """Both models by share of the training grasps, on new grasps."""
    rows = []
    for share in SHARES:
        for model in BOTH:
            cells = [_cell(study.row("iid", model, share), *COLUMNS[c]) for c in LEARNING]
            rows.append([f"{share:g} %" if model == "aminn" else "", MODELS[model], *cells])
    return _table(["training grasps", "model", *LEARNING], rows)


def summary(study: Study) -> str:
    """The short table of the README: new grasps, all models."""
    kept = ("F1", "ECE", "RMSE_pose", "of stuck", "of slid", "relative, median", "p90", "5 % refused", "w.dx < 0")
    rows = []
    for model, name in MODELS.items():
        for inputs, text in INPUTS.items() if model in BOTH else [("", "")]:
            cells = [_cell(study.row("iid", model, inputs=inputs), *COLUMNS[c]) for c in kept]
            rows.append([("**AMINN**" if model == "aminn" else name) if not inputs else "", text, *cells])
    return _table(["model", "told", *kept], rows)


def _ratio(top: float | None, bottom: float | None) -> float | None:
    return top / bottom if top is not None and bottom else None


@dataclass(frozen=True)
class Aim:
    """What was to be shown of a figure: that it lies between two bounds, in the digits that it is given in."""

    text: str
    value: float | None
    """None where the study has none yet."""
    least: float = -np.inf
    most: float = np.inf
    digits: int = 3

    @property
    def met(self) -> bool:
        return self.value is not None and self.least <= round(self.value, self.digits) <= self.most

    @property
    def measured(self) -> str:
        return "-" if self.value is None else f"{self.value:.{self.digits}f}"

    @property
    def row(self) -> list[str]:
        return [self.text, self.measured, "" if self.value is None else "yes" if self.met else "**no**"]


def main_aims(study: Study, test: str, inputs: str) -> dict[str, Aim]:
    """What was to be shown of AMINN on one test set with some inputs, by column of the table `aims`."""
    wanted, row = WANTED[inputs], study.row(test, "aminn", inputs=inputs)
    to_mlp = study.row(test, against("aminn", "mlp"), inputs=inputs).mean
    place = f"{SETS[test]}, {INPUTS[inputs]} told"
    return {
        "F1": Aim(f"F1, {place}", row.mean.get("f1"), least=wanted.f1),
        "RMSE": Aim(f"RMSE_pose to the MLP's, {place}", to_mlp.get("rmse_pose_all"), most=wanted.rmse_ratio, digits=2),
        "median": Aim(f"median, {place}", row.mean.get("relative_error_median_all"), most=wanted.median),
        "p90": Aim(f"p90 to the MLP's, {place}", to_mlp.get("relative_error_p90_all"), most=wanted.p90_ratio, digits=2),
    }


def further_aims(study: Study) -> Iterator[Aim]:
    """What else was to be shown: under noise, with more friction, of passivity, and of how sure a model is."""
    for inputs, text in INPUTS.items():
        clean = study.row("iid", "aminn", inputs=inputs).mean.get("f1")
        noisy = study.row("iid", "aminn", part=noise_part(1.0), inputs=inputs).mean.get("f1")
        lost = None if clean is None or noisy is None else clean - noisy
        yield Aim(f"F1 lost at sensor noise 1, {text} told, at most {LOST_TO_NOISE}", lost, most=LOST_TO_NOISE)
    value = study.row("new_friction", "aminn", inputs="friction_weight").mean.get("f1")
    yield Aim("F1, new friction, friction and weight told, at least 0.97", value, least=0.97)
    for inputs, least in LEAST_AUROC.items():
        value = study.row("iid", "aminn", inputs=inputs).mean.get("slide_auroc")
        yield Aim(f"AUROC of p_slide, {INPUTS[inputs]} told, at least {least}", value, least=least)
    for test, title in SETS.items():
        for inputs, text in INPUTS.items():
            row = study.row(test, "aminn", inputs=inputs)
            value = row.mean.get("passivity_violation_full")
            yield Aim(f"full-work violations 0, {title}, {text} told", value, most=0.0, digits=5)
            if test == "larger_loads":
                continue
            low, high = COVERAGE
            value = row.mean.get("bound_coverage")
            yield Aim(f"within bound_95 from {low} to {high}, {title}, {text} told", value, low, high)
            value = row.mean.get("bound_coverage_slid")
            least = LEAST_COVERAGE_SLID
            yield Aim(f"the same of slid cases, at least {least}, {title}, {text} told", value, least=least)


def aims(study: Study) -> str:
    """What was to be shown in F1, RMSE, median and p90; on new grasps those are the aims, elsewhere a measure."""
    rows = []
    for test, title in SETS.items():
        for inputs, text in INPUTS.items():
            found = main_aims(study, test, inputs)
            to_mlp = study.row(test, against("aminn", "mlp"), inputs=inputs)
            cells = {name: aim.measured for name, aim in found.items()}
            for name, figure in (("RMSE", "rmse_pose_all"), ("p90", "relative_error_p90_all")):
                cells[name] = _between(to_mlp, figure, "{:.2f}")
            marked = [
                f"{cells[n]}{' ≥ ' if np.isfinite(a.least) else ' ≤ '}{a.least if np.isfinite(a.least) else a.most:g}"
                + ("" if a.met or a.value is None else " **no**")
                for n, a in found.items()
            ]
            rows.append([f"**{title}**" if not inputs else "", text, *marked])
    return _table(["test cases", "told", "F1", "RMSE_pose to the MLP's", "relative, median", "p90 to the MLP's"], rows)


def promised(study: Study) -> str:
    """What else was to be shown."""
    return _table(["aim", "measured", "met"], [aim.row for aim in further_aims(study)])


def aims_report(study: Study) -> dict[str, Any]:
    """Flat figures of what was to be shown: how much, and what of it was missed, or not measured."""
    own = [aim for inputs in INPUTS for aim in main_aims(study, "iid", inputs).values()]
    every = [*own, *further_aims(study)]
    missed = [aim for aim in every if not aim.met]
    report: dict[str, Any] = {"aims": len(every), "aims_missed": len(missed)}
    report |= {"aims_missed_which": "; ".join(f"{aim.text}: {aim.measured}" for aim in missed)}
    earlier = list(earlier_aims(study))
    report |= {"earlier_aims": len(earlier), "earlier_aims_missed": sum(not aim.met for aim in earlier)}
    bound = BOUNDS[""]
    return report | {"bound_f1": bound.f1, "bound_f1_error": BOUND_F1_ERROR, "bound_rmse_pose_all": bound.rmse_pose_all}


def earlier_aims(study: Study) -> Iterator[Aim]:
    """What earlier versions set out to show."""

    def aminn(figure: str, test: str = "iid", share: float = 100.0) -> float | None:
        return study.mean(test, "aminn", figure, share)

    def mlp(figure: str, test: str = "iid") -> float | None:
        return study.mean(test, "mlp", figure)

    label = study.row("iid", "label").mean
    yield Aim("F1 of AMINN at least 0.96", aminn("f1"), least=0.96)
    f1, other = aminn("f1"), mlp("f1")
    behind = None if f1 is None or other is None else other - f1
    margin = max(study.row("iid", model).sd.get("f1", 0.0) for model in BOTH)
    yield Aim(f"F1 not below the MLP's by more than the spread ({margin:.3f})", behind, most=round(margin, 3))
    median, p90 = "relative_error_median_all", "relative_error_p90_all"
    yield Aim("median to the MLP's at most 0.35", _ratio(aminn(median), mlp(median)), most=0.35, digits=2)
    for figure, text in (("rmse_pose_all", "RMSE_pose"), (median, "median"), (p90, "p90")):
        ratio = _ratio(aminn(figure, share=10.0), mlp(figure))
        yield Aim(f"{text} at 10 % of the grasps to the MLP's at 100 %, at most 1", ratio, most=1, digits=2)
    ratio = _ratio(aminn(median, share=3.0), mlp(median))
    yield Aim("median at 3 % of the grasps to the MLP's at 100 %, at most 1", ratio, most=1, digits=2)
    value, own = aminn("passivity_violation_translational"), label.get("passivity_violation_translational")
    gap = None if value is None or own is None else abs(value - own)
    yield Aim("share of f.dp < 0 within 0.005 of the ground truth's", gap, most=0.005, digits=4)
    yield Aim("ECE of p_stable under 0.03", aminn("ece"), most=0.029)
    yield Aim("gates against tendons, AUROC over 0.9", aminn("gate_auroc"), least=0.901)
    value = aminn("small_load_compliance_error_median")
    yield Aim("compliance along small loads, median error (reported)", value)
    for test, title in SETS.items():
        bound = 0.8 if test == "iid" else 0.7
        ratio = _ratio(aminn("rmse_pose", test), mlp("rmse_pose", test))
        yield Aim(f"RMSE_pose passed to the MLP's at most {bound}, {title}", ratio, most=bound, digits=2)
    factor = _ratio(aminn("rmse_pose"), label.get("noise_floor_rmse_pose"))
    yield Aim("RMSE_pose passed to the labels' noise floor at most 3", factor, most=3, digits=1)


def earlier(study: Study) -> str:
    """What earlier versions set out to show."""
    return _table(["aim", "measured", "met"], [aim.row for aim in earlier_aims(study)])


def _load_titles() -> dict[str, str]:
    """What the groups of load cases by the size of the load are called."""
    first, *_, last = MAGNITUDE_EDGES_N
    between = [f"{a:g} to {b:g} N" for a, b in pairwise(MAGNITUDE_EDGES_N)]
    return {f"load{k}": text for k, text in enumerate([f"below {first:g} N", *between, f"above {last:g} N"])}


def groups(study: Study) -> str:
    """AMINN and MLP by load, tool and tendon regime."""
    texts, rows = _load_titles(), []
    for row in study.rows:
        if (row.test, row.model, row.inputs) != ("iid", "aminn", "") or "error_share" not in row.mean:
            continue
        other = study.row("iid", "mlp", row.share, row.part)
        cells = [_value(row, "n", "{:.0f}")]
        for figure, form in (
            ("f1", "{:.3f}"), ("rmse_pose_all", "{:.4f}"), ("rmse_pose_stuck", "{:.4f}"),
            ("relative_error_median_all", "{:.3f}"),
        ):  # fmt: skip
            cells.append(" / ".join(_value(r, figure, form) for r in (row, other)))
        cells += [_value(row, "slid_share", "{:.1%}"), _value(row, "error_share", "{:.0%}")]
        rows.append([texts.get(row.part, row.part.replace("_", " ")), *cells])
    head = ["load cases", "n", "F1, AMINN / MLP", "RMSE_pose, all stable", "of stuck", "relative error, median", "slid",
            "error's share"]  # fmt: skip
    return _table(head, rows)


def noise(study: Study) -> str:
    """Both models under noisy sensors."""
    kept, rows = ("F1", "RMSE_pose", "relative, median", "p90", "over 0.01", "passed"), []
    for inputs, text in INPUTS.items():
        for factor in (0.0, *NOISE_FACTORS):
            found = [study.row("iid", m, part=noise_part(factor) if factor else "", inputs=inputs) for m in BOTH]
            if any(row.mean for row in found) or not inputs:
                rows += [
                    [text if not factor and not k else "", "" if k else f"{factor:g}", MODELS[model]]
                    + [_cell(row, *COLUMNS[c]) for c in kept]
                    for k, (model, row) in enumerate(zip(BOTH, found, strict=True))
                ]
    return _table(["told", "noise", "model", *kept], rows)


def ablation(study: Study) -> str:
    """Every variant, on validation grasps: with nothing told, and with friction and weight."""
    columns = {**{c: COLUMNS[c] for c in ABLATION}, "gates, AUROC": ("gate_auroc", "{:.3f}")}
    told = {f"{c}, told": COLUMNS[c] for c in ABLATION_TOLD}
    names = {
        row.model: row for row in study.rows if row.test == "iid" and row.seeds and not row.part and not row.inputs
    }
    order = sorted(names, key=lambda name: (name != "shipped", name.startswith("mlp"), name))
    rows = []
    for name in order:
        with_sensors = study.row("iid", name, inputs="friction_weight")
        cells = [_cell(names[name], *column) for column in columns.values()]
        cells += [_cell(with_sensors, *column) for column in told.values()]
        rows.append([f"**{name}**" if name == "shipped" else name.replace("_", " "), *cells])
    return _table(["variant", *columns, *told], rows)


def frontier(study: Study) -> str:
    """Every width, widest first, on validation grasps: with nothing told, and with friction and weight."""
    rows = []
    for name in dict.fromkeys(row.model for row in study.rows):
        found = [study.row("iid", name, inputs=inputs) for inputs in ("", "friction_weight")]
        cells = [_cell(row, *COLUMNS[c]) for row in found for c in LEARNING]
        parameters = _value(found[0], "n_parameters", "{:.0f}")
        rows.append([name.replace("-", " / "), parameters, str(found[0].seeds), *cells])
    rows.sort(key=lambda row: -int(row[1]))
    told = [f"{c}, told" for c in LEARNING]
    return _table(["trunk 1 / trunk 2 / contacts / classifier", "parameters", "seeds", *LEARNING, *told], rows)


TABLES: dict[str, dict[str, Callable[[Study], str]]] = {
    "paper": {
        "state": state,
        "comparison": comparison,
        "aims": aims,
        "promised": promised,
        "told": told,
        "ratios": ratios,
        "bounds": bounds,
        "sure": sure,
        "earlier": earlier,
        "learning": learning_curve,
        "groups": groups,
        "noise": noise,
        "summary": summary,
    },
    "ablation": {"ablation": ablation},
    "frontier": {"frontier": frontier},
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
