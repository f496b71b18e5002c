"""Aggregates that a piston pushes through one part of a pump line, or several in a row, by discrete elements."""

import math
from collections.abc import Iterator

import numpy as np

from warpcrete.core.inputs.knobs import Trading
from warpcrete.core.inputs.limits import check_velocity
from warpcrete.core.inputs.scene_functions import scene_function
from warpcrete.core.run.run import Run
from warpcrete.dem.pumping.components import fill_of, law_remarks, plug_of, settings_of, sizes_of
from warpcrete.dem.pumping.parameter_groups import index_settings
from warpcrete.dem.pumping.parameters import WIDEST_STONE
from warpcrete.dem.pumping.parts import Course, PartElements, course_of, part_knobs, plug_layers
from warpcrete.dem.scene.containers import PipeContainer
from warpcrete.dem.scene.scene import PipeUnit, PressureProbe, Scene, Stations
from warpcrete.dem.scene.sizes import Sizes
from warpcrete.geometry.mesh_parts import wall_of
from warpcrete.geometry.walls import MeshWall, PipeWall, PlaneWall, Prescribed

from .pipe import check as check_of_pipe


@scene_function(PartElements)
def scene(parameters: PartElements) -> Scene:
    """Model aggregates that a piston pushes through a part of a pump line or a whole line, and compute the pressure.

    The part begins at the origin. At the start, concrete fills a straight pipe upstream of the part. The piston pushes
    this concrete into the part, so that the part stays full. Slices along the part measure stress, wall stress, solid
    fraction and velocity (`stations.csv`). The pressure losses of the straight stretches, and of the bend or taper
    between them, are computed from these slices.

    Raises :class:`warpcrete.SceneError` for parameters that cannot be simulated.
    """
    given = parameters
    course = course_of(given)
    check_velocity("flow", given.flow, course.velocity)
    axis, bores = course.axis, course.bores
    sizes = sizes_of(given, course.narrowest)
    pipe = _pipe(given, course)
    outlet = float(bores.at(axis.length))
    plug = plug_of(given, axis, axis.length, outlet, plug_layers(given, 2 * outlet), outlet)
    inlet = float(bores.at(0.0))
    return Scene(
        name="part-dem",
        duration=course.duration,
        bodies=plug.bodies,
        fill=fill_of(given, _container(course, pipe), sizes),
        walls=(*plug.plates, _piston(course, inlet), pipe),
        drives=plug.drives,
        group_bonds=plug.bonds,
        pressure=PressureProbe(wall="piston", area=math.pi * inlet**2),
        pipe=PipeUnit(
            name="line" if course.line is not None else given.unit,
            axis=axis,
            radius=inlet,
            concrete_length=axis.length,
            velocity=course.velocity,
            ramp=course.ramp,
            travel=course.travel,
        ),
        stations=_stations(given, course),
        remarks=tuple(_remarks(given, course, sizes)),
        **settings_of(given),
        **index_settings(given),
    )


def _pipe(given: PartElements, course: Course) -> PipeWall | MeshWall:
    """Return an exact round pipe if the bore has one diameter, and a triangle mesh otherwise."""
    axis, bores = course.axis, course.bores
    if bores.is_straight:
        return PipeWall(name="pipe", axis=axis, radius=bores.radii[0])
    outlet = float(bores.at(axis.length))
    beyond = 2 * course.advance + plug_layers(given, 2 * outlet) * given.plug_ball + 2 * outlet
    vertices, faces = wall_of(axis, bores, course.inserts, given.facets, before=2 * bores.largest, after=beyond)
    return MeshWall(name="pipe", vertices=vertices, faces=faces)


def _container(course: Course, pipe: PipeWall | MeshWall) -> PipeContainer:
    """Return the space that is packed with aggregates: the whole pipe, from the piston to the outlet."""
    length, least = course.axis.length, course.narrowest / 2
    if isinstance(pipe, PipeWall):
        return PipeContainer(course.axis, least, length)
    return PipeContainer(course.axis, least, length, pipe, bores=course.bores, clear=course.clear)


def _piston(course: Course, radius: float) -> PlaneWall:
    axis, speed = course.axis, course.velocity
    motion = Prescribed(velocity=tuple((speed * np.array(axis.tangent)).tolist()), ramp_time=2 * course.ramp / speed)
    return PlaneWall(name="piston", point=axis.start, normal=axis.tangent, motion=motion, drawn_radius=radius)


def _stations(given: PartElements, course: Course) -> Stations:
    """Return slices of equal length along the part, in which stresses, solid fraction and velocity are measured."""
    begin, end = course.travel, course.axis.length
    count = max(1, round(given.slices * (end - begin) / (2 * float(course.bores.at(begin)))))
    edges = np.linspace(begin, end, count + 1)
    return Stations(
        axis=course.axis, bores=course.bores, edges=tuple(edges.tolist()), origin=begin, middle=course.middle,
        each_row=given.slices > 0,
    )  # fmt: skip


def _remarks(given: PartElements, course: Course, sizes: Sizes) -> Iterator[str]:
    """Yield remarks on simplifications and on aggregates that are too large for pumping."""
    narrow = course.narrowest
    yield from law_remarks(given)
    if given.shapes == "spheres":
        yield "aggregates are single spheres; use --shapes reference for the paper's clumps"
    if sizes.largest > WIDEST_STONE * narrow:
        yield (
            f"the largest aggregates measure {sizes.largest / narrow:.2g} of the diameter of the narrowest bore; "
            f"above {WIDEST_STONE:g}, concrete cannot be pumped (ACI 304.2R)"
        )
    if given.slices > 0 and not _stations(given, course).can_fit_losses:
        yield ("the straight pipes are too short to measure their pressure losses: each needs two slices at least one "
               "radius away from its ends")  # fmt: skip
    if course.line is not None:
        yield from course.line.remarks()


def check(run: Run) -> dict[str, tuple[bool, str]]:
    """Return the checks of a finished run by name, each as a tuple (True if passed, text with the measured value)."""
    return check_of_pipe(run)


trading = Trading(part_knobs, ("end_pressure",))
