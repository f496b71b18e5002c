"""Parts of the contact kernel that go through list entries: a pair's geometry and bond, what touches, what parted."""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.rows import row_functions
from ..common.types import lowest_bit, types, vector_functions
from .bond_parallel import BROKEN_IN_TENSION, HYDRATED, UNBONDED, bond_functions, bond_with, kind_of, load_row
from .contact_law import contact_functions
from .structs import array_structs

BLOCK = wp.constant(31)  # list entries gone through at a time; their bits leave the sign of an int32 alone
ALL_TOUCHED = 2**31 - 1  # bits after a rebuild: whatever touched before


@wp.func
def decode(entry: wp.int32):
    """Neighbour index of a list entry; entries are j, or -1 - j where j has the lower permanent number."""
    if entry < 0:
        return -1 - entry
    return entry


@functools.cache
def pair_functions(scalar):
    """`pair_touch`: the geometry of a touching or bonded pair."""
    t = types(scalar)
    contact = contact_functions(scalar)
    Touch, sphere_touch = contact.Touch, contact.sphere_touch
    xyz = vector_functions(scalar).xyz

    @wp.struct
    class PairTouch:
        touch: Touch
        apart: t.vec3  # velocity of the second centre seen from the first [m/s]
        distance: scalar  # of the centres [m]
        arm_i: scalar  # from either centre to the contact point [m]
        arm_j: scalar

    @wp.func
    def pair_touch(
        position_i: t.vec4,
        velocity_i: t.vec4,
        spin_i: t.vec3,
        position_j: t.vec4,
        velocity_j: t.vec4,
        spin_j: t.vec3,
        sign: scalar,
        dt: scalar,
    ):
        """`sign` is 1 where i has the lower permanent number, else -1: the normal points from that sphere on."""
        pair = PairTouch()
        offset = xyz(position_j) - xyz(position_i)
        distance = wp.length(offset)
        gap = distance - (position_i[3] + position_j[3])
        # Coincident centres have no direction: any fixed one will part them.
        per_distance = scalar(0.0)
        upwards = scalar(1.0)
        if distance > scalar(0.0):
            per_distance = scalar(1.0) / distance
            upwards = scalar(0.0)
        n = (sign * per_distance) * offset + t.vec3(scalar(0.0), scalar(0.0), upwards)
        # The contact point halves the overlap.
        arm_i = position_i[3] + scalar(0.5) * gap
        arm_j = position_j[3] + scalar(0.5) * gap
        apart = sign * (xyz(velocity_j) - xyz(velocity_i))
        # arm_i spin_i + arm_j spin_j, in a form that rounds alike in both copies of a pair, fused or not.
        spins = spin_i + spin_j
        sliding = (scalar(0.5) * (arm_i + arm_j)) * spins
        sliding = sliding + (scalar(0.5) * (arm_j - arm_i)) * (spin_j - spin_i)
        velocity = apart - wp.cross(sliding, n)
        twist = scalar(0.5) * dt * wp.dot(spins, n)
        pair.touch = sphere_touch(n, gap, velocity, twist, position_i[3], position_j[3], velocity_i[3], velocity_j[3])
        pair.touch.tilt = (dt * per_distance) * wp.cross(n, apart)
        pair.apart = apart
        pair.distance = distance
        pair.arm_i = arm_i
        pair.arm_j = arm_j
        return pair

    return SimpleNamespace(Touch=Touch, PairTouch=PairTouch, pair_touch=pair_touch)


@functools.cache
def parting_function(scalar, law, history: bool, healing: bool, subcycling: bool, dissipation: bool):
    """`part_entries`: pairs of the list that touched in the last step and do not any more, a bit for each entry from
    `block` to `end`; the energy that they lose [J]."""
    t = types(scalar)
    structs = array_structs(scalar)
    Spheres, Pairs = structs.Spheres, structs.Pairs
    functions = law.functions(scalar)
    Parameters = functions.Parameters
    contact_energy = functions.energy
    rolls = law.rolls
    moment_energy = functions.moment_energy if rolls else None
    sphere_touch = contact_functions(scalar).sphere_touch
    xyz = vector_functions(scalar).xyz

    @wp.func
    def part(
        spheres: Spheres,
        pairs: Pairs,
        parameters: wp.array(dtype=Parameters),
        row: wp.int32,
        base: wp.int32,
        first: wp.int32,
        last: wp.int32,
        radius: scalar,
        mass: scalar,
        k: wp.int32,
    ):
        lost = wp.float64(0.0)
        if wp.static(history):
            if wp.static(dissipation):
                # A spring still loaded when the surfaces part takes its energy with it.
                entry = pairs.other[k]
                j = base + decode(entry)
                counts = entry >= 0 or (j >= first and j < last)
                loaded = wp.length_sq(pairs.history[k]) > scalar(0.0)
                if wp.static(rolls):
                    loaded = loaded or wp.length_sq(pairs.rolling[k]) > scalar(0.0)
                if loaded and counts:
                    touch = sphere_touch(
                        t.vec3(), scalar(0.0), t.vec3(), scalar(0.0), radius, spheres.position[j][3], mass,
                        spheres.velocity[j][3],
                    )  # fmt: skip
                    p = parameters[row + spheres.material[j]]
                    lost += wp.float64(contact_energy(p, touch, xyz(pairs.history[k])))
                    if wp.static(rolls):
                        lost += wp.float64(moment_energy(p, touch, pairs.rolling[k]))
            pairs.history[k] = t.vec4()
            if wp.static(rolls):
                pairs.rolling[k] = t.vec3()
        if wp.static(healing):
            if pairs.bond[k] < 0:
                pairs.bond[k] = 0  # may bond again at the next touch
                pairs.load[k] = t.vec8()
        return lost

    @wp.func
    def part_entries(
        spheres: Spheres,
        pairs: Pairs,
        parameters: wp.array(dtype=Parameters),
        row: wp.int32,
        base: wp.int32,
        first: wp.int32,
        last: wp.int32,
        radius: scalar,
        mass: scalar,
        block: wp.int32,
        end: wp.int32,
        bits: wp.int32,
    ):
        lost = wp.float64(0.0)
        left = bits
        while left != 0:
            k = block + lowest_bit(left)
            left = left & (left - 1)
            if wp.static(subcycling):
                if k < end and kind_of(pairs.bond[k]) == HYDRATED:
                    continue  # its history is not a contact's of this step
            if k < end:
                lost += part(spheres, pairs, parameters, row, base, first, last, radius, mass, k)
        return lost

    return part_entries


@functools.cache
def broken_function(scalar):
    """`count_broken`: notes at a sphere how a bond of it broke."""
    Spheres = array_structs(scalar).Spheres

    @wp.func
    def count_broken(spheres: Spheres, i: wp.int32, outcome: wp.int32):
        broken = spheres.broken[i]
        if outcome == BROKEN_IN_TENSION:
            broken[0] = broken[0] + 1
        else:
            broken[1] = broken[1] + 1
        spheres.broken[i] = broken

    return count_broken


@functools.cache
def bond_pull_functions(scalar, dissipation: bool):
    """`bond_pull`: load of a pair's bond after a step, and what is left of the pair's contact."""
    t = types(scalar)
    PairTouch = pair_functions(scalar).PairTouch
    bond = bond_functions(scalar)
    Bond, bond_force, bond_energy = bond.Bond, bond.bond_force, bond.bond_energy
    xyz = vector_functions(scalar).xyz

    @wp.struct
    class BondPull:
        force: t.vec4  # shear vector and tension [N], nothing where it broke
        moment: t.vec4  # bending vector and torsion [N m], likewise
        total: t.vec3  # force on the first body [N]
        bending: t.vec3  # moment on it [N m]
        contact: scalar  # 0 where the bond broke and left a pair that does not touch, else 1
        lost: scalar  # energy that contact and bond lose [J]
        outcome: wp.int32  # 1, or how it broke

    @wp.func
    def bond_pull(
        p: Bond, pair: PairTouch, relative_spin: t.vec3, force: t.vec4, moment: t.vec4, lost: scalar, dt: scalar
    ):
        """`lost` is what the contact alone loses [J]."""
        touch = pair.touch
        n = touch.normal
        # Distance now less distance before, without cancellation.
        way = dt * pair.apart
        came_from = pair.distance * n - way
        stretch = wp.dot(way, pair.distance * n + came_from) / (pair.distance + wp.length(came_from))
        held_force, held_moment, outcome = bond_force(p, touch, stretch, relative_spin, force, moment, dt)
        pull = BondPull()
        holds = scalar(1.0)
        pull.contact = scalar(1.0)
        pull.lost = lost
        if outcome < 0:
            holds = scalar(0.0)
            # A bond that breaks may leave a pair that no longer touches: the contact's dashpot must not outlive it.
            if touch.gap >= scalar(0.0):
                pull.contact = scalar(0.0)
                pull.lost = scalar(0.0)
            if wp.static(dissipation):
                pull.lost += bond_energy(p, touch, held_force, held_moment)
        pull.force = holds * held_force
        pull.moment = holds * held_moment
        pull.total = xyz(pull.force) + pull.force[3] * n
        pull.bending = xyz(pull.moment) + pull.moment[3] * n
        pull.outcome = outcome
        return pull

    return SimpleNamespace(BondPull=BondPull, bond_pull=bond_pull)


@functools.cache
def bonded_function(scalar, healing: bool, dissipation: bool):
    """`bonded`: what the bond of a pair adds to its contact's force, and what becomes of the bond."""
    t = types(scalar)
    Pairs = array_structs(scalar).Pairs
    PairTouch = pair_functions(scalar).PairTouch
    Bond = bond_functions(scalar).Bond
    bond_pull = bond_pull_functions(scalar, dissipation).bond_pull
    rows = row_functions(scalar)
    read_int, read_half, write_half = rows.read_int, rows.read_half, rows.write_half

    @wp.func
    def bonded(
        pairs: Pairs,
        parameters: wp.array(dtype=Bond),
        first_kind: wp.int32,
        first_load: wp.int32,
        k: wp.int32,
        pair: PairTouch,
        relative_spin: t.vec3,
        total: t.vec3,
        lost: scalar,
        dt: scalar,
    ):
        """Force of contact and bond [N], moment of the bond [N m], energy lost [J], and how it broke, or 1."""
        moment = t.vec3()
        outcome = wp.int32(1)
        bond = read_int(pairs.bond, k)
        if wp.static(healing):
            if bond == UNBONDED:
                bond = bond_with(1, k - first_load)
                pairs.bond[k] = bond
        if bond > 0:
            row = first_load + load_row(bond)
            pull = bond_pull(
                parameters[first_kind + kind_of(bond)], pair, relative_spin, read_half(pairs.load, row, 0),
                read_half(pairs.load, row, 1), lost, dt,
            )  # fmt: skip
            outcome = pull.outcome
            if outcome < 0:
                pairs.bond[k] = outcome
            write_half(pairs.load, row, 0, pull.force)
            write_half(pairs.load, row, 1, pull.moment)
            total = pull.contact * total + pull.total
            moment = pull.bending
            lost = pull.lost
        return total, moment, lost, outcome

    return bonded


@functools.cache
def closeness_function(scalar, bonds: bool, subcycling: bool):
    """`close_entries`: a bit for each of some list entries whose sphere touches sphere i, or is bonded to it, but for
    pairs that are stepped in rounds of their own; and a bit for each of these.
    """
    t = types(scalar)
    structs = array_structs(scalar)
    Spheres, Pairs = structs.Spheres, structs.Pairs
    xyz = vector_functions(scalar).xyz
    rows = row_functions(scalar)
    read_int, read_vec4 = rows.read_int, rows.read_vec4

    @wp.func
    def close_entries(
        spheres: Spheres, pairs: Pairs, base: wp.int32, position: t.vec4, block: wp.int32, length: wp.int32
    ):
        bits, held = wp.int32(0), wp.int32(0)
        b = wp.int32(0)
        x = xyz(position)
        while b < length:
            position_j = read_vec4(spheres.position, base + decode(read_int(pairs.other, block + b)))
            reach = position[3] + position_j[3]
            close = wp.length_sq(xyz(position_j) - x) < reach * reach
            if wp.static(bonds):
                kind = kind_of(read_int(pairs.bond, block + b))
                close = close or kind > 0
                if wp.static(subcycling):
                    close = close and kind != HYDRATED
                    if kind == HYDRATED:
                        held = held | (1 << b)
            if close:
                bits = bits | (1 << b)
            b = b + 1
        return bits, held

    return close_entries
