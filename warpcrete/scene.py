"""What a simulation is asked to be: frozen, validated dataclasses in SI units.

Defaults are the reference concrete of Zhan et al. 2019, Table 1.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from .errors import between, one_of, positive, refuse, vector
from .laws import Contact, ContactLaw

if TYPE_CHECKING:
    from .axis import Axis
    from .clumps import ClumpTemplate
    from .packing import Fill


PRECISIONS = ("float32", "float64")


@dataclass(frozen=True, kw_only=True)
class Bonds:
    """Parallel bonds (Zhan et al. 2019, Eqs. 9-12)."""

    effective_modulus: float = 2e4
    """Bond modulus [Pa]; bond stiffness per area is modulus / L."""
    stiffness_ratio: float = 2.0
    """Normal over shear bond stiffness."""
    tensile_strength: float = 10.0
    """[Pa]"""
    cohesion: float = 5.0
    """[Pa]"""
    friction_angle: float = 30.0
    """[degrees]; raises the shear strength under compression, lowers it under tension."""
    radius_multiplier: float = 1.0
    """Bond radius over the smaller sphere's radius."""
    moment_factor: float = 1.0
    """Share of bending and twisting moment in the peak stresses (beta in Eq. 11)."""
    gap: float = 0.0
    """Largest gap across which a bond is made [m]."""
    healing: bool = False
    """New contacts bond at first touch; otherwise only the contacts present at the start are bonded."""

    def __post_init__(self) -> None:
        positive("bond effective_modulus", self.effective_modulus, "Pa")
        positive("bond stiffness_ratio", self.stiffness_ratio)
        between("tensile_strength", self.tensile_strength, 0, np.inf, "Pa")
        between("cohesion", self.cohesion, 0, np.inf, "Pa")
        between("friction_angle", self.friction_angle, 0, 89.0, "degrees")
        positive("radius_multiplier", self.radius_multiplier)
        between("moment_factor", self.moment_factor, 0, 1)
        between("bond gap", self.gap, 0, np.inf, "m")


@dataclass(frozen=True, kw_only=True)
class Hydration:
    """A random share of the bonded contacts gets other bonds (Zhan et al. 2019, section 5.3.2)."""

    share: float
    """Of all bonded contacts, 0 to 1."""
    bonds: Bonds = field(default_factory=lambda: Bonds(effective_modulus=1e9, tensile_strength=1e6, cohesion=5e5))

    def __post_init__(self) -> None:
        between("hydration share", self.share, 0, 1)


@dataclass(frozen=True, kw_only=True)
class Prescribed:
    """Motion that nothing can change: speed ramps linearly from rest over `ramp_time`, then holds."""

    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Final velocity [m/s]."""
    spin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Final angular velocity about `pivot` [rad/s]; with a velocity the pivot travels along."""
    pivot: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ramp_time: float = 0.0
    """[s]"""
    start_time: float = 0.0
    """[s]"""

    def __post_init__(self) -> None:
        for name in ("velocity", "spin", "pivot"):
            object.__setattr__(self, name, vector(f"motion {name}", getattr(self, name)))
        between("ramp_time", self.ramp_time, 0, np.inf, "s")
        between("start_time", self.start_time, 0, np.inf, "s")


@dataclass(frozen=True, kw_only=True)
class Driven:
    """Motion along one direction by a force against the wall's inertia (a loaded plate, a servo)."""

    direction: tuple[float, float, float]
    force: float
    """Along `direction` [N]."""
    mass: float
    """[kg]"""
    damping: float = 0.0
    """[N s/m]"""
    start_time: float = 0.0
    """[s]"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "direction", vector("direction", self.direction))
        if not np.any(self.direction):
            refuse("direction", self.direction, "must not be zero")
        positive("mass", self.mass, "kg")
        between("driving force", self.force, -np.inf, np.inf, "N")
        between("damping", self.damping, 0, np.inf, "N s/m")


Motion = Prescribed | Driven


@dataclass(frozen=True, kw_only=True)
class PlaneWall:
    """Infinite plane; material lies on the side its normal points to."""

    name: str
    point: tuple[float, float, float]
    normal: tuple[float, float, float]
    material: str = "wall"
    motion: Motion | None = None
    drawn_radius: float = 0.0
    """Radius of the disc that recorders draw [m]; 0 draws none."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", vector(f"{self.name}.point", self.point))
        normal = np.array(vector(f"{self.name}.normal", self.normal))
        length = float(np.linalg.norm(normal))
        if length == 0:
            refuse(f"{self.name}.normal", self.normal, "must not be zero")
        object.__setattr__(self, "normal", tuple(normal / length))


@dataclass(frozen=True, kw_only=True)
class PipeWall:
    """Inner surface of a round pipe along an axis of lines and arcs, exact (no facets)."""

    name: str
    axis: Axis
    radius: float
    """Inner radius [m]."""
    material: str = "wall"
    motion: Motion | None = None

    def __post_init__(self) -> None:
        positive(f"{self.name}.radius", self.radius, "m")
        if self.motion is not None and isinstance(self.motion, Prescribed) and any(self.motion.spin):
            refuse(f"{self.name}.motion", "spin", "a pipe wall may translate, not turn", "use a MeshWall")


@dataclass(frozen=True, kw_only=True)
class MeshWall:
    """Triangle mesh, rigid; either side may hold material."""

    name: str
    vertices: np.ndarray
    """[m], shape (v, 3), in the wall's frame, which starts as the world's."""
    faces: np.ndarray
    """Shape (f, 3)."""
    material: str = "wall"
    motion: Motion | None = None

    def __post_init__(self) -> None:
        try:
            vertices = np.asarray(self.vertices, dtype=float)
            faces = np.asarray(self.faces, dtype=np.int32)
        except (TypeError, ValueError):
            refuse(f"{self.name}.vertices", "not numbers", "must be finite, shape (v, 3), with faces of shape (f, 3)")
        if vertices.ndim != 2 or vertices.shape[1] != 3 or not np.all(np.isfinite(vertices)):
            refuse(f"{self.name}.vertices", f"shape {vertices.shape}", "must be finite, shape (v, 3)")
        if faces.ndim != 2 or faces.shape[1:] != (3,) or len(faces) == 0:
            refuse(f"{self.name}.faces", f"shape {faces.shape}", "must have shape (f, 3) with f > 0")
        if faces.min() < 0 or faces.max() >= len(vertices):
            refuse(f"{self.name}.faces", f"{faces.min()}..{faces.max()}", f"must lie in 0..{len(vertices) - 1}")
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces)


Wall = PlaneWall | PipeWall | MeshWall


@dataclass(frozen=True, kw_only=True)
class AxisDrive:
    """Constant force on every body of a group, along the local direction of a pipe axis."""

    group: str
    axis: Axis
    force: float
    """Sum over the group [N]; negative pushes against the axis' direction."""

    def __post_init__(self) -> None:
        between("drive force", self.force, -np.inf, np.inf, "N")


@dataclass(frozen=True, kw_only=True)
class Bodies:
    """Bodies placed one by one."""

    positions: np.ndarray
    """Centroids [m], shape (n, 3)."""
    sizes: np.ndarray
    """Diameters of the spheres of equal volume [m], shape (n,) or one number."""
    template: ClumpTemplate | None = None
    """None: single spheres."""
    density: float = 2500.0
    """[kg/m3]"""
    material: str = "aggregate"
    group: str = ""
    orientations: np.ndarray | None = None
    """Unit quaternions x, y, z, w, shape (n, 4)."""
    velocities: np.ndarray | None = None
    """[m/s], shape (n, 3)."""
    spins: np.ndarray | None = None
    """[rad/s], shape (n, 3), in space."""

    def __post_init__(self) -> None:
        try:
            positions = np.atleast_2d(np.asarray(self.positions, dtype=float))
        except (TypeError, ValueError):
            refuse("positions", self.positions, "must be finite, shape (n, 3)")
        if positions.size == 0:
            positions = positions.reshape(0, 3)
        if positions.shape[1:] != (3,) or not np.all(np.isfinite(positions)):
            refuse("positions", f"shape {positions.shape}", "must be finite, shape (n, 3)")
        n = len(positions)
        try:
            sizes = np.broadcast_to(np.asarray(self.sizes, dtype=float), (n,))
        except (TypeError, ValueError):
            refuse("sizes", self.sizes, f"must be one number or {n} numbers")
        if not np.all(np.isfinite(sizes)) or np.any(sizes <= 0):
            refuse("sizes", float(np.min(sizes)), "must be finite numbers above 0 m")
        object.__setattr__(self, "positions", positions)
        object.__setattr__(self, "sizes", sizes)
        positive("density", self.density, "kg/m3")
        for name, width in (("orientations", 4), ("velocities", 3), ("spins", 3)):
            value = getattr(self, name)
            if value is not None:
                try:
                    value = np.asarray(value, dtype=float)
                except (TypeError, ValueError):
                    refuse(name, value, f"must be finite, shape ({n}, {width})")
                if value.shape != (n, width) or not np.all(np.isfinite(value)):
                    refuse(name, f"shape {value.shape}", f"must be finite, shape ({n}, {width})")
                if name == "orientations" and np.any(np.abs(np.linalg.norm(value, axis=1) - 1) > 1e-3):
                    refuse(name, "a quaternion not of length 1", "must be unit quaternions x, y, z, w")
                object.__setattr__(self, name, value)


@dataclass(frozen=True, kw_only=True)
class TimeStep:
    """How the step size is chosen."""

    fixed: float | None = None
    """[s]; None: from masses and live stiffness."""
    safety: float = 0.8
    """Share of the estimated stable step; above 1 overrules the estimate, also for a fixed step."""
    largest: float = 1e-3
    """Cap of the automatic step [s]."""
    interval: int = 20
    """Steps between two estimates."""

    def __post_init__(self) -> None:
        if self.fixed is not None:
            positive("time_step", self.fixed, "s", "leave it out for an automatic step")
        between("safety", self.safety, 1e-3, 10.0)
        positive("largest time step", self.largest, "s")
        if isinstance(self.interval, bool) or not isinstance(self.interval, int) or self.interval < 1:
            refuse("interval", self.interval, "must be a whole number of steps, 1 or more")


@dataclass(frozen=True, kw_only=True)
class Settle:
    """Quiet time before t = 0: prescribed walls stand still, gravity and drives act, motion is damped."""

    duration: float = 2.0
    """Longest [s]; ends earlier once the kinetic energy is a hundred-thousandth of the elastic."""
    local_damping: float = 0.5
    """Share of the unbalanced force that opposes motion (PFC's local damping)."""

    def __post_init__(self) -> None:
        between("settle duration", self.duration, 0, np.inf, "s")
        between("local_damping", self.local_damping, 0, 0.99)


@dataclass(frozen=True, kw_only=True)
class Watch:
    """Limits past which a run stops with an InstabilityError. NaN is always one."""

    overlap: float | None = 1.0
    """Of the overlap that swallows the smaller sphere whole or halves the distance of the centres, whichever comes
    first, or brings a centre behind a wall; checked at every sample. None: no limit."""
    speed: float = 1e3
    """[m/s], of any body, checked in every step."""
    energy: float | None = 0.5
    """Share of all energy in play that may appear without work of walls, drives or gravity; checked at every
    sample. None: no limit."""

    def __post_init__(self) -> None:
        if self.overlap is not None:
            positive("watch.overlap", self.overlap)
        positive("watch.speed", self.speed, "m/s")
        if self.energy is not None:
            positive("watch.energy", self.energy)


@dataclass(frozen=True, kw_only=True)
class Scene:
    """Everything a simulation needs to know, in SI units."""

    name: str
    duration: float
    """Simulated time [s]."""
    bodies: tuple[Bodies, ...] = ()
    fill: Fill | None = None
    """Aggregates to be packed into a container before the start."""
    walls: tuple[Wall, ...] = ()
    drives: tuple[AxisDrive, ...] = ()
    contacts: Mapping[tuple[str, str], ContactLaw] = field(default_factory=dict)
    """Overrides of `contact` for pairs of materials, in either order."""
    contact: ContactLaw = field(default_factory=Contact)
    """Law between bodies, and against walls. Each of the two must be one law throughout a scene, with parameters
    that may differ from one pair of materials to the next."""
    bonds: Bonds | None = None
    hydration: Hydration | None = None
    group_bonds: Mapping[str, Bonds] = field(default_factory=dict)
    """Bonds inside a group of bodies, made before settling (the plug)."""
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    """[m/s2]"""
    local_damping: float = 0.0
    settle: Settle | None = None
    time_step: TimeStep = field(default_factory=TimeStep)
    watch: Watch = field(default_factory=Watch)
    sample_interval: float = 0.01
    """Simulated time between two rows of the series [s]."""
    seed: int = 0
    precision: str = "float32"
    """`float32` or `float64`, of positions, velocities and forces."""
    energy_balance: bool = False
    """Add up all dissipated energy, so that the books of energy can be closed; costs a few per cent."""
    parameters: Mapping[str, Any] = field(default_factory=dict)
    """Arguments that make this scene again through its scene function; empty if it has none."""
    notes: Mapping[str, Any] = field(default_factory=dict)
    """Quantities of the scene that its probes and recorders use (pipe area, axis ...)."""

    def __post_init__(self) -> None:
        between("duration", self.duration, 0, np.inf, "s")
        positive("sample_interval", self.sample_interval, "s")
        object.__setattr__(self, "gravity", vector("gravity", self.gravity))
        between("local_damping", self.local_damping, 0, 0.99)
        if isinstance(self.seed, bool) or not isinstance(self.seed, int | np.integer) or self.seed < 0:
            refuse("seed", self.seed, "must be a whole number, 0 or more")
        one_of("precision", self.precision, PRECISIONS)
        names = [wall.name for wall in self.walls]
        if len(set(names)) != len(names):
            refuse("walls", names, "must have different names")
        driven = [drive.group for drive in self.drives]
        if len(set(driven)) != len(driven):
            refuse("drives", driven, "may name each group once")
        groups = {bodies.group for bodies in self.bodies if bodies.group and len(bodies.positions)}
        for group in [drive.group for drive in self.drives] + list(self.group_bonds):
            if group not in groups:
                refuse("group", group, f"must be one of the bodies' groups ({', '.join(sorted(groups)) or 'none'})")
        if self.hydration is not None and self.bonds is None:
            refuse("hydration", self.hydration, "needs bonds", "set Scene.bonds")
