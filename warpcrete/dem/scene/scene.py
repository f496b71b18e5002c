"""The scene of a discrete element simulation: frozen, validated dataclasses in SI units.

Defaults are the reference concrete of Zhan et al. 2019, Table 1.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...core.device.device import PRECISIONS
from ...core.drawing.html import Parametrised
from ...core.drawing.style import pumping_caption
from ...core.errors import between, flag, one_of, positive, refuse, vector
from ...core.inputs.field_help import help_on_fields
from ...core.inputs.fingerprints import EqualByContent
from ...geometry.axis import Axis
from ...geometry.walls import Driven, MeshWall, Motion, PipeWall, PlaneWall, Prescribed, Stops, Wall
from ...standards import StandardTest
from ...theory.pipe import Concrete
from ..laws import Contact, ContactLaw
from .clumps import ClumpTemplate
from .containers import Fill
from .settings import Blockage, Bonds, Hydration, Rest, Settle, TimeStep, Watch, Wear
from .slices import Stations

__all__ = [
    "AxisDrive", "Blockage", "Bodies", "Bonds", "Contact", "ContactLaw", "Driven", "Fill", "Hydration", "MeshWall",
    "Motion", "PipeUnit", "PipeWall", "PlaneWall", "Prescribed", "PressureProbe", "Published", "Rest", "Scene",
    "Settle", "Stations", "Stops", "TimeStep", "Vessel", "Wall", "Watch", "Wear",
]  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class AxisDrive:
    """Constant force that drives a group of bodies along a pipe axis; all bodies of the group share it equally."""

    group: str
    axis: Axis
    force: float
    """Total force on all bodies of the group [N]; a negative force acts against the direction of the axis."""

    def __post_init__(self) -> None:
        between("drive force", self.force, -np.inf, np.inf, "N")


@help_on_fields
@dataclass(frozen=True, kw_only=True, eq=False)
class Bodies(EqualByContent):
    """Bodies of one shape and one density, which a scene places at given positions."""

    positions: np.ndarray
    """Centroids of the bodies [m], shape (n, 3)."""
    sizes: np.ndarray
    """Diameters of the spheres of equal volume [m], shape (n,) or one number."""
    template: ClumpTemplate | None = None
    """Shape of the bodies; None for single spheres."""
    density: float = 2500.0
    """Density of all the bodies [kg/m3]."""
    material: str = "aggregate"
    """Name of the material, which selects the contact law in `Scene.contacts`."""
    group: str = ""
    """Name of the group, which drives, bonds and recorders can refer to; the balls of a plug have the group `plug`."""
    orientations: np.ndarray | None = None
    """Orientations of the bodies as unit quaternions x, y, z, w, shape (n, 4)."""
    velocities: np.ndarray | None = None
    """Velocities of the bodies' centroids [m/s], shape (n, 3)."""
    spins: np.ndarray | None = None
    """Angular velocities of the bodies in the global frame [rad/s], shape (n, 3)."""

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
                    problem = "must be unit quaternions (x, y, z, w)"
                    refuse(name, "a quaternion whose length is not 1", problem, "divide each quaternion by its length")
                object.__setattr__(self, name, value)


@dataclass(frozen=True, kw_only=True)
class PressureProbe:
    """Measurement of a pressure: the force on a plane wall along its normal, divided by an area."""

    wall: str
    """Name of a :class:`PlaneWall` of the scene."""
    area: float
    """Area by which the force is divided to obtain the pressure [m2]."""

    def __post_init__(self) -> None:
        positive("pressure area", self.area, "m2")


@dataclass(frozen=True, kw_only=True)
class PipeUnit:
    """Description of a pipe through which a piston pushes concrete; measurements, checks and figures use it."""

    name: str
    axis: Axis
    radius: float
    """Inner radius of the pipe [m]; for a pipe that is not round, the nominal radius."""
    concrete_length: float
    """Length of the concrete in the pipe at the start [m]."""
    velocity: float
    """Final speed of the piston [m/s]."""
    ramp: float
    """Travel of the piston over which its speed rises from zero [m]."""
    travel: float
    """Travel of the piston at the end of the run [m]."""
    stops: Stops | None = None
    """Stops of the piston between strokes; None if it never stops."""

    @property
    def stroke(self) -> float:
        """Travel of each stroke of the piston [m]."""
        return self.travel / (1 + self.stops.count if self.stops is not None else 1)

    def begun(self, travel: float) -> float:
        """Return the piston's travel [m] at the beginning of the stroke in which it reaches `travel` [m].

        If the piston stops at `travel`, the next stroke counts as begun.
        """
        if self.stops is None:
            return 0.0
        return min(math.floor(travel / self.stroke + 1e-6), self.stops.count) * self.stroke


@dataclass(frozen=True, kw_only=True)
class Vessel:
    """Description of a vessel in which fresh concrete is tested; measurements and checks use it."""

    test: StandardTest
    opened: float
    """Time at which the vessel is opened and the concrete can flow [s]."""
    rest_speed: float
    """Speed limit for rest [m/s]: all bodies of the main heap must stay below it for a second."""
    dimensions: Mapping[str, float]
    """Dimensions of the vessel by name [m], as the test lists them."""
    concrete: Concrete | None = None
    """Bingham fluid that the contact law represents, for closed forms; None if it does not represent a fluid."""

    def __post_init__(self) -> None:
        between("opened", self.opened, 0, np.inf, "s")
        positive("rest_speed", self.rest_speed, "m/s")
        self.test.check_dimensions(self.dimensions)


@dataclass(frozen=True, kw_only=True)
class Published:
    """Published values that reports show next to the results of a run of this scene."""

    source: str
    peak: float | None = None
    """Published peak of the pumping pressure [Pa]."""
    plateau: float | None = None
    """Published pumping pressure on the plateau [Pa]."""
    peak_travel: float | None = None
    """Published travel of the piston at the peak pressure [m]."""


@help_on_fields
@dataclass(frozen=True, kw_only=True, repr=False)
class Scene(Parametrised):
    """Complete definition of a discrete element simulation, in SI units."""

    name: str
    """Name of the scene, shown in titles and stored with the results."""
    duration: float
    """Simulated duration of the run after t = 0, that is, after packing and settling [s]."""
    bodies: tuple[Bodies, ...] = ()
    """Bodies that are placed at given positions."""
    fill: Fill | None = None
    """Aggregates that are packed into a container before the start."""
    walls: tuple[Wall, ...] = ()
    """Walls of the scene: planes, pipes and meshes, each with its own name. Walls may move."""
    drives: tuple[AxisDrive, ...] = ()
    """Constant forces [N] on groups of bodies along a pipe axis."""
    contacts: Mapping[tuple[str, str], ContactLaw] = field(default_factory=dict)
    """Contact laws for certain pairs of materials, which replace `contact`; the order within a pair does not matter."""
    contact: ContactLaw = field(default_factory=Contact)
    """Contact law between bodies, and against walls unless `contacts` overrides it. A scene has one law between bodies
    and one against walls; the parameters of each may differ between pairs of materials."""
    bonds: Bonds | None = None
    """Bonds between all bodies that touch at the start; None for no bonds."""
    hydration: Hydration | None = None
    """Hydration, which replaces a fraction of the bonds by stiffer ones; requires `bonds`."""
    group_bonds: Mapping[str, Bonds] = field(default_factory=dict)
    """Bonds between the bodies of a group, by the name of the group, for example of the balls that close the front of
    the concrete. They are created before the bodies come to rest (settle)."""
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    """Gravitational acceleration, a vector [m/s2]."""
    local_damping: float = 0.0
    """Fraction of the unbalanced force that opposes motion, 0 to 0.99; 0 for physical motion."""
    settle: Settle | None = None
    """Settling before t = 0, in which the walls stand still; None to start at once."""
    rest: Rest | None = None
    """Rest during the run: the concrete stands still, and bonds and lubrication layer gain strength; None for no
    rest."""
    time_step: TimeStep = field(default_factory=TimeStep)
    """Choice of the time step [s], automatic by default."""
    watch: Watch = field(default_factory=Watch)
    """Limits beyond which the run stops as unstable."""
    sample_interval: float = 0.01
    """Simulated time between two rows of the time series [s]."""
    seed: int = 0
    """Seed of all random numbers, such as those of the packing; 0 or more."""
    precision: str = "float32"
    """Precision of positions, velocities and forces: `float32` or `float64`."""
    energy_balance: bool = False
    """True to sum all dissipated energy, so that the energy balance can be checked; this makes a run a few per cent
    slower."""
    wear: Wear | None = None
    """Settings for measuring the wear of walls; None to leave it out."""
    blockage: Blockage | None = None
    """Settings for detecting blockage, which also requires `pipe` and `pressure`; None to leave it out."""
    segregation: bool = False
    """True to measure segregation, the distribution of aggregate over the pipe; requires `pipe`."""
    pressure: PressureProbe | None = None
    """Measurement of the pressure on a plane wall, such as the piston [Pa]; None to leave it out."""
    pipe: PipeUnit | None = None
    """Description of the pipe, if the scene pumps through one; it only affects measurements."""
    vessel: Vessel | None = None
    """Description of the vessel, if the scene is a test of fresh concrete; it only affects measurements."""
    stations: Stations | None = None
    """Slices of a pipe in which stresses, solid fraction and velocities are measured."""
    published: Published | None = None
    """Published values that reports show next to the results."""
    remarks: tuple[str, ...] = ()
    """Simplifications of the scene, shown to the user before a run."""
    parameters: Mapping[str, Any] = field(default_factory=dict)
    """Arguments of the scene function that created this scene, by name; empty if no scene function created it."""

    def laws(self) -> tuple[ContactLaw, ...]:
        """Return all contact laws of the scene: `contact` first, then the laws in `contacts`."""
        return (self.contact, *self.contacts.values())

    @property
    def caption(self) -> str:
        """Text with scene, diameter, concrete (or contact law) and flow, for titles of figures and recordings.

        For a scene without a pipe, the text states the sizes of the aggregates instead of diameter and flow. It omits
        the sizes if no parameters state them.
        """
        concrete = str(self.parameters.get("concrete") or "")
        if self.pipe is None:
            sizes = [float(size) for name in ("size_min", "size_max") if (size := self.parameters.get(name))]
            stones = f"aggregates {1e3 * sizes[0]:g} to {1e3 * sizes[1]:g} mm" if len(sizes) == 2 else ""
            return ", ".join(filter(None, (self.name, concrete and f"concrete {concrete}", stones)))
        flow = np.pi * self.pipe.radius**2 * self.pipe.velocity
        name = f"{self.name} {self.pipe.name}"
        if self.parameters.get("contact") is not None:
            # The contact law that the user chose replaces the parameters of the concrete, so name the law instead.
            name, concrete = f"{name}, contact law {type(self.contact).__name__}", ""
        return pumping_caption(name, self.pipe.radius, concrete, flow)

    def __post_init__(self) -> None:
        between("duration", self.duration, 0, np.inf, "s")
        positive("sample_interval", self.sample_interval, "s")
        for name in ("energy_balance", "segregation"):
            flag(name, getattr(self, name))
        object.__setattr__(self, "gravity", vector("gravity", self.gravity))
        between("local_damping", self.local_damping, 0, 0.99)
        if isinstance(self.seed, bool) or not isinstance(self.seed, int | np.integer) or self.seed < 0:
            refuse("seed", self.seed, "must be a whole number, 0 or more")
        one_of("precision", self.precision, PRECISIONS)
        names = [wall.name for wall in self.walls]
        if len(set(names)) != len(names):
            refuse("walls", names, "must have different names", "give each wall its own name")
        planes = [wall.name for wall in self.walls if isinstance(wall, PlaneWall)]
        if self.pressure is not None and self.pressure.wall not in planes:
            refuse("pressure wall", self.pressure.wall, f"must be a plane wall ({', '.join(planes) or 'none'})")
        wanted = self.blockage is not None and (self.blockage.stop or self.blockage.travel is not None)
        if wanted and not self.looks_for_blockage:
            refuse("blockage", self.blockage, "needs a pipe and a pressure", "set Scene.pipe and Scene.pressure")
        if self.segregation and self.pipe is None:
            refuse("segregation", self.segregation, "needs a pipe", "set Scene.pipe")
        driven = [drive.group for drive in self.drives]
        if len(set(driven)) != len(driven):
            refuse("drives", driven, "must name each group at most once")
        groups = {bodies.group for bodies in self.bodies if bodies.group and len(bodies.positions)}
        for group in [drive.group for drive in self.drives] + list(self.group_bonds):
            if group not in groups:
                refuse("group", group, f"must be one of the bodies' groups ({', '.join(sorted(groups)) or 'none'})")
        if self.rest is not None and self.rest.wall not in names:
            refuse("rest.wall", self.rest.wall, f"must be a wall ({', '.join(names) or 'none'})")
        if self.hydration is not None and self.bonds is None:
            refuse("hydration", self.hydration, "needs bonds", "set Scene.bonds")

    @property
    def looks_for_blockage(self) -> bool:
        """True if the scene requests detection of blockage, and has the pipe and the piston pressure needed for it."""
        return self.blockage is not None and self.pipe is not None and self.pressure is not None

    def __repr__(self) -> str:
        placed = sum(len(bodies.positions) for bodies in self.bodies)
        parts = [f"{placed} placed bodies" if placed else "", "a fill" if self.fill else "", f"{len(self.walls)} walls"]
        return f"<Scene {self.name!r}: {self.duration:.4g} s, {', '.join(p for p in parts if p)}, seed {self.seed}>"
