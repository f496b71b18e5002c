"""Base class for runs of flows that are computed with particles only, or with particles and a grid."""

import math
from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from ...core.device.footprint import footprint
from ...core.device.kernel_files import run_clock
from ...core.drawing.display import Display
from ...core.errors import InstabilityError
from ...core.records import Record, SavedState
from ...core.run.provenance import arrays_hash, provenance
from ...core.run.run import Run
from ...core.run.run_loop import Simulation
from ...core.run.tables import Table
from ...core.units import quantity


class FlowRun(Simulation):
    """Base class of the simulation of one flow.

    When the particles have been placed, the attribute `flow` is the object that advances the flow in time. It must have
    the members `state`, `state_dict`, `load_state_dict`, `read_progress`, `count` and `steps`.
    """

    flow: Any
    goal: ClassVar[str] = "steady"
    """Name of the entry of a run's result that is true if the flow reached its final state.

    The entry `steady` is true if the flow became steady. For a flow with a free surface, the entry is `at_rest`, which
    is true if the concrete came to rest.
    """
    method: ClassVar[str] = "mps"
    """Name of the simulation method, as the run's result states it."""
    columns: ClassVar[Mapping[str, str]]
    """Units of the columns of the time series, by the name of the column."""
    drawn_by: ClassVar[type[Display]]
    """Class of the display, which tells recorders what to draw: particles, walls, colours and curves."""
    cure: ClassVar[str] = "a smaller 'time_step'"
    """Advice in the error message for the user if a value of the time series is not finite."""

    def set_up(self) -> None:
        """Start with an empty time series; `prepare` places the particles later, because they take much memory."""
        self._rows: list[dict[str, float]] = []
        self.steady = False
        """True once the flow has become steady or, with a free surface, come to rest."""

    def unit(self, column: str) -> str:
        return self.columns[column]

    def display(self, colouring: str | None = None) -> Display:
        """Return the display of the flow, with the quantity `colouring` as colours."""
        return self.drawn_by(self, colouring)

    @abstractmethod
    def place_flow(self) -> Any:
        """Place the particles and return the flow in its initial state."""

    @abstractmethod
    def measured(self) -> dict[str, float]:
        """Measure the flow and return the values of one row of the time series, by column name."""

    @abstractmethod
    def sizes(self) -> Record:
        """Return sizes of the model, such as the particle spacing, for the run's result."""

    @abstractmethod
    def outcome(self, series: dict[str, np.ndarray]) -> tuple[Record, dict[str, Table]]:
        """Return entries and tables for the run's result, computed from a time series with at least two rows."""

    @property
    def prepared(self) -> bool:
        """True after the particles have been placed."""
        return hasattr(self, "flow")

    @property
    def rows(self) -> list[dict[str, float]]:
        """Rows of the time series recorded so far."""
        return self._rows

    @property
    def state(self) -> Any:
        """State of the flow, which includes its particles."""
        return self.flow.state

    @property
    def may_end_early(self) -> bool:
        """True if the flow ends once it is steady or at rest, which may be long before its longest duration."""
        return True

    def prepare(self) -> None:
        """Place the particles at their initial positions."""
        started = run_clock()
        self.tell("packing", 0.0)
        self.flow = self.stepper = self.place_flow()
        self.tell("packing", 1.0)
        self.wall_times.phases["packing"] = run_clock() - started

    def watch_row(self, row: dict[str, float]) -> None:
        """Raise :class:`InstabilityError` if a value in a `row` of the time series is not finite."""
        for name, value in row.items():
            if not math.isfinite(value):
                raise InstabilityError(f"{name} is not a finite number", time=row["time"], cure=self.cure)

    def why_ended(self) -> tuple[str, str]:
        """Return why a complete run has ended: a short reason such as "steady", and a sentence."""
        if self.steady and self.may_end_early:
            return "steady", f"the flow became steady at t = {self.flow.time:.4g} s"
        return super().why_ended()

    def measure(self) -> dict[str, float]:
        """Measure the flow, append the values to the time series as a row, and return this row."""
        row = self.measured()
        self._rows.append(row)
        return row

    def state_dict(self) -> SavedState:
        """Return the state of the flow and the rows of the time series so far."""
        return {
            "flow": self.flow.state_dict(),
            "columns": list(self._rows[0]) if self._rows else [],
            "rows": np.array([list(row.values()) for row in self._rows]),
        }

    def load_state_dict(self, state: SavedState) -> None:
        """Restore a run from a `state_dict`; this replaces the call of `prepare`."""
        spent = dict(self.wall_times.phases)
        self.prepare()
        self.wall_times.phases = spent
        self.flow.load_state_dict(state["flow"])
        self._rows = [dict(zip(state["columns"], map(float, row))) for row in state["rows"]]

    def release(self) -> None:
        """Release the device memory; the results of the run stay available."""
        for name in ("flow", "stepper"):  # A run that failed before its particles were placed lacks these attributes.
            self.__dict__.pop(name, None)

    def series(self) -> dict[str, np.ndarray]:
        """Return the columns of the time series recorded so far, by name; empty before the first row."""
        return {name: np.array([row[name] for row in self._rows]) for name in (self._rows[0] if self._rows else ())}

    def result(self, finished: bool) -> Run:
        """Return the results of the run so far: its time series, quantities and tables.

        `finished` is stored in the results; it is False if the run was interrupted.
        """
        scene, flow, series = self.scene, self.flow, self.series()
        # After an interruption, the host has not yet read how many of the launched steps the device has completed.
        flow.read_progress()
        result: Record = {
            "scene": scene.name,
            "method": self.method,
            "finished": finished,
            "ended": None,
            self.goal: self.steady,
            "simulated_time": quantity(flow.time, "s"),
            "steps": flow.steps,
            "particles": flow.count,
            **self.sizes(),
        }
        outcome, tables = self.outcome(series) if len(self._rows) > 1 else ({}, {})
        result |= outcome
        result["speed"] = self.speed()
        result["state_hash"] = arrays_hash(flow.state_arrays())
        result["provenance"] = provenance(self.device, self.precision, scene.seed, self.threads)
        return Run(scene, series, {name: self.unit(name) for name in series}, result, finished, tables=tables)

    def speed(self) -> Record:
        """Return wall times, step rates and memory of the run for its result."""
        flow, running = self.flow, self.wall_times.phases.get("running", 0.0)
        return {
            "wall_time": quantity(running, "s"),
            "packing_time": quantity(self.wall_times.phases.get("packing", 0.0), "s"),
            "steps_per_second": quantity(self.pace, "1/s"),
            "particle_steps_per_second": quantity(self.pace * flow.count, "1/s"),
            "memory": quantity(footprint(flow=flow)["flow"], "B"),
        }


def largest(values: np.ndarray) -> float:
    """Return the value of largest magnitude, with its sign; NaN if any value is NaN."""
    return float(values[np.argmax(np.abs(values))])
