"""Verlet lists on Warp's hash grid, with contact history carried over exactly.

All kernels run over a whole batch and pass by the scenes whose lists are fresh: those keep their rows.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.control import FAILED, GOAL, HALTED, STALE, STEPS
from ..common.rows import row_functions
from ..common.types import SPAN, lane_functions, types, vector_functions
from .pairs import ALL_TOUCHED, decode
from .structs import SINCE_BUILD, array_structs


@functools.cache
def find_function(scalar, half: bool):
    """`find`: the place of a pair in a list, or -1. A half list may hold it at either sphere."""
    Pairs = array_structs(scalar).Pairs
    read_int = row_functions(scalar).read_int

    @wp.func
    def find(pairs: Pairs, s: wp.int32, base: wp.int32, first: wp.int32, i: wp.int32, j: wp.int32):
        """`base` is the scene's first sphere, `first` its first entry."""
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
    """Put an entry into a row that so far has `found`, in its place.

    Rows ascend, whatever the order in which the grid finds neighbours: the sums of a step then do not depend on the
    grid, which scenes of a batch share.
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
    """Put the entries of a row in order."""
    for k in range(begin + 1, end):
        insert(other, begin, k - begin, other[k])


@functools.cache
def search_functions(scalar, half: bool) -> SimpleNamespace:
    """Who is searched for: `side` and `within` of octants, `holds` of pairs, `near_another` of chunks."""
    t = types(scalar)

    @wp.func
    def side(octant: wp.int32, axis: wp.int32) -> scalar:
        """Which way along an axis an octant lies."""
        return wp.where((octant >> axis) & 1 == 1, scalar(1.0), scalar(-1.0))

    @wp.func
    def within(away: t.vec3, octant: wp.int32) -> wp.bool:
        """Is a place this far from the middle in an octant? Every place is in one."""
        place = wp.where(away[0] < scalar(0.0), 0, 1) + wp.where(away[1] < scalar(0.0), 0, 2)
        return place + wp.where(away[2] < scalar(0.0), 0, 4) == octant

    @wp.func
    def holds(i: wp.int32, j: wp.int32, radius_i: scalar, radius_j: scalar, first: wp.int32, last: wp.int32):
        if wp.static(half):
            if j < first or j >= last:
                return True
            return radius_j < radius_i or (radius_j == radius_i and j > i)
        return i != j

    @wp.func
    def near_another(x: t.vec3, reach: scalar, boxes: wp.array2d(dtype=t.vec3), part: wp.int32):
        """May a sphere that `reach` takes in belong to another chunk? `boxes` bound the centres of each chunk."""
        for other in range(boxes.shape[0]):
            if other != part:
                beyond = wp.max(wp.max(boxes[other, 0] - x, x - boxes[other, 1]), t.vec3())
                if wp.length_sq(beyond) < reach * reach:
                    return True
        return False

    return SimpleNamespace(side=side, within=within, holds=holds, near_another=near_another)


@functools.cache
def search_kernels(scalar, half: bool, bonds: bool, lanes: int = 1):
    """Kernels ``count`` and ``search``.

    In the half list the larger sphere of a pair holds it (the lower place of two equal ones), so a search
    reaches no farther than its own diameter; pairs across chunks stand at both, so near another chunk the search
    reaches for the largest. On a GPU a count of pairs goes before the search that writes them. On a CPU one task
    searches for a chunk, writes one row after the other into the chunk's `room` of a buffer, and counts at once;
    `wanted` tells how much room the chunk needs. Of few spheres each has eight `lanes` of a GPU, threads beside one
    another, each of which searches one octant around it; `shares` tells how much each finds.
    """
    t = types(scalar)
    span = 1 << 30 if half else 1
    structs = array_structs(scalar)
    Scenes, Spheres, Pairs = structs.Scenes, structs.Spheres, structs.Pairs
    find = find_function(scalar, half)
    xyz = vector_functions(scalar).xyz
    read_vec4 = row_functions(scalar).read_vec4
    together = lane_functions(scalar, lanes)

    f = search_functions(scalar, half)
    side, within, holds, near_another = f.side, f.within, f.holds, f.near_another

    def kernel(write: bool):
        @wp.kernel(module="unique", enable_backward=False)
        def search(
            grid: wp.uint64,
            # chunk
            first: wp.int32,
            last: wp.int32,
            part: wp.int32,
            boxes: wp.array2d(dtype=t.vec3),
            # state, read
            flags: wp.array2d(dtype=wp.int32),
            scenes: Scenes,
            spheres: Spheres,
            old_pairs: Pairs,
            old_place: wp.array(dtype=wp.int32),
            stretched: wp.array(dtype=scalar),
            # written: counts, and where a GPU has them already, the rows
            pairs: Pairs,
            count: wp.array(dtype=wp.int32),
            place: wp.array(dtype=wp.int32),
            room: wp.vec2i,
            wanted: wp.array(dtype=wp.int32),
            other: wp.array(dtype=wp.int32),
            shares: wp.array(dtype=wp.int32),
        ):
            lane = wp.tid() % lanes
            begin = first + wp.tid() / lanes * wp.static(span)
            row = room[0]
            for i in range(begin, wp.min(begin + wp.static(span), last)):
                s = spheres.scene[i]
                if flags[s, STALE] == 0:
                    continue
                base = scenes.row[s].spheres
                skin = scenes.row[s].skin
                position = read_vec4(spheres.position, i)
                x = xyz(position)
                radius = position[3]
                body = spheres.body[i]
                margin = skin
                if wp.static(bonds):
                    margin = wp.max(stretched[i], skin)
                reach = radius + scenes.scale[s] * scenes.row[s].largest_radius + margin
                if wp.static(half):
                    if not near_another(x, reach, boxes, part):
                        reach = radius + radius + margin
                elif wp.static(write):
                    row = scenes.row[s].pairs + pairs.start[i + s]
                found = wp.int32(0)
                middle = x
                if wp.static(lanes > 1):
                    middle += scalar(0.5) * reach * t.vec3(side(lane, 0), side(lane, 1), side(lane, 2))
                    reach = scalar(0.501) * reach
                    if wp.static(write):
                        for k in range(lane):
                            row += shares[i * lanes + k]
                query = wp.hash_grid_query(grid, middle, reach, s)
                j = wp.int32(0)
                while wp.hash_grid_query_next(query, j):
                    position_j = read_vec4(spheres.position, j)
                    limit = radius + position_j[3] + skin
                    close = wp.length_sq(xyz(position_j) - x) < limit * limit
                    if wp.static(lanes > 1):
                        close = close and within(xyz(position_j) - x, lane)
                    if wp.static(bonds):
                        # Bonds that hold across a gap wider than the skin stay in the list.
                        far = not close and stretched[i] > skin
                        if wp.static(lanes > 1):
                            far = far and within(xyz(position_j) - x, lane)
                        if far:
                            old = find(old_pairs, s, base, scenes.row[s].pairs, old_place[i], old_place[j])
                            if old >= 0:
                                close = old_pairs.bond[old] > 0
                    if close:
                        if holds(i, j, radius, position_j[3], first, last) and spheres.body[j] != body:
                            if wp.static(write):
                                if wp.static(not half) or (row >= room[0] and row + found < room[1]):
                                    insert(other, row, found, j - base)
                            found += 1
                if wp.static(lanes > 1):
                    if wp.static(write):
                        together.meet_lanes()
                        if lane == 0:
                            sort_row(other, row, scenes.row[s].pairs + pairs.start[i + s + 1])
                    else:
                        shares[i * lanes + lane] = found
                        found = together.total_int(found)
                if wp.static(half or not write):
                    count[i + s] = found
                if wp.static(half):
                    place[i] = row
                    row += found
            if wp.static(half):
                wanted[part] = row - room[0]

        return search

    return kernel(False), kernel(True)


@functools.cache
def transfer_kernel(scalar, half: bool, history: bool, bonds: bool, lanes: int = 1):
    """Kernel over the spheres of a chunk: entries of the new rows, each with what the pair brings from the old list.

    A sphere's entries fall to so many `lanes`, threads of a GPU, in turn.
    """
    t = types(scalar)
    span = SPAN if half else 1
    structs = array_structs(scalar)
    Scenes, Spheres, Pairs = structs.Scenes, structs.Spheres, structs.Pairs
    find = find_function(scalar, half)

    @wp.kernel(module="unique", enable_backward=False)
    def transfer_history(
        # chunk
        first: wp.int32,
        last: wp.int32,
        # read
        flags: wp.array2d(dtype=wp.int32),
        scenes: Scenes,
        old_pairs: Pairs,
        old_place: wp.array(dtype=wp.int32),
        place: wp.array(dtype=wp.int32),
        found: wp.array(dtype=wp.int32),
        # read and written
        spheres: Spheres,
        pairs: Pairs,
    ):
        lane = wp.tid() % lanes
        begin = first + wp.tid() / lanes * wp.static(span)
        for i in range(begin, wp.min(begin + wp.static(span), last)):
            s = spheres.scene[i]
            if flags[s, STALE] == 0:
                continue
            base = scenes.row[s].spheres
            row = scenes.row[s].pairs
            if wp.static(half and (history or bonds)):
                spheres.touching[i] = wp.static(ALL_TOUCHED)
            for k in range(row + pairs.start[i + s] + lane, row + pairs.start[i + s + 1], lanes):
                j = base + pairs.other[k]
                if wp.static(half):
                    j = base + found[place[i] + k - row - pairs.start[i + s]]
                entry = j - base
                if spheres.id[j] < spheres.id[i]:
                    entry = -1 - entry
                pairs.other[k] = entry
                if wp.static(history or bonds):
                    old = find(old_pairs, s, base, row, old_place[i], old_place[j])
                    if wp.static(history):
                        if old >= 0:
                            pairs.history[k] = old_pairs.history[old]
                        else:
                            pairs.history[k] = t.vec3()
                    if wp.static(bonds):
                        if old >= 0:
                            pairs.bond[k] = old_pairs.bond[old]
                            pairs.bond_force[k] = old_pairs.bond_force[old]
                            pairs.bond_moment[k] = old_pairs.bond_moment[old]
                        else:
                            pairs.bond[k] = 0
                            pairs.bond_force[k] = t.vec4()
                            pairs.bond_moment[k] = t.vec4()

    return transfer_history


@functools.cache
def list_kernels(scalar):
    """Kernels around a search: ``centres``, ``stretch``, ``starts``, ``drift``, ``clear_stale``."""
    t = types(scalar)
    structs = array_structs(scalar)
    Scenes, Spheres, Pairs, Walls = structs.Scenes, structs.Spheres, structs.Pairs, structs.Walls
    xyz = vector_functions(scalar).xyz

    @wp.kernel(module="unique", enable_backward=False)
    def centres(flags: wp.array2d(dtype=wp.int32), spheres: Spheres, centre: wp.array(dtype=t.vec3)):
        """Points for the grid; from here on spheres of stale scenes count how far they go."""
        i = wp.tid()
        centre[i] = xyz(spheres.position[i])
        if flags[spheres.scene[i], STALE] != 0:
            spheres.built[i] = spheres.position[i]

    @wp.kernel(module="unique", enable_backward=False)
    def stretch(
        flags: wp.array2d(dtype=wp.int32),
        scenes: Scenes,
        spheres: Spheres,
        old_pairs: Pairs,
        old_place: wp.array(dtype=wp.int32),
        new_place: wp.array(dtype=wp.int32),
        stretched: wp.array(dtype=scalar),
    ):
        """Longest gap of each sphere across which a bond of the old list holds, a little more for rounding."""
        i = wp.tid()
        s = spheres.scene[i]
        if flags[s, STALE] == 0:
            return
        base = scenes.row[s].spheres
        row = scenes.row[s].pairs
        old_i = old_place[i]
        for old in range(row + old_pairs.start[old_i + s], row + old_pairs.start[old_i + s + 1]):
            if old_pairs.bond[old] > 0:
                j = new_place[base + decode(old_pairs.other[old])]
                distance = wp.length(xyz(spheres.position[j]) - xyz(spheres.position[i]))
                gap = scalar(1.001) * (distance - spheres.position[i][3] - spheres.position[j][3])
                if gap > scenes.row[s].skin:
                    wp.atomic_max(stretched, i, gap)
                    wp.atomic_max(stretched, j, gap)

    @wp.kernel(module="unique", enable_backward=False)
    def starts(
        flags: wp.array2d(dtype=wp.int32),
        scenes: Scenes,
        slot_scene: wp.array(dtype=wp.int32),
        scanned: wp.array(dtype=wp.int32),
        start: wp.array(dtype=wp.int32),
        total: wp.array(dtype=wp.int32),
    ):
        """Row starts of the stale scenes from a scan over all; a scene's last row tells how many entries it has."""
        e = wp.tid()
        s = slot_scene[e]
        if flags[s, STALE] == 0:
            return
        begin = scenes.row[s].spheres + s
        start[e] = scanned[e] - scanned[begin]
        if e == begin + scenes.row[s].sphere_count:
            total[s] = scanned[e] - scanned[begin]

    @wp.kernel(module="unique", enable_backward=False)
    def drift(flags: wp.array2d(dtype=wp.int32), scenes: Scenes, spheres: Spheres, lanes: wp.array2d(dtype=wp.vec3d)):
        """Sum of velocities of a part of a scene's spheres."""
        s, lane = wp.tid()
        if flags[s, STALE] == 0:
            return
        total = wp.vec3d()
        n = wp.int64(scenes.row[s].sphere_count)
        parts = wp.int64(lanes.shape[1])
        first = wp.int32(n * wp.int64(lane) / parts)
        last = wp.int32(n * wp.int64(lane + 1) / parts)
        for i in range(scenes.row[s].spheres + first, scenes.row[s].spheres + last):
            total += wp.vec3d(xyz(spheres.velocity[i]))
        lanes[s, lane] = total

    @wp.kernel(module="unique", enable_backward=False)
    def clear_stale(lanes: wp.array2d(dtype=wp.vec3d), flags: wp.array2d(dtype=wp.int32), scenes: Scenes, walls: Walls):
        """One thread a scene: the lists are as new; go on, unless the goal is reached."""
        s = wp.tid()
        if flags[s, STALE] == 0:
            return
        total = wp.vec3d()
        for lane in range(lanes.shape[1]):
            total += lanes[s, lane]
        scenes.reference_velocity[s] = t.vec3(total / wp.float64(wp.max(scenes.row[s].sphere_count, 1)))
        for w in range(scenes.row[s].walls, scenes.row[s].walls + scenes.row[s].wall_count):
            walls.moved[w] = wp.float64(0.0)
        scenes.clock[s, SINCE_BUILD] = wp.float64(0.0)
        flags[s, STALE] = 0
        if flags[s, STEPS] < flags[s, GOAL] and flags[s, FAILED] == 0:
            flags[s, HALTED] = 0

    return SimpleNamespace(centres=centres, stretch=stretch, starts=starts, drift=drift, clear_stale=clear_stale)
