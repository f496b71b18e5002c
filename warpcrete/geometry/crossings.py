"""Search for places where a pipe meets itself or comes too close to itself."""

import math
from collections.abc import Sequence

import numpy as np

from .axis import Axis

HALF_TURN = 0.51 * math.pi
"""Shortest distance along the axis between two pieces of a pipe that are checked for a crossing, divided by the pipe's
diameter. In a tight bend, pieces nearer to each other along the axis may be close together without crossing."""


def first_crossing(axis: Axis, spans: Sequence[tuple[float, float, int]], gap: float = 0.0) -> tuple[int, int] | None:
    """Return the indices of the first two spans of a pipe whose walls are closer to each other than `gap` [m], or None.

    A span is a piece of the pipe, given by its length [m], its diameter [m] and the number of points on its axis; the
    axis counts as straight between these points. Each span begins where the previous span ends.
    """
    begin = 0.0
    places = []
    for length, _, count in spans:
        places.append(np.linspace(begin, begin + length, count))
        begin += length
    points = axis.at(np.concatenate(places))[0]
    firsts = np.cumsum([0, *(len(s) for s in places)])
    edges = np.concatenate([np.arange(first, first + len(s) - 1) for first, s in zip(firsts, places)])
    owner = np.repeat(np.arange(len(spans)), [len(s) - 1 for s in places])
    along = np.concatenate(places)
    start, end, wide = along[edges], along[edges + 1], np.array([wide for _, wide, _ in spans])[owner]
    ends = np.stack([points[edges], points[edges + 1]], axis=1)
    for k in range(len(edges)):
        later = np.arange(k + 1, len(edges))
        apart = 0.5 * (wide[k] + wide[later]) + gap
        # The tightest bend has a centreline radius of half a pipe diameter. On this bend, two pieces less than half a
        # turn apart are always closer than a diameter, so only pieces farther apart along the axis are compared.
        far = start[later] - end[k] > HALF_TURN * apart
        near = later[far][distances(ends[k], ends[later[far]]) < apart[far]]
        if len(near):
            return int(owner[k]), int(owner[near[0]])
    return None


def distances(one: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return the shortest distances [m] of the segment `one` (2, 3) from `others` (n, 2, 3) (Ericson 2005, 5.1.9)."""
    first, second, between = one[1] - one[0], others[:, 1] - others[:, 0], one[0] - others[:, 0]
    a, e, f = first @ first, np.sum(second**2, 1), np.sum(second * between, 1)
    b, c = second @ first, between @ first
    determinant = a * e - b * b
    skew = determinant > 1e-12 * a * e
    s = np.where(skew, np.clip((b * f - c * e) / np.where(skew, determinant, 1.0), 0, 1), 0.0)
    t = (b * s + f) / e
    s = np.where((t < 0) | (t > 1), np.clip((b * np.clip(t, 0, 1) - c) / a, 0, 1), s)
    gap = one[0] + s[:, None] * first - others[:, 0] - np.clip(t, 0, 1)[:, None] * second
    return np.linalg.norm(gap, axis=1)
