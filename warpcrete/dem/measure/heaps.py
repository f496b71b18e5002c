"""Measure the height and spread of a heap of spheres robustly, as tests of fresh concrete require.

A heap of aggregates has no smooth surface, and single aggregates roll away from it. Heights are therefore measured like
a laser scan from above: each ray of a vertical grid finds the highest point of any sphere, and heights are averaged
over areas wider than several aggregates. The spread is measured on the main body only, because one stray aggregate
would otherwise determine it. An aggregate is a stray if at least one empty cell, as wide as the largest aggregate,
separates it from the main body. A slump is the difference of two heights measured in this way, so the effect of surface
roughness cancels.
"""

import numpy as np

FINE = 0.25
"""Distance between the vertical rays that scan a heap from above, divided by the largest sphere radius."""
DIRECTIONS = 36
"""Number of directions in which the spread of a heap is measured. With fewer directions, single aggregates would change
the mean."""

Range = tuple[float, float]


def surface(spheres: np.ndarray, x: Range, y: Range, cell: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the heights of the surface of spheres over a rectangle [m], at the centres of cells of about `cell` [m].

    `spheres` has rows of centre and radius [m], shape (n, 4); `x` and `y` are the ranges of the rectangle [m]. Returns
    x and y of the cell centres and the heights, with shapes (nx, 1), (1, ny) and (nx, ny). A height is -inf where a
    vertical line through the cell centre meets no sphere.
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
    """Return a mask of the spheres that belong to the main body of a heap, shape (n,); the others are strays.

    The plan view is divided into cells as wide as the largest sphere. The main body occupies the cell with the most
    spheres and all occupied cells connected to it by sides or corners.
    """
    side = 2 * float(spheres[:, 3].max())
    place = np.floor((spheres[:, :2] - spheres[:, :2].min(0)) / side).astype(int) + 1
    # Clip the cell indices, because an aggregate that rolled far away could overflow the integer that numbers a cell.
    place = np.minimum(place, 1 + 4 * len(spheres))
    row = int(place[:, 1].max()) + 1
    keys, cell, count = np.unique(place[:, 0] * row + place[:, 1], return_inverse=True, return_counts=True)
    corners = np.stack(np.divmod(keys, row), 1).tolist()
    number = {(a, b): n for n, (a, b) in enumerate(corners)}
    # A flood fill starts at the cell with the most spheres and visits all occupied cells that are connected to it.
    first = int(np.argmax(count))
    members, waiting = {first}, [first]
    while waiting:
        a, b = corners[waiting.pop()]
        for key in ((a + i, b + j) for i in (-1, 0, 1) for j in (-1, 0, 1)):
            beside = number.get(key)
            if beside is not None and beside not in members:
                members.add(beside)
                waiting.append(beside)
    return np.isin(cell, np.fromiter(members, int))


def spread(spheres: np.ndarray) -> float:
    """Return the mean diameter of a heap about x = y = 0 [m], averaged over all directions.

    The tests of fresh concrete average two perpendicular diameters. On a ray from the origin, the heap ends at the
    outermost point that a sphere covers, as seen from above. `spheres` has rows of centre and radius [m], shape (n, 4),
    n > 0.
    """
    far = np.hypot(spheres[:, 0], spheres[:, 1]) + spheres[:, 3]
    # Speed up the search by leaving out spheres that cannot change the result. The outer spheres alone give a lower
    # bound for the reach of the heap in every direction. A sphere that lies nearer to the origin than the smallest of
    # these bounds cannot extend the heap.
    least = float(_reaches(spheres[far >= 0.8 * far.max()]).min())
    return 2 * float(np.mean(_reaches(spheres[far >= least])))


def _reaches(spheres: np.ndarray) -> np.ndarray:
    """Return the distance from x = y = 0 to the edge of the heap in each direction [m], shape (DIRECTIONS,)."""
    angle = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    out = np.stack([np.cos(angle), np.sin(angle)])
    along = spheres[:, :2] @ out
    beside = spheres[:, :2] @ np.stack([-out[1], out[0]])
    square = spheres[:, 3:] ** 2 - beside**2
    reach = np.where(square > 0, along + np.sqrt(np.maximum(square, 0)), 0.0)
    return np.max(reach, axis=0, initial=0.0)


def height_at(spheres: np.ndarray, x: Range, y: Range) -> float:
    """Return the mean height of a heap's surface over a rectangle [m]; places without a sphere count as height 0."""
    _, _, height = surface(spheres, x, y, FINE * float(spheres[:, 3].max()))
    return float(np.mean(np.maximum(height, 0.0)))


def height_of_top(spheres: np.ndarray, radius: float) -> float:
    """Return a heap's mean height within `radius` of x = y = 0 [m]; places without a sphere count as height 0."""
    return height_around(spheres, 0.0, radius)


def height_around(spheres: np.ndarray, inner: float, outer: float) -> float:
    """Return a heap's mean height [m] at radii from `inner` to `outer` about x = y = 0.

    Locations without a sphere count as height 0.
    """
    x, y, height = surface(spheres, (-outer, outer), (-outer, outer), FINE * float(spheres[:, 3].max()))
    square = x**2 + y**2
    return float(np.mean(np.maximum(height[(square >= inner**2) & (square <= outer**2)], 0.0)))


def shadow(spheres: np.ndarray, x: float, y: float, cell: float) -> float:
    """Return the fraction of a rectangle that is covered by spheres, as seen from above.

    The rectangle is centred at the origin and has the half-widths `x` and `y` [m]. Vertical rays, which are `cell` [m]
    apart, test whether a sphere lies above or below a point of the rectangle.
    """
    return float(np.mean(np.isfinite(surface(spheres, (-x, x), (-y, y), cell)[2])))
