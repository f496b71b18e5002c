"""Stations along a pipe: mean stress, wall stress, solid fraction and velocity in slices of the pipe, at every sample.

The mean stress in a slice follows Love and Weber: the sum over contacts of force times branch vector, divided by the
volume. If the branch vector of a contact crosses several slices, each slice receives the part inside it (Goldhirsch,
Granular Matter 12 (2010) 239, with a box as the averaging function). Wall contacts count too, because a slice reaches
to the wall.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from ...geometry.axis import Axis
from ..engine.model import Model
from ..engine.pairs import pairs_of
from ..engine.state import State
from ..scene.slices import Stations
from .station_forces import StationArrays, read_arrays

RINGS = 5
"""Number of rings of equal width around the axis, in each of which the axial velocity is averaged for a profile."""
FRONT = 0.98
"""Fraction of the solid volume that defines the front of the concrete: this fraction lies behind the front. Ahead of
the front, concrete does not fill the whole cross-section."""
FARTHEST = 8
"""The search for the front of the concrete looks only at 1/FARTHEST of all bodies, to save time. These are the bodies
that are farthest along the pipe."""
MEASURED = ("pressure", "axial_stress", "wall_stress", "solid_fraction", "bulk_density", "velocity")
PROFILE = tuple(f"velocity_{(2 * ring + 1) / (2 * RINGS):.1f}R" for ring in range(RINGS))
COLUMNS = (*MEASURED, *PROFILE)
UNITS = {"place": "m", "radius": "m", "pressure": "Pa", "axial_stress": "Pa", "wall_stress": "Pa",
         "solid_fraction": "1", "bulk_density": "kg/m3", "velocity": "m/s"} | dict.fromkeys(PROFILE, "m/s")  # fmt: skip
"""Units of the columns of a table of stations (slices of a pipe). `place` is the arc length of a slice. `pressure` is
the mean normal stress, and `axial_stress` is the normal stress along the pipe, which transmits the piston's force; both
are positive in compression. `wall_stress` is the shear stress of the wall against the flow. `velocity` is the mean
velocity of the solids along the pipe. The columns of `PROFILE` contain the mean velocity in a ring; their names end
with the mean radius of the ring, divided by the pipe's radius."""


@dataclass
class StationLog:
    """Record of the measurements in all slices of a pipe, sample by sample."""

    stations: Stations
    samples: list[np.ndarray] = field(default_factory=list)
    """Measurements, one array of shape (slices, COLUMNS) for each sample; NaN in slices that concrete did not fill."""

    def add(self, model: Model, state: State, travel: float) -> None:
        """Measure all slices of the pipe and append the sample; `travel` is the travel of the piston [m]."""
        self.samples.append(measured(self.stations, model, state, travel))

    def table(self, chosen: np.ndarray) -> dict[str, np.ndarray]:
        """Return a table by column name: place and radius of each slice of the pipe, and mean measured values.

        Each column has the shape (slices,). Measured values are means over the chosen samples. They are NaN in a slice
        if concrete did not fill it in at least one of these samples.
        """
        means = np.mean(np.array(self.samples)[chosen], axis=0)
        stations = self.stations
        table = {"place": stations.places - stations.origin, "radius": stations.bores.at(stations.places)}
        return table | {name: means[:, number] for number, name in enumerate(COLUMNS)}


def measured(stations: Stations, model: Model, state: State, travel: float) -> np.ndarray:
    """Measure all slices of the pipe in the current state; return an array of shape (slices, COLUMNS).

    Slices that concrete does not fill are NaN. `travel` is the arc length of the piston [m].
    """
    axis, edges = stations.axis, np.array(stations.edges)
    table = np.full((len(edges) - 1, len(COLUMNS)), np.nan)
    seen = read_arrays(model, state)
    spheres = _Spheres(seen, axis)
    if not np.any(spheres.solid):
        return table
    full = spheres.filled(edges, travel)
    volumes = stations.volumes
    table[:, :2] = _stresses(stations, seen, spheres) / volumes[:, None]
    table[:, 2] = spheres.wall_shear(stations, seen) / stations.surfaces()
    ring = np.minimum((RINGS * spheres.apart / stations.bores.at(spheres.s)).astype(int), RINGS - 1)
    member = [ring == number for number in range(RINGS)]
    columns = np.stack([np.ones(len(ring)), spheres.density, spheres.speed, *member, *member], axis=1)
    columns[:, 3 + RINGS :] *= spheres.speed[:, None]
    sums = spheres.in_slices(edges, columns)
    table[:, 3:5] = sums[:, :2] / volumes[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        table[:, 5] = sums[:, 2] / sums[:, 0]
        table[:, 6:] = sums[:, 3 + RINGS :] / sums[:, 3 : 3 + RINGS]
    table[~full] = np.nan
    return table


def stresses_along(
    stations: Stations,
    stress: np.ndarray,
    s: np.ndarray,
    tangent: np.ndarray,
    size: np.ndarray,
    fills: np.ndarray,
    travel: float,
) -> np.ndarray:
    """Return the mean normal stress and the stress along the pipe in all slices [Pa], shape (slices, 2).

    The results differ from the first two columns of :func:`measured`, because the stress of each body is distributed
    evenly over the slices that its diameter overlaps. Slices that concrete does not fill are NaN. `travel` is the arc
    length of the piston [m]. The following arrays hold one entry per body:

    - `stress` (n, 6): stress times volume [J], as from :func:`body_stresses`,
    - `s` (n,): arc length [m],
    - `tangent` (n, 3): tangent of the pipe's axis at this arc length,
    - `size` (n,): diameter of the sphere of equal volume [m],
    - `fills` (n,): True for aggregates, False for the balls that close the front of the concrete.
    """
    edges, t = np.array(stations.edges), tangent
    along = np.einsum("ij,ij,ij->i", stress[:, :3], t, t)
    along += 2 * np.einsum("ij,ij,ij->i", stress[:, 3:], t, t[:, [1, 2, 0]])
    each = np.stack([stress[:, :3].sum(axis=1) / 3, along], axis=1)
    stresses = _spread_evenly(s - 0.5 * size, s + 0.5 * size, each, edges) / stations.volumes[:, None]
    stresses[~_filled_slices(edges, travel, s, np.where(fills, size**3, 0.0))] = np.nan
    return stresses


def _filled_slices(edges: np.ndarray, travel: float, s: np.ndarray, volume: np.ndarray) -> np.ndarray:
    """Return a mask of the slices that lie between the piston and the front of the concrete, shape (slices,).

    `edges` contains the arc lengths of the slices' ends [m], and `travel` is the arc length of the piston [m]. `s` and
    `volume` are the arc lengths [m] and the volumes of the bodies, the latter in any unit.
    """
    whole = float(volume.sum())
    if whole == 0:
        return np.zeros(len(edges) - 1, bool)
    return (edges[:-1] >= travel) & (edges[1:] <= _front(s, volume, FRONT * whole))


def _front(s: np.ndarray, volume: np.ndarray, behind: float) -> float:
    """Return the arc length [m] behind which the bodies have the total volume `behind`, in the unit of `volume`."""
    # Sort only the farthest bodies, because sorting all bodies takes four times as long as this search for the front.
    far = len(s) // FARTHEST
    last = np.argpartition(s, len(s) - far)[len(s) - far :] if far else np.arange(len(s))
    before = float(volume.sum() - volume[last].sum()) if far else 0.0
    if before >= behind:
        last, before = np.arange(len(s)), 0.0
    order = last[np.argsort(s[last], kind="stable")]
    return float(s[order[np.searchsorted(before + np.cumsum(volume[order]), behind)]])


class _Spheres:
    """Spheres of a state, in order of permanent numbers.

    The balls of the plug, which closes the front of the concrete, do not count as aggregate, so their solid volume is
    set to 0 here.
    """

    def __init__(self, seen: StationArrays, axis: Axis) -> None:
        self.order = np.argsort(seen["spheres.id"])
        position = seen["spheres.position"].astype(float)[self.order]
        body = seen["spheres.body"][self.order]
        self.centre, self.radius, self.body = position[:, :3], position[:, 3], body
        self.nearest, self.s = axis.projected(self.centre)
        self.tangent = axis.at(self.s)[1]
        self.apart = np.linalg.norm(self.centre - self.nearest, axis=1)
        self.solid = seen["bodies.group"][body] == 0
        # The spheres of a clump overlap. Give each sphere a share of the clump's volume in proportion to the sphere's
        # volume.
        own = self.radius**3
        whole = np.bincount(body, own, len(seen["bodies.size"]))[body]
        size = seen["bodies.size"].astype(float)[body]
        self.share = np.where(self.solid, np.pi / 6 * size**3 * own / whole, 0.0)
        self.density = seen["bodies.mass"].astype(float)[body] / (np.pi / 6 * size**3)
        velocity = seen["spheres.velocity"].astype(float)[self.order, :3]
        self.speed = np.einsum("ij,ij->i", velocity, self.tangent)
        self.middle = seen["bodies.position"].astype(float)

    def filled(self, edges: np.ndarray, travel: float) -> np.ndarray:
        """Return a mask of the slices between a piston at `travel` [m] and the concrete's front, shape (slices,).

        `edges` contains the arc lengths of the slices' ends [m].
        """
        return _filled_slices(edges, travel, self.s, self.share)

    def in_slices(self, edges: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Sum the columns (n, k) of all spheres in each slice, weighted with solid volume [m3]; shape (slices, k).

        The weight is the part of a sphere's solid volume between the two planes across the axis that bound the slice.
        `edges` contains the arc lengths of the slices' ends [m].
        """
        sums = np.zeros((len(edges) - 1, columns.shape[1]))
        for here, slices in _overlaps(self.s - self.radius, self.s + self.radius, edges):
            # The fraction of a sphere's volume below a plane is (2 + 3 z - z^3) / 4. Here z is the height of the plane
            # above the sphere's centre, divided by the sphere's radius.
            z = [np.clip((edges[slices + k] - self.s[here]) / self.radius[here], -1, 1) for k in (0, 1)]
            below, under = (0.25 * (2 + 3 * height - height**3) for height in z)
            volume = self.share[here] * (under - below)
            for column in range(columns.shape[1]):
                sums[:, column] += np.bincount(slices, volume * columns[here, column], len(sums))
        return sums

    def wall_shear(self, stations: Stations, seen: StationArrays) -> np.ndarray:
        """Return the force that the wall exerts on the concrete against the flow in each slice [N], shape (slices,)."""
        push, arm, wall = _wall_pushes(seen, self.order)
        total = np.zeros(len(stations.edges) - 1)
        number = [w.name for w in seen.model.walls].index(stations.wall)
        for slot in range(push.shape[1]):
            here = (wall[:, slot] == number) & self.solid & np.any(arm[:, slot] != 0, axis=1)
            n = arm[here, slot] / np.linalg.norm(arm[here, slot], axis=1, keepdims=True)
            along = push[here, slot] - np.einsum("ij,ij->i", push[here, slot], n)[:, None] * n
            # Project the axis direction onto the wall, because the wall of a taper is not parallel to the axis.
            way = self.tangent[here] - np.einsum("ij,ij->i", self.tangent[here], n)[:, None] * n
            way /= np.linalg.norm(way, axis=1, keepdims=True)
            drag = -np.einsum("ij,ij->i", along, way)
            total += _spread_evenly(self.s[here], self.s[here], drag[:, None], np.array(stations.edges))[:, 0]
        return total


def _stresses(stations: Stations, seen: StationArrays, spheres: _Spheres) -> np.ndarray:
    """Return each slice's mean normal stress and axial stress, both times the slice's volume [J], shape (slices, 2).

    Both follow from a tensor: the sum over contacts of force times branch vector. The mean normal stress is a third of
    its trace, and the axial stress is its component along the pipe. Both are positive in compression.
    """
    edges, axis = np.array(stations.edges), stations.axis
    body_s = axis.along(spheres.middle)
    i, j, place = pairs_of(seen["pairs.start"], seen["pairs.other"], seen.chunks)
    force = seen["pair pushes"][place]
    acts = np.flatnonzero(force.any(axis=1))
    i, j, force = i[acts], j[acts], force[acts]
    number, body = seen["spheres.id"].astype(np.int64), seen["spheres.body"]
    order = np.argsort(np.minimum(number[i], number[j]) * len(number) + np.maximum(number[i], number[j]))
    first, second, force = body[i[order]], body[j[order]], force[order].astype(float)
    branch = spheres.middle[second] - spheres.middle[first]
    total = _of_contacts(axis, edges, body_s[first], body_s[second], force, branch)
    pushes, arms, _ = _wall_pushes(seen, spheres.order)
    for slot in range(pushes.shape[1]):
        here = np.any(arms[:, slot] != 0, axis=1)
        point = spheres.centre[here] + arms[here, slot]
        middle = spheres.middle[spheres.body[here]]
        total += _of_contacts(
            axis, edges, body_s[spheres.body[here]], axis.along(point), pushes[here, slot], point - middle
        )
    return total


def _of_contacts(
    axis: Axis, edges: np.ndarray, begin: np.ndarray, end: np.ndarray, force: np.ndarray, branch: np.ndarray
) -> np.ndarray:
    tangent = axis.at(0.5 * (begin + end))[1]
    along = -np.einsum("ij,ij->i", force, tangent) * np.einsum("ij,ij->i", branch, tangent)
    each = np.stack([-np.einsum("ij,ij->i", force, branch) / 3, along], axis=1)
    return _spread_evenly(begin, end, each, edges)


def _spread_evenly(begin: np.ndarray, end: np.ndarray, values: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Distribute each row of `values`, shape (n, k), evenly over an interval; return the sums per slice, shape (m, k).

    The arc lengths `begin` and `end` [m] are the ends of the intervals, shape (n,). `edges` are the ends of the m
    slices [m].
    """
    # If a contact lies across the pipe, the arc lengths `begin` and `end` of its two ends are equal. Spread the
    # contact's value over a small length, because the code divides by the length.
    width = np.maximum(np.abs(end - begin), 1e-6)
    low = 0.5 * (begin + end - width)
    sums = np.zeros((len(edges) - 1, values.shape[1]))
    for here, slices in _overlaps(low, low + width, edges):
        inside = np.minimum(low[here] + width[here], edges[slices + 1]) - np.maximum(low[here], edges[slices])
        part = np.maximum(inside, 0.0) / width[here]
        for column in range(values.shape[1]):
            sums[:, column] += np.bincount(slices, part * values[here, column], len(sums))
    return sums


def _overlaps(low: np.ndarray, high: np.ndarray, edges: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield indices of intervals and of the slices that they overlap, as pairs of equally long arrays.

    The intervals extend from `low` to `high` [m], and `edges` are the ends of the slices [m]. The first pair contains
    every interval with its first slice. The second pair contains every interval that overlaps at least two slices, with
    its second slice, and so on. Slices outside the range of `edges` are left out.
    """
    first, last = (np.searchsorted(edges, end, "right") - 1 for end in (low, high))
    for step in range(int(np.max(last - first, initial=-1)) + 1):
        slices = first + step
        here = np.flatnonzero((slices <= last) & (slices >= 0) & (slices < len(edges) - 1))
        yield here, slices[here]


def _wall_pushes(seen: StationArrays, order: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the force [N] of each wall contact, the vector from sphere centre to contact [m], and the wall's index.

    The arrays have a row for each sphere, in the order given by `order`, and a column for each wall contact that a
    sphere can have.
    """
    push, arm = (seen[name].astype(float)[order] for name in ("wall pushes", "wall arms"))
    wall = np.broadcast_to(np.arange(push.shape[1]), push.shape[:2]).copy()
    if seen.model.features.meshes:
        first = seen.model.analytic_walls
        wall[:, first:] = seen["slots.wall"][order][:, first:]
    return push, arm, wall
