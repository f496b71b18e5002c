"""Stable step from masses and live stiffness, bonds included (conventions of PFC 5.0).

For each body: the stiffness matrix of its touching or bonded contacts, translation by its largest absolute
row sum; likewise the rotational stiffness matrix (lever arms of contacts, moments of bonds) in principal axes,
scaled by the moments of inertia. The dashpot with critical ratio beta stiffens k to
k / (sqrt(1 + beta^2) - beta)^2. The step is min sqrt(m / k).
"""

import functools

import warp as wp

from .contacts import decode
from .geometry import axis_functions
from .law_linear import law
from .types import types, vector_functions
from .wall_motion import PLANE, wall_struct


@functools.cache
def timestep_kernels(scalar, half: bool, bonds: bool):
    """Kernels ``gather`` over spheres (stiffness sums) and ``reduce`` over bodies (smallest step)."""
    t = types(scalar)
    functions = law(scalar)
    ContactParameters = functions.ContactParameters
    BondParameters = functions.BondParameters
    normal_stiffness = functions.normal_stiffness
    xyz = vector_functions(scalar).xyz
    safe_normalize = vector_functions(scalar).safe_normalize
    Wall = wall_struct(scalar)
    axis = axis_functions(scalar)
    Segment = axis.Segment
    closest_on_axis = axis.closest_on_axis

    @wp.func
    def damped(p: ContactParameters, k: scalar):
        one = scalar(1.0)
        beta = wp.max(p.damping_normal, p.damping_shear)
        root = wp.sqrt(one + beta * beta) - beta
        return k / (root * root)

    @wp.func
    def outer(n: t.vec3, kn: scalar, ks: scalar):
        return (kn - ks) * wp.outer(n, n) + ks * wp.identity(n=3, dtype=scalar)

    @wp.func
    def turning(r: t.vec3, n: t.vec3, kn: scalar, ks: scalar, bending: scalar, torsion: scalar):
        # Stiffness against rotation of a contact at `r` from the centroid: springs at the end of the lever,
        # and the bond's own moments.
        c = wp.cross(r, n)
        levers = wp.length_sq(r) * wp.identity(n=3, dtype=scalar) - wp.outer(r, r)
        return (kn - ks) * wp.outer(c, c) + ks * levers + outer(n, torsion, bending)

    @wp.func
    def load_wall(
        wall_load: wp.array2d(dtype=wp.int64), w: wp.int32, p: ContactParameters, radius: scalar, mass: scalar
    ):
        # Stiffness [mN/m] and damping [mN s/m] that a wall meets; whole numbers add up the same in any order.
        k = normal_stiffness(p, radius, radius)
        c = scalar(2.0) * p.damping_normal * wp.sqrt(mass * k)
        wp.atomic_add(wall_load, w, 0, wp.int64(wp.float64(k) * wp.float64(1000.0)))
        wp.atomic_add(wall_load, w, 1, wp.int64(wp.float64(c) * wp.float64(1000.0)))

    @wp.kernel(module="unique", enable_backward=False)
    def gather(
        contact_parameters: wp.array(dtype=ContactParameters),
        bond_parameters: wp.array(dtype=BondParameters),
        materials: wp.int32,
        walls: wp.array(dtype=Wall),
        analytic: wp.int32,
        segments: wp.array(dtype=Segment),
        wall_position: wp.array(dtype=t.vec3),
        wall_orientation: wp.array(dtype=t.quat),
        body_position: wp.array(dtype=t.vec3),
        body_mass: wp.array(dtype=scalar),
        sphere_body: wp.array(dtype=wp.int32),
        sphere_position: wp.array(dtype=t.vec4),
        sphere_material: wp.array(dtype=wp.int32),
        slot_wall: wp.array2d(dtype=wp.int32),
        slot_normal: wp.array2d(dtype=t.vec3),
        pair_start: wp.array(dtype=wp.int32),
        pair_other: wp.array(dtype=wp.int32),
        pair_bond: wp.array(dtype=wp.int32),
        translation: wp.array(dtype=t.mat33),
        rotation: wp.array(dtype=t.mat33),
        wall_load: wp.array2d(dtype=wp.int64),
    ):
        i = wp.tid()
        xi = xyz(sphere_position[i])
        radius_i = sphere_position[i][3]
        row = sphere_material[i] * materials
        arm_i = xi - body_position[sphere_body[i]]
        sum_i = t.mat33()
        turn_i = t.mat33()
        for k in range(pair_start[i], pair_start[i + 1]):
            j = decode(pair_other[k])
            offset = xyz(sphere_position[j]) - xi
            radius_j = sphere_position[j][3]
            length = radius_i + radius_j
            touching = wp.length_sq(offset) < length * length
            bond = wp.int32(0)
            if wp.static(bonds):
                bond = pair_bond[k]
            if touching or bond > 0:
                smaller = wp.min(radius_i, radius_j)
                p = contact_parameters[row + sphere_material[j]]
                kn = damped(p, normal_stiffness(p, smaller, length))
                ks = kn * p.shear_to_normal
                bending = scalar(0.0)
                torsion = scalar(0.0)
                if wp.static(bonds):
                    if bond > 0:
                        b = bond_parameters[bond]
                        r = b.radius_multiplier * smaller
                        area = scalar(3.141592653589793) * r * r
                        kb = b.effective_modulus / length * area
                        kn += kb
                        ks += kb * b.shear_to_normal
                        bending = scalar(0.25) * kb * r * r
                        torsion = scalar(2.0) * bending * b.shear_to_normal
                n = safe_normalize(offset, t.vec3(scalar(0.0), scalar(0.0), scalar(1.0)))
                block = outer(n, kn, ks)
                sum_i += block
                turn_i += turning(arm_i + radius_i * n, n, kn, ks, bending, torsion)
                if wp.static(half):
                    arm_j = xyz(sphere_position[j]) - body_position[sphere_body[j]]
                    translation[j] = translation[j] + block
                    rotation[j] = rotation[j] + turning(arm_j - radius_j * n, n, kn, ks, bending, torsion)
        for w in range(analytic):
            n = t.vec3()
            distance = scalar(0.0)
            if walls[w].kind == PLANE:
                n = wp.quat_rotate(wall_orientation[w], walls[w].normal)
                distance = wp.dot(xi - wall_position[w], n)
            else:
                offset, tangent = closest_on_axis(segments, walls[w].first, walls[w].last, xi - wall_position[w])
                n = -safe_normalize(offset, t.vec3(scalar(0.0), scalar(0.0), scalar(1.0)))
                distance = walls[w].radius - wp.length(offset)
            if distance < radius_i:
                p = contact_parameters[row + walls[w].material]
                kn = damped(p, normal_stiffness(p, radius_i, radius_i))
                ks = kn * p.shear_to_normal
                sum_i += outer(n, kn, ks)
                turn_i += turning(arm_i - radius_i * n, n, kn, ks, scalar(0.0), scalar(0.0))
                load_wall(wall_load, w, p, radius_i, body_mass[sphere_body[i]])
        for s in range(analytic, slot_wall.shape[1]):
            w = slot_wall[i, s]
            if w >= 0:
                n = slot_normal[i, s]
                p = contact_parameters[row + walls[w].material]
                kn = damped(p, normal_stiffness(p, radius_i, radius_i))
                ks = kn * p.shear_to_normal
                sum_i += outer(n, kn, ks)
                turn_i += turning(arm_i + radius_i * n, n, kn, ks, scalar(0.0), scalar(0.0))
                load_wall(wall_load, w, p, radius_i, body_mass[sphere_body[i]])
        translation[i] = translation[i] + sum_i
        rotation[i] = rotation[i] + turn_i

    @wp.kernel(module="unique", enable_backward=False)
    def reduce(
        contact_parameters: wp.array(dtype=ContactParameters),
        materials: wp.int32,
        body_mass: wp.array(dtype=scalar),
        body_inertia: wp.array(dtype=t.vec3),
        body_orientation: wp.array(dtype=t.quat),
        body_first: wp.array(dtype=wp.int32),
        sphere_position: wp.array(dtype=t.vec4),
        sphere_material: wp.array(dtype=wp.int32),
        translation: wp.array(dtype=t.mat33),
        rotation: wp.array(dtype=t.mat33),
        smallest: wp.array(dtype=wp.float64),
    ):
        b = wp.tid()
        total = t.mat33()
        turn = t.mat33()
        floor = scalar(0.0)
        for s in range(body_first[b], body_first[b + 1]):
            total += translation[s]
            turn += rotation[s]
            translation[s] = t.mat33()
            rotation[s] = t.mat33()
            # A body in flight must survive its next touch: never less than one contact.
            radius = sphere_position[s][3]
            for m in range(materials):
                p = contact_parameters[sphere_material[s] * materials + m]
                floor = wp.max(floor, damped(p, normal_stiffness(p, radius, radius)))
        k = floor
        for r in range(3):
            k = wp.max(k, wp.abs(total[r, 0]) + wp.abs(total[r, 1]) + wp.abs(total[r, 2]))
        step = wp.sqrt(body_mass[b] / k)
        axes = wp.quat_to_matrix(body_orientation[b])
        local = wp.transpose(axes) * turn * axes
        inertia = body_inertia[b]
        spin = scalar(0.0)
        for r in range(3):
            row = scalar(0.0)
            for c in range(3):
                row += wp.abs(local[r, c]) / wp.sqrt(inertia[r] * inertia[c])
            spin = wp.max(spin, row)
        if spin > scalar(0.0):
            step = wp.min(step, scalar(1.0) / wp.sqrt(spin))
        wp.atomic_min(smallest, 0, wp.float64(step))

    return gather, reduce
