"""Wear of walls: sliding and impacts on each patch of a wall since t = 0, and the depth worn according to Archard.

Each time step adds the sliding and the impacts of every sphere on every wall to sums that belong to the sphere. When a
sample is taken, these sums are credited to the patch that the sphere touched last, and start again at zero. The totals
are therefore exact, and their places on the wall are accurate to the distance that a sphere moves between two samples.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from ...geometry.axis import Arc, Axis
from ...geometry.meshes import faces_at, rays
from ...geometry.walls import MeshWall, PipeWall, PlaneWall, Wall
from ..engine.state import State
from ..scene.scene import Wear

PATCHES_AROUND = 24
"""Default number of wear patches around the circumference of a pipe."""
MOST_AROUND, MOST_PATCHES = 3600, 1_000_000
COLUMNS = ("sliding_work", "impact_loss", "load_way")
"""Names of the wear quantities, which are recorded for each patch, and in the time series for each wall as a whole.

The quantities are the work of sliding [J], the energy lost in impacts [J], and normal force times sliding distance [N
m].
"""
UNITS = {"sliding_work": "J", "impact_loss": "J", "load_way": "N m"}
HOUR = 3600.0
RAY_TOLERANCE = 1e-4
"""Tolerance of the test whether a triangle of a wall is visible from the pipe's axis, divided by the triangle's
distance from the axis.

The test follows a ray from the axis towards the triangle to the first surface that it hits. The triangle counts as
visible if it lies behind that surface by no more than the tolerance.
"""


class Patches(ABC):
    """Base class of divisions of a wall into patches, for which wear is summed separately."""

    areas: np.ndarray
    """Areas of the patches [m2], shape (patches,); infinite for an unbounded plane."""

    @abstractmethod
    def of(self, points: np.ndarray) -> np.ndarray:
        """Return the patch number of each of `points` (n, 3), given in the wall's frame [m]."""

    def surface(self) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """Return vertices [m], triangles and the patch of each vertex of a mesh that shows the wall, or None.

        The result is None if the wall is not drawn. The shapes are (v, 3), (f, 3) and (v,).
        """
        return None


class PlanePatch(Patches):
    """Division of a plane wall for the wear measurement: the whole plane is a single patch."""

    def __init__(self, wall: PlaneWall) -> None:
        self._wall = wall
        self.areas = np.array([np.pi * wall.drawn_radius**2 if wall.drawn_radius > 0 else np.inf])

    def of(self, points: np.ndarray) -> np.ndarray:
        return np.zeros(len(points), int)

    def surface(self) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        drawn = self._wall.drawn()
        return None if drawn is None else (*drawn, np.zeros(len(drawn[0]), int))


class PipePatches(Patches):
    """Division of a pipe wall into stations, which are rings of patches around the axis.

    The stations follow one another along the pipe. All stations have the same number of patches, and patches are
    numbered station by station. Angles around the axis are 0 on the outside of the pipe's bends (in their plane, away
    from the centre). In a straight pipe, the angle 0 is the direction of the axis' normal vector.
    """

    def __init__(self, wall: PipeWall, side: float | None) -> None:
        self.axis, self.radius = wall.axis, wall.radius
        width = side or 2 * np.pi * wall.radius / PATCHES_AROUND
        self.around = int(np.clip(round(2 * np.pi * wall.radius / width), 3, MOST_AROUND))
        self.stations = max(1, min(round(wall.axis.length / width), MOST_PATCHES // self.around))
        self.along = (np.arange(self.stations) + 0.5) * wall.axis.length / self.stations
        """Arc length along the pipe of the middle of each station (ring of patches) [m]."""
        self.angles = 2 * np.pi * np.arange(self.around) / self.around
        """Angle about the pipe's axis at which each patch of a ring has its middle [rad]."""
        self.areas = self._areas(wall.axis.length / self.stations).ravel()

    def _areas(self, long: float) -> np.ndarray:
        """Return the area of each patch [m2]; patches on the outside of a bend are longer than patches on its inside.

        `long` is the length of a patch along the axis [m].
        """
        turn = np.array([next(iter(self._curvature(s)), 0.0) for s in self.along])
        lever = self.radius * np.cos(self.angles)
        return long * 2 * np.pi * self.radius / self.around * (1 + turn[:, None] * lever[None])

    def _curvature(self, s: float):
        begin = 0.0
        for segment in self.axis.segments():
            piece = segment["piece"]
            if begin <= s <= begin + piece.length and isinstance(piece, Arc):
                _, _, normal, _ = self.axis.frame(begin)
                # The frame of the axis does not rotate about the tangent along the pipe. If two bends turn to opposite
                # sides, their outsides therefore lie at opposite angles.
                yield float(np.sign(normal[0] @ segment["outward"])) / piece.radius
            begin += piece.length

    def place(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the arc length along the axis [m] and the angle around it [rad] of each of `points` (n, 3)."""
        s = self.axis.along(points)
        centre, _, normal, side = self.axis.frame(s)
        offset = points - centre
        return s, np.arctan2(np.sum(offset * side, 1), np.sum(offset * normal, 1))

    def of(self, points: np.ndarray) -> np.ndarray:
        s, angle = self.place(points)
        row = np.clip((s / self.axis.length * self.stations).astype(int), 0, self.stations - 1)
        column = np.rint(angle / (2 * np.pi) * self.around).astype(int) % self.around
        return row * self.around + column

    def surface(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return a mesh for drawing, with a vertex in the middle of each patch and rings of vertices at both ends."""
        length = self.axis.length
        s = np.concatenate([[0.0], self.along, [length]])
        points, _, normal, side = self.axis.frame(s)
        ring = np.cos(self.angles)[None, :, None] * normal[:, None] + np.sin(self.angles)[None, :, None] * side[:, None]
        vertices = (points[:, None] + self.radius * ring).reshape(-1, 3)
        n = self.around
        row, column = np.meshgrid(np.arange(len(s) - 1), np.arange(n), indexing="ij")
        a, b = (row * n + column).ravel(), (row * n + (column + 1) % n).ravel()
        faces = np.concatenate([np.stack([a, a + n, b], 1), np.stack([b, a + n, b + n], 1)])
        station = np.clip(np.arange(len(s)) - 1, 0, self.stations - 1)
        return vertices, faces, (station[:, None] * n + np.arange(n)).ravel()


class MeshPatches(Patches):
    """Division of a mesh wall into patches: each triangle is one patch, even if several triangles coincide.

    The wear of coinciding triangles is credited to the first of them.
    """

    def __init__(self, wall: MeshWall) -> None:
        self._wall = wall
        vertices, faces, self._origin = wall.surface
        self._cleaned = SimpleNamespace(vertices=vertices, faces=faces)
        a, b, c = (wall.vertices[wall.faces[:, k]] for k in range(3))
        self.areas = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
        self._reach = 2 * float(np.linalg.norm(np.ptp(wall.vertices, axis=0)))

    def of(self, points: np.ndarray) -> np.ndarray:
        return self._origin[np.maximum(faces_at(self._cleaned, points, self._reach), 0)]

    def seen_from(self, axis: Axis) -> np.ndarray:
        """Return a mask of the triangles that are visible from the axis of the pipe, shape (f,).

        If the mesh describes a wall with an inner and an outer surface, these are the triangles of the inner surface.
        """
        middle = self._cleaned.vertices[self._cleaned.faces].mean(axis=1)
        nearest = axis.nearest(middle)
        apart = np.linalg.norm(middle - nearest, axis=1)
        met = rays(self._cleaned, nearest, (middle - nearest) / np.maximum(apart, 1e-30)[:, None], 2 * apart.max())
        seen = np.zeros(len(self.areas), bool)
        seen[self._origin] = (met < 0) | (met > (1 - RAY_TOLERANCE) * apart)
        return seen

    def surface(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        faces = np.arange(3 * len(self.areas)).reshape(-1, 3)
        return self._wall.vertices[self._wall.faces].reshape(-1, 3), faces, np.repeat(np.arange(len(self.areas)), 3)


def patches_of(wall: Wall, side: float | None) -> Patches:
    """Return the division of a wall into patches; the patches of a pipe have sides of about `side` [m]."""
    if isinstance(wall, PipeWall):
        return PipePatches(wall, side)
    return MeshPatches(wall) if isinstance(wall, MeshWall) else PlanePatch(wall)


@dataclass(repr=False)
class WornWall:
    """Sliding, impacts and wear of a wall, patch by patch."""

    name: str
    patches: Any
    """Division of the wall: a :class:`PipePatches`, :class:`MeshPatches` or :class:`PlanePatch`."""
    done: np.ndarray
    """Wear quantities of each patch, named in :data:`COLUMNS` and summed since t = 0, shape (patches, 3)."""
    coefficient: float
    """Coefficient K/H of Archard's law [m2/N]: the dimensionless wear coefficient K divided by the hardness H of the
    wall."""

    def __repr__(self) -> str:
        return f"<WornWall {self.name!r}: {len(self.done)} patches, {self.done[:, 0].sum():.4g} J of sliding>"

    @property
    def sliding(self) -> np.ndarray:
        """Work of sliding on each patch, divided by the area of the patch [J/m2], shape (patches,)."""
        return self.done[:, 0] / self.patches.areas

    @property
    def impacts(self) -> np.ndarray:
        """Energy lost in impacts on each patch, divided by the area of the patch [J/m2], shape (patches,)."""
        return self.done[:, 1] / self.patches.areas

    @property
    def depth(self) -> np.ndarray:
        """Worn depth of each patch [m], shape (patches,).

        The depth is `coefficient` times the sum of normal force times sliding distance, divided by the patch's area.
        """
        return self.coefficient * self.done[:, 2] / self.patches.areas

    def mean_depth(self, chosen: np.ndarray | slice = slice(None)) -> float:
        """Return the mean worn depth of the `chosen` patches, weighted with their areas [m]."""
        return float(self.coefficient * self.done[chosen, 2].sum() / self.patches.areas[chosen].sum())


class WearMap:
    """Wear of every wall of a scene, updated at every sample."""

    def __init__(self, walls: Sequence[Wall], wear: Wear) -> None:
        self.walls = [
            WornWall(wall.name, made := patches_of(wall, wear.patch), np.zeros((len(made.areas), 3)), wear.coefficient)
            for wall in walls
        ]

    def take(self, state: State) -> None:
        """Record the wear since the last call; the wear due to a sphere is credited to the patch it touched last."""
        order = np.argsort(state.spheres.id.numpy())
        worn, points = state.slots.worn.numpy()[order], state.slots.worn_at.numpy()[order].astype(float)
        state.slots.worn.zero_()
        for number, wall in enumerate(self.walls):
            met = np.flatnonzero(np.any(worn[:, number] != 0, axis=1))
            if len(met):
                patch = wall.patches.of(points[met, number])
                for column in range(3):
                    weights = worn[met, number, column]
                    wall.done[:, column] += np.bincount(patch, weights, minlength=len(wall.done))

    def columns(self) -> dict[str, float]:
        """Return the wear quantities of each wall, summed over its patches, by column name of the time series."""
        return {
            f"{wall.name}_{name}": float(wall.done[:, column].sum())
            for wall in self.walls
            for column, name in enumerate(COLUMNS)
        }

    def state_dict(self) -> dict[str, np.ndarray]:
        """Return the wear quantities of all patches by wall name, for a checkpoint."""
        return {wall.name: wall.done.copy() for wall in self.walls}

    def load_state_dict(self, state: dict[str, np.ndarray]) -> None:
        """Restore the wear quantities of all patches from a `state_dict`."""
        for wall in self.walls:
            wall.done = np.array(state[wall.name])

    @property
    def main(self) -> WornWall | None:
        """Most worn wall among pipes and meshes.

        If the scene has none, it is the most worn plane of finite area, or None.
        """
        bounded_walls = [wall for wall in self.walls if np.isfinite(wall.patches.areas).all()]
        shaped = [wall for wall in bounded_walls if not isinstance(wall.patches, PlanePatch)] or bounded_walls
        return max(shaped, key=lambda wall: wall.done[:, 2].sum()) if shaped else None
