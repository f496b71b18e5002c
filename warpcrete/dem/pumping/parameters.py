"""Parameters of pumping aggregates through one pipe unit, in groups (Zhan et al. 2019).

The first line of each parameter class is the heading of its group in the command's help.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from ...core.device.device import PRECISIONS
from ...core.errors import refuse
from ...core.inputs.concretes import is_file
from ...core.inputs.knobs import Knob, Level, precisions, scaled
from ...core.inputs.parameters import Above, Alias, Declared, FileIf, Needs, OneOf, Within, declared_fields
from ...geometry.walls import Stops
from ..laws import OWN_LAW, OWN_WALL_LAW, LawChoice, LubricationLayer, WallLawChoice
from ..laws.linear import DASHPOTS
from ..scene.concretes import elements_of
from ..scene.scene import MUCH_STIFFER, Blockage, Wear

UNITS = ("vertical", "horizontal", "bend-to-horizontal", "bend-to-vertical")
OTHER_NAMES = dict(zip("ABCD", UNITS, strict=True)) | {"elbow-up": UNITS[2], "elbow-down": UNITS[3]}
"""Other accepted names of pipe units: the paper's letters, and words of earlier versions."""
UPRIGHT = 0.4
"""Thickness over diameter at which a plug stays upright at the end of a bend; a plug of 0.13 tips over (measured)."""
WIDEST_STONE = 0.4
"""Largest rounded aggregate that can be pumped, over the pipe's diameter (ACI 304.2R; a third if crushed)."""


def of_meshes(shapes: str) -> bool:
    """Return whether `shapes` contains paths of mesh files instead of names of shapes."""
    return any(Path(one).suffix and not one.strip().startswith("shape-") for one in shapes.split(","))


BONDED = Needs("bonds", bool, "is on")
HYDRATED = Needs("hydration", lambda fraction: fraction > 0, "is above 0")
FROM_FILE = Needs("wall", lambda wall: wall not in ("analytic", "mesh"), "is a file")
FACETED = Needs("wall", lambda wall: wall == "mesh", "is mesh")
OF_MESHES = Needs("shapes", of_meshes, "names meshes")
SEVERAL = Needs("shapes", lambda shapes: shapes == "reference" or "," in shapes, "names several")
NORMAL = Needs("sizes", lambda sizes: sizes == "gaussian", "is gaussian")
RANGED = Needs("sizes", lambda sizes: sizes in ("gaussian", "uniform"), "is gaussian or uniform")
BY_ITSELF = Needs("bulk_density", lambda bulk: bulk is None, "is not given")
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

    unit: Annotated[
        str, "vertical, horizontal, bend-to-horizontal (upward in), bend-to-vertical (horizontal in); or A, B, C, D"
    ] = "vertical"
    diameter: Annotated[float, "inner, of the pipe [m]", Above()] = 0.15
    elbow_radius: Annotated[float, "of a bend's centreline [m]", Above()] = 0.5
    length: Annotated[float, "of the concrete in the pipe at the start [m]", Above()] = 1.0
    wall: Annotated[str, "of the pipe: analytic, mesh, or the path of an STL file around the same axis"] = "analytic"
    wall_scale: Annotated[float, "factor from the units of the wall file to metres", Above(), FROM_FILE] = 1.0
    facets: Annotated[int, "round the pipe of wall=mesh", Within(3, 100_000), FACETED] = 64


@dataclass(frozen=True, kw_only=True)
class PistonParameters:
    """Piston.

    Motion of the piston that pushes the concrete.
    """

    velocity: Annotated[float, "in the end [m/s]", Above(), Within(0, 1e3)] = 0.3
    ramp: Annotated[float, "travel over which the velocity rises linearly from rest [m]", Within(0)] = 0.3
    travel: Annotated[
        float | None,
        "at the end [m]; default: that of all strokes, or twice the ramp, the length without one, in bends "
        "pi/2 x elbow_radius",
        Above(),
    ] = None


@dataclass(frozen=True, kw_only=True)
class StrokeParameters:
    """Strokes and stops.

    Division of the piston's travel into strokes, with pauses or a rest of the concrete between them.
    """

    strokes: Annotated[int, "of the piston, which stops between them as it starts, over the ramp", Within(1, 1000)] = 1
    stroke: Annotated[
        float | None,
        "travel of each [m]; default: an equal part of the travel, three ramps without one, in bends of the arc",
        Above(), STROKES,
    ] = None  # fmt: skip
    pause: Annotated[float, "of the piston at each stop [s]; 0: it goes straight on", Within(0), STROKES] = 0.5
    rest: Annotated[
        float, "that concrete stands before the last stroke, put in by a law and not stepped through [s]", Within(0),
        STROKES,
    ] = 0.0  # fmt: skip
    thixotropy: Annotated[
        float, "growth of yield stress and strengths at rest, A_thix [Pa/s]; 0.1 to 1.7 (Roussel 2006)", Within(0),
        RESTED,
    ] = 0.5  # fmt: skip
    breakdown: Annotated[
        float, "slip along the wall by which what its layer gained falls to 1/e [m]", Above(), RESTED
    ] = 0.1


@dataclass(frozen=True, kw_only=True)
class ConcreteChoice:
    """Concrete.

    Choice of a named concrete, which supplies defaults of aggregate, contacts and bonds.
    """

    concrete: Annotated[
        str,
        "zhan (Table 1 and a wall layer calibrated on units A and B), zhan-table1, no1, no2, no3, or the path of a "
        ".yaml file; it stands for parameters of aggregate, contacts and bonds that are not given",
        FileIf(is_file),
    ] = "zhan"


@dataclass(frozen=True, kw_only=True)
class AggregateParameters:
    """Aggregate.

    Shapes, sizes and density of the aggregates, and how densely they are packed.
    """

    shapes: Annotated[
        str, "spheres, reference (four clumps), shape-F with shape factor F, or paths of closed meshes"
    ] = "spheres"
    shape_spheres: Annotated[int, "that cover each mesh of shapes", OF_MESHES] = 10
    fractions: Annotated[
        str | None, "by volume, of each shape, as '2,1,1,1'; default: equal", SEVERAL, Alias("shares")
    ] = None
    sizes: Annotated[str, "distribution: gaussian, uniform, or a sieve curve 'mm:passing,...' by mass"] = "gaussian"
    size_min: Annotated[float, "smallest [m]", Above(), RANGED] = 5e-3
    size_max: Annotated[float, "largest [m]", Above(), RANGED] = 20e-3
    size_mean: Annotated[float | None, "of the gaussian [m]; default: middle of the range", Above(), NORMAL] = None
    size_deviation: Annotated[
        float | None, "standard deviation of the gaussian [m]; default: half the range", Above(), NORMAL
    ] = None
    density: Annotated[float, "of the aggregates, which weigh alone [kg/m3]", Above(), BY_ITSELF] = 2500.0
    bulk_density: Annotated[
        float | None, "of the concrete [kg/m3]: aggregates bear the mortar between them, too", Above()
    ] = None
    solid_fraction: Annotated[float | None, "of the packing; default: packed to the plug's pressure"] = None


@dataclass(frozen=True, kw_only=True)
class ContactParameters:
    """Contacts.

    Linear contact law between aggregates, and friction and lubrication layer on the walls.
    """

    modulus: Annotated[float, "effective, of contacts [Pa]", Above(), OWN_LAW] = 1e5
    stiffness_ratio: Annotated[float, "normal over shear contact stiffness", Above(), OWN_LAW] = 2.0
    friction: Annotated[float, "coefficient between aggregates", Within(0), OWN_LAW] = 0.05
    wall_friction: Annotated[float | None, "on the pipe and the piston; default: as friction", Within(0), OWN_LAW,
                             OWN_WALL_LAW] = None  # fmt: skip
    layer_yield: Annotated[float, "yield stress of a lubrication layer on pipe and piston [Pa]", Within(0), OWN_LAW,
                           OWN_WALL_LAW] = 0.0  # fmt: skip
    layer_viscosity: Annotated[float, "of that layer, over its thickness [Pa s/m]", Within(0), OWN_LAW,
                               OWN_WALL_LAW] = 0.0  # fmt: skip
    normal_damping: Annotated[float, "normal dashpot, over the critical one", Within(0), OWN_LAW] = 0.5
    shear_damping: Annotated[float, "shear dashpot, over the critical one", Within(0), OWN_LAW] = 0.0
    dashpot: Annotated[str, "mode: full, no-tension, slip-cut, both", OneOf(DASHPOTS), OWN_LAW] = "full"


@dataclass(frozen=True, kw_only=True)
class BondParameters:
    """Bonds (mortar).

    Strength and stiffness of the bonds between aggregates, and the share of hydrated bonds.
    """

    bonds: Annotated[bool, "bond the aggregates' contacts before pumping"] = True
    bond_modulus: Annotated[float, "effective, of bonds [Pa]", Above(), BONDED] = 2e4
    bond_stiffness_ratio: Annotated[float, "normal over shear bond stiffness", Above(), BONDED] = 2.0
    tensile_strength: Annotated[float, "[Pa]", Within(0), BONDED] = 10.0
    cohesion: Annotated[float, "[Pa]", Within(0), BONDED] = 5.0
    friction_angle: Annotated[float, "[degrees]", Within(0, 89), BONDED] = 30.0
    bond_gap: Annotated[float, "largest gap across which bonds are made [m]", Within(0), BONDED] = 0.0
    healing: Annotated[bool, "new contacts bond when they touch", BONDED] = False
    hydration: Annotated[float, "fraction of the bonds that is hydrated", Within(0, 1), BONDED] = 0.0
    hydration_modulus: Annotated[float, "effective, of hydrated bonds [Pa]", Above(), HYDRATED] = 1e9
    hydration_strength: Annotated[
        float, "tensile, of hydrated bonds [Pa]; their cohesion is half of it", Within(0), HYDRATED
    ] = 1e6


@dataclass(frozen=True, kw_only=True)
class PlugParameters:
    """Plug, the front of the concrete.

    Balls or a plate that close the front and carry a pressure against the flow.
    """

    plug: Annotated[str, "balls (bonded), plate (straight pipes), none", OneOf(("balls", "plate", "none"))] = "balls"
    plug_pressure: Annotated[float, "against the flow [Pa]", Within(0), PLUGGED] = 1e3
    plug_ball: Annotated[float, "diameter of the balls, half the thickness of the plate [m]", Above(), PLUGGED] = 10e-3
    plug_layers: Annotated[
        int | None, "of balls; default: 2, in bends as many as 0.4 diameters hold", Within(1, 1000), OF_BALLS
    ] = None


@dataclass(frozen=True, kw_only=True)
class IndexParameters:
    """Wear, segregation and blockage.

    Additional measurements of a run.
    """

    wear: Annotated[bool, "add up sliding and impacts on the walls, patch by patch"] = False
    wear_coefficient: Annotated[
        float, "volume worn over load and way slid, Archard's K/H [m2/N]; of steel by stones 1e-13 to 1e-12",
        Within(0), WORN,
    ] = Wear.coefficient  # fmt: skip
    wear_patch: Annotated[
        float | None, "side of a patch of the pipe's wall [m]; default: a 24th of its circumference", Above(), WORN
    ] = None
    segregation: Annotated[bool, "measure where in the pipe the aggregate is, and its large stones"] = False
    blocked_travel: Annotated[
        float | None,
        "of the piston, after which the pipe counts as blocked if part of the concrete stands all the while [m]; "
        "default: a twentieth of the concrete's length, of soft aggregates a diameter, up to a fifth of it",
        Above(),
    ] = None
    stop_when_blocked: Annotated[bool, "end the run where the pipe is blocked"] = False


@dataclass(frozen=True, kw_only=True)
class RunParameters(Declared):
    """Run.

    Settings of the computation: time step, limits, precision and output.
    """

    gravity: Annotated[float, "[m/s2]", Within(-1e4, 1e4)] = 9.81
    settle: Annotated[float, "longest time to settle under gravity and plug pressure before the start [s]",
                      Within(0)] = 2.0  # fmt: skip
    time_step: Annotated[float | None, "fixed [s]; default: automatic", Above()] = None
    hydration_rounds: Annotated[
        int | None,
        "within a step, in which hydrated bonds are stepped; default: as many as they need, where they are much "
        "stiffer than all else; 1: none, so that they bound the step",
        HYDRATED,
    ] = None
    safety: Annotated[float, "automatic time step over the stable one; above 1 overrules the estimate"] = 0.8
    overlap_limit: Annotated[
        float, "overlap at which the run stops, over that which swallows an aggregate; 0: no limit", Within(0)
    ] = 1.5
    energy_balance: Annotated[bool, "add up what friction, dashpots and breaking bonds dissipate"] = False
    precision: Annotated[str, "of positions and forces: float32 or float64", OneOf(PRECISIONS)] = "float32"
    sample_interval: Annotated[float, "simulated time between two rows of the series [s]", Above()] = 0.01
    seed: Annotated[int, "random seed", Within(0)] = 0


class OfConcrete:
    """Mixin for scene parameters that contain a named concrete: its name supplies defaults for other parameters.

    It also turns paths of mesh files in `shapes` into absolute paths.
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
        if of_meshes(shapes):
            whole = ",".join(os.path.realpath(one.strip()) for one in shapes.split(","))
            object.__setattr__(self, "shapes", whole)


@dataclass(frozen=True, kw_only=True)
class PipeParameters(
    OfConcrete, UnitParameters, PistonParameters, StrokeParameters, ConcreteChoice, AggregateParameters,
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
                longest = f"must not exceed the bend's arc, {self.arc:.6g} m"
                if self.stroke is not None:
                    refuse("stroke", self.stroke, f"times {self.strokes} {longest}")
                refuse("travel", self.travel, longest)
            if self.plug == "plate":
                refuse("plug", self.plug, "a plate cannot follow a bend", "use balls or none")
        self._check_strokes()

    def _check_strokes(self) -> None:
        if self.stroke is not None and self.travel is not None:
            refuse("travel", self.travel, f"follows from {self.strokes} strokes of {self.stroke:g} m", "leave out one")
        if self.stops is not None and self.each < 2 * self.ramp * (1 - 1e-12):
            refuse("stroke", self.each, f"must hold two ramps of {self.ramp:g} m, from rest and to rest",
                   "longer strokes, or a shorter ramp")  # fmt: skip
        if self.rest > 0 and self.pause == 0:
            refuse("rest", self.rest, "needs a stop before the last stroke", "a pause above 0")
        layer = (
            self.layer_yield or self.layer_viscosity or isinstance(self.wall_contact or self.contact, LubricationLayer)
        )
        if self.rest > 0 and not (self.bonds or layer):
            refuse("rest", self.rest, "has nothing to grow: there are no bonds, and no layer on the wall",
                   "bonds, or a layer_yield")  # fmt: skip

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
        """Length of a bend's centreline [m]."""
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
        """Travel of each stroke [m]."""
        return self.distance / self.strokes

    @property
    def stops(self) -> Stops | None:
        """Stops of the piston, or None if it never stops; the last stroke ends with the run, at full speed."""
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
        """Initial arc length of the front [m]: the end of the plug of balls, or of the concrete without such a plug."""
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
    """Return the stress that a deep contact carries [Pa]: the modulus, or the value of another contact law."""
    return given.modulus if given.contact is None else given.contact.stress_scale


def asked_of(given: IndexParameters) -> dict[str, Any]:
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
    """Yield the settings of a pumping scene that trade accuracy for computing time.

    Coarse-graining multiplies all sizes of the aggregate. The laws need no rescaling: a contact's stiffness is
    modulus times area over length, so the stress depends only on the overlap relative to the size. The strengths of
    bonds and lubrication layer are stresses, and dashpots are given by their critical ratio. Only the number of
    aggregates across the pipe changes, and each impact carries more momentum.
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
    elif of_meshes(given.shapes):
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
        # The wall's share of the pressure is proportional to the length if the wall stress is uniform along the pipe.
        pushed = given.plug_pressure if given.plug != "none" else 0.0
        yield Knob("length", tuple(
            Level(f"{f * given.length:.4g} m", {"length": f * given.length}, f, f"x {f:g}",
                  {name: (pushed, 1 / f) for name in ("plateau_pressure", "peak_pressure", "end_pressure")})
            for f in LENGTHS
        ), chosen=False)  # fmt: skip
    if given.settle > 0:
        yield scaled("settling", "settle", given.settle, (0.05, 0.2, 1.0), 0.3, "s")


def coarser(given: AggregateParameters, factor: float) -> Level:
    """Return the level of a coarse-graining setting at which aggregates are `factor` times as large."""
    names = ("size_min", "size_max", "size_mean", "size_deviation")
    sizes = {name: factor * getattr(given, name) for name in names if getattr(given, name) is not None}
    # Computing time: the number of aggregates scales as factor^-3, the number of steps as factor^-1.
    return Level(f"x {factor:g}", sizes, factor**-4)
