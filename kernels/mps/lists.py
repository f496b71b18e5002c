"""Kernels that build the neighbour lists of the moving particle method.

Every fluid particle has three lists: `near` with the fluid particles within the reach of the operators, `far` with the
fluid particles farther away but within the larger reach of the density weights, and `wall` with the wall particles
within this larger reach. A skin is added to every reach, so that the lists stay valid for many steps.
"""

import functools

import warp as wp

from ..common.control import OVERFLOW
from .structs import array_structs, flow_struct, mps_types, row_place


@functools.cache
def list_kernels(scalar, dimensions: int, serial: bool):
    """Build the kernels `place` and `search` for a rebuild of the neighbour lists.

    `place` writes the positions of the particles to the points of the hash grid, and `search` fills all neighbour
    lists.
    """
    t = mps_types(scalar, dimensions)
    FlowConstants = flow_struct(scalar)
    structs = array_structs(scalar, dimensions)
    Particles, Lists, Fields = structs.Particles, structs.Lists, structs.Fields
    entry = row_place(serial)

    @wp.func
    def point(x: t.vec) -> wp.vec3f:
        if wp.static(dimensions == 2):
            return wp.vec3f(wp.float32(x[0]), wp.float32(0.0), wp.float32(x[1]))
        else:
            return wp.vec3f(wp.float32(x[0]), wp.float32(x[1]), wp.float32(x[wp.static(dimensions - 1)]))

    @wp.kernel(enable_backward=False, module="unique")
    def place(
        flow: FlowConstants, particles: Particles, lists: Lists, points: wp.array(dtype=wp.vec3f), fields: Fields
    ):
        i = wp.tid()
        if i < flow.count:
            points[i] = point(particles.position[i])
            fields.position_at_build[i] = particles.position[i]
        else:
            points[i] = point(lists.wall_position[i - flow.count])

    @wp.kernel(enable_backward=False, module="unique")
    def search(
        # The next argument holds the parameters of the flow.
        flow: FlowConstants,
        near_reach: scalar,
        whole_reach: scalar,
        grid: wp.uint64,
        # The next arguments hold the state of the flow, which this kernel only reads.
        points: wp.array(dtype=wp.vec3f),
        # The next arguments are arrays that this kernel writes.
        flags: wp.array(dtype=wp.int32),
        lists: Lists,
    ):
        i = wp.tid()
        here = points[i]
        # Enlarge the reaches of the operators and of the density weights slightly, because the points of the hash grid
        # are rounded to single precision.
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
                if walls < lists.wall_capacity:
                    lists.wall[entry(i, walls, flow.count, lists.wall_capacity)] = j - flow.count
                walls += 1
            elif r <= inner:
                if nears < lists.near_capacity:
                    lists.near[entry(i, nears, flow.count, lists.near_capacity)] = j
                nears += 1
            else:
                if fars < lists.far_capacity:
                    lists.far[entry(i, fars, flow.count, lists.far_capacity)] = j
                fars += 1
        # Number of neighbours divided by capacity, in per mille, for the fullest of the particle's three lists. If a
        # list is too short, the host computes a sufficient capacity from the maximum of this number over all particles.
        needed = wp.max(nears * 1000 / lists.near_capacity, fars * 1000 / lists.far_capacity)
        needed = wp.max(needed, walls * 1000 / lists.wall_capacity)
        if nears > lists.near_capacity or fars > lists.far_capacity or walls > lists.wall_capacity:
            wp.atomic_max(flags, OVERFLOW, needed + 1)
        lists.near_count[i] = wp.min(nears, lists.near_capacity)
        lists.far_count[i] = wp.min(fars, lists.far_capacity)
        lists.wall_count[i] = wp.min(walls, lists.wall_capacity)

    return place, search
