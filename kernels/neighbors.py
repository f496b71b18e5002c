"""Verlet lists on Warp's hash grid, history carried over exactly, and spatial re-sorting.

All kernels run over a whole batch and pass by the scenes whose lists are fresh: those keep their rows.
"""

import functools
from types import SimpleNamespace

import warp as wp

from .contacts import ALL_TOUCHED, decode
from .rows import row_functions
from .types import FAILED, GOAL, HALTED, SINCE_BUILD, SPAN, STALE, STEPS, scene_struct, types, vector_functions


@functools.cache
def permute_kernel(dtype, columns: bool):
    """target[i] = source[order[i]], or the same for rows of a 2D array; a module of its own for each type."""
    if columns:

        @wp.kernel(module="unique", enable_backward=False)
        def permute_rows(
            source: wp.array2d(dtype=dtype), order: wp.array(dtype=wp.int32), target: wp.array2d(dtype=dtype)
        ):
            i, c = wp.tid()
            target[i, c] = source[order[i], c]

        return permute_rows

    @wp.kernel(module="unique", enable_backward=False)
    def permute(source: wp.array(dtype=dtype), order: wp.array(dtype=wp.int32), target: wp.array(dtype=dtype)):
        i = wp.tid()
        target[i] = source[order[i]]

    return permute


@wp.kernel(enable_backward=False)
def iota(target: wp.array(dtype=wp.int32)):
    """target[i] = i"""
    i = wp.tid()
    target[i] = i


@wp.kernel(enable_backward=False)
def invert(order: wp.array(dtype=wp.int32), inverse: wp.array(dtype=wp.int32)):
    """inverse[order[i]] = i"""
    i = wp.tid()
    inverse[order[i]] = i


@functools.cache
def order_kernels(scalar):
    """Kernels that re-sort bodies and their spheres: ``corner``, ``keys``, ``counts``, ``spheres``.

    Scenes keep their rows; inside those of a scene to be sorted (`sort[s]`) bodies follow the Morton code of their
    cell, in the others they stay.
    """
    t = types(scalar)
    SceneRow = scene_struct(scalar)

    @wp.func
    def cell_of(scene: SceneRow, x: scalar):
        return wp.int32(wp.floor(x / (scalar(2.0) * scene.largest_radius + scene.skin)))

    @wp.kernel(module="unique", enable_backward=False)
    def corner(
        scenes: wp.array(dtype=SceneRow),
        body_scene: wp.array(dtype=wp.int32),
        body_position: wp.array(dtype=t.vec3),
        lowest: wp.array2d(dtype=wp.int32),
    ):
        """Lowest cell of each scene in each direction."""
        b = wp.tid()
        s = body_scene[b]
        for c in range(3):
            index = cell_of(scenes[s], body_position[b][c])
            if index < lowest[s, c]:
                wp.atomic_min(lowest, s, c, index)

    @wp.kernel(module="unique", enable_backward=False)
    def keys(
        scenes: wp.array(dtype=SceneRow),
        sort: wp.array(dtype=wp.int32),
        lowest: wp.array2d(dtype=wp.int32),
        body_scene: wp.array(dtype=wp.int32),
        body_position: wp.array(dtype=t.vec3),
        key: wp.array(dtype=wp.int64),
        value: wp.array(dtype=wp.int32),
    ):
        """Scene, then Morton code of the body's cell from the lowest on, 10 bits a direction, wrapping beyond."""
        b = wp.tid()
        s = body_scene[b]
        code = wp.int32(0)
        if sort[s] != 0:
            for c in range(3):
                index = (cell_of(scenes[s], body_position[b][c]) - lowest[s, c]) & 1023
                for bit in range(10):
                    code = code | (((index >> bit) & 1) << (3 * bit + c))
        else:
            code = b - scenes[s].bodies
        key[b] = (wp.int64(s) << wp.int64(30)) | wp.int64(code)
        value[b] = b

    @wp.kernel(module="unique", enable_backward=False)
    def counts(
        body_scene: wp.array(dtype=wp.int32),
        order: wp.array(dtype=wp.int32),
        body_first: wp.array(dtype=wp.int32),
        count: wp.array(dtype=wp.int32),
    ):
        """Spheres of the body that comes to place i."""
        i = wp.tid()
        s = body_scene[i]
        count[i] = body_first[order[i] + s + 1] - body_first[order[i] + s]

    @wp.kernel(module="unique", enable_backward=False)
    def spheres(
        scenes: wp.array(dtype=SceneRow),
        body_scene: wp.array(dtype=wp.int32),
        order: wp.array(dtype=wp.int32),
        old_first: wp.array(dtype=wp.int32),
        new_start: wp.array(dtype=wp.int32),
        new_first: wp.array(dtype=wp.int32),
        old_place: wp.array(dtype=wp.int32),
        sphere_body: wp.array(dtype=wp.int32),
    ):
        """Old places of the spheres in their new order, their bodies' new places, and the bodies' first spheres."""
        i = wp.tid()
        s = body_scene[i]
        base = scenes[s].spheres
        for c in range(new_start[i + 1] - new_start[i]):
            old_place[new_start[i] + c] = base + old_first[order[i] + s] + c
            sphere_body[new_start[i] + c] = i - scenes[s].bodies
        new_first[i + s] = new_start[i] - base
        if i + 1 == scenes[s].bodies + scenes[s].body_count:
            new_first[i + s + 1] = new_start[i + 1] - base

    return SimpleNamespace(corner=corner, keys=keys, counts=counts, spheres=spheres)


@functools.cache
def neighbor_kernels(scalar, half: bool, history: bool, bonds: bool):
    """Kernels of one list layout: ``centres``, ``count``, ``search``, ``carry``, ``stretch``, ``starts``, ``drift``,
    ``freshen``.

    In the half list the larger sphere of a pair holds it (the lower place of two equal ones), so a search
    reaches no farther than its own diameter; pairs across chunks stand at both, so near another chunk the search
    reaches for the largest. On a GPU a count of pairs goes before the search that writes them. On a CPU one task
    searches for a chunk, writes one row after the other into the chunk's `room` of a buffer, and counts at once;
    `wanted` tells how much room the chunk needs.
    """
    t = types(scalar)
    span = 1 << 30 if half else 1
    SceneRow = scene_struct(scalar)
    xyz = vector_functions(scalar).xyz
    read_int, read_vec4 = row_functions(scalar).read_int, row_functions(scalar).read_vec4

    @wp.kernel(module="unique", enable_backward=False)
    def centres(
        flags: wp.array2d(dtype=wp.int32),
        sphere_scene: wp.array(dtype=wp.int32),
        sphere_position: wp.array(dtype=t.vec4),
        sphere_centre: wp.array(dtype=t.vec3),
        sphere_built: wp.array(dtype=t.vec4),
    ):
        i = wp.tid()
        sphere_centre[i] = xyz(sphere_position[i])
        if flags[sphere_scene[i], STALE] != 0:
            sphere_built[i] = sphere_position[i]

    @wp.func
    def holds(i: wp.int32, j: wp.int32, radius_i: scalar, radius_j: scalar, first: wp.int32, last: wp.int32):
        if wp.static(half):
            if j < first or j >= last:
                return True
            return radius_j < radius_i or (radius_j == radius_i and j > i)
        return i != j

    @wp.func
    def find(start: wp.array(dtype=wp.int32), other: wp.array(dtype=wp.int32), s: wp.int32, base: wp.int32,
             pairs: wp.int32, i: wp.int32, j: wp.int32):  # fmt: skip
        """Place of the pair in the old list, or -1. A half list may hold it at either sphere."""
        for k in range(pairs + start[i + s], pairs + start[i + s + 1]):
            if base + decode(read_int(other, k)) == j:
                return k
        if wp.static(half):
            for k in range(pairs + start[j + s], pairs + start[j + s + 1]):
                if base + decode(read_int(other, k)) == i:
                    return k
        return wp.int32(-1)

    @wp.func
    def near_another(x: t.vec3, reach: scalar, boxes: wp.array2d(dtype=t.vec3), part: wp.int32):
        """May a sphere that `reach` takes in belong to another chunk? `boxes` bound the centres of each chunk."""
        for other in range(boxes.shape[0]):
            if other != part:
                beyond = wp.max(wp.max(boxes[other, 0] - x, x - boxes[other, 1]), t.vec3())
                if wp.length_sq(beyond) < reach * reach:
                    return True
        return False

    def search_kernel(write: bool):
        @wp.kernel(module="unique", enable_backward=False)
        def search(
            scenes: wp.array(dtype=SceneRow),
            flags: wp.array2d(dtype=wp.int32),
            grid: wp.uint64,
            first: wp.int32,
            last: wp.int32,
            part: wp.int32,
            boxes: wp.array2d(dtype=t.vec3),
            sphere_scene: wp.array(dtype=wp.int32),
            sphere_position: wp.array(dtype=t.vec4),
            sphere_body: wp.array(dtype=wp.int32),
            scale: wp.array(dtype=scalar),
            stretched: wp.array(dtype=scalar),
            old_place: wp.array(dtype=wp.int32),
            old_start: wp.array(dtype=wp.int32),
            old_other: wp.array(dtype=wp.int32),
            old_bond: wp.array(dtype=wp.int32),
            start: wp.array(dtype=wp.int32),
            count: wp.array(dtype=wp.int32),
            place: wp.array(dtype=wp.int32),
            room: wp.vec2i,
            wanted: wp.array(dtype=wp.int32),
            other: wp.array(dtype=wp.int32),
        ):
            begin = first + wp.tid() * wp.static(span)
            row = room[0]
            for i in range(begin, wp.min(begin + wp.static(span), last)):
                s = sphere_scene[i]
                if flags[s, STALE] == 0:
                    continue
                base = scenes[s].spheres
                pairs = scenes[s].pairs
                skin = scenes[s].skin
                position = read_vec4(sphere_position, i)
                x = xyz(position)
                radius = position[3]
                body = sphere_body[i]
                margin = skin
                if wp.static(bonds):
                    margin = wp.max(stretched[i], skin)
                reach = radius + scale[s] * scenes[s].largest_radius + margin
                if wp.static(half):
                    if not near_another(x, reach, boxes, part):
                        reach = radius + radius + margin
                elif wp.static(write):
                    row = pairs + start[i + s]
                found = wp.int32(0)
                query = wp.hash_grid_query(grid, x, reach, s)
                j = wp.int32(0)
                while wp.hash_grid_query_next(query, j):
                    position_j = read_vec4(sphere_position, j)
                    limit = radius + position_j[3] + skin
                    close = wp.length_sq(xyz(position_j) - x) < limit * limit
                    if wp.static(bonds):
                        # Bonds that hold across a gap wider than the skin stay in the list.
                        if not close and stretched[i] > skin:
                            old = find(old_start, old_other, s, base, pairs, old_place[i], old_place[j])
                            if old >= 0:
                                close = old_bond[old] > 0
                    if close:
                        if holds(i, j, radius, position_j[3], first, last) and sphere_body[j] != body:
                            if wp.static(write):
                                if wp.static(not half) or (row >= room[0] and row + found < room[1]):
                                    # Rows ascend, whatever the order in which the grid finds neighbours: the sums
                                    # of a step then do not depend on the grid, which scenes of a batch share.
                                    k = row + found
                                    for ahead in range(found):
                                        if other[k - 1] < j - base:
                                            break
                                        other[k] = other[k - 1]
                                        k = k - 1
                                    other[k] = j - base
                            found += 1
                if wp.static(half or not write):
                    count[i + s] = found
                if wp.static(half):
                    place[i] = row
                    row += found
            if wp.static(half):
                wanted[part] = row - room[0]

        return search

    @wp.kernel(module="unique", enable_backward=False)
    def carry(
        scenes: wp.array(dtype=SceneRow),
        flags: wp.array2d(dtype=wp.int32),
        first: wp.int32,
        last: wp.int32,
        sphere_scene: wp.array(dtype=wp.int32),
        sphere_id: wp.array(dtype=wp.int32),
        place: wp.array(dtype=wp.int32),
        found: wp.array(dtype=wp.int32),
        old_place: wp.array(dtype=wp.int32),
        old_start: wp.array(dtype=wp.int32),
        old_other: wp.array(dtype=wp.int32),
        old_history: wp.array(dtype=t.vec3),
        old_bond: wp.array(dtype=wp.int32),
        old_bond_force: wp.array(dtype=t.vec4),
        old_bond_moment: wp.array(dtype=t.vec4),
        start: wp.array(dtype=wp.int32),
        sphere_touching: wp.array(dtype=wp.int32),
        other: wp.array(dtype=wp.int32),
        pair_history: wp.array(dtype=t.vec3),
        bond: wp.array(dtype=wp.int32),
        bond_force: wp.array(dtype=t.vec4),
        bond_moment: wp.array(dtype=t.vec4),
    ):
        """Entries of the new rows, each with what the pair brings from the old list."""
        begin = first + wp.tid() * wp.static(SPAN if half else 1)
        for i in range(begin, wp.min(begin + wp.static(SPAN if half else 1), last)):
            s = sphere_scene[i]
            if flags[s, STALE] == 0:
                continue
            base = scenes[s].spheres
            pairs = scenes[s].pairs
            if wp.static(history or bonds):
                sphere_touching[i] = wp.static(ALL_TOUCHED)
            for k in range(pairs + start[i + s], pairs + start[i + s + 1]):
                j = base + other[k]
                if wp.static(half):
                    j = base + found[place[i] + k - pairs - start[i + s]]
                entry = j - base
                if sphere_id[j] < sphere_id[i]:
                    entry = -1 - entry
                other[k] = entry
                if wp.static(history or bonds):
                    old = find(old_start, old_other, s, base, pairs, old_place[i], old_place[j])
                    if wp.static(history):
                        if old >= 0:
                            pair_history[k] = old_history[old]
                        else:
                            pair_history[k] = t.vec3()
                    if wp.static(bonds):
                        if old >= 0:
                            bond[k] = old_bond[old]
                            bond_force[k] = old_bond_force[old]
                            bond_moment[k] = old_bond_moment[old]
                        else:
                            bond[k] = 0
                            bond_force[k] = t.vec4()
                            bond_moment[k] = t.vec4()

    @wp.kernel(module="unique", enable_backward=False)
    def stretch(
        scenes: wp.array(dtype=SceneRow),
        flags: wp.array2d(dtype=wp.int32),
        sphere_scene: wp.array(dtype=wp.int32),
        sphere_position: wp.array(dtype=t.vec4),
        old_place: wp.array(dtype=wp.int32),
        new_place: wp.array(dtype=wp.int32),
        old_start: wp.array(dtype=wp.int32),
        old_other: wp.array(dtype=wp.int32),
        old_bond: wp.array(dtype=wp.int32),
        stretched: wp.array(dtype=scalar),
    ):
        """Longest gap of each sphere across which a bond of the old list holds, a little more for rounding."""
        i = wp.tid()
        s = sphere_scene[i]
        if flags[s, STALE] == 0:
            return
        base = scenes[s].spheres
        old_i = old_place[i]
        for old in range(scenes[s].pairs + old_start[old_i + s], scenes[s].pairs + old_start[old_i + s + 1]):
            if old_bond[old] > 0:
                j = new_place[base + decode(old_other[old])]
                position_j = sphere_position[j]
                distance = wp.length(xyz(position_j) - xyz(sphere_position[i]))
                gap = scalar(1.001) * (distance - sphere_position[i][3] - position_j[3])
                if gap > scenes[s].skin:
                    wp.atomic_max(stretched, i, gap)
                    wp.atomic_max(stretched, j, gap)

    @wp.kernel(module="unique", enable_backward=False)
    def starts(
        scenes: wp.array(dtype=SceneRow),
        flags: wp.array2d(dtype=wp.int32),
        slot_scene: wp.array(dtype=wp.int32),
        scanned: wp.array(dtype=wp.int32),
        start: wp.array(dtype=wp.int32),
        total: wp.array(dtype=wp.int32),
    ):
        """Row starts of the stale scenes from a scan over all; the last row of a scene tells how many pairs it has."""
        e = wp.tid()
        s = slot_scene[e]
        if flags[s, STALE] == 0:
            return
        begin = scenes[s].spheres + s
        start[e] = scanned[e] - scanned[begin]
        if e == begin + scenes[s].sphere_count:
            total[s] = scanned[e] - scanned[begin]

    @wp.kernel(module="unique", enable_backward=False)
    def drift(
        scenes: wp.array(dtype=SceneRow),
        flags: wp.array2d(dtype=wp.int32),
        sphere_velocity: wp.array(dtype=t.vec4),
        lanes: wp.array2d(dtype=wp.vec3d),
    ):
        """Sum of velocities of a share of a scene's spheres."""
        s, lane = wp.tid()
        if flags[s, STALE] == 0:
            return
        total = wp.vec3d()
        n = wp.int64(scenes[s].sphere_count)
        shares = wp.int64(lanes.shape[1])
        first = wp.int32(n * wp.int64(lane) / shares)
        last = wp.int32(n * wp.int64(lane + 1) / shares)
        for i in range(scenes[s].spheres + first, scenes[s].spheres + last):
            total += wp.vec3d(xyz(sphere_velocity[i]))
        lanes[s, lane] = total

    @wp.kernel(module="unique", enable_backward=False)
    def freshen(
        scenes: wp.array(dtype=SceneRow),
        lanes: wp.array2d(dtype=wp.vec3d),
        reference_velocity: wp.array(dtype=t.vec3),
        wall_moved: wp.array(dtype=wp.float64),
        clock: wp.array2d(dtype=wp.float64),
        flags: wp.array2d(dtype=wp.int32),
    ):
        """One thread a scene: the lists are as new; go on, unless the goal is reached."""
        s = wp.tid()
        if flags[s, STALE] == 0:
            return
        total = wp.vec3d()
        for lane in range(lanes.shape[1]):
            total += lanes[s, lane]
        reference_velocity[s] = t.vec3(total / wp.float64(wp.max(scenes[s].sphere_count, 1)))
        for w in range(scenes[s].walls, scenes[s].walls + scenes[s].wall_count):
            wall_moved[w] = wp.float64(0.0)
        clock[s, SINCE_BUILD] = wp.float64(0.0)
        flags[s, STALE] = 0
        if flags[s, STEPS] < flags[s, GOAL] and flags[s, FAILED] == 0:
            flags[s, HALTED] = 0

    return SimpleNamespace(
        centres=centres, count=search_kernel(False), search=search_kernel(True), carry=carry, stretch=stretch,
        starts=starts, drift=drift, freshen=freshen,
    )  # fmt: skip
