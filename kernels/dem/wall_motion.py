"""Kernels that move walls. The motion of a wall is either prescribed or driven by a force."""

import functools

import warp as wp

from ..common.control import FAILED, HALTED, LATE
from ..common.types import types
from ..common.walls import DRIVEN, FIXED, MESH, PRESCRIBED, wall_struct
from .structs import DT, DT_PREVIOUS, FORCE_SCALE, TIME, array_structs

SPEED_LIMIT = 1.0e4  # Speed above which a scene fails [m/s], far above the speed of pumped or falling concrete.


@wp.func
def ramped(time: wp.float64, ramp: wp.float64):
    """Return the distance travelled in `time` if the speed rises linearly from 0 to 1 and then stays 1.

    The rise takes the time `ramp`. The distance is the integral of min(t / ramp, 1) from 0 to `time`.
    """
    if time <= wp.float64(0.0):
        return wp.float64(0.0)
    if time < ramp:
        return wp.float64(0.5) * time * time / ramp
    return time - wp.float64(0.5) * ramp


@wp.func
def stopped(time: wp.float64, ramp: wp.float64, stroke: wp.float64, pause: wp.float64, stops: wp.float64):
    """Return the distance travelled in `time` with `stops` strokes, followed by motion at a constant speed of 1.

    A stroke takes the time `stroke`. Its speed rises from 0 to 1 within the time `ramp`, and falls again in the same
    way at the end of the stroke. A pause follows each stroke.
    """
    done = wp.min(wp.max(wp.floor(time / (stroke + pause)), wp.float64(0.0)), stops)
    left = time - done * (stroke + pause)
    each = stroke - ramp
    if done == stops:
        return stops * each + ramped(left, ramp)
    if left >= stroke:  # In a pause the distance does not depend on the time, so that the wall rests exactly.
        return (done + wp.float64(1.0)) * each
    return done * each + ramped(left, ramp) - ramped(left - each, ramp)


@functools.cache
def motion_functions(scalar, strokes: bool):
    """Return the functions `follow` and `drive`, which move one wall by one step.

    `follow` moves a wall along a prescribed path, and `drive` moves a wall under a force.
    """
    t = types(scalar)
    structs = array_structs(scalar)
    Scenes, Walls = structs.Scenes, structs.Walls
    Wall = wall_struct(scalar)

    @wp.func
    def distance_at(wall: Wall, time: wp.float64):
        if wp.static(strokes):
            if wall.stops > wp.float64(0.0):
                return stopped(time, wall.ramp_time, wall.stroke_time, wall.pause, wall.stops)
        return ramped(time, wall.ramp_time)

    @wp.func
    def follow(walls: Walls, w: wp.int32, now: wp.float64, dt: wp.float64):
        wall = walls.table[w]
        before = walls.position_exact[w]
        gone = distance_at(wall, now)
        angle = gone * wp.length(wall.spin)
        after = walls.rest_position[w]
        if angle > wp.float64(0.0):
            q = wp.quat_from_axis_angle(wp.normalize(wall.spin), angle)
            after = wall.pivot + wp.quat_rotate(q, after - wall.pivot)
            walls.orientation[w] = t.quat(q)
            walls.normal[w] = wp.quat_rotate(t.quat(q), wall.normal)
        # Translate the rotated wall, because the pivot itself moves with the wall's velocity.
        after += gone * wall.velocity
        rate = wp.float64(0.0)
        if dt > wp.float64(0.0):
            rate = (gone - distance_at(wall, now - dt)) / dt
        # The wall's velocity and spin are means over the step, like the leapfrog velocities of bodies.
        walls.spin[w] = t.vec3(rate * wall.spin)
        walls.position_exact[w] = after
        walls.velocity_exact[w] = (after - before) / wp.max(dt, wp.float64(1.0e-300))
        arm = wp.length(walls.rest_position[w] - wall.pivot)
        if wp.length(wall.velocity) > wp.float64(0.0):
            walls.travel[w] = gone * wp.length(wall.velocity)
        else:
            walls.travel[w] = gone * wp.length(wall.spin) * arm

    @wp.func
    def drive(
        scenes: Scenes,
        s: wp.int32,
        f: wp.vec3d,
        kick: wp.float64,
        dt: wp.float64,
        flags: wp.array2d(dtype=wp.int32),
        walls: Walls,
        w: wp.int32,
    ):
        wall = walls.table[w]
        direction = wp.normalize(wall.velocity)
        speed = wp.dot(walls.velocity_exact[w], direction)
        push_along = wall.drive_force + wp.dot(f, direction)
        # Apply the damper to the mean of the wall's old and new speed (trapezoidal rule), which is stable however
        # strong the damping is.
        half = wp.float64(0.5) * kick * wall.drive_damping / wall.mass
        speed = ((wp.float64(1.0) - half) * speed + kick * push_along / wall.mass) / (wp.float64(1.0) + half)
        if not (wp.abs(speed) <= wp.float64(wp.static(SPEED_LIMIT))):
            # The error code is negative for a failed wall and positive for a failed body. The minimum of the codes is
            # stored, so a wall takes precedence over bodies that fail at the same time on a GPU.
            wp.atomic_min(flags, s, FAILED, -1 - (w - scenes.row[s].walls))
        walls.velocity_exact[w] = speed * direction
        walls.position_exact[w] = walls.position_exact[w] + dt * speed * direction
        walls.travel[w] = walls.travel[w] + dt * speed

    return follow, drive


@functools.cache
def advance_kernel(scalar, strokes: bool) -> wp.Kernel:
    """Return the kernel over walls that collects the forces on each wall in a step and moves the walls.

    Each wall has one thread. `strokes` must be true if any wall moves in strokes with pauses between them.
    """
    t = types(scalar)
    structs = array_structs(scalar)
    Scenes, Walls = structs.Scenes, structs.Walls
    follow, drive = motion_functions(scalar, strokes)

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False)
    def advance_walls(
        # The next arguments are arrays of the simulated state that this kernel only reads.
        scenes: Scenes,
        # The next arguments are arrays of the simulated state that this kernel reads and writes.
        flags: wp.array2d(dtype=wp.int32),
        walls: Walls,
    ):
        w = wp.tid()
        s = walls.scene[w]
        if flags[s, HALTED] != 0:
            return
        dt, previous = wp.float64(scenes.clock[s, DT]), wp.float64(scenes.clock[s, DT_PREVIOUS])
        # Time from the middle of the previous step to the middle of this step [s].
        kick = wp.float64(0.5) * (dt + previous)
        motion = walls.table[w].motion
        unit = wp.float64(1.0) / scenes.clock[s, FORCE_SCALE]
        # All values are read from memory before the first one is written. If reads and writes alternated, their memory
        # latencies would add up and delay the kernels that wait for the walls.
        velocity, spin = wp.vec3d(walls.velocity_exact[w]), wp.vec3d(walls.spin[w])
        impulse, angular_impulse = wp.vec3d(walls.impulse[w]), wp.vec3d(walls.angular_impulse[w])
        work = wp.float64(walls.work[w])
        push = wp.vector(length=6, dtype=wp.int64)
        for part in range(walls.step_force.shape[0]):
            for c in range(6):
                push[c] = push[c] + walls.step_force[part, w, c]
        f = unit * wp.vec3d(wp.float64(push[0]), wp.float64(push[1]), wp.float64(push[2]))
        m = unit * wp.vec3d(wp.float64(push[3]), wp.float64(push[4]), wp.float64(push[5]))
        for part in range(walls.step_force.shape[0]):
            for c in range(6):
                walls.step_force[part, w, c] = wp.int64(0)
        walls.force[w] = f
        walls.moment[w] = m
        walls.impulse[w] = impulse + kick * f
        walls.angular_impulse[w] = angular_impulse + kick * m
        # The contact forces act from the middle of the previous step to the middle of the coming step. The wall's work
        # on the concrete is therefore added in two parts. Here, add the work in the second half of the previous step,
        # with the velocity of that step. The work in the first half of the coming step is added below.
        work = work - wp.float64(0.5) * previous * (wp.dot(f, velocity) + wp.dot(m, spin))
        now = scenes.clock[s, TIME] + dt - walls.table[w].start_time
        if motion == PRESCRIBED and scenes.row[s].held == 0:
            follow(walls, w, now, dt)
        elif motion == DRIVEN and now >= wp.float64(0.0):
            drive(scenes, s, f, kick, dt, flags, walls, w)
        walls.position[w] = t.vec3(walls.position_exact[w])
        walls.velocity[w] = t.vec3(walls.velocity_exact[w])
        walls.work[w] = work - wp.float64(0.5) * dt * (
            wp.dot(f, walls.velocity_exact[w]) + wp.dot(m, wp.vec3d(walls.spin[w]))
        )
        if walls.table[w].kind == MESH and motion != FIXED:
            speed = wp.length(walls.velocity_exact[w])
            speed += wp.length(wp.vec3d(walls.spin[w])) * walls.table[w].extent
            walls.moved[w] = walls.moved[w] + dt * speed
            if walls.moved[w] > wp.float64(0.5) * wp.float64(scenes.row[s].mesh_skin):
                flags[s, LATE] = 1

    return advance_walls
