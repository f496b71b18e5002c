"""State of a reproduction: the runs of a paper's cases, and verdicts on the paper's claims."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...core.records import Record, SceneArguments
from ...core.units import number
from .papers import NEEDS_ALL_VALUES, UNITS, Row, column_parameters, zhan_case


@dataclass(repr=False)
class Reproduction:
    """Reproduction of a paper, complete or still in progress."""

    folder: Path
    paper: str
    quick: bool
    seeds: int
    device: str | None
    columns: tuple[str, ...] = ()
    """Names of the report's columns for which runs are made; an empty tuple stands for all columns. A column is a
    concrete, or an assumption about a detail that the paper leaves open."""
    rows: tuple[str, ...] = ()
    """Names of the report's rows for which runs are made; an empty tuple stands for all rows.

    The row `units` stands for the runs of the paper's four pipe units: a vertical pipe, a horizontal pipe and two
    bends. Each other name stands for a :class:`Row`, in which one parameter varies.
    """
    results: dict[str, Record] = field(default_factory=dict)
    """Results of runs, by the key that :func:`key_of` forms from their parameters."""
    failures: dict[str, str] = field(default_factory=dict)
    """Messages of the errors that ended runs, by the key that :func:`key_of` forms from the parameters of the run."""
    finished: bool = False

    def __repr__(self) -> str:
        return f"<Reproduction of {self.paper}: {len(self.results)} runs, folder '{self.folder}'>"

    def values(self, group: str, parameters: Mapping[str, object], quantity: str) -> list[float]:
        """Return the values of a quantity in the runs of one case with different seeds.

        The case has the `parameters`, and belongs to the `group` of runs. Values that are not finite are left out.
        """
        numbers = []
        for seed in range(self.seeds):
            entry = self.results.get(key_of(group, {**parameters, "seed": seed}), {}).get(quantity)
            if entry is not None and math.isfinite(number(entry)):
                numbers.append(number(entry))
        return numbers

    def mean(self, group: str, parameters: Mapping[str, object], quantity: str) -> float:
        """Return the mean of a quantity over the seeds of a case; NaN if no run has a value."""
        numbers = self.values(group, parameters, quantity)
        return float(np.mean(numbers)) if numbers else math.nan


def key_of(group: str, parameters: Mapping[str, object]) -> str:
    """Return a text that identifies a case by its group and its sorted parameters."""
    return f"{group}: " + ", ".join(f"{name}={parameters[name]!r}" for name in sorted(parameters))


def unit_case(unit: str, quick: bool) -> SceneArguments:
    """Return the scene parameters of one of the four pipe units of Zhan et al.

    With `quick`, the concrete consists of coarse spheres instead of clumps.
    """
    return zhan_case(Row("unit", "unit", UNITS, "", lambda values, pressures: (True, "")), unit, quick)


def pressures(found: Reproduction, row: Row, name: str) -> list[list[float]]:
    """Return the peak pressures [Pa] for each value of a varied parameter, as a list with one entry for each seed.

    Seeds without a result are left out. `row` describes the varied parameter. `name` is the name of a column of the
    report, such as "calibrated".
    """
    group = f"{name}, hydrated" if row.is_hydrated else name
    return [
        found.values(group, {**zhan_case(row, value, found.quick), **column_parameters(name)}, "peak_pressure")
        for value in row.values
    ]


def verdict_of(found: Reproduction, row: Row, name: str) -> tuple[list[float], str]:
    """Return the mean peak pressure [Pa] for each value of a varied parameter, and the verdict as a text.

    The mean pressure is NaN for values without a result. The verdict states whether the runs confirm what Zhan et al.
    (2019) claim about the parameter; it is empty if no run has a result. `row` describes the varied parameter. `name`
    names the set of other parameters, a column of the report of `warpcrete reproduce zhan` such as "calibrated".
    """
    means = [float(np.mean(values)) if values else math.nan for values in pressures(found, row, name)]
    there = [k for k, mean in enumerate(means) if math.isfinite(mean)]
    if not there:
        return means, ""
    if len(there) < len(means):
        lost = ", ".join(f"{row.places[k]:g}" for k in range(len(means)) if k not in there)
        if len(there) < 3 or row.judge in NEEDS_ALL_VALUES:
            return means, f"too few runs finished (missing: {lost})"
        holds, what = row.judge([row.places[k] for k in there], [means[k] for k in there])
        return means, f"{'holds' if holds else 'differs'} for the finished runs (missing: {lost}): {what}"
    holds, what = row.judge(row.places, means)
    return means, f"{'holds' if holds else 'differs'}: {what}"
