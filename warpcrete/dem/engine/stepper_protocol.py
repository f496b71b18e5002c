"""Protocol of a stepper for modules that cannot import its class, such as `scheduling`, which `stepper` imports."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, TypedDict

import numpy as np

from ...core.device.arrays import HostArray
from ...core.run.run_loop import Coroutine, Until
from .batch import Batch
from .model import Model
from .neighbors import NeighborLists
from .stable_step import StableStep
from .state import State


@dataclass(frozen=True)
class Steps:
    """Goal that a coroutine may yield instead of a time: a number of further steps of the current size."""

    count: int


class StepperRecord(TypedDict):
    """Data that a stepper needs, in addition to the state, to continue in the same way."""

    skin: float
    """Skin of the neighbour lists [m]."""
    since_estimate: float
    """Number of steps since the last estimate of the stable step; infinite if a new estimate is required."""
    subcycles: Mapping[str, HostArray | int]
    """Data of the sub-cycling, see :meth:`.Subcycles.state_dict`."""


class SceneStepper(Protocol):
    """Protocol of a stepper, which advances one scene of a batch to goals."""

    model: Model
    state: State
    batch: Batch
    lists: NeighborLists
    stable_step: StableStep
    index: int
    """Index of the scene in its batch."""

    def reaching(self, goal: Until | Steps) -> Coroutine:
        """Return a coroutine that advances to a goal and yields while the batch must step."""
        ...

    def wants_estimate(self) -> bool:
        """Return whether the stable step must be estimated before the scene takes more steps."""
        ...

    def failure(self, flags: np.ndarray) -> Exception | None:
        """Return the exception to raise if the control `flags` say that the scene has failed; otherwise None."""
        ...

    def reached(self, flags: np.ndarray) -> bool:
        """Return whether by its control `flags` the scene has halted at its goal or to estimate its stable step."""
        ...

    def join(
        self, lists: NeighborLists, stable_step: StableStep, index: int, *, resumed: StepperRecord | None = None
    ) -> None:
        """Become scene `index` of the batch to which `lists` belongs; continue from a `state_dict` if one is given."""

    def state_dict(self) -> StepperRecord:
        """Return everything that a stepper needs, in addition to the state, to continue identically."""
        ...
