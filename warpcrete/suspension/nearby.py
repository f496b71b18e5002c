"""Search for pairs of close points, and constants of the placement of aggregates."""

from collections.abc import Callable
from itertools import product

import numpy as np

CLEARANCE = 0.02
"""Minimum gap between two spheres at the start, divided by the mean of their radii. It is also the minimum gap between
a sphere and a wall, divided by the sphere's radius."""
MARGIN = 0.005
"""Gap in addition to the gap of CLEARANCE, to which overlapping spheres are pushed apart. Between two spheres the
additional gap is divided by the sum of their radii, and between a sphere and a wall by the sphere's radius. Without it,
overlaps would become ever smaller, but never vanish."""
ITERATIONS = 1000
"""Maximum number of attempts to place spheres clear of walls, and of iterations that push overlapping spheres apart."""
SWEEPS = 100
"""Number of times that each sphere is moved at random after overlaps have been removed."""

Draw = Callable[[np.random.Generator, int], np.ndarray]
"""Function that takes a random number generator and a number n, and returns n random points [m], shape (n, 3)."""
Distance = Callable[[np.ndarray], np.ndarray]
"""Function that returns the distance of points, shape (n, 3), from the nearest wall [m], shape (n,). The distance is
negative for points behind the wall."""


def draw_between(low: np.ndarray, high: np.ndarray) -> Draw:
    """Return a function that draws random points, distributed uniformly in the box between two corners [m]."""
    return lambda rng, count: rng.uniform(low, high, (count, 3))


def close_pairs(x: np.ndarray, reach: float, period: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the pairs of points whose distance is below `reach` [m], in three arrays.

    The arrays hold the index of each pair's first point, the index of its second point, and the vector from the first
    to the second point [m]. Each pair occurs once, with the smaller index first. If `period` is above 0, space repeats
    itself along the last axis with this length [m], which must be at least twice `reach`.
    """
    count = len(x)
    origin = np.arange(count)
    if period > 0:
        # Copy the points near each end of the period to the space beyond the opposite end, so that pairs across an end
        # are found.
        x = x - np.where(np.arange(3) == 2, period * np.floor((x - x.min(0)) / period), 0.0)
        up, down = (np.flatnonzero(x[:, 2] < x[:, 2].min() + reach), np.flatnonzero(x[:, 2] > x[:, 2].max() - reach))
        shift = np.array([0.0, 0.0, period])
        x, origin = np.concatenate([x, x[up] + shift, x[down] - shift]), np.concatenate([origin, up, down])
    cell = np.floor((x - x.min(0)) / reach).astype(np.int64) + 1
    shape = [int(n) + 2 for n in cell.max(0)]
    key: np.ndarray = np.asarray(np.ravel_multi_index(tuple(cell.T), tuple(shape)))
    order = np.argsort(key, kind="stable")
    ranked, first, second = key[order], [], []
    own, own_place = key[:count], np.arange(count)
    # Points are sorted by the key of their cell. Cells that adjoin along the last axis have consecutive keys, so nine
    # ranges of keys cover the 27 cells at and around a point.
    for step in product((-1, 0, 1), repeat=2):
        middle = own + (step[0] * shape[1] + step[1]) * shape[2]
        start, end = np.searchsorted(ranked, middle - 1), np.searchsorted(ranked, middle + 1, "right")
        number = end - start
        first.append(np.repeat(own_place, number))
        within = np.arange(number.sum()) - np.repeat(np.cumsum(number) - number, number)
        second.append(order[within + np.repeat(start, number)])
    i, j = np.concatenate(first), np.concatenate(second)
    kept = i < origin[j]
    i, j = i[kept], j[kept]
    d = x[j] - x[i]
    near = np.einsum("ij,ij->i", d, d) < reach**2
    return i[near], origin[j[near]], d[near]
