"""Estimate of the largest stable time step of a scene, and of the largest speed that a scene can reach."""

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
import warp as wp

from ...core.device.arrays import DeviceArray, Shape, declared, zeros
from ...core.device.graphs import GraphLaunch, Recordable
from ...core.device.launching import Arguments, Stage
from ...geometry.walls import Driven
from ...kernels.dem.gathering import ESTIMATE_LANES, gather_kernel
from ...kernels.dem.stable_step import begin_kernel, keep_kernel, reduce_kernel, step_kernel
from ...kernels.dem.stiffness import estimate_struct
from ..scene.scene import Scene
from .batch import Batch
from .struct_types import Estimate


class StableStep:
    """Estimate of a scene's largest stable step from its masses and the current stiffness of contacts and bonds.

    The estimate is stored in the column STABLE of the array `clock`, which has a row for each scene. The size of the
    next step, in the column DT, follows from the estimate and from the settings of the scene. An automatic step obeys
    two more limits: the energy error of an impact with little dissipation stays below about 1 %, and even the fastest
    bodies move by no more than a fraction of their radius per step.
    """

    def __init__(self, batch: Batch) -> None:
        self.batch = batch
        struct = declared(estimate_struct(batch.scalar))
        variables = struct.vars

        def new(name: str, shape: Shape) -> DeviceArray:
            return zeros(shape, dtype=variables[name].type.dtype, device=batch.device)

        self._estimate: Estimate = struct()
        self._estimate.sums = new("sums", (batch.sphere_count, 4))
        self._estimate.wall_load = new("wall_load", (batch.threads, batch.wall_count, 2))
        self._estimate.smallest = new("smallest", (batch.threads, batch.count))
        self._estimate.resolution_step = new("resolution_step", (batch.threads, batch.count))
        self._estimate.fastest = new("fastest", (batch.threads, batch.count))
        self._estimate_wanted = zeros(batch.count, dtype=wp.int32, device=batch.device)
        self._wanted_before = np.zeros(batch.count, dtype=np.int32)
        self._due = zeros(batch.count, dtype=wp.int32, device=batch.device)
        self._recorded: dict[int, Callable[[], None]] = {}
        self._version = -1
        self._precomputed: set[int] = set()

    def __call__(self, s: int) -> None:
        """Estimate the stable step of scene `s`, unless an unused result of :meth:`precompute` exists."""
        if s in self._precomputed:
            self._precomputed.discard(s)
            return
        self._estimate_for([s])

    def precompute(self, scenes: list[int]) -> None:
        """Estimate the stable steps of several scenes of a batch together, before they are needed.

        On a GPU, this takes as long as the estimate for one scene. On a CPU, the method does nothing.
        """
        if len(scenes) > 1 and self.batch.parallel:
            self._estimate_for(scenes)
            self._precomputed = set(scenes)

    def discard_precomputed(self) -> None:
        """Discard the results of :meth:`precompute` that have not been used."""
        self._precomputed.clear()

    def _estimate_for(self, scenes: list[int]) -> None:
        requested = np.zeros(self.batch.count, dtype=np.int32)
        requested[scenes] = 1
        if not np.array_equal(requested, self._wanted_before):
            self._estimate_wanted.assign(requested)
            self._wanted_before = requested
        with self.batch.changing():
            self._launch(scenes[0])()

    def by_device(self, first: Sequence[Recordable] = ()) -> GraphLaunch:
        """Return a GPU launch that estimates the stable steps of all scenes that have halted for an estimate.

        The scenes then continue without the host. The launches `first` run before the estimate.
        """
        return GraphLaunch([*first, *(stage for phase in self._phases(-1, True) for stage in phase)], self.batch.device)

    def kernels(self) -> list[Stage]:
        """Return all launches that estimate the stable step, so that their kernels can be compiled before the run."""
        return [stage for phase in self._phases(-1 if self.batch.parallel else 0, False) for stage in phase]

    def _launch(self, s: int) -> Callable[[], None]:
        # Discard recorded launches if arrays to which they refer have been replaced.
        if self._version != self.batch.version:
            self._recorded.clear()
            self._version = self.batch.version
        # A CPU estimates the stable step of one scene at a time, in chunks of its spheres; a GPU estimates the stable
        # steps of all scenes with the same launch.
        key = -1 if self.batch.parallel else s
        if key not in self._recorded:
            self._recorded[key] = self._made(self._phases(key, False))
        return self._recorded[key]

    def _made(self, phases: list[list[Stage]]) -> Callable[[], None]:
        b = self.batch
        if b.threads == 1:
            return GraphLaunch([stage for phase in phases for stage in phase], b.device)

        def phase_by_phase() -> None:
            for phase in phases:
                if len(phase) > 1:
                    b.launch_chunks(phase)
                else:
                    phase[0]()

        return phase_by_phase

    def _phases(self, which: int, by_device: bool) -> list[list[Stage]]:
        """Return the launches that estimate the stable step of scene `which`, as a list of phases.

        If `which` is -1, the launches estimate all scenes for which an estimate is due. With `by_device`, the device
        decides which scenes these are. The phases run one after the other; the launches of one phase may run in
        parallel on CPU threads.
        """
        b, f = self.batch, self.batch.features
        own: Arguments = {"due": self._due, "estimate": self._estimate}
        begin: Arguments = {"requested": self._estimate_wanted, "by_device": by_device, **own}
        lanes = ESTIMATE_LANES if b.device.is_cuda else 1
        gather = gather_kernel(b.scalar, f.pair_law, f.wall_law, f.half_list, f.bonds, f.subcycling, lanes)
        reduce = reduce_kernel(b.scalar, f.pair_law, f.wall_law, f.half_list)
        sphere, body = (int(b.rows[name][which]) for name in ("spheres", "bodies"))
        chunks, count = list(pairwise(b.states[which].chunks)), b.states[which].body_count
        if which < 0:
            sphere, body, chunks, count = 0, 0, [(0, b.sphere_count)], b.body_count
        own_bodies = [(0, count)] if b.threads == 1 else list(pairwise(b.body_chunks.tolist()))

        def smallest(stiff: bool) -> list[list[Stage]]:
            return [
                [b.stage(begin_kernel(b.scalar), b.count, **begin)],
                [
                    b.stage(gather, lanes * (last - first), begin=sphere + first, first=sphere + first,
                            last=sphere + last, part=k, stiff=stiff, **own)
                    for k, (first, last) in enumerate(chunks)
                ],
                # Compute the stable step of each body from its stiffness and mass. The smallest of these steps is the
                # stable step of the scene.
                [b.stage(reduce, last - first, begin=body + first, part=k, stiff=stiff, **own)
                 for k, (first, last) in enumerate(own_bodies)],
            ]  # fmt: skip

        rounds: Arguments = {"subcycled": b.subcycles.arrays}
        settle = b.stage(step_kernel(b.scalar, f.subcycling), b.count, by_device=by_device, **own, **rounds)
        phases = [*smallest(False), [settle]]
        if f.subcycling:
            phases = [*smallest(True), [b.stage(keep_kernel(b.scalar), b.count, **own, **rounds)], *phases]
        return [*([stage] for stage in b.sync_stages()), *phases] if by_device else phases


def expected_speed(scene: Scene, horizon: float) -> float:
    """Return an upper estimate of the speeds of walls and bodies [m/s] during the next `horizon` [s].

    The estimate is the largest prescribed speed of a wall, plus the speed that gravity or the force on a driven wall
    can add.
    """
    gained = [float(np.linalg.norm(scene.gravity))]
    gained += [abs(w.motion.force) / w.motion.mass for w in scene.walls if isinstance(w.motion, Driven)]
    return max((wall.top_speed() for wall in scene.walls), default=0.0) + max(gained) * horizon
