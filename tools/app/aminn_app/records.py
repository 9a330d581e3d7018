"""What a study found, as records: facts of its data, and the figures of each model on each test set, over seeds.

Tables are made from the records. The flat keys of build/reports/STUDY.json are their last form, and nothing reads them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from aminn.evaluation.metrics import spread

Figures = dict[str, float]
Parts = dict[str, Figures]
"""Figures of a test set by its parts; "" is the whole set."""
Facts = dict[str, float | int | str]
WHOLE = 100.0


@dataclass(frozen=True)
class Row:
    """Figures of one model on one part of a test set."""

    test: str
    """Test set."""
    model: str
    """Kind or variant of a trained model; "analytical", "no_motion", "label" for the labels themselves, or what
    `against` says of a model beside another."""
    mean: Mapping[str, float | None]
    """By figure, over seeds."""
    sd: Mapping[str, float] = field(default_factory=dict)
    """Standard deviation over seeds, 0 for one; none for what has no seeds."""
    seeds: int = 0
    """0 for what has none."""
    share: float = WHOLE
    """Percent of the training grasps that it was trained on."""
    part: str = ""
    """A group of load cases, a level of noise, or one seed; "" is the whole set."""
    inputs: str = ""
    """What optional sensors told; "" is nothing."""
    interval: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Between which bounds a figure lies, of those that are known so."""


def against(model: str, other: str) -> str:
    """Name of the row that holds a model's figures against another's."""
    return f"{model}_to_{other}"


def over_seeds(test: str, model: str, share: float, runs: Iterable[tuple[int, Parts]], inputs: str = "") -> list[Row]:
    """One row for each part of a test set, from (seed, figures) of the runs; what a run has not counts as missing."""
    runs = list(runs)
    rows = []
    for part in runs[0][1]:
        mean: dict[str, float | None] = {}
        sd: dict[str, float] = {}
        for figure in runs[0][1][part]:
            found = [parts.get(part, {}).get(figure) for _, parts in runs]
            values = [v for v in found if v is not None and np.isfinite(v)]
            if values:
                mean[figure], sd[figure] = float(np.mean(values)), spread(values)
        rows.append(Row(test, model, mean, sd, len({seed for seed, _ in runs}), share, part, inputs))
    return rows


@dataclass(frozen=True)
class Study:
    """Facts and rows."""

    facts: Facts
    rows: list[Row]

    def row(self, test: str, model: str, share: float = WHOLE, part: str = "", inputs: str = "") -> Row:
        """That row; an empty one where the study has none yet."""
        for row in self.rows:
            if (row.test, row.model, row.share, row.part, row.inputs) == (test, model, share, part, inputs):
                return row
        return Row(test, model, {}, share=share, part=part, inputs=inputs)

    def mean(self, test: str, model: str, figure: str, share: float = WHOLE) -> float | None:
        """A figure of a whole test set, with nothing told."""
        return self.row(test, model, share).mean.get(figure)

    def flat(self) -> dict[str, Any]:
        """Flat keys TEST_MODEL_[INPUTS_][PART_]FIGURE[_mean, _sd, _low, _high] for what is trained on all grasps; on
        shares of them learning_SHAREpc_MODEL_FIGURE_mean, which the whole share has as well."""
        out: dict[str, Any] = dict(self.facts)
        shares = len({row.share for row in self.rows if row.seeds}) > 1
        for row in self.rows:
            whole = "".join(f"{word}_" for word in (row.inputs, row.part) if word)
            starts = [f"{row.test}_{row.model}_{whole}"] if row.share == WHOLE else []
            if row.sd and shares and row.test == "iid" and not whole:
                starts.append(f"learning_{row.share:g}pc_{row.model}_")
            for start in starts:
                mean = "_mean" if row.sd else ""
                out |= {f"{start}{figure}{mean}": value for figure, value in row.mean.items()}
                out |= {f"{start}{figure}_sd": value for figure, value in row.sd.items()}
                for end, k in (("low", 0), ("high", 1)):
                    out |= {f"{start}{figure}_{end}": bounds[k] for figure, bounds in row.interval.items()}
                if row.sd and not row.part:
                    out[f"{start}seeds"] = row.seeds
        return out

    def as_json(self) -> Any:
        """What JSON can hold; `from_json` reads it back."""
        return _STUDY.dump_python(self)

    @staticmethod
    def from_json(value: Mapping[str, Any]) -> Study:
        """Read what `as_json` gave. Raises pydantic.ValidationError for anything else."""
        return _STUDY.validate_python(value)


_STUDY = TypeAdapter(Study)
