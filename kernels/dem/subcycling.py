"""Stiff bonds in rounds of their own within a step (multiple time stepping).

Bonds of hydrated contacts are so stiff that leapfrog needs steps of a tenth or a hundredth of what all other contacts
allow. A step then goes: contacts as always, but for pairs with such a bond; bodies without one move as always; those
that have some go through rounds of velocity Verlet, from the middle of the step before to the middle of this one,
under the forces of their stiff pairs (contact and bond), computed in every round, and under those of all else, which
stay. What these contacts see is where a body will be at the end of the step if it keeps its velocity. To a body that
moves as a whole that is leapfrog (drift by half, kick, drift by half), and momentum is kept, since all get the same
impulse of a contact.

The usual way, one kick a step by all else (Tuckerman et al. 1992), was built first: the kicks load a stiff bond by as
many times the force as a step has its periods, and broke bonds that single steps do not break. Forces that stay for a
step, as here, feed vibrations of a half to a whole step's period, those of contacts' dashpots most of all, as they find
another velocity by the time they act. So a step is half of what contacts alone allow, and stiff bonds have dashpots.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.control import FAILED, HALTED, LATE
from ..common.types import SPAN, types, vector_functions
from .bond_parallel import HYDRATED, bond_functions
from .motion import motion_functions, rotation_functions
from .pairs import bonded_function, broken_function, pair_functions
from .search import find_function
from .structs import DT, DT_PREVIOUS, array_structs, subcycled_struct

PART = 0.5
"""Of the stable step by all else, that a step may have."""
RELAXATION = 0.01
"""Time of a stiff bond's dashpots, damping over stiffness, over the step."""


@functools.cache
def locating_kernels(scalar, half: bool):
    """Kernels ``note_spheres``, ``note_bodies``, ``locate_pairs`` and ``locate_bodies``: where everything is after a
    rebuild of the lists."""
    structs = array_structs(scalar)
    Scenes, Bodies, Spheres, Pairs = structs.Scenes, structs.Bodies, structs.Spheres, structs.Pairs
    Subcycled = subcycled_struct(scalar)
    find = find_function(scalar, half)
    find_own = find_function(scalar, False)

    @wp.kernel(module="unique", enable_backward=False)
    def note_spheres(scenes: Scenes, spheres: Spheres, sphere_place: wp.array(dtype=wp.int32)):
        i = wp.tid()
        sphere_place[scenes.row[spheres.scene[i]].spheres + spheres.id[i]] = i

    @wp.kernel(module="unique", enable_backward=False)
    def note_bodies(scenes: Scenes, bodies: Bodies, subcycled: Subcycled, body_place: wp.array(dtype=wp.int32)):
        b = wp.tid()
        body_place[scenes.row[bodies.scene[b]].bodies + bodies.id[b]] = b
        subcycled.member[b] = 0

    @wp.kernel(module="unique", enable_backward=False)
    def locate_pairs(scenes: Scenes, pairs: Pairs, sphere_place: wp.array(dtype=wp.int32), subcycled: Subcycled):
        p = wp.tid()
        s = subcycled.pair_scene[p]
        base = scenes.row[s].spheres
        i = sphere_place[base + subcycled.lower[p]]
        j = sphere_place[base + subcycled.higher[p]]
        subcycled.i[p] = i
        subcycled.j[p] = j
        # A pair in two chunks, or in a full list, stands at both spheres: both entries must hold the same.
        entry = find(pairs, s, base, scenes.row[s].pairs, i, j)
        copy = find_own(pairs, s, base, scenes.row[s].pairs, j, i)
        subcycled.entry[p] = entry
        subcycled.copy[p] = wp.where(copy == entry, -1, copy)
        if entry < 0:  # parted, long after its bond broke
            subcycled.active[p] = 0

    @wp.kernel(module="unique", enable_backward=False)
    def locate_bodies(scenes: Scenes, body_place: wp.array(dtype=wp.int32), subcycled: Subcycled):
        q = wp.tid()
        b = body_place[scenes.row[subcycled.body_scene[q]].bodies + subcycled.body_number[q]]
        subcycled.place[q] = b
        subcycled.member[b] = q + 1

    return SimpleNamespace(
        note_spheres=note_spheres, note_bodies=note_bodies, locate_pairs=locate_pairs, locate_bodies=locate_bodies
    )


@functools.cache
def pair_kernel(scalar, law, half: bool, history: bool, healing: bool, dissipation: bool):
    """Kernel over pairs: force and moments of contact and stiff bond after a round."""
    t, span = types(scalar), SPAN if half else 1
    structs = array_structs(scalar)
    Scenes, Spheres, Pairs = structs.Scenes, structs.Spheres, structs.Pairs
    Subcycled = subcycled_struct(scalar)
    Parameters, contact_force = law.functions(scalar).Parameters, law.functions(scalar).force
    Bond = bond_functions(scalar).Bond
    pair_touch = pair_functions(scalar).pair_touch
    bonded = bonded_function(scalar, False, dissipation)
    bond_stiffness = bond_functions(scalar).bond_stiffness

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False)
    def subcycle_pairs(
        # model
        pair_parameters: wp.array(dtype=Parameters),
        bond_parameters: wp.array(dtype=Bond),
        # chunk and round
        first: wp.int32,
        last: wp.int32,
        turn: wp.int32,
        # state, read
        flags: wp.array2d(dtype=wp.int32),
        scenes: Scenes,
        spheres: Spheres,
        # state, read and written
        pairs: Pairs,
        subcycled: Subcycled,
    ):
        begin_p = first + wp.tid() * wp.static(span)
        for p in range(begin_p, wp.min(begin_p + wp.static(span), last)):
            s = subcycled.pair_scene[p]
            rounds = subcycled.rounds[s]
            if flags[s, HALTED] != 0 or turn >= rounds or subcycled.active[p] == 0:
                continue
            dt = scalar(0.5) * scalar(scenes.clock[s, DT] + scenes.clock[s, DT_PREVIOUS]) / scalar(rounds)
            i, j, k = subcycled.i[p], subcycled.j[p], subcycled.entry[p]
            spin_i, spin_j = spheres.spin[i], spheres.spin[j]
            pair = pair_touch(
                spheres.position[i], spheres.velocity[i], spin_i, spheres.position[j], spheres.velocity[j], spin_j,
                scalar(1.0), dt,
            )  # fmt: skip
            touch = pair.touch
            n = touch.normal
            row = scenes.row[s].laws + spheres.material[i] * scenes.row[s].materials
            old_history = t.vec3()
            if wp.static(history):
                old_history = pairs.history[k]
            total, new_history, lost = contact_force(pair_parameters[row + spheres.material[j]], touch, old_history, dt)
            relative_spin = spin_j - spin_i
            bond_moment = t.vec3()
            outcome = wp.int32(1)
            if pairs.bond[k] > 0:
                total, bond_moment, lost, outcome = bonded(
                    pairs, bond_parameters, scenes.row[s].bonds, k, pair, relative_spin, total, lost, dt
                )
                if outcome > 0:
                    relaxation = scalar(RELAXATION) * scalar(rounds) * dt
                    c = relaxation * bond_stiffness(bond_parameters[scenes.row[s].bonds + HYDRATED], touch)
                    along = wp.dot(touch.velocity, n)
                    across = touch.velocity - along * n
                    twisting = wp.dot(relative_spin, n)
                    bending = relative_spin - twisting * n
                    total = total + (c[0] * along) * n + c[1] * across
                    bond_moment = bond_moment + c[2] * bending + (c[3] * twisting) * n
                    if wp.static(dissipation):
                        rate = c[0] * along * along + c[1] * wp.length_sq(across)
                        lost += dt * (rate + c[2] * wp.length_sq(bending) + c[3] * twisting * twisting)
            elif touch.gap >= scalar(0.0):
                total = t.vec3()
                new_history = t.vec3()
                lost = scalar(0.0)
            if wp.static(history):
                pairs.history[k] = new_history
            if turn + 1 == rounds:
                if pairs.bond[k] <= 0:  # the next step's contacts have it
                    subcycled.active[p] = 0
                    total = t.vec3()
                    bond_moment = t.vec3()
                    if wp.static(healing):
                        if touch.gap >= scalar(0.0):
                            pairs.bond[k] = 0
                copy = subcycled.copy[p]
                if copy >= 0:
                    pairs.bond[copy] = pairs.bond[k]
                    pairs.bond_force[copy] = pairs.bond_force[k]
                    pairs.bond_moment[copy] = pairs.bond_moment[k]
                    if wp.static(history):
                        pairs.history[copy] = pairs.history[k]
            bent = wp.cross(n, total)
            subcycled.force[p] = total
            subcycled.lower_moment[p] = pair.arm_i * bent + bond_moment
            subcycled.higher_moment[p] = pair.arm_j * bent - bond_moment
            subcycled.outcome[p] = outcome
            if wp.static(dissipation):
                subcycled.lost[p] = wp.float64(lost)

    return subcycle_pairs


@functools.cache
def body_kernels(scalar, meshes: bool, half: bool, dissipation: bool):
    """Kernels over bodies with stiff bonds: ``subcycle_bodies``, one round's motion, and ``foresee_bodies`` after the
    last: where they will be at the end of the step."""
    span = SPAN if half else 1
    structs = array_structs(scalar)
    Scenes, Bodies, Spheres = structs.Scenes, structs.Bodies, structs.Spheres
    Subcycled = subcycled_struct(scalar)
    xyz, pack = vector_functions(scalar).xyz, vector_functions(scalar).pack
    turned, spin_at_middle = rotation_functions(scalar)
    motion = motion_functions(scalar, dissipation)
    moved_on, drift_of, outgrows_lists = motion.moved_on, motion.drift_of, motion.outgrows_lists
    count_broken = broken_function(scalar)

    @wp.func
    def kicked(scenes: Scenes, bodies: Bodies, spheres: Spheres, subcycled: Subcycled, q: wp.int32, kick: scalar):
        """Velocity and angular momentum after all forces have acted for `kick` [s]; counts what stiff bonds took."""
        b = subcycled.place[q]
        total = subcycled.other_force[q]
        torque = subcycled.other_torque[q]
        x = subcycled.position[q]
        for place in range(subcycled.start[q], subcycled.start[q + 1]):
            p = subcycled.ref[place] / 2
            if subcycled.ref[place] % 2 == 0:
                i = subcycled.i[p]
                force = subcycled.force[p]
                total += force
                torque += subcycled.lower_moment[p] + wp.cross(xyz(spheres.position[i]) - x, force)
                if wp.static(dissipation):
                    spheres.dissipated_energy[i] = spheres.dissipated_energy[i] + subcycled.lost[p]
                    subcycled.lost[p] = wp.float64(0.0)
                if subcycled.outcome[p] < 0:
                    count_broken(spheres, i, subcycled.outcome[p])
                    subcycled.outcome[p] = 1
            else:
                force = -subcycled.force[p]
                total += force
                arm = xyz(spheres.position[subcycled.j[p]]) - x
                torque += subcycled.higher_moment[p] + wp.cross(arm, force)
        return bodies.velocity[b] + total * (kick / bodies.mass[b]), bodies.angular_momentum[b] + kick * torque

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False)
    def subcycle_bodies(
        # chunk and round
        first: wp.int32,
        last: wp.int32,
        turn: wp.int32,
        # state, read
        flags: wp.array2d(dtype=wp.int32),
        scenes: Scenes,
        # state, read and written
        bodies: Bodies,
        spheres: Spheres,
        subcycled: Subcycled,
    ):
        begin_q = first + wp.tid() * wp.static(span)
        for q in range(begin_q, wp.min(begin_q + wp.static(span), last)):
            s = subcycled.body_scene[q]
            rounds = subcycled.rounds[s]
            if flags[s, HALTED] != 0 or turn >= rounds:
                continue
            b = subcycled.place[q]
            dt = scalar(0.5) * scalar(scenes.clock[s, DT] + scenes.clock[s, DT_PREVIOUS]) / scalar(rounds)
            kick = dt
            if turn == 0:
                # Stiff pairs stood at the real places of their spheres when they last were computed.
                kick = scalar(0.5) * dt
                begin = scenes.row[s].spheres + bodies.first[b + s]
                for i in range(begin, scenes.row[s].spheres + bodies.first[b + s + 1]):
                    arm = wp.quat_rotate(subcycled.orientation[q], xyz(spheres.offset[i]))
                    spheres.position[i] = pack(subcycled.position[q] + arm, spheres.offset[i][3])
            velocity, angular_momentum = kicked(scenes, bodies, spheres, subcycled, q, kick)
            x, rounding = moved_on(subcycled.position[q], dt * velocity, bodies.rounding[b])
            spin = spin_at_middle(subcycled.orientation[q], angular_momentum, bodies.inertia[b], dt)
            orientation = wp.normalize(turned(subcycled.orientation[q], dt * spin))
            bodies.rounding[b] = rounding
            bodies.velocity[b] = velocity
            bodies.angular_momentum[b] = angular_momentum
            subcycled.position[q] = x
            subcycled.orientation[q] = orientation
            begin = scenes.row[s].spheres + bodies.first[b + s]
            for i in range(begin, scenes.row[s].spheres + bodies.first[b + s + 1]):
                arm = wp.quat_rotate(orientation, xyz(spheres.offset[i]))
                spheres.position[i] = pack(x + arm, spheres.offset[i][3])
                spheres.velocity[i] = pack(velocity + wp.cross(spin, arm), bodies.mass[b])
                spheres.spin[i] = spin

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False)
    def foresee_bodies(
        # chunk
        first: wp.int32,
        last: wp.int32,
        # state, read
        scenes: Scenes,
        # state, read and written
        flags: wp.array2d(dtype=wp.int32),
        bodies: Bodies,
        spheres: Spheres,
        subcycled: Subcycled,
    ):
        begin_q = first + wp.tid() * wp.static(span)
        for q in range(begin_q, wp.min(begin_q + wp.static(span), last)):
            s = subcycled.body_scene[q]
            rounds = subcycled.rounds[s]
            if flags[s, HALTED] != 0 or rounds == 0:
                continue
            b = subcycled.place[q]
            ahead = scalar(0.5) * scalar(scenes.clock[s, DT])
            kick = scalar(0.25) * scalar(scenes.clock[s, DT] + scenes.clock[s, DT_PREVIOUS]) / scalar(rounds)
            velocity, angular_momentum = kicked(scenes, bodies, spheres, subcycled, q, kick)
            if not (wp.length_sq(velocity) <= scenes.row[s].speed_limit * scenes.row[s].speed_limit):
                if flags[s, FAILED] == 0:
                    flags[s, FAILED] = 1 + b - scenes.row[s].bodies
                continue
            spin = spin_at_middle(subcycled.orientation[q], angular_momentum, bodies.inertia[b], ahead)
            orientation = wp.normalize(turned(subcycled.orientation[q], ahead * spin))
            x = subcycled.position[q] + ahead * velocity
            bodies.position[b] = x
            bodies.orientation[b] = orientation
            bodies.velocity[b] = velocity
            bodies.angular_momentum[b] = angular_momentum
            bodies.spin[b] = spin
            drift = drift_of(scenes, s)
            begin = scenes.row[s].spheres + bodies.first[b + s]
            for i in range(begin, scenes.row[s].spheres + bodies.first[b + s + 1]):
                offset = spheres.offset[i]
                arm = wp.quat_rotate(orientation, xyz(offset))
                if outgrows_lists(scenes, s, x + arm, offset[3], spheres.built[i], drift, wp.static(meshes)):
                    flags[s, LATE] = 1
                spheres.position[i] = pack(x + arm, offset[3])
                spheres.velocity[i] = pack(velocity + wp.cross(spin, arm), bodies.mass[b])
                spheres.spin[i] = spin

    return subcycle_bodies, foresee_bodies
