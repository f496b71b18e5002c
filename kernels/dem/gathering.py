"""Kernel that adds up the stiffness and damping of each sphere's contacts, for the estimate of the stable step."""

import functools

import warp as wp

from ..common.rows import row_functions
from ..common.types import types, vector_functions
from ..common.walls import wall_functions
from .bond_parallel import bond_functions
from .contact_law import contact_functions
from .contacts import contact_options
from .stable_step import recording_functions
from .stiffness import estimate_struct, pair_stiffness_function, stiffness_functions
from .structs import array_structs
from .warps import group_functions

ESTIMATE_LANES = 4
"""Number of GPU threads that share a sphere in the estimate of the stable step; they divide its list entries among
them."""


@functools.cache
def gather_kernel(scalar, pair_law, wall_law, half: bool, bonds: bool, subcycling: bool, lanes: int) -> wp.Kernel:
    """Return the kernel that adds up the stiffness and damping of each sphere's contacts in `estimate`.

    The kernel's argument `begin` is the first sphere of the launch. If its argument `stiff` is true, the kernel counts
    only pairs with stiff bonds, which are computed in several rounds per step (sub-cycling). With half lists, `first`
    and `last` bound the range of spheres of one CPU thread, and `part` is the number of this thread. On a GPU, `part`
    is 0, and `lanes` threads share a sphere.
    """
    t = types(scalar)
    sum_of_group = group_functions(scalar, lanes).sum_of_group
    structs = array_structs(scalar)
    Scenes, Bodies, Spheres, Slots = structs.Scenes, structs.Bodies, structs.Spheres, structs.Slots
    Pairs, Walls = structs.Pairs, structs.Walls
    Estimate = estimate_struct(scalar)
    PairParameters = pair_law.functions(scalar).Parameters
    WallParameters, wall_stiffness = wall_law.functions(scalar).Parameters, wall_law.functions(scalar).stiffness
    Bond = bond_functions(scalar).Bond
    add_pairs = pair_stiffness_function(scalar, pair_law, half, bonds, subcycling, lanes).add_pairs
    matrices = stiffness_functions(scalar)
    outer, turning = matrices.outer, matrices.turning
    wall_touch = contact_functions(scalar).wall_touch
    shape = wall_functions(scalar)
    Segment, distance_to_wall, into_wall = shape.Segment, shape.distance_to_wall, shape.into_wall
    xyz = vector_functions(scalar).xyz
    record_speed = recording_functions(scalar).record_speed
    add_wall_stiffness = recording_functions(scalar).add_wall_stiffness
    rows = row_functions(scalar)
    read_vec3, read_vec4 = rows.read_vec3, rows.read_vec4

    @wp.kernel(module="unique", enable_backward=False, module_options=contact_options(half))
    def gather_stiffness(
        # The next arguments are arrays of the model, which are constant during a run.
        pair_parameters: wp.array(dtype=PairParameters),
        bond_parameters: wp.array(dtype=Bond),
        wall_parameters: wp.array(dtype=WallParameters),
        segments: wp.array(dtype=Segment),
        # The next arguments are:
        # - the flags of the scenes for which an estimate is due,
        # - the first sphere of the launch,
        # - the first sphere of the CPU thread's range, and the end of this range,
        # - the index of the CPU thread,
        # - true if only pairs with stiff bonds count.
        due: wp.array(dtype=wp.int32),
        begin: wp.int32,
        first: wp.int32,
        last: wp.int32,
        part: wp.int32,
        stiff: wp.bool,
        # The next arguments are arrays of the simulated state that this kernel only reads.
        scenes: Scenes,
        bodies: Bodies,
        spheres: Spheres,
        slots: Slots,
        pairs: Pairs,
        walls: Walls,
        # The next argument receives the sums of stiffness and damping.
        estimate: Estimate,
    ):
        i = begin + wp.tid() / wp.static(lanes)
        lane = wp.tid() % wp.static(lanes)
        s = spheres.scene[i]
        if due[s] == 0:
            return
        zero = scalar(0.0)
        position_i, moving_i = read_vec4(spheres.position, i), read_vec4(spheres.velocity, i)
        xi, radius_i, velocity_i = xyz(position_i), position_i[3], xyz(moving_i)
        row = scenes.row[s].laws + spheres.material[i] * scenes.row[s].materials
        arm_i = xi - read_vec3(bodies.position, scenes.row[s].bodies + spheres.body[i])
        record_speed(estimate, part, s, wp.length(velocity_i))
        sums = add_pairs(
            i, s, lane, first, last, stiff, pair_parameters, bond_parameters, scenes, bodies, spheres, pairs, estimate
        )  # fmt: skip
        if wp.static(lanes > 1):
            sums.k = sum_of_group(sums.k)
            sums.c = sum_of_group(sums.c)
            sums.k_turn = sum_of_group(sums.k_turn)
            sums.c_turn = sum_of_group(sums.c_turn)
            if lane > 0:
                return
        first_wall = scenes.row[s].walls
        for w in range(first_wall, first_wall + scenes.row[s].wall_count):
            surface = walls.velocity[w] + wp.cross(walls.spin[w], xi - walls.position[w])
            record_speed(estimate, part, s, wp.length(surface))
        met = slots.history.shape[1]
        if stiff:
            met = 0
        for slot in range(met):
            w = first_wall + slot
            n = t.vec3()  # Unit normal that points into the wall.
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
                touch = wall_touch(n, -overlap, surface - velocity_i, zero, radius_i, moving_i[3])
                k = wall_stiffness(wall_parameters[row + walls.table[w].material], touch)
                sums.k = sums.k + outer(n, k[0], k[1])
                sums.c = sums.c + outer(n, k[2], k[3])
                sums.k_turn = sums.k_turn + turning(arm_i + radius_i * n, n, k[0], k[1], zero, zero)
                sums.c_turn = sums.c_turn + turning(arm_i + radius_i * n, n, k[2], k[3], zero, zero)
                add_wall_stiffness(estimate, part, w, k)
        # Add what `estimate.sums` already holds: the stiffness and damping of pairs that the half list contains only at
        # the other sphere.
        if wp.static(half):
            sums.k = sums.k + estimate.sums[i, 0]
            sums.c = sums.c + estimate.sums[i, 1]
            sums.k_turn = sums.k_turn + estimate.sums[i, 2]
            sums.c_turn = sums.c_turn + estimate.sums[i, 3]
        estimate.sums[i, 0] = sums.k
        estimate.sums[i, 1] = sums.c
        estimate.sums[i, 2] = sums.k_turn
        estimate.sums[i, 3] = sums.c_turn

    return gather_stiffness
