"""Protocol with the attributes and methods of a simulation that recorders use.

Recorders cannot import the class `Simulation` itself, because the module of that class imports their base class.
"""

from __future__ import annotations

from typing import Any, Protocol

from ..device.simulation_protocol import SimulationOnDevice
from ..drawing.display import Display
from .ending import Ending
from .frames import Frames
from .run import Run


class RecordedSimulation(SimulationOnDevice, Protocol):
    """Attributes and methods of a simulation that recorders use while they record its run."""

    scene: Any
    """Scene of the run; its type depends on the simulation method."""
    frames: Frames
    """Schedule that decides at which simulated times recorders record a frame."""
    precision: str
    resumes: bool
    """True if the run goes on from a checkpoint, in an existing folder."""
    ending: Ending | None
    """Reason why the run ended; None as long as the run has not ended."""
    at_end: bool
    """True if the last step has been taken, so that only recordings may still be incomplete."""

    @property
    def expected_duration(self) -> float:
        """Simulated time that the run will probably take [s]."""
        ...

    @property
    def rows(self) -> list[dict[str, float]]:
        """Rows of the time series so far; each row is a dictionary from column names to values."""
        ...

    def unit(self, column: str) -> str:
        """Return the unit of a column of the run's time series."""
        ...

    def display(self, colouring: str | None = None) -> Display:
        """Return the view of the simulation that recorders draw, with bodies coloured by the quantity `colouring`."""
        ...

    def result(self, finished: bool) -> Run:
        """Return the time series and the result quantities of the run up to now."""
        ...
