"""Kernels that measure contact forces as vectors, for the stresses in slices of a pipe."""

import functools

import warp as wp

from ..common.rows import row_functions
from ..common.types import types, vector_functions
from ..common.walls import wall_functions
from .analytic_walls import surface_touch_function
from .bond_parallel import load_row
from .pairs import decode, pair_functions
from .structs import array_structs


@functools.cache
def force_probe(scalar, pair_law, wall_law, half: bool, history: bool, bonds: bool) -> wp.Kernel:
    """Return the kernel over spheres of scene `s` that writes the force vector of each contact with spheres or walls.

    Each force acts on the sphere at which the contact is listed, and includes the force of a bond. The forces of shear
    springs and bonds come from the last step, while gaps and velocities are current.
    """
    t = types(scalar)
    structs = array_structs(scalar)
    Scenes, Spheres, Slots, Pairs, Walls = structs.Scenes, structs.Spheres, structs.Slots, structs.Pairs, structs.Walls
    PairParameters, pair_force = pair_law.functions(scalar).Parameters, pair_law.functions(scalar).force
    WallParameters, wall_force_of = wall_law.functions(scalar).Parameters, wall_law.functions(scalar).force
    pair_touch = pair_functions(scalar).pair_touch
    surface_touch = surface_touch_function(scalar)
    shape = wall_functions(scalar)
    Segment, distance_to_wall, into_wall = shape.Segment, shape.distance_to_wall, shape.into_wall
    xyz = vector_functions(scalar).xyz
    read_half = row_functions(scalar).read_half

    @wp.func
    def force_on(
        i: wp.int32, j: wp.int32, k: wp.int32, sign: scalar, parameters: PairParameters, spheres: Spheres, pairs: Pairs,
        first_load: wp.int32,
    ):  # fmt: skip
        pair = pair_touch(
            spheres.position[i], spheres.velocity[i], xyz(spheres.spin[i]), spheres.position[j], spheres.velocity[j],
            xyz(spheres.spin[j]), sign, scalar(0.0),
        )  # fmt: skip
        total = t.vec3()
        if pair.touch.gap < scalar(0.0):
            held = t.vec3()
            if wp.static(history):
                held = xyz(pairs.history[k])
            push, unused, unused_loss = pair_force(parameters, pair.touch, held, scalar(0.0))
            total = push
        if wp.static(bonds):
            if pairs.bond[k] > 0:
                load = read_half(pairs.load, first_load + load_row(pairs.bond[k]), 0)
                total = total + xyz(load) + load[3] * pair.touch.normal
        return sign * total

    @wp.kernel(module="unique", enable_backward=False)
    def measure_forces(
        # The next arguments are arrays of the model, which are constant during a run.
        pair_parameters: wp.array(dtype=PairParameters),
        wall_parameters: wp.array(dtype=WallParameters),
        segments: wp.array(dtype=Segment),
        # The next arguments are the scene, and the range of spheres that this launch processes.
        s: wp.int32,
        first: wp.int32,
        last: wp.int32,
        # The next arguments are arrays of the simulated state that this kernel only reads.
        scenes: Scenes,
        spheres: Spheres,
        slots: Slots,
        pairs: Pairs,
        walls: Walls,
        # The next arguments are arrays that this kernel writes.
        pair_push: wp.array(dtype=t.vec3),
        wall_push: wp.array2d(dtype=t.vec3),
        wall_arm: wp.array2d(dtype=t.vec3),
    ):
        i = first + wp.tid()
        base = scenes.row[s].spheres
        row = scenes.row[s].laws + spheres.material[i] * scenes.row[s].materials
        first_entry = scenes.row[s].pairs
        for k in range(first_entry + pairs.start[i + s], first_entry + pairs.start[i + s + 1]):
            entry = pairs.other[k]
            j = base + decode(entry)
            counts = entry >= 0
            if wp.static(half):
                counts = counts or (j >= first and j < last)
            push = t.vec3()
            if counts:
                sign = wp.where(entry < 0, scalar(-1.0), scalar(1.0))
                law = pair_parameters[row + spheres.material[j]]
                push = force_on(i, j, k, sign, law, spheres, pairs, scenes.row[s].loads)
            pair_push[k - first_entry] = push
        x = xyz(spheres.position[i])
        radius = spheres.position[i][3]
        for slot in range(slots.history.shape[1]):
            w = scenes.row[s].walls + slot
            n = t.vec3()  # Unit normal that points into the wall.
            gap = scalar(1.0)
            if slot < scenes.row[s].analytic:
                distance, direction = distance_to_wall(walls.table[w], segments, walls.position[w], walls.normal[w], x)
                n = into_wall(walls.table[w], direction)
                gap = distance - radius
            elif slots.wall[i, slot] >= 0:
                w = scenes.row[s].walls + slots.wall[i, slot]
                n = slots.normal[i, slot]
                gap = -slots.overlap[i, slot]
            push = t.vec3()
            arm = t.vec3()
            if gap < scalar(0.0) and wp.length_sq(n) > scalar(0.0):
                touch, point = surface_touch(
                    walls.position[w], walls.velocity[w], walls.spin[w], n, gap, x, radius, spheres.velocity[i],
                    xyz(spheres.spin[i]), scalar(0.0),
                )  # fmt: skip
                push, unused, unused_loss = wall_force_of(
                    wall_parameters[row + walls.table[w].material], touch, slots.history[i, slot], scalar(0.0)
                )
                arm = (radius + gap) * n
            wall_push[i - base, slot] = push
            wall_arm[i - base, slot] = arm

    return measure_forces


STRESSES: int = wp.constant(6)
"""Number of components of a body's stress sum: products of contact force and branch vector, in the order xx, yy, zz,
xy, yz, zx."""


@functools.cache
def stress_probe(scalar) -> wp.Kernel:
    """Return the kernel over spheres of scene `s` that computes the stress sum of each body.

    The stress sum adds up the products of force and branch vector over the body's contacts. The branch vector points
    from the centroid of one body to the centroid of the other body. The forces come from :func:`force_probe`, and
    compression is positive. Half of the product of a contact is added to each of the two bodies. Sums are integers in
    units of 1 / `scale` newton metres, so the order of the summation cannot change them.
    """
    t = types(scalar)
    structs = array_structs(scalar)
    Scenes, Bodies, Spheres, Pairs = structs.Scenes, structs.Bodies, structs.Spheres, structs.Pairs
    xyz = vector_functions(scalar).xyz

    @wp.func
    def add(stress: wp.array2d(dtype=wp.int64), body: wp.int32, push: t.vec3, branch: t.vec3, scale: wp.float64):
        for c in range(3):
            d = (c + 1) % 3
            level = wp.float64(push[c]) * wp.float64(branch[c])
            across = (wp.float64(push[c]) * wp.float64(branch[d]) + wp.float64(push[d]) * wp.float64(branch[c])) / (
                wp.float64(2.0)
            )
            wp.atomic_add(stress, body, c, wp.int64(wp.round(-level * scale)))
            wp.atomic_add(stress, body, c + 3, wp.int64(wp.round(-across * scale)))

    @wp.kernel(module="unique", enable_backward=False)
    def add_stresses(
        s: wp.int32,
        scale: wp.float64,
        # The next arguments are arrays of the simulated state that this kernel only reads.
        scenes: Scenes,
        bodies: Bodies,
        spheres: Spheres,
        pairs: Pairs,
        pair_push: wp.array(dtype=t.vec3),
        wall_push: wp.array2d(dtype=t.vec3),
        wall_arm: wp.array2d(dtype=t.vec3),
        # The next arguments are arrays that this kernel writes.
        stress: wp.array2d(dtype=wp.int64),
    ):
        base = scenes.row[s].spheres
        first_body = scenes.row[s].bodies
        i = base + wp.tid()
        body = spheres.body[i]
        middle = bodies.position[first_body + body]
        first_entry = scenes.row[s].pairs
        for k in range(first_entry + pairs.start[i + s], first_entry + pairs.start[i + s + 1]):
            push = pair_push[k - first_entry]
            if wp.length_sq(push) > scalar(0.0):
                other = spheres.body[base + decode(pairs.other[k])]
                branch = scalar(0.5) * (bodies.position[first_body + other] - middle)
                add(stress, body, push, branch, scale)
                add(stress, other, push, branch, scale)
        for slot in range(wall_push.shape[1]):
            push = wall_push[i - base, slot]
            if wp.length_sq(push) > scalar(0.0):
                add(stress, body, push, xyz(spheres.position[i]) + wall_arm[i - base, slot] - middle, scale)

    return add_stresses
