"""How high, wide and far a heap of spheres is: what tests of fresh concrete read off, robustly.

A heap of stones has no smooth surface, and loose ones roll away from it. So height is read off a map of the surface as
a scanner sees it from above: a grid of vertical rays, each with the highest point of a sphere that it meets, and of it
means or medians over areas of several stones. Width is that of the main body, what is left when stones are dropped that
lie apart from it by an empty cell as wide as the largest of them: one runaway stone would else decide. The same ways
read the first state and the last: what the roughness of the surface does to a height falls out of a difference.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

FINE = 0.25
"""Side of a cell of the map over the largest radius."""
DIRECTIONS = 36
"""Into which the reach of a heap is measured; means over fewer depend on where stones lie."""


@dataclass(frozen=True)
class Map:
    """The surface of spheres as seen from above."""

    corner: np.ndarray
    """Lowest x and y of the grid [m], shape (2,)."""
    cell: float
    """Side of its cells [m]."""
    height: np.ndarray
    """Of the highest sphere over the middle of each cell [m], -inf where there is none, shape (nx, ny)."""

    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """x and y of the cells' middles [m], shapes (nx, 1) and (1, ny)."""
        nx, ny = self.height.shape
        return (
            (self.corner[0] + (np.arange(nx) + 0.5) * self.cell)[:, None],
            (self.corner[1] + (np.arange(ny) + 0.5) * self.cell)[None],
        )

    def covered(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Whether a sphere is below or above each place [m]; False outside the grid."""
        i = np.floor((x - self.corner[0]) / self.cell).astype(int)
        j = np.floor((y - self.corner[1]) / self.cell).astype(int)
        nx, ny = self.height.shape
        inside = (i >= 0) & (j >= 0) & (i < nx) & (j < ny)
        found = np.zeros(np.broadcast(x, y).shape, bool)
        found[inside] = np.isfinite(self.height[i[inside], j[inside]])
        return found


def surface_map(spheres: np.ndarray, cell: float | None = None) -> Map:
    """Map of spheres, rows of centre and radius [m], shape (n, 4), n > 0; `cell` [m] by default FINE."""
    largest = float(spheres[:, 3].max())
    cell = cell or FINE * largest
    corner = (spheres[:, :2] - spheres[:, 3:]).min(0) - cell
    top = (spheres[:, :2] + spheres[:, 3:]).max(0) + cell
    nx, ny = (np.ceil((top - corner) / cell).astype(int) + 1).tolist()
    reach = int(np.ceil(largest / cell)) + 1
    steps = np.arange(-reach, reach + 1)
    middle = np.floor((spheres[:, :2] - corner) / cell).astype(int)
    i = middle[:, :1, None] + steps[None, :, None]
    j = middle[:, 1:, None] + steps[None, None, :]
    x = corner[0] + (i + 0.5) * cell - spheres[:, 0, None, None]
    y = corner[1] + (j + 0.5) * cell - spheres[:, 1, None, None]
    square = spheres[:, 3, None, None] ** 2 - x**2 - y**2
    # Cells beyond the border, which no sphere reaches, drop out with the others that a sphere does not cover.
    hit = square > 0
    row, column = np.broadcast_arrays(i, j)
    height = np.full(nx * ny, -np.inf)
    tops = (spheres[:, 2, None, None] + np.sqrt(np.maximum(square, 0)))[hit]
    np.maximum.at(height, row[hit] * ny + column[hit], tops)
    return Map(corner, cell, height.reshape(nx, ny))


def main_body(spheres: np.ndarray) -> np.ndarray:
    """Which spheres belong to the main body, shape (n,): cells as wide as the largest sphere that touch by a side or a
    corner, in plan, from the one with most spheres on."""
    side = 2 * float(spheres[:, 3].max())
    place = np.floor((spheres[:, :2] - spheres[:, :2].min(0)) / side).astype(int) + 1
    # A stone that rolled far away alone needs no grid up to where it lies.
    place = np.minimum(place, 1 + 4 * len(spheres))
    corners, cell, count = np.unique(place, axis=0, return_inverse=True, return_counts=True)
    cell = cell.reshape(-1)
    number = {(int(a), int(b)): n for n, (a, b) in enumerate(corners)}
    first = int(np.argmax(count))
    found, waiting = {first}, [first]
    while waiting:
        a, b = (int(c) for c in corners[waiting.pop()])
        for key in ((a + i, b + j) for i in (-1, 0, 1) for j in (-1, 0, 1)):
            beside = number.get(key)
            if beside is not None and beside not in found:
                found.add(beside)
                waiting.append(beside)
    return np.isin(cell, np.fromiter(found, int))


def spread(surface: Map) -> float:
    """Mean diameter of a heap about x = y = 0 [m]: mean of any two that are perpendicular, over all directions.

    In each direction the heap reaches to the last covered place.
    """
    nx, ny = surface.height.shape
    far = max(np.abs(surface.corner).max(), np.abs(surface.corner + surface.cell * np.array([nx, ny])).max())
    along = np.arange(0.0, 1.5 * far, 0.5 * surface.cell)
    angle = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    there = surface.covered(along * np.cos(angle)[:, None], along * np.sin(angle)[:, None])
    return 2 * float(np.mean(np.max(np.where(there, along, 0.0), axis=1)))


def height_at(surface: Map, x: tuple[float, float], y: tuple[float, float]) -> float:
    """Mean height of the surface over a rectangle [m]; what no sphere covers counts as 0."""
    across, along = surface.places()
    there = (across >= x[0]) & (across <= x[1]) & (along >= y[0]) & (along <= y[1])
    if not there.any():
        return 0.0
    return float(np.mean(np.maximum(surface.height[there], 0.0)))


def height_of_top(surface: Map, radius: float) -> float:
    """Mean height of the surface within a radius of x = y = 0 [m]; what no sphere covers counts as 0."""
    x, y = surface.places()
    there = x**2 + y**2 <= radius**2
    return float(np.mean(np.maximum(surface.height[there], 0.0))) if there.any() else 0.0


def shadow(spheres: np.ndarray, x: float, y: float, cell: float) -> float:
    """Part of the rectangle |x| < x, |y| < y [m] that spheres cover as seen from above or below."""
    if len(spheres) == 0:
        return 0.0
    across = np.arange(-x + 0.5 * cell, x, cell)[:, None]
    along = np.arange(-y + 0.5 * cell, y, cell)[None]
    return float(np.mean(surface_map(spheres, cell).covered(*np.broadcast_arrays(across, along))))
