"""The end of a step: time goes on, and scenes that must wait are halted."""

import functools

import warp as wp

from ..common.control import FAILED, GOAL, HALTED, LATE, OVERFLOW, STALE, STEPS
from .structs import DT, DT_PREVIOUS, SINCE_BUILD, TIME, array_structs


@functools.cache
def clock_kernel(scalar, growth: bool):
    """One thread a scene: complete the step (time, step count, growth), and halt the scene where it must wait."""
    Scenes = array_structs(scalar).Scenes

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False)
    def advance_clock(flags: wp.array2d(dtype=wp.int32), scenes: Scenes):
        s = wp.tid()
        if flags[s, HALTED] != 0:
            return
        if flags[s, FAILED] != 0:
            flags[s, HALTED] = 1
            return
        dt = scenes.clock[s, DT]
        scenes.clock[s, TIME] = scenes.clock[s, TIME] + dt
        scenes.clock[s, DT_PREVIOUS] = dt
        scenes.clock[s, SINCE_BUILD] = scenes.clock[s, SINCE_BUILD] + dt
        steps = flags[s, STEPS] + 1
        flags[s, STEPS] = steps
        if wp.static(growth):
            scenes.scale[s] = wp.min(scenes.scale[s] + scenes.row[s].growth_rate, scenes.row[s].growth_end)
        if flags[s, LATE] != 0:
            flags[s, LATE] = 0
            flags[s, STALE] = 1
            flags[s, HALTED] = 1
        if steps >= flags[s, GOAL] or flags[s, OVERFLOW] != 0:
            flags[s, HALTED] = 1

    return advance_clock
