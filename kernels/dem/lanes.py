"""Vectorised contact forces on a CPU: contacts are gathered into lanes and evaluated with vector instructions.

The inputs of LANES contacts are first copied into columns, one column for each scalar quantity (structure of arrays).
The contact law then runs in a loop over the lanes that reads and writes only columns. The compiler turns this loop into
vector instructions: eight contacts at a time in single precision with AVX2, four in double. Finally the results are
added to spheres and pairs one contact at a time, in the order of the list.

The compiler vectorises the loop only if no branch in it assigns a vector or a struct. Contact laws therefore select
between scalars with `wp.where`, or multiply by 0 or 1.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.rows import row_functions
from ..common.types import types, vector_functions
from .bond_parallel import UNBONDED, bond_functions, bond_with, kind_of, load_row
from .pairs import bond_pull_functions, broken_function, decode, pair_functions
from .structs import array_structs

# Number of contacts that are gathered in vector lanes before the contact law is evaluated for all of them.
LANES: int = wp.constant(32)
BOND = (
    "effective_modulus", "shear_to_normal", "tensile_strength", "cohesion", "tan_friction_angle", "radius_multiplier",
    "moment_factor",
)  # fmt: skip
"""Names of the bond parameters, in the order in which `layout` stores their columns. A column holds the values of one
quantity for all vector lanes."""


@functools.cache
def column_functions(scalar):
    """Return functions that read and write numbers and vectors in columns, and that select a vector or zero.

    A vector lane is one of the contacts that a CPU computes at the same time. A column is a part of an array that holds
    one number for each lane. `get` and `put` access the number of lane `lane` in the column that starts at index `at`.
    `get3`, `put3`, `get4` and `put4` access a vector, whose components are in consecutive columns. `where3` and
    `where4` return the vector if a condition holds, else zero.
    """
    t = types(scalar)
    Columns, Ints = wp.array(dtype=scalar), wp.array(dtype=wp.int32)

    @wp.func_native("return columns.data[at + lane];")
    def get(columns: Columns, at: wp.int32, lane: wp.int32) -> scalar: ...

    @wp.func_native("columns.data[at + lane] = value;")
    def put(columns: Columns, at: wp.int32, lane: wp.int32, value: scalar): ...

    @wp.func_native("return columns.data[at + lane];")
    def get_int(columns: Ints, at: wp.int32, lane: wp.int32) -> wp.int32: ...

    @wp.func_native("columns.data[at + lane] = value;")
    def put_int(columns: Ints, at: wp.int32, lane: wp.int32, value: wp.int32): ...

    @wp.func
    def get3(columns: Columns, at: wp.int32, lane: wp.int32):
        return t.vec3(get(columns, at, lane), get(columns, at + LANES, lane), get(columns, at + 2 * LANES, lane))

    @wp.func
    def get4(columns: Columns, at: wp.int32, lane: wp.int32):
        v = get3(columns, at, lane)
        return t.vec4(v[0], v[1], v[2], get(columns, at + 3 * LANES, lane))

    @wp.func
    def put3(columns: Columns, at: wp.int32, lane: wp.int32, value: t.vec3):
        put(columns, at, lane, value[0])
        put(columns, at + LANES, lane, value[1])
        put(columns, at + 2 * LANES, lane, value[2])

    @wp.func
    def put4(columns: Columns, at: wp.int32, lane: wp.int32, value: t.vec4):
        put3(columns, at, lane, t.vec3(value[0], value[1], value[2]))
        put(columns, at + 3 * LANES, lane, value[3])

    @wp.func
    def where3(holds: wp.bool, v: t.vec3):
        zero = scalar(0.0)
        return t.vec3(wp.where(holds, v[0], zero), wp.where(holds, v[1], zero), wp.where(holds, v[2], zero))

    @wp.func
    def where4(holds: wp.bool, v: t.vec4):
        w = where3(holds, t.vec3(v[0], v[1], v[2]))
        return t.vec4(w[0], w[1], w[2], wp.where(holds, v[3], scalar(0.0)))

    return SimpleNamespace(
        get=get, put=put, get_int=get_int, put_int=put_int, get3=get3, put3=put3, get4=get4, put4=put4, where3=where3,
        where4=where4,
    )  # fmt: skip


@functools.cache
def layout(rolls: bool, history: bool, bonds: bool) -> SimpleNamespace:
    """Return where the values of each quantity begin in the two arrays of the vector lanes, and the arrays' sizes.

    A vector lane is one of the contacts that a CPU computes at the same time. One array holds floating-point numbers,
    and the other array holds integers. Each scalar quantity occupies LANES consecutive elements, one for each lane.
    """
    numbers = dict(position_i=4, velocity_i=4, spin_i=3, position_j=4, velocity_j=4, spin_j=3, sign=1)
    numbers |= (dict(history=3) if history else {}) | (dict(rolling=3) if rolls else {})
    numbers |= dict(bond=len(BOND), bond_force=4, bond_moment=4) if bonds else {}
    numbers |= dict(force=3, moment_i=3, moment_j=3, lost=1)
    begins, end = {}, 0
    for name, width in numbers.items():
        begins[name] = end
        end += width * int(LANES)
    integers = {name: k * int(LANES) for k, name in enumerate(("i", "j", "k", "law", "bond", "load"))}
    return SimpleNamespace(numbers=begins, size=end, integers=integers, integer_size=len(integers) * int(LANES))


@functools.cache
def gather_function(scalar, law, history: bool, bonds: bool, healing: bool, mixed: bool):
    """Return the function `gather`, which copies the data of one contact into a vector lane.

    A vector lane is one of the contacts that a CPU computes at the same time. The class `Features` in
    `warpcrete/dem/engine/model.py` explains the flags.
    """
    t = types(scalar)
    structs = array_structs(scalar)
    Spheres, Pairs = structs.Spheres, structs.Pairs
    Columns, Ints = wp.array(dtype=scalar), wp.array(dtype=wp.int32)
    rolls = law.rolls
    Bond = bond_functions(scalar).Bond
    rows = row_functions(scalar)
    read_int, read_vec3, read_vec4, read_half = rows.read_int, rows.read_vec3, rows.read_vec4, rows.read_half
    f = column_functions(scalar)
    xyz = vector_functions(scalar).xyz
    put, put_int, put3, put4 = f.put, f.put_int, f.put3, f.put4
    places = layout(rolls, history, bonds)
    at, int_at = places.numbers, places.integers
    _, write_bond = bond_columns(scalar, at["bond"]) if bonds else (None, None)

    @wp.func
    def gather(
        spheres: Spheres, pairs: Pairs, bond_parameters: wp.array(dtype=Bond), first_bond: wp.int32,
        first_load: wp.int32, row: wp.int32, base: wp.int32, i: wp.int32, k: wp.int32, position_i: t.vec4,
        velocity_i: t.vec4, spin_i: t.vec3, columns: Columns, ints: Ints, lane: wp.int32,
    ):  # fmt: skip
        """Copy the data of the contact in list entry k of sphere i into the vector lane `lane`.

        Four arguments are indices in arrays of the batch: `row` of the first contact parameters for the material of
        sphere i, `base` of the scene's first sphere, `first_bond` of the scene's first bond parameters, and
        `first_load` of the scene's first bond force.
        """
        entry = read_int(pairs.other, k)
        j = base + decode(entry)
        put_int(ints, wp.static(int_at["i"]), lane, i)
        put_int(ints, wp.static(int_at["j"]), lane, j)
        put_int(ints, wp.static(int_at["k"]), lane, k)
        put4(columns, wp.static(at["position_i"]), lane, position_i)
        put4(columns, wp.static(at["velocity_i"]), lane, velocity_i)
        put3(columns, wp.static(at["spin_i"]), lane, spin_i)
        put4(columns, wp.static(at["position_j"]), lane, read_vec4(spheres.position, j))
        put4(columns, wp.static(at["velocity_j"]), lane, read_vec4(spheres.velocity, j))
        put3(columns, wp.static(at["spin_j"]), lane, xyz(read_vec4(spheres.spin, j)))
        put(columns, wp.static(at["sign"]), lane, wp.where(entry < 0, scalar(-1.0), scalar(1.0)))
        if wp.static(history):
            put3(columns, wp.static(at["history"]), lane, xyz(read_vec4(pairs.history, k)))
        if wp.static(rolls):
            put3(columns, wp.static(at["rolling"]), lane, read_vec3(pairs.rolling, k))
        if wp.static(mixed):
            put_int(ints, wp.static(int_at["law"]), lane, row + read_int(spheres.material, j))
        if wp.static(bonds):
            bond = read_int(pairs.bond, k)
            if wp.static(healing):
                if bond == UNBONDED:
                    bond = bond_with(1, k - first_load)
                    pairs.bond[k] = bond
            kind = kind_of(bond)
            put_int(ints, wp.static(int_at["bond"]), lane, kind)
            # The loop over the lanes has no branches, so each lane computes a bond. A lane without a bond computes with
            # the parameters of bond kind 1, and its bond force is discarded.
            write_bond(columns, lane, bond_parameters[first_bond + wp.max(kind, 1)])
            force, moment, at_row = t.vec4(), t.vec4(), wp.int32(-1)
            if bond > 0:
                at_row = first_load + load_row(bond)
                force, moment = read_half(pairs.load, at_row, 0), read_half(pairs.load, at_row, 1)
            put_int(ints, wp.static(int_at["load"]), lane, at_row)
            put4(columns, wp.static(at["bond_force"]), lane, force)
            put4(columns, wp.static(at["bond_moment"]), lane, moment)

    return gather


@functools.cache
def evaluate_function(scalar, law, history: bool, bonds: bool, dissipation: bool, mixed: bool):
    """Return the function `evaluate`, which computes forces and moments of all lanes and updates histories and bonds.

    A lane is one of the contacts that the vector instructions of a CPU process together. Without `mixed`, all spheres
    have one material, and all lanes share one parameter set that is read before the loop. Reading parameters in the
    loop would keep the compiler from vectorising it. The class `Features` in `warpcrete/dem/engine/model.py` explains
    the flags.
    """
    t = types(scalar)
    Columns, Ints = wp.array(dtype=scalar), wp.array(dtype=wp.int32)
    functions = law.functions(scalar)
    Parameters, contact_force = functions.Parameters, functions.force
    rolls = law.rolls
    contact_moment = functions.moment if rolls else None
    pair_touch = pair_functions(scalar).pair_touch
    bond_pull = bond_pull_functions(scalar, dissipation).bond_pull
    f = column_functions(scalar)
    get, put, get_int, put_int = f.get, f.put, f.get_int, f.put_int
    get3, put3, get4, put4 = f.get3, f.put3, f.get4, f.put4
    where3, where4 = f.where3, f.where4
    places = layout(rolls, history, bonds)
    at, int_at = places.numbers, places.integers
    read_bond, _ = bond_columns(scalar, at["bond"]) if bonds else (None, None)

    @wp.func
    def evaluate(columns: Columns, ints: Ints, parameters: wp.array(dtype=Parameters), row: wp.int32, dt: scalar):
        p = parameters[row]
        lane = wp.int32(0)
        while lane < LANES:
            sign = get(columns, wp.static(at["sign"]), lane)
            spin_i = get3(columns, wp.static(at["spin_i"]), lane)
            spin_j = get3(columns, wp.static(at["spin_j"]), lane)
            meeting = pair_touch(
                get4(columns, wp.static(at["position_i"]), lane), get4(columns, wp.static(at["velocity_i"]), lane),
                spin_i, get4(columns, wp.static(at["position_j"]), lane),
                get4(columns, wp.static(at["velocity_j"]), lane), spin_j, sign, dt,
            )  # fmt: skip
            if wp.static(mixed):
                p = parameters[get_int(ints, wp.static(int_at["law"]), lane)]
            old_history = t.vec3()
            if wp.static(history):
                old_history = get3(columns, wp.static(at["history"]), lane)
            total, new_history, lost = contact_force(p, meeting.touch, old_history, dt)
            if wp.static(history):
                put3(columns, wp.static(at["history"]), lane, new_history)
            bending = t.vec3()
            if wp.static(bonds):
                kind = get_int(ints, wp.static(int_at["bond"]), lane)
                pull = bond_pull(
                    read_bond(columns, lane), meeting, sign * (spin_j - spin_i),
                    get4(columns, wp.static(at["bond_force"]), lane),
                    get4(columns, wp.static(at["bond_moment"]), lane), lost, dt,
                )  # fmt: skip
                # The bond formulas may yield NaN for a contact without a bond. Multiplication by 0 would keep the NaN,
                # so the bond's results are selected component by component.
                total = wp.where(kind > 0, pull.contact, scalar(1.0)) * total + where3(kind > 0, pull.total)
                bending = where3(kind > 0, pull.bending)
                lost = wp.where(kind > 0, pull.lost, lost)
                put4(columns, wp.static(at["bond_force"]), lane, where4(kind > 0, pull.force))
                put4(columns, wp.static(at["bond_moment"]), lane, where4(kind > 0, pull.moment))
                put_int(ints, wp.static(int_at["bond"]), lane, wp.where(kind > 0, pull.outcome, 1))
            if wp.static(rolls):
                held_back, new_rolling, lost_rolling = contact_moment(
                    p, meeting.touch, sign * (spin_j - spin_i), get3(columns, wp.static(at["rolling"]), lane), dt
                )
                put3(columns, wp.static(at["rolling"]), lane, new_rolling)
                bending = bending + held_back
                lost += lost_rolling
            turn = wp.cross(meeting.touch.normal, total)
            put3(columns, wp.static(at["force"]), lane, sign * total)
            put3(columns, wp.static(at["moment_i"]), lane, meeting.arm_i * turn + sign * bending)
            put3(columns, wp.static(at["moment_j"]), lane, meeting.arm_j * turn - sign * bending)
            if wp.static(dissipation):
                put(columns, wp.static(at["lost"]), lane, lost)
            lane = lane + 1

    return evaluate


@functools.cache
def scatter_function(scalar, law, history: bool, bonds: bool, dissipation: bool):
    """Return the function `scatter`, which adds the contact results of the first `count` vector lanes to their spheres.

    A vector lane is one of the contacts that a CPU computes at the same time. `scatter` also stores the contact history
    of the pairs.
    """
    structs = array_structs(scalar)
    Spheres, Pairs = structs.Spheres, structs.Pairs
    Columns, Ints = wp.array(dtype=scalar), wp.array(dtype=wp.int32)
    rolls = law.rolls
    count_broken = broken_function(scalar)
    rows = row_functions(scalar)
    read_int, read_vec3 = rows.read_int, rows.read_vec3
    write_vec3, write_vec4, write_half = rows.write_vec3, rows.write_vec4, rows.write_half
    f = column_functions(scalar)
    pack = vector_functions(scalar).pack
    get, get_int, get3, get4 = f.get, f.get_int, f.get3, f.get4
    places = layout(rolls, history, bonds)
    at, int_at = places.numbers, places.integers

    @wp.func
    def scatter(
        spheres: Spheres, pairs: Pairs, first: wp.int32, last: wp.int32, columns: Columns, ints: Ints, count: wp.int32
    ):
        """Add the results of the first `count` vector lanes to their spheres and pairs.

        A vector lane is one of the contacts that a CPU computes at the same time. The calling CPU thread owns the
        spheres `first` to `last` - 1. A pair of one of these spheres and a sphere of another thread is listed at both
        spheres, and both threads evaluate it. Only the evaluation at the sphere with the lower permanent number counts
        energy and broken bonds.
        """
        lane = wp.int32(0)
        while lane < count:
            i = get_int(ints, wp.static(int_at["i"]), lane)
            j = get_int(ints, wp.static(int_at["j"]), lane)
            k = get_int(ints, wp.static(int_at["k"]), lane)
            shared = j >= first and j < last
            if wp.static(history):
                write_vec4(pairs.history, k, pack(get3(columns, wp.static(at["history"]), lane), scalar(0.0)))
            if wp.static(rolls):
                write_vec3(pairs.rolling, k, get3(columns, wp.static(at["rolling"]), lane))
            if wp.static(bonds or dissipation):
                own = shared or read_int(pairs.other, k) >= 0
                if wp.static(bonds):
                    at_row = get_int(ints, wp.static(int_at["load"]), lane)
                    if at_row >= 0:
                        write_half(pairs.load, at_row, 0, get4(columns, wp.static(at["bond_force"]), lane))
                        write_half(pairs.load, at_row, 1, get4(columns, wp.static(at["bond_moment"]), lane))
                    outcome = get_int(ints, wp.static(int_at["bond"]), lane)
                    if outcome < 0:
                        pairs.bond[k] = outcome
                        if own:
                            count_broken(spheres, i, outcome)
                if wp.static(dissipation):
                    if own:
                        lost = wp.float64(get(columns, wp.static(at["lost"]), lane))
                        spheres.dissipated_energy[i] = spheres.dissipated_energy[i] + lost
            force = get3(columns, wp.static(at["force"]), lane)
            write_vec3(spheres.force, i, read_vec3(spheres.force, i) + force)
            moment_i = get3(columns, wp.static(at["moment_i"]), lane)
            write_vec3(spheres.moment, i, read_vec3(spheres.moment, i) + moment_i)
            if shared:
                write_vec3(spheres.force, j, read_vec3(spheres.force, j) - force)
                moment_j = get3(columns, wp.static(at["moment_j"]), lane)
                write_vec3(spheres.moment, j, read_vec3(spheres.moment, j) + moment_j)
            lane = lane + 1

    return scatter


@functools.cache
def bond_columns(scalar, at: int):
    """Return `read_bond` and `write_bond`, which read and write the bond parameters of one contact.

    Contacts are evaluated in vector lanes. Each parameter has a column with one number for each lane, and the first
    column of the bond parameters starts at index `at`.
    """
    Bond = bond_functions(scalar).Bond
    assert tuple(Bond.vars) == BOND
    Columns = wp.array(dtype=scalar)
    f = column_functions(scalar)
    get, put = f.get, f.put

    @wp.func
    def read_bond(columns: Columns, lane: wp.int32):
        bond = Bond()
        bond.effective_modulus = get(columns, at, lane)
        bond.shear_to_normal = get(columns, at + LANES, lane)
        bond.tensile_strength = get(columns, at + 2 * LANES, lane)
        bond.cohesion = get(columns, at + 3 * LANES, lane)
        bond.tan_friction_angle = get(columns, at + 4 * LANES, lane)
        bond.radius_multiplier = get(columns, at + 5 * LANES, lane)
        bond.moment_factor = get(columns, at + 6 * LANES, lane)
        return bond

    @wp.func
    def write_bond(columns: Columns, lane: wp.int32, bond: Bond):
        put(columns, at, lane, bond.effective_modulus)
        put(columns, at + LANES, lane, bond.shear_to_normal)
        put(columns, at + 2 * LANES, lane, bond.tensile_strength)
        put(columns, at + 3 * LANES, lane, bond.cohesion)
        put(columns, at + 4 * LANES, lane, bond.tan_friction_angle)
        put(columns, at + 5 * LANES, lane, bond.radius_multiplier)
        put(columns, at + 6 * LANES, lane, bond.moment_factor)

    return read_bond, write_bond
