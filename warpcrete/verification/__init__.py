"""Verification: our answers beside published or closed-form ones, with the tolerance that the measured error justifies.

`run_cases` gives rows, `table` and `figure` show them; `warpcrete verify` does both. Tests run the same cases on
every device and in both precisions.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from ..core.device import find_device
from ..core.errors import WarpcreteError
from ..dem.bodies import placed_bodies
from ..dem.model import build_model
from ..dem.scene import Scene
from ..dem.state import State
from ..dem.stepper import Stepper


@dataclass(frozen=True)
class Row:
    """One figure: ours beside the expected one."""

    quantity: str
    ours: float
    expected: float
    tolerance: float
    """Allowed |ours - expected|, relative to |expected| or, with `scale`, to that."""
    unit: str = "1"
    scale: float | None = None
    at_least: bool = False
    """Only less than expected is an error."""

    @property
    def error(self) -> float:
        """|ours - expected| over |expected| or `scale`."""
        if self.at_least and self.ours >= self.expected:
            return 0.0
        return abs(self.ours - self.expected) / (abs(self.expected) if self.scale is None else self.scale)

    @property
    def passed(self) -> bool:
        """Whether the error is within the tolerance; NaN is not."""
        return self.error <= self.tolerance


@dataclass(frozen=True)
class Case:
    """A named set of rows."""

    name: str
    source: str
    """Where the expected answer comes from."""
    run: Callable[[str, str], list[Row]]
    """(device, precision) -> rows."""
    group: str
    slow: bool = False
    curves: dict[str, Any] = field(default_factory=dict)
    """What the figure draws, filled by `run`."""


def start(scene: Scene, device: str, precision: str) -> Stepper:
    """A stepper for a scene whose bodies are placed one by one."""
    model = build_model(scene, find_device(device), precision)
    stepper = Stepper(model, State(model, placed_bodies(scene)), scene.time_step)
    stepper.choose_dt()
    return stepper


def cases() -> list[Case]:
    """All cases, in the order of the table."""
    from . import assemblies, bonds, clumps, contacts, flows, impacts, stability

    modules = (impacts, contacts, bonds, clumps, assemblies, stability, flows)
    return [case for module in modules for case in module.CASES]


def run_cases(
    chosen: list[Case], device: str, precision: str, *, slow: bool = True
) -> Iterator[tuple[Case, list[Row]]]:
    """Run cases one after the other; one that breaks off gives a row that fails."""
    for case in chosen:
        if slow or not case.slow:
            try:
                rows = case.run(device, precision)
            except WarpcreteError as error:
                rows = [Row(f"broke off: {error}", math.nan, 0.0, 0.0, scale=1.0)]
            yield case, rows


def table(results: list[tuple[Case, list[Row]]]) -> str:
    """Markdown table of all rows."""
    lines = [
        "| case | quantity | ours | expected | error | allowed | | expected from |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for case, rows in results:
        for number, row in enumerate(rows):
            unit = "" if row.unit == "1" else f" {row.unit}"
            first = number == 0
            cells = [
                case.name if first else "", row.quantity, f"{row.ours:.6g}{unit}", f"{row.expected:.6g}{unit}",
                _share(row.error), _share(row.tolerance), "" if row.passed else "**FAIL**",
                case.source if first else "",
            ]  # fmt: skip
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def summary(results: list[tuple[Case, list[Row]]]) -> str:
    """Markdown table with one line a case: the figure that comes nearest to its tolerance."""
    lines = ["| case | figures | largest error | allowed there | expected from |", "|---|---|---|---|---|"]
    for case, rows in results:
        worst = max(rows, key=lambda row: row.error / row.tolerance if row.tolerance else float(not row.passed))
        wrong = sum(not row.passed for row in rows)
        shown = f"{wrong} of {len(rows)} **FAIL**" if wrong else str(len(rows))
        lines.append(f"| {case.name} | {shown} | {_share(worst.error)} | {_share(worst.tolerance)} | {case.source} |")
    return "\n".join(lines) + "\n"


def _share(value: float) -> str:
    return f"{value:.1e}" if math.isfinite(value) else "-"
