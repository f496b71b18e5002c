"""Random placement of clumps without overlaps: rigid bodies of spheres with random orientations."""

from dataclasses import replace

import numpy as np

from ..core.device.interrupts import stop_if_requested
from ..geometry.rotation import random_orientations
from .aggregates import Aggregates, Spheres, rotated
from .nearby import CLEARANCE, ITERATIONS, MARGIN, SWEEPS, Distance, Draw, close_pairs, draw_between


class _Packing:
    """Clumps that the placement moves and turns until they do not overlap, and the spheres of which they consist."""

    def __init__(self, aggregates: Aggregates, distance: Distance, period: float, rng: np.random.Generator) -> None:
        self.parts, self.distance, self.period, self.rng = Spheres(aggregates), distance, period, rng
        self.count, self.radii = aggregates.count, self.parts.radius
        self.centre, self.turn = np.zeros((self.count, 3)), random_orientations(self.count, rng)
        reach = np.linalg.norm(self.parts.offset, axis=1) + self.radii
        self.extent = np.maximum.reduceat(reach, self.parts.first[:-1])

    def spheres(self, centre: np.ndarray | None = None, turn: np.ndarray | None = None) -> np.ndarray:
        """Return the centres of all spheres [m], shape (m, 3).

        `centre` and `turn` are the centres [m], shape (n, 3), and the orientations, shape (n, 4), of the clumps. The
        present ones are used where an argument is None.
        """
        return self.parts.centres(self.centre if centre is None else centre, self.turn if turn is None else turn)

    def any_of(self, spheres: np.ndarray) -> np.ndarray:
        """Return a mask of the clumps that contain a marked sphere, shape (n,).

        `spheres` is the mask of the marked spheres, shape (m,).
        """
        return np.logical_or.reduceat(spheres, self.parts.first[:-1])

    def start(self, draw: Draw) -> bool:
        """Move all clumps to random places where they overlap no wall, and return whether this succeeded for all."""
        left = np.ones(self.count, bool)
        for _ in range(ITERATIONS):
            stop_if_requested()
            number = int(left.sum())
            self.centre[left], self.turn[left] = draw(self.rng, number), random_orientations(number, self.rng)
            moved = left[self.parts.body]
            blocked = np.zeros(len(self.radii), bool)
            blocked[moved] = self.distance(self.spheres()[moved]) <= (1 + CLEARANCE) * self.radii[moved]
            left = self.any_of(blocked)
            if not left.any():
                return True
        return False

    def separate(self) -> bool:
        """Push overlapping clumps apart, which also turns them, and return whether no overlap is left."""
        goal, needed = 1 + 0.5 * CLEARANCE + MARGIN, 1 + 0.5 * CLEARANCE
        reach, body = 2 * goal * float(self.radii.max()), self.parts.body
        for _ in range(ITERATIONS):
            stop_if_requested()
            x = self.spheres()
            i, j, d = close_pairs(x, reach, self.period)
            other = body[i] != body[j]
            i, j, d = i[other], j[other], d[other]
            away, sum = np.linalg.norm(d, axis=1), self.radii[i] + self.radii[j]
            room = self.distance(x)
            if np.all(away >= needed * sum) and np.all(room >= (1 + CLEARANCE) * self.radii):
                return True
            deep = away < goal * sum
            i, j, d, away, sum = i[deep], j[deep], d[deep], away[deep], sum[deep]
            push = 0.5 * (goal * sum - away)[:, None] * d / np.maximum(away, 1e-12 * reach)[:, None]
            # If several spheres of one clump overlap spheres of another clump, average their pushes instead of adding
            # them up.
            push /= _repetitions(body[i] * self.count + body[j])[:, None]
            self._push(np.concatenate([i, j]), np.concatenate([-push, push]))
            self._leave_walls()
        return False

    def _push(self, spheres: np.ndarray, push: np.ndarray) -> None:
        """Move and turn clumps, where `push` are the displacements of some of their spheres [m], shape (k, 3)."""
        body = self.parts.body[spheres]
        arm = rotated(self.turn[body], self.parts.offset[spheres])
        shift, angle = np.zeros((self.count, 3)), np.zeros((self.count, 3))
        np.add.at(shift, body, push)
        np.add.at(angle, body, np.cross(arm, push) / self.extent[body, None] ** 2)
        self.centre += shift
        self.turn = turned(self.turn, angle)

    def _leave_walls(self) -> None:
        """Move each clump whose spheres overlap a wall away from this wall."""
        x = self.spheres()
        depth = (1 + CLEARANCE + MARGIN) * self.radii - self.distance(x)
        close = np.flatnonzero(depth > 0)
        if not len(close):
            return
        step = 1e-3 * float(self.radii.min())
        shifts = step * np.concatenate([np.eye(3), -np.eye(3)])
        around = self.distance((x[close, None] + shifts).reshape(-1, 3)).reshape(-1, 2, 3)
        slope = (around[:, 0] - around[:, 1]) / (2 * step)
        steep = np.linalg.norm(slope, axis=1, keepdims=True)
        push = depth[close, None] * slope / np.maximum(steep, 1e-3)
        self._push(close, push / _repetitions(self.parts.body[close])[:, None])

    def stir(self) -> None:
        """Move and turn each clump several times at random, without overlaps, as `placing` does with spheres."""
        body, number, needed = self.parts.body, len(self.radii), 1 + 0.5 * CLEARANCE
        size = 0.2 * float(self.extent.mean())
        for _ in range(SWEEPS):
            stop_if_requested()
            centre = self.centre + self.rng.uniform(-size, size, self.centre.shape)
            angle = self.rng.uniform(-size, size, self.centre.shape) / self.extent[:, None]
            turn = turned(self.turn, angle)
            old, new = self.spheres(), self.spheres(centre, turn)
            blocked = self.any_of(self.distance(new) < (1 + CLEARANCE) * self.radii)
            i, j, d = close_pairs(np.concatenate([old, new]), 2 * needed * float(self.radii.max()), self.period)
            a, b = i % number, j % number
            overlap = (np.linalg.norm(d, axis=1) < needed * (self.radii[a] + self.radii[b])) & (body[a] != body[b])
            for place in (i, j):
                moved = overlap & (place >= number)
                blocked[body[place[moved] - number]] = True
            self.centre[~blocked], self.turn[~blocked] = centre[~blocked], turn[~blocked]
            size = min(size * (1.1 if np.mean(blocked) < 0.5 else 0.9), float(self.extent.mean()))


def placed_clumps(
    aggregates: Aggregates, low: np.ndarray, high: np.ndarray, distance: Distance, rng: np.random.Generator,
    periodic: bool = False, draw: Draw | None = None,
) -> Aggregates | None:  # fmt: skip
    """Return aggregates at random places and with random orientations, without overlaps, or None if they do not fit.

    :func:`warpcrete.suspension.placing.random_places` explains the parameters.
    """
    period = float(high[2] - low[2]) if periodic else 0.0
    packing = _Packing(aggregates, distance, period, rng)
    if not packing.start(draw or draw_between(low, high)) or not packing.separate():
        return None
    packing.stir()
    centre = packing.centre
    centre = low + np.where([False, False, periodic], (centre - low) % (period or 1.0), centre - low)
    return replace(aggregates, centre=centre, turn=packing.turn)


def turned(turn: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return orientations, shape (n, 4), after further rotations by the vectors `angle` [rad], shape (n, 3)."""
    size = np.linalg.norm(angle, axis=1, keepdims=True)
    axis = angle * np.where(size > 0, np.sin(0.5 * size) / np.where(size > 0, size, 1.0), 0.5)
    part, vector, scalar = np.cos(0.5 * size), turn[:, :3], turn[:, 3:]
    new = np.concatenate(
        [part * vector + scalar * axis + np.cross(axis, vector),
         part * scalar - np.sum(axis * vector, 1, keepdims=True)], 1
    )  # fmt: skip
    return new / np.linalg.norm(new, axis=1, keepdims=True)


def _repetitions(keys: np.ndarray) -> np.ndarray:
    """Return how often each key occurs in an array, shape (n,)."""
    _, place, number = np.unique(keys, return_inverse=True, return_counts=True)
    return number[place]
