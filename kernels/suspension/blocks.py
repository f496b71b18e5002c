"""Preconditioner of the viscous solve with aggregates: inverses of the diagonal blocks of each aggregate."""

import functools

import warp as wp

from ..common.control import HALTED
from ..mps.coarse import lane_sum, lanes
from ..mps.grid.cells import DT, GridKind, grid_parameters_struct, grid_structs
from ..mps.grid.levels import system_structs
from ..mps.structs import mps_types, row_place
from .bodies import BodyKind, body_functions, body_structs, shape_functions
from .pairs import pair_functions, pair_struct
from .vectors import share_of_body


@functools.cache
def block_kernel(scalar, serial: bool, of: GridKind, kind: BodyKind):
    """Build the kernel that inverts the 3 x 3 diagonal blocks of each aggregate in the reduced viscous matrix.

    The reduced matrix is P^T A P, with the viscous matrix A of all faces and the matrix P of rigid motions, see
    `bodies.py`. An aggregate has one block for its velocity and one for its spin. The inverses precondition the
    conjugate gradients, without the coupling of velocity and spin. The kernel also computes `resistance`, which the
    preconditioner of the coupled solve needs. The tasks of the kernel work on the aggregates, which
    :func:`share_of_body` distributes.
    """
    t = mps_types(scalar, 3)
    vec, mat = t.vec, t.mat
    all_lanes, all_lanes_of_scalar = lane_sum(vec), lane_sum(scalar)
    Grid = grid_parameters_struct(scalar, 3)
    structs = body_structs(scalar)
    Bodies, Cover = structs.Bodies, structs.Cover
    Matrix = system_structs(scalar).Matrix
    Fields = grid_structs(scalar, 3).Fields
    Pairs, pair_blocks = pair_struct(scalar), pair_functions(scalar, kind).blocks
    inertia = shape_functions(scalar, kind).inertia
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
        b, lane = share_of_body(wp.tid(), 0)
        whole = mat()
        round = mat()
        viscous = scalar(0.0)
        dt = scalar(mesh.clock[DT])
        if lane == 0:
            resisting, turning = pair_blocks(bodies, pairs, b)
            whole = bodies.extra_mass[b] / dt * wp.identity(n=3, dtype=scalar) + resisting
            round = inertia(bodies, b) / dt * wp.identity(n=3, dtype=scalar) + turning
        for k in range(lane, cover.count[b], lanes()):
            r = cover.faces[cover.first[b] + k]
            axis = r / g.slots
            e = unit(axis)
            turned = wp.cross(f.lever(g, bodies, b, r), e)
            viscous += matrix.diagonal[r] - g.density * mesh.volume[r] / dt
            whole += matrix.diagonal[r] * wp.outer(e, e)
            round += matrix.diagonal[r] * wp.outer(turned, turned)
            for n in range(matrix.near_count[r]):
                place = entry(r, n, matrix.rows, matrix.near_capacity)
                o = matrix.near[place]
                if cover.owner[o] == b + 1:
                    other = unit(o / g.slots)
                    if o / g.slots == axis:
                        viscous -= matrix.coefficient[place]
                    whole -= matrix.coefficient[place] * wp.outer(e, other)
                    round -= matrix.coefficient[place] * wp.outer(turned, wp.cross(f.lever(g, bodies, b, o), other))
        for axis in range(3):
            whole[axis] = all_lanes(whole[axis])
            round[axis] = all_lanes(round[axis])
        viscous = all_lanes_of_scalar(viscous)
        if lane == 0:
            bodies.resistance[b] = wp.max(viscous, scalar(0.0)) / scalar(wp.max(cover.count[b], 1))
            bodies.mobility[b] = wp.inverse(whole)
            bodies.spin_mobility[b] = wp.inverse(round)

    return blocks
