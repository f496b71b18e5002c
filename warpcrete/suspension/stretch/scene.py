"""Scenes of mortar with aggregates in a stretch of an endless pipe."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any, ClassVar

import numpy as np

from ...core.device.device import PRECISIONS
from ...core.drawing.html import Parametrised
from ...core.errors import at_least, at_most, positive, refuse
from ...core.inputs.parameters import Above, Declared, OneOf, Within
from ...kernels.mps.grid.walls import STICKY
from ...mps.common.settings import MaximumIterations, PressureTolerance
from ...theory.pipe import Concrete, Line, Steady, flow_of_pressure, least_stress, velocity
from ..scene import SphereFields

MIN_LENGTH = 3.0
"""Minimum length of the stretch, in diameters of the largest aggregate."""
NEWTONIAN = 8 / 5.783
"""Constant c in the time constant c rho v / G with which a Newtonian flow starts in a pipe. Here rho is the density, v
the steady mean velocity and G the pressure gradient. The number 5.783 is the square of the first zero of the Bessel
function J0."""
STEADY = 0.02
"""Relative change of the flow over the last quarter of a run below which it counts as steady."""
MIN_ACROSS = 8
"""Minimum number of cells across the pipe."""


Courant = Annotated[
    float,
    "Courant number of a flow with aggregates, which sets the time step: number of cells by which mortar on the axis "
    "may move in a step, or a single aggregate may settle, both by theory",
    Within(0.01, 1),
]


@dataclass(frozen=True, kw_only=True)
class StretchSettings(Declared):
    """Settings of the simulation of a stretch of pipe."""

    common: ClassVar[tuple[str, ...]] = ("duration",)

    duration: Annotated[float, "Simulated time [s]", Above()] = 1.0
    courant: Courant = 0.5
    gravity: Annotated[
        float,
        "Gravitational acceleration against the flow [m/s2], by which heavy aggregates settle; 0: no settling",
        Within(0, 1e4),
    ] = 9.81
    regularisation: Annotated[
        float,
        "Parameter beta of the regularised flow law [s]; mortar below the yield stress creeps at a rate of 1/beta",
        Above(),
    ] = 1e3
    tolerance: PressureTolerance = 1e-3
    maximum_iterations: MaximumIterations = 5000
    precision: Annotated[str, "Precision: float32 or float64", OneOf(PRECISIONS)] = "float32"
    sample_interval: Annotated[float, "Simulated time between two rows of the time series [s]", Above()] = 0.02
    seed: Annotated[int, "Random seed of the places and sizes of the aggregates", Within(0)] = 0


@dataclass(frozen=True, kw_only=True, repr=False)
class StretchScene(SphereFields, Parametrised, StretchSettings):
    """Mortar with rigid aggregates in a stretch of an endless upright pipe; SI units.

    `concrete` holds the constants of the mortar alone. The axis of the pipe is the z axis.
    """

    name: str
    concrete: Concrete
    radius: float
    """Radius of the pipe [m]."""
    length: float
    """Length of the stretch [m]."""
    gradient: float
    """Pressure gradient that balances friction [Pa/m]. The gradient that balances the weight of mortar and aggregates
    is not included."""
    slips: bool
    """True if mortar slips on the wall with its slip layer; False if it sticks to the wall."""
    mean_velocity: float | None = None
    """Mean velocity that the driving force keeps constant [m/s]; `gradient` is then the gradient by theory for the
    mortar alone. None if the pressure gradient is constant."""
    depth: float = 0.0
    """Extent along y [m] of a flow between two walls at x = -radius and x = radius; it ends at planes of symmetry. The
    value is 0 for a round pipe."""
    remarks: tuple[str, ...] = ()
    parameters: Mapping[str, Any] = field(default_factory=dict)
    """Arguments of the function that created this scene, so that the scene can be created again; empty if the scene was
    not created by such a function."""

    step_error: ClassVar[float] = 0.0
    """Allowed error of a time step; 0, because all time steps have the same length and do not adapt to an error."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, unit in (("radius", "m"), ("length", "m"), ("spacing", "m"), ("gradient", "Pa/m")):
            positive(name, getattr(self, name), unit)
        if not self.aggregate_fraction > 0:
            hint = "use the scene 'tube' for a flow without aggregates"
            refuse("aggregate_fraction", self.aggregate_fraction, "must be above 0", hint)
        self.check_aggregates()
        largest = self.diameters[1]
        if self.length < MIN_LENGTH * largest:
            refuse("length", self.length, f"must be at least {MIN_LENGTH:g} diameters of the largest aggregate, "
                                          "because the stretch is periodic (what leaves one end enters the "
                                          "other), and an aggregate must not be close to its own periodic copy",
                   f"use {at_least(MIN_LENGTH * largest)} m or more")  # fmt: skip
        if self.depth and largest > 0.5 * self.depth:
            problem = "must be at least two diameters of the largest aggregate, because planes of symmetry limit it"
            refuse("depth", self.depth, problem, f"use {at_least(2 * largest)} m or more")
        if largest > self.radius:
            problem = f"must be at most the radius of the pipe, {self.radius:g} m"
            refuse("aggregate_largest", largest, problem, "use smaller aggregates or a wider pipe")
        if 2 * self.radius < MIN_ACROSS * self.spacing:
            problem = f"is too coarse: at least {MIN_ACROSS} cells must fit across the pipe"
            refuse("spacing", self.spacing, problem, f"use {at_most(2 * self.radius / MIN_ACROSS)} m or less")
        stress, words = self.concrete.yield_stress, f"a yield stress of {self.concrete.yield_stress:g} Pa"
        if self.slips:
            stress = least_stress(self.concrete, self.line)
            words += f" and a slip layer of {self.concrete.slip_yield:g} Pa"
        least = self.ways * stress / self.radius
        if self.gradient <= least:
            problem = f"is too small: mortar with {words} does not flow below {least:.4g} Pa/m"
            refuse("gradient", self.gradient, problem, f"use {at_least(1.5 * least)} Pa/m or more")

    @property
    def cell_width(self) -> float:
        """Largest width of the cells [m]; a whole number of cells fits into the radius and into the length."""
        return max(side / max(1, round(side / self.spacing)) for side in (self.radius, self.length))

    @cached_property
    def mortar_alone(self) -> Steady:
        """Steady flow of the mortar without aggregates at the same pressure gradient, by theory."""
        return flow_of_pressure(self.concrete, self.line, self.gradient * self.length, self.form)

    @property
    def form(self) -> str:
        """Form of the closed-form theory: "pipe" for a round pipe, "plane" for a flow between two planes."""
        return "plane" if self.depth else "pipe"

    @property
    def ways(self) -> int:
        """Constant c in the balance of forces, pressure gradient times radius = c times wall stress.

        The constant is 2 in a round pipe, and 1 between two planes.
        """
        return 1 if self.depth else 2

    @property
    def wall_area(self) -> float:
        """Area of the pipe's wall, or of both planes in a flow between planes [m2]."""
        return self.length * (2 * self.depth if self.depth else 2 * math.pi * self.radius)

    def aside(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the distance of points from the axis, or from the middle plane between two planes [m]."""
        return np.abs(x) + 0 * y if self.depth else np.hypot(x, y)

    @property
    def line(self) -> Line:
        """Stretch of pipe as a :class:`Line` of the closed-form theory, without weight."""
        return Line(radius=self.radius, length=self.length, gravity=0.0)

    def velocity_alone(self, radius: np.ndarray) -> np.ndarray:
        """Return the velocity [m/s] of the mortar without aggregates, by theory, at distances from the axis [m]."""
        return velocity(self.concrete, self.line, self.mortar_alone, np.minimum(radius, self.radius))

    @property
    def wall_stress(self) -> float:
        """Mean shear stress at the wall in steady flow, which follows from the pressure gradient [Pa]."""
        return self.gradient * self.radius / self.ways

    @property
    def time_step(self) -> float:
        """Length of a time step [s]."""
        fastest = float(self.velocity_alone(np.zeros(1))[0]) + self.settling
        return min(self.courant * self.spacing / fastest, self.sample_interval)

    @property
    def starting_time(self) -> float:
        """Estimated time until the flow of a constant pressure gradient has reached 98 % of its steady value [s].

        The flow approaches its steady value exponentially. The time constant is taken from a Newtonian fluid in a pipe
        (Szymanski 1932), but with a driving force that is reduced by the yield stress.

        A slip layer with a yield stress delays the start. At first, the slip velocity is as low as if the mortar stuck
        to the wall. Each step uses the ratio of friction to slip velocity from the step before. In a step, the slip
        velocity therefore grows at most by a factor, which is the wall stress divided by the layer's yield stress.
        """
        layer = self.slips and self.concrete.slip_yield > 0
        held = self.ways * (least_stress(self.concrete, self.line) if self.slips else self.concrete.yield_stress)
        steady = self.mortar_alone.flow / (math.pi * self.radius**2)
        if self.depth:
            steady = self.mortar_alone.flow / (2 * self.radius * self.depth)
        constant = NEWTONIAN * self.density * steady / (self.gradient - held / self.radius)
        time = constant * math.log(1 / STEADY)
        if layer:
            stiffest = self.concrete.viscosity + self.regularisation * self.concrete.yield_stress
            film = self.wall_stress * self.cell_width / (float(STICKY) * stiffest)
            slip = max(float(self.velocity_alone(np.array([self.radius]))[0]), film)
            time += self.time_step * math.log(slip / film) / math.log(self.wall_stress / self.concrete.slip_yield)
        return time

    @property
    def settling(self) -> float:
        """Speed at which a single aggregate of the largest size settles or rises in mortar without yield stress [m/s].

        The speed follows from Stokes' law, with the viscosity of the mortar at low shear.
        """
        weight = abs(self.aggregate_density - self.concrete.density) * self.gravity
        return 2 / 9 * weight * (self.diameters[1] / 2) ** 2 / self.concrete.viscosity

    @property
    def caption(self) -> str:
        """Text with scene, diameter and mortar, for titles of figures and recordings."""
        wide = "distance of the planes" if self.depth else "diameter"
        drive = f"{1e-3 * self.gradient:.3g} kPa/m" if self.mean_velocity is None else f"{self.mean_velocity:.3g} m/s"
        return (
            f"{self.name}, {wide} {2e3 * self.radius:.4g} mm, mortar {self.concrete.name} with "
            f"{100 * self.aggregate_fraction:.3g} % of aggregates, {drive}"
        )

    @property
    def density(self) -> float:
        """Density of mortar and aggregates together [kg/m3]."""
        return self.density_with(self.simulated_fraction)

    def density_with(self, fraction: float) -> float:
        """Return the density of mortar with the given volume fraction of aggregates [kg/m3]."""
        return self.concrete.density + fraction * (self.aggregate_density - self.concrete.density)

    @property
    def mean_diameter(self) -> float:
        """Mean of the smallest and the largest diameter of the aggregates [m]."""
        return math.fsum(self.diameters) / 2

    def __repr__(self) -> str:
        return (
            f"<StretchScene {self.name!r}: {self.concrete.words}, {self.aggregate_fraction:.0%} aggregates, "
            f"R = {self.radius:g} m, {self.gradient:g} Pa/m, spacing {self.spacing:g} m>"
        )
