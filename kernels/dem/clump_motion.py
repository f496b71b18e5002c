"""Kernel that moves bodies of one or more spheres.

For each body it sums the forces on the body's spheres, makes a leapfrog step, and computes the new sphere positions.
"""

import functools

import warp as wp

from ..common.control import FAILED, HALTED
from ..common.rows import row_functions
from ..common.types import SPAN, types, vector_functions
from .links import result_functions
from .motion import clearing_function, motion_functions, motion_options, placing_function, rotation_functions
from .structs import DT, DT_PREVIOUS, array_structs, links_struct, subcycled_struct
from .warps import warp_functions


@functools.cache
def gather_functions(scalar, dissipation: bool, rows: int, width: int):
    """Return the functions that sum the force [N] and the moment about the centroid [N m] over a body's spheres.

    Both functions clear the spheres' forces for the next step.

    - `gather` is used on a CPU, whose neighbour lists contain most pairs once (half lists).
    - `gather_with_lanes` is used on a GPU, whose lists contain every pair at both spheres (full lists). `lanes` threads
      share a body. This function also returns the energy that the body's contacts lost [J].
    """
    t = types(scalar)
    structs = array_structs(scalar)
    Spheres, Pairs, Links = structs.Spheres, structs.Pairs, links_struct(scalar)
    xyz = vector_functions(scalar).xyz
    each = row_functions(scalar)
    read_vec3, read_vec4 = each.read_vec3, each.read_vec4
    sum_of_links = result_functions(scalar, rows).sum_of_links
    take_half, take_full = clearing_function(scalar, True), clearing_function(scalar, False)
    together = warp_functions(scalar, width)
    any_in_warp, from_lane, energy_from_lane = together.any_in_warp, together.from_lane, together.energy_from_lane
    sync_warp = together.sync_warp

    @wp.func
    def gather(spheres: Spheres, begin: wp.int32, end: wp.int32, x: t.vec3):
        total = t.vec3()
        torque = t.vec3()
        for i in range(begin, end):
            f, m = read_vec3(spheres.force, i), read_vec3(spheres.moment, i)
            total += f
            torque += m + wp.cross(xyz(read_vec4(spheres.position, i)) - x, f)
            take_half(spheres, i, f, m)
        return total, torque

    @wp.func
    def gather_with_lanes(
        spheres: Spheres, pairs: Pairs, links: Links, begin: wp.int32, end: wp.int32, first: wp.int32, lane: wp.int32,
        lanes: wp.int32, row: wp.int32, scene: wp.int32, x: t.vec3,
    ):  # fmt: skip
        """Sum the forces on a body's spheres with `lanes` threads; all threads of a warp must call this together.

        `first` is the lane (thread number in the warp) of the body's first thread. The spheres are always added in the
        same order, so the sums do not depend on the number of lanes.
        """
        total = t.vec3()
        torque = t.vec3()
        lost = wp.float64(0.0)
        place = begin
        while any_in_warp(place < end):
            i = place + lane
            f = t.vec3()
            m = t.vec3()
            taken = wp.float64(0.0)
            if i < end:
                by_links, turned, taken_by_links = sum_of_links(spheres, pairs, links, i, row, i + scene)
                f, m = read_vec3(spheres.force, i), read_vec3(spheres.moment, i)
                take_full(spheres, i, f, m)
                f, m = f + by_links, m + turned
                m = m + wp.cross(xyz(read_vec4(spheres.position, i)) - x, f)
                taken = taken_by_links
            for other in range(lanes):
                total += t.vec3(
                    from_lane(f[0], first + other), from_lane(f[1], first + other), from_lane(f[2], first + other)
                )
                torque += t.vec3(
                    from_lane(m[0], first + other), from_lane(m[1], first + other), from_lane(m[2], first + other)
                )
                if wp.static(dissipation):
                    lost += energy_from_lane(taken, first + other)
            place += lanes
        sync_warp()
        return total, torque, lost

    return gather, gather_with_lanes


@functools.cache
def sphere_motion_function(scalar, growth: bool, meshes: bool, half: bool):
    """Return `move_sphere`, which moves a sphere with its body and checks whether the neighbour lists stay valid."""
    t = types(scalar)
    structs = array_structs(scalar)
    Scenes, Spheres, Links = structs.Scenes, structs.Spheres, links_struct(scalar)
    xyz, pack = vector_functions(scalar).xyz, vector_functions(scalar).pack
    place_sphere = placing_function(scalar, growth, meshes, half)
    rows = row_functions(scalar)
    read_vec4, write_vec4 = rows.read_vec4, rows.write_vec4

    @wp.func
    def move_sphere(
        flags: wp.array2d(dtype=wp.int32), scenes: Scenes, spheres: Spheres, links: Links, s: wp.int32, i: wp.int32,
        x: t.vec3, orientation: t.quat, size: scalar, velocity: t.vec3, spin: t.vec3, mass: scalar, dt: scalar,
    ):  # fmt: skip
        """Set position and velocity of sphere i from the motion of its body.

        The arguments from `x` to `mass` describe the position and motion of the body. `size` is the current scale
        factor of the body's size.
        """
        offset = read_vec4(spheres.offset, i)
        arm = wp.quat_rotate(orientation, xyz(offset)) * size
        speed = velocity + wp.cross(spin, arm)
        place_sphere(flags, scenes, spheres, links, s, i, x + arm, offset[3] * size, dt * speed)
        write_vec4(spheres.velocity, i, pack(speed, mass))
        write_vec4(spheres.spin, i, pack(spin, scalar(0.0)))

    return move_sphere


@functools.cache
def clump_kernel(
    scalar, drives: bool, growth: bool, meshes: bool, half: bool, subcycling: bool, dissipation: bool, rows: int,
    width: int,
) -> wp.Kernel:  # fmt: skip
    """Return the kernel over bodies of one or more spheres that makes one leapfrog step (Zhan et al. 2019, Eqs. 2-3).

    Velocities are known at half steps and positions at full steps. The velocity kick spans from the middle of the
    previous step to the middle of this step, so the step size may vary. Angular momentum is integrated in space axes,
    which conserves it also for bodies with three different principal moments of inertia. The spin is evaluated at the
    middle of the rotation, which makes the rotation time-reversible and bounds its energy error. Bodies with stiff
    bonds move in several rounds per step instead (sub-cycling); for them the kernel only stores the forces.

    On a GPU (full lists), 2^`lane_bits` threads of a warp of `width` share a body. Each thread sums the forces of some
    of the body's spheres, all threads compute the body's motion, and each updates the positions of its spheres. The
    launch consists of whole warps. `rows` is the number of rows in which a link (a pair of spheres) stores its forces.
    The class `Features` in `warpcrete/dem/engine/model.py` explains the flags.
    """
    t = types(scalar)
    structs = array_structs(scalar)
    Scenes, Bodies, Spheres, Pairs = structs.Scenes, structs.Bodies, structs.Spheres, structs.Pairs
    turned, spin_at_middle = rotation_functions(scalar)
    gather, gather_with_lanes = gather_functions(scalar, dissipation, rows, width)
    Links, Subcycled = links_struct(scalar), subcycled_struct(scalar)
    motion, move_sphere = motion_functions(scalar, dissipation), sphere_motion_function(scalar, growth, meshes, half)
    Segment, drive_force_at = motion.Segment, motion.drive_force_at
    damped, new_position = motion.damped, motion.new_position

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False, module_options=motion_options(half))
    def move_clumps(
        # The next arguments are arrays of the model, which are constant during a run.
        segments: wp.array(dtype=Segment), drive_axis: wp.array2d(dtype=wp.int32), drive_force: wp.array(dtype=scalar),
        # The next arguments are the range of bodies of this launch, in which 2^lane_bits threads share a body.
        first: wp.int32, last: wp.int32, lane_bits: wp.int32,
        # The next arguments are arrays of the simulated state that this kernel only reads.
        scenes: Scenes, pairs: Pairs,
        # The next arguments are arrays of the simulated state that this kernel reads and writes.
        flags: wp.array2d(dtype=wp.int32), bodies: Bodies, spheres: Spheres, links: Links, subcycled: Subcycled,
    ):  # fmt: skip
        lanes = 1 << lane_bits
        lane, stride = wp.int32(0), wp.int32(1)
        begin_b, end_b = wp.int32(0), wp.int32(0)
        if wp.static(half):
            begin_b = first + wp.tid() * wp.static(SPAN)
            end_b = wp.min(begin_b + wp.static(SPAN), last)
        else:
            lane, stride = wp.tid() & (lanes - 1), lanes
            begin_b = wp.tid() >> lane_bits
            end_b = begin_b + 1
        for each in range(begin_b, end_b):
            b = wp.min(each, last - 1)
            scene = bodies.scene[b]
            here = each < last and flags[scene, HALTED] == 0
            if wp.static(half):
                if not here:
                    continue
            dt = scalar(scenes.clock[scene, DT])
            kick = scalar(0.5) * scalar(scenes.clock[scene, DT] + scenes.clock[scene, DT_PREVIOUS])
            damping = scenes.row[scene].local_damping
            x = bodies.position[b]
            mass = bodies.mass[b]
            begin = scenes.row[scene].spheres + bodies.first[b + scene]
            end = scenes.row[scene].spheres + bodies.first[b + scene + 1]
            # Read all values before the threads of the warp synchronise, because another thread may overwrite them
            # afterwards.
            velocity = bodies.velocity[b]
            rounding = bodies.rounding[b]
            spin_before = bodies.spin[b]
            q = bodies.orientation[b]
            momentum_before = bodies.angular_momentum[b]

            total, torque = t.vec3(), t.vec3()
            taken = wp.float64(0.0)
            if wp.static(half):
                total, torque = gather(spheres, begin, end, x)
            else:
                total, torque, taken = gather_with_lanes(
                    spheres, pairs, links, begin, wp.where(here, end, begin), wp.tid() % width - lane, lane, lanes,
                    scenes.row[scene].pairs, scene, x,
                )  # fmt: skip
                if not here:
                    continue
                if wp.static(dissipation):
                    if lane == 0:
                        spheres.dissipated_energy[begin] = spheres.dissipated_energy[begin] + taken
            if wp.static(drives):
                group = bodies.group[b]
                if group > 0:
                    total += drive_force_at(segments, drive_axis, drive_force, scenes.row[scene].groups + group, x)
            total += mass * scenes.row[scene].gravity

            if wp.static(subcycling):
                if subcycled.member[b] != 0:
                    if lane == 0:
                        subcycled.other_force[subcycled.member[b] - 1] = total
                        subcycled.other_torque[subcycled.member[b] - 1] = torque
                    continue
            total, lost = damped(total, velocity, damping, kick)
            velocity += total * (kick / mass)
            if not (wp.length_sq(velocity) <= scenes.row[scene].speed_limit * scenes.row[scene].speed_limit):
                wp.atomic_cas(flags, scene, FAILED, 0, 1 + b - scenes.row[scene].bodies)
                continue
            x, rounding = new_position(x, dt * velocity, rounding)
            torque, lost_turning = damped(torque, spin_before, damping, kick)
            angular_momentum = momentum_before + kick * torque
            spin = spin_at_middle(q, angular_momentum, bodies.inertia[b], dt)
            orientation = wp.normalize(turned(q, dt * spin))
            if lane == 0:
                bodies.rounding[b] = rounding
                bodies.position[b] = x
                bodies.velocity[b] = velocity
                bodies.angular_momentum[b] = angular_momentum
                bodies.orientation[b] = orientation
                bodies.spin[b] = spin
                if wp.static(dissipation):
                    spheres.dissipated_energy[begin] = spheres.dissipated_energy[begin] + lost + lost_turning

            size = scalar(1.0)
            if wp.static(growth):
                size = wp.min(scenes.scale[scene] + scenes.row[scene].growth_rate, scenes.row[scene].growth_end)
            for i in range(begin + lane, end, stride):
                move_sphere(flags, scenes, spheres, links, scene, i, x, orientation, size, velocity, spin, mass, dt)

    return move_clumps
