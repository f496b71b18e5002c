"""How high, wide and far a heap of spheres is: what tests of fresh concrete read off, robustly.

A heap of stones has no smooth surface, and loose ones roll away from it. So heights are read as a scanner sees the
surface from above: on a grid of vertical rays, each with the highest point of a sphere that it meets, means over areas
of several stones. Width is that of the main body, what is left when stones are dropped that lie apart from it by an
empty cell as wide as the largest of them: one runaway stone would else decide. The same ways read the first state and
the last: what the roughness of the surface does to a height falls out of a difference.
"""

from __future__ import annotations

import numpy as np

FINE = 0.25
"""Distance of the rays over the largest radius."""
DIRECTIONS = 36
"""Into which the reach of a heap is measured; means over fewer depend on where stones lie."""

Range = tuple[float, float]


def surface(spheres: np.ndarray, x: Range, y: Range, cell: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Heights of the surface over a rectangle [m], at the middles of cells of about the side `cell`.

    `spheres` are rows of centre and radius [m], shape (n, 4). Returns the middles' x and y and the heights, shapes
    (nx, 1), (1, ny), (nx, ny); a height is -inf where there is no sphere.
    """
    low, high = np.array([x[0], y[0]]), np.array([x[1], y[1]])
    count = np.maximum(np.ceil((high - low) / cell - 1e-9).astype(int), 1)
    side = (high - low) / count
    middles = [low[k] + (np.arange(count[k]) + 0.5) * side[k] for k in (0, 1)]
    near = np.all(np.abs(spheres[:, :2] - 0.5 * (low + high)) < 0.5 * (high - low) + spheres[:, 3:], axis=1)
    spheres = spheres[near]
    height = np.full(count[0] * count[1], -np.inf)
    if len(spheres):
        place = np.floor((spheres[:, :2] - low) / side).astype(int)
        around = [np.arange(-n, n + 1) for n in (np.ceil(spheres[:, 3].max() / side).astype(int)).tolist()]
        i = place[:, :1, None] + around[0][None, :, None]
        j = place[:, 1:, None] + around[1][None, None, :]
        across = low[0] + (i + 0.5) * side[0] - spheres[:, 0, None, None]
        along = low[1] + (j + 0.5) * side[1] - spheres[:, 1, None, None]
        square = spheres[:, 3, None, None] ** 2 - across**2 - along**2
        hit = (square > 0) & (i >= 0) & (i < count[0]) & (j >= 0) & (j < count[1])
        row, column = np.broadcast_arrays(i, j)
        tops = (spheres[:, 2, None, None] + np.sqrt(np.maximum(square, 0)))[hit]
        np.maximum.at(height, row[hit] * count[1] + column[hit], tops)
    return middles[0][:, None], middles[1][None], height.reshape(*count.tolist())


def main_body(spheres: np.ndarray) -> np.ndarray:
    """Which spheres belong to the main body, shape (n,): cells as wide as the largest sphere that touch by a side or a
    corner, in plan, from the one with most spheres on."""
    side = 2 * float(spheres[:, 3].max())
    place = np.floor((spheres[:, :2] - spheres[:, :2].min(0)) / side).astype(int) + 1
    # A stone that rolled far away alone needs no grid up to where it lies.
    place = np.minimum(place, 1 + 4 * len(spheres))
    row = int(place[:, 1].max()) + 1
    keys, cell, count = np.unique(place[:, 0] * row + place[:, 1], return_inverse=True, return_counts=True)
    corners = np.stack(np.divmod(keys, row), 1).tolist()
    number = {(a, b): n for n, (a, b) in enumerate(corners)}
    first = int(np.argmax(count))
    found, waiting = {first}, [first]
    while waiting:
        a, b = corners[waiting.pop()]
        for key in ((a + i, b + j) for i in (-1, 0, 1) for j in (-1, 0, 1)):
            beside = number.get(key)
            if beside is not None and beside not in found:
                found.add(beside)
                waiting.append(beside)
    return np.isin(cell, np.fromiter(found, int))


def spread(spheres: np.ndarray) -> float:
    """Mean diameter of a heap about x = y = 0 [m]: mean of any two that are perpendicular, over all directions.

    In each direction the heap reaches to the last place from which a sphere is met, above or below. `spheres` have the
    shape (n, 4), n > 0.
    """
    far = np.hypot(spheres[:, 0], spheres[:, 1]) + spheres[:, 3]
    # What the outermost reach in every direction decides which of the others can reach further in any.
    least = float(_reaches(spheres[far >= 0.8 * far.max()]).min())
    return 2 * float(np.mean(_reaches(spheres[far >= least])))


def _reaches(spheres: np.ndarray) -> np.ndarray:
    """From x = y = 0 [m], in each direction."""
    angle = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    out = np.stack([np.cos(angle), np.sin(angle)])
    along = spheres[:, :2] @ out
    beside = spheres[:, :2] @ np.stack([-out[1], out[0]])
    square = spheres[:, 3:] ** 2 - beside**2
    reach = np.where(square > 0, along + np.sqrt(np.maximum(square, 0)), 0.0)
    return np.max(reach, axis=0, initial=0.0)


def height_at(spheres: np.ndarray, x: Range, y: Range) -> float:
    """Mean height of the surface over a rectangle [m]; what no sphere covers counts as 0."""
    _, _, height = surface(spheres, x, y, FINE * float(spheres[:, 3].max()))
    return float(np.mean(np.maximum(height, 0.0)))


def height_of_top(spheres: np.ndarray, radius: float) -> float:
    """Mean height of the surface within a radius of x = y = 0 [m]; what no sphere covers counts as 0."""
    return height_around(spheres, 0.0, radius)


def height_around(spheres: np.ndarray, inner: float, outer: float) -> float:
    """Mean height of the surface between two radii about x = y = 0 [m]; what no sphere covers counts as 0."""
    x, y, height = surface(spheres, (-outer, outer), (-outer, outer), FINE * float(spheres[:, 3].max()))
    square = x**2 + y**2
    return float(np.mean(np.maximum(height[(square >= inner**2) & (square <= outer**2)], 0.0)))


def shadow(spheres: np.ndarray, x: float, y: float, cell: float) -> float:
    """Part of the rectangle |x| < x, |y| < y [m] that spheres cover as seen from above or below."""
    return float(np.mean(np.isfinite(surface(spheres, (-x, x), (-y, y), cell)[2])))
