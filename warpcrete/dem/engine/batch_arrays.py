"""Device arrays of a batch, in which the arrays of all scenes are joined end to end."""

from abc import abstractmethod
from collections.abc import Sequence

import numpy as np
import warp as wp

from ...core.device.arrays import DeviceArray, HostArray, Struct, copy_array, declared, empty, zeros
from ...core.device.device import parallel
from ...core.errors import CapacityError
from ...geometry.surfaces import Surfaces
from ...geometry.walls import MeshWall
from ...kernels.common.types import types
from ...kernels.common.walls import FIXED, MESH
from ...kernels.dem.bond_parallel import MOST_ROWS
from ...kernels.dem.structs import array_structs, scene_struct
from .launch_planner import NEVER
from .links import copy_links, make_even, make_links
from .model import Model
from .state import PAIR_ARRAYS, STRUCTS, State, pair_bytes, state_fields, struct_of
from .struct_types import Bodies, Candidates, Pairs, Scenes, Slots, Spheres, Walls

MAXIMUM_ENTRIES = 2**31 - 2**20  # Maximum length of a neighbour list that 32-bit indices allow, with a reserve.
FULL = 0.9
"""If one list must be enlarged, all other lists that fill more than this fraction of their memory are enlarged, too.

Enlarging a list replaces arrays of the batch and discards all recorded launches, so it should happen rarely.
"""


class JointArrays:
    """Device arrays of all scenes of a batch, joined end to end; all scenes must use the same kernels."""

    flags: DeviceArray
    """Control flags of all scenes, for example whether a scene is halted or its lists are stale, shape (scenes,
    FLAGS)."""
    scenes: Scenes
    """Clocks and parameters of all scenes, in a struct `Scenes` of arrays (see `kernels/dem/structs.py`)."""
    bodies: Bodies
    spheres: Spheres
    slots: Slots
    pairs: Pairs
    candidates: Candidates
    walls: Walls
    corners: DeviceArray
    """Corners of the triangles of all mesh walls, each in the coordinate frame of its wall [m], shape (corners,)."""
    faces: DeviceArray
    """Indices in `corners` of the three corners of each triangle of all meshes, shape (faces, 3)."""
    across: DeviceArray
    """Neighbours of each triangle across its three edges, shape (faces, 6).

    Each edge joins a triangle to a neighbouring triangle. The first three columns contain, for each edge, the index of
    the neighbour's corner opposite the edge. The last three columns contain the indices of the neighbours.
    :meth:`Surfaces.across` describes the codes for edges without exactly one neighbour.
    """
    ring_start: DeviceArray
    """Index in `ring` at which each adjacency list begins, and the end of the last list, shape (lists + 1,).

    There is a list for each mesh corner, followed by a list for each edge shared by three or more triangles.
    """
    ring: DeviceArray
    """Adjacency lists of all mesh corners, then of all shared edges, joined end to end, shape (entries,).

    Each list begins with the lowest index of the triangles that meet at the corner or edge. The indices of the mesh
    corners around that corner or edge follow.
    """
    face_wall: DeviceArray
    """Index of the wall to which each triangle belongs, shape (faces,)."""
    pair_parameters: DeviceArray
    """Parameters of the contact laws between bodies, one row for each ordered pair of materials, shape (rows,). The
    rows of all scenes are joined end to end."""
    wall_parameters: DeviceArray
    """Parameters of the contact laws between bodies and walls, one row for each ordered pair of materials, shape
    (rows,). The rows of all scenes are joined end to end."""
    bond_parameters: DeviceArray
    """Parameters of each kind of bond, for example of hydrated bonds, for all scenes end to end, shape (kinds,)."""
    segments: DeviceArray
    """Straight and curved segments of all pipe axes and of the axes along which forces drive bodies, for all scenes end
    to end, shape (segments,)."""
    drive_axis: DeviceArray
    """Range in `segments` of the pipe axis along which a force drives each body group, shape (groups, 2).

    The columns are the index of the first segment and the index after the last segment. The two are equal for a group
    without a driving force.
    """
    drive_force: DeviceArray
    """Driving force along the pipe axis on each single body of a group [N], shape (groups,)."""
    rows: np.ndarray
    """Copy of `scenes.row` on the host: the parameters of all scenes, as a structured array of shape (scenes,)."""
    slot_scene: DeviceArray
    """Index of the scene to which each entry of `pairs.start` belongs, shape (spheres + scenes,). The array
    `pairs.start` contains the index of each sphere's first list entry and, for each scene, the end of its list."""

    def __init__(self, models: list[Model], states: list[State], threads: int) -> None:
        """Join the arrays of all models (constant data) and states (changing data) of the scenes.

        Each of the `threads` CPU threads gets its own array of wall forces.
        """
        model = models[0]
        self.models, self.states = models, states
        self.features, self.scalar, self.device = model.features, model.scalar, model.device
        self.parallel = parallel(self.device)
        self.threads = threads
        self.count = len(models)
        self.body_count = sum(s.body_count for s in states)
        self.sphere_count = sum(s.sphere_count for s in states)
        self.wall_count = sum(len(m.walls) for m in models)
        self.structs = array_structs(self.scalar)
        if self.parallel:
            make_even(states)
        self.capacity = np.array([len(s.pairs.other) for s in states])
        """Number of neighbour list entries for which each scene has memory, shape (scenes,)."""
        self.face_capacity = np.array([len(s.candidates.face) for s in states])
        """Number of mesh candidates (pairs of a sphere and a triangle near it) for which each scene has memory, shape
        (scenes,)."""
        self.load_capacity = np.array([len(s.pairs.load) for s in states])
        """For each scene, the number of bonds whose force and moment fit into its memory, shape (scenes,).

        The number is not used if contacts can form bonds during the run: each entry of the neighbour list then has
        memory for the force and moment of a bond.
        """
        self._join_states()
        self._join_models()
        self._place_pairs()
        self.links = make_links(self)

    @property
    def kernel_arrays(self) -> dict[str, object]:
        """Arrays and structs of all scenes, by the names of the kernel parameters that receive them."""
        return {
            "flags": self.flags,
            "scenes": self.scenes,
            "bodies": self.bodies,
            "spheres": self.spheres,
            "slots": self.slots,
            "pairs": self.pairs,
            "links": self.links,
            "candidates": self.candidates,
            "walls": self.walls,
            "corners": self.corners,
            "faces": self.faces,
            "across": self.across,
            "ring_start": self.ring_start,
            "ring": self.ring,
            "face_wall": self.face_wall,
            "pair_parameters": self.pair_parameters,
            "wall_parameters": self.wall_parameters,
            "bond_parameters": self.bond_parameters,
            "segments": self.segments,
            "drive_axis": self.drive_axis,
            "drive_force": self.drive_force,
            "slot_scene": self.slot_scene,
        }

    @abstractmethod
    def invalidate_graphs(self) -> None:
        """Discard recorded launches, because arrays or the division of bodies among CPU threads have changed."""

    def _join_states(self) -> None:
        """Join the arrays of all states, replace the states' arrays by slices, and allocate the remaining arrays."""
        for struct in STRUCTS:
            setattr(self, struct, struct_of(self.structs, struct)())
        for struct, names in state_fields(self.structs).items():
            for name in names:
                joint = self._join([getattr(state, struct) for state in self.states], name)
                setattr(getattr(self, struct), name, joint)
        self.flags = self._join(self.states, "flags")
        n = self.sphere_count
        counts = [s.sphere_count for s in self.states]
        vec4 = struct_of(self.structs, "spheres").vars["clear"].type.dtype
        self.spheres.scene = self._numbers(counts)
        self.spheres.clear = zeros(n if self.features.analytic else 0, dtype=vec4, device=self.device)
        meshed = n if self.features.meshes else 0
        self.candidates.near_count = zeros(meshed, dtype=wp.int32, device=self.device)
        self.candidates.chosen = zeros(meshed, dtype=vec4, device=self.device)
        self._clear_near_candidates()
        self.bodies.scene = self._numbers([s.body_count for s in self.states])
        self.slot_scene = self._numbers([n + 1 for n in counts])

    def _join(self, parts: Sequence[object], name: str) -> DeviceArray:
        """Return the arrays `name` of several objects, joined end to end.

        `parts` contains one object for each scene. The array of each object is replaced by its slice of the joint
        array.
        """
        arrays: list[DeviceArray] = [getattr(part, name) for part in parts]
        if len(arrays) == 1:
            return arrays[0]
        joint = empty((sum(len(a) for a in arrays), *arrays[0].shape[1:]), dtype=arrays[0].dtype, device=self.device)
        first = 0
        for part, array in zip(parts, arrays):
            if array.size:  # Warp cannot copy an array with 0 columns, which a scene without walls may have.
                view = joint[first : first + len(array)]
                copy_array(view, array)
                setattr(part, name, view)
            first += len(array)
        return joint

    def _join_models(self) -> None:
        models = self.models
        self._settings: list[dict[str, float]] = [{} for _ in models]
        row = declared(scene_struct(self.scalar))
        self.rows = np.zeros(self.count, dtype=row.numpy_dtype())
        segments = [m.segments.numpy() for m in models]
        first_segment = np.concatenate([[0], np.cumsum([len(s) for s in segments])])
        tables: list[HostArray] = []
        drives: list[HostArray] = []
        surfaces = Surfaces()
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
                    vertices, faces, _ = wall.surface
                    table["first_face"][w] = surfaces.add(vertices, faces, first["walls"] + w)
            tables.append(table)
            drives.append(model.drive_axis.numpy() + first_segment[s])
            self._set_constants(
                s, model, state, walls_fixed=bool(np.all(table["motion"][: model.analytic_walls] == int(FIXED)))
            )
            first["bodies"] += state.body_count
            first["spheres"] += state.sphere_count
            first["walls"] += len(model.walls)
            first["laws"] += len(model.pair_parameters)
            first["bonds"] += len(model.bond_parameters)
            first["groups"] += len(model.groups)
        for name in ("pair_parameters", "wall_parameters", "bond_parameters", "drive_force", "segments"):
            setattr(self, name, self._concatenate([getattr(model, name) for model in models]))
        self.drive_axis = self._array(np.concatenate(drives), wp.int32)
        self.scenes.row = self._array(self.rows, row)
        self.walls.scene = self._numbers([len(m.walls) for m in models])
        self.walls.table = self._array(np.concatenate(tables), models[0].wall_table.dtype)
        self.walls.rest_position = self._concatenate([m.rest_position for m in models])
        self.walls.step_force = zeros((self.threads, self.wall_count, 6), dtype=wp.int64, device=self.device)
        self.corners = self._array(surfaces.corners(), types(self.scalar).vec3)
        self.faces = self._array(surfaces.faces(), wp.int32, 2)
        self.across = self._array(surfaces.across(), wp.int32, 2)
        self.ring_start = self._array(surfaces.ring_start(), wp.int32)
        self.ring = self._array(surfaces.ring(), wp.int32)
        self.face_wall = self._array(surfaces.owner(), wp.int32)

    def _set_constants(self, s: int, model: Model, state: State, *, walls_fixed: bool) -> None:
        """Set the constant parameters of scene `s` on the host; `walls_fixed` is True if no plane or pipe moves."""
        row = self.rows
        row["body_count"][s], row["sphere_count"][s] = state.body_count, state.sphere_count
        row["wall_count"][s], row["analytic"][s] = len(model.walls), model.analytic_walls
        row["walls_fixed"][s] = walls_fixed
        row["materials"][s] = len(model.materials)
        row["gravity"][s] = model.scene.gravity
        row["speed_limit"][s] = model.scene.watch.speed
        row["mesh_speed"][s] = model.mesh_speed
        row["largest_radius"][s] = state.largest_radius
        row["growth_end"][s] = 1.0
        row["until"][s], row["interval"][s] = np.inf, NEVER
        row["wall_stiffness"][s] = np.pi * model.stress_scale * state.largest_radius

    def _concatenate(self, arrays: list[DeviceArray]) -> DeviceArray:
        """Return constant arrays joined end to end; a single array is returned uncopied, because nothing changes it."""
        if len(arrays) == 1:
            return arrays[0]
        joint = empty(sum(len(a) for a in arrays), dtype=arrays[0].dtype, device=self.device)
        first = 0
        for array in arrays:
            if len(array):
                copy_array(joint[first : first + len(array)], array)
                first += len(array)
        return joint

    def _array(self, values: HostArray, dtype: type | Struct, dimensions: int = 1) -> DeviceArray:
        if len(values) == 0:
            return zeros((0,) * dimensions, dtype=dtype, device=self.device)
        return DeviceArray(np.ascontiguousarray(values), dtype=dtype, device=self.device)

    def _numbers(self, counts: list[int]) -> DeviceArray:
        return self._array(np.repeat(np.arange(self.count), counts), wp.int32)

    def set(self, s: int, **numbers: float) -> None:
        """Change parameters of scene `s` on host and device.

        `numbers` maps field names of the struct `SceneRow` to new values.
        """
        # Return early if nothing changes, because steppers often set values that are already set.
        if numbers.items() <= self._settings[s].items():
            return
        if any(np.any(self.rows[name][s] != self.rows.dtype[name].type(value)) for name, value in numbers.items()):
            for name, value in numbers.items():
                self.rows[name][s] = value
            self.scenes.row.assign(self.rows)
        self._settings[s] |= numbers

    def _place_pairs(self) -> None:
        self.rows["pairs"] = np.concatenate([[0], np.cumsum(self.capacity)[:-1]])
        self.rows["candidates"] = np.concatenate([[0], np.cumsum(self.face_capacity)[:-1]])
        loads = self.capacity if self.features.healing else self.load_capacity
        self.rows["loads"] = np.concatenate([[0], np.cumsum(loads)[:-1]])
        self.scenes.row.assign(self.rows)

    def reserve_pairs(self, wanted: np.ndarray) -> None:
        """Enlarge the neighbour lists so that each scene has room for its number of pairs in `wanted`, shape (scenes,).

        The current pairs are kept. Raises :class:`CapacityError` if the arrays would be too long.
        """
        if not np.any(wanted > self.capacity):
            return
        used = [name for name in PAIR_ARRAYS if name in pair_bytes(self.models[0])]
        if self.features.healing and np.any(wanted > MOST_ROWS):
            raise CapacityError(
                f"bonds = {wanted.max()}: too many pairs of neighbours could form bonds; one scene can hold at most "
                f"{MOST_ROWS} bonds; use fewer or larger aggregates"
            )
        before, old = self.links, self.capacity.copy()
        # The array `result` contains the contact forces of all pairs in the neighbour lists. It is the largest array,
        # so free it before new arrays are allocated. Its values are not needed, because every step computes the forces
        # again.
        before.result = None
        self._regrow("pairs", used, self.capacity, wanted)
        self.links = make_links(self)
        if self.parallel:
            copy_links(before, old, self.links, self.capacity)

    def reserve_loads(self, s: int, wanted: int) -> None:
        """Enlarge `load`, the array of forces and moments of the bonds, to at least `wanted` rows for scene `s`.

        Other scenes of the batch that have no bonds yet will probably create bonds soon. Each of them gets rows in
        proportion to its number of spheres.
        """
        spheres = self.rows["sphere_count"].astype(np.int64)
        each = np.where(self.load_capacity <= 1, wanted * spheres // max(spheres[s], 1), 0)
        each[s] = wanted
        self._regrow("pairs", ["load"], self.load_capacity, each)

    def reserve_faces(self, wanted: np.ndarray) -> None:
        """Enlarge the lists of mesh candidates (triangles near a sphere).

        The new numbers of candidates are in `wanted`, shape (scenes,).
        """
        if np.any(wanted > self.face_capacity):
            self._regrow("candidates", ["face"], self.face_capacity, wanted)
            self._clear_near_candidates()

    def _clear_near_candidates(self) -> None:
        """Allocate an empty list of near candidates, which are the triangles that may touch a sphere soon.

        The list has room for all mesh candidates. Each sphere selects its near candidates again in the next step.
        """
        self.candidates.near = zeros(len(self.candidates.face), dtype=wp.int32, device=self.device)
        self.candidates.chosen.zero_()

    def _regrow(self, struct: str, names: list[str], capacity: np.ndarray, wanted: np.ndarray) -> None:
        if not np.any(wanted > capacity):
            return
        old = np.concatenate([[0], np.cumsum(capacity)])
        grown = wanted > FULL * capacity
        capacity[grown] = (wanted[grown] + wanted[grown] // 4 + 64) // 2 * 2
        # If contacts can form bonds during the run, every list entry has a row for bond forces, and the number of rows
        # is limited to MOST_ROWS.
        if struct == "pairs" and self.features.healing:
            np.minimum(capacity, MOST_ROWS, out=capacity)
        new = np.concatenate([[0], np.cumsum(capacity)])
        # On a GPU, the forces of a pair take up to four rows of the array `result`, and a pair has two list entries.
        # The array may therefore have twice as many rows as the list has entries, and its row numbers must still be
        # 32-bit integers.
        most = MAXIMUM_ENTRIES // 2 if self.parallel and struct == "pairs" else MAXIMUM_ENTRIES
        if new[-1] > most:
            raise CapacityError(
                f"spheres = {self.sphere_count}: would need a list of {new[-1]} {struct}, but the maximum length is "
                f"{most}; use fewer spheres"
            )
        for name in names:
            before: DeviceArray = getattr(getattr(self, struct), name)
            after = zeros(int(new[-1]), dtype=before.dtype, device=self.device)
            for s, state in enumerate(self.states):
                kept = int(old[s + 1] - old[s])
                if kept:
                    copy_array(after, before, int(new[s]), int(old[s]), kept)
                view = after
                if self.count > 1:
                    empty = new[s] == new[s + 1]  # Warp cannot make a slice of length 0.
                    view = after[:1] if empty else after[int(new[s]) : int(new[s + 1])]
                setattr(getattr(state, struct), name, view)
            setattr(getattr(self, struct), name, after)
        self._place_pairs()
        self.invalidate_graphs()
