"""Kernels that create a GPU's links, one for each pair of spheres, after each rebuild of its neighbour lists.

The lists contain every pair twice, once at each sphere. A link represents the pair once, so that one thread can compute
its contact.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.control import STALE
from ..common.types import types
from .pairs import BLOCK, decode
from .structs import APART, TOUCHING, array_structs, links_struct

EXTRA_MASKS: int = wp.constant(4)
"""Number of additional bit masks per sphere. Each bit tells if the pair of a list entry touches. The bits of a sphere's
first BLOCK list entries are in `spheres.touching`, and the bits of later entries are in the additional masks."""
MASKED_ENTRIES: int = wp.constant((int(EXTRA_MASKS) + 1) * int(BLOCK))
"""Number of leading entries of a list row for which a bit mask records whether the pair touches.

The row of a sphere lists its neighbours. A row with more entries is rare, because even a large sphere among small
spheres has only about a hundred neighbours.
"""


@functools.cache
def mark_function(scalar):
    """Return `mark_touching`, which sets or clears the bit that tells if the pair of a list entry touches.

    `place` is the position of the entry in the sphere's row of the neighbour list.
    """
    Spheres, Links = array_structs(scalar).Spheres, links_struct(scalar)

    @wp.func
    def mark_touching(spheres: Spheres, links: Links, i: wp.int32, place: wp.int32, touches: wp.bool):
        bit = 1 << (place % BLOCK)
        if place < BLOCK:
            if touches:
                wp.atomic_or(spheres.touching, i, bit)
            else:
                wp.atomic_and(spheres.touching, i, ~bit)
        elif place < MASKED_ENTRIES:
            at = EXTRA_MASKS * i + place / BLOCK - 1
            if touches:
                wp.atomic_or(links.later_touching, at, bit)
            else:
                wp.atomic_and(links.later_touching, at, ~bit)

    return mark_touching


@functools.cache
def linking_kernels(scalar, history: bool, rolls: bool, bonds: bool, rows: int, lanes: int) -> SimpleNamespace:
    """Return the kernels that create the links when neighbour lists are rebuilt.

    A link represents both list entries of a pair of spheres, so that a GPU evaluates each pair once.
    ``clear_links`` marks all links as unused, with one thread per link. ``count_own`` counts the links of each sphere,
    with one thread per sphere. ``fill_links`` writes the links; `lanes` threads share the list entries of a sphere.
    `rows` is the number of rows in which a link stores its forces.
    """
    t = types(scalar)
    structs = array_structs(scalar)
    Scenes, Spheres, Pairs = structs.Scenes, structs.Spheres, structs.Pairs
    Links = links_struct(scalar)
    mark_touching = mark_function(scalar)

    @wp.kernel(module="unique", enable_backward=False)
    def clear_links(flags: wp.array2d(dtype=wp.int32), links: Links):
        p = wp.tid()
        if flags[links.scene[p], STALE] != 0:
            links.link[p] = wp.vec4i(-1, -1, -1, -1)

    @wp.kernel(module="unique", enable_backward=False)
    def count_own(
        flags: wp.array2d(dtype=wp.int32), scenes: Scenes, pairs: Pairs, count: wp.array(dtype=wp.int32),
        spheres: Spheres, links: Links,
    ):  # fmt: skip
        """Count, for each sphere, the pairs of its neighbour list in which it has the lower permanent number.

        If the scene's lists are being rebuilt, also clear the bits that mark touching pairs.
        """
        i = wp.tid()
        s = spheres.scene[i]
        own = wp.int32(0)
        row = scenes.row[s].pairs
        for k in range(row + pairs.start[i + s], row + pairs.start[i + s + 1]):
            if pairs.other[k] >= 0:
                own += 1
        count[i + s] = own
        if flags[s, STALE] != 0:
            spheres.touching[i] = 0
            for word in range(EXTRA_MASKS):
                links.later_touching[EXTRA_MASKS * i + word] = 0

    @wp.func
    def twin_of(pairs: Pairs, begin: wp.int32, end: wp.int32, i: wp.int32):
        """Return the list entry, from `begin` to `end` - 1, whose neighbour is sphere i.

        The entries of this range belong to one sphere and are sorted by the index of the neighbour. A binary search
        therefore finds the entry.
        """
        low = begin
        high = end - 1
        while low < high:
            middle = (low + high) / 2
            if decode(pairs.other[middle]) < i:
                low = middle + 1
            else:
                high = middle
        return low

    @wp.kernel(module="unique", enable_backward=False)
    def fill_links(
        flags: wp.array2d(dtype=wp.int32), scenes: Scenes, pairs: Pairs, scanned: wp.array(dtype=wp.int32),
        spheres: Spheres, links: Links,
    ):  # fmt: skip
        """Create one link for each listed pair, at the list entry of the sphere with the lower permanent number.

        A link stands for the pair when the GPU computes contact forces. The pair's bond is also copied to the list
        entry of the other sphere. A link with contact history or a bond counts as touching until a time step checks it.
        """
        i = wp.tid() / lanes
        s = spheres.scene[i]
        if flags[s, STALE] == 0:
            return
        base = scenes.row[s].spheres
        row = scenes.row[s].pairs
        first = row / 2 + scanned[i + s] - scanned[base + s]
        for k in range(pairs.start[i + s] + wp.tid() % lanes, pairs.start[i + s + 1], lanes):
            j = pairs.other[row + k]
            if j >= 0:
                p = first
                for earlier in range(pairs.start[i + s], k):
                    p += wp.where(pairs.other[row + earlier] >= 0, 1, 0)
                begin = pairs.start[base + j + s]
                twin = twin_of(pairs, row + begin, row + pairs.start[base + j + s + 1], i - base) - row
                remembers = wp.bool(False)
                if wp.static(history):
                    remembers = wp.length_sq(pairs.history[row + k]) > scalar(0.0)
                if wp.static(rolls):
                    remembers = remembers or wp.length_sq(pairs.rolling[row + k]) > scalar(0.0)
                if wp.static(bonds):
                    remembers = remembers or pairs.bond[row + k] != 0
                    if pairs.bond[row + k] > 0:
                        # Both list entries of a pair share one row of `pairs.load`, which stores the force and the
                        # moment of its bond.
                        pairs.bond[row + twin] = pairs.bond[row + k]
                links.link[p] = wp.vec4i(i - base, j, k, twin)
                links.state[p] = wp.where(remembers, TOUCHING, APART)
                links.end[row + k] = p - row / 2
                links.end[row + twin] = -1 - (p - row / 2)
                # Only the first MASKED_ENTRIES list entries of a sphere have a bit that tells whether the pair touches.
                # Every step adds the results of later entries without a check, so the results of these links must start
                # at zero.
                if k - pairs.start[i + s] >= MASKED_ENTRIES or twin - begin >= MASKED_ENTRIES:
                    for each in range(rows):
                        links.result[rows * p + each] = t.vec4()
                if remembers:
                    mark_touching(spheres, links, i, k - pairs.start[i + s], True)
                    mark_touching(spheres, links, base + j, twin - begin, True)

    return SimpleNamespace(clear_links=clear_links, count_own=count_own, fill_links=fill_links)
