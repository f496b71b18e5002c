"""What a GPU evaluates for each pair of its lists (`links`), found anew with the lists."""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.control import STALE
from ..common.types import types
from .pairs import BLOCK, decode
from .structs import array_structs, links_struct

MORE = wp.constant(4)
"""Numbers with bits for those entries of a sphere's row that come after the first BLOCK."""
BITS = wp.constant((int(MORE) + 1) * int(BLOCK))
"""Entries of a row of which bits tell whether they touch; a large sphere among small ones has a hundred."""


@functools.cache
def mark_function(scalar):
    """`mark`: notes in a sphere's bits whether the entry at a place of its row touches."""
    Spheres, Links = array_structs(scalar).Spheres, links_struct(scalar)

    @wp.func
    def mark(spheres: Spheres, links: Links, i: wp.int32, place: wp.int32, touches: wp.bool):
        bit = 1 << (place % BLOCK)
        if place < BLOCK:
            if touches:
                wp.atomic_or(spheres.touching, i, bit)
            else:
                wp.atomic_and(spheres.touching, i, ~bit)
        elif place < BITS:
            at = MORE * i + place / BLOCK - 1
            if touches:
                wp.atomic_or(links.more, at, bit)
            else:
                wp.atomic_and(links.more, at, ~bit)

    return mark


@functools.cache
def linking_kernels(scalar, history: bool, rolls: bool, bonds: bool, rows: int, lanes: int):
    """Kernels of a rebuild: ``clear_links`` over links, ``count_own`` over spheres, and ``fill_links``, so many `lanes`
    a sphere, to which its entries fall in turn. A link gives so many `rows`.
    """
    t = types(scalar)
    structs = array_structs(scalar)
    Scenes, Spheres, Pairs = structs.Scenes, structs.Spheres, structs.Pairs
    Links = links_struct(scalar)
    mark = mark_function(scalar)

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
        """Entries of a row that are no twins; none of the row touches yet."""
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
            for word in range(MORE):
                links.more[MORE * i + word] = 0

    @wp.func
    def twin_of(pairs: Pairs, begin: wp.int32, end: wp.int32, i: wp.int32):
        """Entry of a row, in which places ascend, that stands for sphere i of the scene."""
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
        """Links of a row's own entries; one that remembers anything counts as touching until it is looked at. Twins
        are told of the bond of their pair."""
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
                        pairs.bond[row + twin] = pairs.bond[row + k]  # with the same row for the load
                links.link[p] = wp.vec4i(i - base, j, k, twin)
                links.touched[p] = wp.where(remembers, 1, 0)
                links.end[row + k] = p - row / 2
                links.end[row + twin] = -1 - (p - row / 2)
                if k - pairs.start[i + s] >= BITS or twin - begin >= BITS:  # summed, whether it touches or not
                    for each in range(rows):
                        links.pull[rows * p + each] = t.vec4()
                if remembers:
                    mark(spheres, links, i, k - pairs.start[i + s], True)
                    mark(spheres, links, base + j, twin - begin, True)

    return SimpleNamespace(clear_links=clear_links, count_own=count_own, fill_links=fill_links)
