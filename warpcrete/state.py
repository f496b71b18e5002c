"""State: the arrays that change during a run, and the host-side table of bodies it is made from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from .clumps import ClumpTemplate, sphere
from .errors import refuse
from .kernels.types import CLOCK, FLAGS, FORCE_SCALE, types
from .kernels.walls import MESH_SLOTS
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
    """Everything that changes, on the model's device.

    Bodies and spheres may be re-sorted in memory; `body_id` and `sphere_id` are their permanent numbers. The
    spheres of a body stand in a row.
    """

    BODY_ARRAYS = (
        "body_id", "body_template", "body_group", "body_size", "body_mass", "body_inertia", "body_position",
        "body_rounding", "body_velocity", "body_spin", "body_orientation", "body_angular_momentum",
    )  # fmt: skip
    SPHERE_ARRAYS = (
        "sphere_id", "sphere_material", "sphere_offset", "sphere_position", "sphere_velocity", "sphere_spin",
        "sphere_built", "force", "moment", "sphere_lost",
    )  # fmt: skip

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
        self.sphere_lost = zeros(spheres if model.features.losses else 1, wp.float64)

        self.pair_start = zeros(spheres + 1, wp.int32)
        self.candidate_start = zeros(spheres + 1, wp.int32)
        self.candidate_face = zeros(1, wp.int32)
        self.pair_total = 0
        self.reserve_pairs(1)

        walls = len(model.walls)
        slots = model.analytic_walls + (MESH_SLOTS if model.features.meshes else 0)
        self.slot_history = zeros((spheres, slots), t.vec3)
        self.slot_normal = zeros((spheres, slots), t.vec3)
        self.slot_overlap = zeros((spheres, slots), scalar)
        self.slot_wall = array(np.full((spheres, slots), -1), wp.int32)
        self.wall_position_exact = wp.clone(model.rest_position)
        self.wall_velocity_exact = zeros(walls, wp.vec3d)
        self.wall_position = array(model.rest_position.numpy().reshape(-1, 3), t.vec3)
        self.wall_orientation = array(np.tile([0.0, 0, 0, 1], (walls, 1)), t.quat)
        self.wall_velocity = zeros(walls, t.vec3)
        self.wall_spin = zeros(walls, t.vec3)
        self.wall_step_force = zeros((walls, 6), wp.int64)
        self.wall_force = zeros(walls, wp.vec3d)
        self.wall_moment = zeros(walls, wp.vec3d)
        self.wall_impulse = zeros(walls, wp.vec3d)
        self.wall_angular_impulse = zeros(walls, wp.vec3d)
        self.wall_travel = zeros(walls, wp.float64)
        self.wall_work = zeros(walls, wp.float64)
        self.wall_moved = zeros(walls, wp.float64)

        self.reference_velocity = zeros(1, t.vec3)
        self.scale = array([1.0], scalar)
        clock = np.zeros(CLOCK)
        typical_force = model.stress_scale * (2 * max(self.largest_radius, 1e-12)) ** 2
        # 2^62 units hold a hundred thousand such forces; one unit is 5e-14 of one.
        clock[int(FORCE_SCALE)] = 2.0 ** np.floor(np.log2(2.0**44 / typical_force))
        self.clock = array(clock, wp.float64)
        self.flags = zeros(FLAGS, wp.int32)

    def reserve_pairs(self, capacity: int) -> None:
        """Empty pair arrays for `capacity` pairs; without friction or bonds their history takes no memory."""
        t = types(self.model.scalar)
        features = self.model.features
        device = self.model.device
        history = capacity if features.history else 1
        bonds = capacity if features.bonds else 1
        self.pair_capacity = capacity
        self.pair_other = wp.zeros(capacity, dtype=wp.int32, device=device)
        self.pair_history = wp.zeros(history, dtype=t.vec3, device=device)
        self.pair_bond = wp.zeros(bonds, dtype=wp.int32, device=device)
        self.pair_bond_force = wp.zeros(bonds, dtype=t.vec4, device=device)
        self.pair_bond_moment = wp.zeros(bonds, dtype=t.vec4, device=device)

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


def rotate(quaternions: np.ndarray, vectors: np.ndarray, inverse: bool = False) -> np.ndarray:
    """Rotate `vectors` (n, 3) by unit quaternions x, y, z, w (n, 4)."""
    axis, w = quaternions[:, :3], quaternions[:, 3:]
    if inverse:
        axis = -axis
    twice = 2 * np.cross(axis, vectors)
    return vectors + w * twice + np.cross(axis, twice)
