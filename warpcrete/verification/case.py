"""Classes of the verification: a case consists of rows, which compare computed quantities with expected values."""

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
    """Allowed value of :attr:`error`, the relative error of the computed value `ours`."""
    unit: str = "1"
    scale: float | None = None
    at_least: bool = False
    """True if the expected value is a lower limit, so that larger results count as correct."""

    @property
    def error(self) -> float:
        """Return the relative error of the computed value `ours`, which is |ours - expected| divided by |expected|.

        If `scale` is given, the divisor is `scale` instead. The error is 0 if the expected value is a lower limit
        (`at_least`) that the computed value reaches.
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
    """Source of the expected values, such as a publication or a formula."""
    run: Callable[[str, str], list[Row]]
    """Function that takes the device and the precision as texts, runs the case, and returns its results, one row for
    each computed quantity."""
    group: str
    slow: bool = False
    curves: dict[str, Any] = field(default_factory=dict)
    """Data of the curves that the figure shows for this case; empty until `run` has stored them."""


def start(scene: Scene, device: str, precision: str) -> Stepper:
    """Return a stepper that advances a scene in time. The scene must state the positions of all its bodies."""
    model = build_model(scene, find_device(device), precision)
    stepper = Stepper(model, State(model, placed_bodies(scene)), scene.time_step)
    stepper.choose_dt()
    return stepper
