"""Scene -> Model: what never changes during a run, on a device, and the features the scene needs."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import warp as wp

from .errors import DeviceError, one_of, refuse
from .kernels.bond_parallel import bond_functions
from .kernels.geometry import axis_functions
from .kernels.wall_motion import DRIVEN, FIXED, MESH, PIPE, PLANE, PRESCRIBED, wall_struct
from .laws import ContactLaw
from .scene import PRECISIONS, Bonds, Driven, MeshWall, PipeWall, PlaneWall, Prescribed, Scene

SCALARS = dict(zip(PRECISIONS, (wp.float32, wp.float64), strict=True))


@dataclass(frozen=True)
class Features:
    """What the scene needs; stages are chosen and kernels specialised by it."""

    pair_law: Callable
    """Kernel functions of contacts between bodies."""
    wall_law: Callable
    """Kernel functions of contacts with walls."""
    history: bool
    """Contacts between bodies remember their shear."""
    bonds: bool
    healing: bool
    clumps: bool
    rotation: bool
    """Bodies can turn; single spheres without friction or bonds cannot."""
    drives: bool
    walls: bool
    analytic: bool
    """Planes or pipes are among the walls."""
    meshes: bool
    growth: bool
    half_list: bool
    losses: bool
    """Dissipated energy is added up."""


@dataclass
class Model:
    """Fixed arrays on `device`."""

    scene: Scene
    device: Any
    scalar: Any
    features: Features
    materials: list[str]
    groups: list[str]
    """Name of each group number; 0 is no group."""
    bond_kinds: list[Bonds]
    """Properties of bond numbers 1, 2, ...."""
    pair_parameters: wp.array
    """Parameters of `features.pair_law`, a row for each pair of materials, shape (m * m,)."""
    wall_parameters: wp.array
    """Parameters of `features.wall_law`, likewise; the body's material first."""
    bond_parameters: wp.array
    walls: list
    """The scene's walls in device order: planes and pipes first."""
    wall_table: wp.array
    analytic_walls: int
    rest_position: wp.array
    segments: wp.array
    drive_axis: wp.array
    drive_force: wp.array
    mesh_objects: list = field(default_factory=list)
    """Keeps the wp.Mesh objects alive."""

    @property
    def stress_scale(self) -> float:
        """Largest stress scale of the scene's contact laws [Pa]."""
        return max(c.stress_scale for c in [self.scene.contact, *self.scene.contacts.values()])

    @property
    def material_count(self) -> int:
        """Number of materials; contact parameters form a square table of them."""
        return len(self.materials)


def find_device(name: str | None):
    """Warp device by name (`cpu`, `cuda`, `cuda:0`), or :class:`DeviceError`; None takes a GPU if there is one."""
    quiet_init()
    available = [str(device) for device in wp.get_devices()]
    if name is None:
        return wp.get_device("cuda:0" if wp.is_cuda_available() else "cpu")
    if name.startswith("cuda") and not wp.is_cuda_available():
        raise DeviceError(f"device = {name!r}: no usable CUDA GPU here; use one of {', '.join(available)}")
    try:
        return wp.get_device(name)
    except ValueError as error:
        raise DeviceError(f"device = {name!r}: must be one of {', '.join(available)}") from error


def quiet_init() -> None:
    """Start Warp without its banner, its compile notes and, where there is no NVIDIA driver, its warning of that."""
    wp.config.log_level = wp.LOG_ERROR
    try:
        ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
        wp.init()
        return
    except OSError:
        pass
    # Warp's native code writes that warning to the process's standard error, whatever its settings.
    sys.stderr.flush()
    kept, sink = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(sink, 2)
        wp.init()
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(sink)


def build_model(scene: Scene, device, precision: str, *, growth: bool = False) -> Model:
    """Arrange a scene for a device. `growth` prepares for packing, where sizes grow during the run."""
    one_of("precision", precision, PRECISIONS)
    scalar = SCALARS[precision]
    analytic = [wall for wall in scene.walls if not isinstance(wall, MeshWall)]
    meshes = [wall for wall in scene.walls if isinstance(wall, MeshWall)]
    walls = analytic + meshes

    materials = sorted({b.material for b in scene.bodies} | {w.material for w in walls} | _fill_materials(scene))
    contacts = {}
    for (a, b), contact in scene.contacts.items():
        for name in (a, b):
            if name not in materials:
                refuse("contacts", (a, b), f"name a material that no body or wall has ({', '.join(materials)})")
        contacts[a, b] = contacts[b, a] = contact
    of_bodies = {b.material for b in scene.bodies} | _fill_materials(scene)
    pair_table = _law_table("bodies", scene, contacts, materials, of_bodies, of_bodies)
    wall_table = _law_table("walls", scene, contacts, materials, of_bodies, {w.material for w in walls})

    groups = [""] + sorted({b.group for b in scene.bodies if b.group})
    bond_kinds: list[Bonds] = []
    if scene.bonds is not None:
        bond_kinds.append(scene.bonds)
    if scene.hydration is not None:
        bond_kinds.append(scene.hydration.bonds)
    bond_kinds.extend(scene.group_bonds.values())

    shapes = [b.template for b in scene.bodies] + list(scene.fill.templates if scene.fill else ())
    clumps = any(t is not None and len(t.radii) > 1 for t in shapes)
    features = Features(
        pair_law=pair_table[0].functions(),
        wall_law=wall_table[0].functions(),
        history=any(c.has_history for c in pair_table),
        bonds=bool(bond_kinds),
        healing=scene.bonds is not None and scene.bonds.healing,
        clumps=clumps,
        rotation=clumps or bool(bond_kinds) or any(c.has_shear for c in (*pair_table, *wall_table)),
        drives=bool(scene.drives),
        walls=bool(walls),
        analytic=bool(analytic),
        meshes=bool(meshes),
        growth=growth,
        half_list=not device.is_cuda,
        losses=scene.energy_balance,
    )

    segments: list[dict] = []

    def axis_range(axis) -> tuple[int, int]:
        first = len(segments)
        segments.extend(axis.parametrised())
        return first, len(segments)

    Wall = wall_struct(scalar)
    rows, rest = [], []
    mesh_objects = []
    for wall in walls:
        row = Wall()
        row.material = materials.index(wall.material)
        origin = np.zeros(3)
        if isinstance(wall, PlaneWall):
            row.kind = int(PLANE)
            row.normal = wall.normal
            origin = np.array(wall.point)
        elif isinstance(wall, PipeWall):
            row.kind = int(PIPE)
            row.radius = wall.radius
            row.first, row.last = axis_range(wall.axis)
        else:
            row.kind = int(MESH)
            surface = wp.Mesh(
                points=wp.array(wall.vertices.astype(np.float32), dtype=wp.vec3, device=device),
                indices=wp.array(wall.faces.ravel(), dtype=wp.int32, device=device),
            )
            mesh_objects.append(surface)
            row.mesh = surface.id
            row.extent = float(np.linalg.norm(wall.vertices, axis=1).max())
        _set_motion(row, wall.motion)
        rows.append(row)
        rest.append(origin)

    drive_axis = np.zeros((len(groups), 2), dtype=np.int32)
    drive_force = np.zeros(len(groups))
    for drive in scene.drives:
        group = groups.index(drive.group)
        count = sum(len(b.positions) for b in scene.bodies if b.group == drive.group)
        drive_axis[group] = axis_range(drive.axis)
        drive_force[group] = drive.force / count

    Segment = axis_functions(scalar).Segment
    segment_rows = []
    for s in segments:
        row = Segment()
        row.kind = int(s["arc"])
        row.start, row.tangent, row.outward = s["start"], s["tangent"], s["outward"]
        row.radius = s["radius"]
        row.lower, row.upper = max(s["lower"], -1e30), min(s["upper"], 1e30)
        segment_rows.append(row)

    Bond = bond_functions(scalar).Bond

    def array(values, dtype, columns: int | None = None):
        data = np.asarray(values)
        shape = (len(data), columns) if columns else (len(data),)
        if len(data) == 0:
            return wp.zeros(shape, dtype=dtype, device=device)
        return wp.array(data, dtype=dtype, device=device)

    def struct_array(values, dtype):
        return wp.array(values, dtype=dtype, device=device) if values else wp.zeros(1, dtype=dtype, device=device)

    return Model(
        scene=scene,
        device=device,
        scalar=scalar,
        features=features,
        materials=materials,
        groups=groups,
        bond_kinds=bond_kinds,
        pair_parameters=_law_rows(features.pair_law(scalar).Parameters, pair_table, device),
        wall_parameters=_law_rows(features.wall_law(scalar).Parameters, wall_table, device),
        bond_parameters=struct_array([Bond(), *(_bond_row(Bond, b) for b in bond_kinds)], Bond),
        walls=walls,
        wall_table=struct_array(rows, Wall),
        analytic_walls=len(analytic),
        rest_position=array(np.reshape(rest, (-1, 3)), wp.vec3d),
        segments=struct_array(segment_rows, Segment),
        drive_axis=wp.array(drive_axis, dtype=wp.int32, device=device),
        drive_force=array(drive_force, scalar),
        mesh_objects=mesh_objects,
    )


def _fill_materials(scene: Scene) -> set[str]:
    return {scene.fill.material} if scene.fill is not None else set()


def _set_motion(row, motion: Prescribed | Driven | None) -> None:
    row.motion = int(FIXED)
    if isinstance(motion, Prescribed):
        row.motion = int(PRESCRIBED)
        row.velocity, row.spin, row.pivot = motion.velocity, motion.spin, motion.pivot
        row.ramp_time, row.start_time = motion.ramp_time, motion.start_time
    elif isinstance(motion, Driven):
        row.motion = int(DRIVEN)
        row.velocity = motion.direction
        row.mass, row.drive_force, row.drive_damping = motion.mass, motion.force, motion.damping
        row.start_time = motion.start_time


def _law_table(
    what: str,
    scene: Scene,
    contacts: dict[tuple[str, str], ContactLaw],
    materials: list[str],
    ours: Iterable[str],
    theirs: Iterable[str],
) -> list[ContactLaw]:
    """Law parameters of every pair of materials; pairs that cannot meet repeat one that can."""
    met = [contacts.get((a, b), scene.contact) for a in sorted(ours) for b in sorted(theirs)] or [scene.contact]
    kinds = sorted({type(c).__name__ for c in met})
    if len(kinds) > 1:
        refuse(
            "contacts",
            ", ".join(kinds),
            f"contacts with {what} must all follow one law",
            "contacts between bodies may follow another than those with walls",
        )
    law = type(met[0])
    table = [contacts.get((a, b), scene.contact) for a in materials for b in materials] or met
    return [c if type(c) is law else met[0] for c in table]


def _law_rows(struct, table: list[ContactLaw], device) -> wp.array:
    return wp.array([_filled(struct(), c.row()) for c in table], dtype=struct, device=device)


def _filled(row, values: dict[str, Any]):
    for name, value in values.items():
        if isinstance(value, dict):
            _filled(getattr(row, name), value)
        else:
            setattr(row, name, value)
    return row


def _bond_row(struct, bonds: Bonds):
    row = struct()
    row.effective_modulus = bonds.effective_modulus
    row.shear_to_normal = 1.0 / bonds.stiffness_ratio
    row.tensile_strength = bonds.tensile_strength
    row.cohesion = bonds.cohesion
    row.tan_friction_angle = float(np.tan(np.radians(bonds.friction_angle)))
    row.radius_multiplier = bonds.radius_multiplier
    row.moment_factor = bonds.moment_factor
    return row
