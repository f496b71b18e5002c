"""Kernels that re-sort bodies and their spheres in space, for memory locality."""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.types import module_of, types
from .structs import array_structs, scene_struct


@functools.cache
def permute_kernels(scalar) -> dict[tuple[type, bool], wp.Kernel]:
    """Return the kernels that permute the rows of arrays: target[i] = source[order[i]].

    The result is a dictionary. Its keys consist of the data type of the array, and True for two-dimensional or False
    for one-dimensional arrays.
    """
    t = types(scalar)
    module = module_of("permuting", scalar)

    def permute(dtype):
        @wp.kernel(name=f"permute_{dtype.__name__}", module=module, enable_backward=False)
        def permute(source: wp.array(dtype=dtype), order: wp.array(dtype=wp.int32), target: wp.array(dtype=dtype)):
            i = wp.tid()
            target[i] = source[order[i]]

        return permute

    def permute_rows(dtype):
        @wp.kernel(name=f"permute_rows_{dtype.__name__}", module=module, enable_backward=False)
        def permute_rows(
            source: wp.array2d(dtype=dtype), order: wp.array(dtype=wp.int32), target: wp.array2d(dtype=dtype)
        ):
            i, c = wp.tid()
            target[i, c] = source[order[i], c]

        return permute_rows

    found = {(dtype, False): permute(dtype) for dtype in (
        wp.int32, wp.float64, wp.vec2i, *{scalar} - {wp.float64}, t.vec3, t.vec4, t.quat,
    )}  # fmt: skip
    rows = dict.fromkeys((wp.int32, scalar, t.vec3, wp.vec3d))
    return found | {(dtype, True): permute_rows(dtype) for dtype in rows}


@functools.cache
def order_kernels(scalar) -> SimpleNamespace:
    """Return the kernels that sort bodies and their spheres by position, for memory locality.

    ``corner`` finds each scene's lowest cell, ``keys`` computes the sort keys, ``counts`` and ``place_spheres`` move
    the spheres with their bodies, and ``invert`` inverts a permutation. Each scene keeps its range of rows in the
    arrays of the batch. If `sort[s]` is 1, the bodies of scene s are ordered by the Morton code of their cell.
    Otherwise they keep their order.
    """
    t = types(scalar)
    structs = array_structs(scalar)
    Scenes, Bodies, Spheres = structs.Scenes, structs.Bodies, structs.Spheres
    SceneRow = scene_struct(scalar)

    @wp.func
    def cell_of(scene: SceneRow, x: t.vec3, c: wp.int32):
        return wp.int32(wp.floor(x[c] / (scalar(2.0) * scene.largest_radius + scene.skin)))

    @wp.kernel(module=module_of("sorting", scalar), enable_backward=False)
    def corner(scenes: Scenes, bodies: Bodies, lowest: wp.array2d(dtype=wp.int32)):
        """Find the lowest cell index along each axis among the bodies of each scene."""
        b = wp.tid()
        s = bodies.scene[b]
        for c in range(3):
            index = cell_of(scenes.row[s], bodies.position[b], c)
            if index < lowest[s, c]:
                wp.atomic_min(lowest, s, c, index)

    @wp.kernel(module=module_of("sorting", scalar), enable_backward=False)
    def keys(
        # The next arguments are arrays of the simulated state that this kernel only reads.
        scenes: Scenes,
        bodies: Bodies,
        sort: wp.array(dtype=wp.int32),
        lowest: wp.array2d(dtype=wp.int32),
        # The next arguments are arrays that this kernel writes.
        key: wp.array(dtype=wp.int64),
        value: wp.array(dtype=wp.int32),
    ):
        """Compute the key by which each body is sorted: first the scene, then the Morton code of the body's cell.

        Cell indices are counted from the scene's lowest cell. The code uses 10 bits of the index along each axis, so
        larger indices wrap around.
        """
        b = wp.tid()
        s = bodies.scene[b]
        code = wp.int32(0)
        if sort[s] != 0:
            for c in range(3):
                index = (cell_of(scenes.row[s], bodies.position[b], c) - lowest[s, c]) & 1023
                for bit in range(10):
                    code = code | (((index >> bit) & 1) << (3 * bit + c))
        else:
            code = b - scenes.row[s].bodies
        key[b] = (wp.int64(s) << wp.int64(30)) | wp.int64(code)
        value[b] = b

    @wp.kernel(module=module_of("sorting", scalar), enable_backward=False)
    def counts(bodies: Bodies, order: wp.array(dtype=wp.int32), count: wp.array(dtype=wp.int32)):
        """Count the spheres of the body that moves to index i of the sorted order."""
        i = wp.tid()
        s = bodies.scene[i]
        count[i] = bodies.first[order[i] + s + 1] - bodies.first[order[i] + s]

    @wp.kernel(module=module_of("sorting", scalar), enable_backward=False)
    def place_spheres(
        # The next arguments are arrays that this kernel only reads.
        scenes: Scenes,
        order: wp.array(dtype=wp.int32),
        old_first: wp.array(dtype=wp.int32),
        new_start: wp.array(dtype=wp.int32),
        # The next arguments are arrays that this kernel writes.
        bodies: Bodies,
        spheres: Spheres,
        old_place: wp.array(dtype=wp.int32),
    ):
        """Compute the old index of the sphere at each new index; update `spheres.body` and `bodies.first`."""
        i = wp.tid()
        s = bodies.scene[i]
        base = scenes.row[s].spheres
        for c in range(new_start[i + 1] - new_start[i]):
            old_place[new_start[i] + c] = base + old_first[order[i] + s] + c
            spheres.body[new_start[i] + c] = i - scenes.row[s].bodies
        bodies.first[i + s] = new_start[i] - base
        if i + 1 == scenes.row[s].bodies + scenes.row[s].body_count:
            bodies.first[i + s + 1] = new_start[i + 1] - base

    @wp.kernel(module=module_of("sorting", scalar), enable_backward=False)
    def invert(order: wp.array(dtype=wp.int32), inverse: wp.array(dtype=wp.int32)):
        """Compute the inverse permutation, inverse[order[i]] = i."""
        i = wp.tid()
        inverse[order[i]] = i

    return SimpleNamespace(corner=corner, keys=keys, counts=counts, place_spheres=place_spheres, invert=invert)
