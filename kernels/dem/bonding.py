"""Kernels that create bonds at existing contacts, and that assign other parameters to a random share of the bonds."""

import functools

import warp as wp

from ..common.types import module_of, types, vector_functions
from .bond_parallel import bond_with, kind_of, load_row
from .pairs import decode
from .structs import array_structs


@functools.cache
def bond_kernels(scalar) -> tuple[wp.Kernel, wp.Kernel]:
    """Return the kernels ``make``, which bonds close pairs of spheres, and ``reassign``, which changes kinds of bonds.

    The kind of a bond selects its parameters, such as stiffness and strength. Each launch processes the spheres of one
    scene. The structs passed to it contain the arrays of this scene alone, not the arrays of a batch of scenes.
    """
    structs = array_structs(scalar)
    Bodies, Spheres, Pairs = structs.Bodies, structs.Spheres, structs.Pairs
    xyz = vector_functions(scalar).xyz
    vec8 = types(scalar).vec8

    @wp.kernel(module=module_of("bonding", scalar), enable_backward=False)
    def make(
        kind: wp.int32,
        healing: wp.bool,
        gap: scalar,
        group: wp.int32,
        # The next arguments are arrays of the simulated state that this kernel only reads.
        bodies: Bodies,
        spheres: Spheres,
        # The next arguments are arrays of the simulated state that this kernel reads and writes.
        pairs: Pairs,
    ):
        """Bond all pairs that have no intact bond and whose surfaces are at most `gap` apart.

        If `group` is not negative, only pairs inside this group are bonded: the bodies of both spheres must belong to
        it. The array `pairs.load` stores the force and moment of each bond. If bonds can form again during the run
        (`healing`), this array has a row for each list entry, and this kernel sets the rows of new bonds to zero.
        Otherwise the caller assigns rows to the new bonds later.
        """
        i = wp.tid()
        for k in range(pairs.start[i], pairs.start[i + 1]):
            j = decode(pairs.other[k])
            inside = group < 0 or (bodies.group[spheres.body[i]] == group and bodies.group[spheres.body[j]] == group)
            if inside and pairs.bond[k] <= 0:
                reach = spheres.position[i][3] + spheres.position[j][3] + gap
                if wp.length_sq(xyz(spheres.position[j]) - xyz(spheres.position[i])) <= reach * reach:
                    pairs.bond[k] = kind
                    if healing:
                        pairs.bond[k] = bond_with(kind, k)
                        pairs.load[k] = vec8()

    @wp.kernel(module=module_of("bonding", scalar), enable_backward=False)
    def reassign(
        old_kind: wp.int32,
        new_kind: wp.int32,
        fraction: wp.float64,
        seed: wp.uint32,
        # The next arguments are arrays of the simulated state that this kernel only reads.
        spheres: Spheres,
        # The next arguments are arrays of the simulated state that this kernel reads and writes.
        pairs: Pairs,
    ):
        """Change each bond of kind `old_kind` to kind `new_kind` with the probability `fraction`.

        The random number depends only on the seed and the permanent numbers of the two spheres. The result is therefore
        the same on every device and in any order of threads.
        """
        i = wp.tid()
        for k in range(pairs.start[i], pairs.start[i + 1]):
            if kind_of(pairs.bond[k]) == old_kind:
                a = spheres.id[i]
                b = spheres.id[decode(pairs.other[k])]
                random = wp.rand_init(wp.int32(seed), wp.min(a, b))
                random = wp.rand_init(wp.int32(random), wp.max(a, b))
                if wp.float64(wp.randf(random)) < fraction:
                    pairs.bond[k] = bond_with(new_kind, load_row(pairs.bond[k]))

    return make, reassign
