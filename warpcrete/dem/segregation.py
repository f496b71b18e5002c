"""Segregation of the aggregate in a pipe: how much of it there is near the axis and near the wall, in front and in the
rear, and where its large stones are."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..core.method import Quantity
from .model import Model
from .state import State

UNITS = dict.fromkeys(
    ("aggregate_inner", "aggregate_outer", "aggregate_front", "aggregate_rear", "large_inner", "large_outer", "mixing"),
    "1",
)
"""Columns of a row. The first four as of a flow of two phases: volume fractions in inner and outer half of the radius,
front and rear half of the concrete; shares of stones larger than the mean in the aggregate of both halves of the
radius; Lacey's mixing index of large and small stones."""
POINTS = 64
"""In each sphere, that stand for its volume."""
ENDS = 0.05
"""Part of the aggregate at either end of the concrete that is left out: there it is not packed against more."""
RINGS, STATIONS = 3, 5
"""Cells of the mixing index: of equal area across, of equal volume of stones along the pipe."""


Stones = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Centres (n, 3) and radii (n,) of spheres [m], the volume that each stands for [m3], the size of its body [m]."""


def ball_points(count: int = POINTS) -> np.ndarray:
    """Points spread evenly through a unit ball, shape (count, 3): shells of equal volume on Fibonacci's spiral."""
    k = np.arange(count) + 0.5
    z = 1 - 2 * k / count
    turn = np.pi * (1 + np.sqrt(5)) * k
    # An irrational stride keeps the radius from going with the latitude.
    radius = np.cbrt((k * (np.sqrt(2) - 1)) % 1.0)
    flat = np.sqrt(1 - z**2)
    return radius[:, None] * np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)


def stones_of(state: State) -> Stones:
    """Spheres of the aggregate in the order of permanent numbers; those of a clump share its volume by their own."""
    order = np.argsort(state.spheres.id.numpy())
    body = state.spheres.body.numpy()[order]
    order, body = (array[state.bodies.group.numpy()[body] == 0] for array in (order, body))
    place = state.spheres.position.numpy()[order].astype(float)
    size = state.bodies.size.numpy().astype(float)
    cube = place[:, 3] ** 3
    share = cube / np.bincount(body, cube, minlength=len(size))[body]
    return place[:, :3], place[:, 3], np.pi / 6 * size[body] ** 3 * share, size[body]


def measured(
    axis: Any, radius: float, stones: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
) -> dict[str, float]:
    """Columns of a row, of stones as from :func:`stones_of` in a pipe of this axis and radius [m]."""
    centre, reach, volume, size = stones
    # A row holds numbers only: without stones there is no aggregate anywhere.
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
    section, length = np.pi * radius**2, end - begin
    inner, front = apart < 0.5 * radius, along > 0.5 * (begin + end)

    def total(chosen: np.ndarray) -> float:
        return float(weight[chosen & inside].sum())

    def share(chosen: np.ndarray) -> float:
        return total(chosen & large) / total(chosen) if total(chosen) > 0 else 0.0

    return {
        "aggregate_inner": total(inner) / (0.25 * section * length),
        "aggregate_outer": total(~inner) / (0.75 * section * length),
        "aggregate_front": total(front) / (0.5 * section * length),
        "aggregate_rear": total(~front) / (0.5 * section * length),
        "large_inner": share(inner),
        "large_outer": share(~inner),
        "mixing": mixing(s, np.linalg.norm(centre - on_axis, axis=1) / radius, are_large(size, volume)),
    }


def _quantiles(values: np.ndarray, weights: np.ndarray, parts: tuple[float, ...]) -> list[float]:
    order = np.argsort(values, kind="stable")
    rank = np.cumsum(weights[order]) - 0.5 * weights[order]
    return [float(np.interp(part * weights.sum(), rank, values[order])) for part in parts]


def are_large(size: np.ndarray, volume: np.ndarray) -> np.ndarray:
    """Which stones are larger than the mean by volume."""
    return size > (1 + 1e-6) * np.average(size, weights=volume)


def mixing(s: np.ndarray, apart: np.ndarray, large: np.ndarray) -> float:
    """Lacey's index of large and small stones: 0 of apart ones, 1 of as even a mix as chance makes (Lacey 1954).

    (s0^2 - s^2) / (s0^2 - sr^2) with the variance s^2 of the share of `large` stones, by number, over cells of rings
    and stations, s0^2 = p (1 - p) and sr^2 = s0^2 / n of n stones in a cell. `apart` is the distance of the axis over
    the pipe's radius.
    """
    p = float(large.mean())
    if not 0 < p < 1:
        return 1.0  # stones alike are nothing that could come apart
    ring = np.minimum((RINGS * apart**2).astype(int), RINGS - 1)
    rank = np.argsort(np.argsort(s, kind="stable"), kind="stable")
    cell = ring * STATIONS + rank * STATIONS // len(s)
    count = np.bincount(cell, minlength=RINGS * STATIONS)
    share = np.bincount(cell, large, RINGS * STATIONS)[count > 0] / count[count > 0]
    count = count[count > 0]
    variance = float(np.sum(count * (share - p) ** 2) / count.sum())
    apart_wholly = p * (1 - p)
    by_chance = apart_wholly * len(count) / count.sum()  # of cells weighed by their stones
    return (apart_wholly - variance) / (apart_wholly - by_chance) if apart_wholly > by_chance else 1.0


def row_of(model: Model, state: State) -> dict[str, float]:
    """Columns of a row of a scene that has a pipe."""
    pipe = model.scene.pipe
    assert pipe is not None
    return measured(pipe.axis, pipe.radius, stones_of(state))


def _at(name: str, place: int) -> Callable[[Any], float | None]:
    return lambda known: float(known.series[name][place]) if name in known.series else None


def _outward(place: int) -> Callable[[Any], float | None]:
    """Outer less inner volume fraction, over their mean."""

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
    Quantity("aggregate_inner", "1", _at("aggregate_inner", -1)),
    Quantity("aggregate_outer", "1", _at("aggregate_outer", -1)),
    Quantity("aggregate_front", "1", _at("aggregate_front", -1)),
    Quantity("aggregate_rear", "1", _at("aggregate_rear", -1)),
    Quantity("segregation", "1", _outward(-1)),
    Quantity("segregation_at_start", "1", _outward(0)),
    Quantity("size_segregation", "1", _large_outward),
    Quantity("mixing", "1", _at("mixing", -1)),
)
"""At the end: volume fractions; outer less inner over the mean, also at the start, since stones keep a distance from
the wall; share of large stones in the outer less that in the inner half of the radius; Lacey's index."""


def words(run: Any) -> str:
    """What the report says of it."""
    start, end, sizes = (100 * run.result[name] for name in ("segregation_at_start", "segregation", "size_segregation"))
    return (
        f"aggregate in the outer minus the inner half of the radius: {end:+.3g} % ({start:+.3g} % at the start); "
        f"large stones in the aggregate, likewise: {sizes:+.3g} %; mixing index {run.result['mixing']:.3g}"
    )
