"""Areas of plane sections that are bounded by polygons and have polygonal holes."""

from collections.abc import Sequence
from itertools import combinations, pairwise

import numpy as np

GAUSS = np.polynomial.legendre.leggauss(2)
"""Points and weights of Gauss integration with two points on [-1, 1], which is exact for polynomials up to the third
degree. The integrands are the width of a section and the width weighted with x. Between two successive heights of
corners or crossings, they are at most quadratic functions of the height."""


def section_area(
    outline: Sequence[Sequence[float]],
    holes: Sequence[Sequence[Sequence[float]]] = (),
    *,
    width: float = np.inf,
    height: float = np.inf,
    axial: bool = False,
) -> float:
    """Return the area [m2] inside an outline and outside all holes, within 0 <= x <= `width` and 0 <= y <= `height`.

    Each polygon is a sequence of its corners (x, y) [m]; polygons may be concave and may overlap. If `axial` is true,
    the area is weighted with x. The result is then the volume per radian [m3] of the solid of revolution about x = 0.

    The corners and the crossings of edges divide the section into horizontal bands. Inside a band all edges are
    straight and keep their order, so that the integral over each band is exact.
    """
    edges = [_edges(polygon) for polygon in (outline, *holes)]
    levels = np.unique(np.clip(_levels(np.concatenate(edges)), 0.0, height))
    total = 0.0
    for low, high in pairwise(levels):
        half = 0.5 * (high - low)
        for place, weight in zip(*GAUSS, strict=True):
            y = 0.5 * (low + high) + half * place
            crossings = [np.clip(_crossings(each, y), 0.0, width) for each in edges]
            cuts = np.unique(np.concatenate(crossings))
            middle = 0.5 * (cuts[1:] + cuts[:-1])
            held = [np.searchsorted(each, middle) % 2 == 1 for each in crossings]
            inside = held[0] & ~np.any(held[1:], axis=0) if holes else held[0]
            pieces = np.diff(0.5 * cuts**2 if axial else cuts)
            total += weight * half * float(pieces[inside].sum())
    return total


def _edges(polygon: Sequence[Sequence[float]]) -> np.ndarray:
    """Return both ends of each edge of a polygon [m], shape (n, 2, 2)."""
    corners = np.array(polygon, dtype=float)
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


def _levels(edges: np.ndarray) -> np.ndarray:
    """Return the heights y [m] of all corners of the given polygon edges, and of all crossings between the edges."""
    heights = list(edges[..., 1].ravel())
    for (a, b), (c, d) in combinations(edges, 2):
        one, two = b - a, d - c
        turn = one[0] * two[1] - one[1] * two[0]
        if turn != 0.0:
            along = ((c - a)[0] * two[1] - (c - a)[1] * two[0]) / turn
            other = ((c - a)[0] * one[1] - (c - a)[1] * one[0]) / turn
            if 0.0 <= along <= 1.0 and 0.0 <= other <= 1.0:
                heights.append(float(a[1] + along * one[1]))
    return np.array(heights)


def _crossings(edges: np.ndarray, y: float) -> np.ndarray:
    """Return the x coordinates [m] at which polygon edges cross the horizontal line at height `y` [m].

    The coordinates are in increasing order.
    """
    (x0, y0), (x1, y1) = edges[:, 0].T, edges[:, 1].T
    met = (y0 <= y) != (y1 <= y)
    part = (y - y0[met]) / (y1[met] - y0[met])
    return np.sort(x0[met] + part * (x1[met] - x0[met]))
