"""Class that describes a standard test of fresh concrete: measurements, end of the test, and closed forms."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from ..core.errors import refuse
from ..core.run.method import Quantity, passage_time
from ..core.run.run import Run
from ..core.units import number

RESTED = 1.0
"""Simulated time [s] that concrete must stay slow before it counts as being at rest."""
FORMATS = {"m": (1e3, " mm", 1, 0), "s": (1.0, " s", 2, 2), "1": (1.0, "", 2, 2)}
"""For each SI unit: factor and unit in the report, decimals of a result, and decimals of its closed forms."""
Sizes = Mapping[str, float]
"""Dimensions of a vessel by name [m]."""
Row = Mapping[str, float]
"""Row of the time series, by column."""


@dataclass(frozen=True)
class Specimen:
    """Concrete in a vessel at one moment, as a simulation method measures it; all lengths are in metres."""

    top: Callable[[float], float]
    """Function of a radius: height of the surface within this radius of the axis."""
    spread: Callable[[], float]
    """Diameter of a heap."""
    height_around: Callable[[float, float], float]
    """Function of two radii about the axis: mean height of the surface between them."""
    depth: Callable[[float, float, float], float]
    """Function of two places along a box and the box's width: depth of the concrete between the places."""
    front: Callable[[], float]
    """Distance that the concrete reaches along a box."""
    screen: Callable[[float, float], float]
    """Function of an outlet's width and breadth: covered fraction of the outlet, seen from above."""
    inside: float
    """Fraction of the concrete that is still in the vessel."""


@dataclass(frozen=True)
class Outcome:
    """Data of a run from which the quantities of its standard test follow."""

    test: StandardTest
    size: Sizes
    series: Mapping[str, np.ndarray]
    """Columns of the time series; empty if only closed forms are evaluated."""
    fill_height: float | None = None
    """Height of settled concrete in a mould before it is lifted [m]; None if concrete fills the mould exactly."""
    concrete: Any = None
    """Yield stress fluid, a :class:`warpcrete.theory.pipe.Concrete`, for the closed forms."""
    gravity: float = 9.81
    whole: float = 0.0
    """Volume of all concrete [m3]."""

    def last(self, name: str) -> float:
        """Return the last value of a column."""
        return float(self.series[name][-1])

    def when(self, name: str, value: float, falls: bool = False) -> float | None:
        """Return the time at which a column first passes `value` [s], interpolated linearly; None if it never does.

        With `falls` the column must fall to the value instead of rising to it.
        """
        return passage_time(self.series, name, value, falls)


@dataclass(frozen=True)
class ClosedForm:
    """Closed form that predicts a quantity of a test for a yield stress fluid."""

    quantity: str
    suffix: str
    """Ending of the result's name, after the name of the quantity and an underscore."""
    label: str
    """Name of the closed form in the report."""
    of: Callable[[Any], float | None]
    """Function that computes the value from an :class:`Outcome`; it returns None where the form does not hold."""
    is_estimate: bool = True
    """True if calibrations may start from this value.

    Of several such forms of a quantity, the last one that holds has priority.
    """

    @property
    def name(self) -> str:
        """Name of the value in results."""
        return f"{self.quantity}_{self.suffix}"


@dataclass(frozen=True)
class Outflow:
    """End condition of a test in which concrete flows out of a vessel whose outlet is at height 0."""

    column: str
    """Column of the series that falls during the test."""
    below: float
    """Value of the column below which the test is over."""
    time: str
    """Name of the quantity that is the duration of the test."""
    finding: str
    """Name of the check that a finished run must pass."""
    height: Callable[[Sizes], float]
    """Function that computes the height of the vessel [m] from its dimensions."""


@dataclass(frozen=True, kw_only=True, eq=False)
class StandardTest:
    """Standard test of fresh concrete. A scene with this record is measured and reported accordingly."""

    name: str
    dimensions: tuple[str, ...]
    """Names of the vessel's dimensions that the test needs; the scene's parameters have the same names."""
    columns: Mapping[str, str]
    """Units of the measured columns of the series, by name."""
    measure: Callable[[Specimen, Sizes], dict[str, float]]
    """Function that measures the columns of one row from a :class:`Specimen` and the vessel's dimensions."""
    quantities: tuple[Quantity, ...]
    """Results, each computed from an :class:`Outcome`."""
    forms: tuple[ClosedForm, ...] = ()
    outflow: Outflow | None = None
    """End condition of a test whose vessel empties; all other tests end when the concrete is at rest."""
    on_plate: bool = False
    """True if the concrete spreads on a plate, whose edge it must not reach."""
    in_space: bool = False
    """True if a flow must be simulated in space, because its closed forms need the depth of the vessel."""
    curves: Mapping[str, str] | None = None
    """Labels of the columns that the picture of a run shows over time; by default, spread and height."""

    def __post_init__(self) -> None:
        TESTS[self.name] = self

    def __reduce__(self) -> Any:
        return _by_name, (self.name,)

    def check_dimensions(self, given: Sizes) -> None:
        """Raise :class:`warpcrete.SceneError` if a dimension that the test needs is missing."""
        if missing := [name for name in self.dimensions if name not in given]:
            refuse("dimensions", dict(given), f"must have {', '.join(missing)} for test {self.name!r}")

    def sizes(self, given: Any) -> dict[str, float]:
        """Return the dimensions of the vessel, from the parameters of a scene."""
        return {name: getattr(given, name) for name in self.dimensions}

    def is_over(self, row: Row) -> bool:
        """Return whether the concrete has flowed out; always False for tests that end at rest."""
        return self.outflow is not None and row[self.outflow.column] < self.outflow.below

    def with_forms(self) -> Iterator[Quantity]:
        """Yield the quantities, each followed by its closed forms, which the report shows beside it."""
        for each in self.quantities:
            forms = [form for form in self.forms if form.quantity == each.name]
            yield replace(each, words=_beside(each, forms)) if forms else each
            for form in forms:
                yield Quantity(form.name, each.unit, form.of)

    def estimates(self, known: Outcome) -> dict[str, float]:
        """Return the quantities that closed forms predict, by name."""
        found = ((form.quantity, form.of(known)) for form in self.forms if form.is_estimate)
        return {name: float(value) for name, value in found if value is not None}

    def judge(self, run: Run) -> dict[str, tuple[bool, str]]:
        """Return the check that the test has come to its end: by name, whether it passed, and what it found."""
        result = run.result
        if self.outflow is None:
            speed = 1e3 * number(result["rest_speed"])
            return {"at rest": (bool(result["at_rest"]), f"the fastest moves at {speed:.2g} mm/s")}
        time = result.get(self.outflow.time)
        left = f"{100 * result['remaining']:.0f} % of the concrete remains"
        return {self.outflow.finding: (time is not None, f"after {number(time):.2f} s" if time else left)}


TESTS: dict[str, StandardTest] = {}
"""All tests by name. A test is added when it is created, so a scene's file may define its own."""


def _by_name(name: str) -> StandardTest:
    return TESTS[name]


def quantities_of_tests(
    of: Callable[[StandardTest], Iterable[Quantity]], outcome: Callable[[Any], Outcome | None]
) -> list[Quantity]:
    """Return the quantities that `of` yields for each test; each is None in runs of other tests.

    `outcome` takes a method's data about a run and returns what its test needs, or None if there is no test.
    """
    found: dict[str, dict[StandardTest, Quantity]] = {}
    for test in TESTS.values():
        for each in of(test):
            found.setdefault(each.name, {})[test] = each

    def value(variants: dict[StandardTest, Quantity], known: Any) -> float | None:
        seen = outcome(known)
        return variants[seen.test].of(seen) if seen and seen.test in variants else None

    return [replace(next(iter(each.values())), of=partial(value, each)) for each in found.values()]


def is_at_rest(rows: Sequence[Row], opened: float, rest_speed: float) -> bool:
    """Return whether concrete was slower than `rest_speed` [m/s] for RESTED seconds, after the time `opened` [s]."""
    now = rows[-1]["time"]
    late = (row["fastest"] for row in rows if row["time"] > now - RESTED - 1e-9)
    return now >= opened + RESTED and all(speed < rest_speed for speed in late)


def report_unrest(run: Run, test: StandardTest | None) -> Iterator[tuple[str, str]]:
    """Yield a line for the report if the run has ended before the concrete was at rest or had flowed out."""
    result = run.result
    is_out = test is not None and test.outflow is not None and test.outflow.time in result
    if run.finished and not result["at_rest"] and not is_out:
        yield "not at rest", f"{1e3 * number(result['rest_speed']):.2g} mm/s at {run.series['time'][-1]:.3g} s"


def _beside(quantity: Quantity, forms: Sequence[ClosedForm]) -> Callable[[Run], str]:
    """Return a function that formats a result, followed by the values of closed forms in parentheses."""
    factor, unit, digits, fewer = FORMATS[quantity.unit]

    def words(run: Run) -> str:
        estimates_first = sorted(forms, key=lambda form: not form.is_estimate)
        found = [(form.label, run.result.get(form.name)) for form in estimates_first]
        texts = [f"{label}: {factor * number(value):.{fewer}f}{unit}" for label, value in found if value is not None]
        beside = f"   ({', '.join(texts)})" if texts else ""
        return f"{factor * number(run.result[quantity.name]):.{digits}f}{unit}{beside}"

    return words
