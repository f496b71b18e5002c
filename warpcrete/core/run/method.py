"""Interface between a simulation method and the rest of the program, and the quantities that result from a run."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from ..drawing.display import Display
from ..errors import warn
from ..units import Quantified, number, quantity, shown
from .forecast import Forecast, Probe
from .quantities import declare_conditions
from .run import Run
from .run_loop import Simulation

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Progress = Callable[[str, float], None]
"""Callback for progress, which is called with the name of a phase, such as "packing", and the fraction done."""


@dataclass(frozen=True)
class Quantity:
    """Number that results from a run: an entry of result.json and, with a `label`, a line in the command's report."""

    name: str
    unit: str
    of: Callable[[Any], float | None] = field(repr=False)
    """Function that takes the simulation method's data about a run. It returns the value of the quantity in `unit`, or
    None if the quantity is undefined for this run."""
    label: str = ""
    """Name of the quantity in the report; without a label, the quantity is not reported."""
    words: Callable[[Run], str] | None = field(default=None, repr=False)
    """Function that takes a run and returns the text that the report shows in place of the value and the unit."""
    compared: bool = False
    """True if studies show the quantity in their table and figure."""
    rare: bool = False
    """True if a study shows the quantity only if its value is above 0 in at least one of the study's runs."""
    meaning: str = ""
    """Meaning of the quantity for the reference pages: a sentence without a full stop at its end."""
    only_if: str = ""
    """Condition under which a run has the quantity, as the rest of a sentence that begins with "only if"; empty if
    there is no simple condition."""

    @property
    def title(self) -> str:
        """Column heading of the quantity in tables."""
        return self.name.removesuffix("_pressure").replace("_", " ")


def results_of(quantities: Sequence[Quantity], known: object) -> dict[str, float | Quantified]:
    """Return entries of result.json: quantities with a unit as `{"value", "unit"}`, pure numbers as numbers.

    `known` is the simulation method's data about a run. The attribute `of` of each quantity is the function that
    computes its value from these data. If it raises an error, warn and leave out this quantity only.
    """
    found: dict[str, float | Quantified] = {}
    for each in quantities:
        try:
            value = each.of(known)
            if value is not None:
                found[each.name] = float(value) if each.unit == "1" else quantity(value, each.unit)
        except Exception as fault:
            warn(f"the results lack {each.name}, which could not be computed: {fault!r}")
    return found


def passage_time(series: Mapping[str, np.ndarray], name: str, value: float, falls: bool = False) -> float | None:
    """Return the time [s] at which a column of a time series first reaches `value`, by linear interpolation.

    The column must rise to the value, or fall to it if `falls` is true. The result is None if the column never reaches
    the value, or is at or beyond it from the start.
    """
    time, column = series["time"], series[name]
    if falls:
        column, value = -column, -value
    past = np.nonzero(column >= value)[0]
    if len(past) == 0 or past[0] == 0:
        return None
    k = past[0]
    part = (value - column[k - 1]) / (column[k] - column[k - 1])
    return float(time[k - 1] + part * (time[k] - time[k - 1]))


def report_of(quantities: Sequence[Quantity], run: Run) -> Iterator[tuple[str, str]]:
    """Yield the lines of a run's report as pairs (label, text), one for each quantity that has a label."""
    for each in quantities:
        if each.label and each.name in run.result:
            factor, unit = shown(each.unit)
            value = number(run.result[each.name]) * factor
            yield each.label, each.words(run) if each.words else f"{value:.4g} {unit}"


@dataclass(frozen=True)
class Method:
    """Simulation method, with its functions for results, pictures and forecasts; a scene's type selects the method.

    The module `warpcrete/methods.py` lists all methods.
    """

    name: str
    simulation: type[Simulation]
    list_quantities: Callable[[], tuple[Quantity, ...]]
    display: type[Display]
    picture: str
    """File name of the picture that :meth:`drawn` draws and that is saved in the run folder."""
    show: Callable[[Run], Figure | None]
    """Function that takes a run and returns a Matplotlib figure for notebooks."""
    report: Callable[[Run], Iterator[tuple[str, str]]]
    """Function that takes a run and yields (label, text) for each line that the command prints after the quantities."""
    forecast: Callable[[Any, wp.Device, str, int | None, Probe], Forecast]
    """Function that takes (scene, device, precision, threads, probe) and returns the expected time and memory of a run.
    `probe` is a function that times the operations of a prepared simulation."""
    run_many: Callable[[Sequence[Any], Sequence[Path | None], Progress], list[Run | BaseException]]
    """Function that runs several simulations on one device, each from its checkpoint if it has one. It returns a run or
    an error for each simulation."""
    draw: Callable[[Any, Run, str | None], Figure | None] | None = None
    """Function that draws the picture of a run folder. It takes the simulation, its run and the quantity that colours
    the bodies, and returns a Matplotlib figure, or None if there is nothing to draw. If None, `show` draws it."""
    more_pictures: Callable[[Run], Mapping[str, Figure | None]] = lambda run: {}
    """Function that takes a run and returns further Matplotlib figures for its folder, by file name; a figure is None
    if there is nothing to draw."""
    check: Callable[[Run], dict[str, tuple[bool, str]]] | None = None
    """Function that checks a finished run of a scene that was built in Python, without a scene function. It returns, by
    the name of each check, whether the run passed and what the check found. None if there are no such checks."""
    expected: Callable[[Any], Mapping[str, float]] = lambda scene: {}
    """Function that takes a scene and returns the quantities that closed-form solutions predict, by name."""

    def __post_init__(self) -> None:
        declare_conditions(
            self.scene_type, lambda: {each.name: each.only_if for each in self.quantities if each.only_if}
        )

    def drawn(self, simulation: Simulation, run: Run, colouring: str | None) -> Figure | None:
        """Return the picture for a run folder; None if there is nothing to draw.

        The method's function `draw` draws the picture, with bodies coloured by the quantity `colouring`. If the method
        has no such function, the result is the figure for notebooks, or None for a run with only its initial row.
        """
        if self.draw is not None:
            return self.draw(simulation, run, colouring)
        return self.show(run) if len(run.series["time"]) > 1 else None

    @property
    def scene_type(self) -> type:
        """Type of the scenes that this simulation method simulates."""
        return self.simulation.scene_type

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """All quantities that runs of this simulation method may have.

        Each access creates a new list, because the user may have added standard tests with quantities of their own.
        """
        return self.list_quantities()

    @property
    def compared(self) -> tuple[Quantity, ...]:
        """Quantities that studies compare in their table and figure."""
        return tuple(each for each in self.quantities if each.compared)


def run_in_turn(
    simulations: Sequence[Simulation], checkpoints: Sequence[Path | None], progress: Progress
) -> list[Run | BaseException]:
    """Run simulations one after the other, each from its file in `checkpoints`, if it has one.

    Return a run or an error for each simulation. `progress` is called with the name of a phase and the fraction done.
    """
    outcomes: list[Run | BaseException] = []
    for done, (simulation, checkpoint) in enumerate(zip(simulations, checkpoints)):
        try:
            if simulation.stop_requested:
                raise KeyboardInterrupt
            if checkpoint is not None:
                simulation.begin(checkpoint)
            run = simulation.run()
            # Drop the final state: the states of many runs would fill the memory, and `save` is not called for these
            # runs.
            run.final_state = None
            outcomes.append(run)
        except (Exception, KeyboardInterrupt) as error:
            outcomes.append(error)
        finally:
            simulation.release()
        progress("running", (done + 1) / len(simulations))
    return outcomes
