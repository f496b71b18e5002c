"""Closed solids that vessels are made of: truncated cones, and prisms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:  # half a second to import
    import trimesh

SIDES = 48
"""Of round solids."""


@dataclass(frozen=True)
class Solid:
    """A closed mesh between two rings of as many corners; faces turn outward."""

    vertices: np.ndarray
    """[m], shape (v, 3)."""
    sides: np.ndarray
    """Two faces for each pair of neighbouring corners of a ring, in turn, shape (2 n, 3)."""
    ends: np.ndarray
    """Faces of the two ends, shape (2 n, 3)."""

    @property
    def faces(self) -> np.ndarray:
        """All of them, shape (4 n, 3)."""
        return np.concatenate([self.sides, self.ends])

    def without(self, *edges: int) -> np.ndarray:
        """All faces but those of the sides at these edges of the rings, counted from the one that begins at corner 0;
        shape (4 n - 2 edges, 3)."""
        left = np.delete(self.sides.reshape(-1, 2, 3), list(edges), axis=0).reshape(-1, 3)
        return np.concatenate([left, self.ends])

    def trimesh(self) -> trimesh.Trimesh:
        """As a mesh of trimesh."""
        import trimesh

        return trimesh.Trimesh(self.vertices, self.faces, process=False)


def truncated_cone(base: float, top: float, height: float, sides: int = SIDES) -> Solid:
    """Upright about z, from z = 0 on: radii [m] at its foot and at its `height` [m].

    Its corners lie outside the cone such that the volume is the cone's.
    """
    angle = 2 * np.pi * np.arange(sides) / sides
    # The area of a polygon whose corners are r away is sides r^2 sin(2 pi / sides) / 2.
    wider = np.sqrt(2 * np.pi / (sides * np.sin(2 * np.pi / sides)))
    ring = wider * np.stack([np.cos(angle), np.sin(angle), np.zeros(sides)], 1)
    return _between(base * ring, top * ring + [0, 0, height], np.array([[0, 0, 0], [0, 0, height]]))


def prism(corners: Sequence[tuple[float, float]], breadth: float, middle: tuple[float, float]) -> Solid:
    """Of a section in x and z [m], every point of which is seen from `middle`, from y = -breadth/2 to breadth/2."""
    ends = [np.insert(np.array(corners, dtype=float), 1, y, axis=1) for y in (-breadth / 2, breadth / 2)]
    return _between(*ends, np.array([[middle[0], y, middle[1]] for y in (-breadth / 2, breadth / 2)]))


def rectangle(corner: Sequence[float], one: Sequence[float], other: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (4, 3) [m] and faces (2, 3) of a parallelogram at a corner, between two edges from there."""
    start, a, b = (np.array(v, dtype=float) for v in (corner, one, other))
    return np.array([start, start + a, start + a + b, start + b]), np.array([[0, 1, 2], [0, 2, 3]])


def _between(first: np.ndarray, last: np.ndarray, middles: np.ndarray) -> Solid:
    """Two rings that run the same way round, each closed by a fan about its middle."""
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
