"""Classes that describe a simulation, as types for the modules that the run loop imports.

These modules cannot import the simulation's class from the run loop, because the import would be circular.
"""

from typing import Any, Protocol

import warp as wp


class Stepped(Protocol):
    """Simulated state with its time, its number of completed steps, and methods that take time steps."""

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        ...

    @property
    def steps(self) -> int:
        """Number of time steps that the run has completed."""
        ...

    def advance(self, until: float, /) -> None:
        """Step the state until its time reaches `until` [s]."""

    def take(self, count: int, /) -> None:
        """Take `count` time steps of the current size."""


class SimulationOnDevice:
    """Base class of simulations, with the attributes that are used by modules which the run loop imports."""

    device: wp.Device
    """Warp device of the run."""
    threads: int
    """Number of CPU threads of the run."""
    stepper: Stepped
    """Simulated state on the device, with its simulated time, its number of steps and the methods that step it."""
    shares_cores = False
    """True if this run is one of several that share the machine, so that no CPU core is free for its recorders."""
    stop_requested = False
    """True if the run must end at its next sample, which adds a row to the time series."""
    finishing = False
    """True if all steps of the run are over, and its results are being written or have been written."""


class DrawnSimulation(Protocol):
    """Members of a simulation that its displays read, for classes that cannot import the simulation's class."""

    @property
    def scene(self) -> Any:
        """Scene of the run; its type depends on the simulation method."""
        ...

    @property
    def state(self) -> Any:
        """Arrays that the time steps change; their type depends on the simulation method."""
        ...

    @property
    def stepper(self) -> Stepped:
        """Simulated state on the device, with its simulated time and its number of steps."""
        ...

    def unit(self, column: str) -> str:
        """Return the unit of a column of the run's time series."""
        ...
