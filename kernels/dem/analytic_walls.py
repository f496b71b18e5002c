"""Contact of spheres with planes and pipe surfaces; how forces on all walls are summed.

Forces on walls are summed in fixed point (int64, `clock[FORCE_SCALE]` units per newton): the same bits in any
order. Contact slots of a sphere: one for each plane or pipe; those for meshes follow.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.control import HALTED
from ..common.rows import row_functions
from ..common.types import SPAN, types, vector_functions
from ..common.walls import FIXED, wall_functions
from .contact_law import contact_functions
from .structs import DT_PREVIOUS, FORCE_SCALE, array_structs, scene_struct
from .wear import wear_functions

FARTHEST = 1.0e15  # [m]; its square is still a number in single precision
WALL_BITS = wp.constant(31)  # walls of a scene whose touching is kept as a bit; of more, the history is always read
COMMON_WALL = """
#if defined(__CUDA_ARCH__)
    const unsigned touching = __ballot_sync(0xffffffffu, touches);
    if (touching == 0) return 0;
    const int first = __shfl_sync(0xffffffffu, w, __ffs(touching) - 1);
    return __all_sync(0xffffffffu, !touches || w == first) ? first + 1 : -1;
#else
    return touches ? -1 : 0;
#endif
"""
WARP_TOTAL = """
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 800
    // In three parts, of which 32 add up to less than 32 bits: one instruction adds up each.
    const unsigned low = value & 0x3fffff, middle = (value >> 22) & 0x3fffff;
    const int high = (int)(value >> 44);
    return ((long long)(__reduce_add_sync(0xffffffffu, high)) * (1LL << 44)
            + ((long long)(__reduce_add_sync(0xffffffffu, middle)) << 22)
            + (long long)(__reduce_add_sync(0xffffffffu, low)));
#elif defined(__CUDA_ARCH__)
    for (int away = 16; away > 0; away /= 2) value += __shfl_xor_sync(0xffffffffu, value, away);
    return value;
#else
    return value;
#endif
"""


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
def warp_force_function(scalar):
    """`add_together`: the same for all threads of a warp, of which some touch: first among themselves, then once.

    All spheres that touch a wall add to the same six numbers; one by one they take most of a small step.
    """
    t = types(scalar)
    add_to_wall = wall_force_function(scalar)

    @wp.func_native(COMMON_WALL)
    def common_wall(touches: wp.bool, w: wp.int32) -> wp.int32: ...  # 1 more than the wall of all, 0: none, -1: several

    @wp.func_native(WARP_TOTAL)
    def warp_total(value: wp.int64) -> wp.int64: ...

    @wp.func
    def add_together(
        step_force: wp.array3d(dtype=wp.int64), touches: wp.bool, lane: wp.int32, w: wp.int32, f: t.vec3, m: t.vec3,
        scale: wp.float64,
    ):  # fmt: skip
        """All threads of a warp must call; f and m are 0 where nothing touches."""
        common = common_wall(touches, w)
        if common > 0:
            for c in range(3):
                force = warp_total(wp.int64(wp.round(wp.float64(f[c]) * scale)))
                moment = warp_total(wp.int64(wp.round(wp.float64(m[c]) * scale)))
                if lane == 0:
                    wp.atomic_add(step_force, 0, common - 1, c, force)
                    wp.atomic_add(step_force, 0, common - 1, c + 3, moment)
        elif touches:
            add_to_wall(step_force, 0, w, f, m, scale)

    return add_together


@functools.cache
def surface_touch_function(scalar):
    """`surface_touch`: the touch of a sphere with a wall `gap` away along `n`, and the point where it is."""
    t = types(scalar)
    wall_touch = contact_functions(scalar).wall_touch
    xyz = vector_functions(scalar).xyz

    @wp.func
    def surface_touch(
        position: t.vec3,
        wall_velocity: t.vec3,
        wall_spin: t.vec3,
        n: t.vec3,
        gap: scalar,
        x: t.vec3,
        radius: scalar,
        velocity: t.vec4,
        spin: t.vec3,
        dt: scalar,
    ):
        arm = radius + gap
        point = x + arm * n
        surface = wall_velocity + wp.cross(wall_spin, point - position)
        relative = surface - xyz(velocity) - wp.cross(spin, arm * n)
        twist = scalar(0.5) * dt * wp.dot(spin + wall_spin, n)
        return wall_touch(n, gap, relative, twist, radius, velocity[3]), point

    return surface_touch


@functools.cache
def analytic_wall_functions(scalar, law, half: bool, dissipation: bool, wear: bool):
    """`on_walls`: force, moment about its centre, and lost energy of one sphere on all planes and pipes. On a GPU all
    threads of a warp must call; one that has nothing to look at says that it is not `here`.

    Most spheres are far from all of those that never move. Each keeps the place where it last looked at them, and how
    far the nearest was; `far_from_walls` tells by this whether it must look again.
    """
    t = types(scalar)
    SceneRow = scene_struct(scalar)
    structs = array_structs(scalar)
    Spheres, Slots, Walls = structs.Spheres, structs.Slots, structs.Walls
    shape = wall_functions(scalar)
    Segment, distance_to_wall, into_wall = shape.Segment, shape.distance_to_wall, shape.into_wall
    functions = law.functions(scalar)
    Parameters, contact_force, contact_energy = functions.Parameters, functions.force, functions.energy
    rolls, contact_moment = law.rolls, functions.moment if law.rolls else None
    moment_energy = functions.moment_energy if rolls else None
    wall_touch = contact_functions(scalar).wall_touch
    surface_touch = surface_touch_function(scalar)
    worn_by, in_frame = wear_functions(scalar, law).worn_by, wear_functions(scalar, law).in_frame
    xyz = vector_functions(scalar).xyz
    pack = vector_functions(scalar).pack
    write_vec4 = row_functions(scalar).write_vec4
    add_to_wall, add_together = wall_force_function(scalar), warp_force_function(scalar)

    @wp.func
    def far_from_walls(position: t.vec4, clear: t.vec4):
        """Is a sphere beyond the reach of every fixed wall, by where it was when it last came to look at them?"""
        room = clear[3] - position[3]
        return room > scalar(0.0) and wp.length_sq(xyz(position) - xyz(clear)) < room * room

    @wp.func
    def on_walls(
        i: wp.int32,
        scene: SceneRow,
        here: wp.bool,
        far: wp.bool,
        part: wp.int32,
        dt: scalar,
        scale: wp.float64,
        parameters: wp.array(dtype=Parameters),
        segments: wp.array(dtype=Segment),
        spheres: Spheres,
        slots: Slots,
        walls: Walls,
    ):
        x = xyz(spheres.position[i])
        radius = spheres.position[i][3]
        velocity = spheres.velocity[i]
        total_force = t.vec3()
        total_moment = t.vec3()
        total_lost = wp.float64(0.0)
        nearest = scalar(wp.static(FARTHEST))
        row = scene.laws + spheres.material[i] * scene.materials
        before = slots.touching[i]
        now = wp.int32(0)
        for slot in range(scene.analytic):
            w = scene.walls + slot
            touches = wp.bool(False)
            f = t.vec3()
            m = t.vec3()
            if here and not (far and walls.table[w].motion == FIXED):
                distance, direction = distance_to_wall(walls.table[w], segments, walls.position[w], walls.normal[w], x)
                gap = distance - radius
                if walls.table[w].motion == FIXED:
                    nearest = wp.min(nearest, gap + radius)
                if gap < scalar(0.0):
                    touches = wp.bool(True)
                    n = into_wall(walls.table[w], direction)  # from the sphere into the wall
                    touch, point = surface_touch(
                        walls.position[w], walls.velocity[w], walls.spin[w], n, gap, x, radius, velocity,
                        xyz(spheres.spin[i]), dt,
                    )  # fmt: skip
                    p = parameters[row + walls.table[w].material]
                    f, new_history, lost = contact_force(p, touch, slots.history[i, slot], dt)
                    slots.history[i, slot] = new_history
                    if slot < WALL_BITS:
                        now = now | (1 << slot)
                    total_lost += wp.float64(lost)
                    total_force += f
                    total_moment += wp.cross((radius + gap) * n, f)
                    m = wp.cross(point - walls.position[w], -f)
                    if wp.static(wear):
                        slots.worn[i, slot] = slots.worn[i, slot] + worn_by(p, touch, f, lost, dt)
                        slots.worn_at[i, slot] = in_frame(point, walls.position[w], walls.orientation[w])
                    if wp.static(rolls):
                        turning = walls.spin[w] - xyz(spheres.spin[i])
                        held_back, rolled, lost = contact_moment(p, touch, turning, slots.rolling[i, slot], dt)
                        slots.rolling[i, slot] = rolled
                        total_lost += wp.float64(lost)
                        total_moment += held_back
                        m = m - held_back
                elif slot >= WALL_BITS or ((before >> slot) & 1) != 0:
                    if wp.static(dissipation):
                        touch = wall_touch(t.vec3(), scalar(0.0), t.vec3(), scalar(0.0), radius, velocity[3])
                        p = parameters[row + walls.table[w].material]
                        total_lost += wp.float64(contact_energy(p, touch, slots.history[i, slot]))
                        if wp.static(rolls):
                            total_lost += wp.float64(moment_energy(p, touch, slots.rolling[i, slot]))
                    slots.history[i, slot] = t.vec3()
                    if wp.static(rolls):
                        slots.rolling[i, slot] = t.vec3()
            if wp.static(half):
                if touches:
                    add_to_wall(walls.step_force, part, w, -f, m, scale)
            else:
                add_together(walls.step_force, touches, part, w, -f, m, scale)
        if here and now != before:
            slots.touching[i] = now
        if here and not far:
            write_vec4(spheres.clear, i, pack(x, scalar(0.99) * nearest))  # the rest is room for rounding
        return total_force, total_moment, total_lost

    return SimpleNamespace(Segment=Segment, far_from_walls=far_from_walls, on_walls=on_walls)


@functools.cache
def wall_kernel(scalar, law, dissipation: bool, wear: bool):
    """Kernel over spheres of half lists: adds the forces of planes and pipes.

    Two kernels are faster than one with the contacts: clang inlines a law that a kernel calls once, not one that it
    calls twice.
    """
    structs = array_structs(scalar)
    Scenes, Spheres, Slots, Walls = structs.Scenes, structs.Spheres, structs.Slots, structs.Walls
    Parameters = law.functions(scalar).Parameters
    analytic = analytic_wall_functions(scalar, law, True, dissipation, wear)
    Segment, far_from_walls, on_walls = analytic.Segment, analytic.far_from_walls, analytic.on_walls
    read_vec4 = row_functions(scalar).read_vec4

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False)
    def wall_contacts(
        # model
        wall_parameters: wp.array(dtype=Parameters),
        segments: wp.array(dtype=Segment),
        # chunk
        first: wp.int32,
        last: wp.int32,
        part: wp.int32,
        # state, read
        flags: wp.array2d(dtype=wp.int32),
        scenes: Scenes,
        # state, read and written
        spheres: Spheres,
        slots: Slots,
        walls: Walls,
    ):
        begin_i = first + wp.tid() * SPAN
        for i in range(begin_i, wp.min(begin_i + SPAN, last)):
            s = spheres.scene[i]
            if flags[s, HALTED] != 0:
                continue
            far = far_from_walls(read_vec4(spheres.position, i), read_vec4(spheres.clear, i))
            if far and scenes.row[s].still != 0:
                continue
            wall_force, wall_moment, lost = on_walls(
                i, scenes.row[s], wp.bool(True), far, part, scalar(scenes.clock[s, DT_PREVIOUS]),
                scenes.clock[s, FORCE_SCALE], wall_parameters, segments, spheres, slots, walls,
            )  # fmt: skip
            spheres.force[i] = spheres.force[i] + wall_force
            spheres.moment[i] = spheres.moment[i] + wall_moment
            if wp.static(dissipation):
                spheres.dissipated_energy[i] = spheres.dissipated_energy[i] + lost

    return wall_contacts
