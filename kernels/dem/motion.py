"""Kernels that move bodies of a single sphere, and functions that the kernels for all kinds of bodies share.

The shared functions rotate bodies, compute driving forces and damping, and check whether the neighbour lists are still
valid.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.control import FAILED, HALTED, LATE
from ..common.geometry import axis_functions
from ..common.rows import row_functions
from ..common.types import SPAN, types, vector_functions
from .links import result_functions
from .near import NEAR
from .structs import DT, DT_PREVIOUS, SINCE_BUILD, array_structs, links_struct


def motion_options(half: bool) -> dict:
    """Return the compiler options of a kernel that moves bodies.

    On a GPU, `fast_math` speeds up division, as it does in contact kernels (:func:`contacts.contact_options`). It also
    gives sines an error of 4e-7. Sines are used only for the direction of drive forces in pipe bends.
    """
    return {"fast_math": not half}


@functools.cache
def rotation_functions(scalar):
    """Return the functions `turned` and `spin_at_middle`, which describe the rotation of a body.

    `turned` rotates a quaternion by a rotation vector [rad], and does not normalise the result. `spin_at_middle`
    computes the angular velocity from the angular momentum.
    """
    t = types(scalar)

    @wp.func
    def turned(q: t.quat, rotation: t.vec3):
        a = wp.length_sq(rotation)
        part = scalar(1.0)
        doublings = wp.int32(0)
        # A rotation by more than 0.1 rad is computed for a fraction of the angle, which is the angle halved several
        # times. The result is then squared as many times. On a GPU this takes fewer instructions than sine and cosine.
        while a > scalar(0.01) and doublings < 40:
            a = scalar(0.25) * a
            part = scalar(0.5) * part
            doublings += 1
        # These are Taylor series of sin(x / 2) / x and cos(x / 2) in x^2. Below 0.1 rad they are exact to the last
        # digit of double precision.
        s = scalar(wp.static(1 / 2)) - a * (
            scalar(wp.static(1 / 48)) - a * (scalar(wp.static(1 / 3840)) - a * scalar(wp.static(1 / 645120)))
        )
        c = scalar(1.0) - a * (
            scalar(wp.static(1 / 8))
            - a
            * (scalar(wp.static(1 / 384)) - a * (scalar(wp.static(1 / 46080)) - a * scalar(wp.static(1 / 10321920))))
        )
        s = s * part
        turn = t.quat(s * rotation[0], s * rotation[1], s * rotation[2], c)
        while doublings > 0:
            turn = turn * turn
            doublings -= 1
        return turn * q

    @wp.func
    def spin_of(q: t.quat, angular_momentum: t.vec3, inertia: t.vec3):
        local = wp.quat_rotate_inv(q, angular_momentum)
        return wp.quat_rotate(q, wp.cw_div(local, inertia))

    @wp.func
    def spin_at_middle(q: t.quat, angular_momentum: t.vec3, inertia: t.vec3, dt: scalar):
        """Return the angular velocity in the middle of the step's rotation [rad/s].

        It depends on the orientation at that time, which depends on the angular velocity itself. Three fixed-point
        iterations solve this equation (midpoint rule).
        """
        spin = spin_of(q, angular_momentum, inertia)
        if inertia[0] != inertia[1] or inertia[1] != inertia[2]:
            iteration = wp.int32(0)
            while iteration < 3:  # A `while` loop keeps the compiler from unrolling the iterations.
                spin = spin_of(turned(q, scalar(0.5) * dt * spin), angular_momentum, inertia)
                iteration += 1
        return spin

    return turned, spin_at_middle


@functools.cache
def motion_functions(scalar, dissipation: bool):
    """Return the functions that the kernels for all kinds of bodies share.

    The functions compute the driving force, the local damping and the new positions (with compensated summation). They
    also check whether the neighbour lists are still valid.
    """
    t = types(scalar)
    xyz = vector_functions(scalar).xyz
    Scenes, Links = array_structs(scalar).Scenes, links_struct(scalar)
    read_vec4 = row_functions(scalar).read_vec4
    axis = axis_functions(scalar)
    Segment, closest_on_axis = axis.Segment, axis.closest_on_axis
    single = scalar is wp.float32

    @wp.func
    def drive_force_at(
        segments: wp.array(dtype=Segment),
        drive_axis: wp.array2d(dtype=wp.int32),
        drive_force: wp.array(dtype=scalar),
        group: wp.int32,
        x: t.vec3,
    ):
        """Return the drive force along the pipe's axis on a body of group `group` at position `x`."""
        from_axis, tangent = closest_on_axis(segments, drive_axis[group, 0], drive_axis[group, 1], x)
        return drive_force[group] * tangent

    @wp.func
    def damped(total: t.vec3, velocity: t.vec3, damping: scalar, kick: scalar):
        """Return a force (or moment) with local damping, and the energy that the damping dissipates.

        Local damping changes each component by the fraction `damping` of its magnitude, against the velocity component
        along the same axis.
        """
        lost = wp.float64(0.0)
        if damping > scalar(0.0):
            for c in range(3):
                against = damping * wp.abs(total[c])
                if wp.static(dissipation):
                    lost += wp.float64(against * wp.abs(velocity[c]) * kick)
                total[c] = total[c] - against * wp.sign(velocity[c])
        return total, lost

    @wp.func
    def new_position(x: t.vec3, displacement: t.vec3, rounding: t.vec3):
        """Return the new position of a body and its rounding error (compensated summation).

        The next step adds this rounding error to the displacement. Double precision needs no such correction.
        """
        if wp.static(single):
            displacement = displacement + rounding
            after = x + displacement
            return after, displacement - (after - x)
        return x + displacement, rounding

    @wp.func
    def drift_of(scenes: Scenes, s: wp.int32):
        """Return the displacement common to all spheres of a scene, from the last list rebuild to the step's end [m].

        It is the time since the rebuild times the mean velocity of the scene's spheres at the rebuild.
        """
        return scalar(scenes.clock[s, SINCE_BUILD] + scenes.clock[s, DT]) * scenes.reference_velocity[s]

    @wp.func
    def exceeds_skin(skin: scalar, place: t.vec3, radius: scalar, built: t.vec4, drift: t.vec3):
        """Return True if a sphere has moved so far that a list with the given skin may miss one of its contacts.

        A sphere may move by half the skin, minus the growth of its radius. Its motion is measured relative to `drift`,
        the displacement that all spheres have in common.
        """
        slack = scalar(0.5) * skin - (radius - built[3])
        return wp.length_sq(place - xyz(built) - drift) > slack * slack or slack < scalar(0.0)

    @wp.func
    def exceeds_lists(
        scenes: Scenes, s: wp.int32, place: t.vec3, radius: scalar, built: t.vec4, drift: t.vec3, meshes: bool
    ):
        """Return True if a sphere has moved so far that the pair or mesh lists may miss a contact in the next step."""
        late = exceeds_skin(scenes.row[s].skin, place, radius, built, drift)
        if meshes:
            moved = wp.length(place - xyz(built)) + (radius - built[3])
            late = late or moved > scenes.row[s].sphere_allowance
        return late

    @wp.func
    def watch_near(scenes: Scenes, links: Links, s: wp.int32, i: wp.int32, place: t.vec3, radius: scalar):
        """Set `near_list_exceeded` if the near links (pairs that may touch soon) may miss a contact of sphere `i`."""
        gone = scenes.clock[s, SINCE_BUILD] + scenes.clock[s, DT] - links.near_time[s]
        drift = scalar(gone) * scenes.reference_velocity[s]
        if exceeds_skin(
            scalar(wp.static(NEAR)) * scenes.row[s].skin, place, radius, read_vec4(links.near_position, i), drift
        ):
            links.near_list_exceeded[s] = 1
            links.near_count[1] = 1

    return SimpleNamespace(
        Segment=Segment, drive_force_at=drive_force_at, damped=damped, new_position=new_position, drift_of=drift_of,
        exceeds_lists=exceeds_lists, watch_near=watch_near,
    )  # fmt: skip


@functools.cache
def clearing_function(scalar, half: bool):
    """Return the function `clear_forces`, which sets a sphere's force and moment to zero for the next step.

    On a GPU only wall contacts change the stored force and moment, so the function writes zeros only if they are not
    zero.
    """
    t = types(scalar)
    Spheres = array_structs(scalar).Spheres
    write_vec3 = row_functions(scalar).write_vec3

    @wp.func
    def clear_forces(spheres: Spheres, i: wp.int32, force: t.vec3, moment: t.vec3):
        met = wp.bool(True)
        if wp.static(not half):
            met = wp.length_sq(force) + wp.length_sq(moment) > scalar(0.0)
        if met:
            write_vec3(spheres.force, i, t.vec3())
            write_vec3(spheres.moment, i, t.vec3())

    return clear_forces


@functools.cache
def placing_function(scalar, growth: bool, meshes: bool, half: bool):
    """Return the function `place_sphere`, which stores a sphere's new position and checks the neighbour lists.

    The function sets three flags:

    - LATE, if the neighbour lists may miss a contact in the next step.
    - `near_list_exceeded`, if the near links (listed pairs of spheres that may touch soon) may miss a contact.
    - FAILED, if a sphere moves by more than its radius in one step. It could then pass through another sphere or a
      wall. In a scene with mesh walls, the motion of the fastest mesh wall in one step is added to the motion of the
      sphere. This motion is computed with the wall's final speed even before the wall moves. During growth in packing
      the flag is not set, because spheres start small and overlap anyway.
    """
    t = types(scalar)
    structs = array_structs(scalar)
    Scenes, Spheres, Links = structs.Scenes, structs.Spheres, links_struct(scalar)
    pack = vector_functions(scalar).pack
    motion = motion_functions(scalar, False)
    drift_of, exceeds_lists, watch_near = motion.drift_of, motion.exceeds_lists, motion.watch_near
    rows = row_functions(scalar)
    read_vec4, write_vec4 = rows.read_vec4, rows.write_vec4

    @wp.func
    def place_sphere(
        flags: wp.array2d(dtype=wp.int32), scenes: Scenes, spheres: Spheres, links: Links, s: wp.int32, i: wp.int32,
        place: t.vec3, radius: scalar, way: t.vec3,
    ):  # fmt: skip
        if wp.static(not growth):
            allowed = radius
            if wp.static(meshes):
                if scenes.row[s].held == 0:
                    by_wall = scalar(scenes.clock[s, DT]) * scenes.row[s].mesh_speed
                    allowed = wp.max(radius - by_wall, scalar(0.0))
            if wp.length_sq(way) > allowed * allowed:
                wp.atomic_cas(flags, s, FAILED, 0, 1 + spheres.body[i])
        drift = drift_of(scenes, s)
        if exceeds_lists(scenes, s, place, radius, read_vec4(spheres.built, i), drift, wp.static(meshes)):
            flags[s, LATE] = 1
        if wp.static(not half):
            watch_near(scenes, links, s, i, place, radius)
        write_vec4(spheres.position, i, pack(place, radius))

    return place_sphere


@functools.cache
def sphere_kernel(
    scalar, drives: bool, growth: bool, meshes: bool, rotation: bool, half: bool, dissipation: bool, rows: int
) -> wp.Kernel:
    """Return the kernel that advances bodies of a single sphere by one leapfrog step.

    The step is the same as in `clump_kernel`, but the kernel computes it on the arrays of spheres alone. `sync_kernel`
    updates the arrays of bodies later, when they are needed. With full lists (GPU), the kernel adds up the forces of
    each sphere's links, which are its listed pairs. The forces of a link are stored in `rows` rows. The class
    `Features` in `warpcrete/dem/engine/model.py` explains the flags.
    """
    t = types(scalar)
    span = SPAN if half else 1
    structs = array_structs(scalar)
    Scenes, Bodies, Spheres, Pairs = structs.Scenes, structs.Bodies, structs.Spheres, structs.Pairs
    xyz = vector_functions(scalar).xyz
    pack = vector_functions(scalar).pack
    motion = motion_functions(scalar, dissipation)
    Segment, drive_force_at = motion.Segment, motion.drive_force_at
    damped, new_position = motion.damped, motion.new_position
    place_sphere = placing_function(scalar, growth, meshes, half)
    each = row_functions(scalar)
    read_vec3, read_vec4, write_vec3, write_vec4 = each.read_vec3, each.read_vec4, each.write_vec3, each.write_vec4
    Links = links_struct(scalar)
    sum_of_links = result_functions(scalar, rows).sum_of_links
    clear_forces = clearing_function(scalar, half)

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False, module_options=motion_options(half))
    def move_spheres(
        # The next arguments are arrays of the model, which are constant during a run.
        segments: wp.array(dtype=Segment),
        drive_axis: wp.array2d(dtype=wp.int32),
        drive_force: wp.array(dtype=scalar),
        # The next arguments are the range of spheres that this launch processes.
        first: wp.int32,
        last: wp.int32,
        # The next arguments are arrays of the simulated state that this kernel only reads.
        scenes: Scenes,
        pairs: Pairs,
        # The next arguments are arrays of the simulated state that this kernel reads and writes.
        flags: wp.array2d(dtype=wp.int32),
        bodies: Bodies,
        spheres: Spheres,
        links: Links,
    ):
        begin_i = first + wp.tid() * wp.static(span)
        for i in range(begin_i, wp.min(begin_i + wp.static(span), last)):
            s = spheres.scene[i]
            if flags[s, HALTED] != 0:
                continue
            dt = scalar(scenes.clock[s, DT])
            kick = scalar(0.5) * scalar(scenes.clock[s, DT] + scenes.clock[s, DT_PREVIOUS])
            damping = scenes.row[s].local_damping
            position = read_vec4(spheres.position, i)
            x = xyz(position)
            radius = position[3]
            before = read_vec4(spheres.velocity, i)
            mass = before[3]
            velocity = xyz(before)
            total = read_vec3(spheres.force, i)
            torque = t.vec3()
            if wp.static(rotation):
                torque = read_vec3(spheres.moment, i)
            clear_forces(spheres, i, total, torque)
            by_links = t.vec3()
            if wp.static(not half):
                push, by_links, taken = sum_of_links(spheres, pairs, links, i, scenes.row[s].pairs, i + s)
                total += push
                if wp.static(dissipation):
                    spheres.dissipated_energy[i] = spheres.dissipated_energy[i] + taken
            if wp.static(drives):
                group = bodies.group[i]
                if group > 0:
                    total += drive_force_at(segments, drive_axis, drive_force, scenes.row[s].groups + group, x)
            total += mass * scenes.row[s].gravity
            total, lost = damped(total, velocity, damping, kick)
            velocity += total * (kick / mass)
            if not (wp.length_sq(velocity) <= scenes.row[s].speed_limit * scenes.row[s].speed_limit):
                wp.atomic_cas(flags, s, FAILED, 0, 1 + i - scenes.row[s].spheres)
                continue
            place, rounding = new_position(x, dt * velocity, read_vec3(bodies.rounding, i))
            write_vec3(bodies.rounding, i, rounding)

            if wp.static(rotation):
                spin = xyz(read_vec4(spheres.spin, i))
                torque, lost_turning = damped(torque + by_links, spin, damping, kick)
                inertia = scalar(0.4) * mass * radius * radius
                if wp.static(growth):
                    inertia = scalar(0.4) * mass * spheres.offset[i][3] * spheres.offset[i][3]
                write_vec4(spheres.spin, i, pack(spin + torque * (kick / inertia), scalar(0.0)))
                lost += lost_turning
            if wp.static(dissipation):
                spheres.dissipated_energy[i] = spheres.dissipated_energy[i] + lost
            if wp.static(growth):
                radius = spheres.offset[i][3] * wp.min(
                    scenes.scale[s] + scenes.row[s].growth_rate, scenes.row[s].growth_end
                )
            place_sphere(flags, scenes, spheres, links, s, i, place, radius, dt * velocity)
            write_vec4(spheres.velocity, i, pack(velocity, mass))

    return move_spheres


@functools.cache
def sync_kernel(scalar) -> wp.Kernel:
    """Return the kernel that copies position, velocity and spin of spheres to their single-sphere bodies."""
    structs = array_structs(scalar)
    Bodies, Spheres = structs.Bodies, structs.Spheres
    xyz = vector_functions(scalar).xyz

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False)
    def sync_bodies(spheres: Spheres, bodies: Bodies):
        i = wp.tid()
        bodies.position[i] = xyz(spheres.position[i])
        bodies.velocity[i] = xyz(spheres.velocity[i])
        bodies.spin[i] = xyz(spheres.spin[i])

    return sync_bodies
