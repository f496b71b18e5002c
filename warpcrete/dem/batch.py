"""A batch: the arrays of one or many scenes joined end to end, and the launches that carry them all forward.

Scenes of a batch share kernels and launches and nothing else: each has its own parameters, walls, clock, flags and
lists. A scene whose lists no longer cover every possible contact, whose goal is reached or which has failed halts
itself on the device: every kernel passes it by. So no contact is missed however many steps are in flight, and a
scene alone and in a batch holds the same bits. Finished scenes cost little, but not nothing: see `regrouping`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp

from ..core.device import parallel
from ..core.errors import CapacityError, refuse
from ..core.exchange import Exchange
from ..core.launching import DEFAULT_BLOCK, Launcher, Size, Stage, Step, by_one_thread, graph_sizes, parameter_names
from ..geometry.surfaces import Surfaces
from ..geometry.walls import MeshWall
from ..kernels.common.control import ESTIMATED, FAILED, GOAL, HALTED, STALE, STEPS, WAITS
from ..kernels.common.types import types
from ..kernels.common.walls import FIXED, MESH
from ..kernels.dem.motion import sync_kernel
from ..kernels.dem.probes import WALL_COLUMNS, wall_probe
from ..kernels.dem.structs import array_structs, scene_struct
from .ahead import NEVER, Ahead
from .links import carry_links, even_pairs, make_links
from .model import Model
from .resting import Structure
from .state import PAIR_ARRAYS, STRUCTS, State, pair_bytes, state_fields
from .subcycling import Subcycles

MAXIMUM_ENTRIES = 2**31 - 2**20  # of a list: places are 32-bit numbers
PER_THREAD = 500
"""Spheres from which on a thread of a CPU is worth its waiting for the others: of a small pipe two threads took two
thirds to the whole of one's time at a thousand spheres, one and a quarter to twice it at half as many."""


def batch_key(model: Model) -> tuple:
    """Scenes with equal keys can share a batch."""
    worn = len(model.walls) if model.features.wear else 0
    return model.features, model.analytic_walls, worn, model.scalar, str(model.device)


class Batch:
    """Scenes with the same features on one device; the arrays of `states[s]` become slices of the joint ones.

    `threads` (CPU only, one scene only) splits every stage into as many chunks of neighbouring bodies; fewer where
    there are few.
    """

    flags: wp.array
    """Of all scenes, as that of a :class:`State`."""
    scenes: Any
    """Joint arrays of all scenes, as those of a :class:`State`: structs of `kernels/dem/structs.py`."""
    bodies: Any
    spheres: Any
    slots: Any
    pairs: Any
    candidates: Any
    walls: Any
    corners: wp.array
    """Of all meshes, each in its wall's frame [m], shape (corners,)."""
    faces: wp.array
    """Corners of each triangle, shape (faces, 3)."""
    across: wp.array
    """Far corner beyond each edge of a triangle, then the triangle there; -1 at borders, shape (faces, 6)."""
    ring_start: wp.array
    """First entry of each corner's row in `ring`, and the end, shape (corners + 1,)."""
    ring: wp.array
    """For each corner the lowest triangle there, then the corners with which it shares an edge."""
    face_wall: wp.array
    """Wall that a triangle belongs to, shape (faces,)."""
    pair_parameters: wp.array
    """Contact laws between bodies, of all scenes one after the other; as the next five those of a :class:`Model`."""
    wall_parameters: wp.array
    """Contact laws of bodies with walls."""
    bond_parameters: wp.array
    """Kinds of bonds."""
    segments: wp.array
    """Pieces of the axes of pipes and drives."""
    drive_axis: wp.array
    """First segment of each group's axis, and the end, shape (groups, 2)."""
    drive_force: wp.array
    """On each body of a group, along that axis [N], shape (groups,)."""
    rows: np.ndarray
    """Host copy of `scenes.row`."""
    slot_scene: wp.array
    """Scene of every entry of `pairs.start`, shape (spheres + scenes,)."""

    def __init__(self, models: list[Model], states: list[State], *, threads: int = 1) -> None:
        model = models[0]
        if len({batch_key(m) for m in models}) > 1:
            refuse("batch", len(models), "scenes of a batch must need the same features")
        self.models, self.states = models, states
        for s, state in enumerate(states):
            state.taken_into(self, s)
        self.features, self.scalar, self.device = model.features, model.scalar, model.device
        self.parallel = parallel(self.device)
        self.count = len(models)
        self.body_count = sum(s.body_count for s in states)
        self.sphere_count = sum(s.sphere_count for s in states)
        self.wall_count = sum(len(m.walls) for m in models)
        if self.parallel or self.count > 1:
            threads = 1
        self.threads = max(1, min(threads, self.sphere_count // PER_THREAD))
        self.structs = array_structs(self.scalar)
        if self.parallel:
            even_pairs(states)
        self.capacity = np.array([len(s.pairs.other) for s in states])
        """Entries that there is room for in the pair arrays, of each scene."""
        self.face_capacity = np.array([len(s.candidates.face) for s in states])
        """Likewise of the mesh candidates."""
        self._join_states()
        self._join_models()
        self._place_pairs()
        self.links = make_links(self)
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
        self._wall_reading: Stage | None = None
        self._unsent = self._row_unsent = False
        self._launched = 0, 0  # steps of the first scene before, and how many were launched
        self._step: list[list[Any]] | None = None
        self._between: Callable[[], None] | None = None
        self._sync: Stage | None = None
        self.split()

    # What a scene of the batch is made of.

    def _join_states(self) -> None:
        """Joint arrays; those of the states become slices of them. What only a batch has begins as zero."""
        for struct in STRUCTS:
            setattr(self, struct, getattr(self.structs, struct.capitalize())())
        for struct, names in state_fields(self.structs).items():
            for name in names:
                joint = self._join([getattr(state, struct) for state in self.states], name)
                setattr(getattr(self, struct), name, joint)
        self.flags = self._join(self.states, "flags")
        n = self.sphere_count
        counts = [s.sphere_count for s in self.states]
        vec4 = self.structs.Spheres.vars["clear"].type.dtype
        self.spheres.scene = self._numbers(counts)
        self.spheres.clear = wp.zeros(n if self.features.analytic else 0, dtype=vec4, device=self.device)
        self.bodies.scene = self._numbers([s.body_count for s in self.states])
        self.slot_scene = self._numbers([n + 1 for n in counts])

    def _join(self, parts: list[Any], name: str) -> wp.array:
        """One array of those that the parts have under a name; theirs become slices of it."""
        arrays = [getattr(part, name) for part in parts]
        if len(arrays) == 1:
            return arrays[0]
        joint = wp.empty((sum(len(a) for a in arrays), *arrays[0].shape[1:]), dtype=arrays[0].dtype, device=self.device)
        first = 0
        for part, array in zip(parts, arrays):
            if array.size:  # without walls rows have no columns
                view = joint[first : first + len(array)]
                wp.copy(view, array)
                setattr(part, name, view)
            first += len(array)
        return joint

    def _join_models(self) -> None:
        models = self.models
        self._given: list[dict[str, Any]] = [{} for _ in models]
        self.rows = np.zeros(self.count, dtype=scene_struct(self.scalar).numpy_dtype())
        segments = [m.segments.numpy() for m in models]
        first_segment = np.concatenate([[0], np.cumsum([len(s) for s in segments])])
        tables, drives, surfaces = [], [], Surfaces()
        first = dict.fromkeys(("bodies", "spheres", "walls", "laws", "bonds", "groups"), 0)
        for s, (model, state) in enumerate(zip(models, self.states)):
            for name, value in first.items():
                self.rows[name][s] = value
            table = model.wall_table.numpy().copy()[: len(model.walls)]
            table["first"] += first_segment[s]
            table["last"] += first_segment[s]
            self.rows["faces"][s] = surfaces.face_count
            for w, wall in enumerate(model.walls):
                if isinstance(wall, MeshWall):
                    assert table["kind"][w] == int(MESH)
                    table["first_face"][w] = surfaces.add(wall.vertices, wall.faces, first["walls"] + w)
            tables.append(table)
            drives.append(model.drive_axis.numpy() + first_segment[s])
            self._describe(s, model, state, still=bool(np.all(table["motion"][: model.analytic_walls] == int(FIXED))))
            first["bodies"] += state.body_count
            first["spheres"] += state.sphere_count
            first["walls"] += len(model.walls)
            first["laws"] += len(model.pair_parameters)
            first["bonds"] += len(model.bond_parameters)
            first["groups"] += len(model.groups)
        for name in ("pair_parameters", "wall_parameters", "bond_parameters", "drive_force", "segments"):
            setattr(self, name, self._chained([getattr(model, name) for model in models]))
        self.drive_axis = self._array(np.concatenate(drives), wp.int32)
        self.scenes.row = self._array(self.rows, scene_struct(self.scalar))
        self.walls.scene = self._numbers([len(m.walls) for m in models])
        self.walls.table = self._array(np.concatenate(tables), models[0].wall_table.dtype)
        self.walls.rest_position = self._chained([m.rest_position for m in models])
        self.walls.step_force = wp.zeros((self.threads, self.wall_count, 6), dtype=wp.int64, device=self.device)
        self.corners = self._array(surfaces.corners(), types(self.scalar).vec3)
        self.faces = self._array(surfaces.faces(), wp.int32, 2)
        self.across = self._array(surfaces.across(), wp.int32, 2)
        self.ring_start = self._array(surfaces.ring_start(), wp.int32)
        self.ring = self._array(surfaces.ring(), wp.int32)
        self.face_wall = self._array(surfaces.owner(), wp.int32)

    def _describe(self, s: int, model: Model, state: State, *, still: bool) -> None:
        """Numbers of a scene's row that never change."""
        row = self.rows
        row["body_count"][s], row["sphere_count"][s] = state.body_count, state.sphere_count
        row["wall_count"][s], row["analytic"][s] = len(model.walls), model.analytic_walls
        row["still"][s] = still
        row["materials"][s] = len(model.materials)
        row["gravity"][s] = model.scene.gravity
        row["speed_limit"][s] = model.scene.watch.speed
        row["largest_radius"][s] = state.largest_radius
        row["growth_end"][s] = 1.0
        row["until"][s], row["interval"][s] = np.inf, NEVER
        row["wall_stiffness"][s] = np.pi * model.stress_scale * state.largest_radius

    def _chained(self, arrays: list[wp.array]) -> wp.array:
        """Arrays that never change, end to end."""
        if len(arrays) == 1:
            return arrays[0]
        joint = wp.empty(sum(len(a) for a in arrays), dtype=arrays[0].dtype, device=self.device)
        first = 0
        for array in arrays:
            if len(array):
                wp.copy(joint[first : first + len(array)], array)
                first += len(array)
        return joint

    def _array(self, values: Any, dtype: Any, dimensions: int = 1) -> wp.array:
        if len(values) == 0:
            return wp.zeros((0,) * dimensions, dtype=dtype, device=self.device)
        return wp.array(np.ascontiguousarray(values), dtype=dtype, device=self.device)

    def _numbers(self, counts: list[int]) -> wp.array:
        return self._array(np.repeat(np.arange(self.count), counts), wp.int32)

    def set(self, s: int, **numbers: Any) -> None:
        """Change numbers of a scene's row."""
        if numbers.items() <= self._given[s].items():  # asked again and again by a scene on its way
            return
        if any(np.any(self.rows[name][s] != self.rows.dtype[name].type(value)) for name, value in numbers.items()):
            for name, value in numbers.items():
                self.rows[name][s] = value
            self.scenes.row.assign(self.rows)
        self._given[s] |= numbers

    def _place_pairs(self) -> None:
        self.rows["pairs"] = np.concatenate([[0], np.cumsum(self.capacity)[:-1]])
        self.rows["candidates"] = np.concatenate([[0], np.cumsum(self.face_capacity)[:-1]])
        self.scenes.row.assign(self.rows)

    def reserve_pairs(self, wanted: np.ndarray) -> None:
        """Room for at least `wanted` pairs a scene; what the pair arrays hold stays."""
        used = [name for name in PAIR_ARRAYS if name in pair_bytes(self.models[0])]
        before, old = self.links, self.capacity.copy()
        before.pull = None  # what touches is written anew before it is read, and takes most of the memory
        self._regrow("pairs", used, self.capacity, wanted)
        self.links = make_links(self)
        if self.parallel:
            carry_links(before, old, self.links, self.capacity)

    def reserve_faces(self, wanted: np.ndarray) -> None:
        """Room for at least `wanted` mesh candidates a scene."""
        self._regrow("candidates", ["face"], self.face_capacity, wanted)

    def _regrow(self, struct: str, names: list[str], capacity: np.ndarray, wanted: np.ndarray) -> None:
        old = np.concatenate([[0], np.cumsum(capacity)])
        grown = wanted > capacity
        capacity[grown] = (wanted[grown] + wanted[grown] // 4 + 64) // 2 * 2
        new = np.concatenate([[0], np.cumsum(capacity)])
        # What a GPU's links give, each two entries, has four rows at most.
        most = MAXIMUM_ENTRIES // 2 if self.parallel and struct == "pairs" else MAXIMUM_ENTRIES
        if new[-1] > most:
            raise CapacityError(f"{struct}: {self.sphere_count} spheres need {new[-1]} entries, more than {most}")
        for name in names:
            before = getattr(getattr(self, struct), name)
            after = wp.zeros(int(new[-1]), dtype=before.dtype, device=self.device)
            for s, state in enumerate(self.states):
                kept = int(old[s + 1] - old[s])
                if kept:
                    wp.copy(after, before, int(new[s]), int(old[s]), kept)
                view = after
                if self.count > 1:
                    empty = new[s] == new[s + 1]  # Warp slices none out of nothing
                    view = after[:1] if empty else after[int(new[s]) : int(new[s + 1])]
                setattr(getattr(state, struct), name, view)
            setattr(getattr(self, struct), name, after)
        self._place_pairs()
        self.invalidate_graphs()

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
        self._step = None
        self._sync = None
        self._wall_reading = None

    def use_step(self, step: list[list[Any]], between: Callable[[], None] | None) -> None:
        """Take the stages of one step, a list for each thread; good until `has_step` says otherwise.

        `between` launches what a GPU does where scenes have taken as many steps as they may by one estimate.
        """
        self._step, self._between = step, between

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
            if self._wall_reading is None:
                self._wall_values = wp.zeros((self.wall_count, WALL_COLUMNS), dtype=wp.float64, device=self.device)
                reading = {"walls": self.walls, "wall_values": self._wall_values}
                probe = wall_probe(self.scalar)
                self._wall_reading = Stage(probe, self.wall_count, reading, self.device, block=DEFAULT_BLOCK)
            self._wall_reading()
            (self._walls,) = self.exchange.read(self._wall_values)
        first = int(self.rows["walls"][s])
        return self._walls[first : first + int(self.rows["wall_count"][s])]

    def device_changed(self) -> None:
        """Flags or clocks on the device are, or are about to become, others than those read last."""
        if self._row_unsent:
            self.exchange.write(self.scenes.row, self.rows)
        if self.parallel:
            if self._unsent:
                assert self._flags is not None
                self.exchange.write(self.flags, self._flags)
            self._flags = self._clock = None
        self._walls = None
        self._unsent = self._row_unsent = False

    def launch(self) -> None:
        """Launch steps until some scene needs looking after; a GPU takes them while Python goes on."""
        before = int(self.host_flags()[0, int(STEPS)])
        pieces = self.ahead.pieces(self.host_flags(), self.host_clock(), self.rows)
        self.device_changed()
        largest = self.ahead.largest_graph(self.threads, self.subcycles.rounds)
        flags = np.empty((0, 0)) if self.parallel else self.host_flags()
        assert self._step is not None
        try:
            for count in pieces:
                # From one estimate to the next a GPU takes one graph.
                whole = self.parallel and self.count == 1 and count == self.rows["interval"][0] and count <= largest
                sizes = [count] if whole else graph_sizes(count, largest)
                self._launcher.replay(self._step, self._alone, sizes, lambda: bool(flags[:, int(HALTED)].all()))
                if self._between is not None:
                    self._between()
        finally:  # an interruption leaves bodies where their spheres are
            for stage in self.sync_stages():
                stage()
        self._launched = before, sum(pieces)
        self.exchange.ask(self.flags, self.scenes.clock)

    @property
    def settled(self) -> bool:
        """Whether all that was launched is done."""
        return self.exchange.answered

    def settle(self) -> np.ndarray:
        """Wait for what was launched; returns a copy of all flags."""
        if self.parallel:
            self._flags, self._clock = self.exchange.answer()
        flags = self.host_flags().copy()
        before, launched = self._launched
        self.ahead.stepped(int(flags[0, int(STEPS)]) - before, launched)
        return flags

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
