"""Pipeline parts whose bore is a mesh from a file: their axis and smallest width, and checks that they fit."""

import functools
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..core.errors import refuse
from ..core.inputs.limits import limit_of
from ..core.inputs.text_files import check_file
from .axis import Arc, Axis, Line
from .bores import Bores
from .inner_surface import DIRECTIONS_AROUND, InnerSurface, equal_radii
from .mesh_axis import pieces_through
from .mesh_bores import MeshBore
from .mesh_sections import follow
from .meshes import load

DIAMETER_TOLERANCE, ROUNDNESS_TOLERANCE = 0.02, 0.05
"""Largest accepted differences between the end of a mesh and the round pipe that meets it, as fractions of the pipe's
diameter and radius. The first number applies to the diameter of a circle with the area of the mesh's cross-section, and
the second number applies to the distance of the mesh's wall from the axis in any direction."""
STRAIGHT_LENGTH_TOLERANCE = 0.002
"""Largest accepted difference between the length of a straight mesh bore and the length stated for its part, divided by
the smaller diameter of the bore's two ends."""
MEASURED = 0.01
"""Largest accepted difference between the stated length of a part that is not straight and the length measured on its
mesh, as a fraction of the stated length."""
OVERLAP = 0.005
"""Length by which a round pipe overlaps with the end of a mesh bore, divided by the pipe's diameter."""
FINE = 0.005
"""Distance along the axis between neighbouring cross-sections at which a mesh bore is measured, divided by the bore's
diameter."""
STEPS = 4000
"""Maximum number of cross-sections at which the bore of one mesh is measured."""
PROFILE = 0.05
"""Length of the stretches of a mesh bore for each of which one mean radius is stored, divided by the bore's
diameter."""
FILE_UNITS = {"millimetres": 1e-3, "centimetres": 0.01, "metres": 1.0, "inches": 0.0254, "feet": 0.3048}
"""Units of length of mesh files [m]."""
Way = tuple[float, float, float]
Fields = tuple[str, str]
WAYS: tuple[Way, ...] = (
    (1.0, 0.0, 0.0),
    (0.0, 0.0, 1.0),
    (0.0, 1.0, 0.0),
    (-1.0, 0.0, 0.0),
    (0.0, 0.0, -1.0),
    (0.0, -1.0, 0.0),
)
"""Directions in which the bore of a mesh may lead away from the mesh's origin, in the order in which they are tried."""


def bore_of(
    fields: Fields,
    file: Path,
    scale: float,
    length: float | None = None,
    diameters: tuple[float, float] | None = None,
    ways: Sequence[Way] = WAYS[:1],
) -> MeshBore:
    """Measure and return the bore of a mesh file; the bore must begin at the mesh's origin.

    Args:
        fields: Names of the fields that error messages show, for the file and for its scale.
        file: Path of the mesh.
        scale: Factor from the file's length unit to metres.
        length: Required length of the axis [m]; any length if None.
        diameters: Required diameters at the start and at the end [m]; any diameters if None.
        ways: Unit directions in which the bore's axis may begin; a part of a pipeline begins along the mesh's x axis.

    Raises:
        SceneError: The file cannot be read, or its mesh has gaps, does not begin at its origin, is blocked, opens to
            the side, has another length, or has ends that are not round or have other diameters.
    """
    check_file(file, fields[0], hint="give the path of an STL, OBJ, PLY ... file")
    digest = hashlib.sha256(file.read_bytes() + repr(scale).encode()).hexdigest()[:12]
    # `_measured` first compares the size of the mesh with the required length, because it could not follow the bore of
    # a mesh that is far too large or small (wrong unit of length). `_of_length` later compares the exact length.
    bore = _measured(fields, file, scale, digest, length, tuple(ways))
    _check_scale(fields[1], scale, bore.ends[0])
    bore = _of_length(fields, bore, length)
    name = str(file)
    for end, place, which in ((0, 0.0, "begins"), (1, bore.axis.length, "ends")):
        reach = _surface(bore, fields[0]).sections(np.array([place]))[0]
        wide = 2 * float(np.sqrt(np.mean(reach**2)))
        if diameters is not None and abs(wide / diameters[end] - 1) > DIAMETER_TOLERANCE:
            unit = scale_hint(fields[1], scale, wide, diameters[end])
            refuse(fields[0], name, f"is {wide:.4g} m wide where it {which}, but the line is {diameters[end]:g} "
                   "m wide", unit or "where the mesh ends, set 'outlet' to its width; where the mesh begins, put a "
                                     "part 'reducer' before it")  # fmt: skip
        if np.any(np.abs(2 * reach / (diameters[end] if diameters else wide) - 1) > ROUNDNESS_TOLERANCE):
            refuse(fields[0], name, f"is not round and centred where it {which}: its wall is {reach.min():.4g} "
                   f"to {reach.max():.4g} m from the axis", "centre the mesh there, or make its end round")  # fmt: skip
    return bore


def _check_scale(field: str, scale: float, diameter: float) -> None:
    """Refuse a `scale` with which a bore has a `diameter` [m] that no pipe has; the file probably has another unit.

    `field` is the name of the scale in the message.
    """
    limit = limit_of("diameter", "m")
    if limit is not None and not limit.low <= diameter <= limit.high:
        unit = "0.001 for a file in millimetres" if diameter > limit.high else "1 for a file in metres"
        problem = f"makes the bore {diameter:.4g} m wide where it begins, but {limit.why}"
        refuse(field, scale, problem, f"{_option(field)}{unit}")


def _option(field: str) -> str:
    """Return the beginning of a hint that states the right scale of a mesh, such as "use --wall-scale ".

    A scene's mesh has an option for the scale; a mesh in a pipeline file has an entry.
    """
    return "use --wall-scale " if field == "wall_scale" else "write 'scale' as "


def scale_hint(field: str, scale: float, width: float, diameter: float) -> str:
    """Return a hint with the scale for which a bore has the required `diameter` [m]; empty if no unit of length fits.

    `field` is the name of the scale, and `width` [m] is the width of the bore with the present `scale`.
    """
    fitting = [f"{_option(field)}{factor:g} for a file in {unit}" for unit, factor in FILE_UNITS.items()
               if factor != scale and abs(width / scale * factor / diameter - 1) <= DIAMETER_TOLERANCE]  # fmt: skip
    return next(iter(fitting), "")


def _of_length(fields: Fields, bore: MeshBore, length: float | None) -> MeshBore:
    """Return the bore of a pipeline part after comparing its length with the `length` [m] stated for the part.

    A bore of a different length is refused. If the bore is straight, the result has exactly the stated length.
    """
    if length is None:
        return bore
    axis_length, straight = bore.axis.length, _is_straight(bore.axis)
    near = STRAIGHT_LENGTH_TOLERANCE * min(bore.ends) if straight else MEASURED * length
    if abs(axis_length - length) > near:
        problem = f"has an axis of {axis_length:.4g} m, but the part has a length of {length:g} m"
        refuse(fields[0], bore.file, problem, "correct 'length' of the part, or leave out 'length'")
    return replace(bore, axis=replace(bore.axis, pieces=(Line(length),))) if straight else bore


def _is_straight(axis: Axis) -> bool:
    return all(isinstance(piece, Line) for piece in axis.pieces)


@functools.lru_cache(maxsize=16)
def _measured(
    fields: Fields, file: Path, scale: float, digest: str, length: float | None, ways: tuple[Way, ...]
) -> MeshBore:
    """Find the axis of a mesh file and measure its bore; :func:`bore_of` explains the arguments.

    Results are cached. The `digest` of the file's content is part of the cache key, so that a changed file of the same
    name is read again.
    """
    mesh, name = load(file, fields[0], scale), str(file)
    extent = float(mesh.extents.max())
    if length is not None and not 0.01 * length <= extent <= 100 * length:
        problem = f"makes the mesh {extent:.4g} m long, but the part is {length:g} m long"
        refuse(fields[1], scale, problem, "check the scale, which is 0.001 for a file in millimetres")
    axis, radius = _axis(mesh.vertices, mesh.faces, ways, fields[0], name)
    surface = InnerSurface(mesh.vertices, mesh.faces, axis, radius, fields[0], name)
    width = 2 * float(equal_radii(surface.sections(np.zeros(1)))[0])
    s = np.linspace(0.0, axis.length, int(np.clip(axis.length / (FINE * width), 20, STEPS)))
    reach = surface.sections(s)
    count = max(2, round(axis.length / (PROFILE * width)))
    blocks = [np.array_split(each, min(count, len(s))) for each in (s, np.mean(reach**2, axis=1), reach.min(axis=1))]
    places, radii, least = (
        tuple(float(of(block)) for block in each)
        for of, each in zip((np.mean, lambda area: np.sqrt(np.mean(area)), np.min), blocks, strict=True)
    )
    narrowest = float((reach[:, : DIRECTIONS_AROUND // 2] + reach[:, DIRECTIONS_AROUND // 2 :]).min())
    return MeshBore(name, scale, axis, narrowest, digest, places, radii, least)


def _axis(vertices: np.ndarray, faces: np.ndarray, ways: tuple[Way, ...], field: str, name: str) -> tuple[Axis, float]:
    """Return the axis of a bore that begins at the mesh's origin, and the bore's radius at the origin [m].

    `ways` are the unit directions in which the axis may begin. Error messages show `field` and its value `name`.
    """
    start = np.zeros(3)
    sections = follow(vertices, faces, start, [np.array(way, float) for way in ways], field, name)
    way = sections.ahead
    pieces = pieces_through(sections.points, way, float(sections.radii[0]), float(sections.radii.max()))
    axis = Axis((0.0, 0.0, 0.0), tuple(way.tolist()), pieces)
    if _is_straight(axis):
        # A straight bore ends at the mesh's farthest vertex. This vertex gives the bore's length more accurately than
        # the last measured cross-section does.
        axis = Axis(axis.start, axis.tangent, (Line(float((vertices @ way).max())),))
    return axis, float(sections.radii[0])


@functools.lru_cache(maxsize=8)
def _surface(bore: MeshBore, field: str) -> InnerSurface:
    """Return the inner surface of a mesh bore in the mesh's own coordinates; results are cached per file content."""
    mesh = load(bore.file, field, bore.scale)
    return InnerSurface(mesh.vertices, mesh.faces, bore.axis, bore.radii[0], field, bore.file)


def directions_at(axis: Axis, s: float) -> np.ndarray:
    """Return the directions of a mesh's x, y and z axes after the mesh is placed on a pipe's axis, shape (3, 3).

    The mesh is placed at the arc length `s` [m], with its x axis along the pipe's axis. At the start of a level pipe,
    the mesh's z axis points up. At the start of a pipe that begins upwards or downwards, it points along the scene's -x
    or +x axis: this is the direction of "up" after a bend from the x axis into the vertical. From the start on, the z
    axis is transported along the pipe's axis without twist.
    """
    tangent, level = np.array(axis.tangent), np.array([0.0, 0.0, 1.0])
    if abs(tangent @ level) > 0.5:
        level = -np.sign(tangent[2]) * np.array([1.0, 0.0, 0.0])
    ahead, up = axis.at(s)[1][0], axis.carried(s, level)[0]
    return np.array([ahead, np.cross(up, ahead), up])


def rotated_pieces(pieces: Sequence[Line | Arc], directions: np.ndarray) -> tuple[Line | Arc, ...]:
    """Return the pieces of an axis (lines and arcs) after a rotation from mesh to world coordinates.

    The three rows of `directions` are the directions of the mesh's x, y and z axes in world coordinates.
    """
    return tuple(
        replace(piece, towards=tuple((np.array(piece.towards) @ directions).tolist()))
        if isinstance(piece, Arc)
        else piece
        for piece in pieces
    )


@dataclass(frozen=True)
class Insert:
    """Bore given as a triangle mesh, which replaces the round pipe along a piece of the pipe's axis."""

    mesh: MeshBore
    begin: float
    """Arc length along the pipe's axis at which the mesh bore begins [m]."""
    end: float
    """Arc length along the pipe's axis at which the mesh bore ends [m]."""


def wall_of(
    axis: Axis, bores: Bores, inserts: Sequence[Insert], facets: int, before: float, after: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices [m] (v, 3) and faces (f, 3) of the wall of a pipe that contains mesh bores.

    Between the meshes, the pipe is round, with `facets` facets around it and the volume of the exact pipe. Its ends
    overlap slightly with the meshes, so that the wall has no gap. The wall extends `before` [m] beyond the start of the
    axis and `after` [m] beyond the end of the axis. :func:`directions_at` defines how the meshes are oriented.
    """
    parts, begin = [], -before
    for insert in inserts:
        radii = float(bores.at(insert.begin)), float(bores.at(insert.end))
        parts.append(bores.mesh_between(axis, begin, insert.begin + 2 * OVERLAP * radii[0], facets))
        surface = _surface(insert.mesh, "bore")
        point = axis.at(insert.begin)[0][0]
        parts.append((point + surface.vertices @ directions_at(axis, insert.begin), surface.faces))
        begin = insert.end - 2 * OVERLAP * radii[1]
    parts.append(bores.mesh_between(axis, begin, axis.length + after, facets))
    return together(parts)


def together(parts: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices [m] (v, 3) and faces (f, 3) of one mesh that joins several meshes."""
    firsts = np.cumsum([0, *(len(points) for points, _ in parts[:-1])])
    faces = np.concatenate([faces + first for (_, faces), first in zip(parts, firsts, strict=True)])
    return np.concatenate([points for points, _ in parts]), faces
