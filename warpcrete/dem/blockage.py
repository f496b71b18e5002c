"""Blockage of a pipe: found while a run goes on, and where, by what the concrete does and what its contacts carry.

Blocked is a pipe in which, while the piston goes on, some part of the concrete goes hardly anywhere, for longer than
compression of what lies behind it explains, and the pressure rises.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..geometry.meshes import rays
from ..geometry.walls import MeshWall, PipeWall
from .model import Model
from .probes import pair_forces
from .state import State

PARTS = 20
"""Parts of the concrete, of equal volume, one after the other along the pipe; of few stones fewer parts."""
STONES = 5
"""In a part, at least."""
LOOKS = 8
"""Looks at them in the travel for which they must stand."""
STANDS = 0.2
"""Way of a part over that of the piston, below which it stands: it was 0.9 or more of all parts of sound runs once they
moved; a pipe that widens to twice its diameter leaves 0.25. Of a closed pipe's concrete the last part still goes as
much as what lies before the end is pressed together."""
GRADIENT = 200e3
"""Of pressure along a pipe, above what concrete is pumped with [Pa/m]: 5 to 50 kPa/m are usual."""
OPPOSITE = np.radians(150.0)
"""Angle between places of a wall that a force chain must join to span the pipe."""
QUADRATURE = 24
"""Directions in which a bore is measured."""


class BlockageWatch:
    """Looks at the concrete now and then along the piston's travel; remembers when the pipe was blocked first."""

    def __init__(self, model: Model, state: State) -> None:
        self.model, self.state = model, state
        pipe, blockage = model.scene.pipe, model.scene.blockage
        assert pipe is not None and blockage is not None
        self.axis, self.radius = pipe.axis, pipe.radius
        self.window = blockage.travel or patience(2 * pipe.radius, pipe.concrete_length, model.stress_scale)
        """Travel of the piston for which a part must stand [m]."""
        self.found: dict[str, float] = {}
        """Empty, or what is known of the blockage: see `_describe`."""
        self._looked = -np.inf
        self._standing: float | None = None
        self._pressure = 0.0
        self._places = np.zeros(0)
        # Of the aggregates: permanent numbers, None as long as nobody looked, and volumes [m3].
        self._numbers: np.ndarray | None = None
        self._volume = np.zeros(0)
        self._begun: Callable[[], list[np.ndarray]] | None = None

    def state_dict(self) -> dict[str, Any]:
        """What the next look depends on, and what was found."""
        return {
            "found": dict(self.found),
            "looked": self._looked,
            "standing": self._standing,
            "pressure": self._pressure,
            "places": self._places,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from a `state_dict`."""
        self.found, self._places = dict(state["found"]), np.array(state["places"])
        self._looked, self._pressure = float(state["looked"]), float(state["pressure"])
        self._standing = None if state["standing"] is None else float(state["standing"])

    def is_due(self, travel: float) -> bool:
        """Whether it looks at a row of this travel of the piston [m]."""
        return not self.found and travel >= self._looked + self.window / LOOKS and self.state.body_count > 0

    @property
    def may_wait(self) -> bool:
        """Whether a look that is begun may be completed when the run has gone on: it will find no blockage, for which
        some part must have stood at the look before."""
        return self._standing is None and self._numbers is not None

    def begin(self) -> None:
        """Begin a look at the concrete as it is now, which the next row completes if it is due then."""
        self._begun = self._reading()

    def __call__(self, row: dict[str, float]) -> None:
        """Look, if the piston has gone far enough since the last look: as it was when the look was begun, if it was."""
        begun, self._begun = self._begun, None
        travel = row.get("travel", 0.0)
        if not self.is_due(travel):
            return
        s, volume = self._stones(begun or self._reading())
        if len(s) < STONES:
            return
        if self._looked >= 0:
            least = least_advance(self._places, s, volume, self.axis.length) / (travel - self._looked)
            if least >= STANDS:
                self._standing = None
            elif self._standing is None:
                self._standing, self._pressure = self._looked, row["pressure"]
            elif travel - self._standing >= self.window and row["pressure"] > self._pressure:
                self.found = self._describe(row, s, volume)
        self._looked, self._places = travel, s

    def _reading(self) -> Callable[[], list[np.ndarray]]:
        """Permanent numbers and places of all bodies as they are now, on their way."""
        bodies = self.state.bodies
        return self.state.batch.exchange.begin(bodies.id, bodies.position)

    def _stones(self, read: Callable[[], list[np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
        """Arc lengths [m] and volumes [m3] of the aggregates, in the order of permanent numbers."""
        bodies, (number, position) = self.state.bodies, read()
        place = np.empty(self.state.body_count, dtype=int)
        place[number] = np.arange(len(place))
        if self._numbers is None:
            self._numbers = np.flatnonzero(bodies.group.numpy()[place] == 0)
            size = bodies.size.numpy()[place][self._numbers].astype(float)
            self._volume = np.pi / 6 * size**3
        return self.axis.along(position[place[self._numbers]].astype(float)), self._volume

    def _describe(self, row: dict[str, float], s: np.ndarray, volume: np.ndarray) -> dict[str, float]:
        assert self._standing is not None
        wide = 2 * self.radius
        stations = np.arange(row["travel"], min(float(s.max()), self.axis.length) + 0.25 * wide, 0.25 * wide)
        forces, places, chains = loads(self.model, self.state, self.axis)
        at = last_loaded(stations, forces, places)
        slab = np.abs(s - at) < 0.5 * self.radius
        solid = volume[slab].sum() / (bore_area(self.model.walls, self.axis, self.radius, at) * self.radius)
        return {
            "at": at,
            "time": row["time"],
            "travel": self._standing,
            "pressure": row["pressure"],
            "pressure_before": self._pressure,
            "solid_fraction": float(solid),
            "chains": float(spanning(self.model, self.state, self.axis, at, wide, chains)),
        }


def patience(diameter: float, length: float, modulus: float) -> float:
    """Travel of the piston for which part of the concrete must stand [m].

    As much as the column gives under a gradient that no pumping has, but a twentieth of its length, and at most a
    diameter, within a tenth and a fifth of the length: the paper's soft aggregates (1e5 Pa) are pressed together by up
    to a twentieth before their front moves.
    """
    most = max(min(diameter, length / 5), length / 10)
    return min(max(length * GRADIENT * length / modulus, length / 20), most)


def least_advance(before: np.ndarray, after: np.ndarray, volume: np.ndarray, end: float) -> float:
    """The least way of a part of the concrete [m]: the median of its stones by volume, from arc lengths before and
    after; stones past the pipe's `end` [m] do not count."""
    inside = np.flatnonzero(before <= end)
    if len(inside) == 0:
        return np.inf
    order = inside[np.argsort(before[inside])]
    rank = np.cumsum(volume[order]) - 0.5 * volume[order]
    parts = max(1, min(PARTS, len(inside) // STONES))
    part = (parts * rank / volume[order].sum()).astype(int)
    way, weight = (after - before)[order], volume[order]
    edges = np.flatnonzero(np.diff(part)) + 1  # parts follow one another
    return min(map(_median, np.split(way, edges), np.split(weight, edges)))


def _median(values: np.ndarray, weights: np.ndarray) -> float:
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(total, 0.5 * total[-1])]])


def loads(model: Model, state: State, axis: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Axial part of the normal force of every touching pair [N], arc lengths of the lower and higher of its ends
    (m, 2), and the pairs, as places of bodies, that carry more than the mean (k, 2)."""
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
    """The last station [m] whose section still carries half of the largest axial force through its contacts."""
    carried = np.array([forces[(places[:, 0] < s) & (places[:, 1] >= s)].sum() for s in stations])
    return float(stations[np.flatnonzero(carried >= 0.5 * carried.max())[-1]]) if len(stations) else 0.0


def spanning(model: Model, state: State, axis: Any, at: float, length: float, chains: np.ndarray) -> int:
    """How many separate networks of strong contacts join opposite places of the wall within a `length` [m] about a
    station `at` [m]; `chains` are pairs of bodies that carry more than the mean contact."""
    position = state.bodies.position.numpy().astype(float)
    s = axis.along(position)
    here = np.abs(s - at) < 0.5 * length
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
    count = 0
    for one in np.unique(roots[linked[body]]):
        mine = angle[(roots == one) & linked[body]]
        apart = np.abs(np.angle(np.exp(1j * (mine[:, None] - mine[None]))))
        count += bool(np.any(apart >= OPPOSITE))
    return count


def wall_contacts(model: Model, state: State) -> tuple[np.ndarray, np.ndarray]:
    """Bodies, by place, that touch a pipe or a mesh, and where (m, 3) [m]."""
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
    """Cross-section of the bore at an arc length [m2]; of one of `radius` where no mesh is met."""
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
