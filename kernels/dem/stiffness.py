"""Stiffness and damping matrices of contacts and bonds, from which the stable step is estimated."""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.rows import row_functions
from ..common.types import lowest_bit, types, vector_functions
from .bond_parallel import HYDRATED, bond_functions, kind_of
from .contact_law import contact_functions
from .pairs import BLOCK, decode
from .structs import array_structs
from .warps import group_functions


@functools.cache
def estimate_struct(scalar):
    """Return the struct `Estimate`, in whose arrays the sums for the stable step are collected.

    The four columns of `sums` are stiffness and damping of translation, then stiffness and damping of rotation. In all
    other arrays each CPU thread has its own row, so that the CPU needs no atomic operations.
    """
    vec6 = wp.types.vector(6, scalar)

    @wp.struct
    class Estimate:
        # Sums of stiffness and damping over each sphere's contacts, shape (spheres, 4). They are zero between two
        # estimates of the stable step.
        sums: wp.array2d(dtype=vec6)
        # Stiffness [mN/m] and damping [mN s/m] of all contacts of a wall, as integers. Each CPU thread stores the sums
        # over its contacts for each wall, shape (threads, walls, 2).
        wall_load: wp.array3d(dtype=wp.int64)
        # Stable time step [s]. Each CPU thread stores the minimum over its bodies for each scene, shape (threads,
        # scenes).
        smallest: wp.array2d(dtype=wp.float64)
        # Largest time step that still resolves the impacts of every body, and in which no sphere moves farther than a
        # given fraction of its radius [s]. Each CPU thread stores the minimum over its bodies for each scene, shape
        # (threads, scenes).
        resolution_step: wp.array2d(dtype=wp.float64)
        fastest: wp.array2d(dtype=wp.float64)  # largest speed of any body or wall [m/s], shape (threads, scenes)

    return Estimate


@functools.cache
def stiffness_functions(scalar):
    """Return functions for the stiffness and damping matrices of one contact, and for the stable step.

    `outer` and `turning` return the matrices of a contact for translation and rotation. `full`, `row_sum` and `stable`
    derive the stable step from the sums of these matrices. Matrices are symmetric and stored as six components xx, yy,
    zz, yz, xz, xy until `full` expands them. Six components save registers, because each GPU thread holds four such
    matrices.
    """
    t = types(scalar)
    vec6 = wp.types.vector(6, scalar)

    @wp.func
    def squared(n: t.vec3) -> vec6:
        return vec6(n[0] * n[0], n[1] * n[1], n[2] * n[2], n[1] * n[2], n[0] * n[2], n[0] * n[1])

    @wp.func
    def times_unit(k: scalar) -> vec6:
        return vec6(k, k, k, scalar(0.0), scalar(0.0), scalar(0.0))

    @wp.func
    def full(m: vec6) -> t.mat33:
        return t.mat33(m[0], m[5], m[4], m[5], m[1], m[3], m[4], m[3], m[2])

    @wp.func
    def outer(n: t.vec3, kn: scalar, ks: scalar):
        """Return the matrix of a spring with stiffness `kn` along the unit vector `n` and `ks` perpendicular to it."""
        return (kn - ks) * squared(n) + times_unit(ks)

    @wp.func
    def turning(r: t.vec3, n: t.vec3, kn: scalar, ks: scalar, bending: scalar, torsion: scalar):
        """Return the rotational stiffness matrix of a contact, about the body's centroid.

        `r` is the vector from the centroid to the contact. The stiffness has two parts. The first part comes
        from the contact's springs, which act at the end of the lever `r`. The second part is the bond's own bending and
        torsion stiffness. The same formula gives the rotational damping of dashpots.
        """
        c = wp.cross(r, n)
        levers = times_unit(wp.length_sq(r)) - squared(r)
        return (kn - ks) * squared(c) + ks * levers + outer(n, torsion, bending)

    @wp.func
    def row_sum(m: t.mat33, scale: t.vec3):
        """Return the largest absolute row sum of the matrix with elements m[r, c] / sqrt(scale[r] scale[c]).

        No eigenvalue of this matrix exceeds the row sum. `scale` contains masses or moments of inertia, so the sum is
        an upper bound of the stiffness per mass, or of the damping per mass.
        """
        largest = scalar(0.0)
        for r in range(3):
            total = scalar(0.0)
            for c in range(3):
                total += wp.abs(m[r, c]) / wp.sqrt(scale[r] * scale[c])
            largest = wp.max(largest, total)
        return largest

    @wp.func
    def stable(k: scalar, c: scalar):
        """Return the stable step dt [s], the positive root of k dt^2 + c dt = 1.

        `k` is the stiffness per mass [1/s2], and `c` the damping per mass [1/s].
        """
        return scalar(2.0) / (c + wp.sqrt(c * c + scalar(4.0) * k))

    return SimpleNamespace(outer=outer, turning=turning, full=full, row_sum=row_sum, stable=stable)


@functools.cache
def counting_function(scalar, bonds: bool, subcycling: bool):
    """Return the function `counts`, which returns true if the pair of a list entry is in contact or bonded.

    With `subcycling` there are two kinds of pairs: pairs with stiff bonds, which are computed in several rounds per
    step, and all others. If the argument `stiff` of the function is true, it accepts only pairs of the first kind;
    otherwise it accepts only the other pairs.
    """
    structs = array_structs(scalar)
    Spheres, Pairs = structs.Spheres, structs.Pairs
    xyz = vector_functions(scalar).xyz
    rows = row_functions(scalar)
    read_int, read_vec4 = rows.read_int, rows.read_vec4

    @wp.func
    def counts(spheres: Spheres, pairs: Pairs, i: wp.int32, base: wp.int32, pair: wp.int32, stiff: wp.bool) -> wp.bool:
        position_i = read_vec4(spheres.position, i)
        position_j = read_vec4(spheres.position, base + decode(read_int(pairs.other, pair)))
        length = position_i[3] + position_j[3]
        found = wp.length_sq(xyz(position_j) - xyz(position_i)) < length * length
        if wp.static(bonds):
            bond = kind_of(read_int(pairs.bond, pair))
            found = found or bond > 0
            if wp.static(subcycling):
                found = found and (bond == HYDRATED) == stiff
        return found

    return counts


@functools.cache
def pair_stiffness_function(scalar, law, half: bool, bonds: bool, subcycling: bool, lanes: int):
    """Return the function `add_pairs`, which sums stiffness K and damping C over the contacts and bonds of sphere i.

    The kind of neighbour list determines which pairs a thread adds:

    - Full list (GPU): a group of `lanes` threads shares the list of a sphere. Each thread adds every `lanes`-th pair
      that touches or is bonded.
    - Half list (CPU): a pair of spheres of one thread is listed once, and the thread adds it to both spheres. A pair
      of spheres of two threads is listed twice, once at each sphere, and each thread adds it to its own sphere only.

    With `subcycling`, the sums contain only pairs with stiff bonds (`stiff` true), or only the others. Listed pairs
    that neither touch nor are bonded add nothing. The sums therefore do not depend on the time of the last list
    rebuild.
    """
    t, structs = types(scalar), array_structs(scalar)
    Scenes, Bodies, Spheres, Pairs = structs.Scenes, structs.Bodies, structs.Spheres, structs.Pairs
    Estimate = estimate_struct(scalar)
    functions = law.functions(scalar)
    Parameters, stiffness = functions.Parameters, functions.stiffness
    Bond, bond_stiffness = bond_functions(scalar).Bond, bond_functions(scalar).bond_stiffness
    sphere_touch = contact_functions(scalar).sphere_touch
    matrices = stiffness_functions(scalar)
    outer, turning = matrices.outer, matrices.turning
    xyz = vector_functions(scalar).xyz
    rows = row_functions(scalar)
    read_int, read_vec3, read_vec4 = rows.read_int, rows.read_vec3, rows.read_vec4
    safe_normalize = vector_functions(scalar).safe_normalize
    counts = counting_function(scalar, bonds, subcycling)
    bits_of_group = group_functions(scalar, lanes).bits_of_group

    vec6 = wp.types.vector(6, scalar)

    @wp.struct
    class Sums:
        k: vec6
        c: vec6
        k_turn: vec6
        c_turn: vec6

    @wp.func
    def add_pair(
        sums: Sums, i: wp.int32, s: wp.int32, pair: wp.int32, first: wp.int32, last: wp.int32,
        parameters: wp.array(dtype=Parameters), bond_parameters: wp.array(dtype=Bond), scenes: Scenes, bodies: Bodies,
        spheres: Spheres, pairs: Pairs, estimate: Estimate,
    ):  # fmt: skip
        zero = scalar(0.0)
        body_base = scenes.row[s].bodies
        position_i, moving_i = read_vec4(spheres.position, i), read_vec4(spheres.velocity, i)
        xi, radius_i = xyz(position_i), position_i[3]
        row = scenes.row[s].laws + spheres.material[i] * scenes.row[s].materials
        arm_i = xi - read_vec3(bodies.position, body_base + spheres.body[i])
        j = scenes.row[s].spheres + decode(read_int(pairs.other, pair))
        position_j, moving_j = read_vec4(spheres.position, j), read_vec4(spheres.velocity, j)
        offset, radius_j = xyz(position_j) - xi, position_j[3]
        n = safe_normalize(offset, t.vec3(zero, zero, scalar(1.0)))
        touch = sphere_touch(
            n, wp.length(offset) - (radius_i + radius_j), xyz(moving_j) - xyz(moving_i), zero, radius_i, radius_j,
            moving_i[3], moving_j[3],
        )  # fmt: skip
        k = stiffness(parameters[row + read_int(spheres.material, j)], touch)
        held = t.vec4()
        if wp.static(bonds):
            bond = kind_of(read_int(pairs.bond, pair))
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
                centre = read_vec3(bodies.position, body_base + read_int(spheres.body, j))
                lever = xyz(position_j) - centre - radius_j * n
                estimate.sums[j, 0] = estimate.sums[j, 0] + block
                estimate.sums[j, 1] = estimate.sums[j, 1] + damping
                estimate.sums[j, 2] = estimate.sums[j, 2] + turning(lever, n, kn, ks, held[2], held[3])
                estimate.sums[j, 3] = estimate.sums[j, 3] + turning(lever, n, k[2], k[3], zero, zero)
        return sums

    @wp.func
    def add_pairs(
        i: wp.int32, s: wp.int32, lane: wp.int32, first: wp.int32, last: wp.int32, stiff: wp.bool,
        parameters: wp.array(dtype=Parameters), bond_parameters: wp.array(dtype=Bond), scenes: Scenes, bodies: Bodies,
        spheres: Spheres, pairs: Pairs, estimate: Estimate,
    ):  # fmt: skip
        sums = Sums()
        base = scenes.row[s].spheres
        begin = scenes.row[s].pairs + pairs.start[i + s]
        end = scenes.row[s].pairs + pairs.start[i + s + 1]
        if wp.static(half):
            for pair in range(begin, end):
                if counts(spheres, pairs, i, base, pair, stiff):
                    sums = add_pair(
                        sums, i, s, pair, first, last, parameters, bond_parameters, scenes, bodies, spheres, pairs,
                        estimate,
                    )  # fmt: skip
        else:
            # The threads of a group first search together for the pairs that count. Then they share these pairs evenly,
            # so that all threads evaluate pairs at the same time.
            # `others` is the number of pairs that this thread still leaves to the other threads before it evaluates a
            # pair itself.
            others = lane
            for block in range(begin, end, BLOCK):
                left = wp.int32(0)
                for place in range(lane, wp.min(BLOCK, end - block), wp.static(lanes)):
                    if counts(spheres, pairs, i, base, block + place, stiff):
                        left = left | (1 << place)
                left = bits_of_group(left)
                while left != 0:
                    while others > 0 and left != 0:
                        left = left & (left - 1)
                        others -= 1
                    if left != 0:
                        sums = add_pair(
                            sums, i, s, block + lowest_bit(left), first, last, parameters, bond_parameters, scenes,
                            bodies, spheres, pairs, estimate,
                        )  # fmt: skip
                        left = left & (left - 1)
                        others = wp.static(lanes) - 1
        return sums

    return SimpleNamespace(Sums=Sums, add_pairs=add_pairs)
