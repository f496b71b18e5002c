"""Uniform grid for the search of neighbouring spheres, built and queried on the device.

Because no host is involved, the search can be part of a CUDA graph. The grid is periodic: positions that differ by the
size of the grid fall into the same cell. Every position therefore has a cell. If bodies are far apart or the grid has
few cells, distant bodies share cells, which costs time, but no neighbour is missed.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.types import module_of, types

FARTHEST = 1.0e9
"""Largest cell index along each axis; farther coordinates are clamped to it. Twice this index fits into 32 bits."""


@functools.cache
def grid_struct(scalar):
    """Return the struct `Grid`, a uniform grid of cells for the search of points near a position."""

    @wp.struct
    class Grid:
        dims: wp.vec3i  # number of cells of the grid along each axis
        per_width: wp.array(dtype=scalar)  # inverse width of a cell [1/m], shape (1,)
        held: wp.array(dtype=wp.int32)  # number of points in each cell, followed by a zero, shape (cells + 1,)

        # index in `point` of each cell's first point, followed by the total number of points, shape (cells + 1,)
        start: wp.array(dtype=wp.int32)
        cell: wp.array(dtype=wp.int32)  # cell index of each point, shape (points,)

        # rank of each point among the points of its cell, counted from 0 in arbitrary order, shape (points,)
        rank: wp.array(dtype=wp.int32)
        point: wp.array(dtype=wp.int32)  # point indices, sorted by cell, shape (points,)

    return Grid


@functools.cache
def grid_functions(scalar) -> SimpleNamespace:
    """Return the functions `cell_at`, `region` and `run_of`, which search the grid for points near a position.

    `cell_at` returns the index of the cell that contains a position. `region` returns the block of cells that may hold
    points within the distance `reach` of a position. The cells of this block are processed in runs, which are lines of
    adjacent cells along x. A line that crosses the end of the periodic grid counts as two runs. `run_of` returns the
    range of one run in `point`, the list of points sorted by cell.
    """
    t = types(scalar)
    Grid = grid_struct(scalar)

    @wp.struct
    class Region:
        lowest: wp.vec3i  # index along each axis of the lowest cell in the searched region
        count: wp.vec3i  # number of cells in the searched region along each axis
        runs: wp.int32  # number of runs in the searched region

    @wp.func
    def along(v: scalar) -> wp.int32:
        """Return the index along one axis of the cell that contains `v`, a coordinate divided by the cell width."""
        far = scalar(wp.static(FARTHEST))
        place = wp.where(v > -far, v, -far)  # Comparisons with NaN are false, so NaN becomes -far.
        return wp.int32(wp.floor(wp.where(place < far, place, far)))

    @wp.func
    def wrapped(place: wp.int32, count: wp.int32) -> wp.int32:
        rest = place % count
        return wp.where(rest < 0, rest + count, rest)

    @wp.func
    def cell_at(grid: Grid, x: t.vec3) -> wp.int32:
        v = grid.per_width[0] * x
        first = wrapped(along(v[0]), grid.dims[0])
        second = wrapped(along(v[1]), grid.dims[1])
        return (wrapped(along(v[2]), grid.dims[2]) * grid.dims[1] + second) * grid.dims[0] + first

    @wp.func
    def region(grid: Grid, x: t.vec3, reach: scalar) -> Region:
        found = Region()
        per_width = grid.per_width[0]
        for axis in range(3):
            lowest = along((x[axis] - reach) * per_width)
            highest = along((x[axis] + reach) * per_width)
            found.lowest[axis] = wrapped(lowest, grid.dims[axis])
            found.count[axis] = wp.min(highest - lowest + 1, grid.dims[axis])
        found.runs = found.count[1] * found.count[2]
        if found.lowest[0] + found.count[0] > grid.dims[0]:
            found.runs *= 2
        return found

    @wp.func
    def run_of(grid: Grid, region: Region, number: wp.int32) -> wp.vec2i:
        """Return the range of run `number` in `point`, the list of points sorted by cell.

        A run is a line of adjacent cells of the region along x.
        """
        row = number
        begin = region.lowest[0]
        end = begin + region.count[0]
        if end > grid.dims[0]:
            row = number / 2
            if number % 2 == 0:
                end = grid.dims[0]
            else:
                begin = wp.int32(0)
                end = end - grid.dims[0]
        y = region.lowest[1] + row % region.count[1]
        z = region.lowest[2] + row / region.count[1]
        y = wp.where(y >= grid.dims[1], y - grid.dims[1], y)
        z = wp.where(z >= grid.dims[2], z - grid.dims[2], z)
        first = (z * grid.dims[1] + y) * grid.dims[0]
        return wp.vec2i(grid.start[first + begin], grid.start[first + end])

    return SimpleNamespace(Region=Region, cell_at=cell_at, region=region, run_of=run_of)


@functools.cache
def grid_kernels(scalar) -> SimpleNamespace:
    """Return two kernels, with one thread per point, that sort points into the cells of a grid.

    ``count`` counts the points of each cell in the array `held`, which must be zero before the launch. The caller then
    writes the prefix sums of these counts to the array `start`. Finally, ``put`` writes the indices of the points to
    the array `point`, sorted by cell.
    """
    Grid = grid_struct(scalar)
    cell_at = grid_functions(scalar).cell_at
    vec3 = types(scalar).vec3

    @wp.kernel(module=module_of("grid", scalar), enable_backward=False)
    def count(centre: wp.array(dtype=vec3), grid: Grid):
        i = wp.tid()
        cell = cell_at(grid, centre[i])
        grid.cell[i] = cell
        grid.rank[i] = wp.atomic_add(grid.held, cell, 1)

    @wp.kernel(module=module_of("grid", scalar), enable_backward=False)
    def put(grid: Grid):
        i = wp.tid()
        grid.point[grid.start[grid.cell[i]] + grid.rank[i]] = i

    return SimpleNamespace(count=count, put=put)
