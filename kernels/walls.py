"""Contact of spheres with planes and pipe surfaces; how forces on all walls are summed.

Forces on walls are summed in fixed point (int64, `clock[FORCE_SCALE]` units per newton): the same bits in any
order. Contact slots of a sphere: one for each plane or pipe; those for meshes follow.
"""

import functools
from types import SimpleNamespace

import warp as wp

from .contact_law import contact_functions
from .geometry import axis_functions
from .rows import row_functions
from .types import DT_PREVIOUS, FORCE_SCALE, HALTED, SPAN, scene_struct, types, vector_functions
from .wall_motion import FIXED, PLANE, wall_struct

FARTHEST = 1.0e15  # [m]; its square is still a number in single precision
WALL_BITS = wp.constant(31)  # walls of a scene whose touching is kept as a bit; of more, the history is always read


@functools.cache
def wall_force_function(scalar):
    """`add_to_wall`: force and moment, in fixed point, on wall `w` of the whole batch."""
    t = types(scalar)

    @wp.func
    def add_to_wall(
        step_force: wp.array3d(dtype=wp.int64), part: wp.int32, w: wp.int32, f: t.vec3, m: t.vec3, scale: wp.float64
    ):
        for c in range(3):
            wp.atomic_add(step_force, part, w, c, wp.int64(wp.round(wp.float64(f[c]) * scale)))
            wp.atomic_add(step_force, part, w, c + 3, wp.int64(wp.round(wp.float64(m[c]) * scale)))

    return add_to_wall


@functools.cache
def analytic_wall_functions(scalar, law, losses: bool):
    """`analytic_walls`: force, moment about its centre, and lost energy of one sphere on all planes and pipes.

    Most spheres are far from all of those that never move. Each keeps the place where it last looked at them, and how
    far the nearest was; `far_from_walls` tells by this whether it must look again.
    """
    t = types(scalar)
    SceneRow = scene_struct(scalar)
    Wall = wall_struct(scalar)
    axis = axis_functions(scalar)
    Segment = axis.Segment
    closest_on_axis = axis.closest_on_axis
    Parameters = law(scalar).Parameters
    contact_force = law(scalar).force
    contact_energy = law(scalar).energy
    wall_touch = contact_functions(scalar).wall_touch
    xyz = vector_functions(scalar).xyz
    pack = vector_functions(scalar).pack
    write_vec4 = row_functions(scalar).write_vec4
    safe_normalize = vector_functions(scalar).safe_normalize
    add_to_wall = wall_force_function(scalar)

    @wp.func
    def far_from_walls(position: t.vec4, clear: t.vec4):
        """Is a sphere beyond the reach of every fixed wall, by where it was when it last came to look at them?"""
        room = clear[3] - position[3]
        return room > scalar(0.0) and wp.length_sq(xyz(position) - xyz(clear)) < room * room

    @wp.func
    def analytic_walls(
        i: wp.int32,
        scene: SceneRow,
        far: wp.bool,
        part: wp.int32,
        dt: scalar,
        position: t.vec4,
        velocity: t.vec4,
        spin: t.vec3,
        material: wp.int32,
        parameters: wp.array(dtype=Parameters),
        walls: wp.array(dtype=Wall),
        segments: wp.array(dtype=Segment),
        wall_position: wp.array(dtype=t.vec3),
        wall_normal: wp.array(dtype=t.vec3),
        wall_velocity: wp.array(dtype=t.vec3),
        wall_spin: wp.array(dtype=t.vec3),
        scale: wp.float64,
        sphere_clear: wp.array(dtype=t.vec4),
        slot_touching: wp.array(dtype=wp.int32),
        slot_history: wp.array2d(dtype=t.vec3),
        step_force: wp.array3d(dtype=wp.int64),
    ):
        x = xyz(position)
        radius = position[3]
        total_force = t.vec3()
        total_moment = t.vec3()
        total_lost = wp.float64(0.0)
        nearest = scalar(wp.static(FARTHEST))
        row = scene.laws + material * scene.materials
        before = slot_touching[i]
        now = wp.int32(0)
        for slot in range(scene.analytic):
            w = scene.walls + slot
            if far and walls[w].motion == FIXED:
                continue
            gap = scalar(0.0)
            n = t.vec3()  # from the sphere into the wall
            if walls[w].kind == PLANE:
                n = -wall_normal[w]
                gap = wp.dot(wall_position[w] - x, n) - radius
            else:
                offset, tangent = closest_on_axis(segments, walls[w].first, walls[w].last, x - wall_position[w])
                length = wp.length(offset)
                gap = walls[w].radius - length - radius
                if gap < scalar(0.0):
                    n = safe_normalize(offset, t.vec3(scalar(0.0), scalar(0.0), scalar(1.0)))
            if walls[w].motion == FIXED:
                nearest = wp.min(nearest, gap + radius)
            if gap < scalar(0.0):
                arm = radius + gap
                point = x + arm * n
                surface = wall_velocity[w] + wp.cross(wall_spin[w], point - wall_position[w])
                relative = surface - xyz(velocity) - wp.cross(spin, arm * n)
                twist = scalar(0.5) * dt * wp.dot(spin + wall_spin[w], n)
                touch = wall_touch(n, gap, relative, twist, radius, velocity[3])
                f, new_history, lost = contact_force(
                    parameters[row + walls[w].material], touch, slot_history[i, slot], dt
                )
                slot_history[i, slot] = new_history
                if slot < WALL_BITS:
                    now = now | (1 << slot)
                total_lost += wp.float64(lost)
                total_force += f
                total_moment += wp.cross(arm * n, f)
                add_to_wall(step_force, part, w, -f, wp.cross(point - wall_position[w], -f), scale)
            elif slot >= WALL_BITS or ((before >> slot) & 1) != 0:
                if wp.static(losses):
                    touch = wall_touch(t.vec3(), scalar(0.0), t.vec3(), scalar(0.0), radius, velocity[3])
                    p = parameters[row + walls[w].material]
                    total_lost += wp.float64(contact_energy(p, touch, slot_history[i, slot]))
                slot_history[i, slot] = t.vec3()
        if now != before:
            slot_touching[i] = now
        if not far:
            write_vec4(sphere_clear, i, pack(x, scalar(0.99) * nearest))  # the rest is room for rounding
        return total_force, total_moment, total_lost

    return SimpleNamespace(Segment=Segment, far_from_walls=far_from_walls, analytic_walls=analytic_walls)


@functools.cache
def wall_kernel(scalar, law, losses: bool):
    """Kernel over spheres: adds the forces of planes and pipes, where the contact kernel does not do that, too.

    On a CPU two kernels are faster: clang inlines a law that a kernel calls once, not one that it calls twice.
    """
    t = types(scalar)
    SceneRow = scene_struct(scalar)
    Wall = wall_struct(scalar)
    Parameters = law(scalar).Parameters
    analytic = analytic_wall_functions(scalar, law, losses)
    Segment = analytic.Segment
    far_from_walls, analytic_walls = analytic.far_from_walls, analytic.analytic_walls
    read_vec4 = row_functions(scalar).read_vec4

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False)
    def wall_contacts(
        scenes: wp.array(dtype=SceneRow),
        first: wp.int32,
        last: wp.int32,
        part: wp.int32,
        parameters: wp.array(dtype=Parameters),
        walls: wp.array(dtype=Wall),
        segments: wp.array(dtype=Segment),
        wall_position: wp.array(dtype=t.vec3),
        wall_normal: wp.array(dtype=t.vec3),
        wall_velocity: wp.array(dtype=t.vec3),
        wall_spin: wp.array(dtype=t.vec3),
        sphere_scene: wp.array(dtype=wp.int32),
        sphere_position: wp.array(dtype=t.vec4),
        sphere_velocity: wp.array(dtype=t.vec4),
        sphere_spin: wp.array(dtype=t.vec3),
        sphere_material: wp.array(dtype=wp.int32),
        clock: wp.array2d(dtype=wp.float64),
        flags: wp.array2d(dtype=wp.int32),
        sphere_clear: wp.array(dtype=t.vec4),
        slot_touching: wp.array(dtype=wp.int32),
        slot_history: wp.array2d(dtype=t.vec3),
        force: wp.array(dtype=t.vec3),
        moment: wp.array(dtype=t.vec3),
        step_force: wp.array3d(dtype=wp.int64),
        sphere_lost: wp.array(dtype=wp.float64),
    ):
        begin_i = first + wp.tid() * wp.static(SPAN)
        for i in range(begin_i, wp.min(begin_i + wp.static(SPAN), last)):
            s = sphere_scene[i]
            if flags[s, HALTED] != 0:
                continue
            position = read_vec4(sphere_position, i)
            far = far_from_walls(position, read_vec4(sphere_clear, i))
            if far and scenes[s].still != 0:
                continue
            wall_force, wall_moment, lost = analytic_walls(
                i, scenes[s], far, part, scalar(clock[s, DT_PREVIOUS]), position, sphere_velocity[i], sphere_spin[i],
                sphere_material[i], parameters, walls, segments, wall_position, wall_normal, wall_velocity, wall_spin,
                clock[s, FORCE_SCALE], sphere_clear, slot_touching, slot_history, step_force,
            )  # fmt: skip
            force[i] = force[i] + wall_force
            moment[i] = moment[i] + wall_moment
            if wp.static(losses):
                sphere_lost[i] = sphere_lost[i] + lost

    return wall_contacts
