"""Result quantities of mortar with aggregates that flows through a part of a pump line."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ...core.run.method import Quantity
from ...core.run.run import Run
from ...core.units import number
from ...mps.part.quantities import QUANTITIES as PART_QUANTITIES
from ...mps.part.quantities import RunData, report
from ..quantities import aggregate_lines
from .blockage import is_blocked
from .scene import PartSuspensionScene

LATE = 0.5
"""Fraction of the simulated time, counted back from its end, over which results are averaged. Averages are needed
because the pressure fluctuates."""
BLOCKS = 5
"""Number of equal parts into which the last half of the run is divided. The standard error of a mean over this half
follows from the scatter of the means over these parts."""


def late_rows(time: np.ndarray) -> np.ndarray:
    """Return a mask of the rows of a time series over which results are averaged; `time` holds their times [s]."""
    return (time > 0) & (time >= (1 - LATE) * time[-1])


@dataclass(frozen=True)
class SuspensionData(RunData):
    """Scene and series, with two rows or more, from which the quantities of a run are computed."""

    scene: PartSuspensionScene  # pyright: ignore[reportIncompatibleVariableOverride]
    place: float = np.nan
    """Arc length at which the frictional pressure falls most steeply at the end of the run [m]."""

    def final(self, name: str) -> float:
        """Return the mean of a column of the time series over the last half of the run."""
        return float(self.series[name][late_rows(self.series["time"])].mean())

    def error(self, name: str) -> float | None:
        """Return the standard error of the mean of a column; None if the last half of the run has too few rows."""
        values = self.series[name][late_rows(self.series["time"])]
        if len(values) < 2 * BLOCKS:
            return None
        means = [float(part.mean()) for part in np.array_split(values, BLOCKS)]
        return float(np.std(means, ddof=1) / np.sqrt(BLOCKS))

    def at_end(self, name: str) -> float:
        """Return the last value of a column of the time series."""
        return float(self.series[name][-1])

    @property
    def blocked(self) -> bool:
        """True if aggregates blocked the part of the pump line when the run ended."""
        names = list(self.series)
        rows = [dict(zip(names, map(float, row), strict=True)) for row in zip(*self.series.values(), strict=True)]
        return is_blocked(self.scene, rows)

    def if_blocked(self, value: float) -> float | None:
        """Return a value if aggregates blocked the part of the pump line, otherwise None."""
        return value if self.blocked else None


def _counts(run: Run) -> str:
    entered, left, present = (
        int(number(run.result[name])) for name in ("aggregates_entered", "aggregates_left", "aggregates_present")
    )
    return f"{entered} entered, {left} left, {present} inside"


BLOCKED = "the part was blocked"
OF_THEORY = frozenset({"pressure_theory", "upstream_gradient_theory", "downstream_gradient_theory", "middle_ratio"})
"""Names of quantities of a part that contain a theoretical value, which holds for the mortar without aggregates."""

QUANTITIES = (
    *(
        replace(each, meaning=f"{each.meaning}; theory of mortar without aggregates")
        if each.name in OF_THEORY
        else each
        for each in PART_QUANTITIES
        if each.name != "middle_excess"
    ),
    Quantity("pressure_error", "Pa", lambda k: k.error("pressure"), "error of pressure",
             lambda run: f"{number(run.result['pressure_error']) / 1e3:.2g} kPa, standard error of the mean",
             meaning="Standard error of the mean pressure"),
    Quantity("aggregates_entered", "1", lambda k: k.at_end("aggregates_entered"), "aggregates", _counts,
             meaning="Number of aggregates that have entered the part"),
    Quantity("aggregates_left", "1", lambda k: k.at_end("aggregates_left"),
             meaning="Number of aggregates that have left the part"),
    Quantity("aggregates_present", "1", lambda k: k.at_end("aggregates_present"),
             meaning="Number of aggregates in the part at the end"),
    Quantity("smallest_gap", "1", lambda k: float(k.series["smallest_gap"][1:].min()),
             meaning="Smallest gap between aggregates, or between aggregate and wall, during the run"),
    Quantity("blocked", "1", lambda k: float(k.blocked), rare=True, compared=True,
             meaning="1 if the aggregates blocked the part, otherwise 0"),
    Quantity("blocked_at", "m", lambda k: k.if_blocked(k.place),
             meaning="Arc length at which the pressure falls most steeply at the end of a blocked run",
             only_if=BLOCKED),
    Quantity("blocked_time", "s", lambda k: k.if_blocked(k.at_end("time")),
             meaning="Simulated time at which the run ended with a blockage", only_if=BLOCKED),
    Quantity("blocked_pressure", "Pa", lambda k: k.if_blocked(k.at_end("pressure")),
             meaning="Pressure at the inlet at the end of a blocked run", only_if=BLOCKED),
)  # fmt: skip
"""Results of a part with aggregates. Pressures and losses are means over the last half of the run. Theoretical values
hold for mortar without aggregates. Results of a blockage have the same names as in simulations with discrete elements.
"""


def report_part(run: Run) -> Iterator[tuple[str, str]]:
    """Yield lines of the report on a part: the loss of each section, and whether aggregates blocked the pipe."""
    yield from report(run)
    yield from aggregate_lines(run)
    if run.result.get("blocked"):
        at, time, pressure = (number(run.result[f"blocked_{name}"]) for name in ("at", "time", "pressure"))
        yield (
            "BLOCKED",
            f"at {at:.3g} m from the start, after {time:.3g} s, with a pressure of {pressure / 1e3:.4g} kPa",
        )
