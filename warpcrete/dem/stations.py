"""Stations along a pipe: stress, wall stress, solid fraction and velocity in slices of it, at every sample.

The mean stress in a slice is that of Love and Weber, the sum over contacts of force times branch over the volume, where
of a contact that reaches from one slice into the next each gets its part of the branch (Goldhirsch, Granular Matter 12
(2010) 239, with a box for the averaging function). Walls count as contacts, so that the slice reaches to the wall.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
import warp as wp

from ..core.launching import DEFAULT_BLOCK, Stage, at_once, parameter_names
from ..geometry.axis import Axis
from ..kernels.common.types import types
from ..kernels.dem.stations import force_probe
from .model import Model
from .probes import listed_pairs
from .slices import FEWEST, Stations
from .state import State

RINGS = 5
"""Of equal width, in which a velocity profile is a mean."""
FRONT = 0.98
"""Part of the solid volume behind the front: what is beyond it no longer fills the pipe."""
PLACES = ("place", "radius")
MEASURED = ("pressure", "axial_stress", "wall_stress", "solid_fraction", "bulk_density", "velocity")
PROFILE = tuple(f"velocity_{(2 * ring + 1) / (2 * RINGS):.1f}R" for ring in range(RINGS))
COLUMNS = (*MEASURED, *PROFILE)
UNITS = {"place": "m", "radius": "m", "pressure": "Pa", "axial_stress": "Pa", "wall_stress": "Pa",
         "solid_fraction": "1", "bulk_density": "kg/m3", "velocity": "m/s"} | dict.fromkeys(PROFILE, "m/s")  # fmt: skip
"""Of the columns of a table of stations. `pressure` is the mean normal stress, `axial_stress` the one along the pipe,
which carries the piston's push, both positive in compression; `wall_stress` acts along the wall against the flow;
`velocity` is the mean of the solids along the pipe, and in rings about so many radii from the axis."""


@dataclass
class StationLog:
    """What was measured at the stations, sample by sample."""

    stations: Stations
    samples: list[np.ndarray] = field(default_factory=list)
    """Each of shape (slices, COLUMNS); NaN in slices that were not full."""

    def add(self, model: Model, state: State, travel: float) -> None:
        """Measure now, after the piston has gone so far [m]."""
        self.samples.append(measured(self.stations, model, state, travel))

    def table(self, chosen: np.ndarray) -> dict[str, np.ndarray]:
        """Means over the chosen samples, a column each; NaN in slices that were not full in all of them."""
        found = np.mean(np.array(self.samples)[chosen], axis=0)
        stations = self.stations
        table = {"place": stations.places - stations.origin, "radius": stations.bores.at(stations.places)}
        return table | {name: found[:, number] for number, name in enumerate(COLUMNS)}


def measured(stations: Stations, model: Model, state: State, travel: float) -> np.ndarray:
    """Columns of all slices now, shape (slices, COLUMNS); NaN in those that concrete does not fill."""
    axis, edges = stations.axis, np.array(stations.edges)
    found = np.full((len(edges) - 1, len(COLUMNS)), np.nan)
    spheres = _Spheres(model, state, axis)
    if not np.any(spheres.solid):
        return found
    order = np.argsort(spheres.s, kind="stable")
    total = np.cumsum(spheres.share[order])
    front = spheres.s[order][np.searchsorted(total, FRONT * total[-1])]
    full = (edges[:-1] >= travel) & (edges[1:] <= front)
    volumes = stations.volumes()
    found[:, :2] = _stresses(stations, model, state, spheres) / volumes[:, None]
    found[:, 2] = spheres.wall_shear(stations, model, state) / stations.surfaces()
    ring = np.minimum((RINGS * spheres.apart / stations.bores.at(spheres.s)).astype(int), RINGS - 1)
    member = [ring == number for number in range(RINGS)]
    columns = np.stack([np.ones(len(ring)), spheres.density, spheres.speed, *member, *member], axis=1)
    columns[:, 3 + RINGS :] *= spheres.speed[:, None]
    sums = spheres.in_slices(edges, columns)
    found[:, 3:5] = sums[:, :2] / volumes[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        found[:, 5] = sums[:, 2] / sums[:, 0]
        found[:, 6:] = sums[:, 3 + RINGS :] / sums[:, 3 : 3 + RINGS]
    found[~full] = np.nan
    return found


def losses(stations: Stations, table: dict[str, np.ndarray], gravity: tuple[float, float, float]) -> dict[str, float]:
    """What friction takes along a pipe, from a table of stations; weight is left out.

    Of a straight pipe the gradient [Pa/m] and wall stress [Pa]; else those of the straight stretches before and behind
    the middle, by lines through what lies a radius off their ends; what the stress along the pipe loses between these
    lines over the middle [Pa]; and that over what a straight pipe would take there. Friction rises with pressure, so
    that of the straight pipe is the logarithmic mean of 4 tau / d at both ends of the middle, which is exact where it
    rises linearly. `flux_ratio` is what leaves over what enters, by solid volume. Empty where too few slices are full.
    """
    s = stations.places
    slope = table["bulk_density"] * (stations.axis.at(s)[1] @ np.array(gravity))
    steps = 0.5 * (slope[1:] + slope[:-1]) * np.diff(s)
    weight = np.concatenate([[0.0], np.cumsum(np.where(np.isfinite(steps), steps, 0.0))])
    stress, shear = table["axial_stress"] - weight, table["wall_stress"]
    flux = table["velocity"] * table["solid_fraction"] * table["radius"] ** 2

    def lines(low: float, high: float) -> _Straight | None:
        here = stations.clear(low, high) & np.isfinite(stress)
        if np.count_nonzero(here) < FEWEST:
            return None
        return _Straight(*(np.polyfit(s[here], each[here], 1) for each in (stress, shear)),
                         float(shear[here].mean()), float(flux[here].mean()))  # fmt: skip

    stretches = [lines(*ends) for ends in stations.straights]
    if stations.middle is None:
        found = stretches[0]
        return {} if found is None else {"gradient": -found.stress[0], "wall_stress": found.mean}
    begin, end = stations.middle
    before, behind = stretches
    result: dict[str, float] = {}
    for name, found in (("upstream", before), ("downstream", behind)):
        if found is not None:
            result |= {f"{name}_gradient": -found.stress[0], f"{name}_wall_stress": found.mean}
    if before is not None and behind is not None:
        loss = float(np.polyval(before.stress, begin) - np.polyval(behind.stress, end))
        there = [2 * np.polyval(line.shear, place) / stations.bores.at(place)
                 for line, place in ((before, begin), (behind, end))]  # fmt: skip
        result |= {"middle_loss": loss, "flux_ratio": behind.flux / before.flux}
        if min(there) > 0:
            result["middle_ratio"] = loss / (_logarithmic_mean(*map(float, there)) * (end - begin))
    return result


@dataclass
class _Straight:
    """Lines through what stations of a straight stretch have, over the arc length; means."""

    stress: np.ndarray
    shear: np.ndarray
    mean: float
    """Of the stress on the wall [Pa]."""
    flux: float


def _logarithmic_mean(a: float, b: float) -> float:
    return a if abs(a - b) < 1e-6 * a else (a - b) / math.log(a / b)


class _Spheres:
    """Spheres of a state, those of a plug left out of what fills the pipe, in the order of permanent numbers."""

    def __init__(self, model: Model, state: State, axis: Axis) -> None:
        self.order = np.argsort(state.spheres.id.numpy())
        position = state.spheres.position.numpy().astype(float)[self.order]
        body = state.spheres.body.numpy()[self.order]
        self.centre, self.radius, self.body = position[:, :3], position[:, 3], body
        self.nearest, self.s = axis.projected(self.centre)
        self.tangent = axis.at(self.s)[1]
        self.apart = np.linalg.norm(self.centre - self.nearest, axis=1)
        self.solid = state.bodies.group.numpy()[body] == 0
        # Overlaps inside a clump count once: its spheres share its volume by their own.
        own = self.radius**3
        whole = np.bincount(body, own, state.body_count)[body]
        size = state.bodies.size.numpy().astype(float)[body]
        self.share = np.where(self.solid, np.pi / 6 * size**3 * own / whole, 0.0)
        self.density = state.bodies.mass.numpy().astype(float)[body] / (np.pi / 6 * size**3)
        velocity = state.spheres.velocity.numpy().astype(float)[self.order, :3]
        self.speed = np.einsum("ij,ij->i", velocity, self.tangent)
        self.middle = state.bodies.position.numpy().astype(float)

    def in_slices(self, edges: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Sums over slices of columns (n, k), each times the solid volume of a sphere in a slice [m3], which planes
        across the axis cut; shape (slices, k).
        """
        found = np.zeros((len(edges) - 1, columns.shape[1]))
        for here, slices in _reached(self.s - self.radius, self.s + self.radius, edges):
            # Part of a sphere's volume below planes z radii above its centre.
            z = [np.clip((edges[slices + k] - self.s[here]) / self.radius[here], -1, 1) for k in (0, 1)]
            below, under = (0.25 * (2 + 3 * height - height**3) for height in z)
            volume = self.share[here] * (under - below)
            for column in range(columns.shape[1]):
                found[:, column] += np.bincount(slices, volume * columns[here, column], len(found))
        return found

    def wall_shear(self, stations: Stations, model: Model, state: State) -> np.ndarray:
        """Force along the wall against the flow, in each slice [N]."""
        push, arm, wall = _wall_pushes(model, state, self.order)
        total = np.zeros(len(stations.edges) - 1)
        number = [w.name for w in model.walls].index(stations.wall)
        for slot in range(push.shape[1]):
            here = (wall[:, slot] == number) & self.solid & np.any(arm[:, slot] != 0, axis=1)
            n = arm[here, slot] / np.linalg.norm(arm[here, slot], axis=1, keepdims=True)
            along = push[here, slot] - np.einsum("ij,ij->i", push[here, slot], n)[:, None] * n
            # Along the wall: of a cone's, that is not along the axis.
            way = self.tangent[here] - np.einsum("ij,ij->i", self.tangent[here], n)[:, None] * n
            way /= np.linalg.norm(way, axis=1, keepdims=True)
            drag = -np.einsum("ij,ij->i", along, way)
            total += _shared(self.s[here], self.s[here], drag[:, None], np.array(stations.edges))[:, 0]
        return total


def _stresses(stations: Stations, model: Model, state: State, spheres: _Spheres) -> np.ndarray:
    """Sums over contacts in each slice [J]: a third of force times branch, and that along the pipe, shape (slices, 2).

    Both are positive where contacts push.
    """
    edges, axis = np.array(stations.edges), stations.axis
    body_s = axis.projected(spheres.middle)[1]
    _probe(model, state)
    push = _arrays(state)[0].numpy()
    i, j, place = listed_pairs(state)
    number, body = state.spheres.id.numpy(), state.spheres.body.numpy()
    order = np.lexsort((np.maximum(number[i], number[j]), np.minimum(number[i], number[j])))
    i, j, place = i[order], j[order], place[order]
    force = push[place].astype(float)
    acts = np.any(force != 0, axis=1)
    first, second, force = body[i[acts]], body[j[acts]], force[acts]
    branch = spheres.middle[second] - spheres.middle[first]
    total = _of_contacts(axis, edges, body_s[first], body_s[second], force, branch)
    pushes, arms, _ = _wall_pushes(model, state, spheres.order)
    for slot in range(pushes.shape[1]):
        here = np.any(arms[:, slot] != 0, axis=1)
        point = spheres.centre[here] + arms[here, slot]
        middle = spheres.middle[spheres.body[here]]
        total += _of_contacts(axis, edges, body_s[spheres.body[here]], axis.projected(point)[1], pushes[here, slot],
                              point - middle)  # fmt: skip
    return total


def _of_contacts(
    axis: Axis, edges: np.ndarray, begin: np.ndarray, end: np.ndarray, force: np.ndarray, branch: np.ndarray
) -> np.ndarray:
    tangent = axis.at(0.5 * (begin + end))[1]
    along = -np.einsum("ij,ij->i", force, tangent) * np.einsum("ij,ij->i", branch, tangent)
    each = np.stack([-np.einsum("ij,ij->i", force, branch) / 3, along], axis=1)
    return _shared(begin, end, each, edges)


def _shared(begin: np.ndarray, end: np.ndarray, values: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Sums of values (n, k) in slices (m,), where each is spread evenly from one arc length to another [m]."""
    # A wall touches across the pipe, without any width: one that does not round away.
    width = np.maximum(np.abs(end - begin), 1e-6)
    low = 0.5 * (begin + end - width)
    found = np.zeros((len(edges) - 1, values.shape[1]))
    for here, slices in _reached(low, low + width, edges):
        inside = np.minimum(low[here] + width[here], edges[slices + 1]) - np.maximum(low[here], edges[slices])
        part = np.maximum(inside, 0.0) / width[here]
        for column in range(values.shape[1]):
            found[:, column] += np.bincount(slices, part * values[here, column], len(found))
    return found


def _reached(low: np.ndarray, high: np.ndarray, edges: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Which of some spans reach into a slice, and which slice that is: the first of each, then the second, and on."""
    first, last = (np.searchsorted(edges, end, "right") - 1 for end in (low, high))
    for step in range(int(np.max(last - first, initial=-1)) + 1):
        slices = first + step
        here = np.flatnonzero((slices <= last) & (slices >= 0) & (slices < len(edges) - 1))
        yield here, slices[here]


def _wall_pushes(model: Model, state: State, order: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of spheres in an order, slot by slot: forces of walls [N], arms from their centres [m], numbers of the walls."""
    push, arm = (array.numpy().astype(float)[order] for array in _arrays(state)[1:])
    wall = np.broadcast_to(np.arange(push.shape[1]), push.shape[:2]).copy()
    if model.features.meshes:
        wall[:, model.analytic_walls :] = state.slots.wall.numpy()[order][:, model.analytic_walls :]
    return push, arm, wall


def _arrays(state: State) -> tuple[wp.array, wp.array, wp.array]:
    vec3 = types(state.model.scalar).vec3
    slots = state.slots.history.shape[1]
    return (
        state.scratch("pair pushes", (len(state.pairs.other),), vec3),
        state.scratch("wall pushes", (state.sphere_count, slots), vec3),
        state.scratch("wall arms", (state.sphere_count, slots), vec3),
    )


def _probe(model: Model, state: State) -> None:
    """Fill the arrays of forces."""
    f, batch = model.features, state.batch
    pair_push, wall_push, wall_arm = _arrays(state)
    kernel = force_probe(model.scalar, f.pair_law, f.wall_law, f.half_list, f.history, f.bonds)
    base = int(batch.rows["spheres"][state.index])
    stages = []
    for first, last in pairwise(state.chunks):
        given: dict[str, Any] = {"s": state.index, "first": base + first, "last": base + last, "pair_push": pair_push,
                                 "wall_push": wall_push, "wall_arm": wall_arm}  # fmt: skip
        bound = {name: given[name] if name in given else getattr(batch, name) for name in parameter_names(kernel)}
        stages.append(Stage(kernel, last - first, bound, batch.device, block=DEFAULT_BLOCK))
    recorded = state.launches(batch.version)
    if "forces" not in recorded:
        recorded["forces"] = at_once(stages, batch.device)
    recorded["forces"]()
