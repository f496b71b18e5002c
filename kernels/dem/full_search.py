"""Search for neighbours on a GPU: every pair is listed at both of its spheres.

The kernels run over all scenes of a batch, and skip scenes whose neighbour lists are still valid.
"""

import functools

import warp as wp

from ..common.control import STALE
from ..common.rows import row_functions
from ..common.types import types, vector_functions
from .grid import grid_functions, grid_struct
from .search import search_functions
from .structs import array_structs


@wp.func
def sort_row(other: wp.array(dtype=wp.int32), begin: wp.int32, end: wp.int32):
    """Sort the entries `begin` to `end` - 1 of `other` with Shell sort (Knuth's gaps), which is fast for long rows."""
    gap = wp.int32(1)
    while gap < (end - begin) / 3:
        gap = 3 * gap + 1
    while gap > 0:
        for k in range(begin + gap, end):
            entry = other[k]
            at = wp.int32(k)
            while at - gap >= begin and other[wp.max(at - gap, 0)] > entry:
                other[at] = other[at - gap]
                at = at - gap
            other[at] = entry
        gap = gap / 3


@functools.cache
def octant_functions(scalar):
    """Return `side` and `within`, functions for the eight octants around a sphere's centre.

    `side` returns the sign (1 or -1) of an octant along an axis, and `within` returns true if a vector from the centre
    lies in an octant.
    """
    t = types(scalar)

    @wp.func
    def side(octant: wp.int32, axis: wp.int32) -> scalar:
        return wp.where((octant >> axis) & 1 == 1, scalar(1.0), scalar(-1.0))

    @wp.func
    def within(away: t.vec3, octant: wp.int32) -> wp.bool:
        # The comparisons assign each point to exactly one octant, also if it lies on a boundary between octants.
        place = wp.where(away[0] < scalar(0.0), 0, 1) + wp.where(away[1] < scalar(0.0), 0, 2)
        return place + wp.where(away[2] < scalar(0.0), 0, 4) == octant

    return side, within


@functools.cache
def recording_functions(scalar, bonds: bool):
    """Return the functions `old_row` and `add_neighbour`, with which a search writes full neighbour lists.

    A full list contains each pair at both of its spheres. `old_row` returns the range of a sphere's entries in the old
    list, and `add_neighbour` records an entry of the new list.
    """
    structs = array_structs(scalar)
    Scenes, Pairs = structs.Scenes, structs.Pairs
    Query = search_functions(scalar, False, bonds).Query

    @wp.func
    def old_row(
        scenes: Scenes, old_pairs: Pairs, old_place: wp.array(dtype=wp.int32), query: Query, i: wp.int32
    ):  # fmt: skip
        """Return the index of a sphere's first entry in the old neighbour list, and the index after its last entry."""
        row = scenes.row[query.s].pairs
        place = old_place[i] + query.s
        return row + old_pairs.start[place], row + old_pairs.start[place + 1]

    @wp.func
    def add_neighbour(
        count: wp.array(dtype=wp.int32), finds: wp.array2d(dtype=wp.int32), total: wp.array(dtype=wp.int32),
        query: Query, i: wp.int32, j: wp.int32,
    ):  # fmt: skip
        """Count a neighbour of sphere i, and store the neighbour's index in `finds` if there is room."""
        found = wp.atomic_add(count, i + query.s, 1)
        if found < finds.shape[0]:
            finds[found, i] = j - query.base
        else:
            wp.atomic_max(total, total.shape[0] - 1, found + 1)

    return old_row, add_neighbour


@functools.cache
def full_search_kernels(scalar, bonds: bool, lanes: int) -> tuple[wp.Kernel, wp.Kernel]:
    """Return the kernels ``search`` and ``fill``, which write a GPU's full lists: each pair is listed at both spheres.

    ``search`` counts the neighbours of each sphere in `count`, which must be zero before the launch, and stores as many
    of them as fit in the buffer `finds`. A prefix sum of the counts then yields the start of each sphere's row in the
    list, and ``fill`` writes the neighbours to their rows in sorted order. If there are few spheres, eight threads
    (`lanes`) share each sphere, and each thread searches one octant. The last element of `total` receives the length of
    the longest row that does not fit into `finds`.

    Pairs whose bond spans a gap wider than the skin are copied from the old list. A wider search in the grid would make
    a few threads slow and let all others wait for them.
    """
    t = types(scalar)
    structs = array_structs(scalar)
    Scenes, Spheres, Pairs = structs.Scenes, structs.Spheres, structs.Pairs
    xyz = vector_functions(scalar).xyz
    rows = row_functions(scalar)
    read_int, read_vec4 = rows.read_int, rows.read_vec4
    Grid = grid_struct(scalar)
    region, run_of = grid_functions(scalar).region, grid_functions(scalar).run_of
    f = search_functions(scalar, False, bonds)
    Query, query_of, padded_reach, is_neighbour = f.Query, f.query_of, f.padded_reach, f.is_neighbour
    bonded_beyond_skin = f.bonded_beyond_skin
    side, within = octant_functions(scalar)
    old_row, add_neighbour = recording_functions(scalar, bonds)

    @wp.func
    def reach_of(scenes: Scenes, query: Query) -> scalar:
        return query.radius + scenes.scale[query.s] * scenes.row[query.s].largest_radius + query.margin

    @wp.kernel(module="unique", enable_backward=False)
    def search(
        grid: Grid,
        shift: wp.array(dtype=t.vec3),
        # The next arguments are arrays of the simulated state that this kernel only reads.
        flags: wp.array2d(dtype=wp.int32),
        scenes: Scenes,
        spheres: Spheres,
        old_pairs: Pairs,
        old_place: wp.array(dtype=wp.int32),
        new_place: wp.array(dtype=wp.int32),
        stretched: wp.array(dtype=scalar),
        # The next arguments are arrays that this kernel writes.
        count: wp.array(dtype=wp.int32),
        finds: wp.array2d(dtype=wp.int32),
        total: wp.array(dtype=wp.int32),
    ):
        i = wp.tid() / lanes
        lane = wp.tid() % lanes
        if flags[spheres.scene[i], STALE] == 0:
            return
        query = query_of(scenes, spheres, stretched, i)
        reach = reach_of(scenes, query)
        middle = query.x + shift[query.s]
        if wp.static(lanes > 1):
            middle += scalar(0.5) * reach * t.vec3(side(lane, 0), side(lane, 1), side(lane, 2))
            reach = scalar(0.5) * reach
        around = region(grid, middle, padded_reach(reach, middle))
        for number in range(around.runs):
            run = run_of(grid, around, number)
            for at in range(run[0], run[1]):
                j = read_int(grid.point, at)
                position_j = read_vec4(spheres.position, j)
                if wp.static(lanes > 1):
                    if not within(xyz(position_j) - query.x, lane):
                        continue
                if is_neighbour(scenes, spheres, old_pairs, old_place, stretched, query, i, j, position_j):
                    add_neighbour(count, finds, total, query, i, j)
        if wp.static(bonds):
            first, last = old_row(scenes, old_pairs, old_place, query, i)
            for old in range(first + lane, last, lanes):
                j = bonded_beyond_skin(scenes, spheres, old_pairs, new_place, query, old)
                if j >= 0:
                    add_neighbour(count, finds, total, query, i, j)

    @wp.kernel(module="unique", enable_backward=False)
    def fill(
        grid: Grid, shift: wp.array(dtype=t.vec3), flags: wp.array2d(dtype=wp.int32), scenes: Scenes, spheres: Spheres,
        old_pairs: Pairs, old_place: wp.array(dtype=wp.int32), new_place: wp.array(dtype=wp.int32),
        stretched: wp.array(dtype=scalar), count: wp.array(dtype=wp.int32), finds: wp.array2d(dtype=wp.int32),
        pairs: Pairs,
    ):  # fmt: skip
        i = wp.tid() / lanes
        s = spheres.scene[i]
        if flags[s, STALE] == 0:
            return
        row = scenes.row[s].pairs + pairs.start[i + s]
        total = count[i + s]
        if total <= finds.shape[0]:
            for k in range(wp.tid() % lanes, total, lanes):
                entry = finds[k, i]
                before = wp.int32(0)
                for m in range(total):
                    before += wp.where(finds[m, i] < entry, 1, 0)
                pairs.other[row + before] = entry
        elif wp.tid() % lanes == 0:
            # The buffer `finds` had no room for the neighbours of this sphere, so search again and write them to the
            # list.
            query = query_of(scenes, spheres, stretched, i)
            middle = query.x + shift[s]
            found = wp.int32(0)
            around = region(grid, middle, padded_reach(reach_of(scenes, query), middle))
            for number in range(around.runs):
                run = run_of(grid, around, number)
                for at in range(run[0], run[1]):
                    j = read_int(grid.point, at)
                    position_j = read_vec4(spheres.position, j)
                    if is_neighbour(scenes, spheres, old_pairs, old_place, stretched, query, i, j, position_j):
                        if found < total:
                            pairs.other[row + found] = j - query.base
                            found += 1
            if wp.static(bonds):
                first, last = old_row(scenes, old_pairs, old_place, query, i)
                for old in range(first, last):
                    j = bonded_beyond_skin(scenes, spheres, old_pairs, new_place, query, old)
                    if j >= 0 and found < total:
                        pairs.other[row + found] = j - query.base
                        found += 1
            sort_row(pairs.other, row, row + found)

    return search, fill
