"""Stable step from masses, live stiffness and dashpots, bonds included.

For each body the 3x3 stiffness K and damping C of its touching or bonded contacts, and the same about its
centroid (lever arms of contacts, moments of bonds) in principal axes, scaled by the moments of inertia. With k and
c the largest absolute row sums, the step is min 2 m / (c + sqrt(c^2 + 4 m k)): half of what leapfrog with dashpots
on the velocity of half a step ago can stand against fixed neighbours, so that neighbours of equal mass may move in
opposition. For one contact it is PFC's sqrt(m/k) (sqrt(1 + beta^2) - beta); for many it counts the dashpots
together, which that formula does not.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.types import types, vector_functions
from ..common.walls import DRIVEN, wall_functions
from .bond_parallel import HYDRATED, bond_functions
from .contact_law import contact_functions
from .pairs import decode
from .structs import DT, STABLE, array_structs, subcycled_struct
from .subcycling import PART, RELAXATION


@functools.cache
def estimate_struct(scalar):
    """What the estimate adds up; `sums` has columns K and C of translation, K and C of rotation."""
    t = types(scalar)

    @wp.struct
    class Estimate:
        sums: wp.array2d(dtype=t.mat33)  # of each sphere, shape (spheres, 4); zero between two estimates
        wall_load: wp.array2d(dtype=wp.int64)  # stiffness [mN/m] and damping [mN s/m] of each wall, shape (walls, 2)
        smallest: wp.array(dtype=wp.float64)  # step of any body of a scene [s], shape (scenes,)
        fastest: wp.array(dtype=wp.float64)  # speed of anything in a scene [m/s], shape (scenes,)

    return Estimate


@functools.cache
def stiffness_functions(scalar):
    """`outer`, `turning` and `stable`: matrices of one contact, and the step that they allow."""
    t = types(scalar)

    @wp.func
    def outer(n: t.vec3, kn: scalar, ks: scalar):
        """Stiffness kn along n and ks across it."""
        return (kn - ks) * wp.outer(n, n) + ks * wp.identity(n=3, dtype=scalar)

    @wp.func
    def turning(r: t.vec3, n: t.vec3, kn: scalar, ks: scalar, bending: scalar, torsion: scalar):
        """Stiffness against rotation of a contact at `r` from the centroid: springs at the end of the lever, and the
        bond's own moments. Dashpots likewise."""
        c = wp.cross(r, n)
        levers = wp.length_sq(r) * wp.identity(n=3, dtype=scalar) - wp.outer(r, r)
        return (kn - ks) * wp.outer(c, c) + ks * levers + outer(n, torsion, bending)

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

    return SimpleNamespace(outer=outer, turning=turning, row_sum=row_sum, stable=stable)


@functools.cache
def begin_kernel(scalar):
    """Kernel over scenes, of which those that are `due` count, as in all kernels here: nothing is known of them yet."""
    structs = array_structs(scalar)
    Scenes = structs.Scenes
    Estimate = estimate_struct(scalar)

    @wp.kernel(module="unique", enable_backward=False)
    def begin_estimate(due: wp.array(dtype=wp.int32), scenes: Scenes, estimate: Estimate):
        s = wp.tid()
        if due[s] == 0:
            return
        estimate.smallest[s] = wp.float64(1.0e30)
        estimate.fastest[s] = scenes.row[s].foreseen_speed
        for w in range(scenes.row[s].walls, scenes.row[s].walls + scenes.row[s].wall_count):
            estimate.wall_load[w, 0] = wp.int64(0)
            estimate.wall_load[w, 1] = wp.int64(0)

    return begin_estimate


@functools.cache
def pair_stiffness_function(scalar, law, half: bool, bonds: bool, subcycling: bool):
    """`add_pairs`: K and C of all touching or bonded pairs in the row of sphere i; a half list adds to both spheres.

    With `subcycling` either of those pairs that are stepped in rounds (`stiff`) or of the others.
    """
    t = types(scalar)
    structs = array_structs(scalar)
    Scenes, Bodies, Spheres, Pairs = structs.Scenes, structs.Bodies, structs.Spheres, structs.Pairs
    Estimate = estimate_struct(scalar)
    functions = law.functions(scalar)
    Parameters, stiffness = functions.Parameters, functions.stiffness
    Bond, bond_stiffness = bond_functions(scalar).Bond, bond_functions(scalar).bond_stiffness
    sphere_touch = contact_functions(scalar).sphere_touch
    matrices = stiffness_functions(scalar)
    outer, turning = matrices.outer, matrices.turning
    xyz = vector_functions(scalar).xyz
    safe_normalize = vector_functions(scalar).safe_normalize

    @wp.struct
    class Sums:
        k: t.mat33
        c: t.mat33
        k_turn: t.mat33
        c_turn: t.mat33

    @wp.func
    def add_pairs(
        i: wp.int32,
        s: wp.int32,
        first: wp.int32,
        last: wp.int32,
        stiff: wp.bool,
        parameters: wp.array(dtype=Parameters),
        bond_parameters: wp.array(dtype=Bond),
        scenes: Scenes,
        bodies: Bodies,
        spheres: Spheres,
        pairs: Pairs,
        estimate: Estimate,
    ):
        zero = scalar(0.0)
        sums = Sums()
        base = scenes.row[s].spheres
        body_base = scenes.row[s].bodies
        xi = xyz(spheres.position[i])
        radius_i = spheres.position[i][3]
        row = scenes.row[s].laws + spheres.material[i] * scenes.row[s].materials
        arm_i = xi - bodies.position[body_base + spheres.body[i]]
        start = scenes.row[s].pairs
        for pair in range(start + pairs.start[i + s], start + pairs.start[i + s + 1]):
            j = base + decode(pairs.other[pair])
            offset = xyz(spheres.position[j]) - xi
            radius_j = spheres.position[j][3]
            length = radius_i + radius_j
            touching = wp.length_sq(offset) < length * length
            bond = wp.int32(0)
            if wp.static(bonds):
                bond = pairs.bond[pair]
            counts = touching or bond > 0
            if wp.static(subcycling):
                counts = counts and (bond == HYDRATED) == stiff
            if counts:
                n = safe_normalize(offset, t.vec3(zero, zero, scalar(1.0)))
                velocity = xyz(spheres.velocity[j]) - xyz(spheres.velocity[i])
                touch = sphere_touch(
                    n, wp.length(offset) - length, velocity, zero, radius_i, radius_j, spheres.velocity[i][3],
                    spheres.velocity[j][3],
                )  # fmt: skip
                k = stiffness(parameters[row + spheres.material[j]], touch)
                held = t.vec4()
                if wp.static(bonds):
                    if bond > 0:
                        held = bond_stiffness(bond_parameters[scenes.row[s].bonds + bond], touch)
                kn = k[0] + held[0]
                ks = k[1] + held[1]
                block = outer(n, kn, ks)
                damping = outer(n, k[2], k[3])
                sums.k = sums.k + block
                sums.c = sums.c + damping
                sums.k_turn = sums.k_turn + turning(arm_i + radius_i * n, n, kn, ks, held[2], held[3])
                sums.c_turn = sums.c_turn + turning(arm_i + radius_i * n, n, k[2], k[3], zero, zero)
                if wp.static(half):
                    if j >= first and j < last:
                        lever = xyz(spheres.position[j]) - bodies.position[body_base + spheres.body[j]] - radius_j * n
                        estimate.sums[j, 0] = estimate.sums[j, 0] + block
                        estimate.sums[j, 1] = estimate.sums[j, 1] + damping
                        estimate.sums[j, 2] = estimate.sums[j, 2] + turning(lever, n, kn, ks, held[2], held[3])
                        estimate.sums[j, 3] = estimate.sums[j, 3] + turning(lever, n, k[2], k[3], zero, zero)
        return sums

    return SimpleNamespace(Sums=Sums, add_pairs=add_pairs)


@functools.cache
def noting_functions(scalar):
    """`hurry` and `load_wall`: the fastest thing of a scene, and what a wall has to bear."""
    t = types(scalar)

    @wp.func
    def hurry(fastest: wp.array(dtype=wp.float64), s: wp.int32, speed: scalar):
        # The plain read spares nearly all atomics; it may be old, never too high.
        if wp.float64(speed) > fastest[s]:
            wp.atomic_max(fastest, s, wp.float64(speed))

    @wp.func
    def load_wall(wall_load: wp.array2d(dtype=wp.int64), w: wp.int32, k: t.vec4):
        # Whole numbers add up the same in any order.
        wp.atomic_add(wall_load, w, 0, wp.int64(wp.float64(k[0]) * wp.float64(1000.0)))
        wp.atomic_add(wall_load, w, 1, wp.int64(wp.float64(k[2]) * wp.float64(1000.0)))

    return hurry, load_wall


@functools.cache
def gather_kernel(scalar, pair_law, wall_law, half: bool, bonds: bool, subcycling: bool):
    """Kernel over spheres from `begin` on: what their contacts add to `estimate`; with `stiff` those that are stepped
    in rounds only.

    In the half list `first` and `last` bound the chunk of spheres whose pairs are counted.
    """
    t = types(scalar)
    structs = array_structs(scalar)
    Scenes, Bodies, Spheres, Slots, Pairs, Walls = (
        structs.Scenes, structs.Bodies, structs.Spheres, structs.Slots, structs.Pairs, structs.Walls
    )  # fmt: skip
    Estimate = estimate_struct(scalar)
    PairParameters = pair_law.functions(scalar).Parameters
    WallParameters, wall_stiffness = wall_law.functions(scalar).Parameters, wall_law.functions(scalar).stiffness
    Bond = bond_functions(scalar).Bond
    add_pairs = pair_stiffness_function(scalar, pair_law, half, bonds, subcycling).add_pairs
    matrices = stiffness_functions(scalar)
    outer, turning = matrices.outer, matrices.turning
    wall_touch = contact_functions(scalar).wall_touch
    shape = wall_functions(scalar)
    Segment, distance_to_wall, into_wall = shape.Segment, shape.distance_to_wall, shape.into_wall
    xyz = vector_functions(scalar).xyz
    hurry, load_wall = noting_functions(scalar)

    @wp.kernel(module="unique", enable_backward=False)
    def gather_stiffness(
        # model
        pair_parameters: wp.array(dtype=PairParameters),
        bond_parameters: wp.array(dtype=Bond),
        wall_parameters: wp.array(dtype=WallParameters),
        segments: wp.array(dtype=Segment),
        # chunk
        due: wp.array(dtype=wp.int32),
        begin: wp.int32,
        first: wp.int32,
        last: wp.int32,
        stiff: wp.bool,
        # state, read
        scenes: Scenes,
        bodies: Bodies,
        spheres: Spheres,
        slots: Slots,
        pairs: Pairs,
        walls: Walls,
        # written
        estimate: Estimate,
    ):
        i = begin + wp.tid()
        s = spheres.scene[i]
        if due[s] == 0:
            return
        zero = scalar(0.0)
        xi = xyz(spheres.position[i])
        radius_i = spheres.position[i][3]
        velocity_i = xyz(spheres.velocity[i])
        row = scenes.row[s].laws + spheres.material[i] * scenes.row[s].materials
        arm_i = xi - bodies.position[scenes.row[s].bodies + spheres.body[i]]
        hurry(estimate.fastest, s, wp.length(velocity_i))
        sums = add_pairs(
            i, s, first, last, stiff, pair_parameters, bond_parameters, scenes, bodies, spheres, pairs, estimate
        )  # fmt: skip
        first_wall = scenes.row[s].walls
        for w in range(first_wall, first_wall + scenes.row[s].wall_count):
            surface = walls.velocity[w] + wp.cross(walls.spin[w], xi - walls.position[w])
            hurry(estimate.fastest, s, wp.length(surface))
        met = slots.history.shape[1]
        if stiff:
            met = 0
        for slot in range(met):
            w = first_wall + slot
            n = t.vec3()  # into the wall
            overlap = scalar(-1.0)
            if slot < scenes.row[s].analytic:
                distance, direction = distance_to_wall(walls.table[w], segments, walls.position[w], walls.normal[w], xi)
                n = into_wall(walls.table[w], direction)
                overlap = radius_i - distance
            else:
                w = first_wall + slots.wall[i, slot]
                if slots.wall[i, slot] >= 0:
                    n = slots.normal[i, slot]
                    overlap = slots.overlap[i, slot]
            if overlap > zero:
                surface = walls.velocity[w] + wp.cross(walls.spin[w], xi + radius_i * n - walls.position[w])
                touch = wall_touch(n, -overlap, surface - velocity_i, zero, radius_i, spheres.velocity[i][3])
                k = wall_stiffness(wall_parameters[row + walls.table[w].material], touch)
                sums.k = sums.k + outer(n, k[0], k[1])
                sums.c = sums.c + outer(n, k[2], k[3])
                sums.k_turn = sums.k_turn + turning(arm_i + radius_i * n, n, k[0], k[1], zero, zero)
                sums.c_turn = sums.c_turn + turning(arm_i + radius_i * n, n, k[2], k[3], zero, zero)
                load_wall(estimate.wall_load, w, k)
        estimate.sums[i, 0] = estimate.sums[i, 0] + sums.k
        estimate.sums[i, 1] = estimate.sums[i, 1] + sums.c
        estimate.sums[i, 2] = estimate.sums[i, 2] + sums.k_turn
        estimate.sums[i, 3] = estimate.sums[i, 3] + sums.c_turn

    return gather_stiffness


@functools.cache
def floor_function(scalar, pair_law, wall_law):
    """`floor_of`: stiffness and damping that a body in flight must be able to bear at its next touch."""
    t = types(scalar)
    Pair, pair_stiffness = pair_law.functions(scalar).Parameters, pair_law.functions(scalar).stiffness
    Wall, wall_stiffness = wall_law.functions(scalar).Parameters, wall_law.functions(scalar).stiffness
    wall_touch = contact_functions(scalar).wall_touch

    @wp.func
    def floor_of(
        pair_parameters: wp.array(dtype=Pair),
        wall_parameters: wp.array(dtype=Wall),
        row: wp.int32,
        materials: wp.int32,
        radius: scalar,
        speed: scalar,
        mass: scalar,
        turn: scalar,
    ):
        """`turn` is what shear does to move and turn the body, over what it does to move it.

        Springs may be twice as stiff as the step allows two bodies, since a single one has nothing that moves against
        it; dashpots, taken half a step late, have no such reserve.
        """
        n = t.vec3(scalar(0.0), scalar(0.0), scalar(1.0))
        touch = wall_touch(n, scalar(0.0), -speed * n, scalar(0.0), radius, mass)
        k_floor = scalar(0.0)
        c_floor = scalar(0.0)
        for m in range(materials):
            k = pair_stiffness(pair_parameters[row + m], touch)
            k_floor = wp.max(k_floor, wp.max(k[0], scalar(0.5) * turn * k[1]))
            c_floor = wp.max(c_floor, wp.max(k[2], turn * k[3]))
            k = wall_stiffness(wall_parameters[row + m], touch)
            k_floor = wp.max(k_floor, wp.max(k[0], scalar(0.5) * turn * k[1]))
            c_floor = wp.max(c_floor, wp.max(k[2], turn * k[3]))
        return k_floor, c_floor

    return floor_of


@functools.cache
def reduce_kernel(scalar, pair_law, wall_law):
    """Kernel over bodies from `begin` on: the smallest step that any of a scene allows; clears the sums."""
    t = types(scalar)
    structs = array_structs(scalar)
    Scenes, Bodies, Spheres = structs.Scenes, structs.Bodies, structs.Spheres
    Estimate = estimate_struct(scalar)
    PairParameters = pair_law.functions(scalar).Parameters
    WallParameters = wall_law.functions(scalar).Parameters
    floor_of = floor_function(scalar, pair_law, wall_law)
    matrices = stiffness_functions(scalar)
    row_sum, stable = matrices.row_sum, matrices.stable
    xyz = vector_functions(scalar).xyz

    @wp.kernel(module="unique", enable_backward=False)
    def reduce_step(
        # model
        pair_parameters: wp.array(dtype=PairParameters),
        wall_parameters: wp.array(dtype=WallParameters),
        # state, read
        due: wp.array(dtype=wp.int32),
        begin: wp.int32,
        stiff: wp.bool,
        scenes: Scenes,
        bodies: Bodies,
        spheres: Spheres,
        # written
        estimate: Estimate,
    ):
        b = begin + wp.tid()
        s = bodies.scene[b]
        if due[s] == 0:
            return
        base = scenes.row[s].spheres
        materials = scenes.row[s].materials
        mass = bodies.mass[b]
        inertia = bodies.inertia[b]
        slight = wp.min(inertia)
        stout = wp.max(inertia)
        k_sum = t.mat33()
        c_sum = t.mat33()
        k_turn = t.mat33()
        c_turn = t.mat33()
        k_floor = scalar(0.0)
        c_floor = scalar(0.0)
        for place in range(base + bodies.first[b + s], base + bodies.first[b + s + 1]):
            k_sum += estimate.sums[place, 0]
            c_sum += estimate.sums[place, 1]
            k_turn += estimate.sums[place, 2]
            c_turn += estimate.sums[place, 3]
            for column in range(4):
                estimate.sums[place, column] = t.mat33()
            # A body in flight must survive its next touch, in shear, too, with the fastest thing that may come.
            # Shear turns it about its long axis with the sphere's radius as lever, across it with the whole arm.
            radius = spheres.position[place][3]
            speed = wp.length(xyz(spheres.velocity[place])) + scalar(estimate.fastest[s])
            lever = radius + wp.length(xyz(spheres.position[place]) - bodies.position[b])
            turn = scalar(1.0) + mass * wp.max(radius * radius / slight, lever * lever / stout)
            row = scenes.row[s].laws + spheres.material[place] * materials
            k, c = floor_of(pair_parameters, wall_parameters, row, materials, radius, speed, mass, turn)
            k_floor = wp.max(k_floor, k)
            c_floor = wp.max(c_floor, c)
        if stiff:
            k_floor = scalar(0.0)
            c_floor = scalar(0.0)
        unit = t.vec3(mass, mass, mass)
        step = stable(wp.max(row_sum(k_sum, unit), k_floor / mass), wp.max(row_sum(c_sum, unit), c_floor / mass))
        axes = wp.quat_to_matrix(bodies.orientation[b])
        k_spin = row_sum(wp.transpose(axes) * k_turn * axes, inertia)
        if k_spin > scalar(0.0):
            step = wp.min(step, stable(k_spin, row_sum(wp.transpose(axes) * c_turn * axes, inertia)))
        if wp.float64(step) < estimate.smallest[s]:
            wp.atomic_min(estimate.smallest, s, wp.float64(step))
        elif not (step >= scalar(0.0)):
            estimate.smallest[s] = wp.float64(-1.0)

    return reduce_step


@functools.cache
def keep_kernel(scalar):
    """Kernel over scenes: what has been found holds for the pairs that are stepped in rounds."""
    Estimate, Subcycled = estimate_struct(scalar), subcycled_struct(scalar)

    @wp.kernel(module="unique", enable_backward=False)
    def keep_stable(due: wp.array(dtype=wp.int32), estimate: Estimate, subcycled: Subcycled):
        s = wp.tid()
        if due[s] == 0:
            return
        subcycled.stable[s] = estimate.smallest[s]

    return keep_stable


@functools.cache
def settle_kernel(scalar, subcycling: bool):
    """Kernel over scenes: the stable step, driven walls included, and the size of the next steps."""
    structs = array_structs(scalar)
    Scenes, Walls = structs.Scenes, structs.Walls
    Estimate, Subcycled = estimate_struct(scalar), subcycled_struct(scalar)

    @wp.kernel(module="unique", enable_backward=False)
    def settle_step(
        due: wp.array(dtype=wp.int32), estimate: Estimate, subcycled: Subcycled, walls: Walls, scenes: Scenes
    ):  # fmt: skip
        s = wp.tid()
        if due[s] == 0:
            return
        one = wp.float64(1.0)
        step = estimate.smallest[s]
        if wp.static(subcycling):
            if subcycled.rounds[s] > 0:
                # Dashpots of stiff bonds go with stiffness and step.
                rounds = wp.float64(subcycled.rounds[s])
                stiff = subcycled.stable[s] * rounds / wp.sqrt(one + wp.float64(RELAXATION) * rounds)
                step = wp.min(wp.float64(PART) * step, stiff)
        for w in range(scenes.row[s].walls, scenes.row[s].walls + scenes.row[s].wall_count):
            if walls.table[w].motion == DRIVEN:
                # A driven wall is a body, too; never less than one contact with the largest sphere.
                load = wp.float64(1.0e-3) * wp.float64(estimate.wall_load[w, 0])
                stiffness = wp.max(load, scenes.row[s].wall_stiffness)
                mass = walls.table[w].mass
                # Dashpots are sized for the aggregates' masses and may be far beyond critical for the wall's.
                ratio = wp.float64(0.5e-3) * wp.float64(estimate.wall_load[w, 1]) / wp.sqrt(mass * stiffness)
                own = wp.sqrt(mass / stiffness) * (wp.sqrt(one + ratio * ratio) - ratio)
                step = wp.min(step, own)
        scenes.clock[s, STABLE] = step
        if scenes.row[s].fixed_step > wp.float64(0.0):
            scenes.clock[s, DT] = scenes.row[s].fixed_step
        else:
            scenes.clock[s, DT] = wp.min(scenes.row[s].safety * step, scenes.row[s].largest_step)

    return settle_step
