"""State: the arrays that change during a run, and the host-side table of bodies it is made from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from .clumps import ClumpTemplate, sphere
from .errors import refuse
from .kernels.contacts import ALL_TOUCHED
from .kernels.mesh_walls import MESH_SLOTS
from .kernels.types import CLOCK, DT, FLAGS, FORCE_SCALE, STABLE, STEPS, TIME, types
from .model import Model
from .scene import Scene


@dataclass
class BodyTable:
    """Bodies on the host, one row each, in order of their permanent numbers."""

    position: np.ndarray
    """Centroids [m], shape (n, 3)."""
    orientation: np.ndarray
    """Unit quaternions x, y, z, w from body to space, shape (n, 4)."""
    velocity: np.ndarray
    """[m/s], shape (n, 3)."""
    spin: np.ndarray
    """In space [rad/s], shape (n, 3)."""
    size: np.ndarray
    """Diameter of the sphere of equal volume [m], shape (n,)."""
    template: np.ndarray
    """Index into `templates`, shape (n,)."""
    density: np.ndarray
    """[kg/m3], shape (n,)."""
    material: list[str]
    group: list[str]
    templates: tuple[ClumpTemplate, ...]

    def __len__(self) -> int:
        return len(self.size)

    @property
    def volume(self) -> np.ndarray:
        """Volume of each body [m3], shape (n,)."""
        return np.pi / 6 * self.size**3

    @property
    def mass(self) -> np.ndarray:
        """[kg], shape (n,)."""
        return self.density * self.volume

    @staticmethod
    def empty() -> BodyTable:
        """A table without rows."""
        none = np.zeros((0, 3))
        return BodyTable(none, np.zeros((0, 4)), none, none, np.zeros(0), np.zeros(0, int), np.zeros(0), [], [], ())

    def joined(self, other: BodyTable) -> BodyTable:
        """Both tables in a row."""
        templates = list(self.templates)
        for template in other.templates:
            if all(template is not known for known in templates):
                templates.append(template)
        place = np.array([next(i for i, k in enumerate(templates) if k is t) for t in other.templates], dtype=int)
        renumbered = place[other.template] if len(other.templates) else other.template
        return BodyTable(
            *(
                np.concatenate([getattr(self, name), getattr(other, name)])
                for name in ("position", "orientation", "velocity", "spin", "size")
            ),
            np.concatenate([self.template, renumbered]).astype(int),
            np.concatenate([self.density, other.density]),
            self.material + other.material,
            self.group + other.group,
            tuple(templates),
        )


def placed_bodies(scene: Scene) -> BodyTable:
    """Table of the bodies that the scene places one by one."""
    table = BodyTable.empty()
    for bodies in scene.bodies:
        n = len(bodies.positions)
        identity = np.tile([0.0, 0.0, 0.0, 1.0], (n, 1))
        zero = np.zeros((n, 3))
        table = table.joined(
            BodyTable(
                bodies.positions,
                identity if bodies.orientations is None else bodies.orientations,
                zero if bodies.velocities is None else bodies.velocities,
                zero if bodies.spins is None else bodies.spins,
                bodies.sizes,
                np.zeros(n, int),
                np.full(n, bodies.density),
                [bodies.material] * n,
                [bodies.group] * n,
                (bodies.template or sphere(),),
            )
        )
    return table


class State:
    """Everything that changes in one scene, on the model's device.

    Bodies and spheres may be re-sorted in memory; `body_id` and `sphere_id` are their permanent numbers. The
    spheres of a body stand in a row. In a batch the arrays are slices of those of all scenes. What the scene's
    features do not need has no rows.
    """

    BODY_ARRAYS = (
        "body_id", "body_template", "body_group", "body_size", "body_mass", "body_inertia", "body_position",
        "body_rounding", "body_velocity", "body_spin", "body_orientation", "body_angular_momentum",
    )  # fmt: skip
    SPHERE_ARRAYS = (
        "sphere_id", "sphere_material", "sphere_offset", "sphere_position", "sphere_velocity", "sphere_spin",
        "sphere_built", "force", "moment", "sphere_lost", "sphere_broken", "sphere_touching", "slot_touching",
        "slot_history", "slot_normal", "slot_overlap", "slot_wall",
    )  # fmt: skip
    WALL_ARRAYS = (
        "wall_position_exact", "wall_velocity_exact", "wall_position", "wall_orientation", "wall_normal",
        "wall_velocity", "wall_spin", "wall_force", "wall_moment", "wall_impulse", "wall_angular_impulse",
        "wall_travel", "wall_work", "wall_moved",
    )  # fmt: skip
    SCENE_ARRAYS = ("reference_velocity", "scale", "clock", "flags")
    PAIR_ARRAYS = ("pair_other", "pair_history", "pair_bond", "pair_bond_force", "pair_bond_moment")

    def __init__(self, model: Model, table: BodyTable) -> None:
        self.model = model
        self.templates = table.templates
        t = types(model.scalar)
        scalar = model.scalar
        n = len(table)

        counts = np.array([len(template.radii) for template in table.templates], dtype=int)[table.template] if n else []
        first = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
        spheres = int(first[-1])
        body_of = np.repeat(np.arange(n), counts).astype(np.int32)
        offsets = np.zeros((spheres, 4))
        inertia = np.zeros((n, 3))
        for number, template in enumerate(table.templates):
            members = np.flatnonzero(table.template == number)
            k = len(template.radii)
            rows = (first[members][:, None] + np.arange(k)).ravel()
            unit = np.concatenate([template.offsets, template.radii[:, None]], axis=1)
            offsets[rows] = (table.size[members][:, None, None] * unit).reshape(-1, 4)
            inertia[members] = template.inertia * (table.mass[members] * table.size[members] ** 2)[:, None]
        self.body_count, self.sphere_count = n, spheres
        self.largest_radius = float(offsets[:, 3].max(initial=0.0))
        self.mean_radius = float(offsets[:, 3].mean()) if spheres else 1.0
        self.smallest_radius = float(offsets[:, 3].min(initial=np.inf)) if spheres else 0.0

        arms = rotate(table.orientation[body_of], offsets[:, :3])
        position = np.concatenate([table.position[body_of] + arms, offsets[:, 3:]], axis=1)
        carried = table.velocity[body_of] + np.cross(table.spin[body_of], arms)
        velocity = np.concatenate([carried, table.mass[body_of][:, None]], axis=1)
        local_spin = rotate(table.orientation, table.spin, inverse=True)
        angular_momentum = rotate(table.orientation, local_spin * inertia)
        for name in sorted(set(table.material)):
            if name not in model.materials:
                refuse("material", name, f"must be one of {', '.join(model.materials)}")

        def array(data, dtype):
            return wp.array(np.ascontiguousarray(data), dtype=dtype, device=model.device)

        def zeros(shape, dtype):
            return wp.zeros(shape, dtype=dtype, device=model.device)

        self.body_id = array(np.arange(n), wp.int32)
        self.body_template = array(table.template, wp.int32)
        self.body_group = array([model.groups.index(g) for g in table.group], wp.int32)
        self.body_size = array(table.size, scalar)
        self.body_mass = array(table.mass, scalar)
        self.body_inertia = array(inertia, t.vec3)
        self.body_first = array(first, wp.int32)
        self.body_position = array(table.position, t.vec3)
        self.body_rounding = zeros(n, t.vec3)
        self.body_velocity = array(table.velocity, t.vec3)
        self.body_spin = array(table.spin, t.vec3)
        self.body_orientation = array(table.orientation, t.quat)
        self.body_angular_momentum = array(angular_momentum, t.vec3)

        self.sphere_id = array(np.arange(spheres), wp.int32)
        self.sphere_body = array(body_of, wp.int32)
        self.sphere_material = array(
            np.array([model.materials.index(m) for m in table.material], dtype=int)[body_of] if n else [], wp.int32
        )
        self.sphere_offset = array(offsets, t.vec4)
        self.sphere_position = array(position, t.vec4)
        self.sphere_velocity = array(velocity, t.vec4)
        self.sphere_spin = array(table.spin[body_of], t.vec3)
        self.sphere_built = array(position, t.vec4)
        self.force = zeros(spheres, t.vec3)
        self.moment = zeros(spheres, t.vec3)
        features = model.features
        self.sphere_lost = zeros(spheres if features.losses else 0, wp.float64)
        self.sphere_broken = zeros(spheres if features.bonds else 0, wp.vec2i)
        self.sphere_touching = array(
            np.full(spheres if features.history or features.bonds else 0, ALL_TOUCHED), wp.int32
        )
        self.chunks = [0, spheres]
        """First sphere of every chunk of a half list, and the end of the last."""
        self.total_mass = float(np.sum(table.mass))
        self.batch: Any = None
        self.index = 0
        """The batch that holds the arrays, and the scene's number in it."""
        self._scratch: dict[str, wp.array] = {}

        self.pair_start = zeros(spheres + 1, wp.int32)
        self.pair_total = 0
        self.pair_other, self.pair_history, self.pair_bond, self.pair_bond_force, self.pair_bond_moment = (
            zeros(1 if used else 0, dtype) for dtype, used in pair_types(model).values()
        )
        self.candidate_start = zeros(spheres + 1 if features.meshes else 0, wp.int32)
        self.candidate_face = zeros(1 if features.meshes else 0, wp.int32)

        walls = len(model.walls)
        slots = model.analytic_walls + (MESH_SLOTS if model.features.meshes else 0)
        meshed = spheres if features.meshes else 0
        self.slot_touching = zeros(spheres if walls else 0, wp.int32)
        self.slot_history = zeros((spheres, slots), t.vec3)
        self.slot_normal = zeros((meshed, slots), t.vec3)
        self.slot_overlap = zeros((meshed, slots), scalar)
        self.slot_wall = array(np.full((meshed, slots), -1), wp.int32) if meshed else zeros((0, slots), wp.int32)
        self.wall_position_exact = wp.clone(model.rest_position)
        self.wall_velocity_exact = zeros(walls, wp.vec3d)
        self.wall_position = array(model.rest_position.numpy().reshape(-1, 3), t.vec3)
        self.wall_orientation = array(np.tile([0.0, 0, 0, 1], (walls, 1)), t.quat)
        normals = [getattr(wall, "normal", (0.0, 0.0, 0.0)) for wall in model.walls]
        self.wall_normal = array(np.reshape(normals, (-1, 3)), t.vec3)
        self.wall_velocity = zeros(walls, t.vec3)
        self.wall_spin = zeros(walls, t.vec3)
        self.wall_force = zeros(walls, wp.vec3d)
        self.wall_moment = zeros(walls, wp.vec3d)
        self.wall_impulse = zeros(walls, wp.vec3d)
        self.wall_angular_impulse = zeros(walls, wp.vec3d)
        self.wall_travel = zeros(walls, wp.float64)
        self.wall_work = zeros(walls, wp.float64)
        self.wall_moved = zeros(walls, wp.float64)

        self.reference_velocity = zeros(1, t.vec3)
        self.scale = array([1.0], scalar)
        clock = np.zeros((1, CLOCK))
        typical_force = model.stress_scale * (2 * max(self.largest_radius, 1e-12)) ** 2
        # 2^62 units hold a hundred thousand such forces; one unit is 5e-14 of one.
        clock[0, int(FORCE_SCALE)] = 2.0 ** np.floor(np.log2(2.0**44 / typical_force))
        self.clock = array(clock, wp.float64)
        self.flags = zeros((1, FLAGS), wp.int32)

    def scratch(self, name: str, shape: tuple[int, ...], dtype) -> wp.array:
        """Memory that a probe may write to, the same at every call."""
        if name not in self._scratch or self._scratch[name].shape != shape:
            self._scratch[name] = wp.empty(shape, dtype=dtype, device=self.model.device)
        return self._scratch[name]

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self._row("clock")[int(TIME)]

    @property
    def steps(self) -> int:
        """Completed steps."""
        return self._row("flags")[int(STEPS)]

    @property
    def dt(self) -> float:
        """Size of the next step [s]."""
        return self._row("clock")[int(DT)]

    @property
    def stable_step(self) -> float:
        """As last estimated [s]."""
        return self._row("clock")[int(STABLE)]

    def _row(self, name: str) -> list[Any]:
        if self.batch is None:
            return getattr(self, name).numpy()[0].tolist()
        return getattr(self.batch, f"host_{name}")()[self.index].tolist()

    @property
    def bytes(self) -> int:
        """Size of all arrays of the state [B]."""
        return sum(
            a.size * wp.types.type_size_in_bytes(a.dtype) for a in vars(self).values() if isinstance(a, wp.array)
        )

    def table(self) -> BodyTable:
        """Bodies as they are now, in order of their permanent numbers."""
        order = np.argsort(self.body_id.numpy())
        scale = float(self.scale.numpy()[0])
        group = self.body_group.numpy()[order]
        first = self.body_first.numpy()[:-1][order]
        material = self.sphere_material.numpy()[first] if len(order) else []
        size = self.body_size.numpy()[order].astype(float) * scale
        return BodyTable(
            position=self.body_position.numpy()[order].astype(float),
            orientation=self.body_orientation.numpy()[order].astype(float),
            velocity=self.body_velocity.numpy()[order].astype(float),
            spin=self.body_spin.numpy()[order].astype(float),
            size=size,
            template=self.body_template.numpy()[order].astype(int),
            density=self.body_mass.numpy()[order].astype(float) / (np.pi / 6 * size**3),
            material=[self.model.materials[m] for m in material],
            group=[self.model.groups[g] for g in group],
            templates=self.templates,
        )


def pair_types(model: Model) -> dict[str, tuple[type, bool]]:
    """Type of every array that has an entry for each listed pair, and whether the scene needs it."""
    t, features = types(model.scalar), model.features
    return {
        "pair_other": (wp.int32, True),
        "pair_history": (t.vec3, features.history),
        "pair_bond": (wp.int32, features.bonds),
        "pair_bond_force": (t.vec4, features.bonds),
        "pair_bond_moment": (t.vec4, features.bonds),
    }


def rotate(quaternions: np.ndarray, vectors: np.ndarray, inverse: bool = False) -> np.ndarray:
    """Rotate `vectors` (n, 3) by unit quaternions x, y, z, w (n, 4)."""
    axis, w = quaternions[:, :3], quaternions[:, 3:]
    if inverse:
        axis = -axis
    twice = 2 * np.cross(axis, vectors)
    return vectors + w * twice + np.cross(axis, twice)
