"""Search for neighbours on a CPU: each thread lists the pairs of its own group of spheres once.

The kernel runs over all scenes of a batch, and skips scenes whose neighbour lists are still valid.
"""

import functools

import warp as wp

from ..common.control import STALE
from ..common.rows import row_functions
from ..common.types import types
from .grid import grid_functions, grid_struct
from .search import search_functions
from .structs import array_structs


@wp.func
def insert(other: wp.array(dtype=wp.int32), row: wp.int32, found: wp.int32, entry: wp.int32):
    """Insert an entry at its sorted position in a list row that already holds `found` entries.

    `row` is the index of the row's first entry. The grid finds neighbours in an order that depends on all scenes of a
    batch. Sorted rows make the sums of a step independent of this order.
    """
    k = row + found
    for ahead in range(found):
        if other[k - 1] < entry:
            break
        other[k] = other[k - 1]
        k = k - 1
    other[k] = entry


@functools.cache
def half_search_kernel(scalar, bonds: bool) -> wp.Kernel:
    """Return the kernel ``search`` for half lists (CPU), which runs with one task per chunk.

    A chunk is the range of spheres of one CPU thread. Two rules decide at which sphere a pair is listed:

    - A pair inside a chunk is listed at its larger sphere, or at the sphere with the lower index if both are equally
      large. The search around a sphere then reaches no further than the sphere's own diameter plus the margin.
    - A pair across two chunks is listed at both spheres. A search near another chunk must therefore reach as far as the
      largest sphere.

    Each task writes the list entries of its spheres, one sphere after the other, to the buffer `other`. `room` is the
    range of entries in this buffer that the chunk may use. The output `wanted` is the number of entries that the chunk
    needs, which may be more than this range can hold.
    """
    t = types(scalar)
    structs = array_structs(scalar)
    Scenes, Spheres, Pairs = structs.Scenes, structs.Spheres, structs.Pairs
    rows = row_functions(scalar)
    read_int, read_vec4 = rows.read_int, rows.read_vec4
    Grid = grid_struct(scalar)
    region, run_of = grid_functions(scalar).region, grid_functions(scalar).run_of
    f = search_functions(scalar, True, bonds)
    query_of, padded_reach, is_neighbour = f.query_of, f.padded_reach, f.is_neighbour

    @wp.func
    def holds(i: wp.int32, j: wp.int32, radius_i: scalar, radius_j: scalar, first: wp.int32, last: wp.int32):
        if j < first or j >= last:
            return True
        return radius_j < radius_i or (radius_j == radius_i and j > i)

    @wp.func
    def near_another(x: t.vec3, reach: scalar, boxes: wp.array2d(dtype=t.vec3), part: wp.int32):
        """Return True if a sphere of another chunk may be within the distance `reach` of the position `x`.

        A chunk is the range of spheres that one CPU thread computes. `boxes` holds the bounding box of each chunk, and
        `part` is the index of the chunk that searches.
        """
        for other in range(boxes.shape[0]):
            if other != part:
                beyond = wp.max(wp.max(boxes[other, 0] - x, x - boxes[other, 1]), t.vec3())
                if wp.length_sq(beyond) < reach * reach:
                    return True
        return False

    @wp.kernel(module="unique", enable_backward=False)
    def search(
        grid: Grid,
        shift: wp.array(dtype=t.vec3),
        # `first` and `last` bound the chunk, which is the range of spheres of one CPU thread, and `part` is the index
        # of the chunk. `room` bounds the entries of `other` that belong to the chunk. `boxes` contains the bounding
        # boxes of all chunks.
        first: wp.int32,
        last: wp.int32,
        part: wp.int32,
        room: wp.vec2i,
        boxes: wp.array2d(dtype=t.vec3),
        # The next arguments are arrays of the simulated state that this kernel only reads.
        flags: wp.array2d(dtype=wp.int32),
        scenes: Scenes,
        spheres: Spheres,
        old_pairs: Pairs,
        old_place: wp.array(dtype=wp.int32),
        stretched: wp.array(dtype=scalar),
        # The next arguments are arrays that this kernel writes.
        count: wp.array(dtype=wp.int32),
        place: wp.array(dtype=wp.int32),
        wanted: wp.array(dtype=wp.int32),
        other: wp.array(dtype=wp.int32),
    ):
        row = room[0]
        for i in range(first, last):
            if flags[spheres.scene[i], STALE] == 0:
                continue
            query = query_of(scenes, spheres, stretched, i)
            s = query.s
            reach = query.radius + scenes.scale[s] * scenes.row[s].largest_radius + query.margin
            if not near_another(query.x, reach, boxes, part):
                reach = query.radius + query.radius + query.margin
            found = wp.int32(0)
            middle = query.x + shift[s]
            around = region(grid, middle, padded_reach(reach, middle))
            for number in range(around.runs):
                run = run_of(grid, around, number)
                for at in range(run[0], run[1]):
                    j = read_int(grid.point, at)
                    position_j = read_vec4(spheres.position, j)
                    if is_neighbour(scenes, spheres, old_pairs, old_place, stretched, query, i, j, position_j):
                        if holds(i, j, query.radius, position_j[3], first, last):
                            if row >= room[0] and row + found < room[1]:
                                insert(other, row, found, j - query.base)
                            found += 1
            count[i + s] = found
            place[i] = row
            row += found
        wanted[part] = row - room[0]

    return search
