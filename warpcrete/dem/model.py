"""Scene -> Model: what never changes during a run, on a device, and the features the scene needs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from ..core.device import parallel, scalar_of
from ..core.errors import refuse
from ..geometry.axis import Axis
from ..geometry.walls import MeshWall, Prescribed, Wall
from ..kernels.common.geometry import axis_functions
from ..kernels.common.walls import wall_struct
from ..kernels.dem.bond_parallel import MOST_KINDS, bond_functions
from .laws import ContactLaw
from .resting import grown_bonds, has_layer
from .scene import MUCH_STIFFER, Bonds, Scene


@dataclass(frozen=True)
class Features:
    """What the scene needs; stages are chosen and kernels specialised by it."""

    pair_law: type[ContactLaw]
    """Of contacts between bodies."""
    wall_law: type[ContactLaw]
    """Of contacts with walls."""
    mixed: bool
    """Bodies are of several materials."""
    history: bool
    """Contacts between bodies remember their shear."""
    bonds: bool
    """Some contacts are, or may come to be, bonded."""
    healing: bool
    """Contacts bond when they touch."""
    subcycling: bool
    """Stiff bonds are stepped in rounds within a step."""
    clumps: bool
    """Some bodies have several spheres, or are to be moved as if they had."""
    rotation: bool
    """Bodies can turn; single spheres without friction or bonds cannot."""
    drives: bool
    """Forces act along a pipe's axis on groups of bodies."""
    walls: bool
    analytic: bool
    """Planes or pipes are among the walls."""
    meshes: bool
    strokes: bool
    """Some wall stops on its way."""
    structure: bool
    """A layer on the walls grows at rest and is worn off."""
    growth: bool
    """Sizes grow while bodies are packed."""
    half_list: bool
    """Pairs inside a thread's chunk stand once in the lists (CPU); else at both spheres (GPU)."""
    dissipation: bool
    """Dissipated energy is added up."""
    wear: bool
    """What contacts do to walls is added up."""


@dataclass(frozen=True, repr=False)
class Model:
    """A scene's fixed arrays on a device. Nothing here changes once it is built."""

    scene: Scene
    device: Any
    scalar: Any
    """`wp.float32` or `wp.float64`."""
    features: Features
    materials: tuple[str, ...]
    groups: tuple[str, ...]
    """Name of each group number; 0 is no group."""
    bond_kinds: tuple[Bonds, ...]
    """Properties of bond numbers 1, 2, ...; those grown at rest come last."""
    walls: tuple[Wall, ...]
    """The scene's walls in device order: planes and pipes first."""
    analytic_walls: int
    """How many of them are planes and pipes."""
    pair_parameters: wp.array
    """Parameters of `features.pair_law`, a row for each pair of materials, shape (m * m,)."""
    wall_parameters: wp.array
    """Parameters of `features.wall_law`, likewise; the body's material first, shape (m * m,)."""
    bond_parameters: wp.array
    """Parameters of the bond kinds; row 0 is none, shape (kinds + 1,)."""
    wall_table: wp.array
    """What each wall is, shape (walls,), one row that nobody reads if there is none."""
    rest_position: wp.array
    """Of each wall at the start [m], shape (walls,)."""
    segments: wp.array
    """Lines and arcs of all pipe axes, shape (segments,), one that nobody reads if there is none."""
    drive_axis: wp.array
    """First segment of each group's axis, and the end; both 0 without a drive, shape (groups, 2)."""
    drive_force: wp.array
    """On each body of a group, along that axis [N], shape (groups,)."""
    meshes: tuple[Any, ...]
    """Keeps the ``wp.Mesh`` objects alive."""

    def __repr__(self) -> str:
        return f"<Model of scene {self.scene.name!r} on {self.device}: {len(self.walls)} walls>"

    @property
    def stress_scale(self) -> float:
        """Largest stress scale of the scene's contact laws [Pa]."""
        return max(c.stress_scale for c in [self.scene.contact, *self.scene.contacts.values()])


def build_model(scene: Scene, device: Any, precision: str, *, growth: bool = False) -> Model:
    """Arrange a scene for a device. `growth` prepares for packing, where sizes grow during the run."""
    scalar = scalar_of(precision)
    analytic = [wall for wall in scene.walls if not isinstance(wall, MeshWall)]
    meshes = [wall for wall in scene.walls if isinstance(wall, MeshWall)]
    walls = (*analytic, *meshes)
    of_bodies = {b.material for b in scene.bodies} | ({scene.fill.material} if scene.fill is not None else set())
    materials = tuple(sorted(of_bodies | {w.material for w in walls}))
    contacts = _both_ways(scene, materials)
    pair_laws = _law_table("bodies", scene, contacts, materials, of_bodies, of_bodies)
    wall_laws = _law_table("walls", scene, contacts, materials, of_bodies, {w.material for w in walls})
    groups = ("", *sorted({b.group for b in scene.bodies if b.group}))
    bond_kinds = _bond_kinds(scene)
    shapes = [b.template for b in scene.bodies] + list(scene.fill.templates if scene.fill else ())
    subcycling = not growth and subcycled(scene)
    # Bodies then hold the velocity of a round, and their spheres the mean over the step.
    clumps = subcycling or any(t is not None and len(t.radii) > 1 for t in shapes)
    features = Features(
        pair_law=type(pair_laws[0]),
        wall_law=type(wall_laws[0]),
        mixed=len(of_bodies) > 1,
        history=any(c.has_history for c in pair_laws),
        bonds=bool(bond_kinds),
        healing=scene.bonds is not None and scene.bonds.healing,
        subcycling=subcycling,
        clumps=clumps,
        rotation=clumps or bool(bond_kinds) or any(c.has_shear for c in (*pair_laws, *wall_laws)),
        drives=bool(scene.drives),
        walls=bool(walls),
        analytic=bool(analytic),
        meshes=bool(meshes),
        strokes=any(isinstance(wall.motion, Prescribed) and wall.motion.stops is not None for wall in walls),
        structure=has_layer(scene, type(wall_laws[0])),
        growth=growth,
        half_list=not parallel(device),
        dissipation=scene.energy_balance,
        wear=scene.wear is not None and bool(walls) and not growth,
    )
    axes = _Axes()
    table, kept = _wall_rows(walls, materials, axes, scalar, device)
    drive_axis, drive_force = _drives(scene, groups, axes)
    return Model(
        scene=scene,
        device=device,
        scalar=scalar,
        features=features,
        materials=materials,
        groups=groups,
        bond_kinds=bond_kinds,
        walls=walls,
        analytic_walls=len(analytic),
        pair_parameters=_law_rows(pair_laws, scalar, device),
        wall_parameters=_law_rows(wall_laws, scalar, device),
        bond_parameters=_bond_rows(bond_kinds, scalar, device),
        wall_table=table,
        rest_position=_array([wall.origin for wall in walls], wp.vec3d, device),
        segments=axes.rows(scalar, device),
        drive_axis=wp.array(drive_axis, dtype=wp.int32, device=device),
        drive_force=_array(drive_force, scalar, device),
        meshes=kept,
    )


def subcycled(scene: Scene) -> bool:
    """Whether hydrated bonds are stepped in rounds of their own: they are there, much stiffer than all else, and
    nobody asked for single steps. Local damping goes by the sum of all forces, which no part of a step knows; rounds
    know no resistance to rolling."""
    hydration, rounds = scene.hydration, scene.time_step.rounds
    if hydration is None or scene.bonds is None or scene.local_damping > 0 or rounds == 1:
        return False
    if scene.contact.rolls or any(c.rolls for c in scene.contacts.values()):
        return False
    laws = [c.stress_scale for c in (scene.contact, *scene.contacts.values())]
    others = [b.effective_modulus for b in (scene.bonds, *scene.group_bonds.values())]
    return rounds is not None or hydration.bonds.effective_modulus >= MUCH_STIFFER * max(*laws, *others)


class _Axes:
    """Pipe axes as segments, one after the other."""

    def __init__(self) -> None:
        self._segments: list[dict] = []

    def add(self, axis: Axis) -> tuple[int, int]:
        """Range of an axis' own segments."""
        first = len(self._segments)
        self._segments.extend(axis.parametrised())
        return first, len(self._segments)

    def rows(self, scalar: Any, device: Any) -> wp.array:
        """All segments on a device."""
        Segment = axis_functions(scalar).Segment
        rows = []
        for s in self._segments:
            row = Segment()
            row.kind = int(s["arc"])
            row.start, row.tangent, row.outward = s["start"], s["tangent"], s["outward"]
            row.radius = s["radius"]
            row.lower, row.upper = max(s["lower"], -1e30), min(s["upper"], 1e30)
            rows.append(row)
        return _structs(rows, Segment, device)


def _wall_rows(
    walls: Sequence[Wall], materials: Sequence[str], axes: _Axes, scalar: Any, device: Any
) -> tuple[wp.array, tuple[Any, ...]]:
    """Device table of the walls, and the ``wp.Mesh`` objects that it refers to."""
    WallRow = wall_struct(scalar)
    rows, kept = [], []
    for wall in walls:
        row = WallRow()
        row.material = materials.index(wall.material)
        wall.fill(row, axes.add)
        if isinstance(wall, MeshWall):
            vertices, faces, _ = wall.surface
            mesh = wp.Mesh(
                points=wp.array(vertices.astype(np.float32), dtype=wp.vec3, device=device),
                indices=wp.array(faces.ravel(), dtype=wp.int32, device=device),
            )
            kept.append(mesh)
            row.mesh = mesh.id
        rows.append(row)
    return _structs(rows, WallRow, device), tuple(kept)


def _drives(scene: Scene, groups: Sequence[str], axes: _Axes) -> tuple[np.ndarray, np.ndarray]:
    """Range of axis segments and force on a body of each group."""
    axis, force = np.zeros((len(groups), 2), dtype=np.int32), np.zeros(len(groups))
    for drive in scene.drives:
        group = groups.index(drive.group)
        count = sum(len(b.positions) for b in scene.bodies if b.group == drive.group)
        axis[group] = axes.add(drive.axis)
        force[group] = drive.force / count
    return axis, force


def _bond_kinds(scene: Scene) -> tuple[Bonds, ...]:
    kinds: list[Bonds] = []
    if scene.bonds is not None:
        kinds.append(scene.bonds)
    if scene.hydration is not None:
        kinds.append(scene.hydration.bonds)
    grown = grown_bonds(scene)
    kinds += [*scene.group_bonds.values(), *([grown] if grown is not None else ())]
    if len(kinds) > MOST_KINDS:
        refuse("group_bonds", len(scene.group_bonds), f"a scene has at most {MOST_KINDS} kinds of bonds in all")
    return tuple(kinds)


def _both_ways(scene: Scene, materials: Sequence[str]) -> dict[tuple[str, str], ContactLaw]:
    """The scene's overrides, for both orders of each pair of materials."""
    contacts = {}
    for (a, b), contact in scene.contacts.items():
        for name in (a, b):
            if name not in materials:
                refuse("contacts", (a, b), f"name a material that no body or wall has ({', '.join(materials)})")
        contacts[a, b] = contacts[b, a] = contact
    return contacts


def _law_table(
    what: str,
    scene: Scene,
    contacts: dict[tuple[str, str], ContactLaw],
    materials: Sequence[str],
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


def _law_rows(table: list[ContactLaw], scalar: Any, device: Any) -> wp.array:
    struct = type(table[0]).functions(scalar).Parameters
    return wp.array([_filled(struct(), c.row()) for c in table], dtype=struct, device=device)


def _filled(row: Any, values: dict[str, Any]) -> Any:
    for name, value in values.items():
        if isinstance(value, dict):
            _filled(getattr(row, name), value)
        else:
            setattr(row, name, value)
    return row


def _bond_rows(kinds: Sequence[Bonds], scalar: Any, device: Any) -> wp.array:
    Bond = bond_functions(scalar).Bond
    rows = [Bond()]
    for bonds in kinds:
        row = Bond()
        row.effective_modulus = bonds.effective_modulus
        row.shear_to_normal = 1.0 / bonds.stiffness_ratio
        row.tensile_strength = bonds.tensile_strength
        row.cohesion = bonds.cohesion
        row.tan_friction_angle = float(np.tan(np.radians(bonds.friction_angle)))
        row.radius_multiplier = bonds.radius_multiplier
        row.moment_factor = bonds.moment_factor
        rows.append(row)
    return _structs(rows, Bond, device)


def _array(values: Any, dtype: Any, device: Any) -> wp.array:
    data = np.asarray(values, dtype=float)
    return wp.array(data, dtype=dtype, device=device) if len(data) else wp.zeros(0, dtype=dtype, device=device)


def _structs(rows: list[Any], dtype: Any, device: Any) -> wp.array:
    return wp.array(rows, dtype=dtype, device=device) if rows else wp.zeros(1, dtype=dtype, device=device)
