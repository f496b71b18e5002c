"""Surfaces of concrete as triangles, extracted from a level at the nodes of a grid.

The level is positive in concrete and negative outside it. The surface is a surface net (Gibson, MICCAI 1998): every
edge of the grid on which the level changes its sign gives one face, whose corners lie in the grid's cells around the
edge. Each corner is the mean of the points at which the level is zero on the edges of its cell.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

PLANE_WEIGHT = 1e-6
"""Weight of a point on the plane of a cut or on a side of the grid in the mean of the points of a cell, relative to
points on the free surface."""
FACETS = 64
"""Number of facets around the axis of a surface of revolution."""


@dataclass(frozen=True)
class Level:
    """Level of concrete at the nodes of a rectilinear grid, in cells: positive in concrete, negative outside it."""

    places: tuple[np.ndarray, ...]
    """Coordinates of the nodes along each of the d axes [m]."""
    values: np.ndarray
    """Level at each node, shape (n_1, ..., n_d)."""
    fields: Mapping[str, np.ndarray] = field(default_factory=dict[str, np.ndarray])
    """Quantities at each node, by name, each with the shape of `values`."""

    def mirrored(self, axis: int) -> Level:
        """Return the level on both sides of the plane of symmetry that lies at coordinate 0 of an axis."""
        places = list(self.places)
        places[axis] = np.concatenate([-places[axis][::-1], places[axis]])

        def both(values: np.ndarray) -> np.ndarray:
            return np.concatenate([np.flip(values, axis), values], axis)

        fields = {name: both(values) for name, values in self.fields.items()}
        return Level(tuple(places), both(self.values), fields)

    def cropped(self) -> Level:
        """Return the smallest block of nodes that contains all concrete, with one layer of nodes around it."""
        ranges: list[slice] = []
        for axis in range(self.values.ndim):
            others = tuple(k for k in range(self.values.ndim) if k != axis)
            found = np.flatnonzero((self.values > 0).any(others))
            ranges.append(slice(max(found[0] - 1, 0), found[-1] + 2) if len(found) else slice(0, 0))
        chosen = tuple(ranges)
        places = tuple(place[part] for place, part in zip(self.places, chosen, strict=True))
        return Level(places, self.values[chosen], {name: values[chosen] for name, values in self.fields.items()})


@dataclass(frozen=True)
class Surface:
    """Surface of concrete as triangles, whose corners are in anticlockwise order as seen from outside."""

    vertices: np.ndarray
    """Positions of the vertices [m], shape (v, 3)."""
    faces: np.ndarray
    """Indices of the three vertices of each triangle, shape (f, 3)."""
    normals: np.ndarray
    """Unit vectors that point out of the concrete at the vertices, shape (v, 3)."""
    fields: Mapping[str, np.ndarray]
    """Quantities at the vertices in SI units, by name, each of shape (v,)."""

    @property
    def volume(self) -> float:
        """Volume that a closed surface encloses [m3]."""
        a, b, c = (self.vertices[self.faces[:, k]].astype(float) for k in range(3))
        return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6

    def moved(self, to_scene: Callable[[np.ndarray], np.ndarray]) -> Surface:
        """Return the surface in other axes; `to_scene` maps points of shape (n, 3) without changing distances."""
        ends = to_scene(self.vertices + self.normals)
        vertices = to_scene(self.vertices)
        return replace(self, vertices=vertices, normals=ends - vertices)


@dataclass(frozen=True)
class Cut:
    """Plane that cuts concrete open; the concrete is kept on the side to which the normal points."""

    normal: np.ndarray
    """Unit vector across the plane, shape (d,)."""
    offset: float
    """Distance of the plane from the origin, along the normal [m]."""

    def depth(self, points: np.ndarray) -> np.ndarray:
        """Return how far points of shape (..., d) lie behind the plane [m]; negative in front of it."""
        return points @ self.normal - self.offset


def surface_of(level: Level, cut: Cut | None = None) -> Surface:
    """Return the closed surface of the concrete in a room in space, or of its part behind a plane."""
    net = _Net(level.cropped(), cut)
    return _surface(net.points, triangles(net.sides), net.fields)


def revolved(level: Level, half: bool = False) -> Surface:
    """Return the closed surface that a section in the plane of radius and height sweeps about the axis.

    With `half`, the section sweeps the half of the space with y > 0 only, and closes the surface in the plane y = 0.
    """
    net = _Net(level.mirrored(0).cropped(), filled=True)
    sides = net.sides[np.all(net.points[net.sides, 0] > -1e-12, axis=1)]
    used, sides = np.unique(sides, return_inverse=True)
    sides = sides.reshape(-1, 2)
    points, around = net.points[used], FACETS // 2 + 1 if half else FACETS
    angle = 2 * np.pi * np.arange(around) / FACETS
    radius, height = points.T
    vertices = np.stack([np.outer(f(angle), radius) for f in (np.cos, np.sin)] + [np.tile(height, (around, 1))], 2)
    ring = np.arange(around - 1 if half else around)[:, None]
    here, there = len(used) * ring, len(used) * ((ring + 1) % around)
    a, b = sides.T
    faces = triangles(np.stack([here + a, there + a, there + b, here + b], 2).reshape(-1, 4))
    fields = {name: np.tile(values[used], around) for name, values in net.fields.items()}
    found = _surface(vertices.reshape(-1, 3), faces, fields)
    return _joined(found, _section(net)) if half else found


def _section(net: _Net) -> Surface:
    """Return the filled section of a net in the plane y = 0, seen from the side where y < 0."""
    faces = triangles(net.quads)
    vertices = np.insert(net.points, 1, 0.0, axis=1)
    return Surface(vertices, faces, np.tile([0.0, -1.0, 0.0], (len(vertices), 1)), net.fields)


def _joined(first: Surface, second: Surface) -> Surface:
    faces = np.concatenate([first.faces, second.faces + len(first.vertices)])
    vertices, normals = (
        np.concatenate([getattr(s, name) for s in (first, second)]) for name in ("vertices", "normals")
    )
    fields = {name: np.concatenate([values, second.fields[name]]) for name, values in first.fields.items()}
    return Surface(vertices, faces, normals, fields)


def triangles(quads: np.ndarray) -> np.ndarray:
    """Return quadrilaterals, given by their vertices of shape (n, 4), as two triangles each, shape (2 n, 3)."""
    return quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)


def _surface(vertices: np.ndarray, faces: np.ndarray, fields: Mapping[str, np.ndarray]) -> Surface:
    """Return a surface whose normals are the means of those of the faces, weighted by area, without empty faces."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    size = np.linalg.norm(across, axis=1)
    kept = size > 1e-9 * size.max(initial=0.0)
    faces, across = faces[kept], across[kept]
    corners, shared = faces.ravel(), np.repeat(across, 3, axis=0)
    total = np.stack([np.bincount(corners, shared[:, k], len(vertices)) for k in range(3)], 1)
    normals = total / np.maximum(np.linalg.norm(total, axis=1), 1e-300)[:, None]
    return Surface(vertices, faces, normals, fields)


class _Net:
    """Surface net of a level in two or three dimensions: vertices, and the sides of the surface between them."""

    points: np.ndarray
    """Positions of the vertices [m], shape (v, d)."""
    fields: dict[str, np.ndarray]
    """Quantities at the vertices, means over the nodes in concrete beside them, each of shape (v,)."""
    sides: np.ndarray
    """Vertices of each side: quadrilaterals (n, 4) in space, line segments (n, 2) in a plane.

    Seen from outside, the corners of a quadrilateral are in anticlockwise order. Outside lies on the right of a
    segment.
    """
    quads: np.ndarray
    """Vertices of quadrilaterals that fill the section of the concrete in a plane, shape (n, 4)."""

    def __init__(self, level: Level, cut: Cut | None = None, filled: bool = False) -> None:
        self._axes = level.values.ndim
        self._places = [_padded_places(place) for place in level.places]
        values = _padded(level.values)
        frame = np.ones(values.shape, bool)
        frame[(slice(1, -1),) * self._axes] = False
        # A node beyond the grid gets the opposite level of its neighbour, so that the surface lies midway between them.
        values[frame] = -np.abs(values[frame])
        self._values, self._inside = values, values > 0
        self._depths = None
        if cut is not None:
            self._depths = cut.depth(np.stack(np.meshgrid(*self._places, indexing="ij"), -1))
            self._inside = self._inside & (self._depths > 0)
        self._fields = {name: _padded(each) for name, each in level.fields.items()}
        self._cells = tuple(n - 1 for n in values.shape)
        found = [self._crossings(axis) for axis in range(self._axes)]
        cells, points, inner, free, by_cut = (np.concatenate([part[k] for part in found]) for k in range(5))
        corners = cells.shape[1]
        number = self._numbered(cells)
        flat = number[cells.ravel()]
        # Where a side of the grid or the plane of the cut meets the surface, the surface alone places the vertex, and
        # the vertex then moves onto the plane, so that the edge is sharp.
        weight = np.where(free, 1.0, PLANE_WEIGHT)
        count = np.bincount(flat, np.repeat(weight, corners), self._count)

        def mean(values: np.ndarray) -> np.ndarray:
            return np.bincount(flat, np.repeat(weight * values, corners), self._count) / count

        self.points = np.stack([mean(points[:, k]) for k in range(self._axes)], 1)
        self.fields = {name: mean(each.ravel()[inner]) for name, each in self._fields.items()}
        used = np.unravel_index(np.unique(cells), self._cells)
        for k, place in enumerate(self._places):
            for cell in (0, len(place) - 2):
                self.points[used[k] == cell, k] = 0.5 * (place[cell] + place[cell + 1])
        if cut is not None:
            on_plane = np.bincount(flat, np.repeat(by_cut, corners), self._count) > 0
            self.points[on_plane] -= cut.depth(self.points[on_plane])[:, None] * cut.normal
        self.sides = number[cells]
        if filled:
            self._fill(number)

    def _numbered(self, cells: np.ndarray) -> np.ndarray:
        """Return the number of the vertex in each cell of the grid, where there is one."""
        used = np.zeros(int(np.prod(self._cells)), bool)
        used[cells.ravel()] = True
        self._count = int(np.count_nonzero(used))
        return np.cumsum(used) - 1

    def _crossings(self, axis: int) -> tuple[np.ndarray, ...]:
        """Return the edges of one direction at which the level changes its sign, or which the cut crosses in concrete.

        The results are the cells around each edge (m, 2 or 4) in the order of the side's vertices, the point where the
        level or the depth is zero (m, d), the index of the edge's node in concrete (m,), whether the edge crosses the
        surface inside the grid (m,), and whether it crosses the cut instead (m,).
        """
        low = [slice(None)] * self._axes
        high = list(low)
        low[axis], high[axis] = slice(None, -1), slice(1, None)
        leaves = self._inside[tuple(low)]
        at = np.argwhere(leaves != self._inside[tuple(high)])
        leaves = leaves[tuple(at.T)]
        end = at.copy()
        end[:, axis] += 1
        a, b = self._values[tuple(at.T)], self._values[tuple(end.T)]
        by_cut = (a > 0) == (b > 0)
        if self._depths is not None:
            a, b = (np.where(by_cut, self._depths[tuple(e.T)], v) for v, e in ((a, at), (b, end)))
        free = ~by_cut & (at[:, axis] > 0) & (end[:, axis] < self._values.shape[axis] - 1)
        part = a / (a - b)
        points = np.stack([self._places[k][at[:, k]] for k in range(self._axes)], 1)
        along = self._places[axis]
        points[:, axis] += part * (along[end[:, axis]] - along[at[:, axis]])
        cells = np.stack([self._cell(at + shift) for shift in self._around(axis)], 1)
        cells = np.where(leaves[:, None], cells, cells[:, ::-1])
        inner = np.asarray(np.ravel_multi_index(tuple(np.where(leaves[:, None], at, end).T), self._values.shape))
        return cells, points, inner, free, by_cut

    def _around(self, axis: int) -> np.ndarray:
        """Return the shifts from a node to the cells around the edge that leaves it along an axis."""
        found = np.zeros((2 ** (self._axes - 1), self._axes), int)
        if self._axes == 2:
            found[0, 1 - axis] = -1
            return found if axis == 0 else found[::-1]
        found[:, (axis + 1) % 3] = [-1, 0, 0, -1]
        found[:, (axis + 2) % 3] = [-1, -1, 0, 0]
        return found

    def _cell(self, index: np.ndarray) -> np.ndarray:
        return np.asarray(np.ravel_multi_index(tuple(index.T), self._cells))

    def _fill(self, number: np.ndarray) -> None:
        """Add a quadrilateral for every node in concrete, and a vertex in the middle of every full cell."""
        at = np.argwhere(self._inside)
        corners = np.array([(-1, -1), (0, -1), (0, 0), (-1, 0)])
        cells = np.stack([self._cell(at + shift) for shift in corners], 1)
        full = np.ones(self._cells, bool)
        for shift in itertools.product((0, 1), repeat=2):
            full &= self._inside[tuple(slice(s, s + n) for s, n in zip(shift, self._cells, strict=True))]
        inner = np.argwhere(full)
        number[np.flatnonzero(full)] = self._count + np.arange(len(inner))
        middle = [0.5 * (place[inner[:, k]] + place[inner[:, k] + 1]) for k, place in enumerate(self._places)]
        self.points = np.concatenate([self.points, np.stack(middle, 1)])
        for name, each in self._fields.items():
            around = [each[tuple((inner + shift).T)] for shift in itertools.product((0, 1), repeat=2)]
            self.fields[name] = np.concatenate([self.fields[name], np.mean(around, axis=0)])
        self.quads = number[cells]


def _padded(values: np.ndarray) -> np.ndarray:
    """Return values with one more node at each end of each axis, which repeats its neighbour."""
    return np.pad(values.astype(float), 1, mode="edge") if values.size else np.zeros([2] * values.ndim)


def _padded_places(place: np.ndarray) -> np.ndarray:
    """Return the coordinates of nodes with one more at each end, at the distance of the last two nodes."""
    if len(place) < 2:
        return np.concatenate([place - 1, place, place + 1]) if len(place) else np.arange(2.0)
    return np.concatenate([[2 * place[0] - place[1]], place, [2 * place[-1] - place[-2]]])


def smoothed(values: np.ndarray) -> np.ndarray:
    """Return values at the nodes of a grid, each averaged with its neighbours with the weights 1, 2, 1 along each axis.

    Values beyond the grid count as zero.
    """
    for axis in range(values.ndim):
        inner = np.moveaxis(np.pad(values, [(1, 1) if k == axis else (0, 0) for k in range(values.ndim)]), axis, 0)
        values = np.moveaxis(0.25 * (inner[:-2] + 2 * inner[1:-1] + inner[2:]), 0, axis)
    return values
