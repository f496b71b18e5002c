"""Concrete pumped through one pipe unit by a piston, against a small pressure on a plug (Zhan et al. 2019).

Units: A `vertical` (up), B `horizontal`, C `bend-to-horizontal` (upward in, horizontal out), D `bend-to-vertical`
(horizontal in, upward out).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Annotated

import numpy as np

from warpcrete.core.device import PRECISIONS
from warpcrete.core.errors import refuse
from warpcrete.core.parameters import Above, Alias, Declared, Needs, OneOf, Within, scene_function
from warpcrete.core.run_loop import Run
from warpcrete.core.units import number
from warpcrete.dem import clumps
from warpcrete.dem.containers import Fill, PipeContainer
from warpcrete.dem.laws import Contact, ContactLaw, LubricationLayer
from warpcrete.dem.laws.linear import DASHPOTS
from warpcrete.dem.scene import (
    AxisDrive,
    Bodies,
    Bonds,
    Hydration,
    PipeUnit,
    PressureProbe,
    Published,
    Scene,
    Settle,
    TimeStep,
    Watch,
)
from warpcrete.dem.sizes import Gaussian, SieveCurve, Sizes, Uniform
from warpcrete.geometry.axis import Arc, Axis, Line
from warpcrete.geometry.meshes import Bore, bore_probes, check_pipe, enclosed, load
from warpcrete.geometry.walls import Driven, MeshWall, PipeWall, PlaneWall, Prescribed, Wall

UNITS = ("vertical", "horizontal", "bend-to-horizontal", "bend-to-vertical")
OTHER_NAMES = dict(zip("ABCD", UNITS, strict=True)) | {"elbow-up": UNITS[2], "elbow-down": UNITS[3]}
"""Letters of the paper, and words of earlier versions."""

SOURCE = "Zhan et al. 2019"
PUBLISHED = {
    "vertical": Published(source=SOURCE, peak=38.93e3, plateau=35e3, peak_travel=0.08),
    "horizontal": Published(source=SOURCE, peak=15.69e3, plateau=12e3, peak_travel=0.10),
    "bend-to-vertical": Published(source=SOURCE, peak=38.58e3),
}
"""Section 5.1: read for the units at the reference parameters."""

FEWEST = 30
"""Aggregates that stand for concrete: fewer are so many stones."""
WIDEST_STONE = 0.4
"""Of the pipe's diameter, the largest rounded aggregate that is pumped (ACI 304.2R; a third if it is crushed)."""
BALANCED = 0.01
"""Part of the largest impulse that may be missing in the balance of momentum."""


def of_meshes(shapes: str) -> bool:
    """Shapes are paths of meshes, not words."""
    return any(Path(one).suffix and not one.strip().startswith("shape-") for one in shapes.split(","))


BONDED = Needs("bonds", bool, "is on")
HYDRATED = Needs("hydration", lambda fraction: fraction > 0, "is above 0")
FROM_FILE = Needs("wall", lambda wall: wall not in ("analytic", "mesh"), "is a file")
FACETED = Needs("wall", lambda wall: wall == "mesh", "is mesh")
OF_MESHES = Needs("shapes", of_meshes, "names meshes")
SEVERAL = Needs("shapes", lambda shapes: shapes == "reference" or "," in shapes, "names several")
NORMAL = Needs("sizes", lambda sizes: sizes == "gaussian", "is gaussian")
RANGED = Needs("sizes", lambda sizes: sizes in ("gaussian", "uniform"), "is gaussian or uniform")
PLUGGED = Needs("plug", lambda plug: plug != "none", "is balls or plate")


@dataclass(frozen=True, kw_only=True)
class UnitParameters:
    """Pipe unit."""

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
    """Piston."""

    velocity: Annotated[float, "in the end [m/s]", Above(), Within(0, 1e3)] = 0.3
    ramp: Annotated[float, "travel over which the velocity rises linearly from rest [m]", Within(0)] = 0.3
    travel: Annotated[
        float | None,
        "at the end [m]; default: twice the ramp, the length without one, in bends pi/2 x elbow_radius",
        Above(),
    ] = None


@dataclass(frozen=True, kw_only=True)
class AggregateParameters:
    """Aggregate."""

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
    density: Annotated[float, "[kg/m3]", Above()] = 2500.0
    solid_fraction: Annotated[float | None, "of the packing; default: packed to the plug's pressure"] = None


@dataclass(frozen=True, kw_only=True)
class ContactParameters:
    """Contacts."""

    modulus: Annotated[float, "effective, of contacts [Pa]", Above()] = 1e5
    stiffness_ratio: Annotated[float, "normal over shear contact stiffness", Above()] = 2.0
    friction: Annotated[float, "coefficient between aggregates", Within(0)] = 0.05
    wall_friction: Annotated[float | None, "on the pipe and the piston; default: as friction", Within(0)] = None
    layer_yield: Annotated[float, "yield stress of a lubrication layer on pipe and piston [Pa]", Within(0)] = 0.0
    layer_viscosity: Annotated[float, "of that layer, over its thickness [Pa s/m]", Within(0)] = 0.0
    normal_damping: Annotated[float, "normal dashpot, over the critical one", Within(0)] = 0.5
    shear_damping: Annotated[float, "shear dashpot, over the critical one", Within(0)] = 0.0
    dashpot: Annotated[str, "mode: full, no-tension, slip-cut, both", OneOf(DASHPOTS)] = "full"


@dataclass(frozen=True, kw_only=True)
class BondParameters:
    """Bonds (mortar)."""

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
    """Plug, the front of the concrete."""

    plug: Annotated[str, "balls (bonded), plate (straight pipes), none", OneOf(("balls", "plate", "none"))] = "balls"
    plug_pressure: Annotated[float, "against the flow [Pa]", Within(0), PLUGGED] = 1e3
    plug_ball: Annotated[float, "diameter of the balls, half the thickness of the plate [m]", Above(), PLUGGED] = 10e-3


@dataclass(frozen=True, kw_only=True)
class RunParameters(Declared):
    """Run."""

    gravity: Annotated[float, "[m/s2]", Within(-1e4, 1e4)] = 9.81
    settle: Annotated[float, "longest time to settle under gravity and plug pressure before the start [s]",
                      Within(0)] = 2.0  # fmt: skip
    time_step: Annotated[float | None, "fixed [s]; default: automatic", Above()] = None
    safety: Annotated[float, "automatic time step over the stable one; above 1 overrules the estimate"] = 0.8
    overlap_limit: Annotated[
        float, "overlap at which the run stops, over that which swallows an aggregate; 0: no limit", Within(0)
    ] = 1.5
    energy_balance: Annotated[bool, "add up what friction, dashpots and breaking bonds dissipate"] = False
    precision: Annotated[str, "of positions and forces: float32 or float64", OneOf(PRECISIONS)] = "float32"
    sample_interval: Annotated[float, "simulated time between two rows of the series [s]", Above()] = 0.01
    seed: Annotated[int, "random seed", Within(0)] = 0


@dataclass(frozen=True, kw_only=True)
class PipeParameters(
    UnitParameters, PistonParameters, AggregateParameters, ContactParameters, BondParameters, PlugParameters,
    RunParameters,
):  # fmt: skip
    """Concrete, one pipe unit, and what pumps it."""

    def __post_init__(self) -> None:
        super().__post_init__()
        unit = OTHER_NAMES.get(self.unit.upper(), OTHER_NAMES.get(self.unit, self.unit))
        OneOf(UNITS).check("unit", unit, "")
        object.__setattr__(self, "unit", unit)
        if self.wall not in ("analytic", "mesh"):
            object.__setattr__(self, "wall", str(Path(self.wall).resolve()))
        if of_meshes(self.shapes):
            object.__setattr__(
                self, "shapes", ",".join(str(Path(one.strip()).resolve()) for one in self.shapes.split(","))
            )
        if self.is_bend:
            if self.elbow_radius <= self.radius:
                refuse("elbow_radius", self.elbow_radius, f"must exceed the pipe's radius, {self.radius:g} m")
            if self.distance > self.arc * (1 + 1e-9):
                refuse("travel", self.travel, f"must not exceed the bend's arc, {self.arc:.6g} m")
            if self.plug == "plate":
                refuse("plug", self.plug, "a plate cannot follow a bend", "use balls or none")

    @property
    def is_bend(self) -> bool:
        return self.unit.startswith("bend")

    @property
    def radius(self) -> float:
        """Of the pipe [m]."""
        return self.diameter / 2

    @property
    def area(self) -> float:
        """Of the pipe's cross-section [m2]."""
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
        return self.arc if self.is_bend else 2 * self.ramp if self.ramp > 0 else self.length

    @property
    def ramp_time(self) -> float:
        """[s]"""
        return 2 * self.ramp / self.velocity

    @property
    def duration(self) -> float:
        """Of the piston's travel [s]."""
        if self.distance <= self.ramp:
            return math.sqrt(2 * self.distance * self.ramp_time / self.velocity)
        return self.ramp_time + (self.distance - self.ramp) / self.velocity

    @property
    def front(self) -> float:
        """Where the concrete and its plug end at the start [m]."""
        return self.length + (2 * self.plug_ball if self.plug == "balls" else 0.0)


@scene_function(PipeParameters)
def scene(parameters: PipeParameters) -> Scene:
    """Concrete pumped through one pipe unit (Zhan et al. 2019).

    The pipe's axis starts at the origin, in +z (vertical, bend-to-horizontal) or +x (horizontal, bend-to-vertical).
    Defaults are the paper's reference case with single spheres instead of its clumps (`shapes="reference"`).
    Raises :class:`warpcrete.SceneError` for anything that cannot be simulated.
    """
    given = parameters
    sizes = _sizes(given)
    axis = unit_axis(given.unit, given.length + given.distance, given.elbow_radius)
    pipe = _pipe_wall(given, axis)
    bore = _odd_bore(given, axis, pipe, 0.0, given.length)
    bodies, drives, plug_bonds, plate = _plug(given, axis, pipe)
    walls: tuple[Wall, ...] = (*plate, _piston(given, axis), pipe)
    return Scene(
        name="pipe",
        duration=given.duration,
        bodies=bodies,
        fill=Fill(
            container=PipeContainer(axis, bore.smallest, given.length, pipe, bore.area)
            if bore is not None and isinstance(pipe, MeshWall)
            else PipeContainer(axis, given.radius, given.length),
            sizes=sizes,
            templates=clumps.templates(given.shapes, given.shape_spheres),
            fractions=_fractions(given.fractions),
            density=given.density,
            solid_fraction=given.solid_fraction,
            # Below that a packing has no pressure to speak of.
            pressure=max(given.plug_pressure, 2e-3 * given.modulus) if given.solid_fraction is None else None,
        ),
        walls=walls,
        drives=drives,
        contact=_contact(given),
        contacts=_wall_contact(given),
        bonds=_bonds(given),
        hydration=_hydration(given),
        group_bonds=plug_bonds,
        gravity=(0.0, 0.0, -given.gravity),
        settle=Settle(duration=given.settle) if given.settle > 0 else None,
        time_step=TimeStep(fixed=given.time_step, safety=given.safety),
        watch=Watch(overlap=given.overlap_limit or None),
        energy_balance=given.energy_balance,
        precision=given.precision,
        sample_interval=given.sample_interval,
        seed=given.seed,
        pressure=PressureProbe(wall="piston", area=given.area),
        pipe=PipeUnit(
            name=given.unit,
            axis=axis,
            radius=given.radius,
            concrete_length=given.length,
            velocity=given.velocity,
            ramp=given.ramp,
            travel=given.distance,
        ),
        published=PUBLISHED.get(given.unit) if _is_reference(given) else None,
        remarks=tuple(_remarks(given, sizes)),
        parameters=asdict(given),
    )


def check(run: Run) -> dict[str, tuple[bool, str]]:
    """Acceptance of a pipe run: name -> (passed, what was found)."""
    result, scene = run.result, run.scene
    balance, overlap = result["momentum_balance_error"], result["largest_overlap"]
    travel, goal = float(run.series["travel"][-1]), scene.pipe.travel
    bodies = run.bodies  # type: ignore[attr-defined]
    wall = next(wall for wall in scene.walls if wall.name == "pipe")
    outside = int(np.count_nonzero(~enclosed(wall, scene.pipe.axis, bodies.position)))
    # The last step ends past the duration.
    step = scene.pipe.velocity * number(result["simulated_time"]) / max(result["steps"], 1)
    found = {
        "finished": (
            run.finished and result["steps"] > 0 and abs(travel - goal) < 1e-3 * goal + step,
            f"travel {travel:.4g} of {goal:.4g} m",
        ),
        "momentum balance": (balance < BALANCED, f"{100 * balance:.3g} % of the largest impulse"),
        "all aggregates inside": (outside == 0, f"{outside} centroids outside the pipe"),
        "no aggregate swallowed": (overlap < 2.0, f"largest overlap {overlap:.3g} of the smaller radius"),
    }  # fmt: skip
    aggregates = sum(group == "" for group in bodies.group)
    if aggregates < FEWEST:
        found["enough aggregates"] = (False, f"{aggregates}; {FEWEST} or more stand for concrete")
    if "plateau_pressure" in result:
        plateau = number(result["plateau_pressure"])
        found["plateau"] = (math.isfinite(plateau), f"{plateau / 1e3:.4g} kPa")
    return found


def unit_axis(unit: str, length: float, elbow_radius: float) -> Axis:
    """Axis of a pipe unit that is at least `length` long [m]."""
    origin = (0.0, 0.0, 0.0)
    up, along = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)
    if unit == "vertical":
        return Axis(origin, up, (Line(length),))
    if unit == "horizontal":
        return Axis(origin, along, (Line(length),))
    tangent, towards = (up, along) if unit == "bend-to-horizontal" else (along, up)
    arc = Arc(elbow_radius, math.pi / 2, towards)
    return Axis(origin, tangent, (arc, Line(max(length - arc.length, 0.1))))


def plug_points(axis: Axis, radius: float, at: float, ball: float) -> np.ndarray:
    """Centres of two layers of balls in rings that fill the pipe's section from the wall inwards, shape (n, 3)."""
    Within(0, radius).check("plug_ball", ball, f" m, the pipe's radius being {radius:g} m")
    Above().check("plug_ball", ball, " m")
    if radius / ball > 1e5**0.5:
        refuse("plug_ball", ball, f"would take {2 * math.pi * np.square(radius / ball):.2g} balls to plug the pipe",
               "use larger balls, a plate or none")  # fmt: skip
    local = []
    for layer in range(2):
        ring = radius - ball / 2
        while ring > ball / 4:
            count = max(1, int(2 * math.pi * ring / ball))
            for k in range(count):
                angle = 2 * math.pi * (k + 0.5 * layer) / count
                local.append((at + (layer + 0.5) * ball, ring * math.cos(angle), ring * math.sin(angle)))
            ring -= ball
        if ring > -ball / 4:
            local.append((at + (layer + 0.5) * ball, 0.0, 0.0))
    s, a, b = np.array(local).T
    points, _, normal, side = axis.frame(s)
    return points + a[:, None] * normal + b[:, None] * side


def _piston(given: PipeParameters, axis: Axis) -> PlaneWall:
    """It moves along a straight pipe, and turns about the centre of a bend."""
    points, tangents = axis.at(0.0)
    if given.is_bend:
        arc = axis.pieces[0]
        assert isinstance(arc, Arc)
        turn = np.cross(axis.tangent, arc.towards)
        centre = np.array(axis.start) + given.elbow_radius * np.array(arc.towards)
        spin = tuple(given.velocity / given.elbow_radius * turn)
        motion = Prescribed(spin=spin, pivot=tuple(centre), ramp_time=given.ramp_time)
    else:
        motion = Prescribed(velocity=tuple(given.velocity * np.array(axis.tangent)), ramp_time=given.ramp_time)
    return PlaneWall(
        name="piston",
        point=tuple(points[0]),
        normal=tuple(tangents[0]),
        motion=motion,
        drawn_radius=given.radius,
    )


def _plug(
    given: PipeParameters, axis: Axis, pipe: Wall
) -> tuple[tuple[Bodies, ...], tuple[AxisDrive, ...], dict[str, Bonds], tuple[PlaneWall, ...]]:
    """Bodies, drives and bonds of a plug of balls, or a plate."""
    if given.plug == "balls":
        bore = _odd_bore(given, axis, pipe, given.length, given.front)
        points = plug_points(axis, bore.smallest if bore is not None else given.radius, given.length, given.plug_ball)
        bodies = Bodies(positions=points, sizes=given.plug_ball, density=given.density, group="plug")
        drive = AxisDrive(group="plug", axis=axis, force=-given.plug_pressure * given.area)
        # Stiff enough to keep its shape under its small pressure, soft enough not to govern the time step.
        bonds = Bonds(
            effective_modulus=2 * given.modulus, tensile_strength=1e12, cohesion=1e12, gap=0.35 * given.plug_ball
        )
        return (bodies,), (drive,), {"plug": bonds}, ()
    if given.plug == "plate":
        points, tangents = axis.at(given.length)
        back = tuple(-tangents[0])
        motion = Driven(
            direction=back,
            force=given.plug_pressure * given.area,
            mass=given.density * given.area * 2 * given.plug_ball,
        )
        plate = PlaneWall(name="plug", point=tuple(points[0]), normal=back, motion=motion, drawn_radius=given.radius)
        return (), (), {}, (plate,)
    return (), (), {}, ()


def _pipe_wall(given: PipeParameters, axis: Axis) -> PipeWall | MeshWall:
    length = given.front + given.distance
    if given.wall == "analytic":
        return PipeWall(name="pipe", axis=axis, radius=given.radius)
    if given.wall == "mesh":
        after = max(0.0, length - axis.length) + given.radius
        vertices, faces = axis.tube(given.radius, given.facets, before=2 * given.radius, after=after)
        return MeshWall(name="pipe", vertices=vertices, faces=faces)
    mesh = load(given.wall, "wall", given.wall_scale)
    check_pipe(mesh, "wall", given.wall, axis, given.radius, length)
    return MeshWall(name="pipe", vertices=mesh.vertices, faces=mesh.faces)


def _odd_bore(given: PipeParameters, axis: Axis, pipe: Wall, begin: float, end: float) -> Bore | None:
    """The bore between two arc lengths [m], where a round pipe does not stand for it."""
    if not isinstance(pipe, MeshWall):
        return None
    # Many probes: between the corners of a few facets the wall comes nearest.
    reach = bore_probes(pipe, axis, given.radius, end, around=72, begin=begin)
    if np.any(reach < 0):
        refuse("wall", given.wall, f"has gaps: {np.count_nonzero(reach < 0)} of {reach.size} probes find no wall",
               "close its holes (trimesh.repair.fill_holes, or in the CAD program)")  # fmt: skip
    bore = Bore.of(reach)
    return None if bore.is_round(given.radius) else bore


def _contact(given: PipeParameters) -> Contact:
    return Contact(
        effective_modulus=given.modulus,
        stiffness_ratio=given.stiffness_ratio,
        friction=given.friction,
        normal_damping_ratio=given.normal_damping,
        shear_damping_ratio=given.shear_damping,
        dashpot=given.dashpot,
    )


def _wall_contact(given: PipeParameters) -> dict[tuple[str, str], ContactLaw]:
    """Contact with pipe and piston, where it differs."""
    contact = _contact(given)
    if given.wall_friction is not None:
        contact = replace(contact, friction=given.wall_friction)
    if given.layer_yield or given.layer_viscosity:
        layer = LubricationLayer(contact=contact, yield_stress=given.layer_yield, viscosity=given.layer_viscosity)
        return {("aggregate", "wall"): layer}
    return {("aggregate", "wall"): contact} if given.wall_friction is not None else {}


def _bonds(given: PipeParameters) -> Bonds | None:
    if not given.bonds:
        return None
    return Bonds(
        effective_modulus=given.bond_modulus,
        stiffness_ratio=given.bond_stiffness_ratio,
        tensile_strength=given.tensile_strength,
        cohesion=given.cohesion,
        friction_angle=given.friction_angle,
        gap=given.bond_gap,
        healing=given.healing,
    )


def _hydration(given: PipeParameters) -> Hydration | None:
    if not (given.bonds and given.hydration):
        return None
    return Hydration(
        fraction=given.hydration,
        bonds=Bonds(
            effective_modulus=given.hydration_modulus,
            stiffness_ratio=given.bond_stiffness_ratio,
            tensile_strength=given.hydration_strength,
            cohesion=given.hydration_strength / 2,
            friction_angle=given.friction_angle,
        ),
    )


def _sizes(given: PipeParameters) -> Sizes:
    found = _distribution(given)
    if found.largest >= given.diameter:
        refuse("size_max", found.largest, f"must be below the pipe's diameter, {given.diameter:g} m")
    return found


def _distribution(given: PipeParameters) -> Sizes:
    smallest, largest = given.size_min, given.size_max
    if given.sizes == "uniform":
        return Uniform(smallest, largest)
    if given.sizes == "gaussian":
        mean, deviation = given.size_mean, given.size_deviation
        if mean is None:
            mean = 0.5 * (smallest + largest)
        if deviation is None:
            deviation = max(0.5 * (largest - smallest), 1e-6 * largest)
        return Gaussian(mean, deviation, smallest, largest)
    try:
        pairs = [tuple(map(float, part.split(":"))) for part in given.sizes.split(",")]
        openings, passing = zip(*pairs, strict=True)
    except ValueError:
        refuse("sizes", given.sizes, "must be gaussian, uniform or a sieve curve",
               "for example '5:0,10:0.4,20:1' (mm:passing)")  # fmt: skip
    return SieveCurve(tuple(1e-3 * o for o in openings), tuple(passing))


def _fractions(text: str | None) -> tuple[float, ...] | None:
    if text is None:
        return None
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        refuse("fractions", text, "must be numbers joined by commas", "for example '2,1,1,1'")


def _remarks(given: PipeParameters, sizes: Sizes) -> Iterator[str]:
    """What is simplified, left unused or outside what is pumped."""
    if given.shapes == "spheres":
        yield (
            "aggregates are single spheres, which run several times as fast as the paper's clumps; "
            "--shapes reference uses clumps"
        )
    if sizes.largest > WIDEST_STONE * given.diameter:
        yield (
            f"the largest aggregates are {sizes.largest / given.diameter:.2g} of the pipe's diameter wide; above "
            f"{WIDEST_STONE:g} concrete is not pumped (ACI 304.2R)"
        )
    default = next(field.default for field in fields(given) if field.name == "elbow_radius")
    if not given.is_bend and given.elbow_radius != default:
        yield f"elbow_radius = {given.elbow_radius:g}: means nothing in a straight pipe"


def _is_reference(given: PipeParameters) -> bool:
    """Is this the paper's case, as far as it is stated? (Shapes differ: it shows no coordinates.)"""
    free = {
        "unit",
        "shapes",
        "shape_spheres",
        "fractions",
        "wall",
        "wall_scale",
        "facets",
        "seed",
        "settle",
        "safety",
        "sample_interval",
        "travel",
        "precision",
        "energy_balance",
        "overlap_limit",
        "time_step",
    }
    return all(getattr(given, f.name) == f.default for f in fields(given) if f.name not in free)
