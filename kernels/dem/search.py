"""Kernels that search a grid for neighbouring spheres.

All kernels run over a whole batch. They skip scenes whose neighbour lists are still valid.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.control import STALE
from ..common.rows import row_functions
from ..common.types import types, vector_functions
from .grid import grid_functions, grid_struct
from .pairs import decode
from .structs import array_structs


@functools.cache
def find_function(scalar, half: bool):
    """Return the function `find`, which finds a pair's list entry; a half list may contain it at either sphere."""
    Pairs = array_structs(scalar).Pairs
    read_int = row_functions(scalar).read_int

    @wp.func
    def find(pairs: Pairs, s: wp.int32, base: wp.int32, first: wp.int32, i: wp.int32, j: wp.int32):
        """Return the list entry of the pair of spheres i and j, or -1 if the list lacks the pair.

        `base` is the scene's first sphere, and `first` is its first list entry.
        """
        for k in range(first + pairs.start[i + s], first + pairs.start[i + s + 1]):
            if base + decode(read_int(pairs.other, k)) == j:
                return k
        if wp.static(half):
            for k in range(first + pairs.start[j + s], first + pairs.start[j + s + 1]):
                if base + decode(read_int(pairs.other, k)) == i:
                    return k
        return wp.int32(-1)

    return find


@wp.func
def insert(other: wp.array(dtype=wp.int32), row: wp.int32, found: wp.int32, entry: wp.int32):
    """Insert an entry at its sorted position in a list row that already holds `found` entries.

    Rows are sorted in ascending order, whatever the order in which the grid finds neighbours. The sums of a step then
    do not depend on the grid, which is shared by all scenes of a batch.
    """
    k = row + found
    for ahead in range(found):
        if other[k - 1] < entry:
            break
        other[k] = other[k - 1]
        k = k - 1
    other[k] = entry


@wp.func
def sort_row(other: wp.array(dtype=wp.int32), begin: wp.int32, end: wp.int32):
    """Sort the entries of `other` from `begin` to `end`, a long row, with Shell sort and Knuth's gap sequence."""
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


SQUARE_APART = """
#if defined(__CUDA_ARCH__)
    const SCALAR x = SUB(a[0], b[0]), y = SUB(a[1], b[1]), z = SUB(a[2], b[2]);
    return ADD(ADD(MUL(x, x), MUL(y, y)), MUL(z, z));
#else
    return wp::length_sq(a - b);
#endif
"""
"""Source of a function that returns the squared distance between two points.

Its intrinsics keep the GPU compiler from fusing multiply and add, so that the result is rounded the same way in every
kernel.
"""


@functools.cache
def close_function(scalar):
    """Return the function `is_close`: true if the gap between two spheres is below a limit.

    On a GPU the function gives the same answer wherever it is called. A bond exactly at the edge of the skin is
    therefore neither lost nor listed twice.
    """
    t = types(scalar)
    name, letter = ("double", "d") if scalar is wp.float64 else ("float", "f")
    snippet = SQUARE_APART.replace("SCALAR", name)
    for operation in ("SUB", "ADD", "MUL"):
        snippet = snippet.replace(operation, f"__{letter}{operation.lower()}_rn")

    @wp.func_native(snippet)
    def square_apart(a: t.vec3, b: t.vec3) -> scalar: ...

    @wp.func
    def is_close(a: t.vec3, radius_a: scalar, b: t.vec3, radius_b: scalar, gap: scalar) -> wp.bool:
        limit = radius_a + radius_b + gap
        return square_apart(a, b) < limit * limit

    return is_close


@functools.cache
def search_functions(scalar, half: bool, bonds: bool) -> SimpleNamespace:
    """Return the functions that decide where to search for neighbours and which spheres are neighbours.

    They are `query_of`, `padded_reach`, `is_neighbour` and `bonded_beyond_skin`. A bond may span a gap wider than the
    skin. Half lists find such pairs by a wider search in the grid, full lists take them from the old list
    (`bonded_beyond_skin`).
    """
    t = types(scalar)
    structs = array_structs(scalar)
    Scenes, Spheres, Pairs = structs.Scenes, structs.Spheres, structs.Pairs
    find = find_function(scalar, half)
    xyz = vector_functions(scalar).xyz
    read_vec4 = row_functions(scalar).read_vec4
    rounding = 8.0e-7 if scalar is wp.float32 else 1.6e-15

    @wp.struct
    class Query:
        s: wp.int32  # index in the batch of the sphere's scene
        base: wp.int32  # index of the scene's first sphere
        body: wp.int32
        x: t.vec3  # centre of the sphere [m]
        radius: scalar  # radius of the sphere [m]
        margin: scalar  # largest gap at which another sphere counts as a neighbour [m]

    is_close = close_function(scalar)
    wider = half and bonds

    @wp.func
    def query_of(scenes: Scenes, spheres: Spheres, stretched: wp.array(dtype=scalar), i: wp.int32) -> Query:
        query = Query()
        query.s = spheres.scene[i]
        query.base = scenes.row[query.s].spheres
        query.body = spheres.body[i]
        position = read_vec4(spheres.position, i)
        query.x = xyz(position)
        query.radius = position[3]
        query.margin = scenes.row[query.s].skin
        if wp.static(wider):
            query.margin = wp.max(stretched[i], query.margin)
        return query

    @wp.func
    def padded_reach(reach: scalar, middle: t.vec3) -> scalar:
        """Return `reach`, enlarged by the rounding errors of the shifted positions of the query and its neighbours."""
        return reach + scalar(wp.static(rounding)) * wp.max(wp.abs(middle))

    @wp.func
    def is_neighbour(
        scenes: Scenes, spheres: Spheres, old_pairs: Pairs, old_place: wp.array(dtype=wp.int32),
        stretched: wp.array(dtype=scalar), query: Query, i: wp.int32, j: wp.int32, position_j: t.vec4,
    ) -> wp.bool:  # fmt: skip
        """Return True if spheres i and j belong in the list as a pair.

        They belong if they are parts of different bodies of one scene and their gap is within the skin, or is spanned
        by a bond.
        """
        skin = scenes.row[query.s].skin
        close = is_close(query.x, query.radius, xyz(position_j), position_j[3], skin)
        if wp.static(wider):
            if not close and stretched[i] > skin and spheres.scene[j] == query.s:
                old = find(
                    old_pairs, query.s, query.base, scenes.row[query.s].pairs, old_place[i], old_place[j]
                )  # fmt: skip
                if old >= 0:
                    close = old_pairs.bond[old] > 0
        return close and spheres.body[j] != query.body and spheres.scene[j] == query.s

    @wp.func
    def bonded_beyond_skin(
        scenes: Scenes, spheres: Spheres, old_pairs: Pairs, new_place: wp.array(dtype=wp.int32), query: Query,
        old: wp.int32,
    ) -> wp.int32:  # fmt: skip
        """Return the index of the other sphere of an old list entry if the pair's bond spans a gap wider than the skin.

        Otherwise return -1.
        """
        if old_pairs.bond[old] <= 0:
            return -1
        j = new_place[query.base + decode(old_pairs.other[old])]
        position_j = read_vec4(spheres.position, j)
        if is_close(query.x, query.radius, xyz(position_j), position_j[3], scenes.row[query.s].skin):
            return -1
        return j

    return SimpleNamespace(
        Query=Query,
        query_of=query_of,
        padded_reach=padded_reach,
        is_neighbour=is_neighbour,
        bonded_beyond_skin=bonded_beyond_skin,
    )


@functools.cache
def half_search_kernel(scalar, bonds: bool) -> wp.Kernel:
    """Return the kernel ``search`` for half lists (CPU), which runs with one task per chunk.

    A chunk is the range of spheres of one CPU thread. Two rules decide where a pair is listed:

    - A pair inside a chunk is listed at its larger sphere; of two equal spheres, at that with the lower index. The
      search around a sphere then reaches no further than the sphere's own diameter plus the margin.
    - A pair across two chunks is listed at both spheres. A search near another chunk must therefore reach as far as the
      largest sphere.

    Each task writes the list entries of its spheres, one sphere after the other, to the buffer `other`. `room` is the
    range of entries in this buffer that the chunk may use. The output `wanted` is the number of entries that the chunk
    needs, which may exceed this range.
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
        """Return True if a neighbour within `reach` may belong to another chunk.

        `boxes` holds the bounding box of each chunk, and `part` is the index of the own chunk.
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
        # The next arguments are the range of spheres of this chunk and its index, the range of entries of `other` that
        # belongs to the chunk, and the bounding boxes of all chunks.
        first: wp.int32,
        last: wp.int32,
        part: wp.int32,
        room: wp.vec2i,
        boxes: wp.array2d(dtype=t.vec3),
        # The next arguments are arrays of the state that this kernel only reads.
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


@functools.cache
def octant_functions(scalar):
    """Return `side` (sign of an octant along an axis) and `within` (true if a point lies in an octant)."""
    t = types(scalar)

    @wp.func
    def side(octant: wp.int32, axis: wp.int32) -> scalar:
        return wp.where((octant >> axis) & 1 == 1, scalar(1.0), scalar(-1.0))

    @wp.func
    def within(away: t.vec3, octant: wp.int32) -> wp.bool:
        # Each point lies in exactly one octant, also on the boundaries.
        place = wp.where(away[0] < scalar(0.0), 0, 1) + wp.where(away[1] < scalar(0.0), 0, 2)
        return place + wp.where(away[2] < scalar(0.0), 0, 4) == octant

    return side, within


@functools.cache
def recording_functions(scalar, bonds: bool):
    """Return the functions `old_row` and `add_neighbour`, with which a search writes full neighbour lists.

    A full list contains each pair at both of its spheres.
    """
    structs = array_structs(scalar)
    Scenes, Pairs = structs.Scenes, structs.Pairs
    Query = search_functions(scalar, False, bonds).Query

    @wp.func
    def old_row(
        scenes: Scenes, old_pairs: Pairs, old_place: wp.array(dtype=wp.int32), query: Query, i: wp.int32
    ):  # fmt: skip
        """Return the first and the end index of a sphere's entries in the old neighbour list."""
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
    """Return the kernels ``search`` and ``fill`` for full lists (GPU).

    ``search`` counts the neighbours of each sphere (`count` must be zero before) and stores them in `finds` as far as
    there is room. After a prefix sum has given the row starts, ``fill`` writes the neighbours to their rows in sorted
    order. If there are few spheres, eight threads (`lanes`) share each sphere, and each thread searches one octant. The
    last element of `total` receives the length of the longest row that does not fit into `finds`.

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
    Query, query_of, padded_reach, is_neighbour, bonded_beyond_skin = (
        f.Query,
        f.query_of,
        f.padded_reach,
        f.is_neighbour,
        f.bonded_beyond_skin,
    )
    side, within = octant_functions(scalar)
    old_row, add_neighbour = recording_functions(scalar, bonds)

    @wp.func
    def reach_of(scenes: Scenes, query: Query) -> scalar:
        return query.radius + scenes.scale[query.s] * scenes.row[query.s].largest_radius + query.margin

    @wp.kernel(module="unique", enable_backward=False)
    def search(
        grid: Grid,
        shift: wp.array(dtype=t.vec3),
        # The next arguments are arrays of the state that this kernel only reads.
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
            # The neighbours of this sphere do not fit into `finds`, so search them again and write them to the list.
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
