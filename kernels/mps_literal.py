"""The operators of Xu, Li & Jiang 2021 as they are printed, to show what they do; `mps_operators.py` has ours.

Laplacian without calibration (Eq. 5, reach 4.1 spacings), pressure without prediction from the number density's rate
(Eqs. 4 and 7), gradient from the lowest pressure around with a factor of 2 (Eq. 18). One sign is mended: as printed,
Eq. 4 gives a pressure that pulls crowded particles closer, and nothing can be run. Walls are ours: what lies behind
them has the particle's own pressure, and in the rate of number density the wall's velocity.
"""

import functools

import warp as wp

from .mps_types import HALTED, fluid_struct, mps_functions, mps_types, row_place, span

LAPLACIAN = 4.1
"""Reach over the spacing."""


@functools.cache
def literal_kernels(scalar, dimensions: int, serial: bool):
    """`weights` after geometry, `source` before the pressure's solve, `project` after it."""
    t = mps_types(scalar, dimensions)
    f = mps_functions(scalar, dimensions)
    Flow = fluid_struct(scalar)
    place = row_place(serial)
    last = dimensions - 1

    @wp.kernel(enable_backward=False, module="unique")
    def weights(
        flow: Flow,
        first: wp.int32,
        end: wp.int32,
        near_capacity: wp.int32,
        flags: wp.array(dtype=wp.int32),
        near_count: wp.array(dtype=wp.int32),
        near: wp.array(dtype=wp.int32),
        reach: scalar,
        laplacian_number: scalar,
        position: wp.array(dtype=t.vec),
        pair_weight: wp.array(dtype=scalar),
        inverse_number: wp.array(dtype=scalar),
        predicted: wp.array(dtype=scalar),
    ):
        if flags[HALTED] != 0:
            return
        begin = first + wp.tid() * wp.static(span(serial))
        for i in range(begin, wp.min(begin + wp.static(span(serial)), end)):
            for k in range(near_count[i]):
                at = place(i, k, flow.count, near_capacity)
                r = wp.max(wp.length(position[near[at]] - position[i]), scalar(1.0e-3) * flow.spacing)
                pair_weight[at] = scalar(0.0)
                if r < reach:
                    pair_weight[at] = scalar(wp.static(5.0 - dimensions)) / laplacian_number * reach / (r * r * r)
            inverse_number[i] = scalar(0.5)  # of a pair's two, which then leave its weight as it is
            predicted[i] = scalar(0.0)

    @wp.kernel(enable_backward=False, module="unique")
    def source(
        flow: Flow,
        first: wp.int32,
        end: wp.int32,
        near_capacity: wp.int32,
        wall_capacity: wp.int32,
        flags: wp.array(dtype=wp.int32),
        near_count: wp.array(dtype=wp.int32),
        near: wp.array(dtype=wp.int32),
        wall_count: wp.array(dtype=wp.int32),
        wall: wp.array(dtype=wp.int32),
        free: wp.array(dtype=wp.int32),
        position: wp.array(dtype=t.vec),
        wall_position: wp.array(dtype=t.vec),
        velocity: wp.array(dtype=t.vec),
        pair_weight: wp.array(dtype=scalar),
        pair_coefficient: wp.array(dtype=scalar),
        diagonal: wp.array(dtype=scalar),
        residual: wp.array(dtype=scalar),
        increment: wp.array(dtype=scalar),
    ):
        if flags[HALTED] != 0:
            return
        begin = first + wp.tid() * wp.static(span(serial))
        for i in range(begin, wp.min(begin + wp.static(span(serial)), end)):
            x = position[i]
            v = velocity[i]
            total = scalar(0.0)
            rate = scalar(0.0)
            for k in range(near_count[i]):
                at = place(i, k, flow.count, near_capacity)
                j = near[at]
                pair_coefficient[at] = pair_weight[at]
                total += pair_weight[at]
                d = position[j] - x
                r = wp.max(wp.length(d), scalar(1.0e-3) * flow.spacing)
                if r < flow.cutoff:
                    rate -= flow.cutoff / (r * r * r) * wp.dot(d, velocity[j] - v)
            n = f.outward(x)
            for k in range(wall_count[i]):
                y = wall_position[wall[place(i, k, flow.count, wall_capacity)]]
                d = y - x
                r = wp.max(wp.length(d), scalar(1.0e-3) * flow.spacing)
                if r < flow.cutoff:
                    jump = t.vec()
                    if wp.length(f.across(y)) > flow.radius:
                        jump -= wp.dot(v, n) * n
                    if y[last] < scalar(0.0):
                        jump[last] = jump[last] - (v[last] - flow.piston_speed)
                    rate -= flow.cutoff / (r * r * r) * wp.dot(d, jump)
            diagonal[i] = total
            increment[i] = scalar(0.0)
            residual[i] = flow.density / flow.dt * rate / flow.lattice_number
            if free[i] != 0:
                residual[i] = scalar(0.0)

    @wp.kernel(enable_backward=False, module="unique")
    def project(
        flow: Flow,
        first: wp.int32,
        end: wp.int32,
        near_capacity: wp.int32,
        wall_capacity: wp.int32,
        flags: wp.array(dtype=wp.int32),
        near_count: wp.array(dtype=wp.int32),
        near: wp.array(dtype=wp.int32),
        wall_count: wp.array(dtype=wp.int32),
        wall: wp.array(dtype=wp.int32),
        position: wp.array(dtype=t.vec),
        wall_position: wp.array(dtype=t.vec),
        increment: wp.array(dtype=scalar),
        velocity: wp.array(dtype=t.vec),
        pressure: wp.array(dtype=scalar),
    ):
        if flags[HALTED] != 0:
            return
        begin = first + wp.tid() * wp.static(span(serial))
        for i in range(begin, wp.min(begin + wp.static(span(serial)), end)):
            x = position[i]
            lowest = increment[i]
            for k in range(near_count[i]):
                j = near[place(i, k, flow.count, near_capacity)]
                if wp.length(position[j] - x) < flow.cutoff:
                    lowest = wp.min(lowest, increment[j])
            slope = t.vec()
            for k in range(near_count[i]):
                j = near[place(i, k, flow.count, near_capacity)]
                d = position[j] - x
                r = wp.max(wp.length(d), scalar(1.0e-3) * flow.spacing)
                if r < flow.cutoff:
                    slope += (f.weight(r, flow.cutoff) * (increment[j] - lowest) / (r * r)) * d
            for k in range(wall_count[i]):
                d = wall_position[wall[place(i, k, flow.count, wall_capacity)]] - x
                r = wp.max(wp.length(d), scalar(1.0e-3) * flow.spacing)
                if r < flow.cutoff:
                    slope += (f.weight(r, flow.cutoff) * (increment[i] - lowest) / (r * r)) * d
            gradient = scalar(wp.static(2.0 * dimensions)) / flow.lattice_number * slope
            velocity[i] = velocity[i] - (flow.dt / flow.density) * gradient
            pressure[i] = increment[i]

    return weights, source, project
