"""Verlet lists on Warp's hash grid, history carried over exactly, and spatial re-sorting."""

import functools
from types import SimpleNamespace

import warp as wp

from .contacts import decode
from .types import types, vector_functions


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


@wp.kernel(enable_backward=False)
def body_sphere_counts(
    order: wp.array(dtype=wp.int32), first: wp.array(dtype=wp.int32), count: wp.array(dtype=wp.int32)
):
    """Spheres of the body that comes to place i."""
    i = wp.tid()
    count[i] = first[order[i] + 1] - first[order[i]]


@wp.kernel(enable_backward=False)
def sphere_order(
    order: wp.array(dtype=wp.int32),
    old_first: wp.array(dtype=wp.int32),
    new_first: wp.array(dtype=wp.int32),
    spheres: wp.array(dtype=wp.int32),
    sphere_body: wp.array(dtype=wp.int32),
):
    """Old places of the spheres in their new order, and their bodies' new places."""
    i = wp.tid()
    for c in range(new_first[i + 1] - new_first[i]):
        spheres[new_first[i] + c] = old_first[order[i]] + c
        sphere_body[new_first[i] + c] = i


@functools.cache
def neighbor_kernels(scalar, half: bool, history: bool, bonds: bool):
    """Kernels of one list layout: ``centres``, ``count``, ``fill``, ``cell_keys``.

    In the half list the larger sphere of a pair holds it (the lower place of two equal ones), so a search
    reaches no farther than its own diameter.
    """
    t = types(scalar)
    xyz = vector_functions(scalar).xyz

    @wp.kernel(module="unique", enable_backward=False)
    def centres(
        sphere_position: wp.array(dtype=t.vec4),
        sphere_centre: wp.array(dtype=t.vec3),
        sphere_built: wp.array(dtype=t.vec4),
    ):
        i = wp.tid()
        sphere_centre[i] = xyz(sphere_position[i])
        sphere_built[i] = sphere_position[i]

    @wp.kernel(module="unique", enable_backward=False)
    def cell_keys(
        body_position: wp.array(dtype=t.vec3),
        cell: scalar,
        keys: wp.array(dtype=wp.int32),
        values: wp.array(dtype=wp.int32),
    ):
        """Morton code of the body's cell, 10 bits a direction, wrapping beyond 1024 cells."""
        b = wp.tid()
        x = body_position[b]
        key = wp.int32(0)
        for c in range(3):
            index = wp.int32(wp.floor(x[c] / cell)) & 1023
            for bit in range(10):
                key = key | (((index >> bit) & 1) << (3 * bit + c))
        keys[b] = key
        values[b] = b

    @wp.func
    def holds(i: wp.int32, j: wp.int32, radius_i: scalar, radius_j: scalar):
        if wp.static(half):
            return radius_j < radius_i or (radius_j == radius_i and j > i)
        return i != j

    @wp.func
    def find(start: wp.array(dtype=wp.int32), other: wp.array(dtype=wp.int32), i: wp.int32, j: wp.int32):
        """Place of the pair in the old list, or -1. A half list may hold it at either sphere."""
        for k in range(start[i], start[i + 1]):
            if decode(other[k]) == j:
                return k
        if wp.static(half):
            for k in range(start[j], start[j + 1]):
                if decode(other[k]) == i:
                    return k
        return wp.int32(-1)

    def build(fill: bool):
        @wp.kernel(module="unique", enable_backward=False)
        def pairs(
            grid: wp.uint64,
            sphere_position: wp.array(dtype=t.vec4),
            sphere_body: wp.array(dtype=wp.int32),
            sphere_id: wp.array(dtype=wp.int32),
            largest_radius: scalar,
            skin: scalar,
            old_place: wp.array(dtype=wp.int32),
            new_place: wp.array(dtype=wp.int32),
            old_start: wp.array(dtype=wp.int32),
            old_other: wp.array(dtype=wp.int32),
            old_history: wp.array(dtype=t.vec3),
            old_bond: wp.array(dtype=wp.int32),
            old_bond_force: wp.array(dtype=t.vec4),
            old_bond_moment: wp.array(dtype=t.vec4),
            start: wp.array(dtype=wp.int32),
            count: wp.array(dtype=wp.int32),
            other: wp.array(dtype=wp.int32),
            pair_history: wp.array(dtype=t.vec3),
            bond: wp.array(dtype=wp.int32),
            bond_force: wp.array(dtype=t.vec4),
            bond_moment: wp.array(dtype=t.vec4),
        ):
            i = wp.tid()
            x = xyz(sphere_position[i])
            radius = sphere_position[i][3]
            body = sphere_body[i]
            old_i = old_place[i]
            reach = radius + largest_radius + skin
            if wp.static(half):
                reach = radius + radius + skin
            found = wp.int32(0)
            query = wp.hash_grid_query(grid, x, reach)
            j = wp.int32(0)
            while wp.hash_grid_query_next(query, j):
                position_j = sphere_position[j]
                if holds(i, j, radius, position_j[3]) and sphere_body[j] != body:
                    limit = radius + position_j[3] + skin
                    if wp.length_sq(xyz(position_j) - x) < limit * limit:
                        if wp.static(fill):
                            k = start[i] + found
                            if sphere_id[j] > sphere_id[i]:
                                other[k] = j
                            else:
                                other[k] = -1 - j
                            if wp.static(history or bonds):
                                old = find(old_start, old_other, old_i, old_place[j])
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
                        found += 1
            if wp.static(bonds):
                # Bonds that hold across a gap wider than the skin stay in the list.
                for old in range(old_start[old_i], old_start[old_i + 1]):
                    if old_bond[old] > 0:
                        j = new_place[decode(old_other[old])]
                        position_j = sphere_position[j]
                        limit = radius + position_j[3] + skin
                        if wp.length_sq(xyz(position_j) - x) >= limit * limit:
                            if wp.static(fill):
                                k = start[i] + found
                                if sphere_id[j] > sphere_id[i]:
                                    other[k] = j
                                else:
                                    other[k] = -1 - j
                                if wp.static(history):
                                    pair_history[k] = old_history[old]
                                bond[k] = old_bond[old]
                                bond_force[k] = old_bond_force[old]
                                bond_moment[k] = old_bond_moment[old]
                            found += 1
            if not wp.static(fill):
                count[i] = found

        return pairs

    return SimpleNamespace(centres=centres, cell_keys=cell_keys, count=build(False), fill=build(True))
