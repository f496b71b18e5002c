"""Closed solids from which vessels are built: truncated cones and prisms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:  # Do not import trimesh at run time, because the import takes half a second.
    import trimesh

SIDES = 48
"""Default number of sides of the regular polygon that approximates the circular cross-section of a truncated cone."""


@dataclass(frozen=True)
class Solid:
    """Closed mesh between two rings with n corners each; the normals of its faces point outward."""

    vertices: np.ndarray
    """Corners of the mesh [m], shape (v, 3)."""
    sides: np.ndarray
    """Triangles between the two rings of corners, two for each edge of a ring, shape (2 n, 3)."""
    ends: np.ndarray
    """Triangles that close the two ends of the solid, n at each end, shape (2 n, 3)."""

    @property
    def faces(self) -> np.ndarray:
        """All triangles of the solid: 2 n between its two rings of n corners and n at each end, shape (4 n, 3)."""
        return np.concatenate([self.sides, self.ends])

    def without(self, *edges: int) -> np.ndarray:
        """Return the triangles of the solid without some of its n lateral faces, shape (4 n - 2 len(edges), 3).

        A lateral face joins an edge of the first ring of corners to the same edge of the second ring, and consists of
        two triangles. `edges` holds the indices of the edges whose lateral faces are left out. Edge k of a ring leads
        from corner k to the next corner. The triangles at the two ends of the solid are always included.
        """
        left = np.delete(self.sides.reshape(-1, 2, 3), list(edges), axis=0).reshape(-1, 3)
        return np.concatenate([left, self.ends])

    def trimesh(self) -> trimesh.Trimesh:
        """Return the solid as a ``trimesh.Trimesh``."""
        import trimesh

        return trimesh.Trimesh(self.vertices, self.faces, process=False)


def truncated_cone(base: float, top: float, height: float, sides: int = SIDES) -> Solid:
    """Return an upright truncated cone of `height` [m] about the z axis with its base at z = 0.

    `base` and `top` are the radii of its ends [m]. The mesh has `sides` flat sides. Its corners lie slightly outside
    the cone, so that the mesh has the volume of the exact cone.
    """
    angle = 2 * np.pi * np.arange(sides) / sides
    # A regular polygon with n sides, whose corners have the distance r from its centre, has the area n r^2 sin(2 pi /
    # n) / 2. Scale the radius so that the polygon has the area of the circle.
    wider = np.sqrt(2 * np.pi / (sides * np.sin(2 * np.pi / sides)))
    ring = wider * np.stack([np.cos(angle), np.sin(angle), np.zeros(sides)], 1)
    return _between(base * ring, top * ring + [0, 0, height], np.array([[0, 0, 0], [0, 0, height]]))


def prism(corners: Sequence[tuple[float, float]], breadth: float, middle: tuple[float, float]) -> Solid:
    """Return a prism whose cross-section in x and z has the `corners` [m]; it reaches from y = -breadth/2 to breadth/2.

    The two ends are divided into triangles that meet at the point `middle` of the cross-section. Every point of the
    cross-section must therefore be visible from this point.
    """
    ends = [np.insert(np.array(corners, dtype=float), 1, y, axis=1) for y in (-breadth / 2, breadth / 2)]
    return _between(*ends, np.array([[middle[0], y, middle[1]] for y in (-breadth / 2, breadth / 2)]))


def rectangle(corner: Sequence[float], one: Sequence[float], other: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Return a parallelogram, given by a corner and the vectors `one` and `other` along two edges [m].

    The result holds vertices [m], shape (4, 3), and faces, shape (2, 3).
    """
    start, a, b = (np.array(v, dtype=float) for v in (corner, one, other))
    return np.array([start, start + a, start + a + b, start + b]), np.array([[0, 1, 2], [0, 2, 3]])


def _between(first: np.ndarray, last: np.ndarray, middles: np.ndarray) -> Solid:
    """Return the solid between two rings `first` and `last` of n corners each [m], shape (n, 3).

    Both rings are listed in the same direction of rotation. Each end of the solid is closed by n triangles that meet at
    a point; `middles` holds this point for both ends.
    """
    n = len(first)
    vertices = np.concatenate([first, last, middles])
    k = np.arange(n)
    after = (k + 1) % n
    sides = np.stack([np.stack([k, after, n + after], 1), np.stack([k, n + after, n + k], 1)], 1).reshape(-1, 3)
    ends = np.concatenate([np.stack([0 * k + 2 * n, after, k], 1), np.stack([0 * k + 2 * n + 1, n + k, n + after], 1)])
    corner = vertices[np.concatenate([sides, ends])]
    if np.einsum("fi,fi->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) < 0:
        sides, ends = sides[:, ::-1], ends[:, ::-1]
    return Solid(vertices, sides, ends)
