"""Kernels that build neighbour (Verlet) lists from the result of a search.

They copy contact histories and bonds from the old lists to the new lists without any change. All kernels run over all
scenes of a batch. They skip scenes whose lists are still valid and leave these lists unchanged.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.control import ARRIVED, FAILED, HALTED, STALE
from ..common.types import SPAN, module_of, types, vector_functions
from .bond_parallel import bond_with, kind_of, load_row
from .clock import arrived_function
from .pairs import ALL_TOUCHED, decode
from .search import find_function
from .structs import SINCE_BUILD, array_structs

SAMPLED: int = wp.constant(16)
"""Approximate number of spheres sampled in each part of a scene to estimate the mean velocity of its spheres.

The spheres of a scene are divided into parts of equal size, each of which yields one partial sum.
"""


@functools.cache
def transfer_kernel(
    scalar, half: bool, history: bool, rolls: bool, bonds: bool, healing: bool, lanes: int = 1
) -> wp.Kernel:
    """Return a kernel that completes a new neighbour list and copies data of each pair from the old list.

    These data are the contact history, the rolling moment and the bond. A launch runs over the range of spheres of one
    CPU thread, or over all spheres on a GPU, where `lanes` threads share the entries of a sphere. The class `Features`
    in `warpcrete/dem/engine/model.py` explains the flags.
    """
    t = types(scalar)
    span = SPAN if half else 1
    structs = array_structs(scalar)
    Scenes, Spheres, Pairs = structs.Scenes, structs.Spheres, structs.Pairs
    find = find_function(scalar, half)

    @wp.func
    def row_of_entry(scenes: Scenes, pairs: Pairs, s: wp.int32, bond: wp.int32, own: wp.bool):
        """Return the bond state to store at one entry of a half neighbour list.

        If the two spheres of a pair belong to different CPU threads, the pair has two list entries, and both threads
        compute its bond. Each entry then needs its own copy of the bond's force and moment. The entry at the sphere
        with the lower permanent number (`own`) uses an even row of `pairs.load`. The other entry uses the odd row after
        it.
        """
        found = bond
        if bond > 0:
            row = load_row(bond) / 2 * 2
            if not own:
                first = scenes.row[s].loads
                pairs.load[first + row + 1] = pairs.load[first + row]
                row += 1
            found = bond_with(kind_of(bond), row)
        return found

    @wp.kernel(module="unique", enable_backward=False)
    def transfer_history(
        # The next arguments are the range of spheres that this launch processes.
        first: wp.int32,
        last: wp.int32,
        # The next arguments are arrays that this kernel only reads.
        flags: wp.array2d(dtype=wp.int32),
        scenes: Scenes,
        old_pairs: Pairs,
        old_place: wp.array(dtype=wp.int32),
        place: wp.array(dtype=wp.int32),
        found: wp.array(dtype=wp.int32),
        # The next arguments are arrays that this kernel reads and writes.
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
                            pairs.history[k] = t.vec4()
                    if wp.static(rolls):
                        if old >= 0:
                            pairs.rolling[k] = old_pairs.rolling[old]
                        else:
                            pairs.rolling[k] = t.vec3()
                    if wp.static(bonds):
                        bond = wp.int32(0)
                        if old >= 0:
                            bond = old_pairs.bond[old]
                        if wp.static(healing):
                            # If the pair has no bond yet, a bond that forms later must start with zero force and
                            # moment.
                            load = t.vec8()
                            if bond > 0:
                                load = old_pairs.load[old]
                                bond = bond_with(kind_of(bond), k - row)
                            pairs.load[k] = load
                        elif wp.static(half):
                            bond = row_of_entry(scenes, pairs, s, bond, entry >= 0 or (j >= first and j < last))
                        pairs.bond[k] = bond

    return transfer_history


@functools.cache
def list_kernels(scalar) -> SimpleNamespace:
    """Return the kernels that run before and after a search for neighbours.

    Before the search, ``centres`` prepares the points to search, and ``stretch`` finds long bonds. After the search,
    ``starts`` computes where the lists of the spheres begin, ``drift`` estimates the mean velocity of each scene, and
    ``clear_stale`` marks the new lists as valid.
    """
    t = types(scalar)
    structs = array_structs(scalar)
    Scenes, Spheres, Pairs, Walls = structs.Scenes, structs.Spheres, structs.Pairs, structs.Walls
    xyz = vector_functions(scalar).xyz
    arrived = arrived_function(scalar)

    @wp.kernel(module=module_of("lists", scalar), enable_backward=False)
    def centres(
        flags: wp.array2d(dtype=wp.int32), shift: wp.array(dtype=t.vec3), spheres: Spheres,
        centre: wp.array(dtype=t.vec3),
    ):  # fmt: skip
        """Write the centre of each sphere, shifted by the `shift` of its scene, as a point for the search grid.

        In scenes whose lists are being rebuilt, also store the present positions, from which later displacements are
        measured.
        """
        i = wp.tid()
        centre[i] = xyz(spheres.position[i]) + shift[spheres.scene[i]]
        if flags[spheres.scene[i], STALE] != 0:
            spheres.built[i] = spheres.position[i]

    @wp.kernel(module=module_of("lists", scalar), enable_backward=False)
    def stretch(
        flags: wp.array2d(dtype=wp.int32),
        scenes: Scenes,
        spheres: Spheres,
        old_pairs: Pairs,
        old_place: wp.array(dtype=wp.int32),
        new_place: wp.array(dtype=wp.int32),
        stretched: wp.array(dtype=scalar),
    ):
        """Store for each sphere the longest gap that one of its bonds spans, with a margin for rounding.

        The bonds are read from the old neighbour list. Only gaps longer than the skin are stored, because the search
        for neighbours finds all pairs with shorter gaps anyway.
        """
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

    @wp.kernel(module=module_of("lists", scalar), enable_backward=False)
    def starts(
        flags: wp.array2d(dtype=wp.int32),
        scenes: Scenes,
        slot_scene: wp.array(dtype=wp.int32),
        scanned: wp.array(dtype=wp.int32),
        start: wp.array(dtype=wp.int32),
        total: wp.array(dtype=wp.int32),
    ):
        """Compute where each sphere's row begins in the list of its scene, for scenes whose lists are being rebuilt.

        `scanned` contains prefix sums of the row lengths over the whole batch. The end of the last row is the number of
        list entries of the scene, which is stored in `total`.
        """
        e = wp.tid()
        s = slot_scene[e]
        if flags[s, STALE] == 0:
            return
        begin = scenes.row[s].spheres + s
        start[e] = scanned[e] - scanned[begin]
        if e == begin + scenes.row[s].sphere_count:
            total[s] = scanned[e] - scanned[begin]

    @wp.kernel(module=module_of("lists", scalar), enable_backward=False)
    def drift(flags: wp.array2d(dtype=wp.int32), scenes: Scenes, spheres: Spheres, lanes: wp.array2d(dtype=wp.vec3d)):
        """Add up the velocities of a sample of each scene's spheres, to estimate the spheres' mean velocity.

        Later displacements of the spheres are measured relative to a motion with this velocity, their common drift. A
        poor estimate costs no accuracy: it only makes the lists expire sooner. A sample is therefore enough.
        """
        s, lane = wp.tid()
        if flags[s, STALE] == 0:
            return
        total = wp.vec3d()
        n = wp.int64(scenes.row[s].sphere_count)
        parts = wp.int64(lanes.shape[1])
        first = wp.int32(n * wp.int64(lane) / parts)
        last = wp.int32(n * wp.int64(lane + 1) / parts)
        stride = 1 + (last - first) / SAMPLED
        for i in range(scenes.row[s].spheres + first, scenes.row[s].spheres + last, stride):
            total += wp.vec3d(xyz(spheres.velocity[i]))
        taken = wp.max((last - first + stride - 1) / stride, 1)
        lanes[s, lane] = total * (wp.float64(last - first) / wp.float64(taken))

    @wp.kernel(module=module_of("lists", scalar), enable_backward=False)
    def clear_stale(lanes: wp.array2d(dtype=wp.vec3d), flags: wp.array2d(dtype=wp.int32), scenes: Scenes, walls: Walls):
        """Mark a scene's new lists as valid and let the scene continue, with one thread per scene.

        The scene stays halted if it has failed, has reached its last step, or waits for an estimate of its stable step.
        The kernel also stores the mean velocity of the scene's spheres, and sets the time and the wall displacements
        since the rebuild to zero.
        """
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
        if flags[s, FAILED] == 0:
            flags[s, HALTED] = wp.where(arrived(flags, scenes, s), ARRIVED, 0)

    return SimpleNamespace(centres=centres, stretch=stretch, starts=starts, drift=drift, clear_stale=clear_stale)
