"""Walls: what they are, and how they move, by prescription or by the forces on them."""

import functools

import warp as wp

from .types import DT, DT_PREVIOUS, FAILED, FORCE_SCALE, HALTED, LATE, TIME, scene_struct, types

PLANE = wp.constant(0)
PIPE = wp.constant(1)
MESH = wp.constant(2)

FIXED = wp.constant(0)
PRESCRIBED = wp.constant(1)
DRIVEN = wp.constant(2)

SPEED_LIMIT = 1.0e4  # [m/s]; nothing that is pumped or dropped comes near


@functools.cache
def wall_struct(scalar):
    """What a wall is; motion lives in separate arrays."""
    t = types(scalar)

    @wp.struct
    class Wall:
        kind: wp.int32
        material: wp.int32
        normal: t.vec3  # planes: unit normal into the material, in the wall's frame
        radius: scalar  # pipes: inner radius
        first: wp.int32  # pipes: range of axis segments
        last: wp.int32
        mesh: wp.uint64  # meshes: id of the wp.Mesh, in the wall's frame
        first_face: wp.int32  # meshes: offset of its faces in the flat face arrays
        motion: wp.int32
        start_time: wp.float64  # prescribed motion: the speed ramps linearly from start_time on ...
        ramp_time: wp.float64  # ... for this long, then holds
        velocity: wp.vec3d  # of the final, steady motion [m/s]
        spin: wp.vec3d  # [rad/s], about `pivot`
        pivot: wp.vec3d
        mass: wp.float64  # driven walls: inertia along `velocity`'s unit direction [kg]
        drive_force: wp.float64  # force that pushes a driven wall along that direction [N]
        drive_damping: wp.float64  # [N s/m]
        extent: wp.float64  # meshes: largest distance of a corner from the wall's origin [m]

    return Wall


@functools.cache
def advance_kernel(scalar):
    """One thread a wall: collect the step's forces, move to the next time."""
    t = types(scalar)
    SceneRow = scene_struct(scalar)
    Wall = wall_struct(scalar)

    @wp.func
    def ramped(time: wp.float64, ramp: wp.float64):
        # Integral of min(time / ramp, 1), the distance gone at unit final speed.
        if time <= wp.float64(0.0):
            return wp.float64(0.0)
        if time < ramp:
            return wp.float64(0.5) * time * time / ramp
        return time - wp.float64(0.5) * ramp

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False)
    def advance(
        scenes: wp.array(dtype=SceneRow),
        wall_scene: wp.array(dtype=wp.int32),
        walls: wp.array(dtype=Wall),
        rest_position: wp.array(dtype=wp.vec3d),
        clock: wp.array2d(dtype=wp.float64),
        flags: wp.array2d(dtype=wp.int32),
        step_force: wp.array3d(dtype=wp.int64),
        position_exact: wp.array(dtype=wp.vec3d),
        velocity_exact: wp.array(dtype=wp.vec3d),
        position: wp.array(dtype=t.vec3),
        orientation: wp.array(dtype=t.quat),
        normal: wp.array(dtype=t.vec3),
        velocity: wp.array(dtype=t.vec3),
        spin: wp.array(dtype=t.vec3),
        force: wp.array(dtype=wp.vec3d),
        moment: wp.array(dtype=wp.vec3d),
        impulse: wp.array(dtype=wp.vec3d),
        angular_impulse: wp.array(dtype=wp.vec3d),
        travel: wp.array(dtype=wp.float64),
        work: wp.array(dtype=wp.float64),
        moved: wp.array(dtype=wp.float64),
    ):
        w = wp.tid()
        s = wall_scene[w]
        if flags[s, HALTED] != 0:
            return
        dt = clock[s, DT]
        # Forces act from the middle of the step before to the middle of this one.
        kick = wp.float64(0.5) * (dt + clock[s, DT_PREVIOUS])
        wall = walls[w]
        unit = wp.float64(1.0) / clock[s, FORCE_SCALE]
        f = wp.vec3d()
        m = wp.vec3d()
        for c in range(3):
            push = wp.int64(0)
            turn = wp.int64(0)
            for part in range(step_force.shape[0]):
                push += step_force[part, w, c]
                turn += step_force[part, w, c + 3]
                step_force[part, w, c] = wp.int64(0)
                step_force[part, w, c + 3] = wp.int64(0)
            f[c] = unit * wp.float64(push)
            m[c] = unit * wp.float64(turn)
        force[w] = f
        moment[w] = m
        impulse[w] = impulse[w] + kick * f
        angular_impulse[w] = angular_impulse[w] + kick * m
        before = position_exact[w]
        # Work done on the material, with the velocity of the middle of the step that ends here.
        work[w] = work[w] - wp.float64(0.5) * clock[s, DT_PREVIOUS] * (
            wp.dot(f, velocity_exact[w]) + wp.dot(m, wp.vec3d(spin[w]))
        )
        now = clock[s, TIME] + dt - wall.start_time
        if wall.motion == PRESCRIBED:
            gone = ramped(now, wall.ramp_time)
            angle = gone * wp.length(wall.spin)
            after = rest_position[w]
            if angle > wp.float64(0.0):
                q = wp.quat_from_axis_angle(wp.normalize(wall.spin), angle)
                after = wall.pivot + wp.quat_rotate(q, after - wall.pivot)
                orientation[w] = t.quat(q)
                normal[w] = wp.quat_rotate(t.quat(q), wall.normal)
            after += gone * wall.velocity  # the pivot travels along
            rate = wp.float64(0.0)
            if dt > wp.float64(0.0):
                rate = (gone - ramped(now - dt, wall.ramp_time)) / dt
            # Average over the step, as the particles' leapfrog velocities are.
            spin[w] = t.vec3(rate * wall.spin)
            position_exact[w] = after
            velocity_exact[w] = (after - before) / wp.max(dt, wp.float64(1.0e-300))
            arm = wp.length(rest_position[w] - wall.pivot)
            if wp.length(wall.velocity) > wp.float64(0.0):
                travel[w] = gone * wp.length(wall.velocity)
            else:
                travel[w] = gone * wp.length(wall.spin) * arm
        elif wall.motion == DRIVEN and now >= wp.float64(0.0):
            direction = wp.normalize(wall.velocity)
            speed = wp.dot(velocity_exact[w], direction)
            push_along = wall.drive_force + wp.dot(f, direction)
            # The damper acts on the mean of old and new speed, which is stable for any damping.
            half = wp.float64(0.5) * kick * wall.drive_damping / wall.mass
            speed = ((wp.float64(1.0) - half) * speed + kick * push_along / wall.mass) / (wp.float64(1.0) + half)
            if not (wp.abs(speed) <= wp.float64(wp.static(SPEED_LIMIT))):
                flags[s, FAILED] = -1 - (w - scenes[s].walls)
            velocity_exact[w] = speed * direction
            position_exact[w] = before + dt * speed * direction
            travel[w] = travel[w] + dt * speed
        position[w] = t.vec3(position_exact[w])
        velocity[w] = t.vec3(velocity_exact[w])
        work[w] = work[w] - wp.float64(0.5) * dt * (wp.dot(f, velocity_exact[w]) + wp.dot(m, wp.vec3d(spin[w])))
        if wall.kind == MESH and wall.motion != FIXED:
            moved[w] = moved[w] + dt * (wp.length(velocity_exact[w]) + wp.length(wp.vec3d(spin[w])) * wall.extent)
            if moved[w] > wp.float64(0.5) * wp.float64(scenes[s].mesh_skin):
                flags[s, LATE] = 1

    return advance
