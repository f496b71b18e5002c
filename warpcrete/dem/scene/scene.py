"""The scene of a discrete element simulation: frozen, validated dataclasses in SI units.

Defaults are the reference concrete of Zhan et al. 2019, Table 1.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np

from ...core.device.device import PRECISIONS
from ...core.drawing.html import Parametrised
from ...core.drawing.style import pumping_caption
from ...core.errors import between, one_of, positive, refuse, vector
from ...core.inputs.parameters import Above, Declared, Within
from ...geometry.axis import Axis
from ...geometry.walls import Driven, MeshWall, Motion, PipeWall, PlaneWall, Prescribed, Stops, Wall
from ...standards import StandardTest
from ...theory.pipe import Concrete
from ..laws import Contact, ContactLaw
from .clumps import ClumpTemplate
from .containers import Fill
from .slices import Stations

__all__ = [
    "AxisDrive", "Blockage", "Bodies", "Bonds", "Contact", "ContactLaw", "Driven", "Fill", "Hydration", "MeshWall",
    "Motion", "PipeUnit", "PipeWall", "PlaneWall", "Prescribed", "PressureProbe", "Published", "Rest", "Scene",
    "Settle", "Stations", "Stops", "TimeStep", "Vessel", "Wall", "Watch", "Wear",
]  # fmt: skip


MUCH_STIFFER = 200.0
"""Ratio of the modulus of hydrated bonds to the largest other modulus, above which sub-cycling of the bonds saves
computing time. At a ratio of 100, a run with sub-cycling takes as long as a run without, whose time steps must all be
as short as the stiff bonds require."""


@dataclass(frozen=True, kw_only=True)
class Bonds(Declared):
    """Parallel bonds between spheres: elastic cylinders with limited strength (Zhan et al. 2019, Eqs. 9-12)."""

    called = "bond"

    effective_modulus: Annotated[
        float, "Effective modulus [Pa]; the bond stiffness per area is this modulus over L", Above()
    ] = 2e4
    stiffness_ratio: Annotated[float, "Ratio of normal to shear bond stiffness", Above()] = 2.0
    tensile_strength: Annotated[float, "Tensile strength [Pa]", Within(0)] = 10.0
    cohesion: Annotated[float, "Cohesion [Pa]", Within(0)] = 5.0
    friction_angle: Annotated[
        float,
        "Friction angle [degrees]; it raises the shear strength under compression and lowers it under tension",
        Within(0, 89),
    ] = 30.0
    radius_multiplier: Annotated[float, "Bond radius over the smaller sphere's radius", Above()] = 1.0
    moment_factor: Annotated[
        float,
        "Fraction of the bending and twisting moment that counts in the peak stresses (beta in Eq. 11)",
        Within(0, 1),
    ] = 1.0
    gap: Annotated[float, "Largest gap across which a bond is made [m]", Within(0)] = 0.0
    healing: Annotated[
        bool, "Bond new contacts when they first touch; otherwise only contacts at the start are bonded"
    ] = False


@dataclass(frozen=True, kw_only=True)
class Hydration(Declared):
    """Replacement of a random fraction of all bonds by hydrated, stiffer ones (Zhan et al. 2019, section 5.3.2)."""

    called = "hydration"

    fraction: Annotated[float, "Fraction of all bonded contacts that is hydrated, 0 to 1", Within(0, 1)]
    bonds: Bonds = field(default_factory=lambda: Bonds(effective_modulus=1e9, tensile_strength=1e6, cohesion=5e5))


@dataclass(frozen=True, kw_only=True)
class AxisDrive:
    """Constant force on every body of a group, along the local direction of a pipe axis."""

    group: str
    axis: Axis
    force: float
    """Total force on all bodies of the group [N]; a negative force acts against the direction of the axis."""

    def __post_init__(self) -> None:
        between("drive force", self.force, -np.inf, np.inf, "N")


@dataclass(frozen=True, kw_only=True)
class Bodies:
    """Bodies of one shape and density that a scene places at given positions."""

    positions: np.ndarray
    """Centroids of the bodies [m], shape (n, 3)."""
    sizes: np.ndarray
    """Diameters of the spheres of equal volume [m], shape (n,) or one number."""
    template: ClumpTemplate | None = None
    """Shape of the bodies; None for single spheres."""
    density: float = 2500.0
    """Density of all the bodies [kg/m3]."""
    material: str = "aggregate"
    group: str = ""
    orientations: np.ndarray | None = None
    """Orientations as unit quaternions x, y, z, w, shape (n, 4)."""
    velocities: np.ndarray | None = None
    """Velocities of the centroids [m/s], shape (n, 3)."""
    spins: np.ndarray | None = None
    """Angular velocities in the global frame [rad/s], shape (n, 3)."""

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
                    refuse(
                        name,
                        "a quaternion whose length is not 1",
                        "must be unit quaternions (x, y, z, w)",
                        "divide each quaternion by its length",
                    )
                object.__setattr__(self, name, value)


@dataclass(frozen=True, kw_only=True)
class TimeStep(Declared):
    """Choice of the time step: a fixed size, or an automatic one from masses and current stiffness."""

    called = "time_step"

    fixed: Annotated[float | None, "Fixed time step [s]; None: computed from masses and current stiffness"] = None
    safety: Annotated[
        float,
        "Ratio of the time step to the estimated stable one; a value above 1 overrules the estimate, also for "
        "a fixed step",
        Within(1e-3, 10),
    ] = 0.8
    largest: Annotated[float, "Upper limit of the automatic time step [s]", Above()] = 1e-3
    interval: Annotated[int, "Number of steps between two estimates of the stable step"] = 20
    rounds: Annotated[
        int | None,
        "Number of sub-steps in which hydrated bonds are integrated within one time step; None: as many as needed if "
        "they are much stiffer than everything else; 1: no sub-steps, so that the stiffest bond limits the time step",
    ] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.rounds is not None and self.rounds < 1:
            refuse(
                "rounds",
                self.rounds,
                "must be a whole number, 1 or more",
                "leave out 'rounds' to use as many as needed",
            )
        if self.fixed is not None:
            positive("time_step", self.fixed, "s", "leave out the fixed time step for an automatic one")
        if self.interval < 1:
            refuse("interval", self.interval, "must be a whole number of steps, 1 or more")


@dataclass(frozen=True, kw_only=True)
class Settle(Declared):
    """Settling before t = 0: prescribed walls stand still, gravity and drives act, and motion is damped."""

    called = "settle"

    duration: Annotated[
        float,
        "Longest duration [s]; settling ends earlier once the kinetic energy is below 1e-5 of the elastic energy",
        Within(0),
    ] = 2.0
    local_damping: Annotated[
        float, "Fraction of the unbalanced force that opposes motion (PFC's local damping)", Within(0, 0.99)
    ] = 0.5


@dataclass(frozen=True, kw_only=True)
class Watch(Declared):
    """Limits beyond which a run stops with an InstabilityError; values that are not finite always stop a run."""

    called = "watch"

    overlap: Annotated[
        float | None,
        "Largest overlap, as a multiple of the overlap that swallows the smaller sphere, halves the distance of the "
        "centres or brings a centre behind a wall, whichever comes first; checked at every sample. None: no limit",
        Above(),
    ] = 1.0
    speed: Annotated[float, "Largest speed of any body [m/s], checked in every step", Above()] = 1e3
    energy: Annotated[
        float | None,
        "Largest energy that may appear without work of walls, drives or gravity, as a fraction of all energy in the "
        "scene; checked at every sample. None: no limit",
        Above(),
    ] = 0.5


@dataclass(frozen=True, kw_only=True)
class Wear(Declared):
    """Wear of the walls, summed per patch: along and around a pipe, and per triangle of a mesh.

    The worn depth follows Archard (1953, J. Appl. Phys. 24, 981): k times load times sliding distance, divided by the
    patch's area. Here k = K/H, the dimensionless wear coefficient K divided by the hardness H.
    """

    called = "wear"

    coefficient: Annotated[
        float,
        "Wear coefficient k, worn volume per load and sliding distance [m2/N]; 1e-13 to 1e-12 for steel worn by stones",
        Within(0),
    ] = 2e-13
    patch: Annotated[float | None, "Edge length of a patch of a pipe's wall [m]; default: 1/24 of its circumference",
                     Above()] = None  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Blockage(Declared):
    """Settings for detecting blockage: part of the concrete in a pipe stands still while the piston advances."""

    called = "blockage"

    travel: Annotated[
        float | None,
        "Travel of the piston during which part of the concrete must stand still [m]; default: 1/20 of "
        "the concrete's length; for soft aggregates one diameter, but at most 1/5 of that length",
        Above(),
    ] = None
    stop: Annotated[bool, "End the run when the pipe is blocked"] = False


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
    """Description of a pipe, through which a piston pushes concrete, for measurements, checks and figures."""

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
        """Return the travel [m] at which the stroke that contains the travel `travel` [m] began.

        During a stop the next stroke counts as begun.
        """
        if self.stops is None:
            return 0.0
        return min(math.floor(travel / self.stroke + 1e-6), self.stops.count) * self.stroke


@dataclass(frozen=True, kw_only=True)
class Vessel:
    """Description of a vessel, in which fresh concrete is tested, for measurements and checks."""

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
class Rest(Declared):
    """Rest of the concrete for minutes at one moment of a run: its structure grows by a law, without time steps.

    The static yield stress grows linearly, tau_0(t) = tau_0 + A_thix t, with the duration t of the rest and the growth
    rate A_thix (Roussel 2006). The same stress is added to the tensile strength and cohesion of the scene's bonds, and
    to the yield stress of a lubrication layer on the walls. Existing bonds keep the forces that they carry, and
    contacts without a bond receive a bond without force. Hydrated bonds and the bonds inside a group, for example the
    plug, do not change. A bond that breaks later stays broken. If the scene lets bonds heal, it returns with the
    strength from before the rest.

    Slip on the wall wears off what the layer gained: the gain is multiplied by exp(-slip / breakdown). As in plug flow,
    the travel of `wall` since the rest serves as the slip of the whole layer. Nothing moves during the rest.
    """

    called = "rest"

    at: Annotated[float, "Simulated time at which the rest takes place [s]", Within(0)]
    duration: Annotated[float, "Duration of the rest [s]", Within(0)]
    growth: Annotated[float, "Growth rate A_thix of the yield stress [Pa/s]", Within(0)] = 0.5
    breakdown: Annotated[float, "Slip over which the layer's gained yield stress falls to 1/e [m]", Above()] = 0.1
    coverage: Annotated[
        float,
        "Area on which a layer acts (pi r^2 of every contact) over the area of the wall; the gained yield "
        "stress of the layer is divided by this ratio",
        Above(),
    ] = 1.0
    wall: Annotated[str, "Name of the wall whose travel is the slip"] = "piston"

    @property
    def gained(self) -> float:
        """Stress by which strengths and yield stress grow during the rest [Pa]."""
        return self.growth * self.duration

    @property
    def layer_gained(self) -> float:
        """Increase of the yield stress of a wall's lubrication layer during the rest [Pa].

        The layer acts only where contacts are, on a fraction of the wall's area. The stress `gained` is divided by this
        fraction, so that it is the mean increase over the whole wall.
        """
        return self.gained / self.coverage


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


@dataclass(frozen=True, kw_only=True, repr=False)
class Scene(Parametrised):
    """Complete definition of a discrete element simulation, in SI units."""

    name: str
    duration: float
    """Simulated duration of the run after t = 0, that is, after packing and settling [s]."""
    bodies: tuple[Bodies, ...] = ()
    fill: Fill | None = None
    """Aggregates that are packed into a container before the start."""
    walls: tuple[Wall, ...] = ()
    drives: tuple[AxisDrive, ...] = ()
    contacts: Mapping[tuple[str, str], ContactLaw] = field(default_factory=dict)
    """Contact laws for single pairs of materials, which replace `contact`; the order within a pair does not matter."""
    contact: ContactLaw = field(default_factory=Contact)
    """Contact law between bodies, and against walls unless `contacts` overrides it. A scene has one law between bodies
    and one against walls; the parameters of each may differ between pairs of materials."""
    bonds: Bonds | None = None
    hydration: Hydration | None = None
    group_bonds: Mapping[str, Bonds] = field(default_factory=dict)
    """Bonds inside a named group of bodies, made before settling; used for the plug."""
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    """Gravitational acceleration [m/s2]."""
    local_damping: float = 0.0
    settle: Settle | None = None
    rest: Rest | None = None
    time_step: TimeStep = field(default_factory=TimeStep)
    watch: Watch = field(default_factory=Watch)
    sample_interval: float = 0.01
    """Simulated time between two rows of the series [s]."""
    seed: int = 0
    precision: str = "float32"
    """Precision of positions, velocities and forces: `float32` or `float64`."""
    energy_balance: bool = False
    """True to sum all dissipated energy, so that the energy balance can be checked; costs a few per cent of speed."""
    wear: Wear | None = None
    """Settings for measuring the wear of walls; None to leave it out."""
    blockage: Blockage | None = None
    """Settings for detecting blockage, which also requires `pipe` and `pressure`; None to leave it out."""
    segregation: bool = False
    """True to measure segregation, the distribution of aggregate over the pipe; requires `pipe`."""
    pressure: PressureProbe | None = None
    pipe: PipeUnit | None = None
    vessel: Vessel | None = None
    stations: Stations | None = None
    """Slices of a pipe in which stresses, solid fraction and velocities are measured."""
    published: Published | None = None
    remarks: tuple[str, ...] = ()
    """Simplifications of the scene, shown to the user before a run."""
    parameters: Mapping[str, Any] = field(default_factory=dict)
    """Arguments with which the scene's function creates this scene again; empty if there is no such function."""

    @property
    def caption(self) -> str:
        """Scene, diameter, concrete and flow in words, for titles of figures and recordings.

        For a scene without a pipe, the text states the sizes of the aggregates instead of diameter and flow. It omits
        the sizes if no parameters state them.
        """
        concrete = str(self.parameters.get("concrete") or "")
        if self.pipe is None:
            sizes = [float(size) for name in ("size_min", "size_max") if (size := self.parameters.get(name))]
            stones = f"aggregates {1e3 * sizes[0]:g} to {1e3 * sizes[1]:g} mm" if len(sizes) == 2 else ""
            return ", ".join(filter(None, (self.name, concrete and f"concrete {concrete}", stones)))
        flow = np.pi * self.pipe.radius**2 * self.pipe.velocity
        return pumping_caption(f"{self.name} {self.pipe.name}", self.pipe.radius, concrete, flow)

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
            refuse("drives", driven, "may name each group once")
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
        """True if the scene detects blockage and has the pipe and the piston pressure that this requires."""
        return self.blockage is not None and self.pipe is not None and self.pressure is not None

    def __repr__(self) -> str:
        placed = sum(len(bodies.positions) for bodies in self.bodies)
        parts = [f"{placed} placed bodies" if placed else "", "a fill" if self.fill else "", f"{len(self.walls)} walls"]
        return f"<Scene {self.name!r}: {self.duration:.4g} s, {', '.join(p for p in parts if p)}, seed {self.seed}>"
