"""A reproduction of a paper: its runs, and what they say of the paper's claims."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..core.units import number
from .papers import OF_ALL, UNITS, Row, overrides, zhan_case


@dataclass(repr=False)
class Reproduction:
    """What came of it."""

    folder: Path
    paper: str
    quick: bool
    seeds: int
    device: str | None
    columns: tuple[str, ...] = ()
    """Concretes, and what is open, that are run; none: all."""
    rows: tuple[str, ...] = ()
    """What is run with each; none: all."""
    results: dict[str, dict[str, Any]] = field(default_factory=dict)
    """result.json of runs by :func:`key_of` their parameters."""
    failures: dict[str, str] = field(default_factory=dict)
    """What ended a run."""
    finished: bool = False

    def __repr__(self) -> str:
        return f"<Reproduction of {self.paper}: {len(self.results)} runs, folder '{self.folder}'>"

    def values(self, group: str, parameters: Mapping[str, Any], quantity: str) -> list[float]:
        """Of a quantity, over the seeds of a case that came to it."""
        found = []
        for seed in range(self.seeds):
            entry = self.results.get(key_of(group, {**parameters, "seed": seed}), {}).get(quantity)
            if entry is not None and math.isfinite(number(entry)):
                found.append(number(entry))
        return found

    def mean(self, group: str, parameters: Mapping[str, Any], quantity: str) -> float:
        """Over seeds; NaN where no run came to it."""
        found = self.values(group, parameters, quantity)
        return float(np.mean(found)) if found else math.nan


def key_of(group: str, parameters: Mapping[str, Any]) -> str:
    """A name of a case, the same for the same parameters."""
    return f"{group}: " + ", ".join(f"{name}={parameters[name]!r}" for name in sorted(parameters))


def unit_case(unit: str, quick: bool) -> dict[str, Any]:
    """Parameters of a unit."""
    return zhan_case(Row("unit", "unit", UNITS, "", lambda values, pressures: (True, "")), unit, quick)


def pressures(found: Reproduction, row: Row, name: str) -> list[list[float]]:
    """Largest pressures [Pa] of a row with a column's concrete, of all seeds that ran, by the row's values."""
    group = f"{name}, hydrated" if row.is_hydrated else name
    return [found.values(group, {**zhan_case(row, value, found.quick), **overrides(name)}, "peak_pressure")
            for value in row.values]  # fmt: skip


def judged(found: Reproduction, row: Row, name: str) -> tuple[list[float], str]:
    """Largest pressures of a row [Pa], NaN where a run failed, and a verdict in words; none where it was not run."""
    means = [float(np.mean(values)) if values else math.nan for values in pressures(found, row, name)]
    there = [k for k, mean in enumerate(means) if math.isfinite(mean)]
    if not there:
        return means, ""
    if len(there) < len(means):
        lost = ", ".join(f"{row.places[k]:g}" for k in range(len(means)) if k not in there)
        if len(there) < 3 or row.judge in OF_ALL:
            return means, f"too few runs finished (missing: {lost})"
        holds, what = row.judge([row.places[k] for k in there], [means[k] for k in there])
        return means, f"{'holds' if holds else 'differs'} for the finished runs (missing: {lost}): {what}"
    holds, what = row.judge(row.places, means)
    return means, f"{'holds' if holds else 'differs'}: {what}"
