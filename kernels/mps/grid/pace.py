"""How long the steps of a flow on a grid are: by what a step errs, and by how far concrete goes in it.

Backward Euler errs by half a step times the change of the acceleration from a step to the next. Here that is the
change of the flow's rms speed: of one face it would be the noise of particles, which no shorter step makes less.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ...common.control import FAILED, GOAL, HALTED, STEPS
from ...common.reductions import BLOCK, keep, total
from ..structs import LOST
from .cells import (
    BEFORE,
    DT,
    LAST,
    LIQUID,
    NOW,
    RATE,
    SPEED,
    SWIFT,
    UNTIL,
    WANTED,
    Kind,
    cells_struct,
    grid_structs,
)

COURANT = wp.constant(wp.float64(1.0))
"""Cells that the fastest concrete passes in a step, at most."""
LONGER, SHORTER = wp.constant(wp.float64(1.25)), wp.constant(wp.float64(0.2))
"""What a step may be of the one that was wanted before, and of the one before."""
SAFETY = wp.constant(wp.float64(0.9))
LEAST = wp.constant(wp.float64(1.0e-4))
"""Shortest step over the longest."""


@wp.struct
class Pace:
    """What the length of steps goes by."""

    longest: wp.float64  # step [s]
    error: wp.float64  # that a step may make, over the rms speed; 0: all steps are the longest
    floor: wp.float64  # of that speed [m/s]
    viscous: wp.float64  # residual of the viscosity's solve that is small enough for the longest step
    pressure: wp.float64  # likewise, of the pressure's
    crowding: wp.float64  # and of the one that moves particles apart


@functools.cache
def speed_kernels(scalar, of: Kind) -> SimpleNamespace:
    """Kernels `speeds`, or `sums` and `speeds_of_sums` on a GPU: how fast concrete goes."""
    dims = of.dimensions
    Cells = cells_struct(scalar, dims)
    Mesh = grid_structs(scalar, dims).Mesh

    @wp.func
    def swift(g: Cells, mesh: Mesh, r: wp.int32) -> wp.float64:
        """Cells that a face's concrete passes in a second."""
        axis = r / g.slots
        speed = mesh.velocity[r]
        if wp.static(of.periodic):
            if axis == wp.static(dims - 1):
                speed -= g.frame
        return wp.float64(wp.abs(speed) / g.width[axis])

    @wp.kernel(enable_backward=False, module="unique")
    def speeds(g: Cells, flags: wp.array(dtype=wp.int32), mesh: Mesh):
        """One task."""
        if flags[HALTED] != 0:
            return
        square = wp.float64(0.0)
        volume = wp.float64(0.0)
        most = wp.float64(0.0)
        for r in range(dims * g.slots):
            if mesh.kind[r] == LIQUID:
                u = wp.float64(mesh.velocity[r])
                square += wp.float64(mesh.volume[r]) * u * u
                volume += wp.float64(mesh.volume[r])
                most = wp.max(most, swift(g, mesh, r))
        mesh.clock[SPEED] = wp.sqrt(square / wp.max(volume, wp.float64(1.0e-30)))
        mesh.clock[SWIFT] = most

    @wp.kernel(enable_backward=False, module="unique")
    def sums(g: Cells, blocks: wp.int32, mesh: Mesh, partial: wp.array(dtype=wp.float64)):
        """Whole blocks; a thread a face."""
        r = wp.tid()
        square = wp.float64(0.0)
        volume = wp.float64(0.0)
        most = wp.float64(0.0)
        if r < dims * g.slots:
            if mesh.kind[r] == LIQUID:
                u = wp.float64(mesh.velocity[r])
                volume = wp.float64(mesh.volume[r])
                square = volume * u * u
                most = swift(g, mesh, r)
        keep(r, partial, 0, square)
        keep(r, partial, blocks, volume)
        highest = wp.tile_max(wp.tile(most))
        whole = highest[0]
        if r % BLOCK == 0:
            partial[2 * blocks + r / BLOCK] = whole

    @wp.kernel(enable_backward=False, module="unique")
    def speeds_of_sums(
        blocks: wp.int32, flags: wp.array(dtype=wp.int32), partial: wp.array(dtype=wp.float64), mesh: Mesh
    ):
        """One block."""
        thread = wp.tid()
        square = total(thread, partial, 0, blocks)
        volume = total(thread, partial, blocks, blocks)
        own = wp.float64(0.0)
        for k in range(thread, blocks, BLOCK):
            own = wp.max(own, partial[2 * blocks + k])
        highest = wp.tile_max(wp.tile(own))
        most = highest[0]
        if thread == 0 and flags[HALTED] == 0:
            mesh.clock[SPEED] = wp.sqrt(square / wp.max(volume, wp.float64(1.0e-30)))
            mesh.clock[SWIFT] = most

    return SimpleNamespace(speeds=speeds, sums=sums, speeds_of_sums=speeds_of_sums)


@functools.cache
def clock_kernels(scalar, of: Kind) -> SimpleNamespace:
    """Kernels `tick` at the end of a step, and `begin` where a flow sets out."""
    Mesh = grid_structs(scalar, of.dimensions).Mesh

    @wp.func
    def fit(
        pace: Pace, clock: wp.array(dtype=wp.float64), viscous: wp.array(dtype=wp.float64),
        pressure: wp.array(dtype=wp.float64), crowding: wp.array(dtype=wp.float64),
    ):  # fmt: skip
        """The next step: as long as is wanted, or an equal part of what is left; residuals go with one over it."""
        left = clock[UNTIL] - clock[NOW]
        dt = clock[WANTED]
        if left < wp.float64(4.0) * dt:
            dt = left / wp.max(wp.ceil(left / dt - wp.float64(1.0e-6)), wp.float64(1.0))
        clock[DT] = dt
        viscous[0] = pace.viscous * pace.longest / dt
        pressure[0] = pace.pressure * pace.longest / dt
        crowding[0] = pace.crowding * pace.longest * pace.longest / (dt * dt)

    @wp.func
    def wanted(pace: Pace, clock: wp.array(dtype=wp.float64), first: wp.bool) -> wp.float64:
        """Length of the next step, by what this one did."""
        dt = clock[DT]
        longest = LONGER * clock[WANTED]  # which this step may be shorter than, as it ends when it had to
        longer = longest
        if not first:
            error = wp.float64(0.5) * wp.abs(clock[SPEED] - clock[BEFORE] - clock[RATE] * dt)
            allowed = pace.error * wp.max(clock[SPEED], pace.floor)
            factor = wp.max(SAFETY * wp.sqrt(allowed / wp.max(error, wp.float64(1.0e-30))), SHORTER)
            longer = wp.min(factor * dt, longest)
        clock[RATE] = (clock[SPEED] - clock[BEFORE]) / dt
        clock[BEFORE] = clock[SPEED]
        longer = wp.min(longer, COURANT / wp.max(clock[SWIFT], wp.float64(1.0e-30)))
        return wp.clamp(longer, LEAST * pace.longest, pace.longest)

    @wp.kernel(enable_backward=False, module="unique")
    def tick(
        pace: Pace, late: wp.array(dtype=wp.int32), flags: wp.array(dtype=wp.int32), mesh: Mesh,
        viscous_least: wp.array(dtype=wp.float64), pressure_least: wp.array(dtype=wp.float64),
        crowding_least: wp.array(dtype=wp.float64),
    ):  # fmt: skip
        """One thread: the step is complete."""
        if flags[HALTED] != 0:
            return
        first = flags[STEPS] == 0
        mesh.clock[LAST] = mesh.clock[DT]
        flags[STEPS] = flags[STEPS] + 1
        if pace.error > wp.float64(0.0):
            mesh.clock[NOW] = mesh.clock[NOW] + mesh.clock[DT]
            mesh.clock[WANTED] = wanted(pace, mesh.clock, first)
            if mesh.clock[UNTIL] - mesh.clock[NOW] < wp.float64(1.0e-9) * pace.longest:
                flags[HALTED] = 1
            else:
                fit(pace, mesh.clock, viscous_least, pressure_least, crowding_least)
        else:
            mesh.clock[NOW] = wp.float64(flags[STEPS]) * mesh.clock[DT]
        if flags[STEPS] >= flags[GOAL]:
            flags[HALTED] = 1
        if late[1] != 0:
            flags[FAILED] = LOST
            flags[HALTED] = 1

    @wp.kernel(enable_backward=False, module="unique")
    def begin(
        until: wp.float64, goal: wp.int32, pace: Pace, flags: wp.array(dtype=wp.int32), mesh: Mesh,
        viscous_least: wp.array(dtype=wp.float64), pressure_least: wp.array(dtype=wp.float64),
        crowding_least: wp.array(dtype=wp.float64),
    ):  # fmt: skip
        """One thread: on to a time, or to a number of steps."""
        if flags[FAILED] != 0:
            return
        flags[GOAL] = goal
        mesh.clock[UNTIL] = until
        flags[HALTED] = 0
        if flags[STEPS] >= goal or until - mesh.clock[NOW] < wp.float64(1.0e-9) * pace.longest:
            flags[HALTED] = 1
        elif pace.error > wp.float64(0.0):
            fit(pace, mesh.clock, viscous_least, pressure_least, crowding_least)

    return SimpleNamespace(tick=tick, begin=begin)
