"""A grid of cells that says which spheres are near a place: built and asked on the device, so that a graph may hold it.

Places wrap around: cells lie side by side without end, and those a whole grid apart are one. Any place is in a cell; to
lie far away, or to have few cells, costs time and loses nobody.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.types import module_of, types

FARTHEST = 1.0e9
"""Cells from the origin from which on it does not matter how far a place is; twice that is still a 32-bit number."""


@functools.cache
def grid_struct(scalar):
    """Struct `Grid`."""

    @wp.struct
    class Grid:
        dims: wp.vec3i  # cells along each axis
        per_width: wp.array(dtype=scalar)  # one over the width of a cell [1/m], shape (1,)
        held: wp.array(dtype=wp.int32)  # how many points each cell has, and 0, shape (cells + 1,)
        start: wp.array(dtype=wp.int32)  # first entry of each cell in `point`, and the end, shape (cells + 1,)
        cell: wp.array(dtype=wp.int32)  # of each point, shape (points,) as the rest
        rank: wp.array(dtype=wp.int32)  # its place among those of its cell, in any order
        point: wp.array(dtype=wp.int32)  # points cell by cell

    return Grid


@functools.cache
def grid_functions(scalar) -> SimpleNamespace:
    """`cell_at`; `region` (the cells that may hold what is within a reach of a place) and `run_of` (its entries in
    `point`, run by run: cells beside one another along x are one run, or two where the grid ends between them)."""
    t = types(scalar)
    Grid = grid_struct(scalar)

    @wp.struct
    class Region:
        lowest: wp.vec3i  # cell
        count: wp.vec3i  # of cells along each axis
        runs: wp.int32

    @wp.func
    def along(v: scalar) -> wp.int32:
        """Cell of a coordinate, in widths."""
        far = scalar(wp.static(FARTHEST))
        place = wp.where(v > -far, v, -far)  # what is no number is far, too
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
        """First entry of a run, and its end."""
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
    """Kernels over points: ``count`` those of each cell, from `held` of zero, then, when it is known where cells begin,
    ``put`` them there."""
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
