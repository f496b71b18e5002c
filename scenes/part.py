"""Flow of concrete pumped through one or all parts of a pump line: straights, bends, reducers, hoses, mesh bores."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from warpcrete.core.errors import at_most, refuse
from warpcrete.core.inputs.concretes import is_file
from warpcrete.core.inputs.knobs import Knob, Trading, precisions, scaled
from warpcrete.core.inputs.limits import check_velocity
from warpcrete.core.inputs.parameters import Above, FileIf, Needs, OneOf, Within
from warpcrete.core.inputs.scene_functions import scene_function
from warpcrete.core.inputs.yaml_files import merged
from warpcrete.core.run.checks import NO_SAMPLE, with_cures
from warpcrete.core.run.run import Run
from warpcrete.geometry.axis import Arc, Axis, Line
from warpcrete.geometry.bores import Bores
from warpcrete.geometry.crossings import first_crossing
from warpcrete.geometry.lines import check_crossing, read_line
from warpcrete.geometry.mesh_parts import DIAMETER_TOLERANCE, WAYS, bore_of, scale_hint
from warpcrete.geometry.meshes import load
from warpcrete.geometry.one_pipe import (
    IN_BENDS,
    check_return,
    check_straight_ends,
    ends,
    joined,
    parameters_from_line,
    parameters_from_mesh,
)
from warpcrete.geometry.walls import MeshWall
from warpcrete.mps.column import FLOW
from warpcrete.mps.common.mixes import CONSTANTS, ConcreteParameters, concrete_of
from warpcrete.mps.part.layout import INLET_RADIUS
from warpcrete.mps.part.scene import MIN_ACROSS, NARROW_CELLS, PartScene, PartSettings, Section
from warpcrete.suspension.aggregates import MIN_CELLS
from warpcrete.suspension.part.checks import check_part as check_with_aggregates
from warpcrete.suspension.part.scene import BlockageSettings, PartSuspensionScene, part_scene
from warpcrete.suspension.scene import AggregateParameters

UNITS = ("vertical", "horizontal", "bend-to-horizontal", "bend-to-vertical", "bend-level", "mesh")
ACCURACY = 0.03
"""Largest accepted difference between simulated and theoretical pressure gradient in straight pipe, divided by the
theoretical pressure gradient."""
REMARKS = ("concrete enters through a plane as a plug with uniform velocity, and leaves freely at the outlet",)
AGGREGATE_REMARKS = (
    "aggregates move with the plane until they have entered entirely; the pressure fluctuates, so results are means "
    "over the last half of the run",
    "no aggregate crosses the plane of symmetry of a part of which only half is simulated",
)


suspension = {"aggregate_fraction": 0.2, "spacing": 0.005}
"""Values of parameters that the option `--method suspension` sets if the user does not set them."""
NO_LINE = Needs("line", lambda line: line is None, "is left out")
MIN_LEG_DISTANCE = 3.0
"""Minimum distance, in grid cells, between two stretches of a pump line that pass each other. It ensures that no cell
belongs to both stretches."""


def _is_given(value: Any) -> bool:
    return value is not None


@dataclass(frozen=True, kw_only=True)
class PartParameters(ConcreteParameters, AggregateParameters, BlockageSettings, PartSettings):
    """Parameters of the pipe and of the flow in it."""

    @classmethod
    def implied(cls, values: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return the parameter values that follow from the file of a pump line, a concrete or a mesh."""
        said = merged(parameters_from_line(values), parameters_from_mesh(values))
        return merged(said, super().implied(merged(said, values)))

    unit: Annotated[
        str,
        "Course of the pipe: vertical, horizontal, a bend between two straight pipes, or mesh (the bore of the mesh "
        "file in 'wall' between two straight pipes; default if 'wall' is given)",
        OneOf(UNITS),
        NO_LINE,
    ] = "bend-to-horizontal"
    diameter: Annotated[float, "Inner diameter of the pipe [m]", Above(), NO_LINE] = 0.1
    straight: Annotated[float, "Length of the straight pipes before and behind the bend or taper [m]", Above(),
                        NO_LINE] = 0.3  # fmt: skip
    elbow_radius: Annotated[float, "Radius of the centreline of a bend [m]", Above(), NO_LINE, IN_BENDS] = 0.25
    angle: Annotated[float, "Angle of a bend [degrees]", Within(5, 135), NO_LINE, IN_BENDS] = 90.0
    outlet_diameter: Annotated[float | None, "Inner diameter behind a taper [m]; the taper lies in the middle of a "
        "straight pipe, or at the distance 'straight' behind a bend", Above(), NO_LINE] = None  # fmt: skip
    taper: Annotated[float, "Length of the taper [m]", Needs("outlet_diameter", _is_given, "is given"),
                     Above()] = 0.3  # fmt: skip
    wall: Annotated[str | None, "Mesh file (STL, OBJ ...) whose bore replaces the round pipe. The bore begins at "
        "the origin and leads along x, y or z, or it follows the course of 'unit'", NO_LINE,
                    FileIf(bool)] = None  # fmt: skip
    wall_scale: Annotated[
        float, "Factor from the unit of the mesh file to metres, 0.001 for mm", Needs("wall", _is_given, "is given"),
        Above()
    ] = 1.0  # fmt: skip
    line: Annotated[str | None, "File or name of a pump line, which replaces the parameters above. It also sets "
        "flow and concrete, unless you state them. The line must begin and end with a straight part",
                    FileIf(is_file)] = None  # fmt: skip
    flow: Annotated[float, "Volume flow [m3/s]", Above()] = FLOW
    spacing: Annotated[
        float, "Edge length of the cells [m], adjusted so that a whole number fits into the radius", Above()
    ] = 0.01


EVEN_CELLS = 9.9
"""Minimum number of cells across a bore of constant width for which the friction deviates little from theory. In a pipe
of 100 mm, it deviates by 1.4 % with 10 cells, and by more than the tolerance of its check with 6."""


@scene_function(PartParameters)
def scene(parameters: PartParameters) -> PartScene:
    """Model concrete that is pumped at a given volume flow through a part of a pump line or a whole pump line.

    The results are the pressure at the inlet and the pressure loss of each part. Aggregates are spheres that move in
    the mortar, enter with it and leave with it. With aggregates, the results also contain the fraction of aggregates
    along the axis, and whether aggregates block the pipe, which ends the run.

    Raises :class:`warpcrete.SceneError` for parameters that cannot be simulated.
    """
    given = parameters
    concrete = concrete_of(given.concrete, given.slip_thickness, **{name: getattr(given, name) for name in CONSTANTS})
    course = _unit(given) if given.line is None else _line(given)
    narrow = course.bores.smallest
    Within(0, math.nextafter(narrow, 0), "use 0 for no slip layer, or less than the radius").check(
        "slip_thickness", given.slip_thickness, " m"
    )
    check_velocity("flow", given.flow, given.flow / (math.pi * narrow**2))
    bores = replace(course.bores, radii=tuple(radius - given.slip_thickness for radius in course.bores.radii))
    return part_scene(
        given,
        name="part",
        concrete=concrete,
        flow=given.flow,
        spacing=given.spacing,
        remarks=REMARKS + (AGGREGATE_REMARKS if given.aggregate_fraction else ()) + _too_coarse(given, course),
        **{f.name: getattr(given, f.name) for f in fields(PartSettings)},
        **{f.name: getattr(course, f.name) for f in fields(_PipeCourse)} | {"bores": bores},
    )


def _too_coarse(given: PartParameters, course: _PipeCourse) -> tuple[str, ...]:
    """Return a remark if few cells lie across the narrowest section, especially of a bore that narrows."""
    widest, narrowest = 2 * max(course.bores.radii), 2 * min(course.bores.radii)
    if narrowest >= (EVEN_CELLS if narrowest > 0.99 * widest else NARROW_CELLS) * given.spacing:
        return ()
    return (
        f"only {narrowest / given.spacing:.1f} cells lie across the narrowest section, where the friction may differ "
        f"by several per cent from theory; use 'spacing' = {at_most(narrowest / NARROW_CELLS, 2)} m or less",
    )


@dataclass(frozen=True)
class _PipeCourse:
    """Axis, inner radii and wall of the pipe, as arguments of :class:`PartScene`."""

    axis: Axis
    bores: Bores
    """Inner radii of the pipe's wall at places along its axis [m]; the slip layer lies inside the wall."""
    wall: MeshWall | None = None
    insert: tuple[float, float] | None = None
    parts: tuple[Section, ...] = ()


def _unit(given: PartParameters) -> _PipeCourse:
    """Return axis, inner radii and wall of a pipe that is a single part; the wall is None unless it is a mesh."""
    bends = given.unit.startswith("bend")
    if given.unit == "mesh":
        return _mesh(given)
    axis = _axis(given, bends)
    bores = Bores((0.0,), (given.diameter / 2,))
    if given.wall is not None:
        _check_wall(given)
        mesh = load(given.wall, "wall", given.wall_scale)
        return _PipeCourse(axis, bores, MeshWall(name=str(given.wall), vertices=mesh.vertices, faces=mesh.faces))
    if given.outlet_diameter is not None:
        before = axis.length - given.straight - given.taper if bends else given.straight
        bores = Bores((before, before + given.taper), (given.diameter / 2, given.outlet_diameter / 2))
    return _PipeCourse(axis, bores)


def _check_wall(given: PartParameters) -> None:
    """Raise :class:`SceneError` for parameters that cannot be combined with a pipe wall from a mesh file."""
    if given.outlet_diameter is not None:
        problem = "cannot be combined with 'wall', because the mesh has its own outlet"
        refuse("outlet_diameter", given.outlet_diameter, problem, "leave out 'outlet_diameter'")
    if given.slip_thickness > 0:
        hint = "set 'slip_thickness' to 0, and narrow the bore of the mesh by the thickness instead"
        refuse("slip_thickness", given.slip_thickness, "cannot be combined with 'wall'", hint)


def _mesh(given: PartParameters) -> _PipeCourse:
    """Return axis, inner radii and wall of a pipe: the bore of a mesh file between two straight pipes."""
    if given.wall is None:
        hint = "set 'wall' to the path of this file, or choose a 'unit' that needs no mesh"
        refuse("unit", given.unit, "needs a mesh file, which contains the bore of the part", hint)
    _check_wall(given)
    bore = bore_of(("wall", "wall_scale"), Path(given.wall), given.wall_scale, ways=WAYS)
    if abs(bore.ends[0] / given.diameter - 1) > DIAMETER_TOLERANCE:
        problem = f"differs from the diameter of the mesh at its start, {bore.ends[0]:.4g} m"
        unit = scale_hint("wall_scale", given.wall_scale, bore.ends[0], given.diameter)
        refuse("diameter", given.diameter, problem, unit or "leave out 'diameter'")
    check_velocity("flow", given.flow, given.flow / (math.pi * min(bore.radii) ** 2))
    inner = bore.axis
    begin, end = given.straight, given.straight + inner.length
    start = np.array(inner.start) - begin * np.array(inner.tangent)
    pieces = (Line(given.straight), *inner.pieces, Line(given.straight))
    axis = joined(Axis(tuple(start.tolist()), inner.tangent, pieces))
    mesh = load(given.wall, "wall", given.wall_scale)
    wall = MeshWall(name=str(given.wall), vertices=mesh.vertices, faces=mesh.faces)
    wide, gap = max(bore.radii), MIN_LEG_DISTANCE * given.spacing
    spans = [(given.straight, 2 * wide, 2), (inner.length, 2 * wide, 2 + int(inner.length / wide)),
             (given.straight, 2 * wide, 2)]  # fmt: skip
    if first_crossing(axis, spans, gap) is not None:
        problem = f"bends so far that the pipe comes within {gap:.3g} m of itself"
        refuse("wall", given.wall, problem, "reduce 'spacing' or 'straight', or shorten the bore of the mesh")
    bores = Bores((0.0,), (given.diameter / 2,))
    check_return(axis, Bores((0.0,), (wide,)), aside=INLET_RADIUS * wide + gap)
    parts = (Section("straight", 0.0, begin), Section("bore", begin, end), Section("straight", end, axis.length))
    return _PipeCourse(axis, bores, wall, (begin, end), parts)


def _line(given: PartParameters) -> _PipeCourse:
    """Return axis, inner radii and wall of the pipe for a whole pump line, which is stated by its name or its file."""
    assert given.line is not None
    line = read_line(given.line)
    check_straight_ends(line, given.line)
    for part in line.parts:
        if part.mesh:
            refuse("line", line.name, f"has a bore from a mesh (part {part.number}), which this scene cannot simulate",
                   "use 'warpcrete line' or '--method dem', or replace the bore by a reducer")  # fmt: skip
        if part.layer != 1:
            refuse(f"part {part.number}, hose: layer", part.layer, "must be 1, because this scene simulates the same "
                                                                   "slip layer in all parts",
                   "leave out 'layer', or simulate the line with 'warpcrete line'")  # fmt: skip
    axis, bores = joined(line.axis), line.bores
    check_crossing(line, MIN_LEG_DISTANCE * given.spacing, "change the course of the line, or use a smaller spacing")
    check_return(axis, bores, aside=INLET_RADIUS * bores.radii[0] + MIN_LEG_DISTANCE * given.spacing)
    parts = tuple(Section(part.kind, *map(float, between), part.label)
                  for part, between in zip(line.parts, pairwise(ends(line)), strict=True))  # fmt: skip
    return _PipeCourse(axis, bores, parts=parts)


def _axis(given: PartParameters, bends: bool) -> Axis:
    """Return the axis of a single part, which starts at the origin; z points up."""
    origin, up, along, aside = (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
    # Without a bend, the pipe consists of a straight stretch, the taper and another straight stretch. With a bend, the
    # taper comes behind the bend, and there are straight stretches before, between and behind them.
    narrowing = given.straight + given.taper if given.outlet_diameter is not None else 0.0
    if not bends:
        return Axis(
            origin, up if given.unit == "vertical" else along, (Line(given.straight + (narrowing or given.straight)),)
        )
    tangent = up if given.unit == "bend-to-horizontal" else along
    towards = {"bend-to-horizontal": along, "bend-to-vertical": up, "bend-level": aside}[given.unit]
    arc = Arc(given.elbow_radius, math.radians(given.angle), towards)
    return Axis(origin, tangent, (Line(given.straight), arc, Line(given.straight + narrowing)))


CURES = {
    "finished": "a longer --duration, or a shorter --sample-interval",
    "steady": "a longer --duration, or a larger --steadiness",
    "friction upstream": "a smaller --spacing, or a longer --straight",
    "friction downstream": "a smaller --spacing, or a longer --straight",
    "volume": "a smaller --tolerance, or a smaller --time-step",
}


def check(run: Run) -> dict[str, tuple[bool, str]]:
    """Return the checks of a finished run by name, each as a tuple (True if passed, text with the measured value)."""
    return check_with_aggregates(run) if isinstance(run.scene, PartSuspensionScene) else _check(run)


@with_cures(CURES)
def _check(run: Run) -> dict[str, tuple[bool, str]]:
    result = run.result
    if "pressure" not in result:
        return NO_SAMPLE
    found = {"steady": (result["steady"], f"after {result['simulated_time']['value']:g} s")}
    for name in ("upstream", "downstream") if run.scene.is_round else ():
        ours, theory = (result[f"{name}_gradient{end}"]["value"] for end in ("", "_theory"))
        off = ours / theory - 1
        found[f"friction {name}"] = (abs(off) < ACCURACY, f"{100 * off:+.2f} % deviation from theory")
    outflow = result["outflow_error"]
    found["volume"] = (abs(outflow) < 1e-3, f"{100 * outflow:+.3f} % difference of outflow from inflow")
    return found


def _knobs(given: PartParameters) -> Iterator[Knob]:
    narrow = min(given.diameter, given.outlet_diameter or given.diameter)
    if given.line is not None:
        narrow = 2 * read_line(given.line).bores.smallest
    coarsest = narrow / MIN_ACROSS
    if given.aggregate_fraction:
        coarsest = min(coarsest, given.diameters[0] / MIN_CELLS)
    spacings = [f for f in (2.0, 1.5, 1.0, 0.7) if f * given.spacing <= coarsest]
    yield scaled("spacing", "spacing", given.spacing, spacings, -4.0, "m", resolution=True)
    yield scaled("time step", "time_step", given.time_step, (2.0, 1.0, 0.5), -0.8, "s")
    yield scaled("regularisation", "regularisation", given.regularisation, (0.1, 1.0, 10.0), 0.1, "s")
    yield precisions()


def _variants(given: PartParameters) -> dict[str, dict[str, float]]:
    """Return variants of the scene for the tests of a trade-off study.

    The keys describe the variants, and the values are the changed parameters: half or twice the flow, or half or twice
    the viscosity of the slip layer.
    """
    concrete = concrete_of(given.concrete, given.slip_thickness, **{name: getattr(given, name) for name in CONSTANTS})
    found = {}
    for name, value in (("flow", given.flow), ("slip_viscosity", concrete.slip_viscosity)):
        words = name.replace("_", " ")
        found |= {f"half the {words}": {name: value / 2}, f"twice the {words}": {name: value * 2}}
    return found


trading = Trading(_knobs, quantities=("pressure",), variants=_variants)
