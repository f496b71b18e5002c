"""Protocol of a stepper, for modules such as `scheduling` that `stepper` imports and that cannot import `stepper`."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, TypedDict

import numpy as np

from ...core.device.arrays import HostArray
from ...core.run.coroutines import Coroutine, Until
from .batch import Batch
from .model import Model
from .neighbors import NeighborLists
from .stable_step import StableStep
from .state import State


@dataclass(frozen=True)
class Steps:
    """Goal of a scene's coroutine: `count` more time steps of the current size. The alternative is a goal in time."""

    count: int


class StepperRecord(TypedDict):
    """Data in a checkpoint that a stepper needs, in addition to the state, to continue with identical results."""

    skin: float
    """Skin of the neighbour lists, which is the largest gap of a listed pair of spheres [m]."""
    since_estimate: float
    """Number of steps since the last estimate of the stable step; infinite if a new estimate is required."""
    subcycles: Mapping[str, HostArray | int]
    """Data of the sub-cycled (stiff) bonds, from :meth:`.Subcycles.state_dict`; empty if no bond is sub-cycled."""


class SceneStepper(Protocol):
    """Protocol of a stepper, which advances one scene of a batch until the scene reaches a goal."""

    model: Model
    state: State
    batch: Batch
    lists: NeighborLists
    stable_step: StableStep
    index: int
    """Index of the scene in its batch."""

    def reaching(self, goal: Until | Steps) -> Coroutine:
        """Return a coroutine that advances the scene to a goal and yields whenever the batch must step."""
        ...

    def wants_estimate(self) -> bool:
        """Return whether the goal of the scene is a number of steps and an estimate of the stable time step is due.

        All steps to such a goal have the same length, so no estimate interrupts them. An estimate can therefore be
        overdue when the scene reaches its goal.
        """
        ...

    def failure(self, flags: np.ndarray) -> Exception | None:
        """Return the exception to raise if the control flags `flags` of the scene report a failure; otherwise None."""
        ...

    def reached(self, flags: np.ndarray) -> bool:
        """Return whether the scene has halted because it has reached its goal or needs an estimate of its stable step.

        In both cases the coroutine from `reaching` must be resumed: it makes the estimate if one is due, and ends if
        the goal is reached. `flags` contains the control flags of the scene.
        """
        ...

    def join(
        self, lists: NeighborLists, stable_step: StableStep, index: int, *, resumed: StepperRecord | None = None
    ) -> None:
        """Make the stepper advance the scene with the index `index` of an existing batch.

        `lists` and `stable_step` belong to this batch. `resumed` is the `state_dict` of an earlier stepper, whose work
        this stepper continues, or None.
        """

    def state_dict(self) -> StepperRecord:
        """Return the data that a stepper needs, in addition to the state, to continue with identical results."""
        ...
