"""The estimate of the largest stable step of a scene."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import warp as wp

from ..core.launching import Stage
from ..geometry.walls import Driven
from ..kernels.dem.stable_step import (
    begin_kernel,
    estimate_struct,
    gather_kernel,
    keep_kernel,
    reduce_kernel,
    settle_kernel,
)
from .batch import Batch
from .scene import Scene


class StableStep:
    """Estimate of the largest stable step of a scene from masses and live stiffness, bonds included.

    It sets the scene's `clock[STABLE]` and, from that and the settings in the scene's row, `clock[DT]`.
    """

    def __init__(self, batch: Batch) -> None:
        self.batch = batch
        variables = estimate_struct(batch.scalar).vars

        def zeros(name: str, shape: int | tuple[int, ...]) -> wp.array:
            return wp.zeros(shape, dtype=variables[name].type.dtype, device=batch.device)

        self._estimate = estimate_struct(batch.scalar)()
        self._estimate.sums = zeros("sums", (batch.sphere_count, 4))
        self._estimate.wall_load = zeros("wall_load", (batch.wall_count, 2))
        self._estimate.smallest = zeros("smallest", batch.count)
        self._estimate.fastest = zeros("fastest", batch.count)
        self._recorded: dict[int, list[Stage]] = {}
        self._version = -1

    def __call__(self, s: int) -> None:
        """Estimate for scene number `s`."""
        if self._version != self.batch.version:  # old launches would hold arrays that nothing else needs
            self._recorded.clear()
            self._version = self.batch.version
        if s not in self._recorded:
            self._recorded[s] = self._stages(s)
        self.batch.device_changed()
        for stage in self._recorded[s]:
            stage()
        self.batch.device_changed()

    def kernels(self) -> list[Stage]:
        """Stages with all that it launches."""
        return self._stages(0)

    def _stages(self, s: int) -> list[Stage]:
        b, f = self.batch, self.batch.features
        own = {"s": s, "estimate": self._estimate}
        gather = gather_kernel(b.scalar, f.pair_law, f.wall_law, f.half_list, f.bonds, f.subcycling)
        base = int(b.rows["spheres"][s])

        def smallest(stiff: bool) -> list[Stage]:
            return [
                b.stage(begin_kernel(b.scalar), 1, **own),
                *(
                    b.stage(gather, last - first, first=base + first, last=base + last, stiff=stiff, **own)
                    for first, last in pairwise(b.states[s].chunks)
                ),
                # Without bodies nothing bounds the step but its largest allowed size.
                b.stage(
                    reduce_kernel(b.scalar, f.pair_law, f.wall_law), b.states[s].body_count, stiff=stiff, **own
                ),
            ]  # fmt: skip

        rounds = {"subcycled": b.subcycles.arrays}
        stages = smallest(False) + [b.stage(settle_kernel(b.scalar, f.subcycling), 1, **own, **rounds)]
        if f.subcycling:
            stages = [*smallest(True), b.stage(keep_kernel(b.scalar), 1, **own, **rounds), *stages]
        return stages


def foreseen_speed(scene: Scene, horizon: float) -> float:
    """Speed that a wall will have, or that forces can give within `horizon` [m/s]."""
    gained = [float(np.linalg.norm(scene.gravity))]
    gained += [abs(w.motion.force) / w.motion.mass for w in scene.walls if isinstance(w.motion, Driven)]
    return max((wall.top_speed() for wall in scene.walls), default=0.0) + max(gained) * horizon
