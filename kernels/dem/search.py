"""Functions that `half_search` (CPU) and `full_search` (GPU) share, and a function that finds a pair in a list."""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.rows import row_functions
from ..common.types import types, vector_functions
from .pairs import decode
from .structs import array_structs

SQUARE_APART = """
#if defined(__CUDA_ARCH__)
    const SCALAR x = SUB(a[0], b[0]), y = SUB(a[1], b[1]), z = SUB(a[2], b[2]);
    return ADD(ADD(MUL(x, x), MUL(y, y)), MUL(z, z));
#else
    return wp::length_sq(a - b);
#endif
"""
"""C++ source of a function that returns the squared distance between two points.

On a GPU it uses intrinsics that are never fused to multiply-add instructions, so that the result is rounded the same
way in every kernel.
"""


@functools.cache
def find_function(scalar, half: bool):
    """Return the function `find`, which finds the entry of a pair of spheres in the neighbour list.

    A full list contains each pair twice, once in the row of each sphere. If `half` is true, the list contains each pair
    only once, in the row of one of the two spheres, so `find` searches both rows.
    """
    Pairs = array_structs(scalar).Pairs
    read_int = row_functions(scalar).read_int

    @wp.func
    def find(pairs: Pairs, s: wp.int32, base: wp.int32, first: wp.int32, i: wp.int32, j: wp.int32):
        """Return the list entry of the pair of spheres i and j, or -1 if the list lacks the pair.

        `base` is the index of the scene's first sphere, and `first` is the index of the scene's first list entry.
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


@functools.cache
def close_function(scalar):
    """Return the function `is_close`, which returns true if the gap between two spheres is below a limit.

    On a GPU, all kernels that call the function round in the same way and get the same answer. A bonded pair whose gap
    equals the skin is therefore neither lost nor listed twice.
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
    """Return functions that decide where to search for neighbours and which spheres are neighbours.

    They are `query_of`, `padded_reach`, `is_neighbour` and `bonded_beyond_skin`. Pairs whose bond spans a gap wider
    than the skin need special treatment. For half lists, a wider search in the grid finds them. For full lists, they
    are taken from the old list with the function `bonded_beyond_skin`.
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
        """Return `reach` plus a margin for rounding errors of positions, which could otherwise hide a neighbour."""
        return reach + scalar(wp.static(rounding)) * wp.max(wp.abs(middle))

    @wp.func
    def is_neighbour(
        scenes: Scenes, spheres: Spheres, old_pairs: Pairs, old_place: wp.array(dtype=wp.int32),
        stretched: wp.array(dtype=scalar), query: Query, i: wp.int32, j: wp.int32, position_j: t.vec4,
    ) -> wp.bool:  # fmt: skip
        """Return True if spheres i and j belong in the neighbour list as a pair.

        They must belong to different bodies of one scene, and the gap between them must be smaller than the skin, which
        is the margin of the lists. In half lists, which contain most pairs once, a bond between the spheres also
        suffices.
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
        """Return the other sphere of an old list entry if the bond of the pair spans a gap wider than the skin.

        The result is the index of that sphere in the new order of the spheres. It is -1 if the pair has no such bond.
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
