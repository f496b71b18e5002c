"""Sphere-sphere contact forces over a stored neighbour list.

One list serves both devices. In the *half* list (CPU: one thread owns every sphere) a pair stands
once and its force is added to both spheres; in the *full* list (GPU) it stands at both spheres, each
thread writes only its own sphere, and no atomic is needed. A pair is always evaluated in the order of
its spheres' permanent numbers, so both copies of a full list compute and store the same bits.
"""

import functools

import warp as wp

from .bond_parallel import BROKEN_IN_TENSION, UNBONDED, bond_functions
from .contact_law import contact_functions
from .types import BROKEN_SHEAR, BROKEN_TENSION, DT_PREVIOUS, FAILED, STALE, types, vector_functions


@wp.func
def decode(entry: wp.int32):
    """Neighbour index of a list entry; entries are j, or -1 - j where j has the lower permanent number."""
    if entry < 0:
        return -1 - entry
    return entry


@functools.cache
def contact_kernel(scalar, law, half: bool, history: bool, bonds: bool, healing: bool, losses: bool):
    """Kernel over spheres: adds contact forces [N] and moments about sphere centres [N m].

    With `losses` it also adds up the energy that friction, dashpots and breaking bonds take [J].
    """
    t = types(scalar)
    Parameters = law(scalar).Parameters
    contact_force = law(scalar).force
    contact_energy = law(scalar).energy
    sphere_touch = contact_functions(scalar).sphere_touch
    Bond = bond_functions(scalar).Bond
    bond_force = bond_functions(scalar).bond_force
    bond_energy = bond_functions(scalar).bond_energy
    xyz = vector_functions(scalar).xyz
    safe_normalize = vector_functions(scalar).safe_normalize

    @wp.kernel(module="unique", enable_backward=False)
    def contacts(
        contact_parameters: wp.array(dtype=Parameters),
        bond_parameters: wp.array(dtype=Bond),
        materials: wp.int32,
        sphere_position: wp.array(dtype=t.vec4),
        sphere_velocity: wp.array(dtype=t.vec4),
        sphere_spin: wp.array(dtype=t.vec3),
        sphere_material: wp.array(dtype=wp.int32),
        pair_start: wp.array(dtype=wp.int32),
        pair_other: wp.array(dtype=wp.int32),
        clock: wp.array(dtype=wp.float64),
        flags: wp.array(dtype=wp.int32),
        pair_history: wp.array(dtype=t.vec3),
        pair_bond: wp.array(dtype=wp.int32),
        pair_bond_force: wp.array(dtype=t.vec4),
        pair_bond_moment: wp.array(dtype=t.vec4),
        force: wp.array(dtype=t.vec3),
        moment: wp.array(dtype=t.vec3),
        sphere_lost: wp.array(dtype=wp.float64),
    ):
        i = wp.tid()
        if flags[STALE] != 0 or flags[FAILED] != 0:
            return
        dt = scalar(clock[DT_PREVIOUS])  # the displacement that led here is that of the step before
        position_i = sphere_position[i]
        velocity_i = sphere_velocity[i]
        spin_i = sphere_spin[i]
        row = sphere_material[i] * materials
        force_i = t.vec3()
        moment_i = t.vec3()
        lost_i = wp.float64(0.0)
        for k in range(pair_start[i], pair_start[i + 1]):
            entry = pair_other[k]
            j = decode(entry)
            position_j = sphere_position[j]
            offset = xyz(position_j) - xyz(position_i)
            reach = position_i[3] + position_j[3]
            distance_squared = wp.dot(offset, offset)
            touching = distance_squared < reach * reach
            bond = wp.int32(0)
            if wp.static(bonds):
                bond = pair_bond[k]
            if touching or bond > 0:
                sign = scalar(1.0)
                if entry < 0:
                    sign = scalar(-1.0)
                velocity_j = sphere_velocity[j]
                spin_j = sphere_spin[j]
                distance = wp.sqrt(distance_squared)
                gap = distance - reach
                # Coincident centres have no direction: any fixed one will part them.
                n = safe_normalize(sign * offset, t.vec3(scalar(0.0), scalar(0.0), scalar(1.0)))
                # The contact point halves the overlap.
                arm_i = position_i[3] + scalar(0.5) * gap
                arm_j = position_j[3] + scalar(0.5) * gap
                spin_a = spin_i
                spin_b = spin_j
                arm_a = arm_i
                arm_b = arm_j
                mass_a = velocity_i[3]
                mass_b = velocity_j[3]
                if entry < 0:
                    spin_a = spin_j
                    spin_b = spin_i
                    arm_a = arm_j
                    arm_b = arm_i
                    mass_a = velocity_j[3]
                    mass_b = velocity_i[3]
                apart = sign * (xyz(velocity_j) - xyz(velocity_i))
                velocity = apart - wp.cross(arm_a * spin_a + arm_b * spin_b, n)
                twist = scalar(0.5) * dt * wp.dot(spin_a + spin_b, n)
                touch = sphere_touch(n, gap, velocity, twist, position_i[3], position_j[3], mass_a, mass_b)

                old_history = t.vec3()
                if wp.static(history):
                    old_history = pair_history[k]
                total, new_history, lost = contact_force(
                    contact_parameters[row + sphere_material[j]], touch, old_history, dt
                )
                if wp.static(history):
                    pair_history[k] = new_history
                bond_moment = t.vec3()
                if wp.static(bonds):
                    if wp.static(healing):
                        if bond == UNBONDED:
                            bond = 1
                            pair_bond[k] = 1
                    if bond > 0:
                        # Distance now less distance before, without cancellation.
                        way = dt * apart
                        before = distance * n - way
                        stretch = wp.dot(way, distance * n + before) / (distance + wp.length(before))
                        held_force, held_moment, outcome = bond_force(
                            bond_parameters[bond], touch, stretch, spin_b - spin_a,
                            pair_bond_force[k], pair_bond_moment[k], dt,
                        )  # fmt: skip
                        if outcome < 0:
                            pair_bond[k] = outcome
                            if wp.static(half) or entry >= 0:
                                if outcome == BROKEN_IN_TENSION:
                                    wp.atomic_add(flags, BROKEN_TENSION, 1)
                                else:
                                    wp.atomic_add(flags, BROKEN_SHEAR, 1)
                            if wp.static(losses):
                                if not touching:
                                    lost = scalar(0.0)
                                lost += bond_energy(bond_parameters[bond], touch, held_force, held_moment)
                            held_force = t.vec4()
                            held_moment = t.vec4()
                            # A bond that breaks may leave a pair that no longer touches: the contact's
                            # dashpot must not outlive it.
                            if not touching:
                                total = t.vec3()
                        pair_bond_force[k] = held_force
                        pair_bond_moment[k] = held_moment
                        total = total + xyz(held_force) + held_force[3] * n
                        bond_moment = xyz(held_moment) + held_moment[3] * n
                if wp.static(losses):
                    if wp.static(half) or entry >= 0:
                        lost_i += wp.float64(lost)
                turn = wp.cross(n, total)
                force_i = force_i + sign * total
                moment_i = moment_i + arm_i * turn + sign * bond_moment
                if wp.static(half):
                    force[j] = force[j] - sign * total
                    moment[j] = moment[j] + arm_j * turn - sign * bond_moment
            else:
                if wp.static(history):
                    if wp.static(losses):
                        # A spring still loaded when the surfaces part takes its energy with it.
                        if wp.length_sq(pair_history[k]) > scalar(0.0) and (wp.static(half) or entry >= 0):
                            touch = sphere_touch(
                                t.vec3(), scalar(0.0), t.vec3(), scalar(0.0), position_i[3], position_j[3],
                                velocity_i[3], sphere_velocity[j][3],
                            )  # fmt: skip
                            p = contact_parameters[row + sphere_material[j]]
                            lost_i += wp.float64(contact_energy(p, touch, pair_history[k]))
                    pair_history[k] = t.vec3()
                if wp.static(healing):
                    if bond < 0:
                        pair_bond[k] = 0  # parted: may bond again at the next touch
        if wp.static(losses):
            sphere_lost[i] = sphere_lost[i] + lost_i
        force[i] = force[i] + force_i
        moment[i] = moment[i] + moment_i

    return contacts
