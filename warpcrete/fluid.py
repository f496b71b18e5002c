"""Scenes of the moving particle method: concrete as a Bingham fluid that a piston drives up a pipe.

Two dimensions are a channel between planes 2 R apart, three a round tube (Xu, Li & Jiang 2021, section 3.3).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .errors import between, one_of, positive, refuse
from .scene import PRECISIONS
from .theory import Concrete, Line, least_stress, steady

FEWEST_ACROSS = 4  # particles over the pipe's width


@dataclass(frozen=True, kw_only=True)
class Aggregates:
    """Coarse aggregate of the two-phase model: rigid groups of elementary particles in mortar."""

    share: float
    """Of the volume."""
    mortar: Concrete
    """Bingham constants and density of what is between them; its slip layer is the concrete's."""
    density: float = 2630.0
    """[kg/m3]"""
    viscosity: float = 1e4
    """mu_CA [Pa s], of aggregate in the pairwise viscous forces: a numerical rigidity."""
    sizes: tuple[tuple[float, float, float], ...] = ((5e-3, 10e-3, 0.3), (10e-3, 15e-3, 0.4), (15e-3, 20e-3, 0.3))
    """Smallest and largest size [m] and share of each class, by volume."""
    roundness: float = 0.6
    """1 makes circles or spheres; less, outlines that vary by up to 1 - roundness."""

    def __post_init__(self) -> None:
        between("aggregate share", self.share, 0, 0.6, "", "denser mixes cannot be placed at random")
        positive("aggregate density", self.density, "kg/m3")
        positive("aggregate viscosity", self.viscosity, "Pa s")
        between("roundness", self.roundness, 0.1, 1)
        for smallest, largest, share in self.sizes:
            positive("aggregate size", smallest, "m")
            between("aggregate size", largest, smallest, np.inf, "m")
            between("share of a size class", share, 0, 1)


@dataclass(frozen=True, kw_only=True)
class FluidScene:
    """A column of concrete in a pipe, driven from below by a piston at constant speed; SI units."""

    name: str
    concrete: Concrete
    dimensions: int
    """2: channel of width 2 R; 3: round tube."""
    radius: float
    """R [m]"""
    length: float
    """Of the column [m]."""
    velocity: float
    """Of the piston [m/s]."""
    spacing: float
    """Wanted distance of particles [m]; the nearest that divides the radius is taken."""
    duration: float | None = None
    """Simulated time [s]; None: until steady."""
    time_step: float = 5e-4
    """[s]"""
    gravity: float = 9.81
    """Against the flow [m/s2]; 0 for a level pipe."""
    regularisation: float = 100.0
    """beta [s] of the regularised law (Eq. 14)."""
    aggregates: Aggregates | None = None
    literal: bool = False
    """The scheme as the paper prints it, to show what it does."""
    steadiness: float = 1e-3
    """Steady: over `sample_interval` no figure of the series changes by more than this share."""
    sample_interval: float = 5e-3
    """Simulated time between two rows of the series [s]."""
    tolerance: float = 1e-2
    """Of the pressure solve: residual over that at its start."""
    most_iterations: int = 2000
    """Of a solve, before it counts as failed."""
    seed: int = 0
    precision: str = "float32"
    parameters: Mapping[str, Any] = field(default_factory=dict)
    notes: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        one_of("dimensions", self.dimensions, (2, 3))
        positive("radius", self.radius, "m")
        positive("length", self.length, "m")
        positive("velocity", self.velocity, "m/s", "at rest there is nothing to simulate")
        positive("spacing", self.spacing, "m")
        if self.duration is not None:
            between("duration", self.duration, 0, np.inf, "s")
        positive("time_step", self.time_step, "s")
        between("gravity", self.gravity, 0, 1e4, "m/s2")
        positive("regularisation", self.regularisation, "s")
        positive("steadiness", self.steadiness)
        positive("sample_interval", self.sample_interval, "s")
        between("tolerance", self.tolerance, 1e-12, 0.5)
        if isinstance(self.seed, bool) or not isinstance(self.seed, int | np.integer) or self.seed < 0:
            refuse("seed", self.seed, "must be a whole number, 0 or more")
        if isinstance(self.most_iterations, bool) or self.most_iterations < 1:
            refuse("most_iterations", self.most_iterations, "must be a whole number, 1 or more")
        one_of("precision", self.precision, PRECISIONS)
        across = 2 * self.radius / self.spacing
        if across < FEWEST_ACROSS - 0.5:
            refuse(
                "spacing", self.spacing, f"leaves {across:.2g} particles across the pipe; at least {FEWEST_ACROSS} are "
                "needed", f"take {2 * self.radius / FEWEST_ACROSS:g} m or less"
            )  # fmt: skip
        if self.length < 2 * self.spacing:
            refuse("length", self.length, f"must hold two particles, {2 * self.spacing:g} m")
        if self.time_step * self.velocity > 0.5 * self.spacing:
            refuse(
                "time_step", self.time_step, "lets the piston pass more than half a particle a step",
                f"take {0.5 * self.spacing / self.velocity:.3g} s or less"
            )  # fmt: skip

    @property
    def form(self) -> str:
        """Form of the theory to compare with."""
        return "plane" if self.dimensions == 2 else "pipe"

    @property
    def line(self) -> Line:
        """The pipe as the theory sees it."""
        return Line(radius=self.radius, length=self.length, gravity=self.gravity)

    def theory(self):
        """The steady state by closed form."""
        return steady(self.concrete, self.line, np.pi * self.radius**2 * self.velocity, self.form)

    def least_stress(self) -> float:
        """Wall stress below which nothing flows [Pa]."""
        return least_stress(self.concrete, self.line)


def mortar_of(concrete: Concrete, share: float, density: float, most: float = 0.6) -> Concrete:
    """Mortar whose mix with a `share` of coarse aggregate of `density` gives `concrete`, by homogenisation.

    Krieger & Dougherty for the viscosity, (1 - share / most)^(-2.5 most) with the densest packing `most`, and
    Chateau, Ovarlez & Trung (2008) for the yield stress, the root of (1 - share) times that. An assumption: the
    paper measured its mortars and does not print them.
    """
    between("aggregate share", share, 0, np.nextafter(most, 0), "", "less than the densest packing")
    factor = (1 - share / most) ** (-2.5 * most)
    rest = (concrete.density - share * density) / (1 - share)
    return Concrete(
        name=f"mortar of {concrete.name}",
        density=rest,
        viscosity=concrete.viscosity / factor,
        yield_stress=concrete.yield_stress / np.sqrt((1 - share) * factor),
        slip_viscosity=concrete.slip_viscosity,
        slip_yield=concrete.slip_yield,
    )
