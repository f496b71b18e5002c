"""Concrete that a piston pumps through one pipe unit, while a plug resists slightly (Zhan et al. 2019).

The units are A `vertical` (upward), B `horizontal`, C `bend-to-horizontal` (an elbow with upward inlet and horizontal
outlet), and D `bend-to-vertical` (an elbow with horizontal inlet and upward outlet).
"""

import math
from collections.abc import Iterator
from dataclasses import fields

import numpy as np

from warpcrete.core.errors import refuse
from warpcrete.core.inputs.concretes import concrete, shipped
from warpcrete.core.inputs.knobs import Trading
from warpcrete.core.inputs.scene_functions import scene_function
from warpcrete.core.run.checks import with_cures
from warpcrete.core.run.run import Run
from warpcrete.core.units import number
from warpcrete.dem.measure.blockage_results import blocked_words
from warpcrete.dem.pumping.components import Plug, fill_of, law_remarks, plug_of, settings_of, sizes_of
from warpcrete.dem.pumping.parameter_groups import index_settings
from warpcrete.dem.pumping.parameters import WIDEST_STONE, PipeParameters, pumping_knobs
from warpcrete.dem.scene.checks import OUTFLOW_CHECK, energy_check, overlap_words
from warpcrete.dem.scene.concretes import COVERAGE
from warpcrete.dem.scene.containers import PipeContainer
from warpcrete.dem.scene.scene import PipeUnit, PressureProbe, Published, Rest, Scene, Stations
from warpcrete.dem.scene.sizes import Sizes
from warpcrete.geometry.axis import Arc, Axis, Line
from warpcrete.geometry.bores import Bores
from warpcrete.geometry.inner_surface import pipe_in
from warpcrete.geometry.meshes import Bore, bore_probes, enclosed, load
from warpcrete.geometry.walls import MeshWall, PipeWall, PlaneWall, Prescribed, Wall

SOURCE = "Zhan et al. 2019"
PUBLISHED = {
    "vertical": Published(source=SOURCE, peak=38.93e3, plateau=35e3, peak_travel=0.08),
    "horizontal": Published(source=SOURCE, peak=15.69e3, plateau=12e3, peak_travel=0.10),
    "bend-to-vertical": Published(source=SOURCE, peak=38.58e3),
}
"""Published peak and plateau pressures of the pipe units, by unit, from section 5.1 of Zhan et al. 2019."""

PAPER_CONCRETES = ("zhan", "zhan-table1")
"""Names of the concretes for which reports show the results of Zhan et al. 2019 for comparison."""
MIN_AGGREGATES = 30
"""Minimum number of aggregates in a valid run; a smaller number does not represent concrete."""
MAX_LEAK = 0.01
"""Maximum fraction of the aggregates that may slip past the plug of balls at the front end of the concrete."""
PAUSE_LEFT_AT_REST = 0.05
"""Remaining fraction of the piston's last pause when the concrete's long rest is applied. In this rest the yield stress
grows, but the simulation takes no time steps."""
SLICES, MAX_SLICES = 2.0, 1000
"""Resolution of the plot of the stress along the pipe, in recordings.

`SLICES` is the number of slices per length of one pipe diameter, and `MAX_SLICES` the maximum number of slices in the
whole pipe.
"""
FLUX_TOLERANCE = 0.2
"""Largest difference of the ratio of outflow to inflow from 1 in a valid run. A larger
difference means that the aggregates are still being compressed. Friction upstream and downstream then belong to
different flows."""
MAX_BALANCE_ERROR = 0.01
"""Largest error of the aggregates' momentum balance in a valid run, divided by the largest impulse (force summed over
time) in the balance."""


@scene_function(PipeParameters)
def scene(parameters: PipeParameters) -> Scene:
    """Model concrete pumped through one pipe unit (Zhan et al. 2019).

    The pipe's axis starts at the origin, in +z (vertical, bend-to-horizontal) or +x (horizontal, bend-to-vertical).
    Defaults are the paper's reference case with single spheres instead of its clumps (`shapes="reference"`). Raises
    :class:`warpcrete.SceneError` for parameters that cannot be simulated.
    """
    given = parameters
    sizes = sizes_of(given, given.diameter)
    axis = unit_axis(given.unit, given.length + given.distance, given.elbow_radius)
    pipe = _pipe_wall(given, axis)
    bore = _uneven_bore(given, axis, pipe, 0.0, given.length)
    plug = _plug(given, axis, pipe)
    return Scene(
        name="pipe",
        duration=given.duration,
        bodies=plug.bodies,
        fill=fill_of(
            given,
            PipeContainer(axis, bore.smallest, given.length, pipe, bore.area)
            if bore is not None and isinstance(pipe, MeshWall)
            else PipeContainer(axis, given.radius, given.length),
            sizes,
        ),
        walls=(*plug.plates, _piston(given, axis), pipe),
        drives=plug.drives,
        group_bonds=plug.bonds,
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
        stations=_stations(given, axis) if bore is None else None,
        published=PUBLISHED.get(given.unit) if _is_reference(given) else None,
        remarks=tuple(_remarks(given, sizes)),
        **settings_of(given),
        **index_settings(given),
    )


CURES = {
    "finished": "a shorter --travel, or a larger --overlap-limit",
    "momentum balance": "--precision float64, or a smaller --safety",
    "all aggregates inside": "a larger --modulus, or a smaller --safety",
    "no aggregate swallowed": "a larger --modulus, or a smaller --safety",
    "not blocked": "a smaller --size-max, or a larger --diameter; a larger --modulus if soft aggregates are compressed",
    "plug holds": "a smaller --plug-ball, or more --plug-layers",
    "enough aggregates": "a smaller --size-max, or a larger --diameter",
    OUTFLOW_CHECK: "a longer --travel, or a larger --modulus",
    "plateau": "a longer --travel",
}


@with_cures(CURES)
def check(run: Run) -> dict[str, tuple[bool, str]]:
    """Return the checks of a finished run by name, each as a tuple (True if passed, text with the measured value)."""
    result, scene = run.result, run.scene
    balance, overlap = result["momentum_balance_error"], result["largest_overlap"]
    travel, goal = float(run.series["travel"][-1]), scene.pipe.travel
    bodies = run.bodies  # type: ignore[attr-defined]
    wall = next(wall for wall in scene.walls if wall.name == "pipe")
    outside = int(np.count_nonzero(~enclosed(wall, scene.pipe.axis, bodies.position)))
    # The last time step may end after the planned duration. The piston's travel may therefore exceed its goal by the
    # travel in one step.
    step = scene.pipe.velocity * number(result["simulated_time"]) / max(result["steps"], 1)
    blocked = bool(result.get("blocked"))
    whole = abs(travel - goal) < 1e-3 * goal + step or (blocked and scene.blockage.stop)
    found = {
        "finished": (
            run.finished and result["steps"] > 0 and whole,
            f"travel {travel:.4g} of {goal:.4g} m",
        ),
        "momentum balance": (balance < MAX_BALANCE_ERROR, f"error {100 * balance:.3g} % of the largest impulse"),
        "all aggregates inside": (outside == 0, f"{outside} centroids outside the pipe"),
        "no aggregate swallowed": (overlap < 2.0, overlap_words(scene, overlap)),
    }  # fmt: skip
    if blocked:
        found["not blocked"] = (False, blocked_words(run))
    passed = _past_plug(run)
    if passed is not None:
        found["plug holds"] = (
            passed[0] <= MAX_LEAK * passed[1], f"{passed[0]} of {passed[1]} aggregates passed the plug"
        )  # fmt: skip
    aggregates = sum(group == "" for group in bodies.group)
    if aggregates < MIN_AGGREGATES:
        found["enough aggregates"] = (
            False,
            f"{aggregates}; at least {MIN_AGGREGATES} are needed to represent concrete",
        )
    if "flux_ratio" in result and not blocked:
        ratio = number(result["flux_ratio"])
        found[OUTFLOW_CHECK] = (abs(ratio - 1) <= FLUX_TOLERANCE, _flux_words(ratio))
    if "plateau_pressure" in result:
        plateau = number(result["plateau_pressure"])
        found["plateau"] = (math.isfinite(plateau), f"{plateau / 1e3:.4g} kPa")
    return found | energy_check(run)


trading = Trading(pumping_knobs, ("plateau_pressure", "peak_pressure"))


def _flux_words(ratio: float) -> str:
    """Return the ratio of outflow to inflow in words, with the reason if it is far from 1."""
    words = f"outflow is {100 * ratio:.0f} % of the inflow (allowed: 100 +- {100 * FLUX_TOLERANCE:.0f} %)"
    return words if ratio >= 1 - FLUX_TOLERANCE else f"{words}; the aggregates are still being compressed"


def _past_plug(run: Run) -> tuple[int, int] | None:
    """Return how many aggregates slipped past the plug, and the total number; None without a plug of bonded balls."""
    bodies, axis = run.bodies, run.scene.pipe.axis  # type: ignore[attr-defined]
    plug = np.array([group == "plug" for group in bodies.group], bool)
    if not plug.any():
        return None
    s = axis.along(bodies.position)
    return int(np.count_nonzero(s[~plug] > s[plug].max() + 0.5 * bodies.size[~plug])), int(np.count_nonzero(~plug))


def unit_axis(unit: str, length: float, elbow_radius: float) -> Axis:
    """Return the axis of a pipe unit that is at least `length` long [m]."""
    origin = (0.0, 0.0, 0.0)
    up, along = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)
    if unit == "vertical":
        return Axis(origin, up, (Line(length),))
    if unit == "horizontal":
        return Axis(origin, along, (Line(length),))
    tangent, towards = (up, along) if unit == "bend-to-horizontal" else (along, up)
    arc = Arc(elbow_radius, math.pi / 2, towards)
    return Axis(origin, tangent, (arc, Line(max(length - arc.length, 0.1))))


def _piston(given: PipeParameters, axis: Axis) -> PlaneWall:
    """Return the piston wall, which moves along a straight pipe or turns about the centre of a bend."""
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
        name="piston", point=tuple(points[0]), normal=tuple(tangents[0]), motion=motion, drawn_radius=given.radius
    )


def _plug(given: PipeParameters, axis: Axis, pipe: Wall) -> Plug:
    """Return the plug that closes the pipe in front of the concrete and resists the flow with a constant force."""
    bore = _uneven_bore(given, axis, pipe, given.length, given.front) if given.plug == "balls" else None
    inner = bore.smallest if bore is not None else given.radius
    return plug_of(given, axis, given.length, given.radius, given.layers, inner)


def _pipe_wall(given: PipeParameters, axis: Axis) -> PipeWall | MeshWall:
    length = given.front + given.distance
    if given.wall == "analytic":
        return PipeWall(name="pipe", axis=axis, radius=given.radius)
    if given.wall == "mesh":
        after = max(0.0, length - axis.length) + given.radius
        vertices, faces = axis.tube(given.radius, given.facets, before=2 * given.radius, after=after)
        return MeshWall(name="pipe", vertices=vertices, faces=faces)
    mesh = load(given.wall, "wall", given.wall_scale)
    surface = pipe_in(mesh.vertices, mesh.faces, "wall", given.wall, axis, given.radius, length)
    return MeshWall(name="pipe", vertices=surface.vertices, faces=surface.faces)


def _stations(given: PipeParameters, axis: Axis) -> Stations:
    """Return the slices in which stresses are measured, from the piston's start to the concrete's final front.

    A slice is half as long as the pipe is wide, or longer in a long pipe.
    """
    end = given.length + given.distance
    edges = np.linspace(0, end, 1 + round(min(max(1.0, SLICES * end / given.diameter), MAX_SLICES)))
    return Stations(axis=axis, bores=Bores((0.0,), (given.radius,)), edges=tuple(edges.tolist()), each_row=False)


def _uneven_bore(given: PipeParameters, axis: Axis, pipe: Wall, begin: float, end: float) -> Bore | None:
    """Return the measured cross-sections of a pipe between two arc lengths [m], or None if the pipe is round there."""
    if not isinstance(pipe, MeshWall):
        return None
    # Measure the radius in 72 directions, so that some of them hit the middle of a facet, where a pipe of few facets is
    # narrowest.
    reach = bore_probes(pipe, axis, given.radius, end, around=72, begin=begin)
    if np.any(reach < 0):
        hint = "close the holes of the mesh in a CAD program or with trimesh.repair.fill_holes"
        problem = f"has gaps: {np.count_nonzero(reach < 0)} of {reach.size} rays from the axis hit no wall"
        refuse("wall", given.wall, problem, hint)
    bore = Bore.of(reach)
    return None if bore.is_round(given.radius) else bore


def _rest(given: PipeParameters) -> Rest | None:
    if not given.rest or given.stops is None:
        return None
    # Apply the long rest of the concrete, in which its yield stress grows, shortly before the end of the piston's last
    # pause. The simulation takes no time steps for the long rest, so the piston starts again soon after it.
    at = given.stops.count * given.stops.period - PAUSE_LEFT_AT_REST * given.pause
    return Rest(
        at=at, duration=given.rest, growth=given.thixotropy, breakdown=given.breakdown, coverage=COVERAGE, wall="piston"
    )


def _remarks(given: PipeParameters, sizes: Sizes) -> Iterator[str]:
    """Yield remarks on simplifications, unused parameters, and aggregates that are too large for pumping."""
    yield from law_remarks(given)
    own = given.contact is None and given.wall_contact is None
    if own and given.concrete in shipped() and concrete(given.concrete).calibrated:
        yield f"concrete {given.concrete}: calibrated {concrete(given.concrete).calibrated}"
    if given.shapes == "spheres":
        yield (
            "aggregates are single spheres, which are several times as fast to simulate as the paper's clumps; "
            "use --shapes reference for clumps"
        )
        if given.layer_yield or given.layer_viscosity:
            yield "single spheres roll along the slip layer, where clumps slide, so the wall resists them less"
    if sizes.largest > WIDEST_STONE * given.diameter:
        yield (
            f"the largest aggregates measure {sizes.largest / given.diameter:.2g} of the diameter of the pipe; above "
            f"{WIDEST_STONE:g}, concrete cannot be pumped (ACI 304.2R)"
        )
    default = next(field.default for field in fields(given) if field.name == "elbow_radius")
    if not given.is_bend and given.elbow_radius != default:
        yield f"elbow_radius = {given.elbow_radius:g}: has no effect in a straight pipe"


def _is_reference(given: PipeParameters) -> bool:
    """Return whether the parameters are the reference case of Zhan et al. 2019, as far as the paper states it.

    Clump shapes may differ, because the paper gives no coordinates for them.
    """
    free = {
        "unit", "shapes", "shape_spheres", "fractions", "wall", "wall_scale", "facets", "seed", "settle",
        "hydration_rounds", "safety", "sample_interval", "travel", "precision", "energy_balance", "overlap_limit",
        "time_step", "wear", "wear_coefficient", "wear_patch", "segregation", "blocked_travel", "stop_when_blocked",
    }  # fmt: skip
    if given.concrete not in PAPER_CONCRETES:
        return False
    its_own = {f.name: f.default for f in fields(given)} | scene.completed({"concrete": given.concrete})
    return all(getattr(given, name) == value for name, value in its_own.items() if name not in free)
