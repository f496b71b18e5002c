"""Where a pipe comes near itself."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from .axis import Axis

HALF_TURN = 0.51 * math.pi
"""Way along a line over the pipe's diameter within which it is near itself, however it bends."""


def meeting(axis: Axis, spans: Sequence[tuple[float, float, int]], gap: float = 0.0) -> tuple[int, int] | None:
    """Numbers of the first two spans, from 0, between whose walls there is no `gap` [m]; None where there are none.

    A span of an axis has a length, a diameter [m], and places along it between which it is taken to be straight; one
    begins where the one before it ends.
    """
    begin = 0.0
    rows: list[tuple[int, float, float, float]] = []
    edges = []
    for number, (length, wide, places) in enumerate(spans):
        s = np.linspace(begin, begin + length, places)
        points, _ = axis.at(s)
        rows += [(number, s[k], s[k + 1], wide) for k in range(len(s) - 1)]
        edges += [points[k : k + 2] for k in range(len(s) - 1)]
        begin += length
    owner, start, end, wide = np.array(rows).T
    ends = np.array(edges)
    for k in range(len(rows)):
        later = np.arange(k + 1, len(rows))
        apart = 0.5 * (wide[k] + wide[later]) + gap
        # What follows along the tightest bend, of half a diameter, is nearer than a diameter for half a turn.
        far = start[later] - end[k] > HALF_TURN * apart
        near = later[far][distances(ends[k], ends[later[far]]) < apart[far]]
        if len(near):
            return int(owner[k]), int(owner[near[0]])
    return None


def distances(one: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Least distances [m] of a segment (2, 3) from each of others (n, 2, 3) (Ericson 2005, 5.1.9)."""
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
