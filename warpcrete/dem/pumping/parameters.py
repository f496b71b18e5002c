"""Parameters of pumping aggregates through one pipe unit, in groups (Zhan et al. 2019).

The first line of each parameter class is the heading of its group in the command's help.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

from ...core.device.device import PRECISIONS
from ...core.errors import refuse
from ...core.inputs.concretes import is_file, shipped
from ...core.inputs.knobs import Knob, Level, precisions, scaled
from ...core.inputs.parameters import Above, Alias, Declared, FileIf, Needs, OneOf, Suggests, Within, declared_fields
from ...geometry.walls import Stops
from ..laws import OWN_LAW, OWN_WALL_LAW, LawChoice, LubricationLayer, WallLawChoice
from ..laws.linear import DASHPOTS
from ..scene.concretes import elements_of
from ..scene.scene import MUCH_STIFFER, Blockage, Wear

UNITS = ("vertical", "horizontal", "bend-to-horizontal", "bend-to-vertical")
OTHER_NAMES = dict(zip("ABCD", UNITS, strict=True)) | {"elbow-up": UNITS[2], "elbow-down": UNITS[3]}
"""Other accepted names of pipe units: the letters of Zhan et al. 2019, and names from earlier versions."""


def unit_names() -> tuple[str, ...]:
    """Return the names of the pipe units."""
    return UNITS


UPRIGHT = 0.4
"""Ratio of thickness to diameter from which a plug stays upright after a bend; at 0.13 it tipped over in test runs."""
WIDEST_STONE = 0.4
"""Ratio of the largest pumpable rounded aggregate to the pipe's diameter (ACI 304.2R; for crushed aggregate, 1/3)."""


def names_meshes(shapes: str) -> bool:
    """Return whether the parameter `shapes` contains paths of mesh files instead of names of shapes."""
    return any(Path(one).suffix and not one.strip().startswith("shape-") for one in shapes.split(","))


BONDED = Needs("bonds", bool, "is on")
HYDRATED = Needs("hydration", lambda fraction: fraction > 0, "is above 0")
FROM_FILE = Needs("wall", lambda wall: wall not in ("analytic", "mesh"), "is a file")
FACETED = Needs("wall", lambda wall: wall == "mesh", "is mesh")
OF_MESHES = Needs("shapes", names_meshes, "names mesh files")
SEVERAL = Needs("shapes", lambda shapes: shapes == "reference" or "," in shapes, "names several shapes")
NORMAL = Needs("sizes", lambda sizes: sizes == "gaussian", "is gaussian")
RANGED = Needs("sizes", lambda sizes: sizes in ("gaussian", "uniform"), "is gaussian or uniform")
BY_ITSELF = Needs("bulk_density", lambda bulk: bulk is None, "is left out")
OF_BALLS = Needs("plug", lambda plug: plug == "balls", "is balls")
STROKES = Needs("strokes", lambda strokes: strokes > 1, "is 2 or more")
RESTED = Needs("rest", lambda rest: rest > 0, "is above 0")
PLUGGED = Needs("plug", lambda plug: plug != "none", "is balls or plate")
WORN = Needs("wear", bool, "is on")


@dataclass(frozen=True, kw_only=True)
class UnitParameters:
    """Pipe unit.

    Shape and dimensions of the pipe, and the length of concrete in it.
    """

    common: ClassVar[tuple[str, ...]] = ("unit", "diameter", "elbow_radius", "length", "wall")

    unit: Annotated[
        str,
        "Unit: vertical, horizontal, bend-to-horizontal (flow enters upward), bend-to-vertical (flow enters "
        "horizontally); or A, B, C, D",
        Suggests(unit_names),
    ] = "vertical"
    diameter: Annotated[float, "Inner diameter of the pipe [m]", Above()] = 0.15
    elbow_radius: Annotated[float, "Radius of a bend's centreline [m]", Above()] = 0.5
    length: Annotated[float, "Length of the concrete in the pipe at the start [m]", Above()] = 1.0
    wall: Annotated[
        str, "Wall of the pipe: analytic, mesh, or the path of an STL file of a wall around the same axis"
    ] = "analytic"
    wall_scale: Annotated[float, "Factor from the units of the wall file to metres", Above(), FROM_FILE] = 1.0
    facets: Annotated[int, "Number of facets around the pipe of wall=mesh", Within(3, 100_000), FACETED] = 64


@dataclass(frozen=True, kw_only=True)
class PistonParameters:
    """Piston.

    Motion of the piston that pushes the concrete.
    """

    common: ClassVar[tuple[str, ...]] = ("velocity", "travel")

    velocity: Annotated[float, "Final velocity of the piston [m/s]", Above(), Within(0, 1e3)] = 0.3
    ramp: Annotated[float, "Travel over which the velocity rises linearly from rest [m]", Within(0)] = 0.3
    travel: Annotated[
        float | None,
        "Total travel of the piston [m]; default: the travel of all strokes or, without strokes, twice the ramp; in "
        "bends pi/2 x elbow_radius",
        Above(),
    ] = None


@dataclass(frozen=True, kw_only=True)
class StrokeParameters:
    """Strokes and stops.

    Division of the piston's travel into strokes, with pauses or a rest of the concrete between them.
    """

    common: ClassVar[tuple[str, ...]] = ("strokes", "pause", "rest")

    strokes: Annotated[
        int, "Number of strokes of the piston; it stops between them and starts again over the ramp", Within(1, 1000)
    ] = 1
    stroke: Annotated[
        float | None,
        "Travel of each stroke [m]; default: an equal part of the travel; without a travel three ramps, in bends an "
        "equal part of the arc",
        Above(), STROKES,
    ] = None  # fmt: skip
    pause: Annotated[
        float, "Duration of each stop of the piston between strokes [s]; 0: no stop", Within(0), STROKES
    ] = 0.5
    rest: Annotated[
        float, "Time at rest before the last stroke [s]; its effect on the strengths is computed by a law, not in "
               "time steps", Within(0),
        STROKES,
    ] = 0.0  # fmt: skip
    thixotropy: Annotated[
        float,
        "Growth rate A_thix of yield stress and bond strengths at rest [Pa/s]; 0.1 to 1.7 (Roussel 2006)",
        Within(0),
        RESTED,
    ] = 0.5
    breakdown: Annotated[
        float,
        "Slip along the wall over which the layer's yield stress gained at rest falls to 1/e [m]",
        Above(),
        RESTED,
    ] = 0.1


@dataclass(frozen=True, kw_only=True)
class ConcreteChoice:
    """Concrete.

    Choice of a named concrete, which supplies defaults of aggregate, contacts and bonds.
    """

    concrete: Annotated[
        str,
        "Concrete: zhan (Table 1 and a wall layer calibrated on units A and B), zhan-table1, no1, no2, no3, or the "
        "path of a .yaml file; it sets the parameters of aggregate, contacts and bonds that are not given",
        FileIf(is_file),
        Suggests(shipped),
    ] = "zhan"


@dataclass(frozen=True, kw_only=True)
class AggregateParameters:
    """Aggregate.

    Shapes, sizes and density of the aggregates, and how densely they are packed.
    """

    common: ClassVar[tuple[str, ...]] = ("shapes", "size_min", "size_max")

    shapes: Annotated[
        str,
        "Shapes of the aggregates: spheres, reference (four clumps), shape-F with shape factor F, or paths of "
        "closed meshes",
    ] = "spheres"
    shape_spheres: Annotated[int, "Number of spheres that represent each mesh in shapes", OF_MESHES] = 10
    fractions: Annotated[
        str | None, "Fraction by volume of each shape, as '2,1,1,1'; default: equal fractions", SEVERAL, Alias("shares")
    ] = None
    sizes: Annotated[str, "Size distribution: gaussian, uniform, or a sieve curve 'mm:passing,...' by mass"] = (
        "gaussian"
    )
    size_min: Annotated[float, "Smallest size [m]", Above(), RANGED] = 5e-3
    size_max: Annotated[float, "Largest size [m]", Above(), RANGED] = 20e-3
    size_mean: Annotated[
        float | None, "Mean of the gaussian size distribution [m]; default: middle of the range", Above(), NORMAL
    ] = None
    size_deviation: Annotated[
        float | None,
        "Standard deviation of the gaussian size distribution [m]; default: half the range",
        Above(),
        NORMAL,
    ] = None
    density: Annotated[
        float, "Density of the aggregates, if they carry only their own mass [kg/m3]", Above(), BY_ITSELF
    ] = 2500.0
    bulk_density: Annotated[
        float | None,
        "Density of the concrete [kg/m3]; if given, the aggregates carry the mass of the mortar, too",
        Above(),
    ] = None
    solid_fraction: Annotated[
        float | None, "Solid fraction of the packing; default: packed until the plug's pressure is reached"
    ] = None


@dataclass(frozen=True, kw_only=True)
class ContactParameters:
    """Contacts.

    Linear contact law between aggregates, and friction and lubrication layer on the walls.
    """

    common: ClassVar[tuple[str, ...]] = ()

    modulus: Annotated[float, "Effective modulus of contacts [Pa]", Above(), OWN_LAW] = 1e5
    stiffness_ratio: Annotated[float, "Ratio of normal to shear contact stiffness", Above(), OWN_LAW] = 2.0
    friction: Annotated[float, "Friction coefficient between aggregates", Within(0), OWN_LAW] = 0.05
    wall_friction: Annotated[float | None, "Friction coefficient on the pipe and the piston; default: the value of "
                                           "friction", Within(0), OWN_LAW,
                             OWN_WALL_LAW] = None  # fmt: skip
    layer_yield: Annotated[float, "Yield stress of a lubrication layer on pipe and piston [Pa]", Within(0), OWN_LAW,
                           OWN_WALL_LAW] = 0.0  # fmt: skip
    layer_viscosity: Annotated[
        float, "Viscosity of the lubrication layer divided by its thickness [Pa s/m]", Within(0), OWN_LAW, OWN_WALL_LAW
    ] = 0.0
    normal_damping: Annotated[
        float, "Damping of the normal dashpot as a fraction of critical damping", Within(0), OWN_LAW
    ] = 0.5
    shear_damping: Annotated[
        float, "Damping of the shear dashpot as a fraction of critical damping", Within(0), OWN_LAW
    ] = 0.0
    dashpot: Annotated[
        str,
        "Mode of the dashpots: full, no-tension (the total normal force never pulls), slip-cut (no shear dashpot in "
        "slip), both",
        OneOf(DASHPOTS),
        OWN_LAW,
    ] = "full"


@dataclass(frozen=True, kw_only=True)
class BondParameters:
    """Bonds (mortar).

    Strength and stiffness of the bonds between aggregates, and the share of hydrated bonds.
    """

    common: ClassVar[tuple[str, ...]] = ("bonds", "hydration")

    bonds: Annotated[bool, "Bond the aggregates in contact before pumping starts"] = True
    bond_modulus: Annotated[float, "Effective modulus of bonds [Pa]", Above(), BONDED] = 2e4
    bond_stiffness_ratio: Annotated[float, "Ratio of normal to shear bond stiffness", Above(), BONDED] = 2.0
    tensile_strength: Annotated[float, "Tensile strength of bonds [Pa]", Within(0), BONDED] = 10.0
    cohesion: Annotated[float, "Cohesion of bonds [Pa]", Within(0), BONDED] = 5.0
    friction_angle: Annotated[float, "Friction angle of bonds [degrees]", Within(0, 89), BONDED] = 30.0
    bond_gap: Annotated[float, "Largest gap across which bonds are made [m]", Within(0), BONDED] = 0.0
    healing: Annotated[bool, "Bond new contacts when they touch", BONDED] = False
    hydration: Annotated[float, "Fraction of the bonds that is hydrated", Within(0, 1), BONDED] = 0.0
    hydration_modulus: Annotated[float, "Effective modulus of hydrated bonds [Pa]", Above(), HYDRATED] = 1e9
    hydration_strength: Annotated[
        float, "Tensile strength of hydrated bonds [Pa]; their cohesion is half of it", Within(0), HYDRATED
    ] = 1e6


@dataclass(frozen=True, kw_only=True)
class PlugParameters:
    """Plug, the front of the concrete.

    Balls or a plate that close the front and carry a pressure against the flow.
    """

    common: ClassVar[tuple[str, ...]] = ()

    plug: Annotated[
        str,
        "Plug at the front of the concrete: balls (bonded), plate (straight pipes only) or none",
        OneOf(("balls", "plate", "none")),
    ] = "balls"
    plug_pressure: Annotated[float, "Pressure of the plug against the flow [Pa]", Within(0), PLUGGED] = 1e3
    plug_ball: Annotated[
        float, "Diameter of the plug's balls, or half the thickness of the plate [m]", Above(), PLUGGED
    ] = 10e-3
    plug_layers: Annotated[
        int | None,
        "Number of layers of balls in the plug; default: 2, in bends as many as fit into 0.4 diameters",
        Within(1, 1000),
        OF_BALLS,
    ] = None


@dataclass(frozen=True, kw_only=True)
class IndexParameters:
    """Wear, segregation and blockage.

    Additional measurements of a run.
    """

    common: ClassVar[tuple[str, ...]] = ("wear", "segregation", "stop_when_blocked")

    wear: Annotated[bool, "Sum up sliding and impacts on the walls, patch by patch"] = False
    wear_coefficient: Annotated[
        float, "Archard's wear coefficient K/H, worn volume per load and sliding distance [m2/N]; 1e-13 to 1e-12 for "
               "steel worn by stones",
        Within(0), WORN,
    ] = Wear.coefficient  # fmt: skip
    wear_patch: Annotated[
        float | None, "Edge length of a patch of the pipe's wall [m]; default: 1/24 of its circumference", Above(), WORN
    ] = None
    segregation: Annotated[bool, "Measure the distribution of the aggregate and of its large stones in the pipe"] = (
        False
    )
    blocked_travel: Annotated[
        float | None,
        "Travel of the piston during which part of the concrete must stand still for the pipe to count as blocked "
        "[m]; default: 1/20 of the concrete's length; for soft aggregates one diameter, but at most 1/5 of that "
        "length",
        Above(),
    ] = None
    stop_when_blocked: Annotated[bool, "End the run when the pipe is blocked"] = False


@dataclass(frozen=True, kw_only=True)
class RunParameters(Declared):
    """Run.

    Settings of the computation: time step, limits, precision and output.
    """

    common: ClassVar[tuple[str, ...]] = ("seed",)

    gravity: Annotated[float, "Gravitational acceleration [m/s2]", Within(-1e4, 1e4)] = 9.81
    settle: Annotated[float, "Longest time to settle under gravity and plug pressure before the start [s]",
                      Within(0)] = 2.0  # fmt: skip
    time_step: Annotated[float | None, "Fixed time step [s]; default: automatic", Above()] = None
    hydration_rounds: Annotated[
        int | None,
        "Number of sub-steps in which hydrated bonds are integrated within one time step; default: as many as needed "
        "if they are much stiffer than everything else; 1: no sub-steps, so that these bonds limit the time step",
        HYDRATED,
    ] = None
    safety: Annotated[
        float, "Ratio of the automatic time step to the stable one; a value above 1 overrules the estimate"
    ] = 0.8
    overlap_limit: Annotated[
        float,
        "Overlap at which the run stops, as a multiple of the overlap that swallows an aggregate; 0: no limit",
        Within(0),
    ] = 1.5
    energy_balance: Annotated[bool, "Sum up the energy that friction, dashpots and breaking bonds dissipate"] = False
    precision: Annotated[str, "Precision of positions and forces: float32 or float64", OneOf(PRECISIONS)] = "float32"
    sample_interval: Annotated[float, "Simulated time between two rows of the series [s]", Above()] = 0.01
    seed: Annotated[int, "Random seed", Within(0)] = 0


class ConcreteDefaults:
    """Mixin for scene parameters that contain a named concrete, which supplies defaults for other parameters.

    The mixin also turns paths of mesh files in `shapes` into absolute paths.
    """

    @classmethod
    def of_concrete(cls) -> tuple[str, tuple[str, ...]]:
        groups = (AggregateParameters, ContactParameters, BondParameters)
        return "elements", tuple(name for group in groups for name in declared_fields(group))

    @classmethod
    def implied(cls, values: Mapping[str, Any]) -> Mapping[str, Any]:
        return elements_of(values, cls.of_concrete()[1], ConcreteChoice.concrete)

    def __post_init__(self) -> None:
        super().__post_init__()  # type: ignore[misc]
        shapes: str = self.shapes  # type: ignore[attr-defined]
        if names_meshes(shapes):
            whole = ",".join(os.path.realpath(one.strip()) for one in shapes.split(","))
            object.__setattr__(self, "shapes", whole)


@dataclass(frozen=True, kw_only=True)
class PipeParameters(
    ConcreteDefaults, UnitParameters, PistonParameters, StrokeParameters, ConcreteChoice, AggregateParameters,
    LawChoice, WallLawChoice, ContactParameters, BondParameters, PlugParameters, IndexParameters, RunParameters,
):  # fmt: skip
    """All parameters of pumping concrete through one pipe unit."""

    def __post_init__(self) -> None:
        super().__post_init__()
        unit = OTHER_NAMES.get(self.unit.upper(), OTHER_NAMES.get(self.unit, self.unit))
        OneOf(UNITS).check("unit", unit, "")
        object.__setattr__(self, "unit", unit)
        if self.wall not in ("analytic", "mesh"):
            object.__setattr__(self, "wall", os.path.realpath(self.wall))
        if self.is_bend:
            if self.elbow_radius <= self.radius:
                refuse("elbow_radius", self.elbow_radius, f"must exceed the pipe's radius, {self.radius:g} m")
            if self.distance > self.arc * (1 + 1e-9):
                longest = f"must not exceed the length of the bend's arc, {self.arc:.6g} m"
                if self.stroke is not None:
                    refuse("stroke", self.stroke, f"times {self.strokes} strokes {longest}")
                refuse("travel", self.travel, longest)
            if self.plug == "plate":
                refuse(
                    "plug",
                    self.plug,
                    "must not be a plate in a bend, because a plate cannot follow it",
                    "set 'plug' to balls or none",
                )
        self._check_strokes()

    def _check_strokes(self) -> None:
        if self.stroke is not None and self.travel is not None:
            refuse(
                "travel",
                self.travel,
                f"is already set by {self.strokes} strokes of {self.stroke:g} m",
                "leave out 'travel' or 'stroke'",
            )
        if self.stops is not None and self.each < 2 * self.ramp * (1 - 1e-12):
            refuse("stroke", self.each, f"must hold two ramps of {self.ramp:g} m, one from rest and one to rest",
                   "use longer strokes, or a shorter 'ramp'")  # fmt: skip
        if self.rest > 0 and self.pause == 0:
            refuse(
                "rest",
                self.rest,
                "takes place in the last stop between strokes, and there is no stop",
                "set 'pause' above 0 and 'strokes' to 2 or more",
            )
        layer = (
            self.layer_yield or self.layer_viscosity or isinstance(self.wall_contact or self.contact, LubricationLayer)
        )
        if self.rest > 0 and not (self.bonds or layer):
            refuse("rest", self.rest, "has no effect, because there are no bonds and no lubrication layer on the wall",
                   "switch on 'bonds', or set 'layer_yield' above 0")  # fmt: skip

    @property
    def is_bend(self) -> bool:
        return self.unit.startswith("bend")

    @property
    def radius(self) -> float:
        """Radius of the pipe [m]."""
        return self.diameter / 2

    @property
    def area(self) -> float:
        """Area of the pipe's cross-section [m2]."""
        return math.pi * self.radius**2

    @property
    def arc(self) -> float:
        """Length of the centreline of the unit's bend [m]."""
        return math.pi / 2 * self.elbow_radius

    @property
    def distance(self) -> float:
        """Travel of the piston [m]."""
        if self.travel is not None:
            return self.travel
        if self.stroke is not None:
            return self.strokes * self.stroke
        if self.strokes > 1 and self.pause > 0 and self.ramp > 0 and not self.is_bend:
            return self.strokes * 3 * self.ramp
        return self.arc if self.is_bend else 2 * self.ramp if self.ramp > 0 else self.length

    @property
    def ramp_time(self) -> float:
        """Time in which the piston reaches its final speed [s]."""
        return 2 * self.ramp / self.velocity

    @property
    def each(self) -> float:
        """Travel of the piston in each stroke [m]."""
        return self.distance / self.strokes

    @property
    def stops(self) -> Stops | None:
        """Stops of the piston between strokes, or None if it never stops.

        No stop follows the last stroke: the run ends while the piston moves at full speed.
        """
        if self.strokes == 1 or self.pause == 0:
            return None
        return Stops(count=self.strokes - 1, stroke_time=self.each / self.velocity + self.ramp_time, pause=self.pause)

    @property
    def duration(self) -> float:
        """Duration of the piston's travel, stops included [s]."""
        if self.stops is not None:
            return self.stops.count * self.stops.period + self.ramp_time + (self.each - self.ramp) / self.velocity
        if self.distance <= self.ramp:
            return math.sqrt(2 * self.distance * self.ramp_time / self.velocity)
        return self.ramp_time + (self.distance - self.ramp) / self.velocity

    @property
    def front(self) -> float:
        """Initial arc length of the front [m]: the end of a plug of balls or, without such a plug, of the concrete."""
        return self.length + (self.layers * self.plug_ball if self.plug == "balls" else 0.0)

    @property
    def layers(self) -> int:
        """Number of layers of balls in the plug.

        In a level pipe the weight of the concrete pushes hardest on the lower edge of the plug, harder than the plug's
        pressure can balance. A thin plug would tip over, and the concrete would flow out past it.
        """
        if self.plug_layers is not None:
            return self.plug_layers
        return max(2, math.ceil(UPRIGHT * self.diameter / self.plug_ball - 1e-9)) if self.is_bend else 2


def stiffness_of(given: Any) -> float:
    """Return the stress scale of the contact law between aggregates [Pa]; for the linear law this is its modulus."""
    return given.modulus if given.contact is None else given.contact.stress_scale


def index_settings(given: IndexParameters) -> dict[str, Any]:
    """Return the fields of a :class:`Scene` that configure wear, blockage and segregation measurements."""
    wear = Wear(coefficient=given.wear_coefficient, patch=given.wear_patch) if given.wear else None
    return {
        "wear": wear,
        "blockage": Blockage(travel=given.blocked_travel, stop=given.stop_when_blocked),
        "segregation": given.segregation,
    }


COARSENINGS = (3.0, 2.0, 1.5, 1.0)
FACETS = (16, 32, 64, 128, 256)
SPHERES = (1, 2, 4, 8, 16)
LENGTHS = (0.25, 0.5, 1.0)


def pumping_knobs(given: PipeParameters) -> Iterator[Knob]:
    """Yield the settings that trade accuracy for computing time in a pumping scene.

    One of the settings is coarse-graining, which multiplies all sizes of the aggregate by a factor. The contact laws
    need no rescaling. A contact's stiffness is modulus times area over length, so the stress depends only on the
    overlap relative to the size. The strengths of bonds and lubrication layer are stresses, and dashpots are given by
    their critical ratio. Coarse-graining therefore changes only the number of aggregates across the pipe and the
    momentum that each impact carries.
    """
    if given.time_step is None:
        yield scaled("time step", "safety", given.safety, (2.0, 1.5, 1.0, 0.5, 0.25), -1.0)
    yield precisions()
    if given.sizes in ("gaussian", "uniform"):
        widest = max(WIDEST_STONE * given.diameter / given.size_max, 1.0)
        yield Knob("coarse-graining", tuple(coarser(given, c) for c in COARSENINGS if c <= widest), True)
    if given.shapes == "reference":
        yield Knob(
            "shape", (Level("spheres", {"shapes": "spheres"}, 0.3), Level("reference", {"shapes": "reference"})), True
        )
    elif names_meshes(given.shapes):
        yield Knob(
            "shape",
            tuple(Level(f"{n} spheres", {"shape_spheres": n}, n**0.7) for n in sorted({*SPHERES, given.shape_spheres})),
        )
    if given.wall in ("analytic", "mesh"):
        faceted = [Level(f"{n} facets", {"wall": "mesh", "facets": n}, 1.3) for n in sorted({*FACETS, given.facets})]
        yield Knob("wall", (*faceted, Level("analytic", {"wall": "analytic"})))
    if given.contact is None:
        yield scaled("stiffness", "modulus", given.modulus, (0.25, 0.5, 1.0), 0.5, "Pa", True)
    if given.bonds and given.hydration > 0:
        yield scaled("hydrated stiffness", "hydration_modulus", given.hydration_modulus, (0.01, 0.1, 1.0), 0.5, "Pa",
                     True)  # fmt: skip
        much_stiffer = given.hydration_modulus >= MUCH_STIFFER * max(stiffness_of(given), given.bond_modulus)
        if given.hydration_rounds is None and given.time_step is None and much_stiffer:
            single = Level("single steps", {"hydration_rounds": 1}, 3.0)
            yield Knob("hydrated bonds", (Level("rounds", {"hydration_rounds": None}), single))
    if not given.is_bend:
        # The pressure without the plug's share is proportional to the length of the pipe if the wall stress is uniform
        # along it. The levels use this to convert the pressures of a shorter pipe.
        pushed = given.plug_pressure if given.plug != "none" else 0.0
        yield Knob("length", tuple(
            Level(f"{f * given.length:.4g} m", {"length": f * given.length}, f, f"x {f:g}",
                  {name: (pushed, 1 / f) for name in ("plateau_pressure", "peak_pressure", "end_pressure")})
            for f in LENGTHS
        ), chosen=False)  # fmt: skip
    if given.settle > 0:
        yield scaled("settling", "settle", given.settle, (0.05, 0.2, 1.0), 0.3, "s")


def coarser(given: AggregateParameters, factor: float) -> Level:
    """Return the coarse-graining level at which aggregates are `factor` times as large, with its relative cost."""
    names = ("size_min", "size_max", "size_mean", "size_deviation")
    sizes = {name: factor * getattr(given, name) for name in names if getattr(given, name) is not None}
    # The computing time scales as factor^-4: the number of aggregates as factor^-3, that of steps as factor^-1.
    return Level(f"x {factor:g}", sizes, factor**-4)
