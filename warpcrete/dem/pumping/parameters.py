"""Parameters of pumping aggregates through a pipe unit (Zhan et al. 2019), motion of the piston, accuracy settings."""

import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from ...core.errors import refuse
from ...core.inputs.knobs import Knob, Level, precisions, scaled
from ...core.inputs.parameters import OneOf, declared_fields
from ...geometry.walls import Stops
from ..laws import LawChoice, LubricationLayer, WallLawChoice
from ..scene.concretes import elements_of
from ..scene.settings import MUCH_STIFFER
from .parameter_groups import (
    UNITS,
    AggregateParameters,
    BondParameters,
    ConcreteChoice,
    ContactParameters,
    IndexParameters,
    PistonParameters,
    PlugParameters,
    RunParameters,
    StrokeParameters,
    UnitParameters,
    names_meshes,
)

OTHER_NAMES = dict(zip("ABCD", UNITS, strict=True))
"""Other accepted names of pipe units: the letters of Zhan et al. 2019."""
UPRIGHT = 0.4
"""Smallest ratio of thickness to diameter at which the plug at the front of the concrete does not tip over behind a
bend. In test runs, plugs with a ratio of 0.13 tipped over."""
WIDEST_STONE = 0.4
"""Largest diameter of rounded aggregate that can be pumped, divided by the pipe's diameter (ACI 304.2R). For crushed
aggregate the ratio is 1/3."""


class ConcreteDefaults:
    """Mixin for scene parameters with a named concrete, which supplies defaults for other parameters.

    The mixin also turns paths of mesh files in `shapes` into absolute paths.
    """

    @classmethod
    def of_concrete(cls) -> tuple[str, tuple[str, ...]]:
        """Return the name of the section for discrete elements in a concrete's file, and its allowed parameters."""
        groups = (AggregateParameters, ContactParameters, BondParameters)
        return "elements", tuple(name for group in groups for name in declared_fields(group))

    @classmethod
    def implied(cls, values: Mapping[str, object]) -> Mapping[str, Any]:
        """Return parameters of the concrete that the user's parameters `values` state by name or by file."""
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
        unit = OTHER_NAMES.get(self.unit.upper(), self.unit)
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
                    refuse("stroke", self.stroke, f"is too long, because {self.strokes} strokes together {longest}")
                refuse("travel", self.travel, longest)
            if self.plug == "plate":
                problem = "must not be a plate in a bend, because a plate cannot follow it"
                refuse("plug", self.plug, problem, "set 'plug' to balls or none")
        self._check_strokes()

    def _check_strokes(self) -> None:
        if self.stroke is not None and self.travel is not None:
            problem = f"is already set by {self.strokes} strokes of {self.stroke:g} m"
            refuse("travel", self.travel, problem, "leave out 'travel' or 'stroke'")
        if self.stops is not None and self.each < 2 * self.ramp * (1 - 1e-12):
            problem = f"must hold two ramps of {self.ramp:g} m, one from rest and one to rest"
            refuse("stroke", self.each, problem, "use longer strokes, or a shorter 'ramp'")
        if self.rest > 0 and self.pause == 0:
            problem = "takes place in the last stop between strokes, and there is no stop"
            refuse("rest", self.rest, problem, "set 'pause' above 0 and 'strokes' to 2 or more")
        layer = (
            self.layer_yield or self.layer_viscosity or isinstance(self.wall_contact or self.contact, LubricationLayer)
        )
        if self.rest > 0 and not (self.bonds or layer):
            problem = "has no effect, because there are no bonds and no lubrication layer on the wall"
            refuse("rest", self.rest, problem, "switch on 'bonds', or set 'layer_yield' above 0")

    @property
    def is_bend(self) -> bool:
        """True if the pipe unit is a pipe with a bend."""
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
        """Length of the centreline of the bend, whose angle is 90 degrees [m]."""
        return math.pi / 2 * self.elbow_radius

    @property
    def distance(self) -> float:
        """Travel of the piston in the whole run [m].

        The travel is the parameter `travel`, or otherwise the sum of all strokes of the length `stroke`. If neither is
        given, it is

        - the length of the arc in a bend,
        - three ramps per stroke in a straight pipe, if the piston stops between strokes and has a ramp,
        - two ramps in a straight pipe, if the piston has a ramp but does not stop,
        - the length of the concrete in a straight pipe, if the piston has no ramp.
        """
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
        """Travel of the piston in one stroke [m]."""
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
        """Initial arc length of the front of the concrete [m].

        If a plug of balls closes the front, this is the end of the plug. Otherwise it is the end of the concrete.
        """
        return self.length + (self.layers * self.plug_ball if self.plug == "balls" else 0.0)

    @property
    def layers(self) -> int:
        """Number of layers of balls in the plug that closes the front of the concrete.

        In a level pipe the weight of the concrete pushes hardest on the lower edge of the plug, harder than the plug's
        pressure can balance. A thin plug would tip over, and the concrete would flow out past it.
        """
        if self.plug_layers is not None:
            return self.plug_layers
        return max(2, math.ceil(UPRIGHT * self.diameter / self.plug_ball - 1e-9)) if self.is_bend else 2


def stiffness_of(given: Any) -> float:
    """Return the order of magnitude of the stress [Pa] in strongly compressed contacts; a linear law's modulus."""
    return given.modulus if given.contact is None else given.contact.stress_scale


COARSENINGS = (3.0, 2.0, 1.5, 1.0)
FACETS = (16, 32, 64, 128, 256)
SPHERES = (1, 2, 4, 8, 16)
LENGTHS = (0.25, 0.5, 1.0)


def pumping_knobs(given: PipeParameters) -> Iterator[Knob]:
    """Yield the parameters that trade accuracy for computing time in a pumping scene.

    One of them is coarse-graining, which multiplies all sizes of the aggregate by a factor. The contact laws need no
    rescaling. A contact's stiffness is modulus times area over length, so the contact stress depends only on the ratio
    of overlap to size, which stays the same. The strengths of bonds and lubrication layer are stresses, and dashpots
    are given by their ratio to critical damping. Coarse-graining therefore changes only the number of aggregates across
    the pipe and the momentum that each impact carries.
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
        yield scaled(
            "hydrated stiffness", "hydration_modulus", given.hydration_modulus, (0.01, 0.1, 1.0), 0.5, "Pa", True
        )
        much_stiffer = given.hydration_modulus >= MUCH_STIFFER * max(stiffness_of(given), given.bond_modulus)
        if given.hydration_rounds is None and given.time_step is None and much_stiffer:
            single = Level("single steps", {"hydration_rounds": 1}, 3.0)
            yield Knob("hydrated bonds", (Level("rounds", {"hydration_rounds": None}), single))
    if not given.is_bend:
        # A shorter pipe saves run time. If the wall stress is uniform along the pipe, the pumping pressure minus the
        # counterpressure at the front of the concrete is proportional to the length of the pipe. A pipe of the fraction
        # f of the length has the fraction f of this difference, so the factor 1/f converts it to the full length.
        pushed = given.plug_pressure if given.plug != "none" else 0.0
        yield Knob("length", tuple(
            Level(f"{f * given.length:.4g} m", {"length": f * given.length}, f, f"x {f:g}",
                  {name: (pushed, 1 / f) for name in ("plateau_pressure", "peak_pressure", "end_pressure")})
            for f in LENGTHS
        ), chosen=False)  # fmt: skip
    if given.settle > 0:
        yield scaled("settling", "settle", given.settle, (0.05, 0.2, 1.0), 0.3, "s")


def coarser(given: AggregateParameters, factor: float) -> Level:
    """Return the accuracy level of coarse-graining in which aggregates are `factor` times as large.

    The cost of the level is its computing time, divided by the computing time without coarse-graining.
    """
    names = ("size_min", "size_max", "size_mean", "size_deviation")
    sizes = {name: factor * getattr(given, name) for name in names if getattr(given, name) is not None}
    # The computing time scales as factor^-4, because the number of aggregates scales as factor^-3 and the number of
    # time steps scales as factor^-1.
    return Level(f"x {factor:g}", sizes, factor**-4)
