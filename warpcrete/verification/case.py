"""What a case of the verification is: rows of numbers, ours beside the expected ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from ..core.device import find_device
from ..dem.bodies import placed_bodies
from ..dem.model import build_model
from ..dem.scene import Scene
from ..dem.state import State
from ..dem.stepper import Stepper


@dataclass(frozen=True)
class Row:
    """One quantity: ours beside the expected one."""

    quantity: str
    ours: float
    expected: float
    tolerance: float
    """Allowed |ours - expected|, relative to |expected| or, with `scale`, to that."""
    unit: str = "1"
    scale: float | None = None
    at_least: bool = False
    """Only less than expected is an error."""

    @property
    def error(self) -> float:
        """|ours - expected| over |expected| or `scale`."""
        if self.at_least and self.ours >= self.expected:
            return 0.0
        return abs(self.ours - self.expected) / (abs(self.expected) if self.scale is None else self.scale)

    @property
    def passed(self) -> bool:
        """Whether the error is within the tolerance; NaN is not."""
        return self.error <= self.tolerance


@dataclass(frozen=True)
class Case:
    """A named set of rows."""

    name: str
    source: str
    """Where the expected answer comes from."""
    run: Callable[[str, str], list[Row]]
    """(device, precision) -> rows."""
    group: str
    slow: bool = False
    curves: dict[str, Any] = field(default_factory=dict)
    """What the figure draws, filled by `run`."""


def start(scene: Scene, device: str, precision: str) -> Stepper:
    """A stepper for a scene whose bodies are placed one by one."""
    model = build_model(scene, find_device(device), precision)
    stepper = Stepper(model, State(model, placed_bodies(scene)), scene.time_step)
    stepper.choose_dt()
    return stepper
