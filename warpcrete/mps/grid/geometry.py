"""Geometry of walls on a grid: signed distances, and the open fractions of cells, faces and edges cut by walls.

Walls may pass through cells (cut cells). The signed distance of the walls at the corners of a cell is interpolated
linearly. It gives the fractions of the cell's volume and faces that are open to the flow (Ng, Min & Gibou 2009). The
shear at an edge of a cell is weighted with the open fraction around this edge (Batty & Bridson 2008).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ...kernels.mps.grid.cells import FIXED, INSIDE
from .distances import CylindricalDistance, Distance, distances_from

NONE, PLATE, SMOOTH, GATE, ROUGH = 0, 1, 2, 3, 4
"""Numbers of the kinds of walls. NONE stands for an open cell. PLATE is the wall of a pipe or a side of the simulated
box. SMOOTH is an axis or plane of symmetry, without friction. GATE is a wall that will open. ROUGH is a wall to which
concrete sticks, unless the layout states a slip layer for it. Larger numbers belong to walls that move."""
WALL, MIRROR, OPEN_SIDE = "wall", "mirror", "open"
"""Kinds of sides of the simulated box: a wall, a plane of symmetry, or an open side."""
NO_SLIP_VISCOSITY = 1e8
"""Viscosity of a slip layer on which concrete hardly slips [Pa s/m]."""
MIN_QUARTER_FRACTION = 1e-3
"""Minimum open fraction of a quarter of a cell that walls do not close entirely. A cell has four quarters for each pair
of axes, because it is halved along both axes."""
MIN_OPEN_FRACTION = 0.01
"""Open fraction of a cell or face below which it counts as closed."""
ALIGNED, MAX_WALL_OFFSET = 0.999, 0.01
"""Two conditions for a cell face to count as lying on a wall parallel to it. ALIGNED is the minimum cosine of the angle
between the wall's normal and the face's normal. MAX_WALL_OFFSET is the maximum distance of the face from the wall, in
cell widths."""
SAMPLES_PER_CELL = {2: 8, 3: 4}
"""Number of sample points per axis in a cell, from which its open volume is computed, by number of axes. The numbers
are even, so that the volume is exact for a wall through the centre of the cell."""
LINES_PER_CELL = 8
"""Number of parallel lines across a face or cell. Its open fraction is the mean of the open fractions of these
lines."""
ROUNDING = 1e-9
"""Difference of two distances, divided by the width of a cell, below which both count as the same."""
AXIS_PAIRS = (0, 1), (0, 2), (1, 2)
"""Pairs of axes, each of which spans a plane of shear."""


@dataclass(frozen=True)
class Geometry:
    """Distances of grid points from walls, and the fractions of cells, faces and edges that walls leave open.

    The struct `Geometry` of the kernels has the same members and describes them. All arrays include one layer of cells
    around the grid. `shape` is the number of cells along each axis, with this layer, last axis first. Arrays of cells
    have this shape. Arrays of faces have the shape (axes, *shape). `depth`, the distance from the nearest wall at
    several points of each cell, has the shape (*shape, 2^axes).
    """

    solid: np.ndarray
    """Number of the kind of wall that fills each cell, NONE for an open cell."""
    depth: np.ndarray
    room: np.ndarray
    quarter_fraction: np.ndarray
    """Open fractions of the four quarters of each cell, for each pair of axes, shape (*shape, pairs of axes, 4). The
    quarters result from halving the cell along both axes of the pair, so each of them adjoins one edge of the cell."""
    weighted_volume: np.ndarray
    gap: np.ndarray
    part: np.ndarray
    shut: np.ndarray
    surface: np.ndarray
    swept: np.ndarray


@dataclass(frozen=True)
class Room:
    """Box of cells that the concrete may flow in."""

    cells: tuple[int, ...]
    width: tuple[float, ...]
    """Width of a cell along each axis [m]."""
    origin: tuple[float, ...]
    """Lowest corner of the box of cells [m]."""
    sides: tuple[tuple[str, str], ...]
    """Kinds of the lower and the upper side along each axis: WALL, MIRROR or OPEN_SIDE."""

    def places(self, shift: Sequence[float], more: int = 0) -> np.ndarray:
        """Return a point [m] in each cell of the grid and in each cell of the layer around the grid.

        Along each axis, a point lies `shift` cell widths from the lower end of its cell. `more` is the number of
        additional points beyond the upper end of each axis. The shape is (*(cells + 2 + more), axes).
        """
        along = [
            o + (np.arange(-1, n + 1 + more) + s) * h
            for o, n, h, s in zip(self.origin, self.cells, self.width, shift, strict=True)
        ]
        return np.stack(np.meshgrid(*along, indexing="ij"), -1)


def geometry_of(room: Room, walls: Sequence[tuple[Distance, int]], axial: bool = False) -> Geometry:
    """Return the geometry of a box with walls: which fractions of its cells, faces and edges are open.

    Each of `walls` is a pair of a distance function and a kind number. Sides of the box that are walls have the number
    PLATE. If `axial`, the flow is axisymmetric, and volumes are weighted by the radius.
    """
    axes, nearest = len(room.cells), nearest_wall(room, walls)
    far = 2.0 * float(np.max(np.array(room.cells) * room.width))
    depth, number = nearest(room.places([0.5] * axes))
    # Leave the sides of the box out of the distances at the corners of cells. The sides of the box coincide with sides
    # of cells, so they need no interpolation. With them, interpolation would round off every wall that meets a side of
    # the box at an angle.
    places = room.places([0.0] * axes, 1)
    groups = ([wall for wall in walls if (wall[1] > ROUGH) == moves] for moves in (False, True))
    standing, moving = (np.minimum(nearest_wall(room, group, sides=False)(places)[0], far) for group in groups)
    corners = np.minimum(standing, moving)
    mirror, beyond, index = np.zeros(depth.shape, bool), np.zeros(depth.shape, bool), np.indices(depth.shape)
    for axis, (lower, upper) in enumerate(room.sides):
        for side, at in ((lower, 0), (upper, depth.shape[axis] - 1)):
            if side == MIRROR:
                mirror |= index[axis] == at
            if side == WALL:
                beyond |= index[axis] == at
    ends = _corner_values(corners, range(axes))
    open_part = np.where(beyond, 0.0, _open_fraction(ends, axes))
    solid = np.where(mirror, SMOOTH, np.where(open_part < MIN_OPEN_FRACTION, number, NONE)).astype(np.int32)
    gap, part, shut, surface = [], [], [], []
    for axis in range(axes):
        shift = [0.5] * axes
        shift[axis] = 0.0
        distance, own = nearest(room.places(shift))
        share, below = _open_part(corners, solid != NONE, axis), np.roll(solid, 1, axis)
        closed = share == 0.0
        # At a closed face that lies on a wall parallel to it, the velocity normal to the face equals the wall's
        # velocity. Near an inclined wall, the velocity normal to a closed face is an unknown of the solve.
        slope = np.abs(depth - np.roll(depth, 1, axis)) / room.width[axis]
        beside = (solid == SMOOTH) ^ (below == SMOOTH)
        on_it = np.abs(distance) < MAX_WALL_OFFSET * room.width[axis]
        stops = ((slope > ALIGNED) & on_it | beside) & ((solid == NONE) ^ (below == NONE))
        # At a face on a side of the box, the velocity normal to the face equals the side's velocity, even where another
        # wall covers the face. If this velocity were an unknown, the equations would hardly determine it where two
        # walls meet, and solves would converge slowly.
        for side, at in zip(room.sides[axis], (1, depth.shape[axis] - 1), strict=True):
            if side == WALL:
                on_side = closed & (index[axis] == at)
                stops, own = stops | on_side, np.where(on_side, PLATE, own)
        gap.append(np.minimum(distance, far))
        part.append(share)
        shut.append(np.where(stops, int(FIXED), int(INSIDE)))
        surface.append(np.where((solid == SMOOTH) | (below == SMOOTH), np.where(closed, SMOOTH, own), own))
    rest = [np.stack([_last_first(a) for a in found]) for found in (gap, part, shut, surface)]
    kept = np.where(solid == NONE, np.maximum(open_part, MIN_OPEN_FRACTION), 0.0)
    weighted_volume = _weighted_volume(room, ends, mirror | beyond, solid != NONE, axial)
    halves = [np.minimum(nearest(room.places(0.25 + 0.5 * np.array(h)))[0], far) for h in np.ndindex((2,) * axes)]
    fine = np.stack([_last_first(halves[n]) for n in _first_fastest(axes)], -1)
    quarter_fraction = np.where(solid == NONE, _quarter_fractions(ends), 0.0)
    quarter_fraction = quarter_fraction.transpose(*range(axes + 1, 1, -1), 0, 1)
    moves = any(number > ROUGH for _, number in walls)
    swept = _swept_fractions(standing, rest[1], mirror | beyond) if moves else np.zeros(0)
    return Geometry(
        _last_first(solid),
        fine,
        _last_first(kept),
        np.ascontiguousarray(quarter_fraction),
        _last_first(weighted_volume),
        *rest,
        swept,
    )


def octants(geometry: Geometry) -> np.ndarray:
    """Return the distance from the nearest wall in the middle of each octant of each cell [m], shape (cells..., 8).

    The layer of cells around the grid is left out. The axes of cells and octants have the order of the grid, with the
    last axis fastest.
    """
    axes = geometry.depth.ndim - 1
    inner = geometry.depth[(slice(1, -1),) * axes]
    return inner.transpose(*range(axes - 1, -1, -1), axes)[..., _first_fastest(axes)]


def _open_part(corners: np.ndarray, wall: np.ndarray, axis: int) -> np.ndarray:
    """Return the open fraction of the area of each face that is perpendicular to an axis.

    The fraction is 0 at faces of wall cells (True in the mask `wall`). `corners` holds the distances of the cells'
    corners from the wall [m].
    """
    others = [b for b in range(wall.ndim) if b != axis]
    lowest = np.take(corners, range(wall.shape[axis]), axis)
    share = _open_fraction(_corner_values(lowest, others), wall.ndim - 1)
    closed = (share < MIN_OPEN_FRACTION) | wall | np.roll(wall, 1, axis)
    return np.where(closed, 0.0, np.where(share > 1 - MIN_OPEN_FRACTION, 1.0, share))


def _swept_fractions(corners: np.ndarray, part: Sequence[np.ndarray], sides: np.ndarray) -> np.ndarray:
    """Return the fraction of each face's area that moving walls close and standing walls leave open.

    `corners` holds the distances of the cells' corners from the standing walls [m]. `part` holds the open fractions of
    faces, one array for each axis, and `sides` is the mask of the cells beyond walls and mirrors on sides of the box.
    The result has the shape (axes, *shape).

    A moving wall displaces concrete through these parts of the faces. If the parts that a standing wall closes counted
    as well, small cells in which both walls meet would get much more concrete than the moving wall displaces.
    """
    axes = range(sides.ndim)
    wall = sides | (_open_fraction(_corner_values(corners, axes), len(axes)) < MIN_OPEN_FRACTION)
    return np.stack([_last_first(_open_part(corners, wall, axis)) - part[axis] for axis in axes])


def _quarter_fractions(ends: np.ndarray) -> np.ndarray:
    """Return the open fractions of each cell's four quarters for each pair of axes, shape (pairs, 4, cells...).

    `ends` holds the distances of the wall at the corners of each cell, shape (cells..., 2, ..., 2).
    """
    axes = ends.ndim // 2
    inner = tuple(range(-axes, 0))
    low = ends.min(inner)
    cut = (low <= 0) & (ends.max(inner) > 0)
    half = ends[cut]
    for axis in range(1, axes + 1):
        # Insert the interpolated value midway between two corners of a cell, so that the result has values at the
        # corners of the two halves of each cell.
        a, b = np.split(half, 2, axis)
        half = np.concatenate([a, 0.5 * (a + b), b], axis)
    # The friction of a wall acts on the concrete through the quarters of cells. A quarter with an open fraction of zero
    # would be left out, so that concrete in an almost closed quarter would have no friction; hence the minimum.
    part = _open_fraction(_corner_values(half, range(1, axes + 1)), axes, MIN_QUARTER_FRACTION)
    pairs = AXIS_PAIRS[:1] if axes == 2 else AXIS_PAIRS
    fractions = np.empty((len(pairs), 4, *cut.shape))
    fractions[:] = np.where(low > 0, 1.0, 0.0)
    for number, (first, second) in enumerate(pairs):
        others = tuple(b + 1 for b in range(axes) if b not in (first, second))
        quarters = part.mean(others) if others else part
        for n in range(4):
            fractions[number, n][cut] = quarters[:, n % 2, n // 2]
    return fractions


def nearest_wall(
    room: Room, walls: Sequence[tuple[Distance, int]], sides: bool = True
) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Return a function of points that gives the distance [m] and the kind number of the wall nearest to each point.

    The points have the shape (..., axes) [m]. If `sides` is true, the sides of the box that are walls are included.
    """
    everything = [*walls, *(_room_walls(room) if sides else ())]

    def nearest(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        shape = points.shape[:-1]
        shortest, which = np.full(shape, np.inf), np.full(shape, everything[0][1] if everything else PLATE, np.int32)
        for distance, number in everything:
            here = distances_from(distance, points)
            # If several walls are equally near, such as an inlet and the pipe around it, take the first of these walls.
            # Rounding errors must not decide, because they differ between processors.
            which = np.where(here < shortest - ROUNDING * min(room.width), number, which).astype(np.int32)
            shortest = np.minimum(shortest, here)
        return shortest, which

    return nearest


def _first_fastest(axes: int) -> list[int]:
    """Return the corner numbers of a cell, as counted by `ndindex`, sorted so that the first axis varies fastest."""
    return [int("".join(reversed(f"{n:0{axes}b}")), 2) for n in range(2**axes)]


def _last_first(array: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(array.transpose())


def _room_walls(room: Room) -> list[tuple[Distance, int]]:
    """Return a distance function and the kind number PLATE for each side of a box that is a wall."""

    def plane(axis: int, place: float, sign: float) -> Distance:
        return CylindricalDistance(lambda x: sign * (x[:, axis] - place), (axis,))

    walls: list[tuple[Distance, int]] = []
    for axis, (lower, upper) in enumerate(room.sides):
        if lower == WALL:
            walls.append((plane(axis, room.origin[axis], 1.0), PLATE))
        if upper == WALL:
            walls.append((plane(axis, room.origin[axis] + room.cells[axis] * room.width[axis], -1.0), PLATE))
    return walls


def _weighted_volume(room: Room, ends: np.ndarray, shut: np.ndarray, wall: np.ndarray, axial: bool) -> np.ndarray:
    """Return the open volume around the centre of each cell, weighted as the kernel `fill` weights particles.

    The weight is a hat function of the position, which falls from 1 at the centre of a cell to 0 at the centres of its
    neighbours. A volume therefore counts in parts for several cells. The part that would count for a wall cell (True in
    the mask `wall`) counts for the cell in which the volume lies instead. Volumes in closed cells (True in the mask
    `shut`) do not count. `ends` holds the distances of the wall at the corners of each cell, shape (cells..., 2, ...,
    2).
    """
    axes = len(room.cells)
    fine = SAMPLES_PER_CELL[axes]
    inner = tuple(range(-axes, 0))
    low = ends.min(inner)
    full, cut = (low > 0) & ~shut, (low <= 0) & (ends.max(inner) > 0) & ~shut
    radius = None
    if axial:
        # In axisymmetric flow, volumes are weighted with the radius. The volumes that belong to the corners of a cell
        # therefore differ from one full cell to the next, and must be computed for every full cell.
        full, cut = np.zeros_like(full), full | cut
        along = (np.arange(full.shape[0]) - 1)[:, None] + (np.arange(fine) + 0.5) / fine
        radius = np.maximum(along * room.width[0], 0.0)[np.nonzero(cut)[0]]
    of_full = _hat_parts(np.ones((1, *[2] * axes)), fine)[0]
    of_cut = _hat_parts(ends[cut], fine, radius)
    volume = np.zeros(full.shape)
    for number, neighbour in enumerate(np.ndindex((3,) * axes)):
        offset = [n - 1 for n in neighbour]
        part = np.where(full, of_full[number], 0.0)
        part[cut] = of_cut[:, number]
        if any(offset):
            stays = _shifted(wall, [-n for n in offset])
            volume += np.where(stays, part, 0.0)
            part = _shifted(np.where(stays, 0.0, part), offset)
        volume += part
    return np.maximum(volume, 1e-6 * float(volume.max())) * float(np.prod(room.width))


def _hat_parts(ends: np.ndarray, fine: int, radius: np.ndarray | None = None) -> np.ndarray:
    """Return the parts of the open volume of cells that count for each cell and its neighbours, in cell volumes.

    Args:
        ends: Signed distances of the wall at the corners of n cells, shape (n, 2, ..., 2).
        fine: Number of sample points along each axis of a cell.
        radius: Weights of the sample points along the first axis, shape (n, fine); all are 1 by default.

    Returns:
        Parts for the neighbours at the offsets -1, 0 and 1 along each axis, the last axis fastest, shape (n, 3^axes).
    """
    axes, inner = ends.ndim - 1, (np.arange(fine) + 0.5) / fine
    values = ends
    for axis in range(1, axes + 1):
        low, high = (np.expand_dims(np.take(values, end, axis), axis) for end in (0, 1))
        values = low + inner.reshape([-1 if a == axis else 1 for a in range(axes + 1)]) * (high - low)
    parts = (values > 0).astype(float)
    if radius is not None:
        parts = parts * radius.reshape(*radius.shape, *[1] * (axes - 1))
    hats = np.maximum(1 - np.abs(inner[:, None] - np.array([-0.5, 0.5, 1.5])), 0.0) / fine
    for _ in range(axes):
        # Each product sums over one axis of sample points, and appends an axis of the neighbours (-1, 0, 1).
        parts = np.tensordot(parts, hats, (1, 0))
    return parts.reshape(len(ends), 3**axes)


def _shifted(values: np.ndarray, offset: Sequence[int]) -> np.ndarray:
    """Return `values` shifted by `offset`: entry i moves to i + `offset`, and entries without a source are 0."""
    moved = np.zeros_like(values)
    target = tuple(slice(max(n, 0), length + min(n, 0)) for n, length in zip(offset, values.shape, strict=True))
    source = tuple(slice(max(-n, 0), length + min(-n, 0)) for n, length in zip(offset, values.shape, strict=True))
    moved[target] = values[source]
    return moved


def _corner_values(values: np.ndarray, axes: Sequence[int]) -> np.ndarray:
    """Return the values at the lower and the upper end of each cell along `axes`, from values at grid points.

    For each of these axes, the result has one more dimension, of length 2, at the end of its shape.
    """
    for axis in axes:
        count = values.shape[axis]
        values = np.stack([np.take(values, range(count - 1), axis), np.take(values, range(1, count), axis)], -1)
    return values


def _open_fraction(corners: np.ndarray, ends: int, least: float = 0.0) -> np.ndarray:
    """Return the fraction of each cell in which a field is positive, as :func:`_positive_fraction` computes it.

    The computation is needed only for cells in which the field changes its sign; in these cells,
    the result is at least `least`. In all other cells the fraction is 0 or 1.
    """
    inner = tuple(range(-ends, 0))
    low = corners.min(inner)
    part, cut = np.where(low > 0, 1.0, 0.0), (low <= 0) & (corners.max(inner) > 0)
    part[cut] = np.maximum(_positive_fraction(corners[cut], ends), least)
    return part


def _positive_fraction(corners: np.ndarray, ends: int) -> np.ndarray:
    """Return the fraction of each cell in which a field, interpolated linearly between its corners, is positive.

    The last `ends` axes of `corners`, each of length 2, contain the values at the corners.
    """
    if ends == 1:
        a, b = corners[..., 0], corners[..., 1]
        high, low = np.maximum(a, b), np.minimum(a, b)
        with np.errstate(divide="ignore", invalid="ignore"):
            part = high / (high - low)
        return np.where(low > 0, 1.0, np.where(high <= 0, 0.0, part))
    total = np.zeros(corners.shape[:-ends])
    for n in range(LINES_PER_CELL):
        t = (n + 0.5) / LINES_PER_CELL
        total = total + _positive_fraction((1 - t) * corners[..., 0] + t * corners[..., 1], ends - 1)
    return total / LINES_PER_CELL
