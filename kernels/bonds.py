"""Making bonds at existing contacts, and giving some of them other properties."""

import functools

import warp as wp

from .contacts import decode
from .types import types, vector_functions


@functools.cache
def bond_kernels(scalar):
    """Kernels ``make`` (bond contacts within a gap) and ``reassign`` (a random share to another kind)."""
    t = types(scalar)
    xyz = vector_functions(scalar).xyz

    @wp.kernel(module="unique", enable_backward=False)
    def make(
        kind: wp.int32,
        gap: scalar,
        group: wp.int32,
        sphere_position: wp.array(dtype=t.vec4),
        sphere_body: wp.array(dtype=wp.int32),
        body_group: wp.array(dtype=wp.int32),
        pair_start: wp.array(dtype=wp.int32),
        pair_other: wp.array(dtype=wp.int32),
        pair_bond: wp.array(dtype=wp.int32),
        pair_bond_force: wp.array(dtype=t.vec4),
        pair_bond_moment: wp.array(dtype=t.vec4),
    ):
        """Bonds, without load, pairs not bonded yet; with a `group` only pairs inside it, else (-1) any."""
        i = wp.tid()
        for k in range(pair_start[i], pair_start[i + 1]):
            j = decode(pair_other[k])
            inside = group < 0 or (body_group[sphere_body[i]] == group and body_group[sphere_body[j]] == group)
            if inside and pair_bond[k] <= 0:
                reach = sphere_position[i][3] + sphere_position[j][3] + gap
                if wp.length_sq(xyz(sphere_position[j]) - xyz(sphere_position[i])) <= reach * reach:
                    pair_bond[k] = kind
                    pair_bond_force[k] = t.vec4()
                    pair_bond_moment[k] = t.vec4()

    @wp.kernel(module="unique", enable_backward=False)
    def reassign(
        old_kind: wp.int32,
        new_kind: wp.int32,
        share: wp.float64,
        seed: wp.uint32,
        sphere_id: wp.array(dtype=wp.int32),
        pair_start: wp.array(dtype=wp.int32),
        pair_other: wp.array(dtype=wp.int32),
        pair_bond: wp.array(dtype=wp.int32),
    ):
        """The draw depends on seed and permanent numbers only: the same on every device and in any order."""
        i = wp.tid()
        for k in range(pair_start[i], pair_start[i + 1]):
            if pair_bond[k] == old_kind:
                a = sphere_id[i]
                b = sphere_id[decode(pair_other[k])]
                random = wp.rand_init(wp.int32(seed), wp.min(a, b))
                random = wp.rand_init(wp.int32(random), wp.max(a, b))
                if wp.float64(wp.randf(random)) < share:
                    pair_bond[k] = new_kind

    return make, reassign
