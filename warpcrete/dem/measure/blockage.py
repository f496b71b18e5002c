"""Detect and locate the blockage of a pipe during a run, from the motion and the contact forces of the aggregates.

A pipe counts as blocked if three conditions hold:

- A part of the concrete hardly moves although the piston advances.
- The part stands still for longer than the compression of the concrete behind it can explain.
- The pressure rises.
"""

from typing import Any

import numpy as np

from ...core.records import SavedState
from ...geometry.meshes import rays
from ...geometry.walls import MeshWall, PipeWall
from ..engine.model import Model
from ..engine.state import State
from ..scene.slices import varying_bores
from .probes import pair_forces

PARTS = 20
"""Number of parts of equal volume into which the concrete is divided along the pipe, to find out whether one of them
stands still. There are fewer parts if there are few aggregates."""
STONES = 5
"""Minimum number of aggregates in each part into which the concrete is divided to detect a part that stands still."""
CHECKS_PER_WINDOW = 8
"""Number of checks for blockage while the piston moves by `BlockageWatch.window`.

A pipe counts as blocked if a part of the concrete stands still during such a window and the pressure rises.
"""
STANDING_RATIO = 0.2
"""Largest advance of a part of the concrete, divided by the advance of the piston, at which the part counts as standing
still; both advances are measured by volume.

In runs without blockage the ratio was at least 0.9 for all parts once they moved. Advances count by volume, so a
widening of the bore does not lower the ratio. In a closed pipe, too, the last part advances a little, because the
concrete ahead of it is compressed.
"""
GRADIENT = 200e3
"""Pressure gradient that pumping never reaches [Pa/m]; 5 to 50 kPa/m are usual."""
OPPOSITE = np.radians(150.0)
"""Smallest angle [rad] around the pipe's axis between two wall contacts that counts as opposite sides of the wall."""
QUADRATURE = 24
"""Number of directions across the axis in which the bore's radius is measured to find the area of its cross-section."""


class BlockageWatch:
    """Detector of blockages: at intervals of piston travel, it compares the motion of the concrete with the piston's.

    The detector records the first blockage of the pipe.
    """

    def __init__(self, model: Model, state: State) -> None:
        self.model, self.state = model, state
        pipe, blockage = model.scene.pipe, model.scene.blockage
        assert pipe is not None and blockage is not None
        self.axis, self.radius = pipe.axis, pipe.radius
        self.bores = varying_bores(model.scene.stations)
        """Radii of the pipe's bore along its axis; None if the radius is the same everywhere."""
        self.window = blockage.travel or blockage_travel(2 * pipe.radius, pipe.concrete_length, model.stress_scale)
        """Piston travel [m] during which a part of the concrete must stand still before the pipe counts as blocked."""
        self.found: dict[str, float] = {}
        """Position, time, pressure and so on of the first blockage, by name; empty while the pipe is not blocked."""
        self.slowest = np.nan
        """Advance of the slowest part of the concrete, divided by the advance of the piston, between the last two
        checks. Both advances are measured by volume. Before the second check the ratio is NaN."""
        self._checked_travel = -np.inf
        self._stand_travel: float | None = None
        self._pressure = 0.0
        self._places = np.zeros(0)
        # Permanent numbers of the aggregates, without the balls that close the front of the concrete. `_volume`
        # contains the volumes of these aggregates [m3].
        self._numbers: np.ndarray | None = None
        self._volume = np.zeros(0)

    def state_dict(self) -> SavedState:
        """Return the recorded blockage and everything that the next check depends on, for a checkpoint."""
        return {
            "found": dict(self.found),
            "looked": self._checked_travel,
            "standing": self._stand_travel,
            "pressure": self._pressure,
            "places": self._places,
            "slowest": self.slowest,
        }

    def load_state_dict(self, state: SavedState) -> None:
        """Restore the recorded blockage and the data for the next check from a `state_dict`."""
        self.found, self._places = dict(state["found"]), np.array(state["places"])
        self.slowest = float(state["slowest"])
        self._checked_travel, self._pressure = float(state["looked"]), float(state["pressure"])
        self._stand_travel = None if state["standing"] is None else float(state["standing"])

    def __call__(self, row: dict[str, float]) -> None:
        """Check for a blockage if the piston has advanced far enough since the last check.

        `row` contains the recorded values of one sample by name.
        """
        travel = row.get("travel", 0.0)
        if self.found or travel < self._checked_travel + self.window / CHECKS_PER_WINDOW or self.state.body_count == 0:
            return
        s, volume = self._aggregates()
        if len(s) < STONES:
            return
        if self._checked_travel >= 0:
            moved = self._places + self._widening(0.5 * (self._places + s)) * (s - self._places)
            least = least_advance(self._places, moved, volume, self.axis.length) / (travel - self._checked_travel)
            self.slowest = least
            if least >= STANDING_RATIO:
                self._stand_travel = None
            elif self._stand_travel is None:
                self._stand_travel, self._pressure = self._checked_travel, row["pressure"]
            elif travel - self._stand_travel >= self.window and row["pressure"] > self._pressure:
                self.found = self._describe(row, s, volume)
        self._checked_travel, self._places = travel, s

    def _widening(self, s: np.ndarray) -> np.ndarray | float:
        """Return the area of the bore at the arc lengths `s` [m], divided by its area at the piston.

        An aggregate in a narrower bore moves faster than the piston. Its advance times this ratio is the travel of a
        piston that displaces the same volume.
        """
        return 1.0 if self.bores is None else (self.bores.at(s) / self.radius) ** 2

    def _aggregates(self) -> tuple[np.ndarray, np.ndarray]:
        """Return arc lengths [m] and volumes [m3] of the aggregates, in the order of their permanent numbers."""
        bodies = self.state.bodies
        number, position = self.state.batch.exchange.read(bodies.id, bodies.position)
        place = np.empty(self.state.body_count, dtype=int)
        place[number] = np.arange(len(place))
        if self._numbers is None:
            self._numbers = np.flatnonzero(bodies.group.numpy()[place] == 0)
            size = bodies.size.numpy()[place][self._numbers].astype(float)
            self._volume = np.pi / 6 * size**3
        return self.axis.along(position[place[self._numbers]].astype(float)), self._volume

    def _describe(self, row: dict[str, float], s: np.ndarray, volume: np.ndarray) -> dict[str, float]:
        assert self._stand_travel is not None
        wide = 2 * (self.radius if self.bores is None else self.bores.smallest)
        stations = np.arange(row["travel"], min(float(s.max()), self.axis.length) + 0.25 * wide, 0.25 * wide)
        forces, places, chains = axial_forces(self.model, self.state, self.axis)
        at = last_loaded(stations, forces, places)
        radius = self.radius if self.bores is None else float(self.bores.at(at))
        slab = np.abs(s - at) < 0.5 * radius
        solid = volume[slab].sum() / (bore_area(self.model.walls, self.axis, radius, at) * radius)
        return {
            "at": at,
            "time": row["time"],
            "travel": self._stand_travel,
            "pressure": row["pressure"],
            "pressure_before": self._pressure,
            "solid_fraction": float(solid),
            "chains": float(count_spanning_networks(self.model, self.state, self.axis, at, 2 * radius, chains)),
        }


def blockage_travel(diameter: float, length: float, modulus: float) -> float:
    """Return the piston travel [m] after which concrete that has not moved counts as blocked.

    The piston compresses the concrete, which delays the motion of the front. The travel must exceed this compression.
    It is therefore the compression of a column of the given `length` [m] and `modulus` [Pa] under a pressure gradient
    that pumping never reaches. Two limits apply:

    - The travel is at least length / 20. The soft aggregates of Zhan (2019, 1e5 Pa) are compressed by up to this length
      before their front moves.
    - The travel is at most the pipe `diameter` [m]. If the diameter is not between length / 10 and length / 5, the
      nearer of these two lengths is the maximum instead.
    """
    most = max(min(diameter, length / 5), length / 10)
    return min(max(length * GRADIENT * length / modulus, length / 20), most)


def least_advance(before: np.ndarray, after: np.ndarray, volume: np.ndarray, end: float) -> float:
    """Return the smallest advance of any part of the concrete [m].

    The concrete is divided along the pipe into parts of equal volume. The advance of a part is the volume-weighted
    median of the advances of its aggregates. `before` and `after` are the arc lengths [m] of all aggregates before and
    after the motion, and `volume` holds their volumes [m3]; each array has the shape (n,). Aggregates that were already
    past the arc length `end` [m] of the pipe's outlet do not count.
    """
    inside = np.flatnonzero(before <= end)
    if len(inside) == 0:
        return np.inf
    # Sort the aggregates along the pipe and divide them by their cumulative volume into parts of equal volume.
    order = inside[np.argsort(before[inside])]
    rank = np.cumsum(volume[order]) - 0.5 * volume[order]
    parts = max(1, min(PARTS, len(inside) // STONES))
    part = (parts * rank / volume[order].sum()).astype(int)
    way, weight = (after - before)[order], volume[order]
    edges = np.flatnonzero(np.diff(part)) + 1  # Index of the first aggregate of each part except the first part.
    return min(map(_median, np.split(way, edges), np.split(weight, edges)))


def _median(values: np.ndarray, weights: np.ndarray) -> float:
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(total, 0.5 * total[-1])]])


def axial_forces(model: Model, state: State, axis: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return forces along the pipe between touching spheres, where they act, and the pairs of bodies in strong contact.

    - The axial part of the normal force of each touching pair [N], shape (m,).
    - The arc lengths of both sphere centres of each pair, the lower arc length first [m], shape (m, 2).
    - The indices of the two bodies of each strong contact in the body arrays, shape (k, 2). The normal force of a
      strong contact exceeds the mean normal force.
    """
    i, j, force = pair_forces(model, state)
    body, centre = state.spheres.body.numpy(), state.spheres.position.numpy()[:, :3].astype(float)
    middle = axis.along(0.5 * (centre[i] + centre[j]))
    _, tangent = axis.at(middle)
    apart = centre[j] - centre[i]
    apart /= np.maximum(np.linalg.norm(apart, axis=1), 1e-300)[:, None]
    lean = np.abs(np.sum(apart * tangent, axis=1))
    half = 0.5 * np.linalg.norm(centre[j] - centre[i], axis=1) * lean
    places = np.stack([middle - half, middle + half], axis=1)
    strong = force > force[force > 0].mean() if np.any(force > 0) else np.zeros(len(force), bool)
    return force * lean, places, np.stack([body[i], body[j]], axis=1)[strong]


def last_loaded(stations: np.ndarray, forces: np.ndarray, places: np.ndarray) -> float:
    """Return the arc length [m] of the last cross-section along the pipe with at least half the largest axial force.

    The cross-sections lie at the arc lengths `stations` [m]. The axial force through a cross-section is the sum of the
    `forces` [N] of the contacts that cross it. `places` [m] has the arc lengths of both ends of each contact.
    :func:`axial_forces` returns `forces` and `places`.
    """
    carried = np.array([forces[(places[:, 0] < s) & (places[:, 1] >= s)].sum() for s in stations])
    return float(stations[np.flatnonzero(carried >= 0.5 * carried.max())[-1]]) if len(stations) else 0.0


def count_spanning_networks(model: Model, state: State, axis: Any, at: float, length: float, chains: np.ndarray) -> int:
    """Count the separate networks of strong contacts that connect opposite sides of the wall near one cross-section.

    The cross-section is at the arc length `at` [m]; only bodies within `length` / 2 [m] of it count. `chains` contains
    the index pairs of the bodies in strong contact, as :func:`axial_forces` returns them.
    """
    position = state.bodies.position.numpy().astype(float)
    s = axis.along(position)
    here = np.abs(s - at) < 0.5 * length
    # With a union-find structure, join bodies into networks: bodies in strong contact belong to the same network.
    parent = np.arange(len(position))

    def root(k: int) -> int:
        while parent[k] != k:
            parent[k] = parent[parent[k]]
            k = parent[k]
        return k

    for a, b in chains:
        if here[a] and here[b]:
            parent[root(int(a))] = root(int(b))
    body, point = wall_contacts(model, state)
    touching = here[body]
    body, point = body[touching], point[touching]
    centre, _, normal, side = axis.frame(axis.along(point))
    angle = np.arctan2(np.sum((point - centre) * side, 1), np.sum((point - centre) * normal, 1))
    linked = np.zeros(len(position), bool)
    linked[chains.ravel()] = True
    roots = np.array([root(int(b)) for b in body], int)
    # Count a network as spanning the pipe if two of its wall contacts lie on opposite sides of the axis.
    count = 0
    for one in np.unique(roots[linked[body]]):
        mine = angle[(roots == one) & linked[body]]
        apart = np.abs(np.angle(np.exp(1j * (mine[:, None] - mine[None]))))
        count += bool(np.any(apart >= OPPOSITE))
    return count


def wall_contacts(model: Model, state: State) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices of bodies that touch a pipe or mesh, shape (m,), and the contact points [m], shape (m, 3)."""
    centre = state.spheres.position.numpy().astype(float)
    body, places, points = state.spheres.body.numpy(), [], []
    for wall in model.walls:
        if isinstance(wall, PipeWall):
            nearest = wall.axis.nearest(centre[:, :3])
            offset = centre[:, :3] - nearest
            apart = np.linalg.norm(offset, axis=1)
            touching = np.flatnonzero(apart + centre[:, 3] > wall.radius)
            places.append(body[touching])
            points.append(nearest[touching] + wall.radius * (offset / np.maximum(apart, 1e-12)[:, None])[touching])
    if model.features.meshes:
        met, normal = state.slots.wall.numpy(), state.slots.normal.numpy().astype(float)
        sphere, slot = np.nonzero(met >= 0)
        places.append(body[sphere])
        points.append(centre[sphere, :3] + centre[sphere, 3:] * normal[sphere, slot])
    if not places:
        return np.zeros(0, int), np.zeros((0, 3))
    return np.concatenate(places), np.concatenate(points)


def bore_area(walls: Any, axis: Any, radius: float, at: float) -> float:
    """Return the cross-sectional area of the bore at the arc length `at` [m2].

    Rays across the axis measure the distance to fixed meshes. If no closed mesh surrounds the axis, the result is the
    area of a circle of `radius` [m].
    """
    area = np.pi * radius**2
    point, _, normal, side = axis.frame(at)
    angle = 2 * np.pi * (np.arange(QUADRATURE) + 0.382) / QUADRATURE
    directions = np.cos(angle)[:, None] * normal + np.sin(angle)[:, None] * side
    for wall in walls:
        if isinstance(wall, MeshWall) and wall.motion is None:
            reach = rays(wall, np.repeat(point, QUADRATURE, 0), directions, 10 * radius)
            if np.all(reach >= 0):
                area = min(area, float(np.pi * np.mean(reach**2)))
    return area
