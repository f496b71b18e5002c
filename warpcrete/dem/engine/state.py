"""State: the arrays that change during a run of one scene."""

from collections.abc import Callable, Iterator
from functools import cached_property
from types import SimpleNamespace
from typing import Any, Protocol

import numpy as np
import warp as wp

from ...core.device.arrays import DeviceArray, HostArray, Shape, Struct, bytes_of, clone, empty, zeros
from ...core.device.exchange import Exchange
from ...core.device.launching import Stage
from ...core.errors import refuse
from ...geometry.rotation import rotate
from ...kernels.common.control import FLAGS, STEPS
from ...kernels.dem.mesh_contacts import MESH_SLOTS
from ...kernels.dem.pairs import ALL_TOUCHED
from ...kernels.dem.structs import CLOCK, DT, FORCE_SCALE, STABLE, TIME, array_structs
from ..scene.bodies import BodyTable
from .model import Model
from .struct_types import Bodies, Candidates, Pairs, Scenes, Slots, Spheres, Walls

STRUCTS = ("scenes", "bodies", "spheres", "slots", "pairs", "candidates", "walls")
"""Names of the attributes of a state that hold its arrays, grouped in structs."""
OF_BATCH = {
    "scenes": ("row",),
    "bodies": ("scene",),
    "spheres": ("scene", "clear"),
    "candidates": ("near", "near_count", "chosen"),
    "walls": ("scene", "table", "rest_position", "step_force"),
}
"""Names of the arrays that a batch stores, but not the state of each scene; the keys are the names of structs.

The batch calculates these arrays from its models, or needs their values only within a step.
"""
NUMBERS = (
    "body_count", "sphere_count", "largest_radius", "smallest_radius", "mean_radius", "total_mass", "chunks",
)  # fmt: skip
"""Names of the attributes of a state, besides its arrays, that a checkpoint stores."""


def state_fields(structs: SimpleNamespace) -> dict[str, tuple[str, ...]]:
    """Return, for each struct of a state, the names of the arrays that a state stores: all except those in OF_BATCH."""
    stored_fields: dict[str, tuple[str, ...]] = {}
    for name in STRUCTS:
        fields = struct_of(structs, name).vars
        stored_fields[name] = tuple(field for field in fields if field not in OF_BATCH.get(name, ()))
    return stored_fields


class HoldingBatch(Protocol):
    """Protocol of the batch to which a state belongs, for modules that cannot import the class `Batch`.

    The module `state` cannot import it, because the module `batch` imports `state`. The measuring functions in `probes`
    access a batch only through a state.
    """

    device: wp.Device
    exchange: Exchange
    version: int
    """Number that increases whenever arrays or the division of bodies among CPU threads change, which makes recorded
    launches invalid."""
    rows: np.ndarray
    """Host copy of the parameters of all scenes, as a structured array of shape (scenes,)."""

    @property
    def kernel_arrays(self) -> dict[str, object]:
        """Arrays and structs of all scenes, by the names of the kernel parameters that receive them."""
        ...

    @cached_property
    def wall_array(self) -> DeviceArray:
        """Device array for forces, travel and other values of all walls, shape (walls, WALL_COLUMNS)."""
        ...

    def wall_stage(self) -> Stage:
        """Return the launch that writes forces, travel and other values of all walls to `wall_array`."""
        ...

    def own_walls(self, s: int, values: np.ndarray) -> np.ndarray:
        """Return the rows of `values` for the walls of scene `s`; `values` has one row for each wall of the batch."""
        ...

    def host_flags(self) -> np.ndarray:
        """Return the control flags of all scenes, such as halted or failed, shape (scenes, FLAGS)."""
        ...

    def host_clock(self) -> np.ndarray:
        """Return simulated time, time step and other time data of each scene, shape (scenes, CLOCK).

        `kernels/dem/structs.py` lists the columns and their units. Callers must not change the array.
        """
        ...

    def reserve_loads(self, s: int, wanted: int) -> None:
        """Enlarge the array of bond loads (forces and moments of bonds) to at least `wanted` rows for scene `s`."""


def struct_of(structs: SimpleNamespace, name: str) -> Struct:
    """Return the struct type of the attribute `name` of a state, such as `Bodies` for "bodies".

    `structs` contains all struct types; it comes from `array_structs`.
    """
    return getattr(structs, name.capitalize())


class State:
    """All data of one scene that change during a run, on the model's device.

    The arrays are members of the structs `scenes` (one row), `bodies`, `spheres`, `slots`, `pairs`, `candidates` and
    `walls`; `kernels/dem/structs.py` gives their meanings, units and shapes. Bodies and spheres may be re-sorted in
    memory; `bodies.id` and `spheres.id` are their permanent numbers. The spheres of a body are contiguous. In a batch
    the arrays are slices of the batch's arrays. Arrays that the scene's features do not need are empty.
    """

    flags: DeviceArray
    """Control flags of the scene, such as halted or failed, shape (1, FLAGS); see `kernels/common/control.py`."""
    scenes: Scenes
    """Struct `Scenes` of arrays with one row for this scene, for example its simulated time and its time step."""
    bodies: Bodies
    """Struct `Bodies` of arrays with one row for each body, such as positions and velocities."""
    spheres: Spheres
    """Struct `Spheres` of arrays with one row for each sphere, such as positions and forces."""
    slots: Slots
    """Struct `Slots` of arrays with a row for each sphere. Each column (slot) stores one contact of the sphere
    with a wall."""
    pairs: Pairs
    """Struct `Pairs` of arrays that form the neighbour list, with contact history and bonds."""
    candidates: Candidates
    """Struct `Candidates` of arrays that list the mesh candidates, which are the triangles near each sphere."""
    walls: Walls
    """Struct `Walls` of arrays with one row for each wall, such as positions and impulses (forces summed over time)."""

    def __init__(self, model: Model, table: BodyTable) -> None:
        self.model = model
        self.templates = table.templates
        self.structs = array_structs(model.scalar)
        for name in STRUCTS:
            setattr(self, name, struct_of(self.structs, name)())
        for name in sorted(set(table.material)):
            if name not in model.materials:
                refuse("material", name, f"must be one of {', '.join(model.materials)}")
        first, offsets, inertia = _shapes(table)
        self.body_count, self.sphere_count = len(table), int(first[-1])
        self.largest_radius = float(offsets[:, 3].max(initial=0.0))
        self.mean_radius = float(offsets[:, 3].mean()) if self.sphere_count else 1.0
        self.smallest_radius = float(offsets[:, 3].min(initial=np.inf)) if self.sphere_count else 0.0
        self.total_mass = float(np.sum(table.mass))
        self.chunks = [0, self.sphere_count]
        """Index of the first sphere of every CPU thread, and the number of spheres as the end of the last thread's
        range."""
        self._batch: HoldingBatch | None = None
        self.index = 0
        """Index of the scene in its batch."""
        self._scratch: dict[str, DeviceArray] = {}
        self._launches: tuple[int, dict[str, Callable[[], Any]]] = -1, {}
        self._make_bodies(table, first, inertia)
        self._make_spheres(table, first, offsets)
        self._make_pairs()
        self._make_walls()
        self._make_scene()

    def _fill(self, struct: str, **arrays: HostArray | Shape) -> None:
        """Create arrays of the struct `struct` on the device.

        Each keyword is the name of an array. Its value is the host data of the array, or the shape of an array of
        zeros.
        """
        target = getattr(self, struct)
        variables = struct_of(self.structs, struct).vars
        for name, value in arrays.items():
            dtype, device = variables[name].type.dtype, self.model.device
            if isinstance(value, int | tuple):
                array = zeros(value, dtype=dtype, device=device)
            else:
                array = DeviceArray(np.ascontiguousarray(value), dtype=dtype, device=device)
            setattr(target, name, array)

    def _make_bodies(self, table: BodyTable, first: np.ndarray, inertia: np.ndarray) -> None:
        n = len(table)
        local_spin = rotate(table.orientation, table.spin, inverse=True)
        self._fill(
            "bodies",
            id=np.arange(n),
            scene=n,
            shape=table.template,
            group=np.array([self.model.groups.index(g) for g in table.group], dtype=int),
            size=table.size,
            mass=table.mass,
            inertia=inertia,
            position=table.position,
            rounding=n,
            velocity=table.velocity,
            spin=table.spin,
            orientation=table.orientation,
            angular_momentum=rotate(table.orientation, local_spin * inertia),
            first=first,
        )

    def _make_spheres(self, table: BodyTable, first: np.ndarray, offsets: np.ndarray) -> None:
        n, f = self.sphere_count, self.model.features
        body = np.repeat(np.arange(len(table)), np.diff(first)).astype(np.int32)
        arms = rotate(table.orientation[body], offsets[:, :3])
        position = np.concatenate([table.position[body] + arms, offsets[:, 3:]], axis=1)
        carried = table.velocity[body] + np.cross(table.spin[body], arms)
        material = np.array([self.model.materials.index(m) for m in table.material], dtype=int)
        self._fill(
            "spheres",
            id=np.arange(n),
            scene=n,
            body=body,
            material=material[body],
            offset=offsets,
            position=position,
            velocity=np.concatenate([carried, table.mass[body][:, None]], axis=1),
            spin=np.pad(table.spin[body], ((0, 0), (0, 1))),
            built=position,
            clear=n if f.analytic else 0,
            force=n,
            moment=n,
            touching=np.full(n if not f.half_list or f.history or f.bonds else 0, ALL_TOUCHED),
            dissipated_energy=n if f.dissipation else 0,
            broken=n if f.bonds else 0,
        )

    def _make_pairs(self) -> None:
        n, f = self.sphere_count, self.model.features
        used = pair_bytes(self.model)
        sizes = {name: 1 if name in used else 0 for name in PAIR_ARRAYS}
        self._fill("pairs", start=n + 1, **sizes | {"load": 1 if f.bonds else 0})
        self._fill("candidates", start=n + 1 if f.meshes else 0, face=1 if f.meshes else 0)

    def _make_walls(self) -> None:
        model, n = self.model, self.sphere_count
        walls = len(model.walls)
        meshed = n if model.features.meshes else 0
        worn = (n, walls) if model.features.wear else (0, walls)
        slots = model.analytic_walls + (MESH_SLOTS if model.features.meshes else 0)
        self._fill(
            "slots",
            touching=n if walls else 0,
            history=(n, slots),
            rolling=(n if walls and model.features.wall_law.rolls else 0, slots),
            normal=(meshed, slots),
            overlap=(meshed, slots),
            wall=np.full((meshed, slots), -1) if meshed else (0, slots),
            worn=worn,
            worn_at=worn,
        )
        rest = model.rest_position.numpy().reshape(-1, 3)
        normals = [getattr(wall, "normal", (0.0, 0.0, 0.0)) for wall in model.walls]
        self._fill(
            "walls",
            scene=walls,
            position_exact=rest,
            position=rest,
            orientation=np.tile([0.0, 0, 0, 1], (walls, 1)),
            normal=np.reshape(normals, (-1, 3)),
            **dict.fromkeys(("velocity_exact", "velocity", "spin", "force", "moment", "impulse", "angular_impulse",
                             "travel", "work", "moved"), walls),
        )  # fmt: skip

    def _make_scene(self) -> None:
        clock = np.zeros((1, CLOCK))
        typical_force = self.model.stress_scale * (2 * max(self.largest_radius, 1e-12)) ** 2
        # Wall forces are summed in fixed point, as 64-bit integers. One unit is between 2^-44 and 2^-43, about 1e-13,
        # times `typical_force`. The largest possible sum, 2^63 units, is therefore at least 2^19, or about 5e5, times
        # `typical_force`.
        clock[0, int(FORCE_SCALE)] = 2.0 ** np.floor(np.log2(2.0**44 / typical_force))
        self._fill("scenes", clock=clock, scale=np.ones(1), reference_velocity=1)
        self.flags = zeros((1, FLAGS), dtype=wp.int32, device=self.model.device)

    def arrays(self) -> Iterator[tuple[str, str, DeviceArray]]:
        """Yield the struct name, the array name and the array itself, for all arrays of the state."""
        for struct, names in state_fields(self.structs).items():
            for name in names:
                yield struct, name, getattr(getattr(self, struct), name)

    def scratch(self, name: str, shape: tuple[int, ...], dtype: type) -> DeviceArray:
        """Return an uninitialised device array for temporary values, such as those of measurements.

        Calls with the same name and shape return the same array.
        """
        if name not in self._scratch or self._scratch[name].shape != shape:
            self._scratch[name] = empty(shape, dtype=dtype, device=self.model.device)
        return self._scratch[name]

    def attach_to(self, batch: HoldingBatch, index: int) -> None:
        """Record that this state belongs to the scene with the index `index` of `batch`."""
        self._batch, self.index = batch, index
        self._launches = -1, {}

    def detach(self) -> None:
        """Replace the slices of the batch's arrays by copies, so that the state can move to another batch."""
        for struct, name, array in list(self.arrays()):
            setattr(getattr(self, struct), name, clone(array))
        self.flags = clone(self.flags)
        self._batch = None

    def launches(self, version: int) -> dict[str, Callable[[], Any]]:
        """Return the dictionary in which the functions of `probes` keep the recorded launches of their measurements.

        The keys are names of measurements. `version` is the current version of the batch. If it has changed since the
        last call, the dictionary is emptied, because the recorded launches may refer to arrays that have been replaced.
        """
        if self._launches[0] != version:
            self._launches = version, {}
        return self._launches[1]

    @property
    def batch(self) -> HoldingBatch:
        """Batch to which the state belongs; the state's arrays are slices of the batch's arrays."""
        assert self._batch is not None, "the state is in no batch"
        return self._batch

    @property
    def pair_total(self) -> int:
        """Number of entries of the scene's neighbour list that are in use."""
        return int(self.pairs.start[-1:].numpy()[0])

    @property
    def time(self) -> float:
        """Simulated time that the scene has reached [s]."""
        return self._clock()[int(TIME)]

    @property
    def steps(self) -> int:
        """Number of time steps that the scene has completed."""
        if self._batch is None:
            return int(self.flags.numpy()[0, int(STEPS)])
        return int(self._batch.host_flags()[self.index, int(STEPS)])

    @property
    def dt(self) -> float:
        """Size of the scene's next time step [s]."""
        return self._clock()[int(DT)]

    @property
    def stable_step(self) -> float:
        """Stable time step of the scene according to the latest estimate [s]."""
        return self._clock()[int(STABLE)]

    def _clock(self) -> list[float]:
        if self._batch is None:
            return self.scenes.clock.numpy()[0].tolist()
        return self._batch.host_clock()[self.index].tolist()

    def table(self) -> BodyTable:
        """Return the bodies as they are now, in the order of their permanent numbers."""
        b = self.bodies
        order = np.argsort(b.id.numpy())
        group = b.group.numpy()[order]
        first = b.first.numpy()[:-1][order]
        material: list[int] = self.spheres.material.numpy()[first].tolist() if len(order) else []
        size = b.size.numpy()[order].astype(float) * float(self.scenes.scale.numpy()[0])
        return BodyTable(
            position=b.position.numpy()[order].astype(float),
            orientation=b.orientation.numpy()[order].astype(float),
            velocity=b.velocity.numpy()[order].astype(float),
            spin=b.spin.numpy()[order].astype(float),
            size=size,
            template=b.shape.numpy()[order].astype(int),
            density=b.mass.numpy()[order].astype(float) / (np.pi / 6 * size**3),
            material=[self.model.materials[m] for m in material],
            group=[self.model.groups[g] for g in group],
            templates=self.templates,
        )


PAIR_ARRAYS = ("other", "history", "rolling", "bond", "load")
"""Names of the arrays of the struct `pairs` that have one entry for each listed pair.

A batch allocates only the arrays that its scenes need. The array `load` (force and moment of bonds) has one entry for
each listed pair only if contacts can form bonds during the run. Otherwise it has one entry for each bond.
"""


def pair_bytes(model: Model) -> dict[str, int]:
    """Return the size of one entry [B] of each array with an entry for every listed pair, by array name.

    Arrays that the scene does not need are left out.
    """
    f = model.features
    used = {"other": True, "history": f.history, "rolling": f.pair_law.rolls}
    # The array `load` (force and moment of bonds) has an entry for every listed pair only if contacts can form bonds
    # during the run (healing). Otherwise it has an entry for every bond.
    used |= {"bond": f.bonds, "load": f.healing}
    variables = struct_of(array_structs(model.scalar), "pairs").vars
    return {name: bytes_of(variables[name].type.dtype) for name in PAIR_ARRAYS if used[name]}


def _shapes(table: BodyTable) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the index of each body's first sphere, the spheres' offsets and radii, and the bodies' moments of inertia.

    `table` contains the bodies. The shapes are (bodies + 1,), (spheres, 4) and (bodies, 3). The offset [m] is the
    position of the sphere's centre relative to the body's centroid, in the body's axes; the fourth column is the radius
    [m]. The moments of inertia [kg m2] are principal moments.
    """
    first = np.concatenate([[0], np.cumsum(table.sphere_counts)]).astype(np.int32)
    offsets = np.zeros((int(first[-1]), 4))
    inertia = np.zeros((len(table), 3))
    for number, template in enumerate(table.templates):
        members = np.flatnonzero(table.template == number)
        rows = (first[members][:, None] + np.arange(len(template.radii))).ravel()
        unit = np.concatenate([template.offsets, template.radii[:, None]], axis=1)
        offsets[rows] = (table.size[members][:, None, None] * unit).reshape(-1, 4)
        inertia[members] = template.inertia * (table.mass[members] * table.size[members] ** 2)[:, None]
    return first, offsets, inertia
