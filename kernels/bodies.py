"""Motion of rigid bodies: forces gathered from a body's own spheres, leapfrog, spheres carried along."""

import functools
from types import SimpleNamespace

import warp as wp

from .geometry import axis_functions
from .rows import row_functions
from .types import (
    DT,
    DT_PREVIOUS,
    FAILED,
    GOAL,
    HALTED,
    LATE,
    OVERFLOW,
    SINCE_BUILD,
    SPAN,
    STALE,
    STEPS,
    TIME,
    scene_struct,
    types,
    vector_functions,
)


@functools.cache
def rotation_functions(scalar):
    """Quaternion turn by a rotation vector (not normalised), and the spin that an angular momentum gives."""
    t = types(scalar)

    @wp.func
    def turned(q: t.quat, rotation: t.vec3):
        a = wp.length_sq(rotation)
        # sin(x / 2) / x and cos(x / 2) in powers of x^2: below 0.1 rad right to the last digit of double precision.
        s = scalar(wp.static(1 / 2)) - a * (
            scalar(wp.static(1 / 48)) - a * (scalar(wp.static(1 / 3840)) - a * scalar(wp.static(1 / 645120)))
        )
        c = scalar(1.0) - a * (
            scalar(wp.static(1 / 8))
            - a
            * (scalar(wp.static(1 / 384)) - a * (scalar(wp.static(1 / 46080)) - a * scalar(wp.static(1 / 10321920))))
        )
        if a > scalar(0.01):
            angle = wp.sqrt(a)
            s = wp.sin(scalar(0.5) * angle) / angle
            c = wp.cos(scalar(0.5) * angle)
        return t.quat(s * rotation[0], s * rotation[1], s * rotation[2], c) * q

    @wp.func
    def spin_of(q: t.quat, angular_momentum: t.vec3, inertia: t.vec3):
        local = wp.quat_rotate_inv(q, angular_momentum)
        return wp.quat_rotate(q, wp.cw_div(local, inertia))

    return turned, spin_of


@functools.cache
def motion_functions(scalar, losses: bool):
    """What both kinds of bodies share: damping, position without lost rounding, and the test of the lists."""
    t = types(scalar)
    xyz = vector_functions(scalar).xyz
    single = scalar is wp.float32

    @wp.func
    def damped(total: t.vec3, velocity: t.vec3, damping: scalar, kick: scalar):
        """Force (moment) less local damping, which acts against each component of the motion, and the energy lost."""
        lost = wp.float64(0.0)
        if damping > scalar(0.0):
            for c in range(3):
                against = damping * wp.abs(total[c])
                if wp.static(losses):
                    lost += wp.float64(against * wp.abs(velocity[c]) * kick)
                total[c] = total[c] - against * wp.sign(velocity[c])
        return total, lost

    @wp.func
    def moved_on(x: t.vec3, way: t.vec3, rounding: t.vec3):
        """New position, and what single precision could not add of this step: the next one gives it back."""
        if wp.static(single):
            way = way + rounding
            after = x + way
            return after, way - (after - x)
        return x + way, rounding

    @wp.func
    def outgrows_lists(place: t.vec3, radius: scalar, built: t.vec4, drift: t.vec3, skin: scalar, share: scalar,
                       meshes: bool):  # fmt: skip
        """Has a sphere gone so far since the build that lists may miss a contact in the next step?"""
        moved = place - xyz(built)
        grown = radius - built[3]
        slack = scalar(0.5) * skin - grown
        late = wp.length_sq(moved - drift) > slack * slack or slack < scalar(0.0)
        if meshes:
            late = late or wp.length(moved) + grown > share
        return late

    return SimpleNamespace(damped=damped, moved_on=moved_on, outgrows_lists=outgrows_lists)


@functools.cache
def sphere_kernel(scalar, drives: bool, growth: bool, meshes: bool, rotation: bool, zero_forces: bool, losses: bool):
    """Kernel over bodies that are all single spheres: one leapfrog step on the sphere arrays alone.

    The same step as `clump_kernel`; what bodies hold besides is written by `publish_kernel`, when somebody looks.
    """
    t = types(scalar)
    span = SPAN if zero_forces else 1
    SceneRow = scene_struct(scalar)
    xyz = vector_functions(scalar).xyz
    pack = vector_functions(scalar).pack
    axis = axis_functions(scalar)
    Segment = axis.Segment
    closest_on_axis = axis.closest_on_axis
    motion = motion_functions(scalar, losses)
    damped, moved_on, outgrows_lists = motion.damped, motion.moved_on, motion.outgrows_lists
    rows = row_functions(scalar)
    read_vec3, read_vec4, write_vec3, write_vec4 = rows.read_vec3, rows.read_vec4, rows.write_vec3, rows.write_vec4

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False)
    def move_spheres(
        scenes: wp.array(dtype=SceneRow),
        first: wp.int32,
        last: wp.int32,
        segments: wp.array(dtype=Segment),
        drive_axis: wp.array2d(dtype=wp.int32),
        drive_force: wp.array(dtype=scalar),
        body_group: wp.array(dtype=wp.int32),
        sphere_scene: wp.array(dtype=wp.int32),
        sphere_offset: wp.array(dtype=t.vec4),
        sphere_built: wp.array(dtype=t.vec4),
        reference_velocity: wp.array(dtype=t.vec3),
        clock: wp.array2d(dtype=wp.float64),
        flags: wp.array2d(dtype=wp.int32),
        scale: wp.array(dtype=scalar),
        force: wp.array(dtype=t.vec3),
        moment: wp.array(dtype=t.vec3),
        sphere_lost: wp.array(dtype=wp.float64),
        body_rounding: wp.array(dtype=t.vec3),
        sphere_position: wp.array(dtype=t.vec4),
        sphere_velocity: wp.array(dtype=t.vec4),
        sphere_spin: wp.array(dtype=t.vec3),
    ):
        begin_i = first + wp.tid() * wp.static(span)
        for i in range(begin_i, wp.min(begin_i + wp.static(span), last)):
            s = sphere_scene[i]
            if flags[s, HALTED] != 0:
                continue
            dt = scalar(clock[s, DT])
            kick = scalar(0.5) * scalar(clock[s, DT] + clock[s, DT_PREVIOUS])
            damping = scenes[s].local_damping
            position = read_vec4(sphere_position, i)
            x = xyz(position)
            radius = position[3]
            before = read_vec4(sphere_velocity, i)
            mass = before[3]
            velocity = xyz(before)
            total = read_vec3(force, i)
            if wp.static(zero_forces):
                write_vec3(force, i, t.vec3())
            if wp.static(drives):
                group = body_group[i]
                if group > 0:
                    group = scenes[s].groups + group
                    from_axis, tangent = closest_on_axis(segments, drive_axis[group, 0], drive_axis[group, 1], x)
                    total += drive_force[group] * tangent
            total += mass * scenes[s].gravity
            total, lost = damped(total, velocity, damping, kick)
            velocity += total * (kick / mass)
            if not (wp.length_sq(velocity) <= scenes[s].speed_limit * scenes[s].speed_limit):
                if flags[s, FAILED] == 0:
                    flags[s, FAILED] = 1 + i - scenes[s].spheres
                continue
            place, rounding = moved_on(x, dt * velocity, read_vec3(body_rounding, i))
            write_vec3(body_rounding, i, rounding)

            if wp.static(rotation):
                spin = read_vec3(sphere_spin, i)
                torque, lost_turning = damped(read_vec3(moment, i), spin, damping, kick)
                if wp.static(zero_forces):
                    write_vec3(moment, i, t.vec3())
                inertia = scalar(0.4) * mass * radius * radius
                if wp.static(growth):
                    inertia = scalar(0.4) * mass * sphere_offset[i][3] * sphere_offset[i][3]
                write_vec3(sphere_spin, i, spin + torque * (kick / inertia))
                lost += lost_turning
            elif wp.static(zero_forces):
                write_vec3(moment, i, t.vec3())
            if wp.static(losses):
                sphere_lost[i] = sphere_lost[i] + lost
            if wp.static(growth):
                radius = sphere_offset[i][3] * wp.min(scale[s] + scenes[s].growth_rate, scenes[s].growth_end)
            drift = scalar(clock[s, SINCE_BUILD] + clock[s, DT]) * reference_velocity[s]
            if outgrows_lists(
                place,
                radius,
                read_vec4(sphere_built, i),
                drift,
                scenes[s].skin,
                scenes[s].sphere_share,
                wp.static(meshes),
            ):
                flags[s, LATE] = 1
            write_vec4(sphere_position, i, pack(place, radius))
            write_vec4(sphere_velocity, i, pack(velocity, mass))

    return move_spheres


@functools.cache
def publish_kernel(scalar):
    """Kernel over bodies that are all single spheres: bring what bodies hold up to date with their spheres."""
    t = types(scalar)
    xyz = vector_functions(scalar).xyz

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False)
    def publish(
        sphere_position: wp.array(dtype=t.vec4),
        sphere_velocity: wp.array(dtype=t.vec4),
        sphere_spin: wp.array(dtype=t.vec3),
        body_position: wp.array(dtype=t.vec3),
        body_velocity: wp.array(dtype=t.vec3),
        body_spin: wp.array(dtype=t.vec3),
    ):
        i = wp.tid()
        body_position[i] = xyz(sphere_position[i])
        body_velocity[i] = xyz(sphere_velocity[i])
        body_spin[i] = sphere_spin[i]

    return publish


@functools.cache
def clump_kernel(scalar, drives: bool, growth: bool, meshes: bool, zero_forces: bool, losses: bool):
    """Kernel over bodies of one or more spheres: one leapfrog step (Zhan et al. 2019, Eqs. 2-3).

    Velocities live at half steps, positions at full steps; the kick spans from the middle of the step
    before to the middle of this one, so the step size may change on the way. Bodies with three principal
    moments keep their angular momentum in space; the spin is taken at the middle of the turn (a fixed-point
    iteration), which makes the turn time-reversible and its energy error bounded.
    """
    t = types(scalar)
    span = SPAN if zero_forces else 1
    SceneRow = scene_struct(scalar)
    xyz = vector_functions(scalar).xyz
    pack = vector_functions(scalar).pack
    axis = axis_functions(scalar)
    Segment = axis.Segment
    closest_on_axis = axis.closest_on_axis
    turned, spin_of = rotation_functions(scalar)
    motion = motion_functions(scalar, losses)
    damped, moved_on, outgrows_lists = motion.damped, motion.moved_on, motion.outgrows_lists
    rows = row_functions(scalar)
    read_vec3, read_vec4, write_vec3, write_vec4 = rows.read_vec3, rows.read_vec4, rows.write_vec3, rows.write_vec4

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False)
    def move_clumps(
        scenes: wp.array(dtype=SceneRow),
        first: wp.int32,
        last: wp.int32,
        segments: wp.array(dtype=Segment),
        drive_axis: wp.array2d(dtype=wp.int32),
        drive_force: wp.array(dtype=scalar),
        body_scene: wp.array(dtype=wp.int32),
        body_group: wp.array(dtype=wp.int32),
        body_mass: wp.array(dtype=scalar),
        body_inertia: wp.array(dtype=t.vec3),
        body_first: wp.array(dtype=wp.int32),
        sphere_offset: wp.array(dtype=t.vec4),
        sphere_built: wp.array(dtype=t.vec4),
        reference_velocity: wp.array(dtype=t.vec3),
        clock: wp.array2d(dtype=wp.float64),
        flags: wp.array2d(dtype=wp.int32),
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
        begin_b = first + wp.tid() * wp.static(span)
        for b in range(begin_b, wp.min(begin_b + wp.static(span), last)):
            scene = body_scene[b]
            if flags[scene, HALTED] != 0:
                continue
            dt = scalar(clock[scene, DT])
            kick = scalar(0.5) * scalar(clock[scene, DT] + clock[scene, DT_PREVIOUS])
            damping = scenes[scene].local_damping
            x = body_position[b]
            mass = body_mass[b]
            begin = scenes[scene].spheres + body_first[b + scene]
            end = scenes[scene].spheres + body_first[b + scene + 1]

            total = t.vec3()
            torque = t.vec3()
            for s in range(begin, end):
                f = read_vec3(force, s)
                total += f
                torque += read_vec3(moment, s) + wp.cross(xyz(read_vec4(sphere_position, s)) - x, f)
                if wp.static(zero_forces):
                    write_vec3(force, s, t.vec3())
                    write_vec3(moment, s, t.vec3())
            if wp.static(drives):
                group = body_group[b]
                if group > 0:
                    group = scenes[scene].groups + group
                    from_axis, tangent = closest_on_axis(segments, drive_axis[group, 0], drive_axis[group, 1], x)
                    total += drive_force[group] * tangent
            total += mass * scenes[scene].gravity

            velocity = body_velocity[b]
            total, lost = damped(total, velocity, damping, kick)
            velocity += total * (kick / mass)
            if not (wp.length_sq(velocity) <= scenes[scene].speed_limit * scenes[scene].speed_limit):
                if flags[scene, FAILED] == 0:
                    flags[scene, FAILED] = 1 + b - scenes[scene].bodies
                continue
            x, rounding = moved_on(x, dt * velocity, body_rounding[b])
            body_rounding[b] = rounding
            body_position[b] = x
            body_velocity[b] = velocity

            torque, lost_turning = damped(torque, body_spin[b], damping, kick)
            if wp.static(losses):
                sphere_lost[begin] = sphere_lost[begin] + lost + lost_turning
            inertia = body_inertia[b]
            q = body_orientation[b]
            angular_momentum = body_angular_momentum[b] + kick * torque
            spin = spin_of(q, angular_momentum, inertia)
            if inertia[0] != inertia[1] or inertia[1] != inertia[2]:
                for iteration in range(3):
                    spin = spin_of(turned(q, scalar(0.5) * dt * spin), angular_momentum, inertia)
            orientation = wp.normalize(turned(q, dt * spin))
            body_angular_momentum[b] = angular_momentum
            body_orientation[b] = orientation
            body_spin[b] = spin

            size = scalar(1.0)
            if wp.static(growth):
                size = wp.min(scale[scene] + scenes[scene].growth_rate, scenes[scene].growth_end)
            drift = scalar(clock[scene, SINCE_BUILD] + clock[scene, DT]) * reference_velocity[scene]
            for s in range(begin, end):
                offset = read_vec4(sphere_offset, s)
                arm = wp.quat_rotate(orientation, xyz(offset)) * size
                place = x + arm
                carried = velocity + wp.cross(spin, arm)
                radius = offset[3] * size
                if outgrows_lists(
                    place, radius, read_vec4(sphere_built, s), drift, scenes[scene].skin, scenes[scene].sphere_share,
                    wp.static(meshes),
                ):  # fmt: skip
                    flags[scene, LATE] = 1
                write_vec4(sphere_position, s, pack(place, radius))
                write_vec4(sphere_velocity, s, pack(carried, mass))
                write_vec3(sphere_spin, s, spin)

    return move_clumps


@functools.cache
def tick_kernel(scalar, growth: bool):
    """One thread a scene: complete the step (time, step count, growth), and halt the scene where it must wait."""
    SceneRow = scene_struct(scalar)

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False)
    def tick(
        scenes: wp.array(dtype=SceneRow),
        clock: wp.array2d(dtype=wp.float64),
        flags: wp.array2d(dtype=wp.int32),
        scale: wp.array(dtype=scalar),
    ):
        s = wp.tid()
        if flags[s, HALTED] != 0:
            return
        if flags[s, FAILED] != 0:
            flags[s, HALTED] = 1
            return
        dt = clock[s, DT]
        clock[s, TIME] = clock[s, TIME] + dt
        clock[s, DT_PREVIOUS] = dt
        clock[s, SINCE_BUILD] = clock[s, SINCE_BUILD] + dt
        steps = flags[s, STEPS] + 1
        flags[s, STEPS] = steps
        if wp.static(growth):
            scale[s] = wp.min(scale[s] + scenes[s].growth_rate, scenes[s].growth_end)
        if flags[s, LATE] != 0:
            flags[s, LATE] = 0
            flags[s, STALE] = 1
            flags[s, HALTED] = 1
        if steps >= flags[s, GOAL] or flags[s, OVERFLOW] != 0:
            flags[s, HALTED] = 1

    return tick
