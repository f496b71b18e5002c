"""Translate a scene into a model: the constant device arrays of a run and the features that the scene needs."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from ...core.device.arrays import DeviceArray, Scalar, Struct, zeros
from ...core.device.device import parallel, scalar_of
from ...core.errors import refuse
from ...geometry.axis import Axis
from ...geometry.walls import MeshWall, Prescribed, Wall
from ...kernels.common.geometry import axis_functions
from ...kernels.common.walls import wall_struct
from ...kernels.dem.bond_parallel import MOST_KINDS, bond_functions
from ..laws import Circumstances, ContactLaw, check_own_laws
from ..scene.scene import Bonds, Scene
from ..scene.settings import MUCH_STIFFER
from .rest import bonds_after_rest, has_layer


@dataclass(frozen=True)
class Features:
    """Features that a scene needs, such as bonds or clumps.

    The features determine which kernels a time step launches and how these kernels are compiled.
    """

    pair_law: type[ContactLaw]
    """Class of the contact law that acts between bodies."""
    wall_law: type[ContactLaw]
    """Class of the contact law that acts between bodies and walls."""
    mixed: bool
    """True if the scene has bodies of several materials; contact parameters may then differ between pairs of bodies."""
    history: bool
    """True if contacts between bodies store values from one step to the next, such as the force of the shear spring."""
    bonds: bool
    """True if some pairs of bodies are bonded at the start or may become bonded later."""
    healing: bool
    """True if bodies that come into contact during the run form bonds.

    If False, bonds form only at the start of the run, and during a rest of the concrete.
    """
    subcycling: bool
    """True if stiff bonds are sub-cycled: each time step integrates them with several shorter steps (rounds)."""
    clumps: bool
    """True if some bodies consist of several spheres or some bonds are sub-cycled; the kernel for clumps then moves the
    bodies."""
    rotation: bool
    """True if bodies rotate; single spheres without friction, shear damping and bonds need no rotation."""
    drives: bool
    """True if the scene prescribes driving forces along a pipe axis on groups of bodies."""
    walls: bool
    analytic: bool
    """True if some walls are planes or pipes, whose contacts are computed by formulas instead of meshes."""
    meshes: bool
    strokes: bool
    """True if the prescribed motion of some wall is interrupted by stops, as between pump strokes."""
    structure: bool
    """True if the lubrication layer on the walls gains strength while the concrete rests; later slip reduces this
    gain."""
    growth: bool
    """True if bodies grow during the run, as in a packing."""
    half_list: bool
    """True if neighbour lists contain a pair only once (CPU); False if they contain it at both spheres (GPU).

    On a CPU, pairs of spheres that belong to different threads are an exception: they are listed at both spheres.
    """
    dissipation: bool
    """True if kernels sum up the dissipated energy, which a check of the energy balance needs."""
    wear: bool
    """True if kernels sum up the work of sliding and impacts on walls, from which the wear of the walls is computed."""


@dataclass(frozen=True, repr=False)
class Model:
    """Constant data of a scene and the arrays of these data on a device; nothing changes after construction."""

    scene: Scene
    device: wp.Device
    scalar: Scalar
    """Floating-point type of the kernels, `wp.float32` or `wp.float64`."""
    features: Features
    materials: tuple[str, ...]
    groups: tuple[str, ...]
    """Name of each body group, by group number; number 0 means no group."""
    bond_kinds: tuple[Bonds, ...]
    """Properties of the bond kinds 1, 2, and so on. If the concrete of the scene stands still for a time (a rest), the
    last kind contains the bonds that gained strength during this time."""
    walls: tuple[Wall, ...]
    """Walls of the scene in the order of the device arrays: planes and pipes first, then meshes."""
    analytic_walls: int
    """Number of planes and pipes among the walls; their contacts are computed by formulas."""
    pair_parameters: DeviceArray
    """Parameters of `features.pair_law` for each ordered pair of the m entries of `materials`, shape (m * m,)."""
    wall_parameters: DeviceArray
    """Parameters of `features.wall_law` for each ordered pair of the m entries of `materials`, shape (m * m,)."""
    bond_parameters: DeviceArray
    """Parameters of the bond kinds, shape (kinds + 1,); row 0 means no bond."""
    wall_table: DeviceArray
    """Properties of each wall, shape (walls,); without walls it has one unused row."""
    rest_position: DeviceArray
    """Position of each wall before it has moved [m], shape (walls,)."""
    segments: DeviceArray
    """Lines and arcs of all pipe axes, shape (segments,); without axes it has one unused row."""
    drive_axis: DeviceArray
    """Range of the pipe axis in `segments` along which a force drives each body group, shape (groups, 2). The columns
    are the index of the first segment and the index after the last segment. Both are 0 for a group without a driving
    force."""
    drive_force: DeviceArray
    """Driving force along the pipe axis on each single body of a group [N], shape (groups,)."""
    meshes: tuple[wp.Mesh, ...]
    """The ``wp.Mesh`` objects of all mesh walls, kept alive because the wall table refers to them only by number."""

    def __repr__(self) -> str:
        return f"<Model of scene {self.scene.name!r} on {self.device}: {len(self.walls)} walls>"

    @property
    def stress_scale(self) -> float:
        """Order of magnitude of the stress in strongly compressed contacts [Pa]: the maximum over all contact laws."""
        return max(c.stress_scale for c in self.scene.laws())

    @property
    def mesh_speed(self) -> float:
        """Largest speed of the mesh walls whose motion is prescribed [m/s]; 0 without such walls."""
        return max((wall.top_speed() for wall in self.walls if isinstance(wall, MeshWall)), default=0.0)


def build_model(scene: Scene, device: wp.Device, precision: str, *, growth: bool = False) -> Model:
    """Build the model of a scene for a Warp `device` and a `precision` ("float32" or "float64").

    `growth` is True for a packing, in which sizes grow during the run. Raises :class:`SceneError` if the scene combines
    contact laws, bonds or materials that the kernels cannot handle.
    """
    scalar = scalar_of(precision)
    analytic = [wall for wall in scene.walls if not isinstance(wall, MeshWall)]
    meshes = [wall for wall in scene.walls if isinstance(wall, MeshWall)]
    walls = (*analytic, *meshes)
    of_bodies = {b.material for b in scene.bodies} | ({scene.fill.material} if scene.fill is not None else set[str]())
    materials = tuple(sorted(of_bodies | {w.material for w in walls}))
    contacts = _both_ways(scene, materials)
    pair_laws = _law_table("bodies", scene, contacts, materials, of_bodies, of_bodies)
    wall_laws = _law_table("walls", scene, contacts, materials, of_bodies, {w.material for w in walls})
    radius, density = _largest_body(scene)
    where = Circumstances(radius, density, scene.bonds is not None, scene.energy_balance, scalar, device)
    check_own_laws(pair_laws, wall_laws if walls else (), where)
    groups = ("", *sorted({b.group for b in scene.bodies if b.group}))
    bond_kinds = _bond_kinds(scene)
    shapes = [b.template for b in scene.bodies] + list(scene.fill.templates if scene.fill else ())
    subcycling = not growth and subcycled(scene)
    # Sub-cycled bodies need the kernel for clumps even if they are single spheres, because the velocity of a sub-cycled
    # body differs from the velocity of its spheres: the body has the velocity of the current sub-cycling round, and the
    # spheres have the mean velocity over the step.
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
        drive_axis=DeviceArray(drive_axis, dtype=wp.int32, device=device),
        drive_force=_array(drive_force, scalar, device),
        meshes=kept,
    )


def _largest_body(scene: Scene) -> tuple[float, float]:
    """Return the radius [m] and the density [kg/m3] of the largest body of a scene."""
    bodies = [(float(np.max(b.sizes)) / 2, float(b.density)) for b in scene.bodies if len(b.positions)]
    if scene.fill is not None:
        bodies.append((scene.fill.sizes.largest / 2, scene.fill.density))
    return max(bodies, default=(0.01, 2500.0))


def subcycled(scene: Scene) -> bool:
    """Return whether hydrated (stiff) bonds are sub-cycled: integrated with several shorter steps in each time step.

    Bonds are sub-cycled if hydrated bonds are much stiffer than all other contacts and bonds, or if the scene requests
    more than one of these shorter steps (rounds). Local damping excludes sub-cycling, because it depends on the sum of
    all forces, which is not known within a round. Rolling resistance excludes sub-cycling, because the rounds do not
    implement it.
    """
    hydration, rounds = scene.hydration, scene.time_step.rounds
    if hydration is None or scene.bonds is None or scene.local_damping > 0 or rounds == 1:
        return False
    if any(c.rolls for c in scene.laws()):
        return False
    laws = [c.stress_scale for c in scene.laws()]
    others = [b.effective_modulus for b in (scene.bonds, *scene.group_bonds.values())]
    return rounds is not None or hydration.bonds.effective_modulus >= MUCH_STIFFER * max(*laws, *others)


class _Axes:
    """Growing list of the segments (lines and arcs) of all pipe axes of a scene."""

    def __init__(self) -> None:
        self._segments: list[dict[str, Any]] = []

    def add(self, axis: Axis) -> tuple[int, int]:
        """Append the segments of `axis`; return the index of its first segment and the index after its last segment."""
        first = len(self._segments)
        self._segments.extend(axis.parametrised())
        return first, len(self._segments)

    def rows(self, scalar: Scalar, device: wp.Device) -> DeviceArray:
        """Return all axis segments as an array of structs `Segment` on the device, shape (segments,)."""
        Segment = axis_functions(scalar).Segment
        rows: list[object] = []
        for s in self._segments:
            row = Segment()
            row.kind = int(s["arc"])
            row.start, row.tangent, row.outward = s["start"], s["tangent"], s["outward"]
            row.radius = s["radius"]
            row.lower, row.upper = max(s["lower"], -1e30), min(s["upper"], 1e30)
            rows.append(row)
        return _structs(rows, Segment, device)


def _wall_rows(
    walls: Sequence[Wall], materials: Sequence[str], axes: _Axes, scalar: Scalar, device: wp.Device
) -> tuple[DeviceArray, tuple[wp.Mesh, ...]]:
    """Return the properties of all walls as an array on the device, and the ``wp.Mesh`` objects of the mesh walls.

    The segments of pipe axes are appended to `axes`. A wall stores the index of its material in `materials`.
    """
    WallRow: Struct = wall_struct(scalar)
    rows: list[object] = []
    kept: list[wp.Mesh] = []
    for wall in walls:
        row = WallRow()
        row.material = materials.index(wall.material)
        wall.fill(row, axes.add)
        if isinstance(wall, MeshWall):
            vertices, faces, _ = wall.surface
            mesh = wp.Mesh(
                points=DeviceArray(vertices.astype(np.float32), dtype=wp.vec3, device=device),
                indices=DeviceArray(faces.ravel(), dtype=wp.int32, device=device),
            )
            kept.append(mesh)
            row.mesh = mesh.id  # pyright: ignore[reportUnknownMemberType]
        rows.append(row)
    return _structs(rows, WallRow, device), tuple(kept)


def _drives(scene: Scene, groups: Sequence[str], axes: _Axes) -> tuple[np.ndarray, np.ndarray]:
    """Return the pipe axis along which a force drives each body group, and the force on each body of the group [N].

    An axis is a range of segments in `axes`, to which this function appends them. The shapes are (groups, 2) and
    (groups,).
    """
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
    grown = bonds_after_rest(scene)
    kinds += [*scene.group_bonds.values(), *([grown] if grown is not None else ())]
    if len(kinds) > MOST_KINDS:
        refuse(
            "group_bonds",
            len(scene.group_bonds),
            f"must be fewer, because a scene has at most {MOST_KINDS} kinds of bonds in all; use the same bonds for "
            "several groups",
        )
    return tuple(kinds)


def _both_ways(scene: Scene, materials: Sequence[str]) -> dict[tuple[str, str], ContactLaw]:
    """Return the contact laws that replace the default law for certain pairs of materials.

    The keys of the dict are the pairs (a, b) and (b, a) of material names.
    """
    contacts: dict[tuple[str, str], ContactLaw] = {}
    for (a, b), contact in scene.contacts.items():
        for name in (a, b):
            if name not in materials:
                refuse("contacts", (a, b), f"must name materials of bodies or walls ({', '.join(materials)})")
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
    """Return a contact law for every ordered pair of `materials`, as a flattened square table.

    Pairs of a material in `ours` and a material in `theirs` can touch. All of them must follow one type of law;
    otherwise :class:`SceneError` is raised, and `what` says in its message what the bodies touch. Pairs that cannot
    touch need an entry in the table as well, and get the law of a pair that can touch.
    """
    met = [contacts.get((a, b), scene.contact) for a in sorted(ours) for b in sorted(theirs)] or [scene.contact]
    kinds = {type(c) for c in met}
    if len(kinds) > 1:
        # If two files define classes of the same name, the message also names their modules.
        names = {kind.__name__ for kind in kinds}
        names = names if len(names) == len(kinds) else {f"{kind.__module__}.{kind.__name__}" for kind in kinds}
        hint = "use one class of contact law between bodies, and one between bodies and walls"
        refuse(
            "contacts", ", ".join(sorted(names)), f"must be one type of contact law for all contacts with {what}", hint
        )
    law = type(met[0])
    table = [contacts.get((a, b), scene.contact) for a in materials for b in materials] or met
    return [c if type(c) is law else met[0] for c in table]


def _law_rows(table: list[ContactLaw], scalar: Scalar, device: wp.Device) -> DeviceArray:
    struct = type(table[0]).functions(scalar).Parameters
    return DeviceArray([c.on_device(scalar) for c in table], dtype=struct, device=device)


def _bond_rows(kinds: Sequence[Bonds], scalar: Scalar, device: wp.Device) -> DeviceArray:
    Bond = bond_functions(scalar).Bond
    rows: list[object] = [Bond()]
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


def _array(values: ArrayLike, dtype: type, device: wp.Device) -> DeviceArray:
    data = np.asarray(values, dtype=float)
    return DeviceArray(data, dtype=dtype, device=device) if len(data) else zeros(0, dtype=dtype, device=device)


def _structs(rows: Sequence[object], dtype: Struct, device: wp.Device) -> DeviceArray:
    return DeviceArray(rows, dtype=dtype, device=device) if rows else zeros(1, dtype=dtype, device=device)
