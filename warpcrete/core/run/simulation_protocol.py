"""Simulation as its recorders see it; they cannot name its class, because the run loop imports them."""

from __future__ import annotations

from typing import Any, Protocol

from ..device.simulation_protocol import SimulationOnDevice
from ..drawing.display import Display
from .frames import Frames
from .run import Run


class RecordedSimulation(SimulationOnDevice, Protocol):
    """Simulation whose run is recorded."""

    scene: Any
    """Scene of the run; its type depends on the method."""
    frames: Frames
    """Schedule of frames."""
    precision: str
    resumes: bool
    """True if the run goes on from a checkpoint, in an existing folder."""
    at_end: bool
    """True if the last step has been taken, so that only recordings may still be incomplete."""

    @property
    def expected_duration(self) -> float:
        """Simulated time that the run will probably take [s]."""
        ...

    @property
    def rows(self) -> list[dict[str, float]]:
        """Rows of the series so far, each with a value by column name."""
        ...

    def unit(self, column: str) -> str:
        """Return the unit of a column of the series."""
        ...

    def display(self, colouring: str | None = None) -> Display:
        """Return the view of the simulation that recorders draw, with bodies coloured by the quantity `colouring`."""
        ...

    def result(self, finished: bool) -> Run:
        """Return the time series and the result quantities of the run up to now."""
        ...
