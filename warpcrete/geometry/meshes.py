"""Triangle meshes from files: reading, closedness, distances, and the fit of a pipe to its axis."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from ..core.device import quiet_init
from ..core.errors import refuse
from ..core.launching import launch
from ..core.text_files import check_file
from ..kernels.common.mesh_queries import distances, nearest_faces, ray_distances, signed_distances
from .axis import Axis
from .cleaning import clean
from .walls import MeshWall, PipeWall

if TYPE_CHECKING:  # half a second to import, and most scenes have no mesh
    import trimesh

FARTHEST_WALL = 10.0
"""Length of the rays that look for a wall, over the radius."""
TURNED, ASIDE = 0.382, 0.1
"""Parts of the angle between two rays by which all are turned, so that they miss the edges of regular tubes, and by
which those that slip through are turned once more."""
ROUND = 0.01
"""Part of a pipe's radius by which its wall may differ from the cylinder and still count as one."""
MOST_FACES = 500_000
"""Triangles of a mesh; reading so many takes ten seconds."""
FARTHEST = 1e4
"""Distance of a corner from the origin [m]."""


def load(source: Any, field: str, scale: float = 1.0) -> trimesh.Trimesh:
    """Mesh from a ``trimesh.Trimesh`` or any file that trimesh reads, cleaned (:func:`clean`).

    Raises :class:`SceneError` naming `field` if it cannot be read or holds no usable triangles.
    """
    import trimesh

    if isinstance(source, trimesh.Trimesh):
        mesh = source.copy()
    elif not isinstance(source, str | Path):
        refuse(field, type(source).__name__, "must be a trimesh.Trimesh or the path of a mesh file")
    else:
        path = check_file(source, field, hint="give the path of an STL, OBJ, PLY ... file")
        try:
            with np.errstate(all="ignore"):  # what is wrong with its numbers is told below
                mesh = trimesh.load_mesh(path)
                if isinstance(mesh, trimesh.Scene):
                    mesh = mesh.to_mesh()
        except Exception as error:  # trimesh raises whatever its readers raise
            # A file of noise ends in whatever reader is tried last, or in one that is not installed.
            why = "it is damaged or of another kind" if isinstance(error, ImportError) else " ".join(str(error).split())
            refuse(field, str(source), f"cannot be read as a triangle mesh ({why or type(error).__name__})",
                   "give an STL, OBJ, PLY ... file whose ending says what it is")  # fmt: skip
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0 or not np.all(np.isfinite(mesh.vertices)):
        refuse(field, str(source), "holds no triangles, or corners that are not finite")
    _check_size(mesh, field, str(source), scale)
    vertices, faces, _ = clean(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    if len(mesh.faces) == 0:
        refuse(field, str(source), "holds only triangles without area")
    mesh.apply_scale(scale)
    return mesh


def _check_size(mesh: trimesh.Trimesh, field: str, name: str, scale: float) -> None:
    """Refuse a mesh of more triangles, or with corners farther away, than can be computed with."""
    if len(mesh.faces) > MOST_FACES:
        refuse(field, name, f"has {len(mesh.faces)} triangles; at most {MOST_FACES} are read",
               "simplify it (trimesh's simplify_quadric_decimation, or in the CAD program)")  # fmt: skip
    farthest = float(np.abs(mesh.vertices).max()) * scale
    if farthest > FARTHEST:
        refuse(field, name, f"has a corner {farthest:.3g} m away; at most {FARTHEST:g} m are possible",
               "look at its corners, and at the scale of its unit (0.001 for mm)")  # fmt: skip


def border_edges(mesh: trimesh.Trimesh) -> np.ndarray:
    """Edges that belong to one triangle only, shape (n, 2)."""
    edges = mesh.edges_sorted
    unique, count = np.unique(edges, axis=0, return_counts=True)
    return unique[count == 1]


def load_closed(source, field: str, scale: float = 1.0) -> trimesh.Trimesh:
    """As :func:`load`, but the mesh must be watertight; normals are turned outward."""
    mesh = load(source, field, scale)
    name = source if isinstance(source, str | Path) else "mesh"
    if not mesh.is_watertight:
        refuse(
            field,
            str(name),
            f"is open: {len(border_edges(mesh))} border edges",
            "close its holes (trimesh.repair.fill_holes, or in the CAD program)",
        )
    if not mesh.is_winding_consistent:
        refuse(field, str(name), "has triangles that face both ways", "orient them alike (trimesh.repair.fix_winding)")
    if mesh.volume < 0:
        mesh.invert()
    if mesh.volume <= 0:
        refuse(field, str(name), "encloses no volume")
    return mesh


def signed_distance(mesh: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    """Distance of points (n, 3) to a closed mesh [m], negative inside; single precision."""
    device = "cpu"
    surface = _warp_mesh(mesh, device, winding=True)
    reach = float(np.linalg.norm(mesh.extents)) * 4 + float(np.abs(points).max(initial=0.0)) * 2
    distance = wp.zeros(len(points), dtype=wp.float32, device=device)
    queries = wp.array(points.astype(np.float32), dtype=wp.vec3, device=device)
    named = {"mesh": surface.id, "points": queries, "reach": reach, "distance": distance}
    launch(signed_distances, len(points), wp.get_device(device), **named)
    return distance.numpy().astype(float)


@dataclass(frozen=True)
class Bore:
    """What the inside of a pipe came to, measured from its axis."""

    smallest: float
    """Smallest distance of the wall [m]."""
    largest: float
    """Largest [m]."""
    area: float
    """Mean cross-section [m2]."""

    @classmethod
    def of(cls, reach: np.ndarray) -> Bore:
        """From distances of the wall, which all found it."""
        return cls(float(reach.min()), float(reach.max()), float(np.pi * np.mean(reach**2)))

    def is_round(self, radius: float) -> bool:
        """Whether a cylinder of `radius` [m] stands for it."""
        return self.smallest >= (1 - ROUND) * radius and self.largest <= (1 + ROUND) * radius


def _stations(radius: float, end: float, begin: float = 0.0) -> np.ndarray:
    """Arc lengths at which a pipe is measured; its ends may be capped, so they lie inside them."""
    inset = min(0.02 * radius, 0.25 * (end - begin))
    return np.linspace(begin + inset, end - inset, max(8, int((end - begin) / radius)))


def bore_probes(mesh: Any, axis: Axis, radius: float, end: float, around: int = 12, begin: float = 0.0) -> np.ndarray:
    """Distances [m] from an axis between two arc lengths to the mesh, -1 where there is none.

    `mesh` is anything with `vertices` (v, 3) and `faces` (f, 3), `radius` what is expected. The result has a row for
    each place along the axis and a column for each of so many directions `around` it.
    """
    points, _, normal, side = axis.frame(_stations(radius, end, begin))
    return SurfaceQueries(mesh.vertices, mesh.faces).around(points, normal, side, around, FARTHEST_WALL * radius)


def enclosed(wall: PipeWall | MeshWall, axis: Axis, points: np.ndarray) -> np.ndarray:
    """Which of `points` (n, 3) [m] lie inside a pipe's wall, seen from its axis."""
    nearest = axis.nearest(points)
    apart = np.linalg.norm(points - nearest, axis=1)
    if isinstance(wall, PipeWall):
        return apart <= wall.radius
    outward = (points - nearest) / np.maximum(apart, 1e-12)[:, None]
    found = rays(wall, nearest, outward, float(apart.max(initial=1e-12)) * 1.001)
    return (found < 0) | (found >= apart)


def faces_at(mesh: Any, points: np.ndarray, reach: float) -> np.ndarray:
    """Triangle of the mesh that is nearest to each of `points` (n, 3) [m], -1 where none is within `reach` [m].

    `mesh` is anything with `vertices` (v, 3) and `faces` (f, 3); single precision.
    """
    surface = _warp_mesh(mesh, "cpu")
    face = wp.zeros(len(points), dtype=wp.int32, device="cpu")
    queries = wp.array(np.ascontiguousarray(points, np.float32), dtype=wp.vec3, device="cpu")
    launch(nearest_faces, len(points), wp.get_device("cpu"), mesh=surface.id, points=queries, reach=reach, face=face)
    return face.numpy().astype(int)


def rays(mesh: Any, origins: np.ndarray, directions: np.ndarray, reach: float) -> np.ndarray:
    """Return distances [m] along unit `directions` (n, 3) from `origins` (n, 3) to the mesh, -1 for a miss.

    `mesh` is anything with `vertices` (v, 3) and `faces` (f, 3).
    """
    return SurfaceQueries(mesh.vertices, mesh.faces).rays(origins, directions, reach)


def fan(normal: np.ndarray, side: np.ndarray, count: int, turned: float = TURNED) -> np.ndarray:
    """Return unit vectors at `count` even angles in planes of two unit vectors (n, 3), shape (n, count, 3)."""
    angle = 2 * np.pi * (np.arange(count) + turned) / count
    return np.cos(angle)[None, :, None] * normal[:, None] + np.sin(angle)[None, :, None] * side[:, None]


class SurfaceQueries:
    """Rays to a triangle mesh and distances from it, in single precision on the CPU."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        quiet_init()
        points = wp.array(np.ascontiguousarray(vertices, np.float32), dtype=wp.vec3, device="cpu")
        corners = wp.array(np.ascontiguousarray(faces, np.int32).ravel(), dtype=wp.int32, device="cpu")
        self._mesh = wp.Mesh(points=points, indices=corners)
        self._extent = float(np.abs(vertices).max(initial=0.0))

    def rays(self, origins: np.ndarray, directions: np.ndarray, reach: float) -> np.ndarray:
        """Return distances [m] along unit `directions` (n, 3) from `origins` (n, 3), -1 for a miss."""
        along = wp.array(np.ascontiguousarray(directions, np.float32), dtype=wp.vec3, device="cpu")
        return self._launched(ray_distances, origins=_points(origins), directions=along, reach=reach)

    def around(self, points: np.ndarray, normal: np.ndarray, side: np.ndarray, count: int, reach: float) -> np.ndarray:
        """Return distances [m] of the wall around points in planes of two unit vectors, each shape (n, 3).

        There are `count` directions in even angles; -1 stands for no wall within `reach` [m]. Shape (n, count).
        """
        found = self._fan(points, normal, side, count, reach, TURNED)
        if np.any(found < 0):
            # A ray along an edge between two facets may miss both: look again a little beside.
            found = np.where(found < 0, self._fan(points, normal, side, count, reach, TURNED + ASIDE), found)
        return found

    def _fan(
        self, points: np.ndarray, normal: np.ndarray, side: np.ndarray, count: int, reach: float, turned: float
    ) -> np.ndarray:
        ways = fan(normal, side, count, turned)
        starts = np.broadcast_to(points[:, None], ways.shape)
        return self.rays(starts.reshape(-1, 3), ways.reshape(-1, 3), reach).reshape(len(points), count)

    def distances(self, points: np.ndarray) -> np.ndarray:
        """Return the distance [m] of each of `points` (n, 3) from the surface."""
        reach = 4 * (self._extent + float(np.abs(points).max(initial=0.0)))
        return self._launched(distances, points=_points(points), reach=reach)

    def _launched(self, kernel: wp.Kernel, **arguments: Any) -> np.ndarray:
        count = len(next(iter(arguments.values())))
        distance = wp.zeros(count, dtype=wp.float32, device="cpu")
        launch(kernel, count, wp.get_device("cpu"), mesh=self._mesh.id, distance=distance, **arguments)
        return distance.numpy().astype(float)


def _points(places: np.ndarray) -> wp.array:
    return wp.array(np.ascontiguousarray(places, np.float32), dtype=wp.vec3, device="cpu")


def _warp_mesh(mesh: Any, device: str, winding: bool = False) -> wp.Mesh:
    quiet_init()
    return wp.Mesh(
        points=wp.array(mesh.vertices.astype(np.float32), dtype=wp.vec3, device=device),
        indices=wp.array(mesh.faces.astype(np.int32).ravel(), dtype=wp.int32, device=device),
        support_winding_number=winding,
    )
