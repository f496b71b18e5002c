"""Concrete pumped through one pipe unit by a piston, against a small pressure on a plug (Zhan et al. 2019).

Units: A `vertical` (up), B `horizontal`, C `elbow-up` (upward in, horizontal out), D `elbow-down`
(horizontal in, upward out).
"""

from __future__ import annotations

import inspect
import math
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from warpcrete import clumps
from warpcrete.axis import Arc, Axis, Line
from warpcrete.errors import between, one_of, positive, refuse
from warpcrete.laws import Contact, ContactLaw, LubricationLayer
from warpcrete.packing import Fill, PipeContainer
from warpcrete.parameters import checked
from warpcrete.scene import (
    AxisDrive,
    Bodies,
    Bonds,
    Driven,
    Hydration,
    MeshWall,
    PipeWall,
    PlaneWall,
    Prescribed,
    Scene,
    Settle,
    TimeStep,
    Watch,
)
from warpcrete.sizes import Gaussian, SieveCurve, Sizes, Uniform

UNITS = ("vertical", "horizontal", "elbow-up", "elbow-down")
LETTERS = dict(zip("ABCD", UNITS, strict=True))

# Zhan et al. 2019, section 5.1: figures read for the four units at the reference parameters [Pa].
PAPER = {
    "vertical": {"peak": 38.93e3, "plateau": 35e3, "peak_travel": 0.08},
    "horizontal": {"peak": 15.69e3, "plateau": 12e3, "peak_travel": 0.10},
    "elbow-down": {"peak": 38.58e3},
}


@checked
def scene(
    unit: Annotated[str, "pipe unit: vertical, horizontal, elbow-up, elbow-down (or A, B, C, D)"] = "vertical",
    diameter: Annotated[float, "inner pipe diameter [m]"] = 0.15,
    elbow_radius: Annotated[float, "radius of the elbow's centreline [m]"] = 0.5,
    length: Annotated[float, "length of concrete in the pipe at the start [m]"] = 1.0,
    velocity: Annotated[float, "steady piston velocity [m/s]"] = 0.3,
    ramp: Annotated[float, "piston travel over which the velocity rises linearly from rest [m]"] = 0.3,
    travel: Annotated[
        float | None, "piston travel at the end [m]; default: twice the ramp; in elbows the arc, pi/2 x elbow_radius"
    ] = None,
    shapes: Annotated[
        str, "aggregates: spheres, reference (four clumps), shape-F with shape factor F, or paths of closed meshes"
    ] = "spheres",
    shape_spheres: Annotated[int, "spheres that cover each mesh of shapes"] = 10,
    shares: Annotated[str | None, "volume share of each shape, as '2,1,1,1'; default: equal"] = None,
    sizes: Annotated[str, "size distribution: gaussian, uniform, or a sieve curve 'mm:share,...' by mass"] = "gaussian",
    size_min: Annotated[float, "smallest aggregate [m]"] = 5e-3,
    size_max: Annotated[float, "largest aggregate [m]"] = 20e-3,
    size_mean: Annotated[float | None, "mean of the gaussian [m]; default: middle of the range"] = None,
    size_deviation: Annotated[float | None, "standard deviation of the gaussian [m]; default: half the range"] = None,
    density: Annotated[float, "density of the aggregates [kg/m3]"] = 2500.0,
    modulus: Annotated[float, "effective modulus of contacts [Pa]"] = 1e5,
    stiffness_ratio: Annotated[float, "normal over shear contact stiffness"] = 2.0,
    friction: Annotated[float, "friction coefficient between aggregates"] = 0.05,
    wall_friction: Annotated[
        float | None, "friction coefficient on the pipe and the piston; default: as friction"
    ] = None,
    layer_yield: Annotated[float, "yield stress of a lubrication layer on the pipe and the piston [Pa]"] = 0.0,
    layer_viscosity: Annotated[float, "viscosity of that layer over its thickness [Pa s/m]"] = 0.0,
    normal_damping: Annotated[float, "normal dashpot, share of critical"] = 0.5,
    shear_damping: Annotated[float, "shear dashpot, share of critical"] = 0.0,
    dashpot: Annotated[str, "dashpot mode: full, no-tension, slip-cut, both"] = "full",
    bonds: Annotated[bool, "bond the aggregates' contacts (mortar) before pumping"] = True,
    bond_modulus: Annotated[float, "effective modulus of bonds [Pa]"] = 2e4,
    bond_stiffness_ratio: Annotated[float, "normal over shear bond stiffness"] = 2.0,
    tensile_strength: Annotated[float, "tensile strength of bonds [Pa]"] = 10.0,
    cohesion: Annotated[float, "cohesion of bonds [Pa]"] = 5.0,
    friction_angle: Annotated[float, "friction angle of bonds [degrees]"] = 30.0,
    bond_gap: Annotated[float, "largest gap across which bonds are made [m]"] = 0.0,
    healing: Annotated[bool, "new contacts bond when they touch"] = False,
    hydration: Annotated[float, "share of the bonds that is hydrated, 0 to 1"] = 0.0,
    hydration_modulus: Annotated[float, "effective modulus of hydrated bonds [Pa]"] = 1e9,
    hydration_strength: Annotated[float, "tensile strength of hydrated bonds [Pa]; their cohesion is half of it"] = 1e6,
    plug: Annotated[str, "front of the concrete: balls (bonded), plate (straight pipes), none"] = "balls",
    plug_pressure: Annotated[float, "pressure on the plug, against the flow [Pa]"] = 1e3,
    plug_ball: Annotated[float, "diameter of the plug's balls [m]"] = 10e-3,
    solid_fraction: Annotated[
        float | None, "solid share of the packing; default: packed to the plug's pressure"
    ] = None,
    gravity: Annotated[float, "acceleration of gravity [m/s2]"] = 9.81,
    wall: Annotated[str, "pipe wall: analytic, mesh, or the path of an STL file around the same axis"] = "analytic",
    wall_scale: Annotated[float, "factor from the units of the wall file to metres"] = 1.0,
    facets: Annotated[int, "facets round the pipe of wall=mesh"] = 64,
    settle: Annotated[float, "longest time to settle under gravity and plug pressure before the start [s]"] = 2.0,
    time_step: Annotated[float | None, "fixed time step [s]; default: automatic"] = None,
    safety: Annotated[float, "automatic time step over the stable one; above 1 overrules the estimate"] = 0.8,
    overlap_limit: Annotated[
        float, "overlap at which the run stops, over that which swallows an aggregate; 0: no limit"
    ] = 1.5,
    energy_balance: Annotated[bool, "add up what friction, dashpots and breaking bonds dissipate"] = False,
    precision: Annotated[str, "of positions and forces: float32 or float64"] = "float32",
    sample_interval: Annotated[float, "simulated time between two rows of the series [s]"] = 0.01,
    seed: Annotated[int, "random seed"] = 0,
) -> Scene:
    """Concrete pumped through one pipe unit (Zhan et al. 2019).

    The pipe's axis starts at the origin, in +z (vertical, elbow-up) or +x (horizontal, elbow-down). Defaults
    are the paper's reference case with single spheres instead of its clumps (`shapes="reference"`).
    Raises :class:`warpcrete.SceneError` for anything that cannot be simulated.
    """
    given = {name: value for name, value in locals().items() if name in _parameter_names()}
    unit = LETTERS.get(unit.upper(), unit)
    one_of("unit", unit, UNITS)
    positive("diameter", diameter, "m")
    positive("elbow_radius", elbow_radius, "m")
    positive("length", length, "m")
    positive("velocity", velocity, "m/s")
    between("ramp", ramp, 0, np.inf, "m")
    between("gravity", gravity, -1e4, 1e4, "m/s2")
    between("plug_pressure", plug_pressure, 0, np.inf, "Pa")
    between("settle", settle, 0, np.inf, "s")
    between("friction", friction, 0, np.inf)
    between("overlap_limit", overlap_limit, 0, np.inf)
    positive("plug_ball", plug_ball, "m")
    positive("wall_scale", wall_scale)
    one_of("plug", plug, ("balls", "plate", "none"))
    elbow = unit.startswith("elbow")
    if travel is None:
        travel = math.pi / 2 * elbow_radius if elbow else 2 * ramp if ramp > 0 else length
    positive("travel", travel, "m")
    if elbow and travel > math.pi / 2 * elbow_radius * (1 + 1e-9):
        refuse("travel", travel, f"must not exceed the elbow's arc, {math.pi / 2 * elbow_radius:.6g} m")
    if elbow and elbow_radius <= diameter / 2:
        refuse("elbow_radius", elbow_radius, f"must exceed the pipe's radius, {diameter / 2:g} m")
    if elbow and plug == "plate":
        refuse("plug", plug, "a plate cannot follow an elbow", "use balls or none")
    distribution = _sizes(sizes, size_min, size_max, size_mean, size_deviation)
    if distribution.largest >= diameter:
        refuse("size_max", distribution.largest, f"must be below the pipe's diameter, {diameter:g} m")

    axis = unit_axis(unit, length + travel, elbow_radius)
    radius = diameter / 2
    area = math.pi * radius**2
    contact = Contact(
        effective_modulus=modulus,
        stiffness_ratio=stiffness_ratio,
        friction=friction,
        normal_damping_ratio=normal_damping,
        shear_damping_ratio=shear_damping,
        dashpot=dashpot,
    )
    contacts: dict[tuple[str, str], ContactLaw] = {}
    if wall_friction is not None:
        between("wall_friction", wall_friction, 0, np.inf)
        contacts["aggregate", "wall"] = replace(contact, friction=wall_friction)
    if layer_yield or layer_viscosity:
        contacts["aggregate", "wall"] = LubricationLayer(
            contact=contacts.get(("aggregate", "wall"), contact),
            yield_stress=layer_yield,
            viscosity=layer_viscosity,
        )

    bodies, drives, group_bonds, walls = (), (), {}, []
    front = length
    if plug == "balls":
        points = plug_points(axis, radius, length, plug_ball)
        bodies = (Bodies(positions=points, sizes=plug_ball, density=density, group="plug"),)
        drives = (AxisDrive(group="plug", axis=axis, force=-plug_pressure * area),)
        # Stiff enough to keep its shape under its small pressure, soft enough not to govern the time step.
        group_bonds["plug"] = Bonds(
            effective_modulus=2 * modulus, tensile_strength=1e12, cohesion=1e12, gap=0.35 * plug_ball
        )
        front += 2 * plug_ball
    end_points, end_tangents = axis.at([0.0, length])
    if plug == "plate":
        walls.append(
            PlaneWall(
                name="plug",
                point=tuple(end_points[1]),
                normal=tuple(-end_tangents[1]),
                motion=Driven(
                    direction=tuple(-end_tangents[1]),
                    force=plug_pressure * area,
                    mass=density * area * 2 * plug_ball,
                ),
                drawn_radius=radius,
            )
        )
    ramp_time = 2 * ramp / velocity
    if elbow:
        turn = np.cross(axis.tangent, axis.pieces[0].towards)  # type: ignore[union-attr]
        centre = np.array(axis.start) + elbow_radius * np.array(axis.pieces[0].towards)  # type: ignore[union-attr]
        motion = Prescribed(spin=tuple(velocity / elbow_radius * turn), pivot=tuple(centre), ramp_time=ramp_time)
    else:
        motion = Prescribed(velocity=tuple(velocity * np.array(axis.tangent)), ramp_time=ramp_time)
    walls.append(
        PlaneWall(
            name="piston", point=tuple(end_points[0]), normal=tuple(end_tangents[0]), motion=motion, drawn_radius=radius
        )
    )
    walls.append(_pipe_wall(wall, wall_scale, axis, radius, front + travel, facets))

    if travel <= ramp:
        duration = math.sqrt(2 * travel * ramp_time / velocity)
    else:
        duration = ramp_time + (travel - ramp) / velocity
    template_set = clumps.templates(shapes, shape_spheres)
    return Scene(
        name="pipe",
        duration=duration,
        bodies=bodies,
        fill=Fill(
            container=PipeContainer(axis, radius, length),
            sizes=distribution,
            templates=template_set,
            shares=_shares(shares),
            density=density,
            solid_fraction=solid_fraction,
            # Below that a packing has no pressure to speak of.
            pressure=max(plug_pressure, 2e-3 * modulus) if solid_fraction is None else None,
        ),
        walls=tuple(walls),
        drives=drives,
        contact=contact,
        contacts=contacts,
        bonds=Bonds(
            effective_modulus=bond_modulus,
            stiffness_ratio=bond_stiffness_ratio,
            tensile_strength=tensile_strength,
            cohesion=cohesion,
            friction_angle=friction_angle,
            gap=bond_gap,
            healing=healing,
        )
        if bonds
        else None,
        hydration=Hydration(
            share=hydration,
            bonds=Bonds(
                effective_modulus=hydration_modulus,
                stiffness_ratio=bond_stiffness_ratio,
                tensile_strength=hydration_strength,
                cohesion=hydration_strength / 2,
                friction_angle=friction_angle,
            ),
        )
        if bonds and hydration
        else _no_hydration(hydration, bonds),
        group_bonds=group_bonds,
        gravity=(0.0, 0.0, -gravity),
        settle=Settle(duration=settle) if settle > 0 else None,
        time_step=TimeStep(fixed=time_step, safety=safety),
        watch=Watch(overlap=overlap_limit or None),
        energy_balance=energy_balance,
        precision=precision,
        sample_interval=sample_interval,
        seed=seed,
        parameters=given
        | {"unit": unit, "wall": str(Path(wall).resolve()) if wall not in ("analytic", "mesh") else wall},
        notes={
            "pressure_wall": "piston",
            "pressure_area": area,
            "axis": axis,
            "radius": radius,
            "concrete_length": length,
            "unit": unit,
            "ramp": ramp,
            "travel": travel,
            "velocity": velocity,
            "simplified": _simplifications(shapes),
            "paper": PAPER.get(unit, {}) if _is_reference(given) else {},
        },
    )


def check(run) -> dict[str, tuple[bool, str]]:
    """Acceptance of a pipe run: name -> (passed, what was found)."""
    result = run.result
    balance = result["momentum_balance_error"]
    travel = run.series["travel"][-1]
    goal = run.scene.notes["travel"]
    overlap = result["largest_overlap"]
    positions = run.bodies.position
    offset = np.array([_distance_from_axis(run.scene.notes["axis"], x) for x in positions])
    outside = int(np.count_nonzero(offset > run.scene.notes["radius"]))
    return {
        "finished": (run.finished, f"travel {travel:.4g} of {goal:.4g} m"),
        "momentum balance": (not balance >= 0.01, f"{100 * balance:.3g} % of the largest impulse"),
        "all aggregates inside": (outside == 0, f"{outside} centroids outside the pipe"),
        "no aggregate swallowed": (overlap < 2.0, f"largest overlap {overlap:.3g} of the smaller radius"),
    }


def unit_axis(unit: str, length: float, elbow_radius: float) -> Axis:
    """Axis of a pipe unit that is at least `length` long [m]."""
    origin = (0.0, 0.0, 0.0)
    up, along = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)
    if unit == "vertical":
        return Axis(origin, up, (Line(length),))
    if unit == "horizontal":
        return Axis(origin, along, (Line(length),))
    tangent, towards = (up, along) if unit == "elbow-up" else (along, up)
    arc = Arc(elbow_radius, math.pi / 2, towards)
    return Axis(origin, tangent, (arc, Line(max(length - arc.length, 0.1))))


def plug_points(axis: Axis, radius: float, at: float, ball: float) -> np.ndarray:
    """Centres of two layers of balls in rings that fill the pipe's section from the wall inwards, shape (n, 3)."""
    between("plug_ball", ball, 0, radius, "m", f"the pipe's radius is {radius:g} m")
    positive("plug_ball", ball, "m")
    if (radius / ball) ** 2 > 1e5:
        refuse("plug_ball", ball, f"would take {2 * math.pi * (radius / ball) ** 2:.2g} balls to plug the pipe",
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


def _pipe_wall(wall: str, scale: float, axis: Axis, radius: float, length: float, facets: int) -> PipeWall | MeshWall:
    if wall == "analytic":
        return PipeWall(name="pipe", axis=axis, radius=radius)
    if wall == "mesh":
        vertices, faces = axis.tube(radius, facets, before=2 * radius, after=max(0.0, length - axis.length) + radius)
        return MeshWall(name="pipe", vertices=vertices, faces=faces)
    from warpcrete.meshes import check_pipe, load

    mesh = load(wall, "wall", scale)
    check_pipe(mesh, "wall", str(wall), axis, radius, length)
    return MeshWall(name="pipe", vertices=mesh.vertices, faces=mesh.faces)


def _sizes(kind: str, smallest: float, largest: float, mean: float | None, deviation: float | None) -> Sizes:
    positive("size_min", smallest, "m")
    positive("size_max", largest, "m")
    if kind == "uniform":
        return Uniform(smallest, largest)
    if kind == "gaussian":
        if mean is None:
            mean = 0.5 * (smallest + largest)
        if deviation is None:
            deviation = max(0.5 * (largest - smallest), 1e-6 * largest)
        return Gaussian(mean, deviation, smallest, largest)
    try:
        pairs = [tuple(map(float, part.split(":"))) for part in kind.split(",")]
        openings, passing = zip(*pairs, strict=True)
    except ValueError:
        refuse("sizes", kind, "must be gaussian, uniform or a sieve curve", "for example '5:0,10:0.4,20:1' (mm:share)")
    return SieveCurve(tuple(1e-3 * o for o in openings), tuple(passing))


def _no_hydration(share: float, bonds: bool) -> None:
    between("hydration", share, 0, 1)
    if share and not bonds:
        refuse("hydration", share, "needs bonds", "leave bonds on")


def _distance_from_axis(axis: Axis, x: np.ndarray) -> float:
    best = np.inf
    for row in axis.parametrised():
        local = x - row["start"]
        if not row["arc"]:
            along = np.clip(local @ row["tangent"], row["lower"], row["upper"])
            best = min(best, float(np.linalg.norm(local - along * row["tangent"])))
        else:
            local = local + row["radius"] * row["outward"]
            angle = np.clip(math.atan2(local @ row["tangent"], local @ row["outward"]), row["lower"], row["upper"])
            centre = row["radius"] * (math.cos(angle) * row["outward"] + math.sin(angle) * row["tangent"])
            best = min(best, float(np.linalg.norm(local - centre)))
    return best


def _shares(text: str | None) -> tuple[float, ...] | None:
    if text is None:
        return None
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        refuse("shares", text, "must be numbers joined by commas", "for example '2,1,1,1'")


def _simplifications(shapes: str) -> tuple[str, ...]:
    if shapes == "spheres":
        return (
            "aggregates are single spheres, which run several times as fast as the paper's clumps; "
            "--shapes reference uses clumps",
        )
    return ()


def _is_reference(given: dict[str, Any]) -> bool:
    """Is this the paper's case, as far as it is stated? (Shapes differ: it shows no coordinates.)"""
    free = {
        "unit",
        "shapes",
        "shape_spheres",
        "shares",
        "wall",
        "wall_scale",
        "facets",
        "seed",
        "settle",
        "safety",
        "sample_interval",
        "travel",
    }
    defaults = {name: p.default for name, p in _parameter_names().items()}
    return all(given[name] == defaults[name] for name in given if name not in free)


def _parameter_names() -> dict[str, Any]:
    return dict(inspect.signature(scene).parameters)
