"""Segregation of aggregate in a pipe: volume fractions at axis and wall, front and rear; position of large stones."""

from collections.abc import Callable
from typing import Any

import numpy as np

from ...core.run.method import Quantity
from ...core.run.run import Run
from ...geometry.bores import Bores
from ..engine.model import Model
from ..engine.state import State
from ..scene.slices import varying_bores

UNITS = dict.fromkeys(
    ("aggregate_inner", "aggregate_outer", "aggregate_front", "aggregate_rear", "large_inner", "large_outer", "mixing"),
    "1",
)
"""Columns of the segregation measurement, with their units.

- `aggregate_inner`, `aggregate_outer`: volume fraction of aggregate in the inner and in the outer half of the pipe's
  radius.
- `aggregate_front`, `aggregate_rear`: volume fraction of aggregate in the front and in the rear half of the concrete.
- `large_inner`, `large_outer`: volume of the stones above the mean size, divided by the volume of all stones, in the
  inner and in the outer half of the pipe's radius.
- `mixing`: Lacey's mixing index of large and small stones, 0 if they are separate and 1 if mixed at random.
"""
POINTS = 64
"""Number of points that represent the volume of a sphere. Each point lies in the inner or the outer half of the pipe's
radius, so the points divide the volume between these halves."""
ENDS = 0.05
"""Fraction of the aggregate at either end of the concrete that the segregation measurement leaves out, because the
aggregate is packed less densely there."""
RINGS, STATIONS = 3, 5
"""Number of rings of equal area, and of sections along the pipe with equally many stones. Rings and sections divide the
pipe into the cells of the mixing index."""


Stones = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Spheres that form the aggregates: their centres [m], shape (n, 3), radii [m], volumes [m3], and the sizes of the
aggregates to which they belong [m], each of shape (n,)."""


def ball_points(count: int = POINTS) -> np.ndarray:
    """Return points spread evenly through a ball of the radius 1, shape (count, 3).

    The directions of the points follow a Fibonacci spiral. The radii divide the ball into shells of equal volume.
    """
    k = np.arange(count) + 0.5
    z = 1 - 2 * k / count
    turn = np.pi * (1 + np.sqrt(5)) * k
    # Successive points lie at successive latitudes. Step through the shells by an irrational stride, so that the radius
    # of a point is not correlated with its latitude.
    radius = np.cbrt((k * (np.sqrt(2) - 1)) % 1.0)
    flat = np.sqrt(1 - z**2)
    return radius[:, None] * np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)


def stones_of(state: State) -> Stones:
    """Return the centres [m], radii [m], volumes [m3] and sizes [m] of the spheres of which the aggregates consist.

    The spheres are ordered by their permanent numbers. The size of a sphere is the size of the aggregate to which the
    sphere belongs. If the aggregate is a clump of several spheres, the volume of a sphere is its share of the clump's
    volume.
    """
    order = np.argsort(state.spheres.id.numpy())
    body = state.spheres.body.numpy()[order]
    order, body = (array[state.bodies.group.numpy()[body] == 0] for array in (order, body))
    place = state.spheres.position.numpy()[order].astype(float)
    size = state.bodies.size.numpy().astype(float)
    cube = place[:, 3] ** 3
    share = cube / np.bincount(body, cube, minlength=len(size))[body]
    return place[:, :3], place[:, 3], np.pi / 6 * size[body] ** 3 * share, size[body]


def measured(axis: Any, radius: float | Bores, stones: Stones) -> dict[str, float]:
    """Measure the segregation of stones in a pipe; return the values by column name.

    `radius` is the radius of the pipe [m], or an object :class:`Bores` with the radius as a function of arc length.
    `stones` contains the arrays that :func:`stones_of` returns, and :data:`UNITS` lists the columns.
    """
    centre, reach, volume, size = stones
    # The time series may contain only finite numbers, so return zeros for an empty pipe.
    if len(volume) == 0:
        return dict.fromkeys(UNITS, 0.0)
    s = axis.along(centre)
    on_axis, tangent, _, _ = axis.frame(s)
    points = ball_points()
    shift = reach[:, None, None] * points[None]
    ahead = np.einsum("npc,nc->np", shift, tangent)
    across = (centre - on_axis)[:, None] + shift - ahead[:, :, None] * tangent[:, None]
    apart = np.linalg.norm(across, axis=2).ravel()
    along = (s[:, None] + ahead).ravel()
    weight = np.repeat(volume / len(points), len(points))
    begin, end = _quantiles(s, volume, (ENDS, 1 - ENDS))
    inside = (along >= begin) & (along <= end)
    large = np.repeat(are_large(size, volume), len(points))
    middle = 0.5 * (begin + end)
    here, wall = (radius.at(along), radius.at(s)) if isinstance(radius, Bores) else (radius, radius)
    inner, front = apart < 0.5 * here, along > middle
    whole, ahead_of, behind = _volumes(radius, begin, middle, end)

    def total(chosen: np.ndarray) -> float:
        return float(weight[chosen & inside].sum())

    def share(chosen: np.ndarray) -> float:
        return total(chosen & large) / total(chosen) if total(chosen) > 0 else 0.0

    return {
        "aggregate_inner": total(inner) / (0.25 * whole),
        "aggregate_outer": total(~inner) / (0.75 * whole),
        "aggregate_front": total(front) / ahead_of,
        "aggregate_rear": total(~front) / behind,
        "large_inner": share(inner),
        "large_outer": share(~inner),
        "mixing": mixing(s, np.linalg.norm(centre - on_axis, axis=1) / wall, are_large(size, volume)),
    }


def _volumes(radius: float | Bores, begin: float, middle: float, end: float) -> tuple[float, float, float]:
    """Return the volumes of three sections of a pipe [m3].

    The sections extend from `begin` to `end`, from `middle` to `end`, and from `begin` to `middle` (arc lengths in m).
    """
    if isinstance(radius, Bores):
        return radius.volume(begin, end), radius.volume(middle, end), radius.volume(begin, middle)
    whole = np.pi * radius**2 * (end - begin)
    return whole, 0.5 * whole, 0.5 * whole


def _quantiles(values: np.ndarray, weights: np.ndarray, parts: tuple[float, ...]) -> list[float]:
    order = np.argsort(values, kind="stable")
    rank = np.cumsum(weights[order]) - 0.5 * weights[order]
    return [float(np.interp(part * weights.sum(), rank, values[order])) for part in parts]


def are_large(size: np.ndarray, volume: np.ndarray) -> np.ndarray:
    """Return a mask of the stones that are larger than the volume-weighted mean size."""
    return size > (1 + 1e-6) * np.average(size, weights=volume)


def mixing(s: np.ndarray, apart: np.ndarray, large: np.ndarray) -> float:
    """Return Lacey's mixing index of large and small stones: 0 if separate, 1 if mixed at random (Lacey 1954).

    The index is (s0^2 - s^2) / (s0^2 - sr^2). It compares three variances of the number fraction of `large` stones:

    - s^2 is the variance found between the cells into which rings and sections divide the pipe.
    - s0^2 = p (1 - p) is the variance if large and small stones were completely separate; p is the number fraction of
      large stones in the whole pipe.
    - sr^2 = s0^2 / n is the variance if the stones were mixed at random, with n stones per cell.

    `s` is the arc length of each stone [m], and `apart` is its distance from the axis divided by the pipe's radius.
    """
    p = float(large.mean())
    if not 0 < p < 1:
        return 1.0  # Stones of equal size cannot segregate.
    ring = np.minimum((RINGS * apart**2).astype(int), RINGS - 1)
    rank = np.argsort(np.argsort(s, kind="stable"), kind="stable")
    cell = ring * STATIONS + rank * STATIONS // len(s)
    count = np.bincount(cell, minlength=RINGS * STATIONS)
    share = np.bincount(cell, large, RINGS * STATIONS)[count > 0] / count[count > 0]
    count = count[count > 0]
    variance = float(np.sum(count * (share - p) ** 2) / count.sum())
    apart_wholly = p * (1 - p)
    # For a random mixture, the variance is the mean of p (1 - p) / n over all cells, weighted with the number n of
    # stones in a cell.
    by_chance = apart_wholly * len(count) / count.sum()
    return (apart_wholly - variance) / (apart_wholly - by_chance) if apart_wholly > by_chance else 1.0


def row_of(model: Model, state: State) -> dict[str, float]:
    """Return the values of the segregation columns for the current state of a scene with a pipe."""
    pipe = model.scene.pipe
    assert pipe is not None
    return measured(pipe.axis, varying_bores(model.scene.stations) or pipe.radius, stones_of(state))


def _at_end(name: str) -> Callable[[Any], float | None]:
    return lambda known: float(known.series[name][-1]) if name in known.series else None


def _outward(place: int) -> Callable[[Any], float | None]:
    """Return a function that computes the radial segregation in the row `place` of the time series.

    The function takes the data of a run. Its result is the volume fraction of aggregate in the outer half of the pipe's
    radius, minus the volume fraction in the inner half, divided by the mean volume fraction.
    """

    def found(known: Any) -> float | None:
        if "aggregate_inner" not in known.series:
            return None
        inner, outer = (known.series[f"aggregate_{name}"][place] for name in ("inner", "outer"))
        return float((outer - inner) / (0.25 * inner + 0.75 * outer))

    return found


def _large_outward(known: Any) -> float | None:
    if "large_inner" not in known.series:
        return None
    return float(known.series["large_outer"][-1] - known.series["large_inner"][-1])


QUANTITIES = (
    Quantity("aggregate_inner", "1", _at_end("aggregate_inner"),
             meaning="Volume fraction of aggregate in the inner half of the radius of the pipe at the end"),
    Quantity("aggregate_outer", "1", _at_end("aggregate_outer"),
             meaning="Volume fraction of aggregate in the outer half of the radius of the pipe at the end"),
    Quantity("aggregate_front", "1", _at_end("aggregate_front"),
             meaning="Volume fraction of aggregate in the front half of the concrete at the end"),
    Quantity("aggregate_rear", "1", _at_end("aggregate_rear"),
             meaning="Volume fraction of aggregate in the rear half of the concrete at the end"),
    Quantity("segregation", "1", _outward(-1),
             meaning="`aggregate_outer` minus `aggregate_inner`, divided by the mean volume fraction of aggregate, at "
                     "the end"),
    Quantity("segregation_at_start", "1", _outward(0),
             meaning="Value of `segregation` at the start, which is not zero, because stones keep a distance from the "
                     "wall"),
    Quantity("size_segregation", "1", _large_outward,
             meaning="Fraction of large stones in the aggregate of the outer half of the radius, minus the "
                     "fraction in the inner half"),
    Quantity("mixing", "1", _at_end("mixing"),
             meaning="Lacey's mixing index of large and small stones at the end: 0 if they are separate, 1 if mixed "
                     "at random"),
)  # fmt: skip
"""Segregation results of a run; all values except `segregation_at_start` are measured at the end of the run."""


def words(run: Run) -> str:
    """Return the line of a run's report that states its radial segregation and its mixing index."""
    start, end, sizes = (100 * run.result[name] for name in ("segregation_at_start", "segregation", "size_segregation"))
    return (
        f"difference between outer and inner half of the radius: aggregate {end:+.3g} % ({start:+.3g} % at the start), "
        f"large stones in the aggregate {sizes:+.3g} %; mixing index {run.result['mixing']:.3g}"
    )
