"""Simulation as modules below the run loop see it; they cannot name its class, because the run loop imports them."""

from __future__ import annotations

from typing import Protocol

import warp as wp


class Clocked(Protocol):
    """Simulated state with a clock: its simulated time and the number of completed steps."""

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        ...

    @property
    def steps(self) -> int:
        """Number of completed steps."""
        ...


class Stepped(Clocked, Protocol):
    """Simulated state with a clock and with methods that take time steps."""

    def advance(self, until: float, /) -> None:
        """Step the state until its time reaches `until` [s]."""

    def take(self, count: int, /) -> None:
        """Take `count` steps of the current size."""


class SimulationOnDevice(Protocol):
    """Simulation with its device, its threads and the state of its run."""

    stop_requested: bool
    """True if the run must end at its next sample."""

    finishing: bool
    """True if the run writes its results."""
    device: wp.Device
    """Warp device of the run."""
    threads: int
    """Number of CPU threads of the run."""
    shares_cores: bool
    """True if other runs use the cores that the threads of this run leave free."""

    @property
    def stepper(self) -> Clocked:
        """Clock of the state."""
        ...
