"""Triangle meshes from files: reading and checks, distances and rays, and the fit between a mesh and a pipe's axis."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from ..core.device.device import quiet_init
from ..core.device.launching import launch
from ..core.errors import refuse
from ..core.inputs.text_files import check_file
from ..kernels.common.mesh_queries import distances, nearest_faces, ray_distances, signed_distances
from .axis import Axis
from .cleaning import clean
from .walls import MeshWall, PipeWall

if TYPE_CHECKING:  # Import trimesh only when a mesh is read, because the import takes half a second.
    import trimesh

FARTHEST_WALL = 10.0
"""Length of the rays that search for a pipe's wall, divided by the pipe's radius."""
FAN_ROTATION, RETRY_ROTATION = 0.382, 0.1
"""Two rotations of a fan (rays from one point in equally spaced directions), each divided by the angle between two
neighbouring rays. Every fan is turned by the first rotation, which keeps the rays away from the edges of regular tubes.
If a ray meets no wall, the fan is turned further by the second rotation and tried again."""
ROUNDNESS_TOLERANCE = 0.01
"""Largest difference between the radius of a cylinder and the distance of a bore's wall from the axis at which the bore
still counts as cylindrical, as a fraction of the cylinder's radius."""
MAX_FACES = 500_000
"""Largest accepted number of triangles of a mesh; reading a mesh of this size takes ten seconds."""
MAX_EXTENT = 1e4
"""Largest accepted distance of a mesh's corner from the origin [m]."""


def load(source: object, field: str, scale: float = 1.0) -> trimesh.Trimesh:
    """Read a mesh from `source`, a ``trimesh.Trimesh`` or any file that trimesh reads, and clean it with :func:`clean`.

    `scale` is the factor from the mesh's length unit to metres. Raises :class:`SceneError` about the parameter `field`
    if the mesh cannot be read or holds no usable triangles.
    """
    import trimesh

    if isinstance(source, trimesh.Trimesh):
        mesh = source.copy()
    elif not isinstance(source, str | Path):
        refuse(field, type(source).__name__, "must be a trimesh.Trimesh or the path of a mesh file")
    else:
        path = check_file(source, field, hint="give the path of an STL, OBJ, PLY ... file")
        _check_count(_stl_triangles(path), field, str(source))
        try:
            with np.errstate(all="ignore"):  # Ignore NumPy's warnings: invalid numbers are refused below.
                mesh = trimesh.load_mesh(path)
                if isinstance(mesh, trimesh.Scene):
                    mesh = mesh.to_mesh()
        except Exception as error:  # Catch every error, because trimesh passes on any error of its readers.
            # A file in an unknown format fails in the last reader that trimesh tries, perhaps with an ImportError
            # because that reader is not installed. The text of this ImportError would mislead the user.
            why = (
                "it is damaged or has another format"
                if isinstance(error, ImportError)
                else " ".join(str(error).split())
            )
            problem = f"cannot be read as a triangle mesh ({why or type(error).__name__})"
            cure = "give a mesh file such as STL, OBJ or PLY, whose extension matches its format"
            refuse(field, str(source), problem, cure)
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0 or not np.all(np.isfinite(mesh.vertices)):
        refuse(field, str(source), "must contain triangles with finite vertices", "check that it is a triangle mesh")
    _check_size(mesh, field, str(source), scale)
    vertices, faces, _ = clean(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    if len(mesh.faces) == 0:
        problem = "contains only triangles without area"
        refuse(field, str(source), problem, "check the file, and the unit of its coordinates")
    mesh.apply_scale(scale)
    return mesh


def _check_size(mesh: trimesh.Trimesh, field: str, name: str, scale: float) -> None:
    """Refuse a mesh with too many triangles, or with corners too far from the origin for the accuracy of computations.

    Error messages show `field` and its value `name`. `scale` is the factor from the file's unit to metres.
    """
    _check_count(len(mesh.faces), field, name)
    farthest = float(np.abs(mesh.vertices).max()) * scale
    if farthest > MAX_EXTENT:
        refuse(field, name, f"has a vertex {farthest:.3g} m from the origin, but at most {MAX_EXTENT:g} m are allowed",
               "check the vertices, and the scale of the mesh, which is 0.001 for a file in millimetres")  # fmt: skip


def _check_count(count: int, field: str, name: str) -> None:
    if count > MAX_FACES:
        hint = "simplify the mesh in a CAD program or with trimesh.Trimesh.simplify_quadric_decimation"
        refuse(field, name, f"has {count} triangles, but at most {MAX_FACES} are allowed", hint)


def _stl_triangles(path: Path) -> int:
    """Return the number of triangles in a binary STL file, without reading them; 0 for any other file."""
    with path.open("rb") as file:
        count = int.from_bytes(file.read(84)[80:], "little")
    is_stl = path.suffix.lower() == ".stl" and path.stat().st_size == 84 + 50 * count
    return count if is_stl else 0


def border_edges(mesh: trimesh.Trimesh) -> np.ndarray:
    """Return the edges that belong to exactly one triangle, as pairs of corner indices, shape (n, 2)."""
    edges, count = _edge_counts(mesh)
    return edges[count == 1]


def _edge_counts(mesh: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    """Return all edges of a mesh as pairs of corner indices, shape (n, 2), and the number of triangles at each edge."""
    return np.unique(mesh.edges_sorted, axis=0, return_counts=True)


def load_closed(source, field: str) -> trimesh.Trimesh:
    """Read a mesh like :func:`load`, refuse it if it is not watertight, and turn its normals outward."""
    mesh = load(source, field)
    name = source if isinstance(source, str | Path) else "mesh"
    if not mesh.is_watertight:
        count = _edge_counts(mesh)[1]
        single, several = (count == 1).sum(), (count > 2).sum()
        problem = f"is not closed: {single} of its edges belong to one triangle only"
        hint = "close the holes of the mesh in a CAD program or with trimesh.repair.fill_holes"
        if single == 0:
            problem = f"has {several} edges to which more than two triangles belong"
            hint = "join bodies that touch each other to one body in a CAD program, or give one of them"
        refuse(field, str(name), problem, hint)
    if not mesh.is_winding_consistent:
        problem = "has triangles whose normals point inwards and others whose normals point outwards"
        hint = "orient all triangles alike in a CAD program or with trimesh.repair.fix_winding"
        refuse(field, str(name), problem, hint)
    if mesh.volume < 0:
        mesh.invert()
    if mesh.volume <= 0:
        refuse(field, str(name), "encloses no volume", "give a closed mesh")
    return mesh


def signed_distance(mesh: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    """Return the distance of points (n, 3) from a closed mesh [m], negative inside, in single precision."""
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
    """Size of a pipe's bore, calculated from distances between the pipe's axis and its wall."""

    smallest: float
    """Smallest distance between a pipe's axis and its wall [m]."""
    largest: float
    """Largest distance between a pipe's axis and its wall [m]."""
    area: float
    """Mean cross-sectional area of a pipe's bore [m2]."""

    @classmethod
    def of(cls, reach: np.ndarray) -> Bore:
        """Return the size of a bore, calculated from the distances `reach` [m] between its axis and its wall.

        Each distance must be the length of a ray that has met the wall; the value -1 for a ray without wall is not
        allowed.
        """
        return cls(float(reach.min()), float(reach.max()), float(np.pi * np.mean(reach**2)))

    def is_round(self, radius: float) -> bool:
        """Return whether the wall deviates from a cylinder of `radius` [m] by at most `ROUNDNESS_TOLERANCE`."""
        return (
            self.smallest >= (1 - ROUNDNESS_TOLERANCE) * radius and self.largest <= (1 + ROUNDNESS_TOLERANCE) * radius
        )


def _stations(radius: float, end: float, begin: float = 0.0) -> np.ndarray:
    """Return the arc lengths [m] between `begin` and `end` at which a pipe of `radius` [m] is measured.

    The first and the last arc length have a small distance from the ends of the pipe, which may be closed by lids.
    """
    inset = min(0.02 * radius, 0.25 * (end - begin))
    return np.linspace(begin + inset, end - inset, max(8, int((end - begin) / radius)))


def bore_probes(mesh: Any, axis: Axis, radius: float, end: float, around: int = 12, begin: float = 0.0) -> np.ndarray:
    """Return distances [m] from a pipe's axis to a mesh, along rays perpendicular to the axis.

    The rays start at places between the arc lengths `begin` and `end`. The distance is -1 where a ray meets no wall.
    `mesh` is any object with `vertices` (v, 3) and `faces` (f, 3), and `radius` is the expected radius [m]. The result
    has one row for each place along the axis and one column for each of the `around` directions.
    """
    points, _, normal, side = axis.frame(_stations(radius, end, begin))
    return SurfaceQueries(mesh.vertices, mesh.faces).around(points, normal, side, around, FARTHEST_WALL * radius)


def enclosed(wall: PipeWall | MeshWall, axis: Axis, points: np.ndarray) -> np.ndarray:
    """Return whether each of `points` (n, 3) [m] lies inside a pipe, as booleans of shape (n,).

    A point lies inside if no wall lies between the point and the pipe's axis.
    """
    nearest = axis.nearest(points)
    apart = np.linalg.norm(points - nearest, axis=1)
    if isinstance(wall, PipeWall):
        return apart <= wall.radius
    outward = (points - nearest) / np.maximum(apart, 1e-12)[:, None]
    hits = rays(wall, nearest, outward, float(apart.max(initial=1e-12)) * 1.001)
    return (hits < 0) | (hits >= apart)


def faces_at(mesh: Any, points: np.ndarray, reach: float) -> np.ndarray:
    """Return the index of the mesh's triangle nearest to each of `points` (n, 3) [m], in single precision.

    `mesh` is any object with `vertices` (v, 3) and `faces` (f, 3). The index is -1 where no triangle lies within
    `reach` [m].
    """
    surface = _warp_mesh(mesh, "cpu")
    face = wp.zeros(len(points), dtype=wp.int32, device="cpu")
    queries = wp.array(np.ascontiguousarray(points, np.float32), dtype=wp.vec3, device="cpu")
    launch(nearest_faces, len(points), wp.get_device("cpu"), mesh=surface.id, points=queries, reach=reach, face=face)
    return face.numpy().astype(int)


def rays(mesh: Any, origins: np.ndarray, directions: np.ndarray, reach: float) -> np.ndarray:
    """Return the distances [m] at which rays meet the mesh, shape (n,); -1 if there is no hit within `reach` [m].

    The rays start at `origins` (n, 3) [m] along the unit vectors `directions` (n, 3). `mesh` is any object with
    `vertices` (v, 3) and `faces` (f, 3).
    """
    return SurfaceQueries(mesh.vertices, mesh.faces).rays(origins, directions, reach)


def fan(normal: np.ndarray, side: np.ndarray, count: int, turned: float = FAN_ROTATION) -> np.ndarray:
    """Return `count` unit vectors at equal angles in each of n planes, shape (n, count, 3).

    The unit vectors `normal` and `side`, shape (n, 3) each, span the planes. All vectors are rotated by `turned` times
    the angle between two adjacent vectors.
    """
    angle = 2 * np.pi * (np.arange(count) + turned) / count
    return np.cos(angle)[None, :, None] * normal[:, None] + np.sin(angle)[None, :, None] * side[:, None]


class SurfaceQueries:
    """Ray and distance queries to a triangle mesh, in single precision on the CPU."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        quiet_init()
        points = wp.array(np.ascontiguousarray(vertices, np.float32), dtype=wp.vec3, device="cpu")
        corners = wp.array(np.ascontiguousarray(faces, np.int32).ravel(), dtype=wp.int32, device="cpu")
        self._mesh = wp.Mesh(points=points, indices=corners)
        self._extent = float(np.abs(vertices).max(initial=0.0))

    def rays(self, origins: np.ndarray, directions: np.ndarray, reach: float) -> np.ndarray:
        """Return the distances [m] at which rays meet the mesh, shape (n,); -1 if there is no hit within `reach` [m].

        The rays start at `origins` (n, 3) [m] along the unit vectors `directions` (n, 3).
        """
        along = wp.array(np.ascontiguousarray(directions, np.float32), dtype=wp.vec3, device="cpu")
        return self._query(ray_distances, origins=_points(origins), directions=along, reach=reach)

    def around(self, points: np.ndarray, normal: np.ndarray, side: np.ndarray, count: int, reach: float) -> np.ndarray:
        """Return distances [m] from `points` to the wall in `count` directions at equal angles, shape (n, count).

        The directions lie in planes spanned by the unit vectors `normal` and `side`, shape (n, 3) each. The distance is
        -1 where there is no wall within `reach` [m].
        """
        distances = self._fan(points, normal, side, count, reach, FAN_ROTATION)
        if np.any(distances < 0):
            # A ray along the edge between two facets may miss both, so repeat the search with slightly rotated rays.
            distances = np.where(
                distances < 0, self._fan(points, normal, side, count, reach, FAN_ROTATION + RETRY_ROTATION), distances
            )
        return distances

    def _fan(
        self, points: np.ndarray, normal: np.ndarray, side: np.ndarray, count: int, reach: float, turned: float
    ) -> np.ndarray:
        ways = fan(normal, side, count, turned)
        starts = np.broadcast_to(points[:, None], ways.shape)
        return self.rays(starts.reshape(-1, 3), ways.reshape(-1, 3), reach).reshape(len(points), count)

    def distances(self, points: np.ndarray) -> np.ndarray:
        """Return the distance [m] of each of `points` (n, 3) from the mesh, shape (n,)."""
        reach = 4 * (self._extent + float(np.abs(points).max(initial=0.0)))
        return self._query(distances, points=_points(points), reach=reach)

    def _query(self, kernel: wp.Kernel, **arguments: object) -> np.ndarray:
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
