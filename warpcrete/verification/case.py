"""Classes of the verification: a case consists of rows, which compare computed quantities with expected values."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from ..core.device.device import find_device
from ..dem.engine.model import build_model
from ..dem.engine.state import State
from ..dem.engine.stepper import Stepper
from ..dem.scene.bodies import placed_bodies
from ..dem.scene.scene import Scene


@dataclass(frozen=True)
class Row:
    """A computed quantity and its expected value."""

    quantity: str
    ours: float
    expected: float
    tolerance: float
    """Allowed error |ours - expected| of the computed value `ours`, relative to `scale` if given, otherwise to
    |expected|.
    """
    unit: str = "1"
    scale: float | None = None
    at_least: bool = False
    """True if the expected value is a lower limit, so that larger results count as correct."""

    @property
    def error(self) -> float:
        """Return the relative error |ours - expected| of the computed value `ours`.

        The difference is divided by `scale` if it is given, otherwise by |expected|.
        """
        if self.at_least and self.ours >= self.expected:
            return 0.0
        return abs(self.ours - self.expected) / (abs(self.expected) if self.scale is None else self.scale)

    @property
    def passed(self) -> bool:
        """Return whether the error is within the tolerance; the result is False if the error is NaN."""
        return self.error <= self.tolerance


@dataclass(frozen=True)
class Case:
    """A verification case. Its function `run` computes quantities and compares each one with its expected value."""

    name: str
    source: str
    """Source of the expected values."""
    run: Callable[[str, str], list[Row]]
    """Function that takes the device and the precision as texts, runs the case, and returns its results, one row for
    each computed quantity."""
    group: str
    slow: bool = False
    curves: dict[str, Any] = field(default_factory=dict)
    """Curves for the figure; calling `run` fills them in."""


def start(scene: Scene, device: str, precision: str) -> Stepper:
    """Return a stepper for a scene in which the positions of all bodies are given and none are packed."""
    model = build_model(scene, find_device(device), precision)
    stepper = Stepper(model, State(model, placed_bodies(scene)), scene.time_step)
    stepper.choose_dt()
    return stepper
