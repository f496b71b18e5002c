"""Class that describes a standard test of fresh concrete: measurements, end of the test, and closed-form solutions."""

from __future__ import annotations

import importlib
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
FASTEST, MOST = "fastest", "speed_of_most"
"""Names of the columns of the series that show whether the concrete is at rest: its largest speed, and the speed that
the fraction :attr:`StandardTest.slow_share` of the concrete does not exceed [m/s]."""
FORMATS = {"m": (1e3, " mm", 1, 0), "s": (1.0, " s", 2, 2), "Pa": (1.0, " Pa", 1, 1), "1": (1.0, "", 2, 2)}
"""Format of results in the report. The keys are SI units. Each value contains the factor to the displayed unit, this
unit, and the numbers of decimals: of the result, and of the closed forms that predict it."""
Sizes = Mapping[str, float]
"""Dimensions of a vessel by name [m]."""
Row = Mapping[str, float]
"""One row of the time series: values by column name."""


@dataclass(frozen=True)
class Specimen:
    """Concrete in a vessel at one moment, as a simulation method measures it; all lengths are in metres."""

    top: Callable[[float], float]
    """Function that takes a radius about the vessel's vertical axis [m], and returns the mean height of the concrete's
    surface within this radius [m]."""
    spread: Callable[[], float]
    """Function that returns the diameter [m] of the heap of concrete, as seen from above."""
    height_around: Callable[[float, float], float]
    """Function that takes two radii about the vessel's vertical axis [m], and returns the mean height of the concrete's
    surface between these radii [m]."""
    depth: Callable[[float, float, float], float]
    """Function that returns the depth of the concrete [m] in a section of a box, such as the L-box.

    Its arguments are the positions of the section's start and end along the box [m], and the width of the box [m].
    """
    front: Callable[[], float]
    """Function that returns how far the front of the concrete has come along a box [m]."""
    screen: Callable[[float, float], float]
    """Function that returns the fraction of an outlet that concrete covers, seen from above.

    Its arguments are the width and the breadth of the outlet [m].
    """
    inside: float
    """Fraction of the concrete that is still in the vessel."""


@dataclass(frozen=True)
class Outcome:
    """Data of a run from which the quantities of its standard test follow."""

    test: StandardTest
    size: Sizes
    series: Mapping[str, np.ndarray]
    """Columns of the time series by name; empty if only closed forms are evaluated, without a run."""
    fill_height: float | None = None
    """Height of settled concrete in a mould before it is lifted [m]; None if concrete fills the mould exactly."""
    concrete: Any = None
    """Yield stress fluid, a :class:`warpcrete.theory.pipe.Concrete`, for the closed forms; None if it is unknown."""
    density: float = 0.0
    """Density of the concrete in the full vessel [kg/m3]."""
    gravity: float = 9.81
    whole: float = 0.0
    """Volume of all concrete in the test, inside the vessel and outside it [m3]."""

    def last(self, name: str) -> float:
        """Return the last value of the column `name` of the time series."""
        return float(self.series[name][-1])

    def when(self, name: str, value: float, falls: bool = False) -> float | None:
        """Return the time at which a column first passes `value` [s], interpolated linearly; None if it never does.

        With `falls` the column must fall to the value instead of rising to it.
        """
        return passage_time(self.series, name, value, falls)


@dataclass(frozen=True)
class ClosedForm:
    """Closed-form solution ("closed form") that predicts a result of a standard test for a yield stress fluid."""

    quantity: str
    suffix: str
    """Suffix of the result's name, which is the name of the quantity, an underscore and this suffix."""
    label: str
    """Name of the closed form in the report of a run."""
    of: Callable[[Any], float | None]
    """Function that takes an :class:`Outcome` and returns the quantity that the closed form predicts.

    The function returns None outside the range in which the closed form is valid.
    """
    is_estimate: bool = True
    """True if calibrations may use this closed form for their first estimate.

    If several closed forms of a quantity have the value True, calibrations use the last one whose function `of` does
    not return None.
    """

    @property
    def name(self) -> str:
        """Name of the closed form's value in the results of a run."""
        return f"{self.quantity}_{self.suffix}"

    def value(self, known: Outcome) -> float | None:
        """Return the value predicted for the run `known`.

        The result is None if the closed form does not hold for the run, or if the concrete is unknown.
        """
        return None if known.concrete is None else self.of(known)


@dataclass(frozen=True)
class Outflow:
    """End condition of a test in which concrete flows out of a vessel whose outlet is at height 0."""

    column: str
    """Name of the column of the time series whose value falls during the test."""
    below: float
    """The test is over as soon as the value in the column `column` falls below this number."""
    time: str
    """Name of the result that is the duration of the test."""
    finding: str
    """Name of the check in the results that is passed if the concrete has flowed out by the end of the run."""
    height: Callable[[Sizes], float]
    """Function that computes the height of the vessel [m] from its dimensions."""


@dataclass(frozen=True, kw_only=True, eq=False)
class StandardTest:
    """Standard test of fresh concrete: how a simulation measures, ends and reports the test.

    A scene that simulates the test holds this record in its field `test`.
    """

    name: str
    dimensions: tuple[str, ...]
    """Names of the vessel's dimensions that the test needs; the scene's parameters have the same names."""
    columns: Mapping[str, str]
    """Units of the measured columns of the series, by name."""
    measure: Callable[[Specimen, Sizes], dict[str, float]]
    """Function that measures the concrete once and returns the values of one row of the time series, by column name.

    Its arguments are a :class:`Specimen` and the vessel's dimensions.
    """
    quantities: tuple[Quantity, ...]
    """Results of the standard test, each computed from an :class:`Outcome`."""
    forms: tuple[ClosedForm, ...] = ()
    outflow: Outflow | None = None
    """End condition of a test whose vessel empties; all other tests end when the concrete is at rest."""
    slow_share: float = 1.0
    """Fraction of the concrete in a flow that must be slow for the concrete to count as at rest. It is below 1 in a
    vessel on whose walls a film may remain that slides down long after the rest of the concrete has stopped."""
    on_plate: bool = False
    """True if the concrete spreads on a plate, whose edge it must not reach."""
    in_space: bool = False
    """True if a flow must be simulated in three dimensions, because the closed forms need the width of the vessel."""
    ring: Callable[[Sizes], float] | None = None
    """Function that returns the radius of a ring of bars about the axis [m], through which the concrete flows; None
    without a ring."""
    curves: Mapping[str, str] | None = None
    """Labels of the columns of the series that the figure of a run shows over time; by default, spread and height."""

    def __post_init__(self) -> None:
        TESTS[self.name] = self

    def __reduce__(self) -> Any:
        return _by_name, (self.name, self.measure.__module__)

    def check_dimensions(self, given: Sizes) -> None:
        """Raise :class:`warpcrete.SceneError` if `given` lacks a dimension that the test needs."""
        if missing := [name for name in self.dimensions if name not in given]:
            problem = f"has no {', '.join(missing)}, which the test {self.name!r} needs"
            refuse("dimensions", dict(given), problem, "add the missing dimensions")

    def sizes(self, given: object) -> dict[str, float]:
        """Return the dimensions of the vessel [m] by name, taken from the scene parameters `given`."""
        return {name: getattr(given, name) for name in self.dimensions}

    def is_over(self, row: Row) -> bool:
        """Return whether the concrete has flowed out, according to a row of the time series.

        The result is always False for tests that end when the concrete is at rest.
        """
        return self.outflow is not None and row[self.outflow.column] < self.outflow.below

    def with_forms(self) -> Iterator[Quantity]:
        """Yield each quantity of the test, followed by the closed forms that predict it.

        The report shows the values of the closed forms next to the measured quantity.
        """
        for each in self.quantities:
            forms = [form for form in self.forms if form.quantity == each.name]
            yield replace(each, words=_beside(each, forms)) if forms else each
            for form in forms:
                meaning = f"Value of `{each.name}` that the closed form '{form.label}' predicts"
                yield Quantity(form.name, each.unit, form.value, meaning=meaning)

    def estimates(self, known: Outcome) -> dict[str, float]:
        """Return the quantities that closed forms predict for the run `known`, by name."""
        values = ((form.quantity, form.value(known)) for form in self.forms if form.is_estimate)
        return {name: float(value) for name, value in values if value is not None}

    def judge(self, run: Run) -> dict[str, tuple[bool, str]]:
        """Return the check that the test has come to its end: that the concrete is at rest or has flowed out.

        The dictionary has one entry: the name of the check, and a tuple (True if passed, text with the measured value).
        """
        result = run.result
        if self.outflow is None:
            speed = 1e3 * number(result["rest_speed"])
            share = (
                f"{self.slow_share:.0%} of it moves at no more than" if MOST in run.series else "the fastest moves at"
            )
            return {"at rest": (bool(result["at_rest"]), f"{share} {speed:.2g} mm/s")}
        time = result.get(self.outflow.time)
        left = f"{100 * result['remaining']:.0f} % of the concrete remains"
        return {self.outflow.finding: (time is not None, f"after {number(time):.2f} s" if time else left)}


TESTS: dict[str, StandardTest] = {}
"""All standard tests of fresh concrete, by name. A test is added when it is created, so a scene's file may define its
own."""


def _by_name(name: str, module: str) -> StandardTest:
    if name not in TESTS:  # A worker process may not have imported the scene's file yet, which defines the test.
        importlib.import_module(module)
    return TESTS[name]


def quantities_of_tests(
    of: Callable[[StandardTest], Iterable[Quantity]], outcome: Callable[[Any], Outcome | None]
) -> list[Quantity]:
    """Return the result quantities of all standard tests, each once, even if several tests have it.

    The function `of` yields the quantities of one test. The function `outcome` takes a simulation method's data about a
    run and returns the :class:`Outcome` of the run's test, or None if the run simulates no standard test. The value of
    a quantity is None for a run whose test does not have this quantity.
    """
    by_name: dict[str, dict[StandardTest, Quantity]] = {}
    for test in TESTS.values():
        for each in of(test):
            by_name.setdefault(each.name, {})[test] = each

    def value(variants: dict[StandardTest, Quantity], known: object) -> float | None:
        measured = outcome(known)
        return variants[measured.test].of(measured) if measured and measured.test in variants else None

    return [replace(next(iter(each.values())), of=partial(value, each)) for each in by_name.values()]


def is_at_rest(rows: Sequence[Row], opened: float, rest_speed: float) -> bool:
    """Return whether the concrete was slower than `rest_speed` [m/s] throughout the last `RESTED` seconds.

    `opened` is the simulated time at which the concrete was free to flow [s]; until `RESTED` seconds later, the result
    is False. If `rows` contain a speed that most of the concrete does not exceed, this speed is compared with
    `rest_speed`, otherwise the largest speed.
    """
    now, column = rows[-1]["time"], MOST if MOST in rows[-1] else FASTEST
    late = (row[column] for row in rows if row["time"] > now - RESTED - 1e-9)
    return now >= opened + RESTED and all(speed < rest_speed for speed in late)


def report_unrest(run: Run, test: StandardTest | None) -> Iterator[tuple[str, str]]:
    """Yield a line for the report if the concrete was neither at rest nor had flowed out when the run ended."""
    result = run.result
    is_out = test is not None and test.outflow is not None and test.outflow.time in result
    if run.finished and not result["at_rest"] and not is_out:
        yield "not at rest", f"{1e3 * number(result['rest_speed']):.2g} mm/s at {run.series['time'][-1]:.3g} s"


def _beside(quantity: Quantity, forms: Sequence[ClosedForm]) -> Callable[[Run], str]:
    """Return a function that takes a run and formats the value of `quantity`, with the closed forms in parentheses."""
    factor, unit, digits, fewer = FORMATS[quantity.unit]

    def words(run: Run) -> str:
        estimates_first = sorted(forms, key=lambda form: not form.is_estimate)
        predictions = [(form.label, run.result.get(form.name)) for form in estimates_first]
        texts = [
            f"{label}: {factor * number(value):.{fewer}f}{unit}" for label, value in predictions if value is not None
        ]
        beside = f"   ({', '.join(texts)})" if texts else ""
        return f"{factor * number(run.result[quantity.name]):.{digits}f}{unit}{beside}"

    return words
