"""Preconditioner of the viscous solve with aggregates: the diagonal blocks of each aggregate."""

import functools

import warp as wp

from ..common.control import HALTED
from ..mps.grid.cells import DT, GridKind, grid_parameters_struct, grid_structs
from ..mps.grid.levels import system_structs
from ..mps.structs import mps_types, row_place
from .bodies import body_functions, body_structs
from .pairs import pair_functions, pair_struct


@functools.cache
def block_kernel(scalar, serial: bool, of: GridKind):
    """Build the kernel that inverts the blocks of the reduced matrix P^T A P of each aggregate.

    An aggregate has one block for its velocity and one for its spin. They precondition the conjugate gradients; the
    coupling of velocity and spin is left out. The kernel runs with one task per aggregate.
    """
    t = mps_types(scalar, 3)
    vec = t.vec
    Grid = grid_parameters_struct(scalar, 3)
    structs = body_structs(scalar)
    Bodies, Cover = structs.Bodies, structs.Cover
    Matrix = system_structs(scalar).Matrix
    Fields = grid_structs(scalar, 3).Fields
    Pairs, resistance_block = pair_struct(scalar), pair_functions(scalar, of).resistance_block
    f = body_functions(scalar, of)
    entry = row_place(serial)

    @wp.func
    def unit(axis: wp.int32) -> vec:
        e = vec()
        e[axis] = scalar(1.0)
        return e

    @wp.kernel(enable_backward=False, module="unique")
    def blocks(
        g: Grid,
        flags: wp.array(dtype=wp.int32),
        matrix: Matrix,
        mesh: Fields,
        cover: Cover,
        pairs: Pairs,
        bodies: Bodies,
    ):
        if flags[HALTED] != 0:
            return
        b = wp.tid()
        dt = scalar(mesh.clock[DT])
        whole = bodies.extra_mass[b] / dt * wp.identity(n=3, dtype=scalar) + resistance_block(pairs, b)
        round = bodies.extra_inertia[b] / dt * wp.identity(n=3, dtype=scalar)
        for k in range(cover.count[b]):
            r = cover.faces[cover.first[b] + k]
            axis = r / g.slots
            e = unit(axis)
            turned = wp.cross(f.lever(g, bodies, b, r), e)
            whole += matrix.diagonal[r] * wp.outer(e, e)
            round += matrix.diagonal[r] * wp.outer(turned, turned)
            for n in range(matrix.near_count[r]):
                place = entry(r, n, matrix.rows, matrix.near_capacity)
                o = matrix.near[place]
                if cover.owner[o] == b + 1:
                    other = unit(o / g.slots)
                    whole -= matrix.coefficient[place] * wp.outer(e, other)
                    round -= matrix.coefficient[place] * wp.outer(turned, wp.cross(f.lever(g, bodies, b, o), other))
        bodies.mobility[b] = wp.inverse(whole)
        bodies.spin_mobility[b] = wp.inverse(round)

    return blocks
