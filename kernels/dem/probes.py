"""Kernels that measure contacts, bodies and walls.

The measured quantities are columns of tables with one row per sphere, body or wall. Columns are always summed in the
same order, so results are reproducible.
"""

import functools

import warp as wp

from ..common.geometry import axis_functions
from ..common.rows import row_functions
from ..common.types import module_of, types, vector_functions
from ..common.walls import wall_functions
from .bond_parallel import HYDRATED, bond_functions, kind_of, load_row
from .contact_law import contact_functions
from .pairs import decode
from .structs import DT_PREVIOUS, array_structs

# The next constants are the indices of columns in a table with a row for each sphere. Each column holds a value that is
# summed over the sphere's contacts.
CONTACTS: int = wp.constant(0)  # column with the number of pairs in contact
OVERLAP_SUM: int = wp.constant(1)  # column with the sum over pairs of the overlap divided by the smaller radius

# OVERLAP_MAX is the column with the largest overlap divided by the smaller radius of the two spheres.
OVERLAP_MAX: int = wp.constant(2)
# ELASTIC_ENERGY is the column with the energy of contact springs, also at walls, at the middle of the last step [J].
ELASTIC_ENERGY: int = wp.constant(3)
BOND_ENERGY: int = wp.constant(4)  # column with the elastic energy of bonds [J]
BONDED: int = wp.constant(5)  # column with the number of bonded pairs

# VIRIAL is the column with the sum over pairs of the normal spring force times the distance of the centroids along the
# normal [N m].
VIRIAL: int = wp.constant(6)
BONDED_HYDRATED: int = wp.constant(7)  # column with the number of pairs joined by stiff bonds (hydrated contacts)

# DEPTH_MAX is the column with the largest ratio of an overlap to its permitted overlap. Between two spheres, the
# permitted overlap is reached when the larger sphere contains the smaller one, or when the distance of the centres is
# half their distance at first touch, whichever comes first. At a wall, the permitted overlap is the sphere's radius.
DEPTH_MAX: int = wp.constant(8)
BROKEN_TENSION: int = wp.constant(9)  # column with the number of bonds broken in tension since the start
BROKEN_SHEAR: int = wp.constant(10)  # column with the number of bonds broken in shear since the start
CONTACT_COLUMNS: int = wp.constant(11)
ContactRow = wp.types.vector(int(CONTACT_COLUMNS), wp.float64)
# Columns that are reduced to their largest value instead of their sum.
CONTACT_MAXIMA = (int(OVERLAP_MAX), int(DEPTH_MAX))

# The next constants are the indices of columns in a table with a row for each body. The columns are summed over the
# bodies.
KINETIC: int = wp.constant(0)  # column with the kinetic energy at the middle of the last step [J]

# POTENTIAL is the column with the potential energy of gravity, relative to the origin, at the middle of the last step
# [J].
POTENTIAL: int = wp.constant(1)
MOMENTUM: int = wp.constant(2)  # columns 2 to 4: momentum at the middle of the last step [kg m/s]
LIFT: int = wp.constant(5)  # columns 5 to 7: mass times position, from which the centroid of all bodies follows [kg m]
DRIVEN: int = wp.constant(8)  # columns 8 to 10: sum of the forces that drive bodies along the axis [N]
DRIVE_POWER: int = wp.constant(11)  # column with the power of the forces that drive bodies along the axis [W]
REACH: int = wp.constant(12)  # column with the largest absolute coordinate of any body [m]
BODY_COLUMNS: int = wp.constant(13)
BODY_MAXIMA = (int(REACH),)

# The next constants are the indices of columns in a table with a row for each wall.
IMPULSE: int = wp.constant(0)  # columns 0 to 5: impulse of force and moment about the wall's position [N s], [N m s]
FORCE: int = wp.constant(6)  # columns 6 to 11: force [N] and moment [N m] of the contacts on the wall
TURN: int = wp.constant(12)  # columns 12 to 15: orientation quaternion of the wall's frame
TRAVEL: int = wp.constant(16)  # column with the displacement of the wall along its path [m]
WORK: int = wp.constant(17)  # column with the work done by the wall on the concrete [J]
WALL_COLUMNS = 18

# Number of partial sums of each column. It is fixed, so that the order of summation depends only on the number of rows.
LANES = 256


@functools.cache
def column_kernels() -> tuple[wp.Kernel, wp.Kernel]:
    """Return two kernels that reduce every column of an array to its sum or maximum.

    Column c is reduced to its maximum if bit c of `maxima` is set. The first kernel reduces the rows to LANES partial
    results, and the second kernel reduces these to one result.
    """

    @wp.kernel(module=module_of("columns"), enable_backward=False)
    def partial(
        values: wp.array2d(dtype=wp.float64), rows: wp.int32, maxima: wp.int32, lanes: wp.array2d(dtype=wp.float64)
    ):
        lane, c = wp.tid()
        largest = ((maxima >> c) & 1) != 0
        total = wp.float64(0.0)
        for row in range(lane, rows, wp.static(LANES)):
            if largest:
                total = wp.max(total, values[row, c])
            else:
                total += values[row, c]
        lanes[lane, c] = total

    @wp.kernel(module=module_of("columns"), enable_backward=False)
    def whole(lanes: wp.array2d(dtype=wp.float64), maxima: wp.int32, sums: wp.array(dtype=wp.float64)):
        c = wp.tid()
        largest = ((maxima >> c) & 1) != 0
        total = wp.float64(0.0)
        for lane in range(wp.static(LANES)):
            if largest:
                total = wp.max(total, lanes[lane, c])
            else:
                total += lanes[lane, c]
        sums[c] = total

    return partial, whole


@functools.cache
def wall_probe(scalar) -> wp.Kernel:
    """Return the kernel over walls that writes a row with each wall's impulse, force, orientation, travel and work."""
    Walls = array_structs(scalar).Walls

    @wp.kernel(module="unique", enable_backward=False)
    def read_walls(walls: Walls, wall_values: wp.array2d(dtype=wp.float64)):
        w = wp.tid()
        for c in range(3):
            wall_values[w, IMPULSE + c] = walls.impulse[w][c]
            wall_values[w, IMPULSE + 3 + c] = walls.angular_impulse[w][c]
            wall_values[w, FORCE + c] = walls.force[w][c]
            wall_values[w, FORCE + 3 + c] = walls.moment[w][c]
        for c in range(4):
            wall_values[w, TURN + c] = wp.float64(walls.orientation[w][c])
        wall_values[w, TRAVEL] = walls.travel[w]
        wall_values[w, WORK] = walls.work[w]

    return read_walls


@functools.cache
def body_probe(scalar) -> wp.Kernel:
    """Return the kernel over the bodies of scene `s` that writes a row of measured values for each body.

    Rows are sorted by the bodies' permanent numbers.
    """
    structs = array_structs(scalar)
    Scenes, Bodies = structs.Scenes, structs.Bodies
    axis = axis_functions(scalar)
    Segment, closest_on_axis = axis.Segment, axis.closest_on_axis

    @wp.kernel(module="unique", enable_backward=False)
    def measure_bodies(
        # The next arguments are arrays of the model, which are constant during a run.
        segments: wp.array(dtype=Segment),
        drive_axis: wp.array2d(dtype=wp.int32),
        drive_force: wp.array(dtype=scalar),
        # The next arguments are arrays of the simulated state that this kernel only reads.
        s: wp.int32,
        scenes: Scenes,
        bodies: Bodies,
        # The next arguments are arrays that this kernel writes.
        values: wp.array2d(dtype=wp.float64),
    ):
        b = scenes.row[s].bodies + wp.tid()
        row = bodies.id[b]
        half = wp.float64(0.5)
        mass = wp.float64(bodies.mass[b])
        x = wp.vec3d(bodies.position[b])
        v = wp.vec3d(bodies.velocity[b])
        local = wp.vec3d(wp.quat_rotate_inv(bodies.orientation[b], bodies.spin[b]))
        turning = wp.dot(wp.cw_mul(wp.vec3d(bodies.inertia[b]), local), local)
        values[row, KINETIC] = half * (mass * wp.dot(v, v) + turning)
        lifted = x - half * scenes.clock[s, DT_PREVIOUS] * v
        values[row, POTENTIAL] = -mass * wp.dot(wp.vec3d(scenes.row[s].gravity), lifted)
        driven = wp.vec3d()
        group = scenes.row[s].groups + bodies.group[b]
        if bodies.group[b] > 0 and drive_axis[group, 1] > drive_axis[group, 0]:
            offset, tangent = closest_on_axis(segments, drive_axis[group, 0], drive_axis[group, 1], bodies.position[b])
            driven = wp.vec3d(drive_force[group] * tangent)
        for c in range(3):
            values[row, MOMENTUM + c] = mass * v[c]
            values[row, LIFT + c] = mass * x[c]
            values[row, DRIVEN + c] = driven[c]
        values[row, DRIVE_POWER] = wp.dot(driven, v)
        values[row, REACH] = wp.max(wp.abs(x))

    return measure_bodies


@functools.cache
def pair_probe_function(scalar, law, history: bool, bonds: bool):
    """Return the function `measure_pair`, which measures one pair of spheres.

    It returns the pair's normal force [N], and adds the pair's energies and other quantities to the columns of `sums`.
    """
    t = types(scalar)
    structs = array_structs(scalar)
    Scenes, Bodies, Spheres, Pairs = structs.Scenes, structs.Bodies, structs.Spheres, structs.Pairs
    functions = law.functions(scalar)
    Parameters, pair_energy, pair_force = functions.Parameters, functions.energy, functions.force
    rolls = law.rolls
    moment_energy = functions.moment_energy if rolls else None
    sphere_touch = contact_functions(scalar).sphere_touch
    Bond, bond_energy = bond_functions(scalar).Bond, bond_functions(scalar).bond_energy
    xyz = vector_functions(scalar).xyz
    safe_normalize = vector_functions(scalar).safe_normalize
    read_half = row_functions(scalar).read_half

    @wp.func
    def measure_pair(
        i: wp.int32,
        j: wp.int32,
        s: wp.int32,
        k: wp.int32,
        parameters: wp.array(dtype=Parameters),
        bond_parameters: wp.array(dtype=Bond),
        scenes: Scenes,
        bodies: Bodies,
        spheres: Spheres,
        pairs: Pairs,
        sums: ContactRow,
    ):
        zero = scalar(0.0)
        normal_force = zero
        half_step = scalar(0.5) * scalar(scenes.clock[s, DT_PREVIOUS])
        radius_i = spheres.position[i][3]
        radius_j = spheres.position[j][3]
        mass_i = spheres.velocity[i][3]
        mass_j = spheres.velocity[j][3]
        smaller = wp.min(radius_i, radius_j)
        offset = xyz(spheres.position[j]) - xyz(spheres.position[i])
        overlap = radius_i + radius_j - wp.length(offset)
        n = safe_normalize(offset, t.vec3(zero, zero, scalar(1.0)))
        middle = half_step * wp.dot(xyz(spheres.velocity[j]) - xyz(spheres.velocity[i]), n) + overlap
        p = parameters[scenes.row[s].laws + spheres.material[i] * scenes.row[s].materials + spheres.material[j]]
        if overlap > zero:
            relative = wp.float64(overlap / smaller)
            sums[CONTACTS] += wp.float64(1.0)
            sums[OVERLAP_SUM] += relative
            sums[OVERLAP_MAX] = wp.max(sums[OVERLAP_MAX], relative)
            deep = wp.float64(overlap / wp.min(scalar(2.0) * smaller, scalar(0.5) * (radius_i + radius_j)))
            sums[DEPTH_MAX] = wp.max(sums[DEPTH_MAX], deep)
            touch = sphere_touch(n, -overlap, t.vec3(), zero, radius_i, radius_j, mass_i, mass_j)
            push, unused, unused_loss = pair_force(p, touch, t.vec3(), zero)
            normal_force = -wp.dot(push, n)
            first_body = scenes.row[s].bodies
            branch = bodies.position[first_body + spheres.body[j]] - bodies.position[first_body + spheres.body[i]]
            sums[VIRIAL] -= wp.float64(wp.dot(push, n) * wp.dot(branch, n))
        if middle > zero:
            held = t.vec3()
            if wp.static(history):
                held = xyz(pairs.history[k])
            touch = sphere_touch(n, -middle, t.vec3(), zero, radius_i, radius_j, mass_i, mass_j)
            sums[ELASTIC_ENERGY] += wp.float64(pair_energy(p, touch, held))
            if wp.static(rolls):
                turned = moment_energy(p, touch, pairs.rolling[k])
                sums[ELASTIC_ENERGY] += wp.float64(turned)
        if wp.static(bonds):
            kind = kind_of(pairs.bond[k])
            if kind > 0:
                row = scenes.row[s].loads + load_row(pairs.bond[k])
                touch = sphere_touch(n, zero, t.vec3(), zero, radius_i, radius_j, mass_i, mass_j)
                b = bond_parameters[scenes.row[s].bonds + kind]
                stored = bond_energy(b, touch, read_half(pairs.load, row, 0), read_half(pairs.load, row, 1))
                sums[BOND_ENERGY] += wp.float64(stored)
                sums[BONDED] += wp.float64(1.0)
                if kind == HYDRATED:
                    sums[BONDED_HYDRATED] += wp.float64(1.0)
        return normal_force, sums

    return measure_pair


@functools.cache
def load_probe(scalar) -> wp.Kernel:
    """Return the kernel over the spheres of scene `s` that updates the largest normal force on each body.

    :func:`contact_probe` supplies the normal forces of the pairs of spheres.
    """
    structs = array_structs(scalar)
    Scenes, Spheres, Pairs = structs.Scenes, structs.Spheres, structs.Pairs

    @wp.kernel(module="unique", enable_backward=False)
    def raise_loads(
        s: wp.int32,
        # The next arguments are arrays of the simulated state that this kernel only reads.
        scenes: Scenes,
        spheres: Spheres,
        pairs: Pairs,
        pair_normal_force: wp.array(dtype=scalar),
        # The next arguments are arrays that this kernel writes.
        loads: wp.array(dtype=scalar),
    ):
        base = scenes.row[s].spheres
        i = base + wp.tid()
        first_entry = scenes.row[s].pairs
        for k in range(first_entry + pairs.start[i + s], first_entry + pairs.start[i + s + 1]):
            force = pair_normal_force[k - first_entry]
            if force > scalar(0.0):
                wp.atomic_max(loads, spheres.body[i], force)
                wp.atomic_max(loads, spheres.body[base + decode(pairs.other[k])], force)

    return raise_loads


@functools.cache
def contact_probe(scalar, pair_law, wall_law, half: bool, history: bool, bonds: bool) -> wp.Kernel:
    """Return the kernel that sums energies, overlaps and other values over the contacts of each sphere of scene `s`.

    The result has one row per sphere, ordered by permanent number. The kernel also writes the normal force of each
    pair.
    """
    t = types(scalar)
    structs = array_structs(scalar)
    Scenes, Bodies, Spheres, Slots = structs.Scenes, structs.Bodies, structs.Spheres, structs.Slots
    Pairs, Walls = structs.Pairs, structs.Walls
    PairParameters = pair_law.functions(scalar).Parameters
    WallParameters, wall_energy = wall_law.functions(scalar).Parameters, wall_law.functions(scalar).energy
    Bond = bond_functions(scalar).Bond
    rolls = wall_law.rolls
    wall_moment_energy = wall_law.functions(scalar).moment_energy if rolls else None
    measure_pair = pair_probe_function(scalar, pair_law, history, bonds)
    wall_touch = contact_functions(scalar).wall_touch
    shape = wall_functions(scalar)
    Segment, distance_to_wall, into_wall = shape.Segment, shape.distance_to_wall, shape.into_wall
    xyz = vector_functions(scalar).xyz

    @wp.kernel(module="unique", enable_backward=False)
    def measure_contacts(
        # The next arguments are arrays of the model, which are constant during a run.
        pair_parameters: wp.array(dtype=PairParameters),
        bond_parameters: wp.array(dtype=Bond),
        wall_parameters: wp.array(dtype=WallParameters),
        segments: wp.array(dtype=Segment),
        # The next arguments are the scene, and the range of spheres that this launch processes.
        s: wp.int32,
        first: wp.int32,
        last: wp.int32,
        # The next arguments are arrays of the simulated state that this kernel only reads.
        scenes: Scenes,
        bodies: Bodies,
        spheres: Spheres,
        slots: Slots,
        pairs: Pairs,
        walls: Walls,
        # The next arguments are arrays that this kernel writes.
        values: wp.array2d(dtype=wp.float64),
        pair_normal_force: wp.array(dtype=scalar),
    ):
        i = first + wp.tid()
        zero = scalar(0.0)
        base = scenes.row[s].spheres
        half_step = scalar(0.5) * scalar(scenes.clock[s, DT_PREVIOUS])
        sums = ContactRow()
        if wp.static(bonds):
            sums[BROKEN_TENSION] = wp.float64(spheres.broken[i][0])
            sums[BROKEN_SHEAR] = wp.float64(spheres.broken[i][1])
        x = xyz(spheres.position[i])
        radius = spheres.position[i][3]
        velocity = xyz(spheres.velocity[i])
        first_entry = scenes.row[s].pairs
        for k in range(first_entry + pairs.start[i + s], first_entry + pairs.start[i + s + 1]):
            entry = pairs.other[k]
            j = base + decode(entry)
            counts = entry >= 0
            if wp.static(half):
                counts = counts or (j >= first and j < last)
            normal_force = zero
            if counts:
                normal_force, sums = measure_pair(
                    i, j, s, k, pair_parameters, bond_parameters, scenes, bodies, spheres, pairs, sums
                )
            pair_normal_force[k - first_entry] = normal_force
        material = scenes.row[s].laws + spheres.material[i] * scenes.row[s].materials
        for slot in range(slots.history.shape[1]):
            w = scenes.row[s].walls + slot
            n = t.vec3()  # Unit normal that points into the wall.
            overlap = scalar(-1.0)
            towards = half_step
            known = slot < scenes.row[s].analytic
            if known:
                distance, direction = distance_to_wall(walls.table[w], segments, walls.position[w], walls.normal[w], x)
                n = into_wall(walls.table[w], direction)
                overlap = radius - distance
            else:
                known = slots.wall[i, slot] >= 0
                # The energy is measured at the middle of the last step. A mesh contact stores the overlap at the start
                # of the step, which is half a step earlier.
                towards = -half_step
                if known:
                    w = scenes.row[s].walls + slots.wall[i, slot]
                    n = slots.normal[i, slot]
                    overlap = slots.overlap[i, slot]
            if known:
                middle = overlap + towards * wp.dot(walls.velocity[w] - velocity, n)
                sums[DEPTH_MAX] = wp.max(sums[DEPTH_MAX], wp.float64(overlap / radius))
                if middle > zero and wp.length_sq(n) > zero:
                    touch = wall_touch(n, -middle, t.vec3(), zero, radius, spheres.velocity[i][3])
                    p_wall = wall_parameters[material + walls.table[w].material]
                    stored = wall_energy(p_wall, touch, slots.history[i, slot])
                    if wp.static(rolls):
                        stored += wall_moment_energy(p_wall, touch, slots.rolling[i, slot])
                    sums[ELASTIC_ENERGY] += wp.float64(stored)
        row = spheres.id[i]
        for c in range(CONTACT_COLUMNS):
            values[row, c] = sums[c]

    return measure_contacts
