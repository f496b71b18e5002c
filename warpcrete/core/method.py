"""What a method of simulation is to the rest of the program, and what a run of it comes to in numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .display import Display
from .forecast import Forecast, Probe
from .run_loop import Run, Simulation
from .units import number, quantity, shown

Progress = Callable[[str, float], None]
"""Called with a phase and the fraction done."""


@dataclass(frozen=True)
class Quantity:
    """A number that a run comes to: it stands in result.json and, by `label`, in the report of the command."""

    name: str
    unit: str
    of: Callable[[Any], float | None]
    """Of what the method knows of a run; None where it means nothing."""
    label: str = ""
    """What the report calls it; without one it is not reported."""
    words: Callable[[Run], str] | None = None
    """How the report gives it, instead of value and unit."""
    compared: bool = False
    """Studies put it into their table and figure."""
    rare: bool = False
    """Only if some case has more than 0 of it."""

    @property
    def title(self) -> str:
        """Heading of a table."""
        return self.name.removesuffix("_pressure").replace("_", " ")


def results_of(quantities: Sequence[Quantity], known: Any) -> dict[str, Any]:
    """Entries of result.json: quantities with a unit as `{"value", "unit"}`, pure numbers plain."""
    found: dict[str, Any] = {}
    for each in quantities:
        value = each.of(known)
        if value is not None:
            found[each.name] = float(value) if each.unit == "1" else quantity(value, each.unit)
    return found


def report_of(quantities: Sequence[Quantity], run: Run) -> Iterator[tuple[str, str]]:
    """Label and text of every quantity of a run that is reported."""
    for each in quantities:
        if each.label and each.name in run.result:
            factor, unit = shown(each.unit)
            value = number(run.result[each.name]) * factor
            yield each.label, each.words(run) if each.words else f"{value:.4g} {unit}"


@dataclass(frozen=True)
class Method:
    """A method, found by the type of a scene; see `warpcrete/methods.py`."""

    name: str
    simulation: type[Simulation]
    quantities: tuple[Quantity, ...]
    display: type[Display]
    picture: str
    """Name of the picture in a run folder."""
    draw: Callable[[Any, Run, str], Any]
    """Matplotlib figure of (simulation, run, colouring), or None where there is nothing to draw."""
    show: Callable[[Run], Any]
    """Matplotlib figure of a run alone, for notebooks."""
    report: Callable[[Run], Iterator[tuple[str, str]]]
    """Label and text of each line that the command prints about a run, after its quantities."""
    forecast: Callable[[Any, Any, str, int | None, Probe], Forecast]
    """What a run of a scene will take, of (scene, device, precision, threads, probe of a prepared simulation)."""
    run_many: Callable[[Sequence[Any], Sequence[Path | None], Progress], list[Run | BaseException]]
    """Runs simulations of one device, each from its checkpoint if it has one; what each came to, or its error."""
    more_pictures: Callable[[Run], Mapping[str, Any]] = lambda run: {}
    """Other Matplotlib figures of a run's folder by their files' names; None where there is nothing to draw."""
    expected: Callable[[Any], Mapping[str, float]] = lambda scene: {}
    """Quantities of a scene by closed forms, before it runs; those that have none are left out."""

    @property
    def scene_type(self) -> type:
        """Of the scenes that it simulates."""
        return self.simulation.scene_type

    @property
    def compared(self) -> tuple[Quantity, ...]:
        """Quantities that studies compare."""
        return tuple(each for each in self.quantities if each.compared)


def run_in_turn(
    simulations: Sequence[Any], checkpoints: Sequence[Path | None], progress: Progress
) -> list[Run | BaseException]:
    """Run simulations one after the other."""
    outcomes: list[Run | BaseException] = []
    for done, (simulation, checkpoint) in enumerate(zip(simulations, checkpoints)):
        try:
            if simulation.stop_requested:
                raise KeyboardInterrupt
            if checkpoint is not None:
                simulation.begin(checkpoint)
            outcomes.append(simulation.run())
        except (Exception, KeyboardInterrupt) as error:
            outcomes.append(error)
        finally:
            simulation.release()
        progress("running", (done + 1) / len(simulations))
    return outcomes
