"""Where the particles of the moving particle method go at the end of a step."""

import functools

import warp as wp

from .mps_types import FAILED, HALTED, LOST, STALE, STEPS, fluid_struct, mps_functions, mps_types, row_place, span

CROWDED = wp.constant(0.95)
"""Spacings at which particles begin to be pushed apart."""


@functools.cache
def shift_kernel(scalar, dimensions: int, serial: bool):
    """How far each particle goes: with its velocity, off crowds, and apart from those that come too near."""
    t = mps_types(scalar, dimensions)
    Flow = fluid_struct(scalar)
    place = row_place(serial)

    @wp.kernel(enable_backward=False, module="unique")
    def shift(
        flow: Flow,
        first: wp.int32,
        end: wp.int32,
        near_capacity: wp.int32,
        flags: wp.array(dtype=wp.int32),
        near_count: wp.array(dtype=wp.int32),
        near: wp.array(dtype=wp.int32),
        position: wp.array(dtype=t.vec),
        pair_weight: wp.array(dtype=scalar),
        fluid_inverse: wp.array(dtype=t.mat),
        potential: wp.array(dtype=scalar),
        moved: wp.array(dtype=t.vec),
    ):
        if flags[HALTED] != 0:
            return
        begin = first + wp.tid() * wp.static(span(serial))
        for i in range(begin, wp.min(begin + wp.static(span(serial)), end)):
            x = position[i]
            p = potential[i]
            slope = t.vec()
            push = t.vec()
            close = scalar(CROWDED) * flow.spacing
            for k in range(near_count[i]):
                at = place(i, k, flow.count, near_capacity)
                j = near[at]
                d = position[j] - x
                square = wp.length_sq(d)
                slope += (pair_weight[at] * square * (potential[j] - p)) * d
                if square < close * close:
                    r = wp.max(wp.sqrt(square), scalar(1.0e-3) * flow.spacing)
                    push -= (scalar(0.1) * (close - r) / r) * d
            away = fluid_inverse[i] * slope
            most = scalar(0.02) * flow.spacing
            size = wp.length(away)
            if size > most:
                away = away * (most / size)
            moved[i] = push - away

    return shift


@functools.cache
def advance_kernel(scalar, dimensions: int, serial: bool):
    """Particles go to their new places; says when the lists are no longer good, or a particle is lost."""
    t = mps_types(scalar, dimensions)
    f = mps_functions(scalar, dimensions)
    Flow = fluid_struct(scalar)
    last = dimensions - 1

    @wp.kernel(enable_backward=False, module="unique")
    def advance(
        flow: Flow,
        first: wp.int32,
        end: wp.int32,
        height: scalar,
        flags: wp.array(dtype=wp.int32),
        velocity: wp.array(dtype=t.vec),
        moved: wp.array(dtype=t.vec),
        built: wp.array(dtype=t.vec),
        rounding: wp.array(dtype=t.vec),
        position: wp.array(dtype=t.vec),
        late: wp.array(dtype=wp.int32),
    ):
        if flags[HALTED] != 0:
            return
        begin = first + wp.tid() * wp.static(span(serial))
        for i in range(begin, wp.min(begin + wp.static(span(serial)), end)):
            x = position[i]
            relative = velocity[i]
            relative[last] = relative[last] - flow.piston_speed
            # What rounding took from small steps is kept and added to the next (Kahan).
            step = flow.dt * relative + moved[i] - rounding[i]
            after = x + step
            rounding[i] = (after - x) - step
            closest = scalar(0.25) * flow.spacing
            out = wp.length(f.across(after)) - (flow.radius - closest)
            if out > scalar(0.0):
                after = after - out * f.outward(after)
            if after[last] < closest:
                after[last] = closest
            position[i] = after
            far = wp.length(after - built[i])
            if far > scalar(0.45) * flow.skin:
                late[0] = 1
            if not (far < flow.radius and after[last] < height):
                late[1] = 1

    return advance


@wp.kernel(enable_backward=False)
def finish(flags: wp.array(dtype=wp.int32), late: wp.array(dtype=wp.int32)):
    """One thread: the step is complete."""
    if flags[HALTED] != 0:
        return
    flags[STEPS] = flags[STEPS] + 1
    if late[0] != 0:
        flags[STALE] = 1
        flags[HALTED] = 1
    if late[1] != 0:
        flags[FAILED] = LOST
        flags[HALTED] = 1
