"""What a run will take before it runs: features, time step and what governs it, memory, steps, wall time."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

import warp as wp

Found = TypeVar("Found")
Probe = Callable[[Any], Mapping[str, float]]
"""Times something with a simulation that stands at t = 0; times in seconds by what they are of."""


@dataclass(frozen=True)
class Forecast:
    """Of one scene on one device; times in seconds, memory in bytes."""

    method: str
    device: str
    """In words."""
    counts: Mapping[str, int]
    """Of bodies, spheres, particles, contacts."""
    features: Mapping[str, str]
    """What is compiled in, and why; of what is left out, that it is."""
    memory: Mapping[str, float]
    """By part."""
    time_step: float
    limits: Mapping[str, float]
    """What bounds the time step, each with the largest step that it alone would leave."""
    governing: str
    """What the smallest of these steps comes from, in words."""
    steps: float
    parts: Mapping[str, float]
    """Wall time by part, recordings not among them."""
    frame: Mapping[str, float] = field(default_factory=dict)
    """Wall time of a frame of each recording, as far as that was probed."""
    duration: float = 0.0
    """Simulated time of the run [s]."""
    remarks: tuple[str, ...] = ()

    @property
    def wall_time(self) -> float:
        """Of a run without recordings."""
        return sum(self.parts.values())

    @property
    def total_memory(self) -> float:
        """Of all parts."""
        return sum(self.memory.values())


def timed(call: Callable[[], Found], device: Any) -> tuple[Found, float]:
    """What a call returns, and its wall time, device finished [s]."""
    wp.synchronize_device(device)
    begun = time.perf_counter()
    found = call()
    wp.synchronize_device(device)
    return found, time.perf_counter() - begun


def median_time(call: Callable[[], Any], device: Any, repeats: int = 3) -> float:
    """Median wall time of a call [s]; a first one, which may load kernels, is not counted."""
    call()
    return sorted(timed(call, device)[1] for _ in range(repeats))[(repeats - 1) // 2]
