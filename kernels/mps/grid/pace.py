"""Adaptive time steps of a flow on a grid, limited by the error of a step and by the distance that concrete moves.

The error of a step of the backward Euler method is half the step times the change of the acceleration between two
steps. Here, acceleration means the rate of change of the root mean square speed of the flow. The acceleration at a
single face would contain the noise of the particles, which a shorter step does not reduce.

With a free surface, the transfer of velocities from particles to the grid changes even the rms speed by up to a
hundredth in every step, however short the step is. If errors had to be smaller than this change, steps would shrink to
microseconds, and the many transfers would slow the flow down.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ...common.control import FAILED, GOAL, HALTED, STEPS
from ...common.reductions import BLOCK, keep, total
from ..structs import LOST
from .cells import (
    BEFORE,
    CELLS_PER_SECOND,
    DT,
    GATHERED,
    LAST,
    LIQUID,
    NOW,
    RATE,
    SPEED,
    UNTIL,
    WANTED,
    GridKind,
    grid_parameters_struct,
    grid_structs,
)

COURANT = wp.constant(wp.float64(1.0))
"""Maximum number of cells that the fastest concrete crosses in a step (Courant number)."""
LONGER, SHORTER = wp.constant(wp.float64(1.25)), wp.constant(wp.float64(0.2))
"""Limits of the ratio between successive time steps. A step may be at most LONGER times as long as the length that was
allowed for the previous step. If the error of a step was too large, the next step is shorter, but at least SHORTER
times as long. The Courant number may shorten it further."""
SAFETY = wp.constant(wp.float64(0.9))
LEAST = wp.constant(wp.float64(1.0e-4))
"""Shortest allowed time step, divided by the longest allowed one."""


@wp.struct
class Pace:
    """Parameters that determine the length of the time steps and the accuracy of the solves."""

    longest: wp.float64  # Longest allowed time step [s].

    # Allowed error of a step divided by the rms speed of the concrete; 0 if all steps have the longest allowed length.
    error: wp.float64
    floor: wp.float64  # Lower limit of the rms speed by which errors are divided [m/s].

    # Second limit for the error of a step, divided by the change of the rms speed in the transfer of velocities from
    # particles to the grid. The larger of this limit and the limit `error` applies.
    transfer: wp.float64
    viscous: wp.float64  # Residual norm at which the viscous solve stops in a step of the longest allowed length.
    pressure: wp.float64  # Residual norm at which the pressure solve stops in a step of the longest allowed length.

    # Residual norm at which the solve that disperses particles stops in a step of the longest allowed length.
    crowding: wp.float64


@functools.cache
def speed_kernels(scalar, of: GridKind) -> SimpleNamespace:
    """Build the kernels that measure the speed of the concrete.

    They compute the root mean square (rms) speed, and the largest number of cells that concrete crosses per second. A
    CPU runs the kernel `speeds`, a GPU the kernel `sums` followed by `speeds_of_sums`.
    """
    dims = of.dimensions
    Grid = grid_parameters_struct(scalar, dims)
    Fields = grid_structs(scalar, dims).Fields

    @wp.func
    def cells_per_second(g: Grid, mesh: Fields, r: wp.int32) -> wp.float64:
        """Return the number of cells that the concrete at a face crosses per second."""
        axis = r / g.slots
        speed = mesh.velocity[r]
        if wp.static(of.periodic):
            if axis == wp.static(dims - 1):
                speed -= g.frame
        return wp.float64(wp.abs(speed) / g.width[axis])

    @wp.kernel(enable_backward=False, module="unique")
    def speeds(g: Grid, flags: wp.array(dtype=wp.int32), mesh: Fields):
        """Compute the concrete's rms speed and the largest number of cells that it crosses per second, in one task."""
        if flags[HALTED] != 0:
            return
        square = wp.float64(0.0)
        gathered = wp.float64(0.0)
        volume = wp.float64(0.0)
        most = wp.float64(0.0)
        for r in range(dims * g.slots):
            if mesh.kind[r] == LIQUID:
                own = wp.float64(mesh.volume[r])
                u = wp.float64(mesh.velocity[r])
                before = wp.float64(mesh.start[r])
                square += own * u * u
                gathered += own * before * before
                volume += own
                most = wp.max(most, cells_per_second(g, mesh, r))
        mesh.clock[SPEED] = wp.sqrt(square / wp.max(volume, wp.float64(1.0e-30)))
        mesh.clock[GATHERED] = wp.sqrt(gathered / wp.max(volume, wp.float64(1.0e-30)))
        mesh.clock[CELLS_PER_SECOND] = most

    @wp.kernel(enable_backward=False, module="unique")
    def sums(g: Grid, blocks: wp.int32, mesh: Fields, partial: wp.array(dtype=wp.float64)):
        """Compute each block's sums of volume times squared speed and of volume, and its maximum crossing rate.

        The crossing rate is the number of cells that the flow crosses per second (`cells_per_second`). One thread
        processes one face of the grid. All threads of a block take part in its sums, so the kernel runs in whole
        blocks.
        """
        r = wp.tid()
        square = wp.float64(0.0)
        gathered = wp.float64(0.0)
        volume = wp.float64(0.0)
        most = wp.float64(0.0)
        if r < dims * g.slots:
            if mesh.kind[r] == LIQUID:
                u = wp.float64(mesh.velocity[r])
                before = wp.float64(mesh.start[r])
                volume = wp.float64(mesh.volume[r])
                square = volume * u * u
                gathered = volume * before * before
                most = cells_per_second(g, mesh, r)
        keep(r, partial, 0, square)
        keep(r, partial, blocks, volume)
        keep(r, partial, 2 * blocks, gathered)
        highest = wp.tile_max(wp.tile(most))
        whole = highest[0]
        if r % BLOCK == 0:
            partial[3 * blocks + r / BLOCK] = whole

    @wp.kernel(enable_backward=False, module="unique")
    def speeds_of_sums(
        blocks: wp.int32, flags: wp.array(dtype=wp.int32), partial: wp.array(dtype=wp.float64), mesh: Fields
    ):
        """Combine the block results of `sums` into the concrete's rms speed and its largest crossing rate.

        The crossing rate is the number of cells that the concrete crosses per second. The kernel runs in one block.
        """
        thread = wp.tid()
        square = total(thread, partial, 0, blocks)
        volume = total(thread, partial, blocks, blocks)
        gathered = total(thread, partial, 2 * blocks, blocks)
        own = wp.float64(0.0)
        for k in range(thread, blocks, BLOCK):
            own = wp.max(own, partial[3 * blocks + k])
        highest = wp.tile_max(wp.tile(own))
        most = highest[0]
        if thread == 0 and flags[HALTED] == 0:
            mesh.clock[SPEED] = wp.sqrt(square / wp.max(volume, wp.float64(1.0e-30)))
            mesh.clock[GATHERED] = wp.sqrt(gathered / wp.max(volume, wp.float64(1.0e-30)))
            mesh.clock[CELLS_PER_SECOND] = most

    return SimpleNamespace(speeds=speeds, sums=sums, speeds_of_sums=speeds_of_sums)


@functools.cache
def clock_kernels(scalar, of: GridKind) -> SimpleNamespace:
    """Build the kernels `begin`, which sets a goal for the flow, and `tick`, which ends each step.

    The goal is a time or a step count at which the flow must halt. A flow that has reached its goal is marked as halted
    and takes no steps. Therefore `begin`, which needs only one thread, sets the new goal and also removes this mark.
    """
    Fields = grid_structs(scalar, of.dimensions).Fields

    @wp.func
    def fit(
        pace: Pace, clock: wp.array(dtype=wp.float64), viscous: wp.array(dtype=wp.float64),
        pressure: wp.array(dtype=wp.float64), crowding: wp.array(dtype=wp.float64),
    ):  # fmt: skip
        """Set the next time step, and the residual norms at which the solves stop.

        If the time left before the end time is shorter than four wanted time steps, it is divided into equal steps. The
        norms are inversely proportional to the time step, or to its square for the solve that disperses particles.
        """
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
        """Return the length of the next step [s] that the error and the speed of the completed step allow.

        If `first` is true, the error is not used, because it is not known in the first step.
        """
        dt = clock[DT]
        # Limit the growth of the time step relative to the length that was allowed for the previous step. The actual
        # length of that step may be shorter, because a step is cut short to end at a given time.
        longest = LONGER * clock[WANTED]
        longer = longest
        if not first:
            # The error is proportional to the square of the step, so the allowed step follows from a square root.
            error = wp.float64(0.5) * wp.abs(clock[SPEED] - clock[BEFORE] - clock[RATE] * dt)
            allowed = pace.error * wp.max(clock[SPEED], pace.floor)
            allowed = wp.max(allowed, pace.transfer * wp.abs(clock[GATHERED] - clock[BEFORE]))
            factor = wp.max(SAFETY * wp.sqrt(allowed / wp.max(error, wp.float64(1.0e-30))), SHORTER)
            longer = wp.min(factor * dt, longest)
        clock[RATE] = (clock[SPEED] - clock[BEFORE]) / dt
        clock[BEFORE] = clock[SPEED]
        longer = wp.min(longer, COURANT / wp.max(clock[CELLS_PER_SECOND], wp.float64(1.0e-30)))
        return wp.clamp(longer, LEAST * pace.longest, pace.longest)

    @wp.kernel(enable_backward=False, module="unique")
    def tick(
        pace: Pace, event_flags: wp.array(dtype=wp.int32), flags: wp.array(dtype=wp.int32), mesh: Fields,
        viscosity_threshold: wp.array(dtype=wp.float64), pressure_threshold: wp.array(dtype=wp.float64),
        dispersion_threshold: wp.array(dtype=wp.float64),
    ):  # fmt: skip
        """Complete the step in one thread: advance the clock, choose the next step, and halt at the goal."""
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
                fit(pace, mesh.clock, viscosity_threshold, pressure_threshold, dispersion_threshold)
        else:
            mesh.clock[NOW] = wp.float64(flags[STEPS]) * mesh.clock[DT]
        if flags[STEPS] >= flags[GOAL]:
            flags[HALTED] = 1
        if event_flags[1] != 0:
            flags[FAILED] = LOST
            flags[HALTED] = 1

    @wp.kernel(enable_backward=False, module="unique")
    def begin(
        until: wp.float64, goal: wp.int32, pace: Pace, flags: wp.array(dtype=wp.int32), mesh: Fields,
        viscosity_threshold: wp.array(dtype=wp.float64), pressure_threshold: wp.array(dtype=wp.float64),
        dispersion_threshold: wp.array(dtype=wp.float64),
    ):  # fmt: skip
        """Set the time or the step count at which the flow must halt, and let the flow continue, in one task."""
        if flags[FAILED] != 0:
            return
        flags[GOAL] = goal
        mesh.clock[UNTIL] = until
        flags[HALTED] = 0
        if flags[STEPS] >= goal or until - mesh.clock[NOW] < wp.float64(1.0e-9) * pace.longest:
            flags[HALTED] = 1
        elif pace.error > wp.float64(0.0):
            fit(pace, mesh.clock, viscosity_threshold, pressure_threshold, dispersion_threshold)

    return SimpleNamespace(tick=tick, begin=begin)
