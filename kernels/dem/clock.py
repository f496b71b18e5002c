"""Kernel for the end of a step: advance the time, and halt scenes that failed, need new lists or reached their goal."""

import functools

import warp as wp

from ..common.control import ARRIVED, ESTIMATED, FAILED, GOAL, HALTED, LATE, OVERFLOW, STALE, STEPS, WAITS
from .structs import DT, DT_PREVIOUS, SINCE_BUILD, TIME, array_structs

CLOSE = 1.0e-6
"""Fraction of a step by which a scene may miss its end time and still count as arrived (absorbs rounding)."""


@functools.cache
def arrived_function(scalar):
    """Return the function `arrived`: true if a scene has reached its goal or needs a new stable step estimate."""
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

    `beyond_goal` and `beyond_estimate` count steps beyond the goal and the next estimate; `left` is the time left [s].
    """
    return beyond_goal >= 0 or beyond_estimate >= 0 or not (left > wp.float64(wp.static(CLOSE)) * dt)


@functools.cache
def clock_kernel(scalar, growth: bool) -> wp.Kernel:
    """Return the kernel, with one thread per scene, that completes a step and halts the scene where it must wait.

    It advances the time, the step count and, with `growth`, the growth of the spheres during packing.
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
        # Bodies are re-sorted at fixed step counts, and sorting always forces a list rebuild. The result of the sorting
        # therefore does not depend on when the lists were last rebuilt for other reasons.
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
