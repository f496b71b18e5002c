"""Scenes of the moving particle method: concrete as a Bingham fluid that a piston drives up a pipe.

Two dimensions are a channel between planes 2 R apart, three a round tube (Xu, Li & Jiang 2021, section 3.3).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from .errors import between, one_of, positive, refuse
from .scene import PRECISIONS
from .theory import CONCRETES, MIXES, THICKER_LAYERS, Concrete, Line, flow_of_pressure, steady

FEWEST_ACROSS = 4  # particles over the pipe's width
SHORTEST = 8  # spacings in the column's length: less has no inside that neither piston nor surface disturbs


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
    """1 makes circles or spheres; less, radii that vary by up to 1 - roundness."""

    def __post_init__(self) -> None:
        positive("aggregate share", self.share, "", "leave out aggregates")
        between("aggregate share", self.share, 0, 0.6, "", "denser mixes cannot be placed at random")
        positive("aggregate density", self.density, "kg/m3")
        positive("aggregate viscosity", self.viscosity, "Pa s")
        between("roundness", self.roundness, 0.5, 1)
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
    """Wanted distance of particles [m]; the nearest is taken that divides the channel's width, or the tube's radius."""
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
    """Steady: pressure, wall stress and slip velocity (over the piston's) change by less than this share in 5 ms, and
    in the 5 ms before."""
    sample_interval: float = 5e-3
    """Simulated time between two rows of the series [s]."""
    tolerance: float = 1e-2
    """Of the pressure solve: residual over that at its start, or over what the piston's speed would make."""
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
        positive("time_step", self.time_step, "s")
        if self.duration is not None:
            between("duration", self.duration, self.time_step, np.inf, "s", "one time step at least")
        between("gravity", self.gravity, 0, 1e4, "m/s2")
        positive("regularisation", self.regularisation, "s")
        positive("steadiness", self.steadiness)
        between("sample_interval", self.sample_interval, self.time_step, np.inf, "s", "one time step at least")
        between("tolerance", self.tolerance, 1e-12, 0.5)
        if isinstance(self.seed, bool) or not isinstance(self.seed, int | np.integer) or self.seed < 0:
            refuse("seed", self.seed, "must be a whole number, 0 or more")
        if isinstance(self.most_iterations, bool) or self.most_iterations < 1:
            refuse("most_iterations", self.most_iterations, "must be a whole number, 1 or more")
        one_of("precision", self.precision, PRECISIONS)
        if self.literal and self.aggregates is not None:
            refuse("literal", True, "shows the scheme of one phase", "leave out aggregates")
        across = 2 * self.radius / self.spacing
        if across < FEWEST_ACROSS - 0.5:
            refuse(
                "spacing", self.spacing, f"leaves {across:.2g} particles across the pipe; at least {FEWEST_ACROSS} are "
                "needed", f"take {2 * self.radius / FEWEST_ACROSS:g} m or less"
            )  # fmt: skip
        if self.length < SHORTEST * self.spacing:
            refuse("length", self.length, f"must hold {SHORTEST} particles, {SHORTEST * self.spacing:g} m")
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


def concrete_of(mix: str, slip_thickness: float = 0.0, **constants: float | None) -> Concrete:
    """A named concrete, or `mix="own"` with all five constants; those that are given replace the mix's.

    A slip layer of one of the thicknesses of the paper's Table 3 has the eta_L printed there.
    """
    one_of("mix", mix, (*CONCRETES, "own"))
    given = {name: value for name, value in constants.items() if value is not None}
    if mix == "own":
        missing = sorted(set(constants) - set(given))
        if missing:
            refuse("mix", mix, f"needs {', '.join(missing)}", f"give them, or take one of {', '.join(CONCRETES)}")
        return Concrete(name="own", **given)
    concrete = CONCRETES[mix]
    if slip_thickness > 0 and "slip_viscosity" not in given:
        table = THICKER_LAYERS[mix]
        match = [eta for thickness, eta in table.items() if abs(thickness - slip_thickness) < 1e-9]
        if not match:
            printed = ", ".join(f"{x:g}" for x in table)
            refuse(
                "slip_thickness", slip_thickness, f"has no printed constants ({printed} have)", "give slip_viscosity"
            )
        given["slip_viscosity"] = match[0]
    return replace(concrete, **given) if given else concrete


@dataclass(frozen=True, kw_only=True)
class Column:
    """A concrete, the pipe it is in, and what drives it: what `channel` and `tube` have in common."""

    mix: str = "no1"
    """A name of `theory.CONCRETES`, or `own`."""
    density: float | None = None
    """[kg/m3]; this and the next four replace the mix's constants."""
    viscosity: float | None = None
    yield_stress: float | None = None
    slip_viscosity: float | None = None
    slip_yield: float | None = None
    slip_thickness: float = 0.0
    """[m]; the concrete is thinner by it."""
    radius: float = 0.05
    """Of the pipe [m]."""
    length: float = 0.3
    """Of the concrete [m]."""
    flow: float | None = None
    """Through a round pipe of the radius [m3/s]; 1500 cm3/s if neither this nor `pressure` is given."""
    pressure: float | None = None
    """On the piston [Pa]; theory tells the flow."""
    aggregates: bool = False
    aggregate_share: float | None = None
    """Of the volume; None: the mix's gravel."""
    aggregate_viscosity: float = 1e4
    aggregate_density: float = 2630.0
    inclusions: str = "auto"
    """How :func:`mortar_of` takes the aggregate: `spheres`, `discs`, or what it is in so many dimensions."""
    mortar_viscosity: float | None = None
    """None: by :func:`mortar_of`, as the next."""
    mortar_yield: float | None = None
    gravity: float = 9.81

    def concrete(self) -> Concrete:
        """Its constants."""
        return concrete_of(
            self.mix, self.slip_thickness, density=self.density, viscosity=self.viscosity,
            yield_stress=self.yield_stress, slip_viscosity=self.slip_viscosity, slip_yield=self.slip_yield,
        )  # fmt: skip

    def coarse(self, concrete: Concrete, dimensions: int) -> Aggregates | None:
        """The coarse aggregate and its mortar, if there are two phases."""
        if not self.aggregates:
            return None
        share = self.aggregate_share
        positive("aggregate_density", self.aggregate_density, "kg/m3")
        if share == 0:
            return None
        if share is None:
            if self.mix not in MIXES:
                refuse("aggregate_share", None, "is needed for a mix of one's own")
            share = MIXES[self.mix]["gravel"] / self.aggregate_density
        one_of("inclusions", self.inclusions, ("auto", *SUSPENSIONS))
        inclusions = self.inclusions if self.inclusions != "auto" else "discs" if dimensions == 2 else "spheres"
        mortar = mortar_of(concrete, share, self.aggregate_density, inclusions)
        own = {"viscosity": self.mortar_viscosity, "yield_stress": self.mortar_yield}
        mortar = replace(mortar, **{key: value for key, value in own.items() if value is not None})
        return Aggregates(
            share=share, mortar=mortar, density=self.aggregate_density, viscosity=self.aggregate_viscosity
        )


def driven_column(name: str, dimensions: int, column: Column, **others: Any) -> FluidScene:
    """Scene of a column; `others` go to :class:`FluidScene` as they are.

    Raises :class:`SceneError` where the pressure moves nothing.
    """
    positive("radius", column.radius, "m")
    between("slip_thickness", column.slip_thickness, 0, np.nextafter(column.radius, 0), "m", "less than the radius")
    concrete = column.concrete()
    bulk, flow = column.radius - column.slip_thickness, column.flow
    if column.pressure is not None:
        if flow is not None:
            refuse("flow", flow, "is given together with pressure", "leave out one of both")
        line = Line(radius=bulk, length=column.length, gravity=column.gravity)
        flow = flow_of_pressure(concrete, line, column.pressure, "plane" if dimensions == 2 else "pipe").flow
    elif flow is None:
        flow = 1500e-6
    positive("flow", flow, "m3/s", "at rest there is nothing to simulate")
    return FluidScene(
        name=name,
        concrete=concrete,
        dimensions=dimensions,
        radius=bulk,
        length=column.length,
        velocity=flow / (np.pi * bulk**2),
        gravity=column.gravity,
        aggregates=column.coarse(concrete, dimensions),
        **others,
    )


def scene_of(name: str, dimensions: int, given: dict[str, Any], paper: Mapping[str, Any]) -> FluidScene:
    """Scene of the parameters of a scene function; `paper` has the printed figures of each mix."""
    names = {f.name for f in fields(Column)}
    column = Column(**{k: v for k, v in given.items() if k in names})
    rest = {k: v for k, v in given.items() if k not in names}
    # What the paper prints holds for its own case, one phase, thin layer.
    own = replace(column, aggregates=False, pressure=None, flow=column.flow or 1500e-6) == Column(
        mix=column.mix, flow=1500e-6
    )
    printed = paper.get(column.mix, {}) if own and column.pressure is None else {}
    return driven_column(name, dimensions, column, parameters=given, notes={"paper": printed}, **rest)


def check_flow(run) -> dict[str, tuple[bool, str]]:
    """Acceptance of a flow: name -> (passed, what was found). Two phases may differ more from one fluid's theory."""
    result, two = run.result, run.scene.aggregates is not None
    limit = 0.03 if two else 0.02 if run.scene.dimensions == 3 else 0.01
    pressure, slip = result["pressure_error"], result["slip_velocity_error"]
    balance, time = result["force_balance_error"], result["simulated_time"]["value"]
    found = {
        "steady": (result["steady"] or run.scene.duration is not None, f"after {time:g} s"),
        "pressure": (abs(pressure) < limit, f"{100 * pressure:+.2f} % from theory"),
        "volume": (abs(result["volume_error"]) < 1e-3, f"{100 * result['volume_error']:+.3f} % at most"),
        "balance of forces": (abs(balance) < 5e-3, f"{100 * balance:+.2f} % of the piston's force"),
    }  # fmt: skip
    if not two:
        found["slip velocity"] = (abs(slip) < limit, f"{100 * slip:+.2f} % of the mean velocity from theory")
        found["profile"] = (
            result["profile_error"] < 0.01,
            f"rms {100 * result['profile_error']:.2f} % of the mean velocity",
        )
    return found


SUSPENSIONS = {"spheres": (2.5, 0.60), "discs": (2.0, 0.82)}
"""Intrinsic viscosity and densest random packing of rigid inclusions: in three dimensions, and in two."""


def mortar_of(concrete: Concrete, share: float, density: float, inclusions: str = "spheres") -> Concrete:
    """Mortar whose mix with a `share` of coarse aggregate of `density` gives `concrete`, by homogenisation.

    Krieger & Dougherty for the viscosity, f = (1 - share / most)^(-intrinsic most), and Chateau, Ovarlez & Trung
    (2008) for the yield stress, the root of (1 - share) f; `inclusions` names the constants in :data:`SUSPENSIONS`. An
    assumption: the paper measured its mortars and does not print them.
    """
    one_of("inclusions", inclusions, SUSPENSIONS)
    intrinsic, most = SUSPENSIONS[inclusions]
    between("aggregate share", share, 0, np.nextafter(most, 0), "", "less than the densest packing")
    factor = (1 - share / most) ** (-intrinsic * most)
    rest = (concrete.density - share * density) / (1 - share)
    return Concrete(
        name=f"mortar of {concrete.name}",
        density=rest,
        viscosity=concrete.viscosity / factor,
        yield_stress=concrete.yield_stress / np.sqrt((1 - share) * factor),
        slip_viscosity=concrete.slip_viscosity,
        slip_yield=concrete.slip_yield,
    )
