"""Contact of spheres with planes and pipe surfaces, and the summation of forces on all walls.

Forces on walls are rounded to a fixed fraction of a newton and summed as 64-bit integers, so the order of the summation
cannot change the result. Each sphere has storage places, called slots, for the histories of its wall contacts: one slot
for each plane or pipe of the scene, then some slots for triangle meshes.
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
from .warps import warp_functions
from .wear import wear_functions

# Distance [m] larger than any distance from a wall. The square of this number still fits into single precision.
FARTHEST = 1.0e15
# Each sphere has a bit mask that marks the planes and pipes it touched in the last step. WALL_BITS is the number of
# bits, for the walls with the lowest indices. Walls with higher indices have no bit, so every step must read the
# contact history of these walls.
WALL_BITS: int = wp.constant(31)
LEADER = """
#if defined(__CUDA_ARCH__)
    unsigned column = 0;
    for (int at = threadIdx.x & (lanes - 1); at < 32; at += lanes) column |= 1u << at;
    const unsigned touching = __ballot_sync(0xffffffffu, touches) & column;
    const int first = touching == 0 ? 0 : __ffs(touching) - 1;
    const int common = __shfl_sync(0xffffffffu, w, first);
    const bool same = (__ballot_sync(0xffffffffu, touches && w != common) & column) == 0;
    return touching == 0 ? 32 : same ? first : -1;
#else
    return touches ? 0 : 32;
#endif
"""
WARP_TOTAL = """
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 800
    if (lanes > 1) {
        for (int away = 16; away >= lanes; away /= 2) value += __shfl_xor_sync(0xffffffffu, value, away);
        return value;
    }
    // Split the value into three parts, such that the sum of 32 parts fits into 32 bits. One instruction then adds up
    // each part over the warp.
    const unsigned low = value & 0x3fffff, middle = (value >> 22) & 0x3fffff;
    const int high = (int)(value >> 44);
    return ((long long)(__reduce_add_sync(0xffffffffu, high)) * (1LL << 44)
            + ((long long)(__reduce_add_sync(0xffffffffu, middle)) << 22)
            + (long long)(__reduce_add_sync(0xffffffffu, low)));
#elif defined(__CUDA_ARCH__)
    for (int away = 16; away >= lanes; away /= 2) value += __shfl_xor_sync(0xffffffffu, value, away);
    return value;
#else
    return value;
#endif
"""


@functools.cache
def wall_force_function(scalar):
    """Return the function `add_to_wall`, which adds a force and a moment, as integers, to the wall with index `w`."""
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
    """Return the function `add_together`, which adds the wall forces of all threads of a warp with few atomics.

    Many spheres touch the same wall. One atomic addition per sphere would take most of the time of a small step. The
    threads of a warp therefore first sum their forces, and then one thread adds the sum to the wall. If `lanes`
    adjacent threads share a sphere, each of them handles different walls. Only threads whose numbers differ by a
    multiple of `lanes` therefore sum their forces with each other.
    """
    t = types(scalar)
    add_to_wall = wall_force_function(scalar)

    @wp.func_native(LEADER)
    # `leader` returns the number of the first thread of a warp whose sphere touches a wall. It returns 32 if no sphere
    # touches a wall, and -1 if spheres touch different walls. If `lanes` threads share a sphere, the function considers
    # only threads whose numbers differ from the caller's number by a multiple of `lanes`.
    def leader(touches: wp.bool, w: wp.int32, lanes: wp.int32) -> wp.int32: ...

    @wp.func_native(WARP_TOTAL)
    def warp_total(value: wp.int64, lanes: wp.int32) -> wp.int64: ...

    @wp.func
    def add_together(
        step_force: wp.array3d(dtype=wp.int64), touches: wp.bool, thread: wp.int32, lanes: wp.int32, w: wp.int32,
        f: t.vec3, m: t.vec3, scale: wp.float64,
    ):  # fmt: skip
        """Add the forces `f` and moments `m` of the threads of a GPU warp to the walls that their spheres touch.

        All threads of the warp must call this function together. A thread whose sphere touches no wall must pass `f`
        and `m` as zero.
        """
        first = leader(touches, w, lanes)
        for c in range(3):
            force = warp_total(wp.int64(wp.round(wp.float64(f[c]) * scale)), lanes)
            moment = warp_total(wp.int64(wp.round(wp.float64(m[c]) * scale)), lanes)
            if thread == first:
                wp.atomic_add(step_force, 0, w, c, force)
                wp.atomic_add(step_force, 0, w, c + 3, moment)
        if first < 0 and touches:
            add_to_wall(step_force, 0, w, f, m, scale)

    return add_together


@functools.cache
def surface_touch_function(scalar):
    """Return `surface_touch`, which computes the contact geometry of a sphere at the distance `gap` from a wall."""
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
def contact_function(scalar, law, dissipation: bool, wear: bool):
    """Return the function `wall_contact_of`, which evaluates the contact of a sphere with one plane or pipe.

    The result is the distance to the surface, True if sphere and wall touch, the force and moment on the sphere, the
    moment on the wall, and the energy lost. The function also updates the contact history.
    """
    t = types(scalar)
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
    contact_wear, in_frame = wear_functions(scalar, law).contact_wear, wear_functions(scalar, law).in_frame
    xyz = vector_functions(scalar).xyz

    @wp.func
    def wall_contact_of(
        i: wp.int32, slot: wp.int32, w: wp.int32, row: wp.int32, remembers: wp.bool, dt: scalar,
        parameters: wp.array(dtype=Parameters), segments: wp.array(dtype=Segment), spheres: Spheres, slots: Slots,
        walls: Walls,
    ):  # fmt: skip
        x, radius = xyz(spheres.position[i]), spheres.position[i][3]
        velocity, spin = spheres.velocity[i], xyz(spheres.spin[i])
        touches = wp.bool(False)
        f = t.vec3()
        moment = t.vec3()
        m = t.vec3()
        lost = wp.float64(0.0)
        distance, direction = distance_to_wall(walls.table[w], segments, walls.position[w], walls.normal[w], x)
        gap = distance - radius
        if gap < scalar(0.0):
            touches = wp.bool(True)
            n = into_wall(walls.table[w], direction)  # Normal vector that points from the sphere into the wall.
            touch, point = surface_touch(
                walls.position[w], walls.velocity[w], walls.spin[w], n, gap, x, radius, velocity, spin, dt
            )  # fmt: skip
            p = parameters[row + walls.table[w].material]
            f, new_history, slid = contact_force(p, touch, slots.history[i, slot], dt)
            slots.history[i, slot] = new_history
            lost = wp.float64(slid)
            moment = wp.cross((radius + gap) * n, f)
            m = wp.cross(point - walls.position[w], -f)
            if wp.static(wear):
                slots.worn[i, slot] = slots.worn[i, slot] + contact_wear(p, touch, f, slid, dt)
                slots.worn_at[i, slot] = in_frame(point, walls.position[w], walls.orientation[w])
            if wp.static(rolls):
                turning = walls.spin[w] - spin
                held_back, rolled, rolling_lost = contact_moment(p, touch, turning, slots.rolling[i, slot], dt)
                slots.rolling[i, slot] = rolled
                lost += wp.float64(rolling_lost)
                moment += held_back
                m = m - held_back
        elif remembers:
            if wp.static(dissipation):
                touch = wall_touch(t.vec3(), scalar(0.0), t.vec3(), scalar(0.0), radius, velocity[3])
                p = parameters[row + walls.table[w].material]
                lost = wp.float64(contact_energy(p, touch, slots.history[i, slot]))
                if wp.static(rolls):
                    lost += wp.float64(moment_energy(p, touch, slots.rolling[i, slot]))
            slots.history[i, slot] = t.vec3()
            if wp.static(rolls):
                slots.rolling[i, slot] = t.vec3()
        return distance, touches, f, moment, m, lost

    return wall_contact_of


@functools.cache
def analytic_wall_functions(scalar, law, half: bool, dissipation: bool, wear: bool, width: int = 1):
    """Return the functions `on_walls` and `far_from_walls` for contacts with planes and pipes.

    `on_walls` computes the contacts of one sphere with all planes and pipes. It returns the sum of the forces on the
    sphere, the sum of the moments about its centre, and the energy lost. On a GPU, `lanes` adjacent threads share a
    sphere and divide its walls among them; their results are added up in the order of the walls. All threads of a warp
    of `width` must call `on_walls`; a thread without a sphere passes False for `here`.

    Most spheres are far from all fixed walls. Each sphere stores its position at the last measurement of its distance
    to the nearest fixed wall, and the measured distance. `far_from_walls` uses this position and distance to decide if
    the sphere can skip the fixed walls.
    """
    t = types(scalar)
    SceneRow = scene_struct(scalar)
    structs = array_structs(scalar)
    Spheres, Slots, Walls = structs.Spheres, structs.Slots, structs.Walls
    Segment, Parameters = wall_functions(scalar).Segment, law.functions(scalar).Parameters
    wall_contact_of = contact_function(scalar, law, dissipation, wear)
    xyz = vector_functions(scalar).xyz
    pack = vector_functions(scalar).pack
    write_vec4 = row_functions(scalar).write_vec4
    add_to_wall, add_together = wall_force_function(scalar), warp_force_function(scalar)
    together = warp_functions(scalar, width)
    any_in_warp, from_lane, energy_from_lane = together.any_in_warp, together.from_lane, together.energy_from_lane
    bits_of_lanes, least_of_lanes = together.bits_of_lanes, together.least_of_lanes

    @wp.func
    def far_from_walls(position: t.vec4, clear: t.vec4):
        """Return True if a sphere is certainly out of contact with all fixed walls.

        `clear` holds the sphere's centre at the last measurement of its distance from the nearest fixed wall, and this
        distance [m]. The sphere touches no fixed wall if it has since moved by less than the distance minus its radius.
        """
        room = clear[3] - position[3]
        return room > scalar(0.0) and wp.length_sq(xyz(position) - xyz(clear)) < room * room

    @wp.func
    def on_walls(
        i: wp.int32,
        scene: SceneRow,
        here: wp.bool,
        far: wp.bool,
        part: wp.int32,
        lanes: wp.int32,
        dt: scalar,
        scale: wp.float64,
        parameters: wp.array(dtype=Parameters),
        segments: wp.array(dtype=Segment),
        spheres: Spheres,
        slots: Slots,
        walls: Walls,
    ):
        x = xyz(spheres.position[i])
        total_force = t.vec3()
        total_moment = t.vec3()
        total_lost = wp.float64(0.0)
        nearest = scalar(wp.static(FARTHEST))
        row = scene.laws + spheres.material[i] * scene.materials
        before = slots.touching[i]
        now = wp.int32(0)
        lane = part & (lanes - 1)
        if wp.static(half):
            lane = wp.int32(0)
        for place in range(0, scene.analytic, lanes):
            slot = place + lane
            w = scene.walls + wp.min(slot, scene.analytic - 1)
            touches = wp.bool(False)
            f = t.vec3()
            moment = t.vec3()
            m = t.vec3()
            lost = wp.float64(0.0)
            if here and slot < scene.analytic and not (far and walls.table[w].motion == FIXED):
                remembers = slot >= WALL_BITS or ((before >> slot) & 1) != 0
                distance, touches, f, moment, m, lost = wall_contact_of(
                    i, slot, w, row, remembers, dt, parameters, segments, spheres, slots, walls
                )
                if walls.table[w].motion == FIXED:
                    nearest = wp.min(nearest, distance)
                if touches and slot < WALL_BITS:
                    now = now | (1 << slot)
            if wp.static(half):
                total_force += f
                total_moment += moment
                total_lost += lost
                if touches:
                    add_to_wall(walls.step_force, part, w, -f, m, scale)
            else:
                if any_in_warp(touches):
                    add_together(walls.step_force, touches, part, lanes, w, -f, m, scale)
                    for other in range(part - lane, part - lane + lanes):
                        total_force += t.vec3(from_lane(f[0], other), from_lane(f[1], other), from_lane(f[2], other))
                        total_moment += t.vec3(
                            from_lane(moment[0], other), from_lane(moment[1], other), from_lane(moment[2], other)
                        )
                if wp.static(dissipation):
                    for other in range(part - lane, part - lane + lanes):
                        total_lost += energy_from_lane(lost, other)
        if wp.static(not half):
            now = bits_of_lanes(now, lanes)
            nearest = least_of_lanes(nearest, lanes)
            here = here and lane == 0
        if here and now != before:
            slots.touching[i] = now
        if here and not far:
            # Store only 99 % of the distance from the nearest fixed wall, to cover rounding errors.
            write_vec4(spheres.clear, i, pack(x, scalar(0.99) * nearest))
        return total_force, total_moment, total_lost

    return SimpleNamespace(Segment=Segment, far_from_walls=far_from_walls, on_walls=on_walls)


@functools.cache
def wall_kernel(scalar, law, dissipation: bool, wear: bool) -> wp.Kernel:
    """Return the CPU kernel that adds the forces of planes and pipes to the spheres.

    Two separate kernels, for walls and for contacts between spheres, are faster than a joint kernel: clang inlines a
    contact law that a kernel calls once, but not a law that it calls twice.
    """
    structs = array_structs(scalar)
    Scenes, Spheres, Slots, Walls = structs.Scenes, structs.Spheres, structs.Slots, structs.Walls
    Parameters = law.functions(scalar).Parameters
    analytic = analytic_wall_functions(scalar, law, True, dissipation, wear)
    Segment, far_from_walls, on_walls = analytic.Segment, analytic.far_from_walls, analytic.on_walls
    read_vec4 = row_functions(scalar).read_vec4

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False)
    def wall_contacts(
        # The next arguments are arrays of the model, which are constant during a run.
        wall_parameters: wp.array(dtype=Parameters),
        segments: wp.array(dtype=Segment),
        # The next arguments are the range of spheres that this launch processes, and the index of the CPU thread.
        first: wp.int32,
        last: wp.int32,
        part: wp.int32,
        # The next arguments are arrays of the simulated state that this kernel only reads.
        flags: wp.array2d(dtype=wp.int32),
        scenes: Scenes,
        # The next arguments are arrays of the simulated state that this kernel reads and writes.
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
            if far and scenes.row[s].walls_fixed != 0:
                continue
            wall_force, wall_moment, lost = on_walls(
                i, scenes.row[s], wp.bool(True), far, part, 1, scalar(scenes.clock[s, DT_PREVIOUS]),
                scenes.clock[s, FORCE_SCALE], wall_parameters, segments, spheres, slots, walls,
            )  # fmt: skip
            spheres.force[i] = spheres.force[i] + wall_force
            spheres.moment[i] = spheres.moment[i] + wall_moment
            if wp.static(dissipation):
                spheres.dissipated_energy[i] = spheres.dissipated_energy[i] + lost

    return wall_contacts
