"""Kernel for the end of a time step: it advances the time, and halts scenes that must not take another step."""

import functools

import warp as wp

from ..common.control import ARRIVED, ESTIMATED, FAILED, GOAL, HALTED, LATE, OVERFLOW, STALE, STEPS, WAITS
from .structs import DT, DT_PREVIOUS, SINCE_BUILD, TIME, array_structs

CLOSE = 1.0e-6
"""A scene counts as arrived at its end time if the time left is less than this fraction of a time step. This absorbs
rounding errors."""


@functools.cache
def arrived_function(scalar):
    """Return `arrived`, a function that returns true if a scene has taken all steps that it may take for now.

    The scene must then wait until it gets a new goal, or until its stable time step is estimated again.
    """
    Scenes = array_structs(scalar).Scenes

    @wp.func
    def arrived(flags: wp.array2d(dtype=wp.int32), scenes: Scenes, s: wp.int32) -> wp.bool:
        return goal_reached(
            flags[s, STEPS] - flags[s, GOAL], flags[s, STEPS] - flags[s, ESTIMATED] - scenes.row[s].interval,
            scenes.row[s].until - scenes.clock[s, TIME], scenes.clock[s, DT],
        )  # fmt: skip

    return arrived


@wp.func
def goal_reached(beyond_goal: wp.int32, beyond_estimate: wp.int32, left: wp.float64, dt: wp.float64) -> wp.bool:
    """Return True if the step goal, the next estimate of the stable step or the end time is reached.

    `beyond_goal` is the present step count minus the step goal, the count at which the scene must halt.
    `beyond_estimate` is the present step count minus the count at which the stable step is estimated next. `left` is
    the time left until the end time [s].
    """
    return beyond_goal >= 0 or beyond_estimate >= 0 or not (left > wp.float64(wp.static(CLOSE)) * dt)


@functools.cache
def clock_kernel(scalar, growth: bool) -> wp.Kernel:
    """Return the kernel, with one thread per scene, that completes a step and halts the scene if necessary.

    It advances the time and the step count. With `growth` it also advances the growth of the spheres during packing. A
    scene halts if it has failed, if it needs new neighbour lists or a new estimate of the stable step, or if it has
    reached its last step or its end time.
    """
    Scenes = array_structs(scalar).Scenes

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False)
    def advance_clock(flags: wp.array2d(dtype=wp.int32), scenes: Scenes):
        s = wp.tid()
        # This kernel is bound by memory latency, so it issues all its loads at once instead of one after another.
        halted = wp.int32(flags[s, HALTED])
        failed = wp.int32(flags[s, FAILED])
        late = wp.int32(flags[s, LATE])
        overflow = wp.int32(flags[s, OVERFLOW])
        steps = flags[s, STEPS] + 1
        beyond_goal = steps - flags[s, GOAL]
        beyond_estimate = steps - flags[s, ESTIMATED] - scenes.row[s].interval
        until = scenes.row[s].until
        sort_every = scenes.row[s].sort_every
        dt = wp.float64(scenes.clock[s, DT])
        time = scenes.clock[s, TIME] + dt
        since = scenes.clock[s, SINCE_BUILD] + dt
        if halted != 0:
            return
        if failed != 0:
            flags[s, HALTED] = WAITS
            return
        scenes.clock[s, TIME] = time
        scenes.clock[s, DT_PREVIOUS] = dt
        scenes.clock[s, SINCE_BUILD] = since
        flags[s, STEPS] = steps
        if wp.static(growth):
            scenes.scale[s] = wp.min(scenes.scale[s] + scenes.row[s].growth_rate, scenes.row[s].growth_end)
        # Bodies are re-sorted only at fixed step counts, and these steps always force a list rebuild. Otherwise the
        # order of the bodies would depend on when motion happened to make a rebuild necessary.
        if late != 0 or (sort_every > 0 and steps % sort_every == 0):
            flags[s, LATE] = 0
            flags[s, STALE] = 1
            halted = WAITS
        if overflow != 0:
            halted = WAITS
        elif goal_reached(beyond_goal, beyond_estimate, until - time, dt):
            halted = ARRIVED
        if halted != 0:
            flags[s, HALTED] = halted

    return advance_clock
