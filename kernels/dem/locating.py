"""Kernels that find pairs with stiff bonds, and their bodies, in the arrays of a batch after a list rebuild."""

import functools
from types import SimpleNamespace

import warp as wp

from .bond_parallel import HYDRATED, bond_with, kind_of, load_row
from .search import find_function
from .structs import array_structs, subcycled_struct


@functools.cache
def locating_kernels(scalar, half: bool, history: bool) -> SimpleNamespace:
    """Return the kernels ``index_spheres``, ``index_bodies``, ``locate_pairs`` and ``locate_bodies``.

    ``index_spheres`` and ``index_bodies`` store the current array index for each permanent number of a sphere or body.
    After a list rebuild, ``locate_pairs`` and ``locate_bodies`` use these indices to find the pairs with stiff bonds,
    and the bodies of these pairs. They copy the data of these pairs and bodies to the struct `Subcycled`.
    """
    structs = array_structs(scalar)
    Scenes, Bodies, Spheres, Pairs = structs.Scenes, structs.Bodies, structs.Spheres, structs.Pairs
    Subcycled = subcycled_struct(scalar)
    find = find_function(scalar, half)
    find_own = find_function(scalar, False)

    @wp.kernel(module="unique", enable_backward=False)
    def index_spheres(scenes: Scenes, spheres: Spheres, sphere_place: wp.array(dtype=wp.int32)):
        i = wp.tid()
        sphere_place[scenes.row[spheres.scene[i]].spheres + spheres.id[i]] = i

    @wp.kernel(module="unique", enable_backward=False)
    def index_bodies(scenes: Scenes, bodies: Bodies, subcycled: Subcycled, body_place: wp.array(dtype=wp.int32)):
        b = wp.tid()
        body_place[scenes.row[bodies.scene[b]].bodies + bodies.id[b]] = b
        subcycled.member[b] = 0

    @wp.kernel(module="unique", enable_backward=False)
    def locate_bodies(scenes: Scenes, bodies: Bodies, body_place: wp.array(dtype=wp.int32), subcycled: Subcycled):
        q = wp.tid()
        b = body_place[scenes.row[subcycled.body_scene[q]].bodies + subcycled.body_number[q]]
        subcycled.place[q] = b
        subcycled.member[b] = q + 1
        subcycled.mass[q] = bodies.mass[b]
        subcycled.inertia[q] = bodies.inertia[b]
        subcycled.rounding[q] = bodies.rounding[b]
        subcycled.velocity[q] = bodies.velocity[b]
        subcycled.angular_momentum[q] = bodies.angular_momentum[b]

    @wp.kernel(module="unique", enable_backward=False)
    def locate_pairs(
        scenes: Scenes, spheres: Spheres, pairs: Pairs, sphere_place: wp.array(dtype=wp.int32), subcycled: Subcycled
    ):
        p = wp.tid()
        s = subcycled.pair_scene[p]
        base = scenes.row[s].spheres
        i = sphere_place[base + subcycled.lower[p]]
        j = sphere_place[base + subcycled.higher[p]]
        subcycled.lower_offset[p] = spheres.offset[i]
        subcycled.higher_offset[p] = spheres.offset[j]
        row = scenes.row[s].laws + spheres.material[i] * scenes.row[s].materials
        subcycled.law[p] = row + spheres.material[j]
        # In a full list, every pair has an entry at both of its spheres. In a half list, this is so for a pair whose
        # spheres belong to two CPU threads. Both entries must be kept up to date.
        k = find(pairs, s, base, scenes.row[s].pairs, i, j)
        copy = find_own(pairs, s, base, scenes.row[s].pairs, j, i)
        subcycled.entry[p] = k
        subcycled.copy[p] = wp.where(copy == k, -1, copy)
        subcycled.active[p] = 0
        if k >= 0:  # A pair that is missing in the new list has no bond any more, so nothing is copied for it.
            bond = pairs.bond[k]
            subcycled.active[p] = wp.where(kind_of(bond) == HYDRATED, 1, 0)
            subcycled.held.bond[p] = bond
            if bond > 0:
                subcycled.held.bond[p] = bond_with(kind_of(bond), p)
                subcycled.held.load[p] = pairs.load[scenes.row[s].loads + load_row(bond)]
            if wp.static(history):
                subcycled.held.history[p] = pairs.history[k]

    return SimpleNamespace(
        index_spheres=index_spheres, index_bodies=index_bodies, locate_pairs=locate_pairs, locate_bodies=locate_bodies
    )
