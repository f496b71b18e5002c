"""The operators of Xu, Li & Jiang 2021 exactly as printed, for comparison; `operators.py` has the ones normally used.

The printed Laplacian is not calibrated (Eq. 5, reach 4.1 spacings). The pressure has no prediction and follows from the
rate of the number density (Eqs. 4 and 7). The gradient uses the lowest pressure nearby and a factor of 2 (Eq. 18). One
sign is corrected: with Eq. 4 as printed, the pressure pulls crowded particles together, and no run is possible. The
treatment of walls is not the paper's: a point behind a wall has the particle's own pressure, and it has the wall's
velocity in the rate of the number density.
"""

import functools

import warp as wp

from ..common.control import HALTED
from .structs import array_structs, flow_struct, mps_functions, mps_types, row_place, span

LAPLACIAN = 4.1
"""Reach of the printed Laplacian over the initial particle spacing."""


@functools.cache
def weights_kernel(scalar, dimensions: int, serial: bool):
    """Build the kernel that sets the pair weights of the printed Laplacian, and a predicted pressure of zero."""
    f = mps_functions(scalar, dimensions)
    Flow = flow_struct(scalar)
    structs = array_structs(scalar, dimensions)
    Particles, Lists, Fields = structs.Particles, structs.Lists, structs.Fields
    place = row_place(serial)

    @wp.kernel(enable_backward=False, module="unique")
    def weights(
        # The next argument holds the parameters of the flow.
        flow: Flow,
        reach: scalar,
        laplacian_number: scalar,
        # The next arguments are the range of rows that this launch processes.
        first: wp.int32,
        end: wp.int32,
        # The next arguments are the state, which this kernel only reads.
        flags: wp.array(dtype=wp.int32),
        particles: Particles,
        lists: Lists,
        # The next arguments are arrays that this kernel writes.
        fields: Fields,
    ):
        if flags[HALTED] != 0:
            return
        begin = first + wp.tid() * wp.static(span(serial))
        for i in range(begin, wp.min(begin + wp.static(span(serial)), end)):
            for k in range(lists.near_count[i]):
                at = place(i, k, flow.count, lists.near_capacity)
                r = f.distance(flow, particles.position[lists.near[at]] - particles.position[i])
                fields.pair_weight[at] = scalar(0.0)
                if r < reach:
                    fields.pair_weight[at] = (
                        scalar(wp.static(5.0 - dimensions)) / laplacian_number * reach / (r * r * r)
                    )
            # A pair's weight is multiplied by the sum of both particles' factors, here by 1.
            fields.inverse_number[i] = scalar(0.5)
            fields.predicted[i] = scalar(0.0)

    return weights


@functools.cache
def source_kernel(scalar, dimensions: int, serial: bool):
    """Build the kernel that sets up the pressure equation from the rate of the number density (Eqs. 4 and 7)."""
    t = mps_types(scalar, dimensions)
    f = mps_functions(scalar, dimensions)
    Flow = flow_struct(scalar)
    structs = array_structs(scalar, dimensions)
    Particles, Lists, Fields = structs.Particles, structs.Lists, structs.Fields
    Matrix, Solve = structs.Matrix, structs.NumberSolve
    place = row_place(serial)
    last = dimensions - 1

    @wp.kernel(enable_backward=False, module="unique")
    def source(
        # The next argument holds the parameters of the flow.
        flow: Flow,
        # The next arguments are the range of rows that this launch processes.
        first: wp.int32,
        end: wp.int32,
        # The next arguments are the state, which this kernel only reads.
        flags: wp.array(dtype=wp.int32),
        particles: Particles,
        lists: Lists,
        # The next arguments are arrays that this kernel writes.
        fields: Fields,
        matrix: Matrix,
        projection: Solve,
    ):
        if flags[HALTED] != 0:
            return
        begin = first + wp.tid() * wp.static(span(serial))
        for i in range(begin, wp.min(begin + wp.static(span(serial)), end)):
            x = particles.position[i]
            v = particles.velocity[i]
            total = scalar(0.0)
            rate = scalar(0.0)
            for k in range(lists.near_count[i]):
                at = place(i, k, flow.count, lists.near_capacity)
                j = lists.near[at]
                matrix.coefficient[at] = fields.pair_weight[at]
                total += fields.pair_weight[at]
                d = particles.position[j] - x
                r = f.distance(flow, d)
                if r < flow.cutoff:
                    rate -= flow.cutoff / (r * r * r) * wp.dot(d, particles.velocity[j] - v)
            n = f.outward(x)
            for k in range(lists.wall_count[i]):
                y = lists.wall_position[lists.wall[place(i, k, flow.count, lists.wall_capacity)]]
                d = y - x
                r = f.distance(flow, d)
                if r < flow.cutoff:
                    jump = t.vec()
                    if wp.length(f.across(y)) > flow.radius:
                        jump -= wp.dot(v, n) * n
                    if y[last] < scalar(0.0):
                        jump[last] = jump[last] - (v[last] - flow.piston_speed)
                    rate -= flow.cutoff / (r * r * r) * wp.dot(d, jump)
            matrix.diagonal[i] = total
            fields.increment[i] = scalar(0.0)
            projection.residual[i] = flow.density / flow.dt * rate / flow.lattice_number
            if matrix.free[i] != 0:
                projection.residual[i] = scalar(0.0)

    return source


@functools.cache
def projection_kernel(scalar, dimensions: int, serial: bool):
    """Build the kernel that subtracts the printed pressure gradient (Eq. 18) from the velocities.

    The gradient is not exact for linear fields, so the velocities are divergence-free only approximately.
    """
    t = mps_types(scalar, dimensions)
    f = mps_functions(scalar, dimensions)
    Flow = flow_struct(scalar)
    structs = array_structs(scalar, dimensions)
    Particles, Lists, Fields = structs.Particles, structs.Lists, structs.Fields
    place = row_place(serial)

    @wp.kernel(enable_backward=False, module="unique")
    def project(
        # The next argument holds the parameters of the flow.
        flow: Flow,
        # The next arguments are the range of rows that this launch processes.
        first: wp.int32,
        end: wp.int32,
        # The next arguments are the state, which this kernel only reads.
        flags: wp.array(dtype=wp.int32),
        lists: Lists,
        fields: Fields,
        # The next arguments are arrays that this kernel reads and writes.
        particles: Particles,
    ):
        if flags[HALTED] != 0:
            return
        begin = first + wp.tid() * wp.static(span(serial))
        for i in range(begin, wp.min(begin + wp.static(span(serial)), end)):
            x = particles.position[i]
            lowest = fields.increment[i]
            for k in range(lists.near_count[i]):
                j = lists.near[place(i, k, flow.count, lists.near_capacity)]
                if wp.length(particles.position[j] - x) < flow.cutoff:
                    lowest = wp.min(lowest, fields.increment[j])
            slope = t.vec()
            for k in range(lists.near_count[i]):
                j = lists.near[place(i, k, flow.count, lists.near_capacity)]
                d = particles.position[j] - x
                r = f.distance(flow, d)
                if r < flow.cutoff:
                    slope += (f.weight(r, flow.cutoff) * (fields.increment[j] - lowest) / (r * r)) * d
            for k in range(lists.wall_count[i]):
                d = lists.wall_position[lists.wall[place(i, k, flow.count, lists.wall_capacity)]] - x
                r = f.distance(flow, d)
                if r < flow.cutoff:
                    slope += (f.weight(r, flow.cutoff) * (fields.increment[i] - lowest) / (r * r)) * d
            gradient = scalar(wp.static(2.0 * dimensions)) / flow.lattice_number * slope
            particles.velocity[i] = particles.velocity[i] - (flow.dt / flow.density) * gradient
            particles.pressure[i] = fields.increment[i]

    return project
