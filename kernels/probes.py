"""What is measured: per-body and per-sphere contributions, to be summed in a fixed order."""

import functools

import warp as wp

from .bond_parallel import bond_functions
from .contact_law import contact_functions
from .contacts import decode
from .geometry import axis_functions
from .types import DT_PREVIOUS, scene_struct, types, vector_functions
from .wall_motion import PLANE, wall_struct

# Columns of the per-sphere contact sums.
CONTACTS = wp.constant(0)  # touching pairs
OVERLAP_SUM = wp.constant(1)  # of overlap over the smaller radius
OVERLAP_MAX = wp.constant(2)
ELASTIC_ENERGY = wp.constant(3)  # [J], springs, walls included, at the middle of the last step
BOND_ENERGY = wp.constant(4)  # [J]
BONDED = wp.constant(5)  # pairs with a bond
VIRIAL = wp.constant(6)  # sum of normal spring force times branch vector of the bodies [J]
BONDED_HYDRATED = wp.constant(7)  # pairs with a bond of the second kind
DEPTH_MAX = wp.constant(
    8
)  # overlap over what swallows a sphere whole or halves the centres' distance; on walls over the radius
BROKEN_TENSION = wp.constant(9)  # bonds broken by tension since the start
BROKEN_SHEAR = wp.constant(10)  # bonds broken by shear since the start
CONTACT_COLUMNS = wp.constant(11)
CONTACT_MAXIMA = (int(OVERLAP_MAX), int(DEPTH_MAX))  # of these columns the largest counts, of the others the sum

# Columns of the per-body sums.
KINETIC = wp.constant(0)  # [J], at the middle of the last step
POTENTIAL = wp.constant(1)  # [J], gravity, from the origin, at the middle of the last step
MOMENTUM = wp.constant(2)  # ..4 [kg m/s], at the middle of the last step
LIFT = wp.constant(5)  # ..7 sum of mass times position [kg m]
DRIVEN = wp.constant(8)  # ..10 sum of axis drive forces [N]
DRIVE_POWER = wp.constant(11)  # of the axis drives [W]
REACH = wp.constant(12)  # largest coordinate [m]
BODY_COLUMNS = wp.constant(13)
BODY_MAXIMA = (int(REACH),)

LANES = 256  # partial sums of a column; their order, and so the bits of a sum, depends on the number of rows only


@functools.cache
def column_kernels(maxima: tuple[int, ...]):
    """Kernels that add up (or take the maximum of) every column: rows to LANES partial results, then those."""
    bits = sum(1 << c for c in maxima)

    @wp.kernel(module="unique", enable_backward=False)
    def partial(values: wp.array2d(dtype=wp.float64), rows: wp.int32, lanes: wp.array2d(dtype=wp.float64)):
        lane, c = wp.tid()
        largest = ((wp.static(bits) >> c) & 1) != 0
        total = wp.float64(0.0)
        for row in range(lane, rows, wp.static(LANES)):
            if largest:
                total = wp.max(total, values[row, c])
            else:
                total += values[row, c]
        lanes[lane, c] = total

    @wp.kernel(module="unique", enable_backward=False)
    def whole(lanes: wp.array2d(dtype=wp.float64), sums: wp.array(dtype=wp.float64)):
        c = wp.tid()
        largest = ((wp.static(bits) >> c) & 1) != 0
        total = wp.float64(0.0)
        for lane in range(wp.static(LANES)):
            if largest:
                total = wp.max(total, lanes[lane, c])
            else:
                total += lanes[lane, c]
        sums[c] = total

    return partial, whole


@functools.cache
def body_probe(scalar):
    """Kernel over the bodies of one scene: a row of values each, in the order of permanent numbers."""
    t = types(scalar)
    SceneRow = scene_struct(scalar)
    axis = axis_functions(scalar)
    Segment = axis.Segment
    closest_on_axis = axis.closest_on_axis

    @wp.kernel(module="unique", enable_backward=False)
    def measure_bodies(
        scenes: wp.array(dtype=SceneRow),
        s: wp.int32,
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
        clock: wp.array2d(dtype=wp.float64),
        values: wp.array2d(dtype=wp.float64),
    ):
        b = scenes[s].bodies + wp.tid()
        row = body_id[b]
        half = wp.float64(0.5)
        mass = wp.float64(body_mass[b])
        x = wp.vec3d(body_position[b])
        v = wp.vec3d(body_velocity[b])
        local = wp.vec3d(wp.quat_rotate_inv(body_orientation[b], body_spin[b]))
        turning = wp.dot(wp.cw_mul(wp.vec3d(body_inertia[b]), local), local)
        values[row, KINETIC] = half * (mass * wp.dot(v, v) + turning)
        values[row, POTENTIAL] = -mass * wp.dot(wp.vec3d(scenes[s].gravity), x - half * clock[s, DT_PREVIOUS] * v)
        driven = wp.vec3d()
        group = scenes[s].groups + body_group[b]
        if body_group[b] > 0 and drive_axis[group, 1] > drive_axis[group, 0]:
            offset, tangent = closest_on_axis(segments, drive_axis[group, 0], drive_axis[group, 1], body_position[b])
            driven = wp.vec3d(drive_force[group] * tangent)
        for c in range(3):
            values[row, MOMENTUM + c] = mass * v[c]
            values[row, LIFT + c] = mass * x[c]
            values[row, DRIVEN + c] = driven[c]
        values[row, DRIVE_POWER] = wp.dot(driven, v)
        values[row, REACH] = wp.max(wp.abs(x))

    return measure_bodies


@functools.cache
def contact_probe(scalar, pair_law, wall_law, half: bool, history: bool, bonds: bool):
    """Kernel over spheres of one scene: a row of values each, by permanent numbers, and each pair's normal force."""
    t = types(scalar)
    SceneRow = scene_struct(scalar)
    PairParameters = pair_law(scalar).Parameters
    WallParameters = wall_law(scalar).Parameters
    pair_energy = pair_law(scalar).energy
    pair_force = pair_law(scalar).force
    wall_energy = wall_law(scalar).energy
    sphere_touch = contact_functions(scalar).sphere_touch
    wall_touch = contact_functions(scalar).wall_touch
    Bond = bond_functions(scalar).Bond
    bond_energy = bond_functions(scalar).bond_energy
    xyz = vector_functions(scalar).xyz
    safe_normalize = vector_functions(scalar).safe_normalize
    Wall = wall_struct(scalar)
    axis = axis_functions(scalar)
    Segment = axis.Segment
    closest_on_axis = axis.closest_on_axis

    @wp.kernel(module="unique", enable_backward=False)
    def measure_contacts(
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
        slot_history: wp.array2d(dtype=t.vec3),
        slot_normal: wp.array2d(dtype=t.vec3),
        slot_overlap: wp.array2d(dtype=scalar),
        slot_wall: wp.array2d(dtype=wp.int32),
        slots: wp.int32,
        body_position: wp.array(dtype=t.vec3),
        sphere_body: wp.array(dtype=wp.int32),
        sphere_id: wp.array(dtype=wp.int32),
        sphere_position: wp.array(dtype=t.vec4),
        sphere_velocity: wp.array(dtype=t.vec4),
        sphere_material: wp.array(dtype=wp.int32),
        pair_start: wp.array(dtype=wp.int32),
        pair_other: wp.array(dtype=wp.int32),
        pair_history: wp.array(dtype=t.vec3),
        pair_bond: wp.array(dtype=wp.int32),
        pair_bond_force: wp.array(dtype=t.vec4),
        pair_bond_moment: wp.array(dtype=t.vec4),
        sphere_broken: wp.array(dtype=wp.vec2i),
        clock: wp.array2d(dtype=wp.float64),
        values: wp.array2d(dtype=wp.float64),
        pair_normal_force: wp.array(dtype=scalar),
    ):
        i = first + wp.tid()
        zero = scalar(0.0)
        base = scenes[s].spheres
        bodies = scenes[s].bodies
        materials = scenes[s].materials
        half_step = scalar(0.5) * scalar(clock[s, DT_PREVIOUS])
        row = sphere_id[i]
        for c in range(CONTACT_COLUMNS):
            values[row, c] = wp.float64(0.0)
        if wp.static(bonds):
            values[row, BROKEN_TENSION] = wp.float64(sphere_broken[i][0])
            values[row, BROKEN_SHEAR] = wp.float64(sphere_broken[i][1])
        xi = xyz(sphere_position[i])
        radius_i = sphere_position[i][3]
        velocity_i = xyz(sphere_velocity[i])
        mass_i = sphere_velocity[i][3]
        material = scenes[s].laws + sphere_material[i] * materials
        pairs = scenes[s].pairs
        for k in range(pairs + pair_start[i + s], pairs + pair_start[i + s + 1]):
            entry = pair_other[k]
            j = base + decode(entry)
            radius_j = sphere_position[j][3]
            smaller = wp.min(radius_i, radius_j)
            offset = xyz(sphere_position[j]) - xi
            overlap = radius_i + radius_j - wp.length(offset)
            pair_normal_force[k - pairs] = zero
            counts = entry >= 0
            if wp.static(half):
                counts = counts or (j >= first and j < last)
            if counts:
                n = safe_normalize(offset, t.vec3(zero, zero, scalar(1.0)))
                middle = half_step * wp.dot(xyz(sphere_velocity[j]) - velocity_i, n) + overlap
                p = pair_parameters[material + sphere_material[j]]
                mass_j = sphere_velocity[j][3]
                if overlap > zero:
                    relative = wp.float64(overlap / smaller)
                    values[row, CONTACTS] = values[row, CONTACTS] + wp.float64(1.0)
                    values[row, OVERLAP_SUM] = values[row, OVERLAP_SUM] + relative
                    values[row, OVERLAP_MAX] = wp.max(values[row, OVERLAP_MAX], relative)
                    deep = wp.float64(overlap / wp.min(scalar(2.0) * smaller, scalar(0.5) * (radius_i + radius_j)))
                    values[row, DEPTH_MAX] = wp.max(values[row, DEPTH_MAX], deep)
                    touch = sphere_touch(n, -overlap, t.vec3(), zero, radius_i, radius_j, mass_i, mass_j)
                    push, unused, unused_loss = pair_force(p, touch, t.vec3(), zero)
                    pair_normal_force[k - pairs] = -wp.dot(push, n)
                    branch = body_position[bodies + sphere_body[j]] - body_position[bodies + sphere_body[i]]
                    values[row, VIRIAL] = values[row, VIRIAL] - wp.float64(wp.dot(push, n) * wp.dot(branch, n))
                if middle > zero:
                    held = t.vec3()
                    if wp.static(history):
                        held = pair_history[k]
                    touch = sphere_touch(n, -middle, t.vec3(), zero, radius_i, radius_j, mass_i, mass_j)
                    values[row, ELASTIC_ENERGY] = values[row, ELASTIC_ENERGY] + wp.float64(pair_energy(p, touch, held))
                if wp.static(bonds):
                    if pair_bond[k] > 0:
                        touch = sphere_touch(n, zero, t.vec3(), zero, radius_i, radius_j, mass_i, mass_j)
                        b = bond_parameters[scenes[s].bonds + pair_bond[k]]
                        stored = bond_energy(b, touch, pair_bond_force[k], pair_bond_moment[k])
                        values[row, BOND_ENERGY] = values[row, BOND_ENERGY] + wp.float64(stored)
                        values[row, BONDED] = values[row, BONDED] + wp.float64(1.0)
                        if pair_bond[k] == 2:
                            values[row, BONDED_HYDRATED] = values[row, BONDED_HYDRATED] + wp.float64(1.0)
        for slot in range(slots):
            w = scenes[s].walls + slot
            n = t.vec3()  # into the wall
            overlap = scalar(-1.0)
            towards = half_step
            known = slot < scenes[s].analytic
            if known:
                if walls[w].kind == PLANE:
                    n = -wall_normal[w]
                    overlap = radius_i + wp.dot(xi - wall_position[w], n)
                else:
                    offset, tangent = closest_on_axis(segments, walls[w].first, walls[w].last, xi - wall_position[w])
                    n = safe_normalize(offset, t.vec3(zero, zero, scalar(1.0)))
                    overlap = radius_i + wp.length(offset) - walls[w].radius
            else:
                known = slot_wall[i, slot] >= 0
                towards = -half_step  # a mesh's overlap is that of the step's start
                if known:
                    w = scenes[s].walls + slot_wall[i, slot]
                    n = slot_normal[i, slot]
                    overlap = slot_overlap[i, slot]
            if known:
                middle = overlap + towards * wp.dot(wall_velocity[w] - velocity_i, n)
                values[row, DEPTH_MAX] = wp.max(values[row, DEPTH_MAX], wp.float64(overlap / radius_i))
                if middle > zero and wp.length_sq(n) > zero:
                    touch = wall_touch(n, -middle, t.vec3(), zero, radius_i, mass_i)
                    p_wall = wall_parameters[material + walls[w].material]
                    stored = wall_energy(p_wall, touch, slot_history[i, slot])
                    values[row, ELASTIC_ENERGY] = values[row, ELASTIC_ENERGY] + wp.float64(stored)

    return measure_contacts
