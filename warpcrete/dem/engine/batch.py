"""Batch of one or many scenes: their arrays, joined end to end, and the kernel launches that advance them together.

The scenes of a batch share only kernels and launches. Each scene has its own parameters, walls, time, control flags and
neighbour lists. A scene halts itself on the device when its lists no longer cover every possible contact, when it has
reached its goal (a time or a number of steps), or when it has failed. Every kernel skips halted scenes, so no contact
is missed however many steps are queued, and a scene gives bitwise identical results alone and in a batch. A finished
scene still costs a little time, because every kernel visits it; the module `regrouping` removes finished scenes.
"""

from collections.abc import Generator, Sequence
from contextlib import contextmanager
from functools import cached_property

import numpy as np
import warp as wp

from ...core.device.arrays import DeviceArray, Kernel, zeros
from ...core.device.device import parallel
from ...core.device.exchange import Exchange
from ...core.device.graphs import GraphLaunch
from ...core.device.launching import (
    DEFAULT_BLOCK,
    Launcher,
    Size,
    Stage,
    Step,
    completed,
    graph_sizes,
    merge_thread_stages,
)
from ...core.errors import refuse
from ...kernels.common.control import ESTIMATED, FAILED, GOAL, HALTED, STALE, WAITS
from ...kernels.dem.motion import sync_kernel
from ...kernels.dem.probes import WALL_COLUMNS, wall_probe
from .batch_arrays import JointArrays
from .launch_planner import DEVICE_CHECK_INTERVAL, NEVER, LaunchPlanner
from .model import Model
from .state import State
from .subcycling import Subcycles
from .wall_layer import Structure

SPHERES_PER_THREAD = 500
"""Minimum number of spheres for each CPU thread. Threads with fewer spheres wait longer for each other than they save.

In a small pipe, the wall time with two threads divided by the wall time with one thread was 0.67 to 1.0 for 1000
spheres in total, and 1.25 to 2 for 500 spheres in total.
"""


def batch_key(model: Model) -> tuple[object, ...]:
    """Return a key of all features of a scene on which its kernels depend, such as the types of its contact laws.

    Scenes can share a batch if their models, which hold their constant data, have equal keys.
    """
    worn = len(model.walls) if model.features.wear else 0
    return model.features, model.analytic_walls, worn, model.scalar, str(model.device)


class Batch(JointArrays):
    """Scenes with the same features on one device; their arrays are slices of joint arrays.

    `models` (constant data of the scenes) and `states` (data that change in time) have one entry for each scene. On a
    CPU, `threads` threads share the work of a single scene: each thread computes a chunk, a range of bodies that are
    neighbours in memory. A batch of several scenes uses one thread, and a small scene uses fewer than `threads`
    threads. Raises :class:`SceneError` if the scenes need different features.
    """

    def __init__(self, models: list[Model], states: list[State], *, threads: int = 1) -> None:
        model = models[0]
        if len({batch_key(m) for m in models}) > 1:
            refuse(
                "batch",
                len(models),
                "must contain only scenes that need the same features, such as bonds or mesh walls; run scenes with "
                "other features in a separate batch",
            )
        for s, state in enumerate(states):
            state.attach_to(self, s)
        if parallel(model.device) or len(models) > 1:
            threads = 1
        spheres = sum(s.sphere_count for s in states)
        super().__init__(models, states, max(1, min(threads, spheres // SPHERES_PER_THREAD)))
        self.subcycles = Subcycles(self)
        self.structure = Structure(self) if self.features.structure else None
        self.exchange = Exchange(self.device)
        self._launcher = Launcher(self.threads, self.device)
        self.barrier = self._launcher.barrier
        self.version = 0
        """Number that increases whenever arrays or the division of bodies among CPU threads change, which makes
        recorded launches invalid."""
        self.memory_by_version: tuple[int, int] = (-1, 0)
        """Version of the batch at the last measurement of its device memory, and the measured memory [B]."""
        self._chunks: tuple[int, ...] = ()
        self.scenes_with_new_chunks: set[int] = set()
        """Indices of the scenes whose bodies are now divided differently among the CPU threads, so that their neighbour
        lists must be rebuilt."""
        self.planner = LaunchPlanner(self.parallel, self.count)
        self._flags: np.ndarray | None = None
        self._clock: np.ndarray | None = None
        self._walls: np.ndarray | None = None
        self._wall_launch: GraphLaunch | None = None
        self._flags_pending = self._row_pending = False
        self._step: Step | None = None
        self._rebuild: GraphLaunch | None = None
        self._between_pieces: GraphLaunch | None = None
        self._sync: Stage | None = None
        self.split()

    def split(self) -> None:
        """Divide bodies and spheres, in their current order, into one range (chunk) for each CPU thread."""
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
                self.scenes_with_new_chunks.add(s)
            state.chunks = own
        self._chunks = (*self.body_chunks.tolist(), *self.sphere_chunks.tolist())
        if self._chunks != before:
            self.invalidate_graphs()

    def stage(
        self, kernel: Kernel, dim: Size, *, on_side_stream: bool = False, joins_side_stream: bool = False,
        every: int = 1, block: int | None = None, **named: object,
    ) -> Stage:  # fmt: skip
        """Return a launch of `kernel` over `dim` tasks, recorded for later replays.

        `named` holds arguments by the names of the kernel's parameters. Missing arguments come from `kernel_arrays`.
        :class:`Stage` describes `on_side_stream`, `joins_side_stream`, `every` and `block`.
        """
        arguments = completed(kernel, named, self.kernel_arrays)
        return Stage(
            kernel,
            dim,
            arguments,
            self.device,
            on_side_stream=on_side_stream,
            joins_side_stream=joins_side_stream,
            every=every,
            block=block,
        )

    def invalidate_graphs(self) -> None:
        self._launcher.invalidate_graphs()
        self.planner.reset_step_count()
        self.version += 1
        self._step = self._rebuild = self._between_pieces = None
        self._sync = None
        self._wall_launch = None

    def use_step(self, step: Step, rebuild: GraphLaunch | None, between_pieces: GraphLaunch | None) -> None:
        """Store the launches of a time step, and the launches that follow each group of time steps on a GPU.

        `step` holds one list of launches for each CPU thread. The launches stay valid while `has_step` is True. After
        each group of steps, a GPU launches `between_pieces`, which estimates stable time steps. If the batch has only
        one scene, `between_pieces` also rebuilds stale neighbour lists. If no scene needs an estimate, the GPU
        launches `rebuild` instead, which only rebuilds stale lists.
        """
        self._step, self._rebuild, self._between_pieces = step, rebuild, between_pieces

    @property
    def has_step(self) -> bool:
        """True if a recorded time step is valid for the current arrays and the current ranges of the CPU threads."""
        return self._step is not None

    def set_goal(self, s: int, *, steps: int = NEVER, until: float = np.inf, interval: int = NEVER) -> None:
        """Let scene `s` continue until it has completed `steps` steps in total or has reached the time `until` [s].

        The scene also halts after every `interval` steps, so that its stable time step can be estimated again. When
        this method is called, the scene must not have reached either goal yet.
        """
        goal = until, min(interval, NEVER)
        if goal != (self.rows["until"][s], self.rows["interval"][s]):
            self.rows["until"][s], self.rows["interval"][s] = goal
            self._row_pending = True
        row = self.host_flags()[s]
        row[int(GOAL)] = steps
        row[int(HALTED)] = int(WAITS) if row[int(STALE)] != 0 or row[int(FAILED)] != 0 else 0
        self._flags_pending = True

    def mark_stale(self, scenes: Sequence[int] | np.ndarray) -> None:
        """Mark the neighbour lists of `scenes` as stale, so that the scenes halt until their lists are rebuilt."""
        flags = self.host_flags()
        for s in scenes:
            flags[s, int(STALE)] = 1
            flags[s, int(HALTED)] = flags[s, int(HALTED)] or int(WAITS)
        self._flags_pending = True

    def estimated(self, s: int, steps: int) -> None:
        """Record that the stable time step of scene `s` was estimated after `steps` completed steps."""
        self.host_flags()[s, int(ESTIMATED)] = steps
        self._flags_pending = True

    def host_flags(self) -> np.ndarray:
        """Return the control flags of all scenes, such as halted or failed, shape (scenes, FLAGS).

        The caller may change the array. The next launch copies the changed flags to the device.
        """
        if self._flags is None:
            self._read_flags()
        assert self._flags is not None
        return self._flags

    def host_clock(self) -> np.ndarray:
        """Return simulated time, time step and other time data of each scene, shape (scenes, CLOCK).

        `kernels/dem/structs.py` lists the columns and their units. Callers must not change the array.
        """
        if self._clock is None:
            self._read_flags()
        assert self._clock is not None
        return self._clock

    def _read_flags(self) -> None:
        """Read the scenes' control flags and times from the device into the host's copies.

        On a CPU, use views of the arrays, which are always up to date, instead of copies.
        """
        if self.parallel:
            flags, self._clock = self.exchange.read(self.flags, self.scenes.clock)
            # If the host has a copy of the flags, keep it, because it may contain changes not yet sent to the device.
            self._flags = flags if self._flags is None else self._flags
        else:
            self._flags, self._clock = self.flags.numpy(), self.scenes.clock.numpy()

    def host_walls(self, s: int) -> np.ndarray:
        """Return the current forces, travel and other values of the walls of scene `s`, shape (walls, WALL_COLUMNS).

        `kernels/dem/probes.py` lists the columns and their units.
        """
        if self._walls is None:
            (self._walls,) = self.exchange.read(self.wall_values())
        return self.own_walls(s, self._walls)

    def wall_values(self) -> DeviceArray:
        """Write the current forces, travel and other values of all walls to `wall_array`, and return this device array.

        The next call overwrites the array.
        """
        if self._wall_launch is None:
            self._wall_launch = GraphLaunch([self.wall_stage()], self.device)
        self._wall_launch()
        return self.wall_array

    @cached_property
    def wall_array(self) -> DeviceArray:
        """Device array for forces, travel and other values of all walls, shape (walls, WALL_COLUMNS)."""
        return zeros((self.wall_count, WALL_COLUMNS), dtype=wp.float64, device=self.device)

    def wall_stage(self) -> Stage:
        """Return the launch that writes forces, travel and other values of all walls to `wall_array`."""
        reading = {"walls": self.walls, "wall_values": self.wall_array}
        return Stage(wall_probe(self.scalar), self.wall_count, reading, self.device, block=DEFAULT_BLOCK)

    def own_walls(self, s: int, values: np.ndarray) -> np.ndarray:
        """Return the rows of `values` for the walls of scene `s`; `values` has one row for each wall of the batch."""
        first = int(self.rows["walls"][s])
        return values[first : first + int(self.rows["wall_count"][s])]

    @contextmanager
    def changing(self) -> Generator[None]:
        """Open a context in which code may change control flags, times or walls on the device.

        The host's pending changes are sent to the device first. At the end of the context, also after an exception, the
        host's copies of the device arrays are discarded, because they may be out of date.
        """
        self.flush()
        try:
            yield
        finally:
            self.flush()

    def flush(self) -> None:
        """Send pending host changes to the device, so that its arrays are up to date, and discard the host's copies."""
        pending = [(self.scenes.row, self.rows)] if self._row_pending else []
        if self.parallel and self._flags_pending:
            assert self._flags is not None
            pending.append((self.flags, self._flags))
        if pending:
            self.exchange.write(*pending)
        # Discard the host's copies only after they have been written to the device, so that Ctrl-C during the write
        # loses no changes.
        if self.parallel:
            self._flags = self._clock = None
        self._walls = None
        self._flags_pending = self._row_pending = False

    def launch(self) -> None:
        """Launch the next time steps; the launch planner chooses their number.

        A scene that has halted, for example because its neighbour lists are stale, skips the remaining steps. On a GPU,
        the method returns while the steps are still running.
        """
        launch_sizes = self.planner.launch_sizes(self.host_flags(), self.host_clock(), self.rows)
        interval = self.rows["interval"][self.host_flags()[:, int(HALTED)] == 0].min(initial=NEVER)
        with self.changing():
            self._launch(launch_sizes, interval)
        self.planner.count_steps(sum(launch_sizes))
        self.exchange.begin_read(self.flags, self.scenes.clock)

    def _launch(self, launch_sizes: list[int], interval: int) -> None:
        """Launch the time steps in groups; `launch_sizes` holds the number of steps of each group.

        After each group, a GPU also launches the work that :meth:`use_step` has recorded for this purpose: `rebuild` if
        no scene needs estimates of its stable step (`interval` is NEVER), and otherwise `between_pieces`.
        """
        # A GPU runs all sub-cycling rounds (shorter steps of stiff bonds) of a time step in one kernel, so their number
        # does not change the number of launches.
        rounds = 0 if self.parallel else self.subcycles.rounds
        largest = self.planner.largest_graph(self.threads, rounds)
        flags = np.empty((0, 0)) if self.parallel else self.host_flags()
        assert self._step is not None
        between_pieces = self._rebuild if interval == NEVER else self._between_pieces

        def ended() -> bool:
            return bool(flags[:, int(HALTED)].all())

        try:
            for count in launch_sizes:
                # On a GPU, record all steps of a group in one CUDA graph, together with the work that follows the
                # group, such as a rebuild of the neighbour lists. This reduces the number of launches.
                whole = self.parallel and count in (interval, DEVICE_CHECK_INTERVAL) and count <= largest
                sizes = [count] if whole else graph_sizes(count, largest)
                appended = between_pieces if whole and self.device.is_cuda else None
                self._launcher.replay(self._step, self._single_thread_step, sizes, ended, appended)
                if between_pieces is not None and appended is None:
                    between_pieces()
        finally:  # Copy the motion of spheres to their bodies even if Ctrl-C interrupts the launch.
            for stage in self.sync_stages():
                stage()

    def rebuild(self) -> None:
        """Rebuild the neighbour lists of all scenes now, with the recorded launch that a GPU uses between steps."""
        assert self._rebuild is not None
        self.mark_stale(range(self.count))
        with self.changing():
            self._rebuild()

    @property
    def settled(self) -> bool:
        """True if the device has completed the time steps of the latest launch."""
        return self.exchange.read_is_done

    def settle(self) -> np.ndarray:
        """Wait until the device has completed all launched steps; return a copy of the control flags of all scenes."""
        if self.parallel:
            self._flags, self._clock = self.exchange.finish_read()
        return self.host_flags().copy()

    def _single_thread_step(self) -> Step:
        assert self._step is not None
        return merge_thread_stages(self._step)

    def launch_chunks(self, stages: list[Stage]) -> None:
        """Launch `stages`, each on its own CPU thread; a stage is one kernel launch for a range (chunk) of bodies."""
        self._launcher.apart(stages)

    def sync_stages(self) -> list[Stage]:
        """Return the launches that copy the motion of single spheres to their bodies.

        If every body is a single sphere, steps move only the spheres, because that is faster. For scenes with clumps
        the returned list is empty.
        """
        if self.features.clumps or not self.sphere_count:
            return []
        self._sync = self._sync or self.stage(sync_kernel(self.scalar), self.sphere_count)
        return [self._sync]
