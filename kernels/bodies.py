"""Motion of rigid bodies: forces gathered from a body's own spheres, leapfrog, spheres carried along."""

import functools

import warp as wp

from .geometry import axis_functions
from .types import DT, DT_PREVIOUS, FAILED, LATE, SINCE_BUILD, STALE, STEPS, TIME, types, vector_functions


@functools.cache
def rotation_functions(scalar):
    """Quaternion turn by a rotation vector, and the spin that an angular momentum gives."""
    t = types(scalar)

    @wp.func
    def turned(q: t.quat, rotation: t.vec3):
        angle = wp.length(rotation)
        if angle > scalar(0.0):
            q = wp.normalize(wp.quat_from_axis_angle(rotation / angle, angle) * q)
        return q

    @wp.func
    def spin_of(q: t.quat, angular_momentum: t.vec3, inertia: t.vec3):
        local = wp.quat_rotate_inv(q, angular_momentum)
        return wp.quat_rotate(q, wp.cw_div(local, inertia))

    return turned, spin_of


@functools.cache
def body_kernel(scalar, clumps: bool, drives: bool, growth: bool, meshes: bool, losses: bool):
    """Kernel over bodies: one leapfrog step (Zhan et al. 2019, Eqs. 2-3).

    Velocities live at half steps, positions at full steps; the kick spans from the middle of the step
    before to the middle of this one, so the step size may change on the way. Bodies with three principal
    moments keep their angular momentum in space; the spin is taken at the middle of the turn (a fixed-point
    iteration), which makes the turn time-reversible and its energy error bounded.
    """
    t = types(scalar)
    xyz = vector_functions(scalar).xyz
    pack = vector_functions(scalar).pack
    axis = axis_functions(scalar)
    Segment = axis.Segment
    closest_on_axis = axis.closest_on_axis
    turned, spin_of = rotation_functions(scalar)
    single = scalar is wp.float32

    @wp.kernel(module="unique", enable_backward=False)
    def move(
        gravity: t.vec3,
        local_damping: scalar,
        speed_limit: scalar,
        segments: wp.array(dtype=Segment),
        drive_axis: wp.array2d(dtype=wp.int32),
        drive_force: wp.array(dtype=scalar),
        body_group: wp.array(dtype=wp.int32),
        body_mass: wp.array(dtype=scalar),
        body_inertia: wp.array(dtype=t.vec3),
        body_first: wp.array(dtype=wp.int32),
        sphere_offset: wp.array(dtype=t.vec4),
        sphere_built: wp.array(dtype=t.vec4),
        reference_velocity: wp.array(dtype=t.vec3),
        skin: scalar,
        mesh_skin: scalar,
        growth_rate: scalar,
        growth_end: scalar,
        clock: wp.array(dtype=wp.float64),
        flags: wp.array(dtype=wp.int32),
        scale: wp.array(dtype=scalar),
        force: wp.array(dtype=t.vec3),
        moment: wp.array(dtype=t.vec3),
        sphere_lost: wp.array(dtype=wp.float64),
        body_position: wp.array(dtype=t.vec3),
        body_rounding: wp.array(dtype=t.vec3),
        body_velocity: wp.array(dtype=t.vec3),
        body_spin: wp.array(dtype=t.vec3),
        body_orientation: wp.array(dtype=t.quat),
        body_angular_momentum: wp.array(dtype=t.vec3),
        sphere_position: wp.array(dtype=t.vec4),
        sphere_velocity: wp.array(dtype=t.vec4),
        sphere_spin: wp.array(dtype=t.vec3),
    ):
        b = wp.tid()
        if flags[STALE] != 0 or flags[FAILED] != 0:
            return
        zero = scalar(0.0)
        dt = scalar(clock[DT])
        kick = scalar(0.5) * scalar(clock[DT] + clock[DT_PREVIOUS])
        x = body_position[b]
        mass = body_mass[b]
        first = body_first[b]
        last = body_first[b + 1]

        total = t.vec3()
        torque = t.vec3()
        for s in range(first, last):
            f = force[s]
            total += f
            torque += moment[s]
            if wp.static(clumps):
                torque += wp.cross(xyz(sphere_position[s]) - x, f)
            force[s] = t.vec3()
            moment[s] = t.vec3()
        if wp.static(drives):
            group = body_group[b]
            if group > 0:
                from_axis, tangent = closest_on_axis(segments, drive_axis[group, 0], drive_axis[group, 1], x)
                total += drive_force[group] * tangent
        total += mass * gravity

        velocity = body_velocity[b]
        if local_damping > zero:
            for c in range(3):
                against = local_damping * wp.abs(total[c])
                if wp.static(losses):
                    lost = wp.float64(against * wp.abs(velocity[c]) * kick)
                    sphere_lost[first] = sphere_lost[first] + lost
                total[c] = total[c] - against * wp.sign(velocity[c])
        velocity += total * (kick / mass)
        speed = wp.length(velocity)
        if not (speed <= speed_limit):
            flags[FAILED] = b + 1
            return
        if wp.static(single):
            # What rounding took from one step is given back in the next: a step far below the resolution of
            # the position still counts.
            way = dt * velocity + body_rounding[b]
            after = x + way
            body_rounding[b] = way - (after - x)
            x = after
        else:
            x += dt * velocity
        body_position[b] = x
        body_velocity[b] = velocity

        spin = body_spin[b]
        orientation = t.quat()
        if local_damping > zero:
            for c in range(3):
                against = local_damping * wp.abs(torque[c])
                if wp.static(losses):
                    lost = wp.float64(against * wp.abs(spin[c]) * kick)
                    sphere_lost[first] = sphere_lost[first] + lost
                torque[c] = torque[c] - against * wp.sign(spin[c])
        if wp.static(clumps):
            inertia = body_inertia[b]
            q = body_orientation[b]
            angular_momentum = body_angular_momentum[b] + kick * torque
            spin = spin_of(q, angular_momentum, inertia)
            if inertia[0] != inertia[1] or inertia[1] != inertia[2]:
                for iteration in range(3):
                    spin = spin_of(turned(q, scalar(0.5) * dt * spin), angular_momentum, inertia)
            orientation = turned(q, dt * spin)
            body_angular_momentum[b] = angular_momentum
            body_orientation[b] = orientation
        else:
            spin += torque * (kick / body_inertia[b][0])
        body_spin[b] = spin

        size = scalar(1.0)
        if wp.static(growth):
            size = wp.min(scale[0] + growth_rate, growth_end)
        drift = scalar(clock[SINCE_BUILD] + clock[DT]) * reference_velocity[0]
        for s in range(first, last):
            offset = sphere_offset[s]
            place = x
            carried = velocity
            if wp.static(clumps):
                arm = wp.quat_rotate(orientation, xyz(offset)) * size
                place += arm
                carried += wp.cross(spin, arm)
            radius = offset[3] * size
            built = sphere_built[s]
            moved = place - xyz(built)
            grown = radius - built[3]
            slack = scalar(0.5) * skin - grown
            if wp.length_sq(moved - drift) > slack * slack or slack < zero:
                flags[LATE] = 1
            if wp.static(meshes):
                if wp.length(moved) + grown > mesh_skin:
                    flags[LATE] = 1
            sphere_position[s] = pack(place, radius)
            sphere_velocity[s] = pack(carried, mass)
            sphere_spin[s] = spin

    return move


@functools.cache
def tick_kernel(scalar, growth: bool):
    """One thread: complete the step (time, step count, growth), and let LATE freeze the next."""

    @wp.kernel(module="unique", enable_backward=False)
    def tick(
        growth_rate: scalar,
        growth_end: scalar,
        clock: wp.array(dtype=wp.float64),
        flags: wp.array(dtype=wp.int32),
        scale: wp.array(dtype=scalar),
    ):
        if flags[STALE] != 0 or flags[FAILED] != 0:
            return
        dt = clock[DT]
        clock[TIME] = clock[TIME] + dt
        clock[DT_PREVIOUS] = dt
        clock[SINCE_BUILD] = clock[SINCE_BUILD] + dt
        flags[STEPS] = flags[STEPS] + 1
        if wp.static(growth):
            scale[0] = wp.min(scale[0] + growth_rate, growth_end)
        if flags[LATE] != 0:
            flags[LATE] = 0
            flags[STALE] = 1

    return tick
