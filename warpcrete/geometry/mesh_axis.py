"""Axis of a pipe that is given as a mesh: a smooth curve of lines and arcs through the centres of cross-sections."""

from collections.abc import Callable, Sequence

import numpy as np

from .axis import Arc, Axis, Line
from .curves import biarc

WINDOW = 2
"""Number of neighbouring cross-sections, on each side, whose centres are used to determine the direction of the bore at
a cross-section."""
AXIS_TOLERANCES = (0.004, 0.008, 0.016, 0.032, 0.064)
"""Largest accepted distances between the fitted axis and the centres of the cross-sections, divided by the bore's
radius. The values are tried in turn, from small to large, until the axis bends gently enough for a simulation. A large
value rounds the kinks of a bend whose mesh has few rings of triangles."""
LEAST_TURN = 1e-3
"""Smallest angle of an arc [rad]; an arc that turns less is replaced by a straight piece."""
STRAIGHT_TOLERANCE = 0.004
"""Largest angle that a straight piece of a bore's fitted axis may form with the measured direction of the bore, at any
cross-section along this piece [rad]."""
LEAST_STRAIGHT = 4
"""Smallest number of intervals between neighbouring cross-sections that a straight piece of the axis spans."""


def pieces_through(points: np.ndarray, ahead: np.ndarray, radius: float, widest: float) -> tuple[Line | Arc, ...]:
    """Return a smooth curve of few lines and arcs that passes close to points (n, 3) [m].

    The curve begins at the first point in the direction `ahead` and has no kinks. Its distance from each point is at
    most a small fraction of `radius`, the typical radius of the bore [m]. The fractions in `AXIS_TOLERANCES` are tried
    from small to large, until the radii of all arcs exceed `widest`, the largest radius of the bore [m]. If no
    fraction achieves this, the curve for the smallest fraction is returned.
    """
    fits = [_pieces(points, ahead, AXIS_TOLERANCES[0] * radius)]
    for tolerance in AXIS_TOLERANCES[1:]:
        if _bends_gently(fits[-1], widest):
            break
        fits.append(_pieces(points, ahead, tolerance * radius))
    return fits[-1] if _bends_gently(fits[-1], widest) else fits[0]


def _bends_gently(pieces: Sequence[Line | Arc], widest: float) -> bool:
    """Return whether the radii of all arcs of a curve exceed `widest` [m] and no arc is tiny, as a simulation requires.

    An arc is tiny if it turns by less than `LEAST_TURN`.
    """
    return all(piece.radius > widest and piece.angle >= LEAST_TURN for piece in pieces if isinstance(piece, Arc))


def _pieces(points: np.ndarray, ahead: np.ndarray, allowed: float) -> tuple[Line | Arc, ...]:
    """Return a smooth curve that starts in the direction `ahead` and stays within `allowed` [m] of points (n, 3) [m].

    Each straight piece or pair of arcs spans as many points as this distance allows.
    """
    tangents = directions(points, ahead)
    pieces: list[Line | Arc] = []
    here, tangent, position = 0, ahead, points[0]
    last = len(points) - 1
    while here < last:
        curve, reached = _longest(_straight, points, tangents, here, position, tangent, allowed)
        if curve is None or (reached - here < LEAST_STRAIGHT and reached < last):
            curve, reached = _longest(_biarc, points, tangents, here, position, tangent, allowed)
        assert curve is not None
        # Replace an arc that turns by a negligible angle by a line. The next piece then starts at the end of this line.
        curve = [Line(x.length) if isinstance(x, Arc) and x.angle < LEAST_TURN else x for x in curve]
        axis = Axis(tuple(position.tolist()), tuple(tangent.tolist()), tuple(curve))
        end, way = axis.at(axis.length)
        position, tangent, here = end[0], way[0], reached
        pieces += curve
    return tuple(pieces)


def directions(points: np.ndarray, ahead: np.ndarray) -> np.ndarray:
    """Return unit tangents of a curve at points (n, 3), from parabolas through neighbouring points.

    The tangent at the first point is `ahead`.
    """
    tangents = np.empty_like(points)
    count = len(points)
    for k in range(count):
        low, high = max(0, k - WINDOW), min(count, k + WINDOW + 1)
        near = points[low:high]
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(near, axis=0), axis=1))])
        degree = min(2, len(near) - 1)
        slope = np.polynomial.polynomial.polyfit(along - along[k - low], near, degree)[1]
        tangents[k] = slope / np.linalg.norm(slope)
    tangents[0] = ahead
    return tangents


Curve = list[Line | Arc] | None


def _longest(
    attempt: Callable[..., Curve], points: np.ndarray, tangents: np.ndarray, here: int, position: np.ndarray,
    tangent: np.ndarray, allowed: float,
) -> tuple[Curve, int]:  # fmt: skip
    """Fit curves with `attempt` from the point with index `here` to later points, and return the longest that fits.

    The curves begin at `position` with the unit tangent `tangent`, and stay within the distance `allowed` [m] of
    `points` (n, 3), where the bore has the directions `tangents` (n, 3). The second result is the index of the last
    point on the curve. If no curve fits, the first result is None.
    """
    best, reached = None, here
    step, last = 1, len(points) - 1
    while step > 0 and reached < last:
        stop = min(reached + step, last)
        curve = attempt(points, tangents, here, stop, position, tangent, allowed)
        if curve is None:
            # Search for the last point that the curve can reach. After each success, twice as many points are tried in
            # the next attempt. After a failure, half as many points are tried, to find the limit in between.
            step = step // 2 if best is not None else 0
        else:
            best, step = curve, 2 * (stop - reached) if stop - reached == step else step
            reached = stop
    return best, reached


def _straight(
    points: np.ndarray, tangents: np.ndarray, here: int, stop: int, position: np.ndarray, tangent: np.ndarray,
    allowed: float,
) -> Curve:  # fmt: skip
    """Return the straight line from `position` along `tangent` that ends beside the point with index `stop`.

    The result is None if the line is farther than half the distance `allowed` [m] from a point after the index `here`,
    up to `stop`, or if the `tangents` at these points deviate too much from the line.
    """
    offset = points[here + 1 : stop + 1] - position
    along = offset @ tangent
    beside = np.linalg.norm(offset - along[:, None] * tangent, axis=1)
    turned = np.linalg.norm(np.cross(tangents[here + 1 : stop + 1], tangent), axis=1)
    # The tangent at the last point also depends on the points beyond it, and the curve may bend there. The tangent at
    # the last point is therefore ignored, except at the end of the whole curve.
    inner = turned if stop == len(points) - 1 else turned[:-1]
    if np.all(beside <= 0.5 * allowed) and np.all(inner <= STRAIGHT_TOLERANCE):
        return [Line(float(along[-1]))]
    return None


def _biarc(
    points: np.ndarray, tangents: np.ndarray, here: int, stop: int, position: np.ndarray, tangent: np.ndarray,
    allowed: float,
) -> Curve:  # fmt: skip
    """Return two arcs that lead from `position` to the point with index `stop`, or None if they do not fit.

    The arcs begin with the unit tangent `tangent` and end with the tangent in `tangents` at `stop`. They do not fit if
    one of them turns by more than a quarter circle, if `stop` lies behind `position`, or if they are farther than
    `allowed` [m] from a point in between. Arcs to the point that follows the index `here` always fit.
    """
    if stop > here + 1 and (points[stop] - position) @ (tangent + tangents[stop]) <= 0:
        return None
    curve = biarc(position, tangent, points[stop], tangents[stop])
    if stop > here + 1 and any(isinstance(piece, Arc) and piece.angle > 0.5 * np.pi for piece in curve):
        return None
    axis = Axis(tuple(position.tolist()), tuple(tangent.tolist()), tuple(curve))
    inner = points[here + 1 : stop]
    beside = np.linalg.norm(inner - axis.nearest(inner), axis=1) if len(inner) else np.zeros(1)
    return curve if beside.max() <= allowed or stop == here + 1 else None
