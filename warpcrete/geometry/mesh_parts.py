"""A part of a line whose bore is a mesh from a file: whether it fits, and how narrow it is."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..core.errors import refuse
from .axis import Axis, Line
from .bores import Bores
from .meshes import border_edges, border_loops, load, rays

if TYPE_CHECKING:  # half a second to import, and most lines have no mesh
    import trimesh

FIT, ROUND = 0.02, 0.05
"""By how much a mesh may differ where it begins and ends from the line's pipe: by its area, as a diameter, and anywhere
around."""
PLACED = 0.002
"""Diameters by which it may begin and end beside where it should."""
OVERLAP = 0.005
"""Diameters by which round pipe reaches into it."""
ACROSS, NEAR = 0.9, 0.05
"""Cosine between a triangle's normal and the axis above which it closes a mesh, if it lies so near its end, over the
radius."""
AROUND, FINE, FACETS = 24, 0.005, 96
"""Directions in which a bore is measured, diameters between places, and facets of round pipe."""
STEPS = 4000
"""Places at most."""
PROFILE = 0.05
"""Diameters between places of what a line knows of its radii."""


@dataclass(frozen=True)
class MeshBore:
    """What a line knows of a mesh that is one of its parts."""

    file: str
    """Whole path."""
    scale: float
    """Of its unit: 0.001 for mm."""
    narrowest: float
    """Across the axis [m]."""
    digest: str
    """Of what the file holds and how it is scaled."""
    places: tuple[float, ...]
    """From where it begins, rising [m]."""
    radii: tuple[float, ...]
    """There, of circles of its area [m]."""
    least: tuple[float, ...]
    """Of circles about the axis that are free there [m]."""


def bore_of(field: str, file: Path, scale: float, length: float, diameters: tuple[float, float]) -> MeshBore:
    """The bore in a mesh `file`, which must begin at its origin and lead along its x for a `length` [m].

    Raises :class:`SceneError` for a file that cannot be read, a mesh that has gaps, does not lie about that axis or is
    blocked on it, or whose ends are not round and of these `diameters` [m].
    """
    mesh, name = load(file, f"{field}: file", scale), str(file)
    low, high = mesh.bounds
    near, width = PLACED * min(diameters), max(diameters)
    if high[0] - low[0] > 100 * length or high[0] - low[0] < 0.01 * length:
        refuse(f"{field}: scale", scale, f"makes the mesh {high[0] - low[0]:.4g} m long, and the part is {length:g} m",
               "check it: 0.001 for a file in mm")  # fmt: skip
    if abs(low[0]) > near or abs(high[0] - length) > near:
        refuse(f"{field}: file", name, f"goes from x = {low[0]:.4g} to {high[0]:.4g} m, and the part from 0 to "
               f"{length:g} m", "give the part's length, or move the mesh")  # fmt: skip
    _check_closed(mesh, f"{field}: file", name, length, near)
    reach = _probed(mesh, length, width)
    bare = int(np.count_nonzero(reach < 0))
    if bare:
        spans = " x ".join(f"{x:.4g}" for x in mesh.extents)
        refuse(f"{field}: file", name, f"has gaps or does not lie about the line's axis, which is its x: {bare} of "
               f"{reach.size} probes find no wall (it spans {spans} m)", "close its holes, or move it")  # fmt: skip
    for end, diameter, which in ((0, diameters[0], "begins"), (-1, diameters[1], "ends")):
        found = 2 * float(np.sqrt(np.mean(reach[end] ** 2)))
        if abs(found / diameter - 1) > FIT:
            refuse(f"{field}: file", name, f"is {found:.4g} m wide where it {which}, and the line is {diameter:g} m",
                   "give outlet, the diameter behind it, or put a reducer beside it")  # fmt: skip
        if np.any(np.abs(2 * reach[end] / diameter - 1) > ROUND):
            refuse(f"{field}: file", name, f"is not round where it {which}, or lies beside the axis: its wall is "
                   f"{reach[end].min():.4g} to {reach[end].max():.4g} m away", "move it, or end it round")  # fmt: skip
    inset = np.array([[2 * near, 0.0, 0.0]])
    if rays(mesh, inset, np.array([[1.0, 0.0, 0.0]]), length - 4 * near)[0] >= 0:
        refuse(f"{field}: file", name, "is blocked: a surface crosses the line's axis", "leave the bore open there")
    across = reach[:, : AROUND // 2] + reach[:, AROUND // 2 :]
    digest = hashlib.sha256(Path(file).read_bytes() + repr(scale).encode()).hexdigest()[:12]
    s, count = _places(length, width), max(2, round(length / (PROFILE * width)))
    blocks = [np.array_split(each, min(count, len(s))) for each in (s, np.mean(reach**2, axis=1), reach.min(axis=1))]
    places, radii, least = (
        tuple(float(of(block)) for block in each)
        for of, each in zip((np.mean, lambda area: np.sqrt(np.mean(area)), np.min), blocks, strict=True)
    )
    return MeshBore(name, scale, float(across.min()), digest, places, radii, least)


def _check_closed(mesh: trimesh.Trimesh, field: str, name: str, length: float, near: float) -> None:
    """Closed, as with lids or a thick wall, or open at its two ends alone."""
    border = border_edges(mesh)
    loops = border_loops(border) if len(border) else []
    ends = [mesh.vertices[loop][:, 0] for loop in loops]
    at = [sum(bool(np.all(np.abs(x - place) <= near)) for x in ends) for place in (0.0, length)]
    if loops and (len(loops) != 2 or at != [1, 1]):
        refuse(field, name, f"is not closed: {len(border)} border edges in {len(loops)} rims, where a bore has one at "
               "each end or none", "close its holes (trimesh.repair.fill_holes, or in the CAD program)")  # fmt: skip


def _places(length: float, width: float) -> np.ndarray:
    """Where along a bore it is measured [m]."""
    inset = min(0.01 * width, 0.02 * length)  # beside a lid
    return np.linspace(inset, length - inset, int(np.clip(length / (FINE * width), 20, STEPS)))


def _probed(mesh: trimesh.Trimesh, length: float, width: float) -> np.ndarray:
    """Distances [m] of the wall from the axis at places along it, -1 for none, shape (places, AROUND)."""
    axis = Axis((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (Line(length),))
    points, _, normal, side = axis.frame(_places(length, width))
    # Turned by an odd angle, so that rays do not run into the edges between the facets of a regular tube.
    angle = 2 * np.pi * (np.arange(AROUND) + 0.382) / AROUND
    ways = np.cos(angle)[None, :, None] * normal[:, None] + np.sin(angle)[None, :, None] * side[:, None]
    starts = np.broadcast_to(points[:, None], ways.shape)
    return rays(mesh, starts.reshape(-1, 3), ways.reshape(-1, 3), 10 * width).reshape(-1, AROUND)


def between_pipes(
    mesh: trimesh.Trimesh, axis: Axis, insert: tuple[float, float], radii: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (v, 3) and faces (f, 3) of a mesh between round pipes of these `radii` [m].

    The mesh begins at its origin along the `axis`, which is straight, and is moved to lie between the arc lengths of
    `insert`; lids at its ends are left out.
    """
    begin, end = insert
    start, tangent = np.array(axis.start, float), np.array(axis.tangent, float)
    faces = _without_lids(mesh, (mesh.triangles_center - start) @ tangent, tangent, end - begin, radii)
    parts = [(mesh.vertices + begin * tangent, faces)]
    wider = np.sqrt(2 * np.pi / (FACETS * np.sin(2 * np.pi / FACETS)))  # the area of a circle
    # Pipe reaches a little into the mesh, for a ray in a plane where both only end finds no wall, and out of the part.
    for low, high, radius in ((-radii[0], begin, radii[0]), (end, axis.length + radii[1], radii[1])):
        more = 2 * OVERLAP * radius
        low, high = (low, high + more) if low < 0 else (low - more, high)
        count = 2 + int((high - low) / (4 * radius))  # boxes of the search must not become long
        parts.append(axis.swept(np.linspace(low, high, count), wider * radius, FACETS))
    return _together(parts)


def _without_lids(
    mesh: trimesh.Trimesh, along: np.ndarray, tangent: np.ndarray, length: float, radii: tuple[float, float]
) -> np.ndarray:
    """Faces (f, 3) that do not close an end of the bore; `along` are arc lengths of their middles [m]."""
    across = np.abs(mesh.face_normals @ tangent) > ACROSS
    return mesh.faces[~(across & ((along < NEAR * radii[0]) | (along > length - NEAR * radii[1])))]


@dataclass(frozen=True)
class Insert:
    """Where a bore from a mesh lies along an axis."""

    mesh: MeshBore
    begin: float
    """Arc length [m]."""
    end: float
    """[m]"""


def wall_of(
    axis: Axis, bores: Bores, inserts: Sequence[Insert], facets: int, before: float, after: float
) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (v, 3) and faces (f, 3) of the wall of a pipe that meshes are pieces of.

    Round pipe, of `facets` and its own volume, reaches a little into them, so that nothing finds a gap; it starts
    `before` [m] ahead of the axis and ends `after` [m] behind it. A mesh's z is up where the line begins level, and
    against the way it bends up by; it is carried along without twist.
    """
    level = np.array([0.0, 0.0, 1.0])
    tangent = np.array(axis.tangent)
    if abs(tangent @ level) > 0.5:
        level = -np.sign(tangent[2]) * np.array([1.0, 0.0, 0.0])
    parts, begin = [], -before
    for insert in inserts:
        radii = float(bores.at(insert.begin)), float(bores.at(insert.end))
        parts.append(bores.mesh_between(axis, begin, insert.begin + 2 * OVERLAP * radii[0], facets))
        mesh = load(insert.mesh.file, "bore", insert.mesh.scale)
        faces = _without_lids(mesh, mesh.triangles_center[:, 0], np.eye(3)[0], insert.end - insert.begin, radii)
        point, ahead = (each[0] for each in axis.at(insert.begin))
        up = axis.carried(insert.begin, level)[0]
        parts.append((point + mesh.vertices @ np.array([ahead, np.cross(up, ahead), up]), faces))
        begin = insert.end - 2 * OVERLAP * radii[1]
    parts.append(bores.mesh_between(axis, begin, axis.length + after, facets))
    return _together(parts)


def _together(parts: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """One mesh of several."""
    firsts = np.cumsum([0, *(len(points) for points, _ in parts[:-1])])
    faces = np.concatenate([faces + first for (_, faces), first in zip(parts, firsts, strict=True)])
    return np.concatenate([points for points, _ in parts]), faces
