"""Areas of plane sections: what polygons, less other polygons, hold."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, pairwise

import numpy as np

GAUSS = np.polynomial.legendre.leggauss(2)
"""Places and weights in -1..1, exact for the cubes of widths that a band of a section has."""


def section_area(
    outline: Sequence[Sequence[float]],
    holes: Sequence[Sequence[Sequence[float]]] = (),
    *,
    width: float = np.inf,
    height: float = np.inf,
    axial: bool = False,
) -> float:
    """Return the area inside an outline, outside all holes, and in a room from 0 to `width` and `height` [m2].

    Polygons are given by their corners (x, y) [m] in turn; they may overlap one another and be concave. With `axial`
    the area is weighted by x, which gives the volume of a radian about the axis x = 0 [m3].

    Between two neighbouring levels of a corner or a crossing all edges run straight and in one order, so the integral
    over each such band is exact.
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
    """Return both ends of each edge, shape (n, 2, 2)."""
    corners = np.array(polygon, dtype=float)
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


def _levels(edges: np.ndarray) -> np.ndarray:
    """Return the heights of all corners and of all crossings of two edges."""
    found = list(edges[..., 1].ravel())
    for (a, b), (c, d) in combinations(edges, 2):
        one, two = b - a, d - c
        turn = one[0] * two[1] - one[1] * two[0]
        if turn != 0.0:
            along = ((c - a)[0] * two[1] - (c - a)[1] * two[0]) / turn
            other = ((c - a)[0] * one[1] - (c - a)[1] * one[0]) / turn
            if 0.0 <= along <= 1.0 and 0.0 <= other <= 1.0:
                found.append(float(a[1] + along * one[1]))
    return np.array(found)


def _crossings(edges: np.ndarray, y: float) -> np.ndarray:
    """Return where edges cross the level `y`, increasing."""
    (x0, y0), (x1, y1) = edges[:, 0].T, edges[:, 1].T
    met = (y0 <= y) != (y1 <= y)
    part = (y - y0[met]) / (y1[met] - y0[met])
    return np.sort(x0[met] + part * (x1[met] - x0[met]))
