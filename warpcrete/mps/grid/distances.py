"""Signed distances of points from walls: planes, pipes, meshes, and polygons that are extended into bodies."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ...geometry.meshes import load_closed, signed_distance
from ...geometry.walls import MeshWall, PipeWall, PlaneWall

Distance = Callable[[np.ndarray], np.ndarray]
"""Function of points, shape (n, axes), that gives the signed distance from a wall [m]; positive outside the wall."""


@dataclass(frozen=True)
class CylindricalDistance:
    """Distance function of a general cylinder or a plane: the distance depends on the coordinates along some axes only.

    `distance` is the distance function, and `axes` are the numbers of these axes.
    """

    distance: Distance
    axes: tuple[int, ...]

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Return the signed distance of points, shape (n, axes), from the wall [m], shape (n,)."""
        return self.distance(points)


def distances_from(distance: Distance, points: np.ndarray) -> np.ndarray:
    """Return the distances of points from a wall [m], with the shape of `points` without its last axis.

    `points` has the shape (..., axes). If it holds the points of a grid, and the wall looks the same everywhere along
    an axis, the distance is computed for a single coordinate along this axis. The result then has the length 1 along
    this axis.
    """
    axes = points.shape[-1]
    if isinstance(distance, CylindricalDistance) and points.ndim == axes + 1:
        along = {axis % axes for axis in distance.axes}
        points = points[tuple(slice(None) if axis in along else slice(0, 1) for axis in range(axes))]
    return distance(points.reshape(-1, axes)).reshape(points.shape[:-1])


def wall_distance(wall: PlaneWall | PipeWall | MeshWall, within: np.ndarray) -> Distance:
    """Return the distance function of a three-dimensional wall.

    A mesh must be closed; concrete is on the side of the mesh where the point `within` lies [m], shape (3,).
    """
    if isinstance(wall, PlaneWall):
        point, normal = np.array(wall.point), np.array(wall.normal)
        return lambda x: (x - point) @ normal
    if isinstance(wall, PipeWall):
        return lambda x: wall.radius - np.linalg.norm(x - wall.axis.nearest(x), axis=1)
    import trimesh

    mesh = load_closed(trimesh.Trimesh(wall.vertices, wall.faces, process=False), f"{wall.name}.vertices")
    sign = 1.0 if signed_distance(mesh, within[None])[0] > 0 else -1.0
    return lambda x: sign * signed_distance(mesh, x)


def polygon_distance(corners: Sequence[tuple[float, float]], axes: tuple[int, int] = (0, -1)) -> Distance:
    """Return a function that gives the signed distance of points from a polygonal wall [m], negative inside the wall.

    The corners have two coordinates, along the two `axes`. The wall extends without end along any other axis.
    """
    a = np.array(corners, float)
    b = np.roll(a, -1, 0)

    def distance(points: np.ndarray) -> np.ndarray:
        x = points[:, list(axes)]
        nearest, inside = np.full(len(x), np.inf), np.zeros(len(x), bool)
        for one, two in zip(a, b, strict=True):
            along = two - one
            part = np.clip((x - one) @ along / max(float(along @ along), 1e-300), 0.0, 1.0)
            nearest = np.minimum(nearest, np.linalg.norm(x - one - part[:, None] * along, axis=1))
            # A point lies inside the polygon if a horizontal ray from the point to the right crosses an odd number of
            # the polygon's sides. The height of the ray must lie between the heights of the two ends of such a side.
            crosses = (one[1] > x[:, 1]) != (two[1] > x[:, 1])
            rise = along[1] if along[1] else 1.0
            inside ^= crosses & (x[:, 0] < one[0] + (x[:, 1] - one[1]) * along[0] / rise)
        return np.where(inside, -nearest, nearest)

    return CylindricalDistance(distance, axes)
