"""Lists of neighbours of the moving particle method.

Fluid particles within the operators' reach stand in a `near` row, those that only the density sees in a `far` row,
particles of the walls in a third; all with a skin, so that the lists serve for many steps.
"""

import functools

import warp as wp

from .mps_types import OVERFLOW, fluid_struct, mps_types, row_place


@functools.cache
def list_kernels(scalar, dimensions: int, serial: bool):
    """`place` (points for the grid) and `search` (all rows)."""
    t = mps_types(scalar, dimensions)
    Flow = fluid_struct(scalar)
    entry = row_place(serial)

    @wp.func
    def point(x: t.vec) -> wp.vec3f:
        if wp.static(dimensions == 2):
            return wp.vec3f(wp.float32(x[0]), wp.float32(0.0), wp.float32(x[1]))
        else:
            return wp.vec3f(wp.float32(x[0]), wp.float32(x[1]), wp.float32(x[wp.static(dimensions - 1)]))

    @wp.kernel(enable_backward=False, module="unique")
    def place(
        flow: Flow,
        position: wp.array(dtype=t.vec),
        wall_position: wp.array(dtype=t.vec),
        points: wp.array(dtype=wp.vec3f),
        built: wp.array(dtype=t.vec),
    ):
        i = wp.tid()
        if i < flow.count:
            points[i] = point(position[i])
            built[i] = position[i]
        else:
            points[i] = point(wall_position[i - flow.count])

    @wp.kernel(enable_backward=False, module="unique")
    def search(
        flow: Flow,
        near_reach: scalar,
        whole_reach: scalar,
        grid: wp.uint64,
        near_capacity: wp.int32,
        far_capacity: wp.int32,
        wall_capacity: wp.int32,
        points: wp.array(dtype=wp.vec3f),
        flags: wp.array(dtype=wp.int32),
        near_count: wp.array(dtype=wp.int32),
        near: wp.array(dtype=wp.int32),
        far_count: wp.array(dtype=wp.int32),
        far: wp.array(dtype=wp.int32),
        wall_count: wp.array(dtype=wp.int32),
        wall: wp.array(dtype=wp.int32),
    ):
        i = wp.tid()
        here = points[i]
        # A hair more than the skin, for the rounding of the grid's points.
        inner = wp.float32(near_reach) * wp.float32(1.0001)
        outer = wp.float32(whole_reach) * wp.float32(1.0001)
        nears, fars, walls = wp.int32(0), wp.int32(0), wp.int32(0)
        for j in wp.hash_grid_query(grid, here, outer):
            if j == i:
                continue
            r = wp.length(points[j] - here)
            if r > outer:
                continue
            if j >= flow.count:
                if walls < wall_capacity:
                    wall[entry(i, walls, flow.count, wall_capacity)] = j - flow.count
                walls += 1
            elif r <= inner:
                if nears < near_capacity:
                    near[entry(i, nears, flow.count, near_capacity)] = j
                nears += 1
            else:
                if fars < far_capacity:
                    far[entry(i, fars, flow.count, far_capacity)] = j
                fars += 1
        # Over the capacity in per mille, so that one number tells how much is missing in any of the three.
        needed = wp.max(nears * 1000 / near_capacity, fars * 1000 / far_capacity)
        needed = wp.max(needed, walls * 1000 / wall_capacity)
        if nears > near_capacity or fars > far_capacity or walls > wall_capacity:
            wp.atomic_max(flags, OVERFLOW, needed + 1)
        near_count[i] = wp.min(nears, near_capacity)
        far_count[i] = wp.min(fars, far_capacity)
        wall_count[i] = wp.min(walls, wall_capacity)

    return place, search
