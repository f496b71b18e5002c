"""Smooth curves through points, made of circular arcs and straight pieces."""

import math

import numpy as np

from .axis import Arc, Line

FLAT = 1e-6
"""Turning angle [rad] below which a piece of a curve becomes a straight line instead of an arc."""


def curve_through(points: np.ndarray, tangent: np.ndarray) -> list[Line | Arc]:
    """Return the pieces of a smooth curve through `points` (n, 3) [m] that starts with the unit vector `tangent`.

    Each pair of neighbouring points is joined by two arcs that meet without a kink (biarcs of equal tangent lengths,
    Bolton 1975); in general, the two arcs lie in different planes. At an inner point, the curve has the direction of
    the circle through that point and its two neighbours. The curve through points on a circle is therefore this circle.
    """
    pieces: list[Line | Arc] = []
    tangents = _tangents(points, tangent)
    for place in range(len(points) - 1):
        pieces += biarc(points[place], tangents[place], points[place + 1], tangents[place + 1])
    return pieces


def start_tangent(points: np.ndarray) -> np.ndarray:
    """Return the unit tangent of the circle through the first three of `points` (n, 3), at the first point."""
    chord = _unit(points[1] - points[0])
    if len(points) == 2:
        return chord
    after = _passing(points[0], points[1], points[2])
    return _unit(2 * (chord @ after) * chord - after)


def _tangents(points: np.ndarray, first: np.ndarray) -> list[np.ndarray]:
    found = [first]
    found += [_passing(*points[k - 1 : k + 2]) for k in range(1, len(points) - 1)]
    chord = _unit(points[-1] - points[-2])
    found.append(_unit(2 * (chord @ found[-1]) * chord - found[-1]))
    return found


def _passing(before: np.ndarray, here: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Return the unit tangent, at the point `here`, of the circle through three points."""
    one, other = here - before, after - here
    return _unit(_unit(one) * np.linalg.norm(other) + _unit(other) * np.linalg.norm(one))


def biarc(begin: np.ndarray, t0: np.ndarray, end: np.ndarray, t1: np.ndarray) -> list[Line | Arc]:
    """Return two arcs (a biarc) from a point with unit tangent `t0` to a point with unit tangent `t1`.

    The two arcs have tangents of equal length d (Bolton 1975). The tangents at the two ends lead to the points
    q1 = begin + d t0 and q2 = end - d t1. The arcs meet midway between q1 and q2. They meet without a kink if the
    distance between q1 and q2 is 2 d, which gives a quadratic equation for d.
    """
    chord, both = end - begin, t0 + t1
    bent = 2 * (1 - float(t0 @ t1))
    if bent < 1e-12:
        d = float(chord @ chord) / (2 * float(chord @ both))
    else:
        d = (math.sqrt(float(chord @ both) ** 2 + bent * float(chord @ chord)) - float(chord @ both)) / bent
    middle = 0.5 * (begin + d * t0 + end - d * t1)
    first = _arc(begin, t0, middle)
    turned = t0 if isinstance(first, Line) else _after(first, t0)
    return [first, _arc(middle, turned, end)]


def _arc(begin: np.ndarray, tangent: np.ndarray, end: np.ndarray) -> Line | Arc:
    chord = end - begin
    length = float(np.linalg.norm(chord))
    across = chord - (chord @ tangent) * tangent
    turn = 2 * math.atan2(float(np.linalg.norm(across)), float(chord @ tangent))
    if turn < FLAT:
        return Line(length)
    towards = _unit(across)
    return Arc(length / (2 * math.sin(turn / 2)), turn, (float(towards[0]), float(towards[1]), float(towards[2])))


def _after(arc: Arc, tangent: np.ndarray) -> np.ndarray:
    """Return the unit tangent at the end of an arc that starts with the unit vector `tangent`."""
    return math.cos(arc.angle) * tangent + math.sin(arc.angle) * np.array(arc.towards)


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)
