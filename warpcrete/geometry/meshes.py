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
from ..kernels.common.mesh_queries import nearest_faces, ray_distances, signed_distances
from .axis import Axis
from .walls import MeshWall, PipeWall

if TYPE_CHECKING:  # half a second to import, and most scenes have no mesh
    import trimesh

ROUND = 0.01
"""Part of a pipe's radius by which its wall may differ from the cylinder and still count as one."""
MOST_FACES = 500_000
"""Triangles of a mesh; reading so many takes ten seconds."""
FARTHEST = 1e4
"""Distance of a corner from the origin [m]."""
WIDEST_ERROR = 0.1
"""Part by which it may differ at all."""


def load(source: Any, field: str, scale: float = 1.0) -> trimesh.Trimesh:
    """Mesh from a ``trimesh.Trimesh`` or any file that trimesh reads, with coincident corners merged.

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
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    mesh.update_faces(mesh.nondegenerate_faces())
    mesh.remove_unreferenced_vertices()
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


def border_loops(edges: np.ndarray) -> list[np.ndarray]:
    """Corners of each connected set of `edges` (n, 2)."""
    corners, local = np.unique(edges, return_inverse=True)
    local = local.reshape(-1, 2)
    label = np.arange(len(corners))
    while True:
        lowest = label.copy()
        np.minimum.at(lowest, local[:, 0], label[local[:, 1]])
        np.minimum.at(lowest, local[:, 1], label[local[:, 0]])
        lowest = lowest[lowest]
        if np.array_equal(lowest, label):
            return [corners[label == k] for k in np.unique(label)]
        label = lowest


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


def check_pipe(mesh: trimesh.Trimesh, field: str, name: str, axis: Axis, radius: float, length: float) -> Bore:
    """Measure the bore around the first `length` [m] of `axis`; refuse a mesh that is no pipe of about `radius` [m].

    It must be closed (a pipe with wall thickness, say), or open at nothing but the two ends of the tube, and
    its bore must be free and nowhere a tenth wider or narrower than wanted.
    """
    extents = " x ".join(f"{e:.4g}" for e in mesh.extents)
    where = f"(the mesh spans {extents} m)"
    border = border_edges(mesh)
    if len(border):
        ends = border_loops(border)
        if len(ends) != 2:
            refuse(
                field,
                name,
                f"is open: {len(border)} border edges in {len(ends)} rims, where a tube has two",
                "close its holes (trimesh.repair.fill_holes, or in the CAD program)",
            )
        for loop in ends:
            # An end of the tube winds once round the axis.
            centre = mesh.vertices[loop].mean(0)
            nearest, _ = axis.at(np.linspace(-2 * radius, axis.length * 3 + 2 * radius, 2000))
            beside = float(np.linalg.norm(nearest - centre, axis=1).min())
            if beside > WIDEST_ERROR * radius:
                place = ", ".join(f"{x:.4g}" for x in centre)
                refuse(
                    field,
                    name,
                    f"does not follow the pipe's axis: its open end round ({place}) m is {beside:.3g} m beside it",
                    f"the axis starts at {axis.start} m along {axis.tangent}; check the unit, or wall_scale",
                )
    reach = bore_probes(mesh, axis, radius, length)
    if np.any(reach < 0) or np.any(np.abs(reach / radius - 1) > WIDEST_ERROR):
        bare = int(np.count_nonzero(reach < 0))
        off = reach[reach >= 0]
        found = f"{2e3 * off.min():.4g} to {2e3 * off.max():.4g} mm across" if len(off) else "nothing"
        refuse(
            field,
            name,
            f"does not enclose a bore of {2e3 * radius:g} mm along the pipe's axis: "
            f"{bare} of {reach.size} probes find no wall, the others {found} {where}",
            "check its place, its length and its unit (wall_scale=0.001 for millimetres)",
        )
    stations = _stations(radius, length)
    points, tangents = axis.at(stations)
    step = np.linalg.norm(np.diff(points, axis=0), axis=1)
    ahead = rays(mesh, points[:-1], tangents[:-1], float(step.max()))
    if np.any((ahead >= 0) & (ahead < 0.5 * step.min()) & (stations[:-1] < length - radius)):
        refuse(field, name, f"is blocked: a surface crosses the pipe's axis {where}", "leave the bore open")
    return Bore.of(reach)


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
    # Turned by an odd angle, so that rays do not run into the edges between the facets of a regular tube.
    angle = 2 * np.pi * (np.arange(around) + 0.382) / around
    directions = np.cos(angle)[None, :, None] * normal[:, None] + np.sin(angle)[None, :, None] * side[:, None]
    origins = np.broadcast_to(points[:, None], directions.shape)
    return rays(mesh, origins.reshape(-1, 3), directions.reshape(-1, 3), 10 * radius).reshape(-1, around)


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
    """Distances [m] along unit `directions` (n, 3) from `origins` (n, 3) to the mesh, -1 for a miss.

    `mesh` is anything with `vertices` (v, 3) and `faces` (f, 3).
    """
    surface = _warp_mesh(mesh, "cpu")
    distance = wp.zeros(len(origins), dtype=wp.float32, device="cpu")
    start = wp.array(np.ascontiguousarray(origins, np.float32), dtype=wp.vec3, device="cpu")
    along = wp.array(np.ascontiguousarray(directions, np.float32), dtype=wp.vec3, device="cpu")
    named = {"mesh": surface.id, "origins": start, "directions": along, "reach": reach, "distance": distance}
    launch(ray_distances, len(origins), wp.get_device("cpu"), **named)
    return distance.numpy().astype(float)


def _warp_mesh(mesh: Any, device: str, winding: bool = False) -> wp.Mesh:
    quiet_init()
    return wp.Mesh(
        points=wp.array(mesh.vertices.astype(np.float32), dtype=wp.vec3, device=device),
        indices=wp.array(mesh.faces.astype(np.int32).ravel(), dtype=wp.int32, device=device),
        support_winding_number=winding,
    )
