"""A batch made anew of the scenes that run on, when most have ended: kernels go over all that a batch holds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ..core.device import memory_free
from ..core.footprint import footprint
from .batch import Batch
from .neighbors import NeighborLists
from .stable_step import StableStep
from .state import State

PART = 0.5
"""Of a batch's spheres, that scenes which run on have at most when it is made anew."""
PATIENCE = 20
"""Launches in which so few are left before that: what ends soon after is not worth it."""
ROOM = 0.5
"""Of the memory that is free, that the new batch may take: the old one stays until all is done, and others grow."""
SETTINGS = (
    "local_damping", "skin", "mesh_skin", "sphere_allowance", "growth_rate", "growth_end", "safety", "largest_step",
    "fixed_step", "until", "interval", "foreseen_speed", "held",
)  # fmt: skip
"""What is set of a scene's row while it runs."""


class Regrouping:
    """Looks after a batch of a GPU, launch by launch, while scenes of it end."""

    def __init__(self) -> None:
        self._few = 0

    def __call__(self, steppers: Sequence[Any]) -> None:
        """Move scenes that run on, by their steppers, to a batch of their own, if that is due."""
        batch = steppers[0].batch
        spheres = sum(stepper.state.sphere_count for stepper in steppers)
        if not batch.parallel or len(steppers) == batch.count or spheres > PART * batch.sphere_count:
            self._few = 0
            return
        self._few += 1
        if self._few <= PATIENCE:
            return
        self._few = 0
        # Scenes that have ended hold on to the batch that they were in.
        needed = footprint(stepper=steppers[0])["stepper"] * spheres / max(batch.sphere_count, 1)
        if needed < ROOM * memory_free(batch.device):
            regroup(steppers)


def regroup(steppers: Sequence[Any]) -> None:
    """Move steppers of one batch to another that holds them alone; to the bit they go on as they would have."""
    old = steppers[0].batch
    old.device_changed()
    before = [(stepper.index, stepper.state_dict()) for stepper in steppers]
    states: list[State] = [stepper.state for stepper in steppers]
    for state in states:
        state.leave()
    batch = Batch([stepper.model for stepper in steppers], states)
    batch.subcycles.abreast = old.subcycles.abreast
    lists, estimate = NeighborLists(batch), StableStep(batch)
    for s, (stepper, (index, found)) in enumerate(zip(steppers, before)):
        batch.set(s, **{name: old.rows[name][index] for name in SETTINGS})
        stepper.join(lists, estimate, s, resumed=found)
        if old.structure is not None and batch.structure is not None:
            batch.structure.take(s, old.structure, index)
