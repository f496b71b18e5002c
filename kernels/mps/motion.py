"""Kernels that move the particles at the end of a step of the moving particle method."""

import functools

import warp as wp

from ..common.control import FAILED, HALTED, STALE, STEPS
from .structs import LOST, array_structs, flow_struct, mps_functions, mps_types, row_place, span

CROWDED = wp.constant(0.95)
"""Distance between two particles, divided by the initial particle spacing, below which these particles are pushed
apart."""


@functools.cache
def shift_kernel(scalar, dimensions: int, serial: bool):
    """Build the kernel that computes the displacement of each particle in addition to its velocity times the step.

    These displacements move particles out of crowded regions, down the gradient of a potential, and push close pairs
    apart. They change no velocities.
    """
    t = mps_types(scalar, dimensions)
    f = mps_functions(scalar, dimensions)
    FlowConstants = flow_struct(scalar)
    structs = array_structs(scalar, dimensions)
    Particles, Lists, Fields = structs.Particles, structs.Lists, structs.Fields
    place = row_place(serial)

    @wp.kernel(enable_backward=False, module="unique")
    def shift(
        # The next argument holds the parameters of the flow.
        flow: FlowConstants,
        # The next arguments are the range of particles that this launch processes.
        first: wp.int32,
        end: wp.int32,
        # The next arguments hold the state of the flow, which this kernel only reads.
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
            x = particles.position[i]
            p = fields.potential[i]
            slope = t.vec()
            push = t.vec()
            close = scalar(CROWDED) * flow.spacing
            for k in range(lists.near_count[i]):
                at = place(i, k, flow.count, lists.near_capacity)
                j = lists.near[at]
                d = particles.position[j] - x
                square = wp.length_sq(d)
                slope += f.slope_of_pair(fields.pair_weight[at], d, fields.potential[j] - p)
                if square < close * close:
                    r = wp.max(wp.sqrt(square), scalar(1.0e-3) * flow.spacing)
                    push -= (scalar(0.1) * (close - r) / r) * d
            away = fields.fluid_inverse[i] * slope
            farthest = scalar(0.02) * flow.spacing
            size = wp.length(away)
            if size > farthest:
                away = away * (farthest / size)
            fields.extra_displacement[i] = push - away

    return shift


@functools.cache
def advance_kernel(scalar, dimensions: int, serial: bool):
    """Build the kernel that moves the particles and reports stale neighbour lists and lost particles."""
    f = mps_functions(scalar, dimensions)
    FlowConstants = flow_struct(scalar)
    structs = array_structs(scalar, dimensions)
    Particles, Fields = structs.Particles, structs.Fields
    last = dimensions - 1

    @wp.kernel(enable_backward=False, module="unique")
    def advance(
        # The next argument holds the parameters of the flow.
        flow: FlowConstants,
        # The next arguments are the range of particles that this launch processes.
        first: wp.int32,
        end: wp.int32,
        # The next arguments hold the state of the flow, of which this kernel only changes `fields.event_flags`.
        flags: wp.array(dtype=wp.int32),
        fields: Fields,
        # The next arguments are arrays that this kernel reads and writes.
        particles: Particles,
    ):
        if flags[HALTED] != 0:
            return
        begin = first + wp.tid() * wp.static(span(serial))
        for i in range(begin, wp.min(begin + wp.static(span(serial)), end)):
            x = particles.position[i]
            relative = particles.velocity[i]
            relative[last] = relative[last] - flow.piston_speed
            # Kahan summation: the rounding error of each small step is stored and corrected in the next step.
            step = flow.dt * relative + fields.extra_displacement[i] - particles.rounding[i]
            after = x + step
            particles.rounding[i] = (after - x) - step
            out = f.beyond_room(flow, after)
            if out > scalar(0.0):
                after = after - out * f.outward(after)
            lowest = scalar(0.25) * flow.spacing
            if after[last] < lowest:
                after[last] = lowest
            particles.position[i] = after
            far = wp.length(after - fields.position_at_build[i])
            if far > scalar(0.45) * flow.skin:
                fields.event_flags[0] = 1
            if not (far < flow.radius and after[last] < flow.loss_limit):
                fields.event_flags[1] = 1

    return advance


@wp.kernel(enable_backward=False)
def finish(event_flags: wp.array(dtype=wp.int32), flags: wp.array(dtype=wp.int32)):
    """Complete the step in one thread: increase the step count, and halt if lists are stale or a particle is lost."""
    if flags[HALTED] != 0:
        return
    flags[STEPS] = flags[STEPS] + 1
    if event_flags[0] != 0:
        flags[STALE] = 1
        flags[HALTED] = 1
    if event_flags[1] != 0:
        flags[FAILED] = LOST
        flags[HALTED] = 1
