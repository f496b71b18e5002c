"""Triangulated surfaces of concrete, extracted from a level-set function at the nodes of a grid.

The level-set function, called level here, is positive in concrete and negative outside it. The surface is a surface net
(Gibson, MICCAI 1998). Every grid edge along which the level changes its sign yields one face. The corners of the face
lie in the cells around the edge. Each corner is the mean of the points on the edges of its cell at which the level is
zero.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

PLANE_WEIGHT = 1e-6
"""Weight of a point on a cutting plane or on a side of the grid; a point on the free surface has the weight 1.

A vertex of the triangulated surface is the weighted mean of the points where the surface of the concrete crosses the
edges of one grid cell.
"""
FACETS = 64
"""Number of facets around the axis of a surface of revolution."""


@dataclass(frozen=True)
class Level:
    """Level-set function of concrete at the nodes of a rectilinear grid: positive in concrete, negative outside it."""

    places: tuple[np.ndarray, ...]
    """Coordinates of the grid's nodes along each of the d axes [m]."""
    values: np.ndarray
    """Dimensionless value of the level-set function at each node of the grid, shape (n_1, ..., n_d).

    An example is the fraction of a cell that concrete fills, minus one half.
    """
    fields: Mapping[str, np.ndarray] = field(default_factory=dict[str, np.ndarray])
    """Physical quantities at each node of the grid, by name, each with the shape of `values`."""

    def mirrored(self, axis: int) -> Level:
        """Return the level-set function completed by its mirror image about the plane at coordinate 0 of `axis`."""
        places = list(self.places)
        places[axis] = np.concatenate([-places[axis][::-1], places[axis]])

        def both(values: np.ndarray) -> np.ndarray:
            return np.concatenate([np.flip(values, axis), values], axis)

        fields = {name: both(values) for name, values in self.fields.items()}
        return Level(tuple(places), both(self.values), fields)

    def cropped(self) -> Level:
        """Return the level-set function on a smaller grid, which reaches one layer of nodes beyond the concrete."""
        ranges: list[slice] = []
        for axis in range(self.values.ndim):
            others = tuple(k for k in range(self.values.ndim) if k != axis)
            inner = np.flatnonzero((self.values > 0).any(others))
            ranges.append(slice(max(inner[0] - 1, 0), inner[-1] + 2) if len(inner) else slice(0, 0))
        chosen = tuple(ranges)
        places = tuple(place[part] for place, part in zip(self.places, chosen, strict=True))
        return Level(places, self.values[chosen], {name: values[chosen] for name, values in self.fields.items()})


@dataclass(frozen=True)
class Surface:
    """Triangulated surface of concrete; the corners of triangles are in anticlockwise order as seen from outside."""

    vertices: np.ndarray
    """Positions of the surface's vertices [m], shape (v, 3)."""
    faces: np.ndarray
    """Indices of the three vertices of each triangle, shape (f, 3)."""
    normals: np.ndarray
    """Unit vectors that point out of the concrete at the vertices, shape (v, 3)."""
    fields: Mapping[str, np.ndarray]
    """Physical quantities at the vertices in SI units, by name, each of shape (v,)."""

    @property
    def volume(self) -> float:
        """Volume that a closed surface encloses [m3]."""
        a, b, c = (self.vertices[self.faces[:, k]].astype(float) for k in range(3))
        return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6

    def moved(self, to_scene: Callable[[np.ndarray], np.ndarray]) -> Surface:
        """Return the surface in other coordinates; `to_scene` rotates and shifts points of shape (n, 3)."""
        ends = to_scene(self.vertices + self.normals)
        vertices = to_scene(self.vertices)
        return replace(self, vertices=vertices, normals=ends - vertices)


@dataclass(frozen=True)
class Cut:
    """Plane that cuts concrete open; only the concrete on the side to which the normal points is drawn."""

    normal: np.ndarray
    """Unit normal of the cutting plane in d dimensions, shape (d,)."""
    offset: float
    """Distance of the cutting plane from the origin, along the plane's normal [m]."""

    def depth(self, points: np.ndarray) -> np.ndarray:
        """Return the signed distance of points (..., d) from the plane [m], positive on the side of the normal."""
        return points @ self.normal - self.offset


def surface_of(level: Level, cut: Cut | None = None) -> Surface:
    """Return the closed surface of concrete in three dimensions.

    With `cut`, return the closed surface of the concrete on the side to which the cutting plane's normal points.
    """
    net = _Net(level.cropped(), cut)
    return _surface(net.points, triangles(net.sides), net.fields)


def revolved(level: Level, half: bool = False) -> Surface:
    """Return the closed surface of revolution that belongs to a level-set function of radius and height.

    If `half` is true, return only the half with y > 0, closed by a flat surface in the plane y = 0.
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
    surface = _surface(vertices.reshape(-1, 3), faces, fields)
    return _joined(surface, _section(net)) if half else surface


def _section(net: _Net) -> Surface:
    """Return a filled two-dimensional section as a flat surface in the plane y = 0; its normals point to y < 0."""
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
    """Split quadrilaterals, given by their vertices with shape (n, 4), into triangles with shape (2 n, 3)."""
    return quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)


def _surface(vertices: np.ndarray, faces: np.ndarray, fields: Mapping[str, np.ndarray]) -> Surface:
    """Return a surface without faces of zero area, with normals averaged over adjacent faces, weighted by area."""
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
    """Surface net (Gibson, MICCAI 1998) of a level-set function in two or three dimensions.

    A surface net consists of vertices (`points`) and of faces between them (`sides`). In two dimensions, the faces are
    line segments.
    """

    points: np.ndarray
    """Positions of the surface's vertices in d dimensions [m], shape (v, d)."""
    fields: dict[str, np.ndarray]
    """Physical quantities at the vertices, averaged over adjacent nodes in concrete, each of shape (v,)."""
    sides: np.ndarray
    """Indices of the vertices of each side.

    In three dimensions, a side is a quadrilateral, shape (n, 4), whose corners are in anticlockwise order as seen from
    outside. In two dimensions, a side is a line segment, shape (n, 2), with the outside on its right.
    """
    quads: np.ndarray
    """Indices of the vertices of quadrilaterals that fill a two-dimensional section of the concrete, shape (n, 4)."""

    def __init__(self, level: Level, cut: Cut | None = None, filled: bool = False) -> None:
        self._axes = level.values.ndim
        self._places = [_padded_places(place) for place in level.places]
        values = _padded(level.values)
        frame = np.ones(values.shape, bool)
        frame[(slice(1, -1),) * self._axes] = False
        # Concrete ends at the sides of the grid. A node added outside the grid gets minus the level of its neighbour in
        # the grid. The level is then zero midway between the two nodes, and the surface lies there.
        values[frame] = -np.abs(values[frame])
        self._values, self._inside = values, values > 0
        self._depths = None
        if cut is not None:
            self._depths = cut.depth(np.stack(np.meshgrid(*self._places, indexing="ij"), -1))
            self._inside = self._inside & (self._depths > 0)
        self._fields = {name: _padded(each) for name, each in level.fields.items()}
        self._cells = tuple(n - 1 for n in values.shape)
        crossings = [self._crossings(axis) for axis in range(self._axes)]
        cells, points, inner, free, by_cut = (np.concatenate([part[k] for part in crossings]) for k in range(5))
        corners = cells.shape[1]
        number = self._numbered(cells)
        flat = number[cells.ravel()]
        # In a cell where the free surface meets a side of the grid or a cutting plane, the vertex is the mean of the
        # points on the free surface only. It is then moved onto the side or plane, so that the edge is sharp.
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
        """Return an array with a consecutive number for every grid cell that contains a vertex.

        Entries of the array for cells without a vertex are meaningless.
        """
        used = np.zeros(int(np.prod(self._cells)), bool)
        used[cells.ravel()] = True
        self._count = int(np.count_nonzero(used))
        return np.cumsum(used) - 1

    def _crossings(self, axis: int) -> tuple[np.ndarray, ...]:
        """Return the grid edges along one axis that cross the surface: one end is in the concrete, the other is not.

        With a cut, only concrete on the side of the cutting plane's normal counts. The results, for m edges in d
        dimensions, are:

        - the indices of the grid cells around each edge, in the order of the corners of a side, shape (m, 2 or 4),
        - the point of the edge at which the level, or the distance from the cutting plane, is zero, shape (m, d),
        - the index of the end node that lies in concrete, shape (m,),
        - whether the edge crosses the free surface inside the grid, shape (m,),
        - whether the edge crosses the cut, shape (m,).
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
        """Return the index offsets from a node to the cells around the grid edge from this node along `axis`."""
        offsets = np.zeros((2 ** (self._axes - 1), self._axes), int)
        if self._axes == 2:
            offsets[0, 1 - axis] = -1
            return offsets if axis == 0 else offsets[::-1]
        offsets[:, (axis + 1) % 3] = [-1, 0, 0, -1]
        offsets[:, (axis + 2) % 3] = [-1, -1, 0, 0]
        return offsets

    def _cell(self, index: np.ndarray) -> np.ndarray:
        return np.asarray(np.ravel_multi_index(tuple(index.T), self._cells))

    def _fill(self, number: np.ndarray) -> None:
        """Fill a two-dimensional section of the concrete with quadrilaterals.

        Add a vertex at the centre of every grid cell that lies entirely in concrete. Then add a quadrilateral around
        every node in concrete; its corners are the vertices of the four cells that meet at the node. `number` holds the
        number of the vertex in each cell, as :meth:`_numbered` returns it.
        """
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
    """Return `values` with one more node at both ends of each axis; a new node gets the value of its neighbour."""
    return np.pad(values.astype(float), 1, mode="edge") if values.size else np.zeros([2] * values.ndim)


def _padded_places(place: np.ndarray) -> np.ndarray:
    """Return the coordinates `place` of nodes along an axis, with one more node at each end.

    The spacing of the new node equals the spacing between the last two nodes at this end.
    """
    if len(place) < 2:
        return np.concatenate([place - 1, place, place + 1]) if len(place) else np.arange(2.0)
    return np.concatenate([[2 * place[0] - place[1]], place, [2 * place[-1] - place[-2]]])


def smoothed(values: np.ndarray) -> np.ndarray:
    """Smooth values at the nodes of a grid by averaging neighbours with the weights 1, 2, 1 along each axis.

    Values outside the grid count as zero.
    """
    for axis in range(values.ndim):
        inner = np.moveaxis(np.pad(values, [(1, 1) if k == axis else (0, 0) for k in range(values.ndim)]), axis, 0)
        values = np.moveaxis(0.25 * (inner[:-2] + 2 * inner[1:-1] + inner[2:]), 0, axis)
    return values
