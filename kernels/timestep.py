"""Stable step from masses, live stiffness and dashpots, bonds included.

For each body the 3x3 stiffness K and damping C of its touching or bonded contacts, and the same about its
centroid (lever arms of contacts, moments of bonds) in principal axes, scaled by the moments of inertia. With k and
c the largest absolute row sums, the step is min 2 m / (c + sqrt(c^2 + 4 m k)): half of what leapfrog with dashpots
on the velocity of half a step ago can stand against fixed neighbours, so that neighbours of equal mass may move in
opposition. For one contact it is PFC's sqrt(m/k) (sqrt(1 + beta^2) - beta); for many it counts the dashpots
together, which that formula does not.
"""

import functools

import warp as wp

from .bond_parallel import bond_functions
from .contact_law import contact_functions
from .contacts import decode
from .geometry import axis_functions
from .types import DT, STABLE, scene_struct, types, vector_functions
from .wall_motion import DRIVEN, PLANE, wall_struct


@functools.cache
def timestep_kernels(scalar, pair_law, wall_law, half: bool, bonds: bool):
    """Kernels over one scene: ``begin``, ``gather`` (K and C of each sphere), ``reduce`` (smallest step), ``settle``.

    In the half list `first` and `last` bound the chunk of spheres whose pairs are counted.
    """
    t = types(scalar)
    SceneRow = scene_struct(scalar)
    PairParameters = pair_law(scalar).Parameters
    WallParameters = wall_law(scalar).Parameters
    pair_stiffness = pair_law(scalar).stiffness
    wall_stiffness = wall_law(scalar).stiffness
    contact = contact_functions(scalar)
    sphere_touch = contact.sphere_touch
    wall_touch = contact.wall_touch
    Bond = bond_functions(scalar).Bond
    bond_stiffness = bond_functions(scalar).bond_stiffness
    xyz = vector_functions(scalar).xyz
    safe_normalize = vector_functions(scalar).safe_normalize
    Wall = wall_struct(scalar)
    axis = axis_functions(scalar)
    Segment = axis.Segment
    closest_on_axis = axis.closest_on_axis

    @wp.func
    def outer(n: t.vec3, kn: scalar, ks: scalar):
        return (kn - ks) * wp.outer(n, n) + ks * wp.identity(n=3, dtype=scalar)

    @wp.func
    def turning(r: t.vec3, n: t.vec3, kn: scalar, ks: scalar, bending: scalar, torsion: scalar):
        # Stiffness against rotation of a contact at `r` from the centroid: springs at the end of the lever,
        # and the bond's own moments. Dashpots likewise.
        c = wp.cross(r, n)
        levers = wp.length_sq(r) * wp.identity(n=3, dtype=scalar) - wp.outer(r, r)
        return (kn - ks) * wp.outer(c, c) + ks * levers + outer(n, torsion, bending)

    @wp.func
    def hurry(fastest: wp.array(dtype=wp.float64), s: wp.int32, speed: scalar):
        # The plain read spares nearly all atomics; it may be old, never too high.
        if wp.float64(speed) > fastest[s]:
            wp.atomic_max(fastest, s, wp.float64(speed))

    @wp.func
    def load_wall(wall_load: wp.array2d(dtype=wp.int64), w: wp.int32, k: t.vec4):
        # Stiffness [mN/m] and damping [mN s/m] that a wall meets; whole numbers add up the same in any order.
        wp.atomic_add(wall_load, w, 0, wp.int64(wp.float64(k[0]) * wp.float64(1000.0)))
        wp.atomic_add(wall_load, w, 1, wp.int64(wp.float64(k[2]) * wp.float64(1000.0)))

    @wp.kernel(module="unique", enable_backward=False)
    def begin(
        scenes: wp.array(dtype=SceneRow),
        s: wp.int32,
        smallest: wp.array(dtype=wp.float64),
        fastest: wp.array(dtype=wp.float64),
        wall_load: wp.array2d(dtype=wp.int64),
    ):
        smallest[s] = wp.float64(1.0e30)
        fastest[s] = scenes[s].foreseen_speed
        for w in range(scenes[s].walls, scenes[s].walls + scenes[s].wall_count):
            wall_load[w, 0] = wp.int64(0)
            wall_load[w, 1] = wp.int64(0)

    @wp.kernel(module="unique", enable_backward=False)
    def gather(
        scenes: wp.array(dtype=SceneRow),
        s: wp.int32,
        first: wp.int32,
        last: wp.int32,
        pair_parameters: wp.array(dtype=PairParameters),
        wall_parameters: wp.array(dtype=WallParameters),
        bond_parameters: wp.array(dtype=Bond),
        walls: wp.array(dtype=Wall),
        segments: wp.array(dtype=Segment),
        wall_position: wp.array(dtype=t.vec3),
        wall_normal: wp.array(dtype=t.vec3),
        wall_velocity: wp.array(dtype=t.vec3),
        wall_spin: wp.array(dtype=t.vec3),
        body_position: wp.array(dtype=t.vec3),
        sphere_body: wp.array(dtype=wp.int32),
        sphere_position: wp.array(dtype=t.vec4),
        sphere_velocity: wp.array(dtype=t.vec4),
        sphere_material: wp.array(dtype=wp.int32),
        slot_wall: wp.array2d(dtype=wp.int32),
        slot_normal: wp.array2d(dtype=t.vec3),
        slot_overlap: wp.array2d(dtype=scalar),
        slots: wp.int32,
        pair_start: wp.array(dtype=wp.int32),
        pair_other: wp.array(dtype=wp.int32),
        pair_bond: wp.array(dtype=wp.int32),
        sums: wp.array2d(dtype=t.mat33),
        wall_load: wp.array2d(dtype=wp.int64),
        fastest: wp.array(dtype=wp.float64),
    ):
        """`sums` has columns K and C of translation, K and C of rotation; `fastest` the largest speed [m/s]."""
        i = first + wp.tid()
        zero = scalar(0.0)
        base = scenes[s].spheres
        materials = scenes[s].materials
        xi = xyz(sphere_position[i])
        radius_i = sphere_position[i][3]
        velocity_i = xyz(sphere_velocity[i])
        mass_i = sphere_velocity[i][3]
        row = scenes[s].laws + sphere_material[i] * materials
        arm_i = xi - body_position[scenes[s].bodies + sphere_body[i]]
        k_sum = t.mat33()
        c_sum = t.mat33()
        k_turn = t.mat33()
        c_turn = t.mat33()
        hurry(fastest, s, wp.length(velocity_i))
        pairs = scenes[s].pairs
        for pair in range(pairs + pair_start[i + s], pairs + pair_start[i + s + 1]):
            j = base + decode(pair_other[pair])
            offset = xyz(sphere_position[j]) - xi
            radius_j = sphere_position[j][3]
            length = radius_i + radius_j
            touching = wp.length_sq(offset) < length * length
            bond = wp.int32(0)
            if wp.static(bonds):
                bond = pair_bond[pair]
            if touching or bond > 0:
                n = safe_normalize(offset, t.vec3(zero, zero, scalar(1.0)))
                velocity = xyz(sphere_velocity[j]) - velocity_i
                touch = sphere_touch(
                    n, wp.length(offset) - length, velocity, zero, radius_i, radius_j, mass_i, sphere_velocity[j][3]
                )
                k = pair_stiffness(pair_parameters[row + sphere_material[j]], touch)
                held = t.vec4()
                if wp.static(bonds):
                    if bond > 0:
                        held = bond_stiffness(bond_parameters[scenes[s].bonds + bond], touch)
                kn = k[0] + held[0]
                ks = k[1] + held[1]
                block = outer(n, kn, ks)
                damping = outer(n, k[2], k[3])
                k_sum += block
                c_sum += damping
                k_turn += turning(arm_i + radius_i * n, n, kn, ks, held[2], held[3])
                c_turn += turning(arm_i + radius_i * n, n, k[2], k[3], zero, zero)
                if wp.static(half):
                    if j >= first and j < last:
                        lever = (
                            xyz(sphere_position[j]) - body_position[scenes[s].bodies + sphere_body[j]] - radius_j * n
                        )
                        sums[j, 0] = sums[j, 0] + block
                        sums[j, 1] = sums[j, 1] + damping
                        sums[j, 2] = sums[j, 2] + turning(lever, n, kn, ks, held[2], held[3])
                        sums[j, 3] = sums[j, 3] + turning(lever, n, k[2], k[3], zero, zero)
        for w in range(scenes[s].walls, scenes[s].walls + scenes[s].wall_count):
            surface = wall_velocity[w] + wp.cross(wall_spin[w], xi - wall_position[w])
            hurry(fastest, s, wp.length(surface))
        for slot in range(slots):
            w = scenes[s].walls + slot
            n = t.vec3()  # into the wall
            overlap = scalar(-1.0)
            if slot < scenes[s].analytic:
                if walls[w].kind == PLANE:
                    n = -wall_normal[w]
                    overlap = radius_i + wp.dot(xi - wall_position[w], n)
                else:
                    offset, tangent = closest_on_axis(segments, walls[w].first, walls[w].last, xi - wall_position[w])
                    n = safe_normalize(offset, t.vec3(zero, zero, scalar(1.0)))
                    overlap = radius_i + wp.length(offset) - walls[w].radius
            else:
                w = scenes[s].walls + slot_wall[i, slot]
                if slot_wall[i, slot] >= 0:
                    n = slot_normal[i, slot]
                    overlap = slot_overlap[i, slot]
            if overlap > zero:
                surface = wall_velocity[w] + wp.cross(wall_spin[w], xi + radius_i * n - wall_position[w])
                touch = wall_touch(n, -overlap, surface - velocity_i, zero, radius_i, mass_i)
                k = wall_stiffness(wall_parameters[row + walls[w].material], touch)
                k_sum += outer(n, k[0], k[1])
                c_sum += outer(n, k[2], k[3])
                k_turn += turning(arm_i + radius_i * n, n, k[0], k[1], zero, zero)
                c_turn += turning(arm_i + radius_i * n, n, k[2], k[3], zero, zero)
                load_wall(wall_load, w, k)
        sums[i, 0] = sums[i, 0] + k_sum
        sums[i, 1] = sums[i, 1] + c_sum
        sums[i, 2] = sums[i, 2] + k_turn
        sums[i, 3] = sums[i, 3] + c_turn

    @wp.func
    def row_sum(m: t.mat33, scale: t.vec3):
        """Largest absolute row sum of m / sqrt(scale_r scale_c)."""
        largest = scalar(0.0)
        for r in range(3):
            total = scalar(0.0)
            for c in range(3):
                total += wp.abs(m[r, c]) / wp.sqrt(scale[r] * scale[c])
            largest = wp.max(largest, total)
        return largest

    @wp.func
    def stable(k: scalar, c: scalar):
        """Step for stiffness and damping per mass."""
        return scalar(2.0) / (c + wp.sqrt(c * c + scalar(4.0) * k))

    @wp.kernel(module="unique", enable_backward=False)
    def reduce(
        scenes: wp.array(dtype=SceneRow),
        s: wp.int32,
        pair_parameters: wp.array(dtype=PairParameters),
        wall_parameters: wp.array(dtype=WallParameters),
        fastest: wp.array(dtype=wp.float64),
        body_mass: wp.array(dtype=scalar),
        body_inertia: wp.array(dtype=t.vec3),
        body_position: wp.array(dtype=t.vec3),
        body_orientation: wp.array(dtype=t.quat),
        body_first: wp.array(dtype=wp.int32),
        sphere_position: wp.array(dtype=t.vec4),
        sphere_velocity: wp.array(dtype=t.vec4),
        sphere_material: wp.array(dtype=wp.int32),
        sums: wp.array2d(dtype=t.mat33),
        smallest: wp.array(dtype=wp.float64),
    ):
        b = scenes[s].bodies + wp.tid()
        base = scenes[s].spheres
        materials = scenes[s].materials
        mass = body_mass[b]
        inertia = body_inertia[b]
        slight = wp.min(inertia)
        stout = wp.max(inertia)
        k_sum = t.mat33()
        c_sum = t.mat33()
        k_turn = t.mat33()
        c_turn = t.mat33()
        k_floor = scalar(0.0)
        c_floor = scalar(0.0)
        for place in range(base + body_first[b + s], base + body_first[b + s + 1]):
            k_sum += sums[place, 0]
            c_sum += sums[place, 1]
            k_turn += sums[place, 2]
            c_turn += sums[place, 3]
            for column in range(4):
                sums[place, column] = t.mat33()
            # A body in flight must survive its next touch, in shear, too, with the fastest thing that may come.
            n = t.vec3(scalar(0.0), scalar(0.0), scalar(1.0))
            radius = sphere_position[place][3]
            closing = -wp.length(xyz(sphere_velocity[place])) - scalar(fastest[s])
            touch = wall_touch(n, scalar(0.0), closing * n, scalar(0.0), radius, mass)
            lever = radius + wp.length(xyz(sphere_position[place]) - body_position[b])
            # Shear moves and turns the body: about its long axis with the sphere's radius as lever, across it
            # with the whole arm. Springs may be twice as stiff as the step allows two bodies, since a single one
            # has nothing that moves against it; dashpots, taken half a step late, have no such reserve.
            turn = scalar(1.0) + mass * wp.max(radius * radius / slight, lever * lever / stout)
            for m in range(materials):
                row = scenes[s].laws + sphere_material[place] * materials + m
                k = pair_stiffness(pair_parameters[row], touch)
                k_floor = wp.max(k_floor, wp.max(k[0], scalar(0.5) * turn * k[1]))
                c_floor = wp.max(c_floor, wp.max(k[2], turn * k[3]))
                k = wall_stiffness(wall_parameters[row], touch)
                k_floor = wp.max(k_floor, wp.max(k[0], scalar(0.5) * turn * k[1]))
                c_floor = wp.max(c_floor, wp.max(k[2], turn * k[3]))
        unit = t.vec3(mass, mass, mass)
        step = stable(wp.max(row_sum(k_sum, unit), k_floor / mass), wp.max(row_sum(c_sum, unit), c_floor / mass))
        axes = wp.quat_to_matrix(body_orientation[b])
        k_spin = row_sum(wp.transpose(axes) * k_turn * axes, inertia)
        if k_spin > scalar(0.0):
            step = wp.min(step, stable(k_spin, row_sum(wp.transpose(axes) * c_turn * axes, inertia)))
        if wp.float64(step) < smallest[s]:
            wp.atomic_min(smallest, s, wp.float64(step))
        elif not (step >= scalar(0.0)):
            smallest[s] = wp.float64(-1.0)

    @wp.kernel(module="unique", enable_backward=False)
    def settle(
        scenes: wp.array(dtype=SceneRow),
        s: wp.int32,
        walls: wp.array(dtype=Wall),
        wall_load: wp.array2d(dtype=wp.int64),
        smallest: wp.array(dtype=wp.float64),
        clock: wp.array2d(dtype=wp.float64),
    ):
        """One thread: the scene's stable step, driven walls included, and the size of its next steps."""
        one = wp.float64(1.0)
        step = smallest[s]
        for w in range(scenes[s].walls, scenes[s].walls + scenes[s].wall_count):
            if walls[w].motion == DRIVEN:
                # A driven wall is a body, too; never less than one contact with the largest sphere.
                stiffness = wp.max(wp.float64(1.0e-3) * wp.float64(wall_load[w, 0]), scenes[s].wall_stiffness)
                # Dashpots are sized for the aggregates' masses and may be far beyond critical for the wall's.
                ratio = wp.float64(0.5e-3) * wp.float64(wall_load[w, 1]) / wp.sqrt(walls[w].mass * stiffness)
                own = wp.sqrt(walls[w].mass / stiffness) * (wp.sqrt(one + ratio * ratio) - ratio)
                step = wp.min(step, own)
        clock[s, STABLE] = step
        if scenes[s].fixed_step > wp.float64(0.0):
            clock[s, DT] = scenes[s].fixed_step
        else:
            clock[s, DT] = wp.min(scenes[s].safety * step, scenes[s].largest_step)

    return begin, gather, reduce, settle
