"""Sub-cycling of stiff bonds: within each time step, hydrated bonds are integrated in several shorter steps (rounds).

Sub-cycling is a form of multiple time stepping. The forces of all other contacts on the bodies stay constant during the
rounds of a step; `kernels/dem/subcycling.py` explains the method. This module manages the sub-cycled pairs and bodies,
the number of rounds, and the kernel launches.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import warp as wp

from ...core.device.arrays import DeviceArray, HostArray, Kernel, declared, zeros
from ...core.device.launching import Arguments, Stage
from ...kernels.common.types import SPAN
from ...kernels.dem.bond_parallel import HYDRATED
from ...kernels.dem.locating import locating_kernels
from ...kernels.dem.structs import subcycled_struct
from ...kernels.dem.subcycling import RELAXATION, body_kernel, pair_kernel, prediction_kernel, rounds_kernel
from .batch_protocol import SceneBatch
from .bonding import bond_kinds
from .pairs import listed_pairs
from .state import pair_bytes
from .struct_types import Subcycled

MARGIN = 1.1
"""Safety factor for the number of sub-cycling rounds.

The number of rounds is chosen once in a run. With this factor, the rounds (the shorter steps of stiff bonds) stay
stable in later time steps that are up to `MARGIN` times as long as the step for which the number was chosen.
"""
ROUND_BLOCK = 128
"""Number of threads per block of the GPU kernel that computes all sub-cycling rounds of a step."""
RESIDENT_BLOCKS = 2
"""Number of thread blocks of the sub-cycling kernel that always fit on one multiprocessor of a GPU at the same time.

Two blocks of 128 threads fit even if each thread uses the maximum number of registers.
"""
OF_BODIES = ("position", "orientation")
"""Names of the arrays with one row per sub-cycled body. Checkpoints contain these arrays, because the next step depends
on them."""
OF_ENDS = ("force", "torque")
"""Names of the arrays that have two rows for each sub-cycled pair, one row for each body of the pair. Checkpoints
contain these arrays."""
BODY_ARRAYS = (
    "body_scene", "body_number", "place", "mass", "inertia", "rounding", "velocity", "spin", "angular_momentum",
    "other_force", "other_torque", *OF_BODIES,
)  # fmt: skip
"""Names of the arrays of `Subcycled` with one row per body; most of its other arrays have one row per pair."""


def rounds_for(ratio: float) -> int:
    """Return the number of sub-cycling rounds in a time step.

    `ratio` is the time step divided by the stable step of the stiff bonds without damping. The dashpots of stiff bonds
    have a relaxation time of `RELAXATION` times the time step. With this damping, n rounds are stable if n^2 >= ratio^2
    (1 + RELAXATION n). The result is the smallest whole number n that fulfils this inequality.
    """
    damped = 0.5 * RELAXATION * ratio * ratio
    return max(1, math.ceil(damped + math.hypot(damped, ratio)))


def round_blocks(count: int, multiprocessors: int, concurrent_batches: int) -> int:
    """Return the number of GPU blocks that compute the sub-cycling rounds of one batch.

    A round computes `count` pairs or bodies. The blocks of a batch wait for each other after every round, so all of
    them must be resident on the GPU at once. If several batches (`concurrent_batches`) compute rounds at the same time,
    each of them gets an equal share of the blocks that fit on the `multiprocessors` of the GPU.
    """
    return max(1, min(-(-count // ROUND_BLOCK), RESIDENT_BLOCKS * multiprocessors // concurrent_batches))


class Subcycles:
    """Sub-cycled pairs (pairs with stiff bonds) of all scenes of a batch.

    The pairs of each scene are in the order of their spheres' permanent numbers.
    """

    arrays: Subcycled
    """Device arrays of the sub-cycled pairs and bodies, in a struct `Subcycled` of `kernels/dem/structs.py`."""

    def __init__(self, batch: SceneBatch) -> None:
        """Prepare the sub-cycling of stiff bonds for a batch; at first no pair is sub-cycled."""
        self.batch = batch
        self._by_scene: list[dict[str, np.ndarray]] = [{} for _ in range(batch.count)]
        self._rounds = np.zeros(batch.count, dtype=np.int32)
        self._concurrent_batches = 1
        self._gate = zeros(1, dtype=wp.int32, device=batch.device)
        self._join()

    @property
    def rounds(self) -> int:
        """Largest number of rounds (shorter steps of stiff bonds) per time step among all scenes of the batch."""
        return int(self._rounds.max(initial=0))

    @property
    def concurrent_batches(self) -> int:
        """Number of batches that may compute rounds (shorter steps of stiff bonds) on the same GPU at the same time."""
        return self._concurrent_batches

    @concurrent_batches.setter
    def concurrent_batches(self, count: int) -> None:
        if count != self._concurrent_batches:
            self._concurrent_batches = count
            self.batch.invalidate_graphs()

    def collect(self, s: int) -> None:
        """Select the sub-cycled pairs of scene `s`: all pairs whose bonds are currently hydrated."""
        state = self.batch.states[s]
        i, j, place = listed_pairs(state)
        held = bond_kinds(state.pairs.bond.numpy()[place]) == int(HYDRATED)
        number = state.spheres.id.numpy()
        ends = np.stack([number[i[held]], number[j[held]]])
        pairs = np.stack([ends.min(0), ends.max(0)])
        pairs = pairs[:, np.lexsort(pairs[::-1])]
        self._restore(s, {"lower": pairs[0], "higher": pairs[1]})

    def set_rounds(self, s: int, rounds: int) -> None:
        """Set the number of rounds (shorter steps) per time step for the sub-cycled pairs of scene `s`."""
        self._rounds[s] = rounds
        self.arrays.rounds.assign(self._rounds)
        self.batch.invalidate_graphs()

    def stable_step(self, s: int) -> float:
        """Return the last estimated stable step of the sub-cycled bonds alone, without safety factor [s]."""
        return float(self.arrays.stable.numpy()[s])

    def state_dict(self, s: int) -> dict[str, HostArray | int]:
        """Return the checkpoint data of the sub-cycled bonds of scene `s`; empty if the scene has no such bonds."""
        stored = self._values(s)
        return {**stored, "rounds": int(self._rounds[s])} if stored else {}

    def load_state_dict(self, s: int, stored: Mapping[str, Any]) -> None:
        """Restore the data of the sub-cycled bonds of scene `s` from a dictionary of :meth:`state_dict`."""
        if stored:
            self._rounds[s] = stored["rounds"]
            self._restore(s, {name: stored[name] for name in ("lower", "higher", *OF_BODIES, *OF_ENDS)})

    def _values(self, s: int) -> dict[str, np.ndarray]:
        """Return the checkpoint data of the sub-cycled (stiff) bonds of scene `s`, by array name.

        The data are the permanent numbers of both spheres of each bonded pair, and the arrays named in OF_BODIES and
        OF_ENDS.
        """
        if not self._by_scene[s]:
            return {}
        pairs = self._by_scene[s]
        stored = {name: pairs[name] for name in ("lower", "higher")}
        bodies, ends = sum(self._bodies[:s]), 2 * sum(self._pairs[:s])
        for name in OF_BODIES:
            stored[name] = getattr(self.arrays, name).numpy()[bodies : bodies + self._bodies[s]].copy()
        for name in OF_ENDS:
            stored[name] = getattr(self.arrays, name).numpy()[ends : ends + 2 * self._pairs[s]].copy()
        return stored

    def _restore(self, s: int, stored: dict[str, np.ndarray]) -> None:
        for other, each in enumerate(self._by_scene):
            if other != s:
                each.update(self._values(other))
        self._by_scene[s] = stored
        self._join()
        self.locate()
        self.batch.invalidate_graphs()

    def _join(self) -> None:
        """Create joint device arrays of all scenes for the pairs with sub-cycled bonds and for their bodies."""
        b = self.batch
        self._pairs = [len(each.get("lower", ())) for each in self._by_scene]
        rows = [self._rows(s) for s in range(b.count)]
        self._bodies = [len(number) for number, _, _ in rows]
        first_pair = np.concatenate([[0], np.cumsum(self._pairs)])
        ref = np.concatenate([ref + 2 * first for (_, _, ref), first in zip(rows, first_pair)])
        counts = np.concatenate([counts for _, counts, _ in rows])
        # Compute two indices for each end of a pair: the row of the end's body in the body arrays, and the row of the
        # force on this body in the force array. The force array is ordered by body, so that all forces on one body are
        # neighbours in memory. Below, the two ends of each pair are combined into one row of four indices: the rows of
        # both bodies, then the rows of both forces.
        ends = np.stack([np.repeat(np.arange(len(counts)), counts)[np.argsort(ref)], np.argsort(ref)], axis=1)
        given: dict[str, HostArray] = {
            "rounds": self._rounds,
            "stable": np.zeros(b.count),
            "member": np.zeros(b.body_count if b.features.subcycling else 0),
            "pair_scene": np.repeat(np.arange(b.count), self._pairs),
            "body_scene": np.repeat(np.arange(b.count), self._bodies),
            "body_number": np.concatenate([number for number, _, _ in rows]),
            "start": np.concatenate([[0], np.cumsum(counts)]),
            "ref": ref,
            "ends": ends.reshape(-1, 2, 2).transpose(0, 2, 1).reshape(-1, 4),
        }
        for s, (number, _, _) in enumerate(rows):
            if len(number):
                self._place_bodies(s, number)
        for name in ("lower", "higher", *OF_BODIES, *OF_ENDS):
            parts = [each[name] for each in self._by_scene if each]
            given[name] = np.concatenate(parts) if parts else np.zeros(0)
        self.pair_count, self.body_count = sum(self._pairs), sum(self._bodies)
        struct = declared(subcycled_struct(b.scalar))
        self.arrays = struct()
        for name, variable in struct.vars.items():
            if name != "held":
                dtype, count = variable.type.dtype, self.body_count if name in BODY_ARRAYS else self.pair_count
                if len(given.get(name, ())):
                    array = DeviceArray(np.ascontiguousarray(given[name]), dtype=dtype, device=b.device)
                else:
                    array = zeros(0 if name in given else count, dtype=dtype, device=b.device)
                setattr(self.arrays, name, array)
        for name in {*pair_bytes(b.models[0]), "load"}:
            dtype = getattr(b.pairs, name).dtype
            setattr(self.arrays.held, name, zeros(self.pair_count, dtype=dtype, device=b.device))
        self._sphere_place = zeros(b.sphere_count if self.pair_count else 0, dtype=wp.int32, device=b.device)
        self._body_place = zeros(b.body_count if self.pair_count else 0, dtype=wp.int32, device=b.device)

    def _rows(self, s: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the bodies of scene `s` that have stiff bonds, and the ends of these bonds on each body.

        Each sub-cycled pair k has two ends: 2k is the sphere with the lower permanent number, and 2k + 1 is the other
        sphere. The first array contains the permanent numbers of the bodies, in ascending order. The second array
        contains the number of ends on each body. The third array lists the ends of the first body, then the ends of the
        second body, and so on.
        """
        pairs = self._by_scene[s]
        if not pairs:
            return np.zeros(0, dtype=int), np.zeros(0, dtype=int), np.zeros(0, dtype=int)
        state = self.batch.states[s]
        body_of = np.empty(state.sphere_count, dtype=int)
        body_of[state.spheres.id.numpy()] = state.bodies.id.numpy()[state.spheres.body.numpy()]
        # For each pair, `ends` contains two permanent numbers of bodies: the body of the pair's first sphere and the
        # body of its second sphere.
        ends = body_of[np.stack([pairs["lower"], pairs["higher"]], axis=1).ravel()]
        number, counts = np.unique(ends, return_counts=True)
        return number, counts, np.argsort(ends, kind="stable")

    def _place_bodies(self, s: int, number: np.ndarray) -> None:
        """Prepare the data of newly sub-cycled (stiff) bonds.

        Copy the positions and orientations of their bodies from the state, and set the forces of the bonds to 0.
        `number` contains the permanent numbers of the bodies.
        """
        bodies, stored = self.batch.states[s].bodies, self._by_scene[s]
        where = np.argsort(bodies.id.numpy())[number]
        for name in OF_BODIES:
            stored.setdefault(name, getattr(bodies, name).numpy()[where])
        for name in OF_ENDS:
            stored.setdefault(name, np.zeros((2 * self._pairs[s], 3)))

    def locate(self) -> None:
        """Find the pairs with sub-cycled bonds in rebuilt neighbour lists, and the indices of their bodies."""
        for stage in self.locating():
            stage()

    def locating(self) -> list[Stage]:
        """Return launches that find the sub-cycled pairs in rebuilt neighbour lists, and the indices of their bodies.

        Sub-cycled pairs are pairs with stiff bonds. The result is empty if there are none.
        """
        return self._locating() if self.pair_count else []

    def _locating(self) -> list[Stage]:
        b = self.batch
        kernels = locating_kernels(b.scalar, b.features.half_list, b.features.history)
        own: Arguments = {"subcycled": self.arrays, "sphere_place": self._sphere_place, "body_place": self._body_place}

        def stage(kernel: Kernel, dim: int, *names: str) -> Stage:
            return b.stage(kernel, dim, **{name: own[name] for name in names})

        return [
            stage(kernels.index_spheres, b.sphere_count, "sphere_place"),
            stage(kernels.index_bodies, b.body_count, "body_place", "subcycled"),
            stage(kernels.locate_bodies, self.body_count, "body_place", "subcycled"),
            stage(kernels.locate_pairs, self.pair_count, "sphere_place", "subcycled"),
        ]

    def kernels(self) -> list[Stage]:
        """Return launches of all kernels that sub-cycle stiff bonds, for compiling the kernels before the run."""
        if not self.batch.features.subcycling:
            return []
        rounds = self._round(0, 0) if self.batch.features.half_list else [self._all_rounds()]
        return [*self._locating(), *rounds, self._prediction_stage(0)]

    def stages(self, part: int) -> list[Stage]:
        """Return the launches that compute all sub-cycling rounds of a step, on CPU thread `part` or on a GPU.

        A round is one of several shorter steps with which stiff bonds are integrated within a time step.
        """
        if not self.batch.features.half_list:
            return [self._all_rounds(), self._prediction_stage(part)]
        meet = self.batch.barrier()
        rounds = [stage for turn in range(self.rounds) for stage in self._round(part, turn)]
        return [each for stage in (*rounds, self._prediction_stage(part)) for each in (stage, *meet)]

    def _all_rounds(self) -> Stage:
        """Return the single GPU launch that computes all sub-cycling rounds (shorter steps of stiff bonds) of a step.

        All blocks of the launch must be resident at once, because they wait for each other after every round.
        """
        b, f = self.batch, self.batch.features
        count = max(self.pair_count, self.body_count)
        multiprocessors = int(b.device.sm_count)  # pyright: ignore[reportUnknownMemberType, reportUnknownArgumentType]
        blocks = round_blocks(count, multiprocessors, self.concurrent_batches) if b.device.is_cuda else 1
        threads = blocks * (ROUND_BLOCK if b.device.is_cuda else 1)
        kernel = rounds_kernel(b.scalar, f.pair_law, f.history, f.healing, f.dissipation)
        return b.stage(
            kernel, threads if count else 0, block=ROUND_BLOCK, threads=threads, parties=blocks,
            body_count=self.body_count, pair_count=self.pair_count, subcycled=self.arrays, gate=self._gate,
        )  # fmt: skip

    def _round(self, part: int, turn: int) -> list[Stage]:
        b, f = self.batch, self.batch.features
        pairs = pair_kernel(b.scalar, f.pair_law, f.history, f.healing, f.dissipation)
        return [
            self._stage(body_kernel(b.scalar), part, self.body_count, turn=turn),
            self._stage(pairs, part, self.pair_count, turn=turn),
        ]

    def _prediction_stage(self, part: int) -> Stage:
        b, f = self.batch, self.batch.features
        return self._stage(prediction_kernel(b.scalar, f.meshes, f.half_list, f.dissipation), part, self.body_count)

    def _stage(self, kernel: Kernel, part: int, count: int, **named: Any) -> Stage:
        """Return a launch of `kernel` for CPU thread `part`, which computes its share of `count` pairs or bodies."""
        b = self.batch
        first, last = count * part // b.threads, count * (part + 1) // b.threads
        tasks = -(-(last - first) // SPAN) if b.features.half_list else last - first
        return b.stage(kernel, tasks, first=first, last=last, subcycled=self.arrays, **named)
