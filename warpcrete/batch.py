"""A batch: the arrays of one or many scenes joined end to end, and the launches that carry them all forward.

Scenes of a batch share kernels and launches and nothing else: each has its own parameters, walls, clock, flags and
lists. A scene whose lists no longer cover every possible contact, whose goal is reached or which has failed halts
itself on the device: every kernel passes it by. So no contact is missed however many steps are in flight, a
finished scene costs nothing, and a scene alone and in a batch holds the same bits.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from .errors import CapacityError, refuse
from .kernels.types import FAILED, GOAL, HALTED, STALE, STEPS, scene_struct, types
from .kernels.wall_motion import FIXED, MESH
from .launching import Launcher, Stage, graph_sizes
from .model import Model
from .scene import MeshWall
from .stages import publish_stage, step_stages
from .state import State, pair_types
from .surfaces import Surfaces

MOST_ENTRIES = 2**31 - 2**20  # of a list: places are 32-bit numbers
LARGEST_GRAPH = {"cpu": 8, "cuda": 64}
"""Steps of one graph: on a CPU capturing costs as much as some steps, replaying next to nothing."""
CPU_LAUNCH = 64  # steps from one look at Ctrl-C to the next
BATCH_LAUNCH = 16  # steps in flight before scenes that halted are looked after, where there are several


def batch_key(model: Model) -> tuple:
    """Scenes with equal keys can share a batch."""
    return model.features, model.analytic_walls, model.scalar, str(model.device)


class Batch:
    """Scenes with the same features on one device; `models[s]` and `states[s]` become views of the joint arrays.

    `threads` (CPU only, one scene only) splits every stage into as many chunks of neighbouring bodies.
    """

    if TYPE_CHECKING:  # the joint arrays have the names that models and states give theirs

        def __getattr__(self, name: str) -> Any: ...

    def __init__(self, models: list[Model], states: list[State], *, threads: int = 1) -> None:
        model = models[0]
        if len({batch_key(m) for m in models}) > 1:
            refuse("batch", len(models), "scenes of a batch must need the same features")
        self.models, self.states = models, states
        for s, state in enumerate(states):
            state.batch, state.index = self, s
        self.features, self.scalar, self.device = model.features, model.scalar, model.device
        self.is_cuda = bool(self.device.is_cuda)
        self.count = len(models)
        bodies = sum(s.body_count for s in states)
        if self.is_cuda or self.count > 1:
            threads = 1
        self.threads = max(1, min(threads, bodies // 32))
        self.bodies, self.spheres = bodies, sum(s.sphere_count for s in states)
        self.walls = sum(len(m.walls) for m in models)
        self._join_models()
        self._join_states()
        self._launcher = Launcher(self.threads, self.device)
        self.version = 0
        """Of the recorded launches: another number means that arrays or chunks have changed."""
        self._chunks: tuple[int, ...] = ()
        self.rechunked: set[int] = set()
        """Scenes whose chunks are others than those of the lists that they came with, or that they had once."""
        self._since_build = 0
        self._between_builds = 64
        self.goals = np.zeros(self.count, dtype=int)
        self._flags: np.ndarray | None = None
        self._clock: np.ndarray | None = None
        self._unsent = False
        self.split()

    # What a scene of the batch is made of.

    def _join_models(self) -> None:
        models = self.models
        row = np.zeros(self.count, dtype=scene_struct(self.scalar).numpy_dtype())
        self.rows = row
        segments = [m.segments.numpy() for m in models]
        first_segment = np.concatenate([[0], np.cumsum([len(s) for s in segments])])
        walls, drives, surfaces = [], [], Surfaces()
        first = dict.fromkeys(("bodies", "spheres", "walls", "laws", "bonds", "groups"), 0)
        for s, (model, state) in enumerate(zip(models, self.states)):
            for name, value in first.items():
                row[name][s] = value
            table = model.wall_table.numpy().copy()
            table["first"] += first_segment[s]
            table["last"] += first_segment[s]
            for w, wall in enumerate(model.walls):
                if isinstance(wall, MeshWall):
                    assert table["kind"][w] == int(MESH)
                    table["first_face"][w] = surfaces.add(wall.vertices, wall.faces, first["walls"] + w)
            walls.append(table[: len(model.walls)])
            drives.append(model.drive_axis.numpy() + first_segment[s])
            row["body_count"][s], row["sphere_count"][s] = state.body_count, state.sphere_count
            row["wall_count"][s], row["analytic"][s] = len(model.walls), model.analytic_walls
            row["still"][s] = int(np.all(table["motion"][: model.analytic_walls] == int(FIXED)))
            row["materials"][s] = model.material_count
            row["gravity"][s] = model.scene.gravity
            row["speed_limit"][s] = model.scene.watch.speed
            row["largest_radius"][s] = state.largest_radius
            row["growth_end"][s] = 1.0
            row["wall_stiffness"][s] = np.pi * model.stress_scale * state.largest_radius
            first["bodies"] += state.body_count
            first["spheres"] += state.sphere_count
            first["walls"] += len(model.walls)
            first["laws"] += len(model.pair_parameters)
            first["bonds"] += len(model.bond_parameters)
            first["groups"] += len(model.groups)
        self.scenes = self._array(row, scene_struct(self.scalar))
        for name in (
            "pair_parameters", "wall_parameters", "bond_parameters", "rest_position", "drive_force", "segments",
        ):  # fmt: skip
            self._join(models, name)
        dtype = models[0].wall_table.dtype
        self.wall_table = self._array(np.concatenate(walls) if self.walls else np.zeros(1, walls[0].dtype), dtype)
        self.drive_axis = self._array(np.concatenate(drives), wp.int32)
        for s, model in enumerate(models):
            if model.walls:
                place = int(row["walls"][s])
                model.wall_table = self.wall_table[place : place + len(model.walls)]  # type: ignore[assignment]
        vec3 = types(self.scalar).vec3
        self.corners = self._array(surfaces.corners(), vec3)
        self.faces = self._array(surfaces.faces(), wp.int32, 2)
        self.face_across = self._array(surfaces.across(), wp.int32, 2)
        self.ring_start = self._array(surfaces.ring_start(), wp.int32)
        self.ring = self._array(surfaces.ring(), wp.int32)
        self.face_wall = self._array(surfaces.owner(), wp.int32)

    def _join_states(self) -> None:
        states, t = self.states, types(self.scalar)
        for name in (*State.BODY_ARRAYS, *State.SPHERE_ARRAYS, *State.WALL_ARRAYS, *State.SCENE_ARRAYS):
            self._join(states, name)
        for name in ("body_first", "sphere_body", "pair_start", "candidate_start"):
            self._join(states, name)
        counts = [s.sphere_count for s in states]
        self.sphere_scene = self._numbers(counts)
        self.body_scene = self._numbers([s.body_count for s in states])
        self.wall_scene = self._numbers([len(m.walls) for m in self.models])
        self.slot_scene = self._numbers([n + 1 for n in counts])
        self.capacity = np.array([len(s.pair_other) for s in states])
        self.face_capacity = np.array([len(s.candidate_face) for s in states])
        for name in State.PAIR_ARRAYS:
            self._join(states, name)
        self._join(states, "candidate_face")
        self._place_pairs()
        self.wall_step_force = wp.zeros((self.threads, self.walls, 6), dtype=wp.int64, device=self.device)
        self.sums = wp.zeros((self.spheres, 4), dtype=t.mat33, device=self.device)
        self.sphere_clear = wp.zeros(self.spheres if self.features.analytic else 0, dtype=t.vec4, device=self.device)
        """Where a sphere was when its distance to fixed planes and pipes was last measured; that distance [m]."""
        self.wall_load = wp.zeros((self.walls, 2), dtype=wp.int64, device=self.device)
        self.smallest = wp.zeros(self.count, dtype=wp.float64, device=self.device)
        self.fastest = wp.zeros(self.count, dtype=wp.float64, device=self.device)

    def _join(self, parts: list, name: str) -> None:
        """Join the arrays of all scenes; theirs become slices of the joint one."""
        arrays = [getattr(part, name) for part in parts]
        if len(arrays) == 1:
            setattr(self, name, arrays[0])
            return
        joint = wp.empty((sum(len(a) for a in arrays), *arrays[0].shape[1:]), dtype=arrays[0].dtype, device=self.device)
        setattr(self, name, joint)
        first = 0
        for part, array in zip(parts, arrays):
            if len(array):
                view = joint[first : first + len(array)]
                if array.size:
                    wp.copy(view, array)
                setattr(part, name, view)
                first += len(array)

    def _array(self, values, dtype, dimensions: int = 1) -> wp.array:
        if len(values) == 0:
            return wp.zeros((0,) * dimensions, dtype=dtype, device=self.device)
        return wp.array(np.ascontiguousarray(values), dtype=dtype, device=self.device)

    def _numbers(self, counts: list[int]) -> wp.array:
        return self._array(np.repeat(np.arange(self.count), counts), wp.int32)

    def set(self, s: int, **numbers: Any) -> None:
        """Change numbers of a scene's row."""
        if any(np.any(self.rows[name][s] != self.rows.dtype[name].type(value)) for name, value in numbers.items()):
            for name, value in numbers.items():
                self.rows[name][s] = value
            self.scenes.assign(self.rows)

    def _place_pairs(self) -> None:
        self.rows["pairs"] = np.concatenate([[0], np.cumsum(self.capacity)[:-1]])
        self.rows["candidates"] = np.concatenate([[0], np.cumsum(self.face_capacity)[:-1]])
        self.scenes.assign(self.rows)

    def reserve_pairs(self, wanted: np.ndarray) -> None:
        """Room for at least `wanted` pairs a scene; what the pair arrays hold stays."""
        used = {name for name, (_, used) in pair_types(self.models[0]).items() if used}
        self._regrow(State.PAIR_ARRAYS, self.capacity, wanted, used)

    def reserve_faces(self, wanted: np.ndarray) -> None:
        """Room for at least `wanted` mesh candidates a scene."""
        self._regrow(("candidate_face",), self.face_capacity, wanted, {"candidate_face"})

    def _regrow(self, names: tuple[str, ...], capacity: np.ndarray, wanted: np.ndarray, used: set[str]) -> None:
        old = np.concatenate([[0], np.cumsum(capacity)])
        grown = wanted > capacity
        capacity[grown] = wanted[grown] + wanted[grown] // 4 + 64
        new = np.concatenate([[0], np.cumsum(capacity)])
        if new[-1] > MOST_ENTRIES:
            raise CapacityError(f"{names[0]}: {self.spheres} spheres need {new[-1]} entries, more than {MOST_ENTRIES}")
        for name in names:
            if name not in used:
                continue
            before = getattr(self, name)
            after = wp.zeros(int(new[-1]), dtype=before.dtype, device=self.device)
            for s in range(self.count):
                kept = int(old[s + 1] - old[s])
                if kept:
                    wp.copy(after, before, int(new[s]), int(old[s]), kept)
                setattr(self.states[s], name, after[int(new[s]) : int(new[s + 1])] if self.count > 1 else after)
            setattr(self, name, after)
        self._place_pairs()
        self.void()

    # Chunks of a CPU's threads.

    def split(self) -> None:
        """Chunks of bodies and spheres that threads own, from the order of the bodies as it is now."""
        before = self._chunks
        if self.threads == 1:
            self.body_chunks = np.array([0, self.bodies])
            self.sphere_chunks = np.array([0, self.spheres])
        else:
            first = self.body_first.numpy()
            wanted = self.spheres * np.arange(self.threads + 1) // self.threads
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
            self.void()

    # Launching.

    def void(self) -> None:
        """Recorded launches hold arrays or chunks that are no more."""
        self._launcher.void()
        self.version += 1
        self._stages: list[list] | None = None
        self._publish: Any = None

    @property
    def stages(self) -> list[list]:
        """Stages of one step, a list for each thread."""
        if self._stages is None:
            self._stages = step_stages(self)
        return self._stages

    def goal(self, s: int, steps: int) -> None:
        """Let a scene go on until it has completed so many steps."""
        self.goals[s] = steps
        row = self.host_flags()[s]
        row[int(GOAL)] = steps
        row[int(HALTED)] = int(row[int(STEPS)] >= steps or row[int(STALE)] != 0 or row[int(FAILED)] != 0)
        self._unsent = True

    def host_flags(self) -> np.ndarray:
        """All flags as they are on the device; what is changed here goes there with the next launch."""
        flags = self._flags
        if flags is None:
            flags = self._flags = self.flags.numpy()
        return flags

    def host_clock(self) -> np.ndarray:
        """All clocks as they are on the device, to read."""
        clock = self._clock
        if clock is None:
            clock = self._clock = self.clock.numpy()
        return clock

    def changed(self) -> None:
        """Flags or clocks on the device are others than those read last."""
        self._send()
        if self.is_cuda:
            self._flags = self._clock = None

    def _send(self) -> None:
        if self._unsent and self.is_cuda:
            self.flags.assign(self._flags)
        self._unsent = False

    def launch(self) -> np.ndarray:
        """Launch steps until some scene needs looking after; returns a copy of all flags."""
        flags = self.host_flags()
        left = np.where(flags[:, int(HALTED)] == 0, flags[:, int(GOAL)] - flags[:, int(STEPS)], 0)
        count = int(left.max(initial=0))
        if self.count > 1:
            count = min(count, BATCH_LAUNCH)
        elif self.is_cuda:
            # A scene that goes stale leaves the rest of what is in flight to idle: expect it when it came last time.
            expected = self._between_builds - self._since_build
            count = min(count, expected if expected > 0 else 16)
        else:
            count = min(count, CPU_LAUNCH)
        before = int(flags[0, int(STEPS)])
        self.changed()
        sizes = graph_sizes(count, LARGEST_GRAPH["cuda" if self.is_cuda else "cpu"])
        flags = np.empty((0, 0)) if self.is_cuda else self.host_flags()
        self._launcher.replay(self.stages, sizes, lambda: bool(flags[:, int(HALTED)].all()))
        self.publish()
        flags = self.host_flags().copy()
        self._since_build += int(flags[0, int(STEPS)]) - before
        return flags

    def built(self) -> None:
        """Lists are new."""
        self._between_builds = max(self._since_build, 8)
        self._since_build = 0

    def in_parts(self, stages: list[Stage]) -> None:
        """Launch stages that chunks have apart, each on a thread of its own."""
        self._launcher.apart(stages)

    def publish(self) -> None:
        """Bring what bodies hold up to date with their spheres."""
        if not self.features.clumps and self.spheres:
            if self._publish is None:
                self._publish = publish_stage(self)
            self._publish()
