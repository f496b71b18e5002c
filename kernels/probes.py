"""What is measured: per-body and per-sphere contributions, to be summed in a fixed order."""

import functools

import warp as wp

from .contacts import decode
from .geometry import axis_functions
from .law_linear import law
from .types import types, vector_functions
from .wall_motion import PLANE, wall_struct

# Columns of the per-sphere contact sums.
CONTACTS = 0  # touching pairs
OVERLAP_SUM = 1  # of overlap over the smaller radius
OVERLAP_MAX = 2
ELASTIC_ENERGY = 3  # [J], springs
BOND_ENERGY = 4  # [J]
BONDED = 5  # pairs with a bond
VIRIAL = 6  # sum of normal spring force times branch vector of the bodies [J]
BONDED_HYDRATED = 7  # pairs with a bond of the second kind
CONTACT_COLUMNS = 8

# Columns of the per-body sums.
KINETIC = 0  # [J], at the middle of the last step
POTENTIAL = 1  # [J], gravity, from the origin
MOMENTUM = 2  # ..4 [kg m/s], at the middle of the last step
LIFT = 5  # ..7 sum of mass times position [kg m]
DRIVEN = 8  # ..10 sum of axis drive forces [N]
BODY_COLUMNS = 11


@functools.cache
def probe_kernels(scalar, half: bool, friction: bool, bonds: bool):
    """Kernels ``measure_bodies`` and ``measure_contacts``."""
    t = types(scalar)
    functions = law(scalar)
    ContactParameters = functions.ContactParameters
    BondParameters = functions.BondParameters
    normal_stiffness = functions.normal_stiffness
    xyz = vector_functions(scalar).xyz
    Wall = wall_struct(scalar)
    axis = axis_functions(scalar)
    Segment = axis.Segment
    closest_on_axis = axis.closest_on_axis

    @wp.kernel(module="unique", enable_backward=False)
    def measure_bodies(
        gravity: t.vec3,
        segments: wp.array(dtype=Segment),
        drive_axis: wp.array2d(dtype=wp.int32),
        drive_force: wp.array(dtype=scalar),
        body_group: wp.array(dtype=wp.int32),
        body_mass: wp.array(dtype=scalar),
        body_inertia: wp.array(dtype=t.vec3),
        body_position: wp.array(dtype=t.vec3),
        body_velocity: wp.array(dtype=t.vec3),
        body_spin: wp.array(dtype=t.vec3),
        body_orientation: wp.array(dtype=t.quat),
        body_id: wp.array(dtype=wp.int32),
        values: wp.array2d(dtype=wp.float64),
    ):
        b = wp.tid()
        row = body_id[b]  # summed in the order of permanent numbers
        mass = wp.float64(body_mass[b])
        x = wp.vec3d(body_position[b])
        v = wp.vec3d(body_velocity[b])
        local = wp.vec3d(wp.quat_rotate_inv(body_orientation[b], body_spin[b]))
        turning = wp.dot(wp.cw_mul(wp.vec3d(body_inertia[b]), local), local)
        values[row, 0] = wp.float64(0.5) * (mass * wp.dot(v, v) + turning)
        values[row, 1] = -mass * wp.dot(wp.vec3d(gravity), x)
        driven = wp.vec3d()
        group = body_group[b]
        if group > 0 and drive_axis[group, 1] > drive_axis[group, 0]:
            offset, tangent = closest_on_axis(segments, drive_axis[group, 0], drive_axis[group, 1], body_position[b])
            driven = wp.vec3d(drive_force[group] * tangent)
        for c in range(3):
            values[row, 2 + c] = mass * v[c]
            values[row, 5 + c] = mass * x[c]
            values[row, 8 + c] = driven[c]

    @wp.kernel(module="unique", enable_backward=False)
    def measure_contacts(
        contact_parameters: wp.array(dtype=ContactParameters),
        bond_parameters: wp.array(dtype=BondParameters),
        materials: wp.int32,
        walls: wp.array(dtype=Wall),
        analytic: wp.int32,
        segments: wp.array(dtype=Segment),
        wall_position: wp.array(dtype=t.vec3),
        wall_orientation: wp.array(dtype=t.quat),
        slot_shear: wp.array2d(dtype=t.vec3),
        slot_overlap: wp.array2d(dtype=scalar),
        slot_wall: wp.array2d(dtype=wp.int32),
        body_position: wp.array(dtype=t.vec3),
        sphere_body: wp.array(dtype=wp.int32),
        sphere_id: wp.array(dtype=wp.int32),
        sphere_position: wp.array(dtype=t.vec4),
        sphere_material: wp.array(dtype=wp.int32),
        pair_start: wp.array(dtype=wp.int32),
        pair_other: wp.array(dtype=wp.int32),
        pair_shear: wp.array(dtype=t.vec3),
        pair_bond: wp.array(dtype=wp.int32),
        pair_bond_force: wp.array(dtype=t.vec4),
        pair_bond_moment: wp.array(dtype=t.vec4),
        values: wp.array2d(dtype=wp.float64),
    ):
        i = wp.tid()
        row = sphere_id[i]
        for c in range(8):
            values[row, c] = wp.float64(0.0)
        xi = xyz(sphere_position[i])
        radius_i = sphere_position[i][3]
        for k in range(pair_start[i], pair_start[i + 1]):
            entry = pair_other[k]
            if wp.static(half) or entry >= 0:
                j = decode(entry)
                radius_j = sphere_position[j][3]
                length = radius_i + radius_j
                smaller = wp.min(radius_i, radius_j)
                offset = xyz(sphere_position[j]) - xi
                distance = wp.length(offset)
                overlap = length - distance
                if overlap > scalar(0.0):
                    p = contact_parameters[sphere_material[i] * materials + sphere_material[j]]
                    kn = normal_stiffness(p, smaller, length)
                    energy = scalar(0.5) * kn * overlap * overlap
                    if wp.static(friction):
                        energy += scalar(0.5) * wp.length_sq(pair_shear[k]) / (kn * p.shear_to_normal)
                    relative = wp.float64(overlap / smaller)
                    values[row, 0] = values[row, 0] + wp.float64(1.0)
                    values[row, 1] = values[row, 1] + relative
                    values[row, 2] = wp.max(values[row, 2], relative)
                    values[row, 3] = values[row, 3] + wp.float64(energy)
                    branch = body_position[sphere_body[j]] - body_position[sphere_body[i]]
                    if distance > scalar(0.0):
                        work = kn * overlap * wp.dot(branch, offset) / distance
                        values[row, 6] = values[row, 6] + wp.float64(work)
                if wp.static(bonds):
                    if pair_bond[k] > 0:
                        b = bond_parameters[pair_bond[k]]
                        r = b.radius_multiplier * smaller
                        area = scalar(3.141592653589793) * r * r
                        inertia = scalar(0.25) * area * r * r
                        stiffness = b.effective_modulus / length
                        f = pair_bond_force[k]
                        m = pair_bond_moment[k]
                        energy = f[3] * f[3] / area + wp.length_sq(xyz(f)) / (area * b.shear_to_normal)
                        energy += wp.length_sq(xyz(m)) / inertia
                        energy += m[3] * m[3] / (scalar(2.0) * inertia * b.shear_to_normal)
                        values[row, 4] = values[row, 4] + wp.float64(scalar(0.5) * energy / stiffness)
                        values[row, 5] = values[row, 5] + wp.float64(1.0)
                        if pair_bond[k] == 2:
                            values[row, 7] = values[row, 7] + wp.float64(1.0)
        for w in range(analytic):
            distance = scalar(0.0)
            if walls[w].kind == PLANE:
                n = wp.quat_rotate(wall_orientation[w], walls[w].normal)
                distance = wp.dot(xi - wall_position[w], n)
            else:
                offset, tangent = closest_on_axis(segments, walls[w].first, walls[w].last, xi - wall_position[w])
                distance = walls[w].radius - wp.length(offset)
            overlap = radius_i - distance
            if overlap > scalar(0.0):
                p = contact_parameters[sphere_material[i] * materials + walls[w].material]
                kn = normal_stiffness(p, radius_i, radius_i)
                energy = kn * overlap * overlap + wp.length_sq(slot_shear[i, w]) / (kn * p.shear_to_normal)
                values[row, 3] = values[row, 3] + wp.float64(scalar(0.5) * energy)

        for s in range(analytic, slot_wall.shape[1]):
            if slot_wall[i, s] >= 0:
                p = contact_parameters[sphere_material[i] * materials + walls[slot_wall[i, s]].material]
                kn = normal_stiffness(p, radius_i, radius_i)
                energy = kn * slot_overlap[i, s] * slot_overlap[i, s]
                energy += wp.length_sq(slot_shear[i, s]) / (kn * p.shear_to_normal)
                values[row, 3] = values[row, 3] + wp.float64(scalar(0.5) * energy)

    return measure_bodies, measure_contacts
