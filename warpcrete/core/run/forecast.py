"""Forecast of a run before it starts: kernel features, time step and its limits, memory, number of steps, wall time."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

import warp as wp

Found = TypeVar("Found")
Probe = Callable[[Any], Mapping[str, float]]
"""Function that times operations of a prepared simulation at t = 0. It returns wall times [s] by the name of the
operation."""


@dataclass(frozen=True)
class Forecast:
    """Expected time and memory for the simulation of one scene on one device."""

    method: str
    device: str
    """Text that describes the device for which the run is forecast."""
    counts: Mapping[str, int]
    """Numbers of bodies, spheres, particles and contacts, by name."""
    features: Mapping[str, str]
    """Optional features of the kernels by name: whether each one is compiled in, and why."""
    memory: Mapping[str, float]
    """Device memory of each part of the simulation [B], by the name of the part."""
    time_step: float
    """Expected size of the time steps [s]."""
    limits: Mapping[str, float]
    """Largest time step that each effect would allow if it were the only limit [s], by the name of the effect."""
    governing: str
    """Text that states why the time step is not longer: the name of the physical effect that limits it, or the
    parameter with which the user chose it."""
    steps: float
    parts: Mapping[str, float]
    """Expected wall time of each part of the run's work [s], by the name of the part; recordings are not included."""
    frame: Mapping[str, float] = field(default_factory=dict[str, float])
    """Wall time that each recording takes for one frame [s], by the recording's name; empty if not measured."""
    duration: float = 0.0
    """Simulated time that the run is expected to cover [s]."""
    remarks: tuple[str, ...] = ()

    @property
    def wall_time(self) -> float:
        """Expected wall time of the run [s]; the time to write recordings is not included."""
        return sum(self.parts.values())

    @property
    def total_memory(self) -> float:
        """Device memory of all parts together [B]."""
        return sum(self.memory.values())


def timed(call: Callable[[], Found], device: wp.Device) -> tuple[Found, float]:
    """Return the result of a call and its wall time [s], including the device work that it launched."""
    wp.synchronize_device(device)
    begun = time.perf_counter()
    found = call()
    wp.synchronize_device(device)
    return found, time.perf_counter() - begun


def median_time(call: Callable[[], object], device: wp.Device, repeats: int = 3) -> float:
    """Return the median wall time of `repeats` calls [s]; a first call, which may load kernels, is not counted."""
    call()
    return sorted(timed(call, device)[1] for _ in range(repeats))[(repeats - 1) // 2]
