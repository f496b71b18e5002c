"""Stiff bonds in rounds of their own within a step: which pairs and bodies, how many rounds, and their stages."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import warp as wp

from ..core.launching import Stage
from ..kernels.common.types import SPAN
from ..kernels.dem.bond_parallel import HYDRATED
from ..kernels.dem.locating import locating_kernels
from ..kernels.dem.structs import subcycled_struct
from ..kernels.dem.subcycling import RELAXATION, body_kernel, foreseeing_kernel, pair_kernel, rounds_kernel
from .bonding import bond_kinds
from .probes import listed_pairs
from .state import pair_bytes

MARGIN = 1.1
"""Over the step at the start: so far it may grow before rounds bound it."""
ROUND_BLOCK = 128
"""Threads of a GPU's block that takes all rounds of a step."""
RESIDENT = 2
"""Such blocks that a multiprocessor has room for, whatever registers they take."""
OF_BODIES = ("position", "orientation")
"""Arrays of the bodies that the next step depends on, beside those of the state."""
OF_ENDS = ("force", "torque")
"""Likewise of the ends of pairs."""
BODY_ARRAYS = (
    "body_scene", "body_number", "place", "mass", "inertia", "rounding", "velocity", "spin", "angular_momentum",
    "other_force", "other_torque", *OF_BODIES,
)  # fmt: skip
"""Arrays with a row for each body that has such pairs; `OF_ENDS` have two for each pair, most others one."""


def rounds_for(ratio: float) -> int:
    """Rounds of a step that is so many times what stiff bonds alone, without their dashpots, can stand."""
    damped = 0.5 * RELAXATION * ratio * ratio
    return max(1, math.ceil(damped + math.hypot(damped, ratio)))


def round_blocks(count: int, multiprocessors: int, abreast: int) -> int:
    """Blocks that take the rounds of so many pairs or bodies: all of as many batches have room at once."""
    return max(1, min(-(-count // ROUND_BLOCK), RESIDENT * multiprocessors // abreast))


class Subcycles:
    """Pairs of a batch that are stepped in rounds, in the order of their spheres' permanent numbers."""

    arrays: Any
    """A struct `Subcycled`."""

    def __init__(self, batch: Any) -> None:
        """`batch` is the :class:`Batch` that has this."""
        self.batch = batch
        self._of_scene: list[dict[str, np.ndarray]] = [{} for _ in range(batch.count)]
        self._rounds = np.zeros(batch.count, dtype=np.int32)
        self._abreast = 1
        self._gate = wp.zeros(1, dtype=wp.int32, device=batch.device)
        self._join()

    @property
    def rounds(self) -> int:
        """Rounds of the scene that has most."""
        return int(self._rounds.max(initial=0))

    @property
    def abreast(self) -> int:
        """Batches whose rounds a GPU may have at the same time."""
        return self._abreast

    @abreast.setter
    def abreast(self, count: int) -> None:
        if count != self._abreast:
            self._abreast = count
            self.batch.invalidate_graphs()

    def collect(self, s: int) -> None:
        """Take the hydrated bonds that scene `s` has now; no other scene changes."""
        state = self.batch.states[s]
        i, j, place = listed_pairs(state)
        held = bond_kinds(state.pairs.bond.numpy()[place]) == int(HYDRATED)
        number = state.spheres.id.numpy()
        ends = np.stack([number[i[held]], number[j[held]]])
        pairs = np.stack([ends.min(0), ends.max(0)])
        pairs = pairs[:, np.lexsort(pairs[::-1])]
        self._take(s, {"lower": pairs[0], "higher": pairs[1]})

    def set_rounds(self, s: int, rounds: int) -> None:
        """Step the pairs of scene `s` in so many rounds."""
        self._rounds[s] = rounds
        self.arrays.rounds.assign(self._rounds)
        self.batch.invalidate_graphs()

    def stable_step(self, s: int) -> float:
        """Of these pairs alone, as last estimated, without safety factor [s]."""
        return float(self.arrays.stable.numpy()[s])

    # Checkpoints.

    def state_dict(self, s: int) -> dict[str, Any]:
        """What the next step of scene `s` depends on; empty without such pairs."""
        found = self._values(s)
        return {**found, "rounds": int(self._rounds[s])} if found else {}

    def load_state_dict(self, s: int, found: dict[str, Any]) -> None:
        """Go on from a `state_dict`."""
        if found:
            self._rounds[s] = found["rounds"]
            self._take(s, {name: found[name] for name in ("lower", "higher", *OF_BODIES, *OF_ENDS)})

    def _values(self, s: int) -> dict[str, np.ndarray]:
        """Values on the device of the pairs of a scene, and of its bodies that have some."""
        if not self._of_scene[s]:
            return {}
        pairs = self._of_scene[s]
        found = {name: pairs[name] for name in ("lower", "higher")}
        bodies, ends = sum(self._bodies[:s]), 2 * sum(self._pairs[:s])
        for name in OF_BODIES:
            found[name] = getattr(self.arrays, name).numpy()[bodies : bodies + self._bodies[s]].copy()
        for name in OF_ENDS:
            found[name] = getattr(self.arrays, name).numpy()[ends : ends + 2 * self._pairs[s]].copy()
        return found

    def _take(self, s: int, found: dict[str, np.ndarray]) -> None:
        for other, each in enumerate(self._of_scene):
            if other != s:
                each.update(self._values(other))
        self._of_scene[s] = found
        self._join()
        self.locate()
        self.batch.invalidate_graphs()

    # Arrays.

    def _join(self) -> None:
        """Arrays of all scenes, one after the other."""
        b = self.batch
        self._pairs = [len(each.get("lower", ())) for each in self._of_scene]
        rows = [self._rows(s) for s in range(b.count)]
        self._bodies = [len(number) for number, _, _ in rows]
        first_pair = np.concatenate([[0], np.cumsum(self._pairs)])
        ref = np.concatenate([ref + 2 * first for (_, _, ref), first in zip(rows, first_pair)])
        counts = np.concatenate([counts for _, counts, _ in rows])
        # Of both ends of each pair: the row of the body, and the row among all ends, body by body.
        ends = np.stack([np.repeat(np.arange(len(counts)), counts)[np.argsort(ref)], np.argsort(ref)], axis=1)
        given: dict[str, Any] = {
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
            parts = [each[name] for each in self._of_scene if each]
            given[name] = np.concatenate(parts) if parts else np.zeros(0)
        self.pair_count, self.body_count = sum(self._pairs), sum(self._bodies)
        self.arrays = subcycled_struct(b.scalar)()
        for name, variable in subcycled_struct(b.scalar).vars.items():
            if name != "held":
                dtype, count = variable.type.dtype, self.body_count if name in BODY_ARRAYS else self.pair_count
                if len(given.get(name, ())):
                    array = wp.array(np.ascontiguousarray(given[name]), dtype=dtype, device=b.device)
                else:
                    array = wp.zeros(0 if name in given else count, dtype=dtype, device=b.device)
                setattr(self.arrays, name, array)
        for name in {*pair_bytes(b.models[0]), "load"}:
            dtype = getattr(b.pairs, name).dtype
            setattr(self.arrays.held, name, wp.zeros(self.pair_count, dtype=dtype, device=b.device))
        self._sphere_place = wp.zeros(b.sphere_count if self.pair_count else 0, dtype=wp.int32, device=b.device)
        self._body_place = wp.zeros(b.body_count if self.pair_count else 0, dtype=wp.int32, device=b.device)

    def _rows(self, s: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Permanent numbers of a scene's bodies with such pairs, how many each has, and which."""
        pairs = self._of_scene[s]
        if not pairs:
            return np.zeros(0, dtype=int), np.zeros(0, dtype=int), np.zeros(0, dtype=int)
        state = self.batch.states[s]
        body_of = np.empty(state.sphere_count, dtype=int)
        body_of[state.spheres.id.numpy()] = state.bodies.id.numpy()[state.spheres.body.numpy()]
        ends = body_of[np.stack([pairs["lower"], pairs["higher"]], axis=1).ravel()]  # pair by pair, as `ref` counts
        number, counts = np.unique(ends, return_counts=True)
        return number, counts, np.argsort(ends, kind="stable")

    def _place_bodies(self, s: int, number: np.ndarray) -> None:
        """Where bodies that have just come to have such pairs are; no force yet."""
        bodies, found = self.batch.states[s].bodies, self._of_scene[s]
        where = np.argsort(bodies.id.numpy())[number]
        for name in OF_BODIES:
            found.setdefault(name, getattr(bodies, name).numpy()[where])
        for name in OF_ENDS:
            found.setdefault(name, np.zeros((2 * self._pairs[s], 3)))

    # Launches.

    def locate(self) -> None:
        """Find everything again, after a rebuild of the lists."""
        for stage in self.locating():
            stage()

    def locating(self) -> list[Stage]:
        """What does that; nothing where no pair is stepped in rounds."""
        return self._locating() if self.pair_count else []

    def _locating(self) -> list[Stage]:
        b = self.batch
        kernels = locating_kernels(b.scalar, b.features.half_list, b.features.history)
        own = {"subcycled": self.arrays, "sphere_place": self._sphere_place, "body_place": self._body_place}

        def stage(kernel: Any, dim: int, *names: str) -> Stage:
            return b.stage(kernel, dim, **{name: own[name] for name in names})

        return [
            stage(kernels.note_spheres, b.sphere_count, "sphere_place"),
            stage(kernels.note_bodies, b.body_count, "body_place", "subcycled"),
            stage(kernels.locate_bodies, self.body_count, "body_place", "subcycled"),
            stage(kernels.locate_pairs, self.pair_count, "sphere_place", "subcycled"),
        ]

    def kernels(self) -> list[Any]:
        """Stages with all that it launches."""
        if not self.batch.features.subcycling:
            return []
        rounds = self._round(0, 0) if self.batch.features.half_list else [self._all_rounds()]
        return [*self._locating(), *rounds, self._foreseeing(0)]

    def stages(self, part: int) -> list[Any]:
        """Rounds of a step, a thread's part of them."""
        if not self.batch.features.half_list:
            return [self._all_rounds(), self._foreseeing(part)]
        meet = self.batch.barrier()
        rounds = [stage for turn in range(self.rounds) for stage in self._round(part, turn)]
        return [each for stage in (*rounds, self._foreseeing(part)) for each in (stage, *meet)]

    def _all_rounds(self) -> Stage:
        """Those of a GPU, whose blocks must all have room at once."""
        b, f = self.batch, self.batch.features
        count = max(self.pair_count, self.body_count)
        blocks = round_blocks(count, b.device.sm_count, self.abreast) if b.device.is_cuda else 1
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

    def _foreseeing(self, part: int) -> Stage:
        b, f = self.batch, self.batch.features
        return self._stage(foreseeing_kernel(b.scalar, f.meshes, f.half_list, f.dissipation), part, self.body_count)

    def _stage(self, kernel: Any, part: int, count: int, **named: int) -> Stage:
        """A launch over a thread's part of so many pairs or bodies."""
        b = self.batch
        first, last = count * part // b.threads, count * (part + 1) // b.threads
        tasks = -(-(last - first) // SPAN) if b.features.half_list else last - first
        return b.stage(kernel, tasks, first=first, last=last, subcycled=self.arrays, **named)
