"""Scenes of the moving particle method: concrete as a yield stress fluid that is pumped up a pipe.

In two dimensions the pipe is a channel between two parallel planes at a distance of 2 R. In three dimensions it is a
round tube of radius R. The scenes follow Xu, Li & Jiang 2021, section 3.3.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar

import numpy as np

from ..core.device.device import PRECISIONS
from ..core.drawing.html import Parametrised
from ..core.drawing.style import pumping_caption
from ..core.errors import at_most, between, one_of, positive, refuse
from ..core.inputs.parameters import Above, Declared, Needs, OneOf, Within
from ..theory.pipe import Concrete, Line, Steady, restart, steady
from .common.settings import STEP_ERROR, check_interval

MIN_PARTICLES_ACROSS = 4
"""Minimum number of particles across the pipe. A scene with fewer particles is refused, and the search for faster
settings skips it."""
ENDS = ("piston", "periodic")
RESTED = Needs("rest", lambda rest: rest > 0, "is above 0")
STRUCTURED = Needs("rest", lambda value: value > 0, "is above 0", ("rebuild_rate",))
MAX_PARTICLES = 2**26
"""Maximum number of particles of a column. With more, neighbour lists would exceed the memory of current GPUs."""
# Minimum length of a column in particle spacings. In a shorter column, the piston and the free surface disturb the flow
# everywhere.
MIN_SPACINGS_HIGH = 8


@dataclass(frozen=True, kw_only=True)
class Aggregates:
    """Coarse aggregate of the two-phase model: grains in mortar, each a group of particles that form a rigid body."""

    fraction: float
    """Volume fraction of the coarse aggregate."""
    mortar: Concrete
    """Density and flow law of the mortar between the grains; the mortar has the same slip layer as the concrete."""
    density: float = 2630.0
    """Density of the aggregate [kg/m3]."""
    sizes: tuple[tuple[float, float, float], ...] = ((5e-3, 10e-3, 0.3), (10e-3, 15e-3, 0.4), (15e-3, 20e-3, 0.3))
    """Size classes of the aggregate, each with its smallest size [m], its largest size [m] and its share of the
    aggregate's volume."""
    roundness: float = 0.6
    """Roundness of the grains. With 1, they are circles or spheres. Otherwise their radius varies with the direction by
    up to 1 - roundness, relative to its mean."""

    def __post_init__(self) -> None:
        positive("aggregate fraction", self.fraction, "", "leave out 'aggregates' for a concrete without them")
        between(
            "aggregate fraction", self.fraction, 0, 0.6, "", "grains above 0.6 of the volume cannot be placed at random"
        )
        positive("aggregate density", self.density, "kg/m3")
        between("roundness", self.roundness, 0.5, 1)
        for smallest, largest, part in self.sizes:
            positive("aggregate size", smallest, "m")
            between("aggregate size", largest, smallest, np.inf, "m")
            between("part of a size class", part, 0, 1)


@dataclass(frozen=True, kw_only=True)
class FlowWatch(Declared):
    """Limits beyond which a flow stops with an InstabilityError, checked at each measurement; NaN exceeds any limit."""

    called = "watch"

    force_balance: Annotated[
        float | None,
        "Largest difference between the piston's force and the sum of weight, wall friction and inertia, as a "
        "fraction of the piston's force; None: no limit",
        Above(),
    ] = 0.2
    pressure: Annotated[
        float | None,
        "Largest magnitude of the pressure on the piston, as a multiple of the pressure by theory; None: no limit",
        Above(),
    ] = 10.0
    speed: Annotated[
        float | None,
        "Largest speed of a particle, as a multiple of the highest speed by theory; None: no limit",
        Above(),
    ] = 4.0
    volume: Annotated[
        float | None, "Largest change of the concrete's volume, as a fraction of it; None: no limit", Above()
    ] = 0.015


@dataclass(frozen=True, kw_only=True)
class FlowSettings(Declared):
    """Settings of the simulation of a pipe flow."""

    common: ClassVar[tuple[str, ...]] = ("duration", "rest")

    duration: Annotated[float | None, "Simulated time [s]; default: until the flow is steady"] = None
    ends: Annotated[
        str,
        "Ends of the pipe: piston (a piston pushes a column of particles with a free surface) or periodic (a stretch "
        "of an endless pipe on a grid, axisymmetric for a tube; for flows with any amount of shear)",
        OneOf(ENDS),
    ] = "piston"
    time_step: Annotated[
        float, "Longest time step [s]; if step_error is 0, all time steps have this length", Above()
    ] = 5e-4
    step_error: Annotated[float, STEP_ERROR, Within(0, 0.5)] = 0.0
    gravity: Annotated[
        float, "Gravitational acceleration against the flow [m/s2]; 0 for a level pipe", Within(0, 1e4)
    ] = 9.81
    regularisation: Annotated[
        float, "Parameter beta of the regularised flow law [s] (Xu, Li & Jiang 2021, Eq. 14)", Above()
    ] = 100.0
    tolerance: Annotated[
        float,
        "Tolerance of the pressure solve: norm of the final residual, divided by that of the initial residual, or by "
        "that of a typical residual, which follows from the speed of the piston",
        Within(1e-12, 0.5),
    ] = 1e-2
    maximum_iterations: Annotated[
        int,
        "Largest number of iterations of a linear solve; if a solve needs more, the run ends with an error",
        Within(1),
    ] = 2000
    steadiness: Annotated[
        float,
        "The flow counts as steady if the relative changes of pressure, wall stress and slip velocity were smaller "
        "than this value in the last 5 ms and in the 5 ms before; the change of the slip velocity is divided by the "
        "speed of the piston",
        Above(),
    ] = 1e-3
    precision: Annotated[
        str, "Precision of positions, velocities and pressures: float32 or float64", OneOf(PRECISIONS)
    ] = "float32"
    sample_interval: Annotated[float, "Simulated time between two rows of the time series [s]", Above()] = 5e-3
    seed: Annotated[int, "Random seed of the places and shapes of the aggregates", Within(0)] = 0
    rest: Annotated[
        float,
        "Time at rest in the pipe before the flow starts [s], in which the yield stresses of the concrete and of "
        "its slip layer grow by thixotropy x rest",
        Within(0),
    ] = 0.0
    thixotropy: Annotated[
        float, "Growth rate A_thix of the yield stresses at rest [Pa/s]; 0.1 to 1.7 (Roussel 2006)", Within(0), RESTED
    ] = 0.5
    breakdown: Annotated[
        float,
        "Slip distance over which the yield stress that the slip layer gained at rest falls to 1/e [m]",
        Above(),
        STRUCTURED,
    ] = 0.1
    breakdown_strain: Annotated[
        float,
        "Shear strain over which the yield stress that the concrete gained at rest falls to 1/e; it equals 1 / alpha "
        "of Roussel (2006)",
        Above(),
        STRUCTURED,
    ] = 100.0
    rebuild_rate: Annotated[
        float,
        "Rate A_thix at which the yield stresses of concrete and slip layer grow while the concrete flows [Pa/s]; 0: "
        "they only fall",
        Within(0),
    ] = 0.0
    tolerated_error: Annotated[
        float | None,
        "Largest error relative to theory that the checks accept; default: 0.01 in 2D, 0.02 in 3D, 0.03 with two "
        "phases",
        Above(),
    ] = None


@dataclass(frozen=True, kw_only=True, repr=False)
class FluidScene(Parametrised, FlowSettings):
    """Column of concrete in a pipe, driven from below by a piston at constant speed; SI units."""

    name: str
    concrete: Concrete
    dimensions: int
    """Number of dimensions: 2 for a channel of width 2 R, 3 for a round tube."""
    radius: float
    """Radius R of the pipe, or half the width of the channel [m]."""
    length: float
    """Length of the concrete column in the pipe [m]."""
    velocity: float
    """Velocity of the piston [m/s]."""
    spacing: float
    """Requested particle spacing [m]. The simulation uses the nearest spacing that divides the width of the channel or
    the radius of the tube into whole spacings."""
    aggregates: Aggregates | None = None
    watch: FlowWatch = field(default_factory=FlowWatch)
    published: Mapping[str, float] = field(default_factory=dict)
    """Values of result quantities that Xu, Li & Jiang 2021 print for this scene, in SI units."""
    remarks: tuple[str, ...] = ()
    """Remarks on simplifications in the scene, shown before a run."""
    parameters: Mapping[str, Any] = field(default_factory=dict)
    """Arguments of the function that created this scene, stored so that it can be created again; empty if there is no
    such function."""

    def __post_init__(self) -> None:
        super().__post_init__()
        one_of("dimensions", self.dimensions, (2, 3))
        positive("radius", self.radius, "m")
        positive("length", self.length, "m")
        positive(
            "velocity", self.velocity, "m/s", "increase the velocity, because concrete at rest needs no simulation"
        )
        positive("spacing", self.spacing, "m")
        if self.aggregates is not None and (self.rest or self.step_error or self.rebuild_rate):
            name = next(each for each in ("rest", "step_error", "rebuild_rate") if getattr(self, each))
            problem = "needs a flow on a grid, which cannot contain aggregates of the two-phase model"
            refuse(name, getattr(self, name), problem, f"leave out {name!r} or 'aggregates'")
        for name in ("rest", "rebuild_rate"):
            if self.ends == "piston" and getattr(self, name):
                problem = "needs a flow on a grid, because a column of particles cannot track the structure"
                refuse(name, getattr(self, name), problem, f"set 'ends' to periodic, or {name!r} to 0")
        if self.ends == "piston" and self.step_error:
            problem = "needs a flow on a grid, because all time steps of a column of particles are equal"
            refuse("step_error", self.step_error, problem, "set 'ends' to periodic, or 'step_error' to 0")
        if self.ends == "periodic" and self.aggregates is not None:
            problem = "cannot be combined with aggregates, because periodic flows are solved on a grid"
            refuse("ends", self.ends, problem, "set 'ends' to piston")
        across = 2 * self.radius / self.spacing
        if across < MIN_PARTICLES_ACROSS - 0.5:
            problem = f"leaves {across:.2g} particles across the pipe, but at least {MIN_PARTICLES_ACROSS} are needed"
            refuse("spacing", self.spacing, problem, f"use {2 * self.radius / MIN_PARTICLES_ACROSS:g} m or less")
        if self.length < MIN_SPACINGS_HIGH * self.spacing:
            problem = f"must be at least {MIN_SPACINGS_HIGH} times 'spacing', {MIN_SPACINGS_HIGH * self.spacing:g} m"
            refuse("length", self.length, problem)
        section = 2 * self.radius if self.dimensions == 2 else np.pi * self.radius**2
        count = section * self.length / self.spacing**self.dimensions
        if self.ends == "piston" and count > MAX_PARTICLES:
            refuse("length", self.length, f"needs {count:.2g} particles, but at most {MAX_PARTICLES:.2g} are possible",
                   "reduce 'length', increase 'spacing', or " + ("set 'ends' to periodic" if self.aggregates is None
                                                                 else "leave out 'aggregates'"))  # fmt: skip
        if self.time_step * self.velocity > 0.5 * self.spacing:
            problem = "must be shorter, because the piston moves by more than half a particle spacing per step"
            refuse("time_step", self.time_step, problem, f"use {at_most(0.5 * self.spacing / self.velocity)} s or less")
        if self.duration is not None:
            between("duration", self.duration, self.time_step, np.inf, "s", "simulate at least one time step")
        check_interval(self)

    def __repr__(self) -> str:
        phases = "one phase" if self.aggregates is None else f"{100 * self.aggregates.fraction:.0f} % aggregate"
        return (
            f"<FluidScene {self.name!r}: {self.concrete.words}, {phases}, {self.dimensions}D, R = {self.radius:g} m, "
            f"{self.velocity:.4g} m/s, spacing {self.spacing:g} m>"
        )

    @property
    def caption(self) -> str:
        """Text with scene, diameter, concrete and flow, for titles of figures and recordings."""
        if self.dimensions == 2:
            return (
                f"{self.name}, {2e3 * self.radius:.4g} mm wide, concrete {self.concrete.name}, {self.velocity:.3g} m/s"
            )
        flow = np.pi * self.radius**2 * self.velocity
        return pumping_caption(self.name, self.radius, self.concrete.name, flow)

    @property
    def form(self) -> str:
        """Geometry for which the closed forms are evaluated, "plane" for a channel or "pipe" for a tube."""
        return "plane" if self.dimensions == 2 else "pipe"

    @property
    def line(self) -> Line:
        """Pipe of the scene as a :class:`Line`, the argument of the closed forms."""
        return Line(radius=self.radius, length=self.length, gravity=self.gravity)

    @property
    def weight(self) -> float:
        """Hydrostatic part of the driving pressure, which carries the weight of the concrete [Pa]."""
        return self.concrete.density * self.gravity * self.length

    def friction(self, wall_stress: float) -> float:
        """Return the loss of pressure per length [Pa/m] that a wall shear stress [Pa] causes, without weight."""
        return (self.dimensions - 1) * wall_stress / self.radius

    @property
    def gained(self) -> float:
        """Increase of the yield stresses of bulk and slip layer during the rest before the start [Pa]."""
        return self.thixotropy * self.rest

    @property
    def is_structured(self) -> bool:
        """True if the yield stresses change in time, so that closed forms for constant yield stresses do not hold."""
        return self.gained > 0 or self.rebuild_rate > 0

    def theory(self) -> Steady:
        """Return the steady state of the flow by closed-form theory."""
        return steady(self.concrete, self.line, np.pi * self.radius**2 * self.velocity, self.form)

    def restart(self) -> Steady:
        """Return the theoretical state directly after the rest, when concrete flows but no structure is broken yet.

        The concrete moves with the velocity of the piston, and has the yield stresses that it has gained at rest.
        """
        flow = np.pi * self.radius**2 * self.velocity
        return restart(self.concrete, self.line, self.rest, self.thixotropy, flow, self.form)
