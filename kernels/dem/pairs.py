"""Functions for the entries of neighbour lists: geometry and bond of a pair, and checks if a pair touches."""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.rows import row_functions
from ..common.types import lowest_bit, types, vector_functions
from .bond_parallel import BROKEN_IN_TENSION, HYDRATED, UNBONDED, bond_functions, bond_with, kind_of, load_row
from .contact_law import contact_functions
from .structs import array_structs

# Number of list entries that are checked at a time. Each entry has one bit in an int32, whose sign bit is not used.
BLOCK: int = wp.constant(31)
# Mask with all bits set. It is stored after a list rebuild, so that every pair counts as having touched in the previous
# step.
ALL_TOUCHED = 2**31 - 1


@wp.func
def decode(entry: wp.int32):
    """Return the index of the neighbour from an entry of a neighbour list.

    An entry is the index j of the neighbour, or -1 - j if the neighbour has the lower permanent number of the pair.
    """
    if entry < 0:
        return -1 - entry
    return entry


@functools.cache
def pair_functions(scalar):
    """Return the struct `PairTouch` (geometry of a touching or bonded pair) and `pair_touch`, which computes it."""
    t = types(scalar)
    contact = contact_functions(scalar)
    Touch, sphere_touch = contact.Touch, contact.sphere_touch
    xyz = vector_functions(scalar).xyz

    @wp.struct
    class PairTouch:
        touch: Touch
        apart: t.vec3  # velocity of the higher-numbered sphere's centre relative to the other centre [m/s]
        distance: scalar  # distance between the centres of the two spheres [m]
        arm_i: scalar  # distance from the centre of sphere i to the contact point [m]
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
        """Compute the geometry of the contact between spheres i and j.

        `sign` is 1 where sphere i has the lower permanent number, else -1. The normal points from the sphere with the
        lower number to the sphere with the higher number.
        """
        pair = PairTouch()
        offset = xyz(position_j) - xyz(position_i)
        distance = wp.length(offset)
        gap = distance - (position_i[3] + position_j[3])
        # Coincident centres define no normal, so use the direction z, which pushes the spheres apart.
        per_distance = scalar(0.0)
        upwards = scalar(1.0)
        if distance > scalar(0.0):
            per_distance = scalar(1.0) / distance
            upwards = scalar(0.0)
        n = (sign * per_distance) * offset + t.vec3(scalar(0.0), scalar(0.0), upwards)
        # The contact point lies in the middle of the overlap.
        arm_i = position_i[3] + scalar(0.5) * gap
        arm_j = position_j[3] + scalar(0.5) * gap
        apart = sign * (xyz(velocity_j) - xyz(velocity_i))
        # A pair may be listed and computed twice, as (i, j) and as (j, i). Both computations must give the same bits,
        # even if the compiler fuses a multiplication and an addition. The following form of arm_i spin_i + arm_j spin_j
        # rounds in the same way when i and j are exchanged.
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
    """Return the function `part_entries`, which clears the contact history of pairs that separated in this step.

    In the argument `bits`, bit b is set if the pair of the list entry `block` + b has separated. Entries from `end` on
    are ignored. The function returns the energy that these pairs lose [J]. The class `Features` in
    `warpcrete/dem/engine/model.py` explains the flags.
    """
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
    def clear_parted(
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
                # When the surfaces separate, the energy of a spring that is still loaded is lost.
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
                pairs.bond[k] = 0  # Reset the broken bond, so that the pair may bond again when its spheres next touch.
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
                    # Skip a pair with a stiff bond, because its history is updated in the several rounds per step that
                    # such bonds need (sub-cycling).
                    continue
            if k < end:
                lost += clear_parted(spheres, pairs, parameters, row, base, first, last, radius, mass, k)
        return lost

    return part_entries


@functools.cache
def broken_function(scalar):
    """Return `count_broken`, which adds a broken bond to a sphere's count for tension or for shear."""
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
    """Return the struct `BondPull` with the results for a bond, and the function `bond_pull`, which computes them.

    The function advances the bond of a pair by one step.
    """
    t = types(scalar)
    PairTouch = pair_functions(scalar).PairTouch
    bond = bond_functions(scalar)
    Bond, bond_force, bond_energy = bond.Bond, bond.bond_force, bond.bond_energy
    xyz = vector_functions(scalar).xyz

    @wp.struct
    class BondPull:
        force: t.vec4  # new shear force vector and tension of the bond [N]; zero if the bond broke
        moment: t.vec4  # new bending moment vector and torsion of the bond [N m]; zero if the bond broke
        total: t.vec3  # force of the bond on the sphere with the lower permanent number [N]
        bending: t.vec3  # moment of the bond on the sphere with the lower permanent number [N m]
        contact: scalar  # factor on the contact force: 0 if the bond broke and the spheres do not touch, else 1
        lost: scalar  # energy that contact and bond lose in this step [J]
        outcome: wp.int32  # 1 if the bond holds; otherwise the negative code of how it broke

    @wp.func
    def bond_pull(
        p: Bond, pair: PairTouch, relative_spin: t.vec3, force: t.vec4, moment: t.vec4, lost: scalar, dt: scalar
    ):
        """Compute the new force, moment and state of a bond, and the energy that the pair loses in this step.

        `lost` is the energy that the contact alone loses in this step [J].
        """
        touch = pair.touch
        n = touch.normal
        # The new distance minus the old one is computed as (d^2 - d_old^2) / (d + d_old), which avoids cancellation.
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
            # The contact law computes a dashpot force for every bonded pair, even if its spheres are apart. If the bond
            # breaks while they are apart, this force must vanish together with the bond.
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
    """Return the function `bonded`, which adds the force of a pair's bond to its contact force and updates the bond."""
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
        """Return total force [N], bond moment [N m], lost energy [J] and bond outcome of a pair that may be bonded.

        The total force is the sum of the forces of contact and bond. The outcome is 1 if the bond holds or if the pair
        has no bond. If the bond breaks, the outcome is the negative code of its failure mode. With `healing`, a pair
        that was never bonded or may bond again gets a bond in this call.
        """
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
    """Return the function `close_entries`, which checks a block of list entries for contacts of sphere i.

    The function returns two integers with one bit for each entry of the block. A bit of the first integer is set if the
    entry's sphere touches sphere i or is bonded to it. With `subcycling`, entries with stiff bonds have their bit in
    the second integer instead.
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
