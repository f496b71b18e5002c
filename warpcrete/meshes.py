"""Triangle meshes from files: reading, closedness, distances, and the fit of a pipe to its axis."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
import warp as wp

from .axis import Axis
from .errors import refuse
from .kernels.shapes import ray_distances, signed_distances
from .model import quiet_init


def load(source, field: str, scale: float = 1.0) -> trimesh.Trimesh:
    """Mesh from a ``trimesh.Trimesh`` or any file that trimesh reads, with coincident corners merged.

    Raises :class:`SceneError` naming `field` if it cannot be read or holds no usable triangles.
    """
    if isinstance(source, trimesh.Trimesh):
        mesh = source.copy()
    elif not isinstance(source, str | Path):
        refuse(field, type(source).__name__, "must be a trimesh.Trimesh or the path of a mesh file")
    else:
        path = Path(source)
        if not path.is_file():
            refuse(field, str(source), "is no file", "give the path of an STL, OBJ, PLY ... file")
        try:
            mesh = trimesh.load_mesh(path)
            if isinstance(mesh, trimesh.Scene):
                mesh = mesh.to_mesh()
        except Exception as error:  # trimesh raises whatever its readers raise
            refuse(field, str(source), f"cannot be read as a triangle mesh ({type(error).__name__}: {error})")
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0 or not np.all(np.isfinite(mesh.vertices)):
        refuse(field, str(source), "holds no triangles, or corners that are not finite")
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    mesh.update_faces(mesh.nondegenerate_faces())
    mesh.remove_unreferenced_vertices()
    if len(mesh.faces) == 0:
        refuse(field, str(source), "holds only triangles without area")
    mesh.apply_scale(scale)
    return mesh


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
    wp.launch(signed_distances, dim=len(points), inputs=[surface.id, queries, reach, distance], device=device)
    return distance.numpy().astype(float)


def check_pipe(mesh: trimesh.Trimesh, field: str, name: str, axis: Axis, radius: float, length: float) -> None:
    """Refuse a mesh that is not a pipe of inner `radius` [m] around the first `length` [m] of `axis`.

    It must be closed (a pipe with wall thickness, say), or open at nothing but the two ends of the tube, and
    its bore must be round to 10 % and free.
    """
    border = border_edges(mesh)
    if len(border):
        ends = border_loops(border)
        loops = len(ends)
        if loops == 2:
            # An end of the tube winds once round the axis.
            for loop in ends:
                centre = mesh.vertices[loop].mean(0)
                nearest, _ = axis.at(np.linspace(-2 * radius, axis.length * 3 + 2 * radius, 2000))
                if np.linalg.norm(nearest - centre, axis=1).min() > 0.1 * radius:
                    loops = -1
        if loops != 2:
            refuse(
                field,
                name,
                f"is open: {len(border)} border edges beyond the two ends of a tube",
                "close its holes (trimesh.repair.fill_holes, or in the CAD program)",
            )
    # The ends themselves may be capped; look inside them.
    stations = np.linspace(0.02 * radius, length - 0.02 * radius, max(8, int(length / radius)))
    points, tangents, normal, side = axis.frame(stations)
    angle = 2 * np.pi * (np.arange(12) + 0.5) / 12
    directions = np.cos(angle)[None, :, None] * normal[:, None] + np.sin(angle)[None, :, None] * side[:, None]
    origins = np.broadcast_to(points[:, None], directions.shape)
    reach = rays(mesh, origins.reshape(-1, 3), directions.reshape(-1, 3), 10 * radius)
    extents = " x ".join(f"{e:.4g}" for e in mesh.extents)
    where = f"(the mesh spans {extents} m)"
    if np.any(reach < 0) or np.any(np.abs(reach / radius - 1) > 0.1):
        bare = int(np.count_nonzero(reach < 0))
        off = reach[reach >= 0]
        found = f"{2e3 * off.min():.4g} to {2e3 * off.max():.4g} mm across" if len(off) else "nothing"
        refuse(
            field,
            name,
            f"does not enclose a bore of {2e3 * radius:g} mm along the pipe's axis: "
            f"{bare} of {len(reach)} probes find no wall, the others {found} {where}",
            "check its place, its length and its unit (wall_scale=0.001 for millimetres)",
        )
    step = np.linalg.norm(np.diff(points, axis=0), axis=1)
    ahead = rays(mesh, points[:-1], tangents[:-1], float(step.max()))
    if np.any((ahead >= 0) & (ahead < 0.5 * step.min()) & (stations[:-1] < length - radius)):
        refuse(field, name, f"is blocked: a surface crosses the pipe's axis {where}", "leave the bore open")


def rays(mesh: trimesh.Trimesh, origins: np.ndarray, directions: np.ndarray, reach: float) -> np.ndarray:
    """Distances [m] along unit `directions` (n, 3) from `origins` (n, 3) to the mesh, -1 for a miss."""
    surface = _warp_mesh(mesh, "cpu")
    distance = wp.zeros(len(origins), dtype=wp.float32, device="cpu")
    start = wp.array(np.ascontiguousarray(origins, np.float32), dtype=wp.vec3, device="cpu")
    along = wp.array(np.ascontiguousarray(directions, np.float32), dtype=wp.vec3, device="cpu")
    wp.launch(ray_distances, dim=len(origins), inputs=[surface.id, start, along, reach, distance], device="cpu")
    return distance.numpy().astype(float)


def _warp_mesh(mesh: trimesh.Trimesh, device: str, winding: bool = False) -> wp.Mesh:
    quiet_init()
    return wp.Mesh(
        points=wp.array(mesh.vertices.astype(np.float32), dtype=wp.vec3, device=device),
        indices=wp.array(mesh.faces.astype(np.int32).ravel(), dtype=wp.int32, device=device),
        support_winding_number=winding,
    )
