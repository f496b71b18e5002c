"""Points of a trade: settings of the scene and what their runs came to; what is promised of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..core.units import number
from ..record.checks import failed_checks
from .fronts import Error, worst

TARGETS = (0.2, 0.1, 0.05, 0.02, 0.01)
"""Errors for which settings are sought."""
GIVEN, REFERENCE, COMBINED, CARRIED = "as given", "finest", "combined", "carried"
"""Where a point comes from, besides a knob."""


@dataclass
class Point:
    """One setting of the scene, and what its runs came to."""

    origin: str
    """A knob's name, or one of the words above."""
    levels: dict[str, int]
    """Level of each knob that is not as the scene has it."""
    parameters: dict[str, Any]
    """All that the scene function is given, without the seed."""
    results: dict[int, dict[str, Any]] = field(default_factory=dict)
    """result.json by seed (0 where there are no seeds)."""
    failures: dict[int, str] = field(default_factory=dict)
    """What ended runs for good, by seed."""
    left_out: str = ""
    """Why there is no run, as far as another try may have one."""
    errors: list[Error] = field(default_factory=list)
    converted: dict[str, tuple[float, float]] = field(default_factory=dict)
    """Quantities of another meaning here: (offset, factor), as :class:`warpcrete.core.knobs.Level` has them."""
    variant: str = ""
    """In what the scene differs from that of the trade; empty if in nothing."""
    full: dict[str, Any] = field(default_factory=dict)
    """All parameters that mean something, defaults included."""

    def values(self, quantity: str, seeds: Sequence[int]) -> list[float]:
        """A quantity of the runs with these seeds."""
        found = [number(self.results[s][quantity]) for s in seeds if self.results.get(s, {}).get(quantity) is not None]
        offset, factor = self.converted.get(quantity, (0.0, 1.0))
        return [offset + factor * (value - offset) for value in found]

    @property
    def failure(self) -> str:
        """What ended a run, that of the first seed that failed, or why there is none."""
        return self.failures[min(self.failures)] if self.failures else self.left_out

    @property
    def cost(self) -> float:
        """Median wall time of a run, packing and settling included [s]; NaN without one."""
        parts = ("packing_time", "settling_time", "wall_time")
        times = [sum(number(r["speed"][p]) for p in parts if p in r["speed"]) for r in self.results.values()]
        return float(np.median(times)) if times else math.nan

    @property
    def work(self) -> float:
        """Sphere-steps or particle-steps of a run, whatever the machine; NaN without one."""
        counts = [float(r["steps"]) * (r.get("spheres") or r["particles"]) for r in self.results.values()]
        return float(np.median(counts)) if counts else math.nan

    @property
    def memory(self) -> float:
        """What a run takes on the device at its end [B]; NaN without one."""
        taken = [number(r["speed"]["memory"]) for r in self.results.values() if "memory" in r["speed"]]
        return float(np.median(taken)) if taken else math.nan

    @property
    def worst(self) -> Error | None:
        """The largest error of the quantities."""
        return worst(self.errors)

    @property
    def suspect(self) -> list[str]:
        """Checks that a run failed."""
        return sorted({name for result in self.results.values() for name in failed_checks(result)})


@dataclass(frozen=True)
class Promise:
    """The cheapest setting found for a wanted error, and how it did with fresh seeds."""

    target: float
    point: Point | None
    found: Error | None = None
    """With seeds of its own; None where there was no time for them, or there are no seeds."""
    carried: dict[str, Error | None] = field(default_factory=dict)
    """Largest error in each variant of the scene that it was tried on, by what that is and which checks it fails; None
    where it does not run."""
    bound: float = math.inf
    """What is promised."""
