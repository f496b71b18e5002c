"""Sphere-sphere contact forces over a stored neighbour list, and, in the same pass, planes and pipes.

One list serves both devices. In the *half* list (CPU: a thread owns the spheres of a chunk) a pair inside a
chunk stands once and its force is added to both spheres; a pair across two chunks stands at both. In the *full*
list (GPU) every pair stands at both spheres, each thread writes only its own sphere, and no atomic is needed. A
pair is always evaluated in the order of its spheres' permanent numbers, so both copies compute and store the same
bits.

A row of the list is gone through twice: first the distances, which leave a bit for each contact, then the
contacts, one bit after the other. The second loop does nothing but contacts: on a GPU threads of a warp work on
theirs together, on a CPU there is no branch to mispredict. The bits of the first BLOCK entries are kept for the
next step, so that contacts which have parted are known without reading the history of all that never touched.
"""

import functools

import warp as wp

from .bond_parallel import BROKEN_IN_TENSION, UNBONDED, bond_functions
from .contact_law import contact_functions
from .rows import row_functions
from .types import DT_PREVIOUS, FORCE_SCALE, HALTED, SPAN, cpu_flags, lowest_bit, scene_struct, types, vector_functions
from .wall_motion import wall_struct
from .walls import analytic_wall_functions

BLOCK = wp.constant(31)  # list entries gone through at a time; their bits leave the sign of an int32 alone
ALL_TOUCHED = 2**31 - 1  # bits after a rebuild: whatever touched before


@wp.func
def decode(entry: wp.int32):
    """Neighbour index of a list entry; entries are j, or -1 - j where j has the lower permanent number."""
    if entry < 0:
        return -1 - entry
    return entry


@functools.cache
def contact_kernel(scalar, pair_law, wall_law, half: bool, history: bool, bonds: bool, healing: bool,
                   walls: bool, losses: bool):  # fmt: skip
    """Kernel over spheres: contact forces [N] and moments about sphere centres [N m].

    In the half list they are added to `force` and `moment`, else they replace what stands there. With `losses` it
    also adds up the energy that friction, dashpots and breaking bonds take [J]. `first` and `last` bound the
    chunk of spheres that this launch owns, `part` is its number.
    """
    t = types(scalar)
    span = SPAN if half else 1
    SceneRow = scene_struct(scalar)
    Parameters = pair_law(scalar).Parameters
    contact_force = pair_law(scalar).force
    contact_energy = pair_law(scalar).energy
    WallParameters = wall_law(scalar).Parameters
    Wall = wall_struct(scalar)
    analytic = analytic_wall_functions(scalar, wall_law, losses)
    Segment = analytic.Segment
    far_from_walls, analytic_walls = analytic.far_from_walls, analytic.analytic_walls
    sphere_touch = contact_functions(scalar).sphere_touch
    Bond = bond_functions(scalar).Bond
    bond_force = bond_functions(scalar).bond_force
    bond_energy = bond_functions(scalar).bond_energy
    xyz = vector_functions(scalar).xyz
    rows = row_functions(scalar)
    read_int, read_vec3, read_vec4 = rows.read_int, rows.read_vec3, rows.read_vec4
    write_vec3, write_vec4 = rows.write_vec3, rows.write_vec4

    # A GPU's exact division and root are subroutines that take most of a contact's time; those of `fast_math` are
    # off by two units in the last place, in single precision only.
    options = {"fast_math": not half, "cpu_compiler_flags": cpu_flags()}

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False, module_options=options)
    def contacts(
        scenes: wp.array(dtype=SceneRow),
        first: wp.int32,
        last: wp.int32,
        part: wp.int32,
        pair_parameters: wp.array(dtype=Parameters),
        bond_parameters: wp.array(dtype=Bond),
        sphere_scene: wp.array(dtype=wp.int32),
        sphere_position: wp.array(dtype=t.vec4),
        sphere_velocity: wp.array(dtype=t.vec4),
        sphere_spin: wp.array(dtype=t.vec3),
        sphere_material: wp.array(dtype=wp.int32),
        pair_start: wp.array(dtype=wp.int32),
        pair_other: wp.array(dtype=wp.int32),
        clock: wp.array2d(dtype=wp.float64),
        flags: wp.array2d(dtype=wp.int32),
        sphere_touching: wp.array(dtype=wp.int32),
        pair_history: wp.array(dtype=t.vec3),
        pair_bond: wp.array(dtype=wp.int32),
        pair_bond_force: wp.array(dtype=t.vec4),
        pair_bond_moment: wp.array(dtype=t.vec4),
        wall_parameters: wp.array(dtype=WallParameters),
        walls_in: wp.array(dtype=Wall),
        segments: wp.array(dtype=Segment),
        wall_position: wp.array(dtype=t.vec3),
        wall_normal: wp.array(dtype=t.vec3),
        wall_velocity: wp.array(dtype=t.vec3),
        wall_spin: wp.array(dtype=t.vec3),
        sphere_clear: wp.array(dtype=t.vec4),
        slot_touching: wp.array(dtype=wp.int32),
        slot_history: wp.array2d(dtype=t.vec3),
        wall_step_force: wp.array3d(dtype=wp.int64),
        force: wp.array(dtype=t.vec3),
        moment: wp.array(dtype=t.vec3),
        sphere_lost: wp.array(dtype=wp.float64),
        sphere_broken: wp.array(dtype=wp.vec2i),
    ):
        begin_i = first + wp.tid() * wp.static(span)
        for i in range(begin_i, wp.min(begin_i + wp.static(span), last)):
            s = sphere_scene[i]
            if flags[s, HALTED] != 0:
                continue
            base = scenes[s].spheres
            laws = scenes[s].laws
            materials = scenes[s].materials
            pairs = scenes[s].pairs
            dt = scalar(clock[s, DT_PREVIOUS])  # the displacement that led here is that of the step before
            position_i = read_vec4(sphere_position, i)
            velocity_i = read_vec4(sphere_velocity, i)
            spin_i = read_vec3(sphere_spin, i)
            x_i = xyz(position_i)
            radius_i = position_i[3]
            row = laws + sphere_material[i] * materials
            force_i = t.vec3()
            moment_i = t.vec3()
            lost_i = wp.float64(0.0)
            begin = pairs + pair_start[i + s]
            end = pairs + pair_start[i + s + 1]
            before = wp.int32(0)
            if wp.static(history or healing):
                before = sphere_touching[i]
            for block in range(begin, end, BLOCK):
                bits = wp.int32(0)
                length = wp.min(BLOCK, end - block)
                b = wp.int32(0)
                while b < length:
                    position_j = read_vec4(sphere_position, base + decode(read_int(pair_other, block + b)))
                    reach = radius_i + position_j[3]
                    close = wp.length_sq(xyz(position_j) - x_i) < reach * reach
                    if wp.static(bonds):
                        close = close or read_int(pair_bond, block + b) > 0
                    if close:
                        bits = bits | (1 << b)
                    b = b + 1
                if wp.static(history or healing):
                    parted = wp.static(ALL_TOUCHED) & ~bits
                    if block == begin:
                        parted = parted & before
                        if bits != before:
                            sphere_touching[i] = bits
                    while parted != 0:
                        k = block + lowest_bit(parted)
                        parted = parted & (parted - 1)
                        if k < end:
                            if wp.static(history):
                                if wp.static(losses):
                                    # A spring still loaded when the surfaces part takes its energy with it.
                                    entry = pair_other[k]
                                    j = base + decode(entry)
                                    counts = entry >= 0
                                    if wp.static(half):
                                        counts = counts or (j >= first and j < last)
                                    if wp.length_sq(pair_history[k]) > scalar(0.0) and counts:
                                        touch = sphere_touch(
                                            t.vec3(), scalar(0.0), t.vec3(), scalar(0.0), radius_i,
                                            sphere_position[j][3],
                                            velocity_i[3], sphere_velocity[j][3],
                                        )  # fmt: skip
                                        p = pair_parameters[row + sphere_material[j]]
                                        lost_i += wp.float64(contact_energy(p, touch, pair_history[k]))
                                pair_history[k] = t.vec3()
                            if wp.static(healing):
                                if pair_bond[k] < 0:
                                    pair_bond[k] = 0  # parted: may bond again at the next touch
                while bits != 0:
                    k = block + lowest_bit(bits)
                    bits = bits & (bits - 1)
                    entry = read_int(pair_other, k)
                    j = base + decode(entry)
                    position_j = read_vec4(sphere_position, j)
                    velocity_j = read_vec4(sphere_velocity, j)
                    spin_j = read_vec3(sphere_spin, j)
                    own = entry >= 0  # this copy of the pair is the one that counts
                    shared = wp.bool(False)
                    if wp.static(half):
                        shared = j >= first and j < last
                        own = own or shared
                    sign = scalar(1.0)
                    if entry < 0:
                        sign = scalar(-1.0)
                    offset = xyz(position_j) - x_i
                    distance = wp.length(offset)
                    gap = distance - (radius_i + position_j[3])
                    # Coincident centres have no direction: any fixed one will part them.
                    n = t.vec3(scalar(0.0), scalar(0.0), scalar(1.0))
                    if distance > scalar(0.0):
                        n = (sign / distance) * offset
                    # The contact point halves the overlap.
                    arm_i = radius_i + scalar(0.5) * gap
                    arm_j = position_j[3] + scalar(0.5) * gap
                    apart = sign * (xyz(velocity_j) - xyz(velocity_i))
                    # arm_i spin_i + arm_j spin_j, in a form that rounds alike in both copies of a pair, fused or not.
                    spins = spin_i + spin_j
                    sliding = (scalar(0.5) * (arm_i + arm_j)) * spins
                    sliding = sliding + (scalar(0.5) * (arm_j - arm_i)) * (spin_j - spin_i)
                    velocity = apart - wp.cross(sliding, n)
                    twist = scalar(0.5) * dt * wp.dot(spins, n)
                    touch = sphere_touch(n, gap, velocity, twist, radius_i, position_j[3], velocity_i[3], velocity_j[3])

                    old_history = t.vec3()
                    if wp.static(history):
                        old_history = read_vec3(pair_history, k)
                    total, new_history, lost = contact_force(
                        pair_parameters[row + read_int(sphere_material, j)], touch, old_history, dt
                    )
                    if wp.static(history):
                        write_vec3(pair_history, k, new_history)
                    bond_moment = t.vec3()
                    if wp.static(bonds):
                        bond = read_int(pair_bond, k)
                        if wp.static(healing):
                            if bond == UNBONDED:
                                bond = 1
                                pair_bond[k] = 1
                        if bond > 0:
                            # Distance now less distance before, without cancellation.
                            way = dt * apart
                            came_from = distance * n - way
                            stretch = wp.dot(way, distance * n + came_from) / (distance + wp.length(came_from))
                            held_force, held_moment, outcome = bond_force(
                                bond_parameters[scenes[s].bonds + bond], touch, stretch, sign * (spin_j - spin_i),
                                read_vec4(pair_bond_force, k), read_vec4(pair_bond_moment, k), dt,
                            )  # fmt: skip
                            if outcome < 0:
                                pair_bond[k] = outcome
                                if own:
                                    broken = sphere_broken[i]
                                    if outcome == BROKEN_IN_TENSION:
                                        broken[0] = broken[0] + 1
                                    else:
                                        broken[1] = broken[1] + 1
                                    sphere_broken[i] = broken
                                if wp.static(losses):
                                    if gap >= scalar(0.0):
                                        lost = scalar(0.0)
                                    lost += bond_energy(
                                        bond_parameters[scenes[s].bonds + bond], touch, held_force, held_moment
                                    )
                                held_force = t.vec4()
                                held_moment = t.vec4()
                                # A bond that breaks may leave a pair that no longer touches: the contact's
                                # dashpot must not outlive it.
                                if gap >= scalar(0.0):
                                    total = t.vec3()
                            write_vec4(pair_bond_force, k, held_force)
                            write_vec4(pair_bond_moment, k, held_moment)
                            total = total + xyz(held_force) + held_force[3] * n
                            bond_moment = xyz(held_moment) + held_moment[3] * n
                    if wp.static(losses):
                        if own:
                            lost_i += wp.float64(lost)
                    turn = wp.cross(n, total)
                    force_i = force_i + sign * total
                    moment_i = moment_i + arm_i * turn + sign * bond_moment
                    if wp.static(half):
                        if shared:
                            write_vec3(force, j, read_vec3(force, j) - sign * total)
                            write_vec3(moment, j, read_vec3(moment, j) + arm_j * turn - sign * bond_moment)
            if wp.static(walls):
                far = far_from_walls(position_i, read_vec4(sphere_clear, i))
                if not far or scenes[s].still == 0:
                    wall_force, wall_moment, wall_lost = analytic_walls(
                        i, scenes[s], far, part, dt, position_i, velocity_i, spin_i, sphere_material[i],
                        wall_parameters, walls_in, segments, wall_position, wall_normal, wall_velocity, wall_spin,
                        clock[s, FORCE_SCALE], sphere_clear, slot_touching, slot_history, wall_step_force,
                    )  # fmt: skip
                    force_i += wall_force
                    moment_i += wall_moment
                    lost_i += wall_lost
            if wp.static(losses):
                sphere_lost[i] = sphere_lost[i] + lost_i
            if wp.static(half):
                write_vec3(force, i, read_vec3(force, i) + force_i)
                write_vec3(moment, i, read_vec3(moment, i) + moment_i)
            else:
                write_vec3(force, i, force_i)
                write_vec3(moment, i, moment_i)

    return contacts
