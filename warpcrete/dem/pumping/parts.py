"""Parts of a pumping line through which aggregates are pushed: their parameters, and the course of the pipe."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np

from ...core.errors import between, refuse
from ...core.inputs.concretes import is_file
from ...core.inputs.knobs import Knob, Level, precisions, scaled
from ...core.inputs.parameters import Above, FileIf, Needs, OneOf, Within
from ...core.inputs.yaml_files import merged
from ...geometry.axis import Arc, Axis, Line
from ...geometry.bores import FACETS, Bores
from ...geometry.lines import check_crossing, read_line
from ...geometry.mesh_parts import DIAMETER_TOLERANCE, WAYS, Insert, bore_of, scale_hint
from ...geometry.one_pipe import (
    IN_BENDS,
    check_return,
    check_straight_ends,
    ends,
    parameters_from_line,
    parameters_from_mesh,
)
from ...geometry.pipe_line import Part, PipeLine
from ..laws import OWN_LAW, LawChoice, WallLawChoice
from .parameter_groups import (
    AggregateParameters,
    BondParameters,
    ConcreteChoice,
    ContactParameters,
    IndexParameters,
    PlugParameters,
    RunParameters,
)
from .parameters import COARSENINGS, UPRIGHT, WIDEST_STONE, ConcreteDefaults, coarser

UNITS = ("vertical", "horizontal", "bend-to-horizontal", "bend-to-vertical", "bend-level", "mesh")
ALONE = Needs("line", lambda line: line is None, "is left out")


def _is_given(value: object) -> bool:
    return value is not None


OF_MESH = Needs("wall", _is_given, "is given")


@dataclass(frozen=True, kw_only=True)
class CourseParameters:
    """Pipe.

    Course and dimensions of the pipe: a single part, the bore of a mesh, or a line from a file.
    """

    common: ClassVar[tuple[str, ...]] = (
        "unit", "diameter", "straight", "elbow_radius", "angle", "outlet_diameter", "wall", "wall_scale", "line",
    )  # fmt: skip

    unit: Annotated[
        str,
        "Course of the pipe: vertical, horizontal, a bend between two straight stretches, or mesh (the bore of the "
        "mesh file in 'wall' between two straight stretches; default if 'wall' is given)",
        OneOf(UNITS),
        ALONE,
    ] = "bend-to-horizontal"
    diameter: Annotated[float, "Inner diameter of the pipe [m]", Above(), ALONE] = 0.1
    straight: Annotated[
        float, "Length of each of the straight stretches before and behind the bend or taper [m]", Above(), ALONE
    ] = 0.3
    elbow_radius: Annotated[float, "Radius of a bend's centreline [m]", Above(), ALONE, IN_BENDS] = 0.25
    angle: Annotated[float, "Angle of a bend [degrees]", Within(5, 135), ALONE, IN_BENDS] = 90.0
    outlet_diameter: Annotated[
        float | None,
        "Inner diameter behind a taper [m]; the taper lies in the middle of a straight pipe, or at the distance "
        "'straight' behind a bend",
        Above(),
        ALONE,
    ] = None
    taper: Annotated[
        float,
        "Length of the taper [m]",
        Needs("outlet_diameter", _is_given, "is given"),
        Needs("wall", lambda wall: wall is None, "is left out"),
        Above(),
    ] = 0.3
    wall: Annotated[str | None, "Mesh file (STL, OBJ ...) whose bore is the part; the bore begins at the origin of "
        "the mesh and leads along its x axis", ALONE, FileIf(bool)] = None  # fmt: skip
    wall_scale: Annotated[float, "Factor from the unit of the mesh file to metres: 0.001 for mm", OF_MESH, Above()] = (
        1.0
    )
    line: Annotated[str | None, "File or name of a pump line, which replaces all of these parameters. It also sets "
        "flow and concrete, unless you give them. The line must begin and end with a straight part",
                    FileIf(is_file)] = None  # fmt: skip
    facets: Annotated[
        int, "Number of facets around a pipe with a taper, whose wall consists of triangles", Within(8, 1000)
    ] = FACETS
    slices: Annotated[float, "Number of slices per diameter in which stress, solid fraction and velocity are "
        "measured; 0: no slices, with which a sample takes a tenth of the time", Within(0, 20)] = 2.0  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class PushParameters:
    """Piston.

    Motion of the piston that pushes the concrete.
    """

    common: ClassVar[tuple[str, ...]] = ("flow", "travel")

    flow: Annotated[float, "Final volume flow that the piston displaces [m3/s]", Above()] = 1500e-6
    travel: Annotated[
        float | None, "Travel of the piston in the pipe before the part [m]; default: two diameters", Above()
    ] = None
    ramp: Annotated[
        float | None,
        "Travel over which the speed of the piston rises linearly [m]; default: half of the travel",
        Within(0),
    ] = None


@dataclass(frozen=True, kw_only=True)
class PartElements(
    ConcreteDefaults, CourseParameters, PushParameters, ConcreteChoice, AggregateParameters, LawChoice, WallLawChoice,
    ContactParameters, BondParameters, PlugParameters, IndexParameters, RunParameters,
):  # fmt: skip
    """All parameters of a part of a pumping line: concrete, pipe, piston, contacts, plug, measurements and run.

    The default modulus is five times that of Zhan et al. (2019), which is the default of the scene `pipe`. Softer
    aggregates are still being compressed when the piston has completed its travel: with 1e5 Pa, only half as much
    concrete leaves the default part as enters it, and the part counts as blocked.
    """

    modulus: Annotated[float, "Effective modulus of contacts [Pa]", Above(), OWN_LAW] = 5e5

    @classmethod
    def implied(cls, values: Mapping[str, object]) -> Mapping[str, Any]:
        """Return parameters, by name, from the files of a line, of a mesh and of a concrete in `values`."""
        said = merged(parameters_from_line(values), parameters_from_mesh(values, WAYS[:1]))
        return merged(said, super().implied(merged(said, values)))


@dataclass(frozen=True)
class Course:
    """Course of a pipe: a straight run-up as long as the piston's travel, followed by the part to be simulated."""

    axis: Axis
    bores: Bores
    travel: float
    """Travel of the piston [m]."""
    ramp: float
    """Travel over which the piston's speed rises linearly in time [m]."""
    velocity: float
    """Speed of the piston after its ramp [m/s]."""
    middle: tuple[float, float] | None
    """Arc lengths between which the part is not a straight pipe of constant diameter [m]; None if the whole part is a
    straight pipe of constant diameter."""
    line: PipeLine | None = None
    inserts: tuple[Insert, ...] = ()
    """Sections of the pipe whose bore is a mesh, with the arc lengths of their ends [m]."""
    clear: Bores | None = None
    """Radii [m] of the largest circles about the axis that lie inside the bore, as a function of arc length.

    None if no section of the bore is a mesh.
    """

    @property
    def narrowest(self) -> float:
        """Smallest free width of the bore across the axis [m]."""
        return min([2 * self.bores.smallest, *(insert.mesh.narrowest for insert in self.inserts)])

    @property
    def duration(self) -> float:
        """Simulated time of the piston's travel [s]."""
        # The speed rises linearly in time, so the travel `ramp` takes the time 2 ramp / velocity.
        return 2 * self.ramp / self.velocity + (self.travel - self.ramp) / self.velocity

    @property
    def advance(self) -> float:
        """Distance [m] by which the front of the concrete moves in the piston's travel at constant concrete volume."""
        return self.travel * float(self.bores.at(0.0) / self.bores.at(self.axis.length)) ** 2


def course_of(given: PartElements) -> Course:
    """Return the pipe of a scene: a straight section in which the piston moves, followed by one part or a pumping line.

    Raises :class:`SceneError` if parameters contradict each other.
    """
    line = None if given.line is None else read_line(given.line)
    if line is not None:
        check_straight_ends(line, given.line)
    if given.unit == "mesh" and given.wall is None and line is None:
        hint = "set 'wall' to the path of this file, or choose a 'unit' that needs no mesh"
        refuse("unit", given.unit, "needs a mesh file, which contains the bore of the part", hint)
    parts = _meshed(given) if given.wall is not None else line
    if parts is None:
        axis, bores, middle = _part(given)
    else:
        axis, bores, middle = parts.axis, parts.bores, _middle(parts)
    diameter = 2 * bores.radii[0]
    velocity = given.flow / (math.pi * bores.radii[0] ** 2)
    travel = 2 * diameter if given.travel is None else given.travel
    ramp = 0.5 * travel if given.ramp is None else given.ramp
    if ramp > travel:
        refuse("ramp", ramp, f"must not exceed the travel, {travel:g} m", "increase 'travel', or reduce 'ramp'")
    first = axis.pieces[0]
    assert isinstance(first, Line)
    start = np.array(axis.start) - travel * np.array(axis.tangent)
    whole = Axis(tuple(start.tolist()), axis.tangent, (Line(first.length + travel), *axis.pieces[1:]))
    check_return(whole, bores, travel)
    inserts = () if parts is None else tuple(_inserts(parts, travel))
    return Course(
        axis=whole, bores=_moved(bores, travel), travel=travel, ramp=ramp, velocity=velocity,
        middle=None if middle is None else (middle[0] + travel, middle[1] + travel), line=line, inserts=inserts,
        clear=_moved(parts.clear, travel) if parts is not None and inserts else None,
    )  # fmt: skip


def _moved(bores: Bores, by: float) -> Bores:
    return Bores(tuple(by + place for place in bores.places), bores.radii)


def _middle(line: PipeLine) -> tuple[float, float] | None:
    """Return the arc lengths [m] between which a line is not a straight pipe; None if all of it is straight."""
    odd = [k for k, part in enumerate(line.parts) if part.kind != "straight"]
    places = ends(line)
    return (float(places[odd[0]]), float(places[odd[-1] + 1])) if odd else None


def _inserts(line: PipeLine, travel: float) -> Iterator[Insert]:
    """Yield the parts of a pumping line whose bore is a mesh.

    Arc lengths are counted from the beginning of the straight pipe before the line, whose length is `travel` [m].
    """
    for part, (begin, end) in zip(line.parts, pairwise(travel + ends(line)), strict=True):
        if part.mesh:
            yield Insert(part.mesh, float(begin), float(end))


def _meshed(given: PartElements) -> PipeLine:
    """Return a pumping line that consists of a straight pipe, the bore of a mesh, and another straight pipe.

    The first pipe is level.
    """
    assert given.wall is not None
    if given.unit != "mesh":
        problem = f"can only be combined with 'unit' = mesh, not {given.unit}"
        refuse("wall", given.wall, problem, "set 'unit' to mesh, or give a pipeline file with a part 'bore' as 'line'")
    if given.outlet_diameter is not None:
        problem = "has no effect together with 'wall', because the mesh has its own outlet"
        refuse("outlet_diameter", given.outlet_diameter, problem, "leave out 'outlet_diameter'")
    mesh = bore_of(("wall", "wall_scale"), Path(given.wall), given.wall_scale)
    wide, outlet = mesh.ends
    if abs(wide / given.diameter - 1) > DIAMETER_TOLERANCE:
        problem = f"differs from the diameter of the mesh at its start, {wide:.4g} m"
        unit = scale_hint("wall_scale", given.wall_scale, wide, given.diameter)
        hint = unit or "set 'diameter' to this value, or scale the mesh with 'wall_scale'"
        refuse("diameter", given.diameter, problem, hint)
    ends, _ = mesh.axis.at([0.0, mesh.axis.length])
    length, rise = mesh.axis.length, float(ends[1, 2] - ends[0, 2])
    level = float(mesh.axis.at(length)[1][0, 2])
    parts = (
        Part(1, "straight", wide, given.straight, 0.0, wide),
        Part(2, "bore", wide, length, rise, outlet, mesh=mesh),
        Part(3, "straight", outlet, given.straight, level * given.straight, outlet),
    )
    pieces = (Line(given.straight), *mesh.axis.pieces, Line(given.straight))
    line = PipeLine("part", parts, Axis((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), pieces))
    check_crossing(line, hint="reduce 'straight', or shorten the bore of the mesh")
    return line


def _part(given: PartElements) -> tuple[Axis, Bores, tuple[float, float] | None]:
    """Return the axis of a single pipe part, its inner radii, and where its bend and taper begin and end.

    The axis begins at the origin. The third result contains two arc lengths [m]: the beginning of the first of these
    parts and the end of the last. It is None for a straight pipe of constant diameter.
    """
    origin, up, along, aside = (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
    radius, straight = given.diameter / 2, given.straight
    narrows = given.outlet_diameter is not None
    if narrows:
        hint = "for a larger change, use a 'line' from a file with several parts 'reducer'"
        between("outlet_diameter", given.outlet_diameter, given.diameter / 10, 10 * given.diameter, "m", hint)
    # In a pipe without a bend, the taper lies in the middle. In a pipe with a bend, it lies downstream, behind a
    # straight section.
    narrowing = straight + given.taper if narrows else 0.0
    if not given.unit.startswith("bend"):
        pieces: tuple[Line | Arc, ...] = (Line(straight + (narrowing or straight)),)
        axis = Axis(origin, up if given.unit == "vertical" else along, pieces)
        begin, middle = straight, None
    else:
        if given.elbow_radius <= radius:
            refuse("elbow_radius", given.elbow_radius, f"must exceed the pipe's radius, {radius:g} m")
        tangent = up if given.unit == "bend-to-horizontal" else along
        towards = {"bend-to-horizontal": along, "bend-to-vertical": up, "bend-level": aside}[given.unit]
        arc = Arc(given.elbow_radius, math.radians(given.angle), towards)
        axis = Axis(origin, tangent, (Line(straight), arc, Line(straight + narrowing)))
        begin, middle = 2 * straight + arc.length, (straight, straight + arc.length)
    if given.outlet_diameter is None:
        return axis, Bores((0.0,), (radius,)), middle
    bores = Bores((begin, begin + given.taper), (radius, given.outlet_diameter / 2))
    return axis, bores, (middle[0] if middle else begin, begin + given.taper)


def plug_layers(given: PartElements, diameter: float) -> int:
    """Return the number of layers of balls in the plug that closes the front of the concrete.

    By default the plug is so thick that the weight of the concrete cannot tip it over in a level pipe of this
    `diameter` [m].
    """
    if given.plug_layers is not None:
        return given.plug_layers
    return max(2, math.ceil(UPRIGHT * diameter / given.plug_ball - 1e-9))


def part_knobs(given: PartElements) -> Iterator[Knob]:
    """Yield the settings that trade accuracy for computing time in a scene of a part or line."""
    if given.time_step is None:
        yield scaled("time step", "safety", given.safety, (2.0, 1.5, 1.0, 0.5, 0.25), -1.0)
    yield precisions()
    if given.sizes in ("gaussian", "uniform"):
        widest = max(WIDEST_STONE * course_of(given).narrowest / given.size_max, 1.0)
        yield Knob("coarse-graining", tuple(coarser(given, c) for c in COARSENINGS if c <= widest), True)
    if given.shapes == "reference":
        yield Knob(
            "shape", (Level("spheres", {"shapes": "spheres"}, 0.3), Level("reference", {"shapes": "reference"})), True
        )
    if given.contact is None:
        yield scaled("stiffness", "modulus", given.modulus, (0.25, 0.5, 1.0), 0.5, "Pa", True)
    if given.settle > 0:
        yield scaled("settling", "settle", given.settle, (0.05, 0.2, 1.0), 0.3, "s")
