"""Regrouping: once most scenes of a batch have ended, move the running scenes to a smaller batch.

Every kernel visits all scenes of a batch, so ended scenes still cost time.
"""

from collections.abc import Sequence

from ...core.device.device import memory_free
from .batch import Batch
from .memory import memory_of_batch
from .neighbors import NeighborLists
from .stable_step import StableStep
from .state import State
from .stepper_protocol import SceneStepper

LARGEST_SHARE = 0.5
"""Largest fraction of a batch's spheres that belong to running scenes when these scenes move to a smaller batch."""
LAUNCHES_BEFORE_REGROUPING = 20
"""Number of successive launches after which the running scenes move to a smaller batch.

In all these launches, at most the fraction `LARGEST_SHARE` of the batch's spheres must belong to running scenes. The
delay is useful because the move costs more than it saves if the running scenes end soon.
"""
MEMORY_SHARE = 0.5
"""Fraction of the free device memory that the new, smaller batch may use.

The rest is a reserve, because other batches may grow.
"""
SETTINGS = (
    "local_damping", "skin", "mesh_skin", "sphere_allowance", "growth_rate", "growth_end", "safety", "largest_step",
    "fixed_step", "until", "interval", "expected_speed", "held",
)  # fmt: skip
"""Names of the scene parameters that may change during a run and are therefore copied to the new batch."""


class Regrouping:
    """Rule that decides before each launch of steps whether a GPU batch moves its running scenes to a smaller batch."""

    def __init__(self) -> None:
        self._few = 0

    def __call__(self, steppers: Sequence[SceneStepper]) -> None:
        """Move the running scenes, which `steppers` advance, to a new batch if this is worthwhile.

        The running scenes must contain only a small part of the batch's spheres, and the new batch must fit into the
        free memory.
        """
        batch = steppers[0].batch
        spheres = sum(stepper.state.sphere_count for stepper in steppers)
        if not batch.parallel or len(steppers) == batch.count or spheres > LARGEST_SHARE * batch.sphere_count:
            self._few = 0
            return
        self._few += 1
        if self._few <= LAUNCHES_BEFORE_REGROUPING:
            return
        self._few = 0
        # The old batch stays in memory, because ended scenes refer to it. The new batch must fit into the free memory.
        needed = memory_of_batch(steppers[0]) * spheres / max(batch.sphere_count, 1)
        if needed < MEMORY_SHARE * memory_free(batch.device):
            regroup(steppers)


def regroup(steppers: Sequence[SceneStepper]) -> None:
    """Move the scenes of `steppers` from their common batch to a new batch; results stay bitwise identical."""
    old = steppers[0].batch
    old.flush()
    before = [(stepper.index, stepper.state_dict()) for stepper in steppers]
    states: list[State] = [stepper.state for stepper in steppers]
    for state in states:
        state.detach()
    batch = Batch([stepper.model for stepper in steppers], states)
    batch.subcycles.concurrent_batches = old.subcycles.concurrent_batches
    lists, estimate = NeighborLists(batch), StableStep(batch)
    for s, (stepper, (index, found)) in enumerate(zip(steppers, before)):
        batch.set(s, **{name: old.rows[name][index] for name in SETTINGS})
        stepper.join(lists, estimate, s, resumed=found)
        if old.structure is not None and batch.structure is not None:
            batch.structure.take(s, old.structure, index)
