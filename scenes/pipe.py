"""Concrete pumped through one pipe unit by a piston, against a small pressure on a plug (Zhan et al. 2019).

Units: A `vertical` (up), B `horizontal`, C `bend-to-horizontal` (upward in, horizontal out), D `bend-to-vertical`
(horizontal in, upward out).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, fields, replace

import numpy as np

from warpcrete.core.concretes import concrete, shipped
from warpcrete.core.errors import refuse
from warpcrete.core.knobs import Trading
from warpcrete.core.parameters import Above, Within, scene_function
from warpcrete.core.run_loop import Run
from warpcrete.core.units import number
from warpcrete.dem import clumps
from warpcrete.dem.blocked import blocked_words
from warpcrete.dem.concretes import COVERAGE
from warpcrete.dem.containers import Fill, PipeContainer
from warpcrete.dem.laws import Contact, ContactLaw, LubricationLayer
from warpcrete.dem.pumping import WIDEST_STONE, PipeParameters, asked_of, pumping_knobs
from warpcrete.dem.scene import (
    AxisDrive,
    Bodies,
    Bonds,
    Hydration,
    PipeUnit,
    PressureProbe,
    Published,
    Rest,
    Scene,
    Settle,
    TimeStep,
    Watch,
)
from warpcrete.dem.sizes import Gaussian, SieveCurve, Sizes, Uniform
from warpcrete.geometry.axis import Arc, Axis, Line
from warpcrete.geometry.meshes import Bore, bore_probes, check_pipe, enclosed, load
from warpcrete.geometry.walls import Driven, MeshWall, PipeWall, PlaneWall, Prescribed, Wall

SOURCE = "Zhan et al. 2019"
PUBLISHED = {
    "vertical": Published(source=SOURCE, peak=38.93e3, plateau=35e3, peak_travel=0.08),
    "horizontal": Published(source=SOURCE, peak=15.69e3, plateau=12e3, peak_travel=0.10),
    "bend-to-vertical": Published(source=SOURCE, peak=38.58e3),
}
"""Section 5.1: read for the units at the reference parameters."""

OF_THE_PAPER = ("zhan", "zhan-table1")
"""Concretes beside which the paper's figures are shown."""
FEWEST = 30
"""Aggregates that stand for concrete: fewer are so many stones."""
MOST_BALLS = 600_000
LEAK = 0.01
"""Part of the aggregates that may slip past the plug."""
LAST_OF_PAUSE = 0.05
"""Part of the last pause that is left when the rest is put in."""
BALANCED = 0.01
"""Part of the largest impulse that may be missing in the balance of momentum."""


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
            bulk_density=given.bulk_density,
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
        time_step=TimeStep(fixed=given.time_step, safety=given.safety, rounds=given.hydration_rounds),
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
            stops=given.stops,
        ),
        rest=_rest(given),
        published=PUBLISHED.get(given.unit) if _is_reference(given) else None,
        remarks=tuple(_remarks(given, sizes)),
        parameters=asdict(given),
        **asked_of(given),
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
    blocked = bool(result.get("blocked"))
    whole = abs(travel - goal) < 1e-3 * goal + step or (blocked and scene.blockage.stop)
    found = {
        "finished": (
            run.finished and result["steps"] > 0 and whole,
            f"travel {travel:.4g} of {goal:.4g} m",
        ),
        "momentum balance": (balance < BALANCED, f"{100 * balance:.3g} % of the largest impulse"),
        "all aggregates inside": (outside == 0, f"{outside} centroids outside the pipe"),
        "no aggregate swallowed": (overlap < 2.0, f"largest overlap {overlap:.3g} of the smaller radius"),
    }  # fmt: skip
    if blocked:
        found["not blocked"] = (False, blocked_words(run))
    passed = _past_plug(run)
    if passed is not None:
        found["plug holds"] = (
            passed[0] <= LEAK * passed[1], f"{passed[0]} of {passed[1]} aggregates went past it"
        )  # fmt: skip
    aggregates = sum(group == "" for group in bodies.group)
    if aggregates < FEWEST:
        found["enough aggregates"] = (False, f"{aggregates}; {FEWEST} or more stand for concrete")
    if "plateau_pressure" in result:
        plateau = number(result["plateau_pressure"])
        found["plateau"] = (math.isfinite(plateau), f"{plateau / 1e3:.4g} kPa")
    return found


trading = Trading(pumping_knobs, ("plateau_pressure", "peak_pressure"))


def _past_plug(run: Run) -> tuple[int, int] | None:
    """Aggregates that are ahead of the plug of balls, and how many there are; None without one."""
    bodies, axis = run.bodies, run.scene.pipe.axis  # type: ignore[attr-defined]
    plug = np.array([group == "plug" for group in bodies.group], bool)
    if not plug.any():
        return None
    s = axis.along(bodies.position)
    return int(np.count_nonzero(s[~plug] > s[plug].max() + 0.5 * bodies.size[~plug])), int(np.count_nonzero(~plug))


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


def plug_points(axis: Axis, radius: float, at: float, ball: float, layers: int) -> np.ndarray:
    """Centres of layers of balls in rings that fill the pipe's section from the wall inwards, shape (n, 3)."""
    Within(0, radius).check("plug_ball", ball, f" m, the pipe's radius being {radius:g} m")
    Above().check("plug_ball", ball, " m")
    across = radius / ball
    count = layers * math.pi * across * across  # a power would not be infinite, but an error
    if count > MOST_BALLS:
        refuse("plug_ball", ball, f"would take {count:.2g} balls to plug the pipe",
               "use larger balls, a plate or none")  # fmt: skip
    local = []
    for layer in range(layers):
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
        motion = Prescribed(spin=spin, pivot=tuple(centre), ramp_time=given.ramp_time, stops=given.stops)
    else:
        velocity = tuple(given.velocity * np.array(axis.tangent))
        motion = Prescribed(velocity=velocity, ramp_time=given.ramp_time, stops=given.stops)
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
        points = plug_points(axis, bore.smallest if bore is not None else given.radius, given.length,
                             given.plug_ball, given.layers)  # fmt: skip
        density = given.bulk_density or given.density
        bodies = Bodies(positions=points, sizes=given.plug_ball, density=density, group="plug")
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
            mass=(given.bulk_density or given.density) * given.area * 2 * given.plug_ball,
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


def _rest(given: PipeParameters) -> Rest | None:
    if not given.rest or given.stops is None:
        return None
    # Just before the piston starts again.
    at = given.stops.count * given.stops.period - LAST_OF_PAUSE * given.pause
    return Rest(
        at=at, duration=given.rest, growth=given.thixotropy, breakdown=given.breakdown, coverage=COVERAGE, wall="piston"
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
    if given.concrete in shipped() and concrete(given.concrete).calibrated:
        yield f"concrete {given.concrete}: calibrated {concrete(given.concrete).calibrated}"
    if given.shapes == "spheres":
        yield (
            "aggregates are single spheres, which run several times as fast as the paper's clumps; "
            "--shapes reference uses clumps"
        )
        if given.layer_yield or given.layer_viscosity:
            yield "single spheres roll along the wall's layer where clumps slide, so it bears less than beside clumps"
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
        "hydration_rounds",
        "safety",
        "sample_interval",
        "travel",
        "precision",
        "energy_balance",
        "overlap_limit",
        "time_step",
        "wear",
        "wear_coefficient",
        "wear_patch",
        "segregation",
        "blocked_travel",
        "stop_when_blocked",
    }
    if given.concrete not in OF_THE_PAPER:
        return False
    its_own = {f.name: f.default for f in fields(given)} | scene.completed({"concrete": given.concrete})
    return all(getattr(given, name) == value for name, value in its_own.items() if name not in free)
