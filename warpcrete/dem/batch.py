"""A batch: the arrays of one or many scenes joined end to end, and the launches that carry them all forward.

Scenes of a batch share kernels and launches and nothing else: each has its own parameters, walls, clock, flags and
lists. A scene whose lists no longer cover every possible contact, whose goal is reached or which has failed halts
itself on the device: every kernel passes it by. So no contact is missed however many steps are in flight, and a
scene alone and in a batch holds the same bits. Finished scenes cost little, but not nothing: see `regrouping`.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
import warp as wp

from ..core.device import parallel
from ..core.errors import refuse
from ..core.exchange import Exchange
from ..core.graphs import AtOnce
from ..core.launching import (
    DEFAULT_BLOCK,
    Launcher,
    Size,
    Stage,
    Step,
    by_one_thread,
    graph_sizes,
    parameter_names,
)
from ..kernels.common.control import ESTIMATED, FAILED, GOAL, HALTED, STALE, WAITS
from ..kernels.dem.motion import sync_kernel
from ..kernels.dem.probes import WALL_COLUMNS, wall_probe
from .ahead import NEVER, WAIT, Ahead
from .joint import JointArrays
from .model import Model
from .resting import Structure
from .state import State
from .subcycling import Subcycles

PER_THREAD = 500
"""Spheres from which on a thread of a CPU is worth its waiting for the others: of a small pipe two threads took two
thirds to the whole of one's time at a thousand spheres, one and a quarter to twice it at half as many."""


def batch_key(model: Model) -> tuple:
    """Scenes with equal keys can share a batch."""
    worn = len(model.walls) if model.features.wear else 0
    return model.features, model.analytic_walls, worn, model.scalar, str(model.device)


class Batch(JointArrays):
    """Scenes with the same features on one device; the arrays of `states[s]` become slices of the joint ones.

    `threads` (CPU only, one scene only) splits every stage into as many chunks of neighbouring bodies; fewer where
    there are few.
    """

    def __init__(self, models: list[Model], states: list[State], *, threads: int = 1) -> None:
        model = models[0]
        if len({batch_key(m) for m in models}) > 1:
            refuse("batch", len(models), "scenes of a batch must need the same features")
        for s, state in enumerate(states):
            state.taken_into(self, s)
        if parallel(model.device) or len(models) > 1:
            threads = 1
        spheres = sum(s.sphere_count for s in states)
        super().__init__(models, states, max(1, min(threads, spheres // PER_THREAD)))
        self.subcycles = Subcycles(self)
        self.structure = Structure(self) if self.features.structure else None
        self.exchange = Exchange(self.device)
        self._launcher = Launcher(self.threads, self.device)
        self.barrier = self._launcher.barrier
        self.version = 0
        """Of the recorded launches: another number means that arrays or chunks have changed."""
        self._chunks: tuple[int, ...] = ()
        self.rechunked: set[int] = set()
        """Scenes whose chunks are others than those of the lists that they came with, or that they had once."""
        self.ahead = Ahead(self.parallel, self.count)
        self._flags: np.ndarray | None = None
        self._clock: np.ndarray | None = None
        self._walls: np.ndarray | None = None
        self._wall_reading: AtOnce | None = None
        self._unsent = self._row_unsent = False
        self._step: list[list[Any]] | None = None
        self._rebuild: AtOnce | None = None
        self._between: AtOnce | None = None
        self._sync: Stage | None = None
        self.split()

    # Chunks of a CPU's threads.

    def split(self) -> None:
        """Chunks of bodies and spheres that threads own, from the order of the bodies as it is now."""
        before = self._chunks
        if self.threads == 1:
            self.body_chunks = np.array([0, self.body_count])
            self.sphere_chunks = np.array([0, self.sphere_count])
        else:
            first = self.bodies.first.numpy()
            wanted = self.sphere_count * np.arange(self.threads + 1) // self.threads
            self.body_chunks = np.searchsorted(first, wanted)
            self.sphere_chunks = first[self.body_chunks]
        chunks = [int(c) for c in self.sphere_chunks]
        for s, state in enumerate(self.states):
            own = chunks if self.count == 1 else [0, state.sphere_count]
            if state.chunks != own:
                self.rechunked.add(s)
            state.chunks = own
        self._chunks = (*self.body_chunks.tolist(), *self.sphere_chunks.tolist())
        if self._chunks != before:
            self.invalidate_graphs()

    # Launching.

    def stage(
        self, kernel: Any, dim: Size, *, beside: bool = False, meets: bool = False, every: int = 1,
        block: int | None = None, **named: Any,
    ) -> Stage:  # fmt: skip
        """A launch of a kernel; parameters that are not `named` are the batch's attributes of the same names."""
        for name in parameter_names(kernel):
            if name not in named:
                named[name] = getattr(self, name)
        return Stage(kernel, dim, named, self.device, beside=beside, meets=meets, every=every, block=block)

    def invalidate_graphs(self) -> None:
        """Recorded launches hold arrays or chunks that are no more."""
        self._launcher.invalidate_graphs()
        self.ahead.captured()
        self.version += 1
        self._step = self._rebuild = self._between = None
        self._sync = None
        self._wall_reading = None

    def use_step(self, step: list[list[Any]], rebuild: AtOnce | None, between: AtOnce | None) -> None:
        """Take the stages of one step, a list for each thread; good until `has_step` says otherwise.

        `between` launches what a GPU does where scenes have taken as many steps as they may by one estimate, `rebuild`
        what it does of that where no estimate is due for long.
        """
        self._step, self._rebuild, self._between = step, rebuild, between

    @property
    def has_step(self) -> bool:
        """The stages are those of the arrays and chunks as they are now."""
        return self._step is not None

    def goal(self, s: int, *, steps: int = NEVER, until: float = np.inf, interval: int = NEVER) -> None:
        """Let a scene go on until it has completed so many steps, or has got to a time [s], with an estimate of the
        stable step every `interval` steps; it is at neither yet."""
        goal = until, min(interval, NEVER)
        if goal != (self.rows["until"][s], self.rows["interval"][s]):
            self.rows["until"][s], self.rows["interval"][s] = goal
            self._row_unsent = True
        row = self.host_flags()[s]
        row[int(GOAL)] = steps
        row[int(HALTED)] = int(WAITS) if row[int(STALE)] != 0 or row[int(FAILED)] != 0 else 0
        self._unsent = True

    def outdate(self, scenes: Sequence[int] | np.ndarray) -> None:
        """Have scenes wait for new lists."""
        flags = self.host_flags()
        for s in scenes:
            flags[s, int(STALE)] = 1
            flags[s, int(HALTED)] = flags[s, int(HALTED)] or int(WAITS)
        self._unsent = True

    def estimated(self, s: int, steps: int) -> None:
        """Note at how many completed steps the stable step of a scene was estimated."""
        self.host_flags()[s, int(ESTIMATED)] = steps
        self._unsent = True

    def host_flags(self) -> np.ndarray:
        """All flags as they are on the device; what is changed here goes there with the next launch."""
        if self._flags is None:
            self._look()
        assert self._flags is not None
        return self._flags

    def host_clock(self) -> np.ndarray:
        """All clocks as they are on the device, to read."""
        if self._clock is None:
            self._look()
        assert self._clock is not None
        return self._clock

    def _look(self) -> None:
        """Read flags and clocks; on a CPU they are the arrays themselves, which are always up to date."""
        if self.parallel:
            flags, self._clock = self.exchange.read(self.flags, self.scenes.clock)
            self._flags = flags if self._flags is None else self._flags  # which may have been changed
        else:
            self._flags, self._clock = self.flags.numpy(), self.scenes.clock.numpy()

    def host_walls(self, s: int) -> np.ndarray:
        """What is read of the walls of a scene, as they are on the device: columns of `kernels/dem/probes.py`."""
        if self._walls is None:
            (self._walls,) = self.exchange.read(self.wall_values())
        return self.own_walls(s, self._walls)

    def wall_values(self) -> wp.array:
        """The same of all walls, on the device: good until the next call."""
        if self._wall_reading is None:
            self._wall_reading = AtOnce([self.wall_stage()], self.device)
        self._wall_reading()
        return self.wall_array

    @cached_property
    def wall_array(self) -> wp.array:
        """Where they are written, shape (walls, WALL_COLUMNS)."""
        return wp.zeros((self.wall_count, WALL_COLUMNS), dtype=wp.float64, device=self.device)

    def wall_stage(self) -> Stage:
        """What writes them."""
        reading = {"walls": self.walls, "wall_values": self.wall_array}
        return Stage(wall_probe(self.scalar), self.wall_count, reading, self.device, block=DEFAULT_BLOCK)

    def own_walls(self, s: int, values: np.ndarray) -> np.ndarray:
        """Rows of a scene among those of all walls."""
        first = int(self.rows["walls"][s])
        return values[first : first + int(self.rows["wall_count"][s])]

    def device_changed(self) -> None:
        """Flags or clocks on the device are, or are about to become, others than those read last."""
        unsent = [(self.scenes.row, self.rows)] if self._row_unsent else []
        if self.parallel and self._unsent:
            assert self._flags is not None
            unsent.append((self.flags, self._flags))
        if unsent:
            self.exchange.write(*unsent)
        # Not before: an interruption of that must not lose what was to be sent.
        if self.parallel:
            self._flags = self._clock = None
        self._walls = None
        self._unsent = self._row_unsent = False

    def launch(self) -> None:
        """Launch steps until some scene needs looking after; a GPU takes them while Python goes on."""
        pieces = self.ahead.pieces(self.host_flags(), self.host_clock(), self.rows)
        interval = self.rows["interval"][self.host_flags()[:, int(HALTED)] == 0].min(initial=NEVER)
        self.device_changed()
        rounds = 0 if self.parallel else self.subcycles.rounds  # which a GPU takes in one kernel
        largest = self.ahead.largest_graph(self.threads, rounds)
        flags = np.empty((0, 0)) if self.parallel else self.host_flags()
        assert self._step is not None
        between = self._rebuild if interval == NEVER else self._between

        def ended() -> bool:
            return bool(flags[:, int(HALTED)].all())

        try:
            for count in pieces:
                # From one estimate to the next a GPU takes one graph, the estimate included.
                whole = self.parallel and count in (interval, WAIT) and count <= largest
                sizes = [count] if whole else graph_sizes(count, largest)
                behind = between if whole and self.device.is_cuda else None
                self._launcher.replay(self._step, self._alone, sizes, ended, behind)
                if between is not None and behind is None:
                    between()
        finally:  # an interruption leaves bodies where their spheres are
            for stage in self.sync_stages():
                stage()
        self.ahead.stepped(sum(pieces))
        self.exchange.ask(self.flags, self.scenes.clock)

    def rebuild(self) -> None:
        """Have a GPU that builds lists by itself build them, as it does between steps."""
        assert self._rebuild is not None
        self.outdate(range(self.count))
        self.device_changed()
        self._rebuild()
        self.device_changed()

    @property
    def settled(self) -> bool:
        """Whether all that was launched is done."""
        return self.exchange.answered

    def settle(self) -> np.ndarray:
        """Wait for what was launched; returns a copy of all flags."""
        if self.parallel:
            self._flags, self._clock = self.exchange.answer()
        return self.host_flags().copy()

    def _alone(self) -> Step:
        assert self._step is not None
        return by_one_thread(self._step)

    def in_parts(self, stages: list[Stage]) -> None:
        """Launch stages that chunks have apart, each on a thread of its own."""
        self._launcher.apart(stages)

    def sync_stages(self) -> list[Stage]:
        """What brings bodies up to date with their spheres, where every body is one: steps do not."""
        if self.features.clumps or not self.sphere_count:
            return []
        self._sync = self._sync or self.stage(sync_kernel(self.scalar), self.sphere_count)
        return [self._sync]
