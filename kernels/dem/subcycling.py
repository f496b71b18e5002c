"""Sub-cycling of stiff bonds: bodies with stiff bonds move in several rounds per time step (multiple time stepping).

Bonds of hydrated contacts are so stiff that leapfrog needs a tenth or a hundredth of the step that all other contacts
allow. A time step with sub-cycling has three parts. First, the contact kernels evaluate all contacts except those of
pairs with a stiff bond. Second, bodies without stiff bonds move by one leapfrog step, as without sub-cycling. Third,
bodies with stiff bonds go through several rounds of velocity Verlet, from the middle of the previous step to the middle
of this step. Each round recomputes the forces of the stiff pairs (contact and bond); all other forces stay constant
through the step.

The contact kernels need positions at the end of a step. For a body with stiff bonds they use its position extrapolated
with its velocity. For a group of bodies that moves as a whole this scheme equals leapfrog (half drift, kick, half
drift). Momentum is conserved, because both bodies of a contact receive the same impulse.

An alternative was tried and rejected: the usual scheme that applies all other forces as one kick per step (Tuckerman et
al. 1992). Such a kick loads a stiff bond with the force times the number of bond periods in a step. With this scheme,
bonds broke that do not break in a run without sub-cycling. Forces held constant, as used here, have a drawback too.
They feed energy into vibrations with periods between half a step and a full step, mostly through the dashpots of
ordinary contacts, which act when the velocity has already changed. Therefore the step is limited to half of what
ordinary contacts allow (`SUBCYCLED_STEP_FRACTION`), and stiff bonds have dashpots (`RELAXATION`).
"""

import functools

import warp as wp

from ..common.control import FAILED, HALTED
from ..common.resident import gather
from ..common.types import SPAN, types, vector_functions
from .bond_parallel import HYDRATED, bond_functions, load_row
from .clump_motion import sphere_motion_function
from .contacts import contact_options
from .motion import motion_functions, rotation_functions
from .pairs import bonded_function, broken_function, pair_functions
from .structs import DT, DT_PREVIOUS, array_structs, links_struct, subcycled_struct

SUBCYCLED_STEP_FRACTION = 0.5
"""Largest time step if stiff bonds are computed in several rounds per step, divided by the stable step of all other
contacts."""
RELAXATION = 0.01
"""Relaxation time of a stiff bond's dashpots (damping / stiffness), as a fraction of the time step."""


@functools.cache
def stiff_pair_function(scalar, law, history: bool, dissipation: bool):
    """Return the function `stiff_pair`, which computes the forces of a stiff pair and updates its contact and bond.

    A stiff pair is joined by a stiff bond. The function returns the force [N] on the sphere with the lower permanent
    number, and the moment of the bond [N m].
    """
    t = types(scalar)
    Subcycled = subcycled_struct(scalar)
    Parameters, contact_force = law.functions(scalar).Parameters, law.functions(scalar).force
    Bond, bond_stiffness = bond_functions(scalar).Bond, bond_functions(scalar).bond_stiffness
    pair = pair_functions(scalar)
    PairTouch, Touch = pair.PairTouch, pair.Touch
    bonded = bonded_function(scalar, False, dissipation)
    xyz, pack = vector_functions(scalar).xyz, vector_functions(scalar).pack

    @wp.func
    def dashpots(p: Bond, touch: Touch, relative_spin: t.vec3, relaxation: scalar):
        """Return the force and moment of a stiff bond's dashpots, and the power that they dissipate [W]."""
        c = relaxation * bond_stiffness(p, touch)
        along = wp.dot(touch.velocity, touch.normal)
        across = touch.velocity - along * touch.normal
        twisting = wp.dot(relative_spin, touch.normal)
        bending = relative_spin - twisting * touch.normal
        power = c[0] * along * along + c[1] * wp.length_sq(across)
        power += c[2] * wp.length_sq(bending) + c[3] * twisting * twisting
        return (c[0] * along) * touch.normal + c[1] * across, c[2] * bending + (c[3] * twisting) * touch.normal, power

    @wp.func
    def stiff_pair(
        subcycled: Subcycled, pair_parameters: wp.array(dtype=Parameters), bond_parameters: wp.array(dtype=Bond),
        first_bond: wp.int32, p: wp.int32, pair: PairTouch, relative_spin: t.vec3, relaxation: scalar, dt: scalar,
    ):  # fmt: skip
        old_history = t.vec3()
        if wp.static(history):
            old_history = xyz(subcycled.held.history[p])
        total, new_history, lost = contact_force(pair_parameters[subcycled.law[p]], pair.touch, old_history, dt)
        moment = t.vec3()
        if subcycled.held.bond[p] > 0:
            total, moment, lost, outcome = bonded(
                subcycled.held, bond_parameters, first_bond, 0, p, pair, relative_spin, total, lost, dt
            )
            if outcome > 0:
                damping, turning, power = dashpots(
                    bond_parameters[first_bond + HYDRATED], pair.touch, relative_spin, relaxation
                )
                total = total + damping
                moment = moment + turning
                lost += dt * power
            else:
                subcycled.outcome[p] = outcome
        elif pair.touch.gap >= scalar(0.0):
            total = t.vec3()
            new_history = t.vec3()
            lost = scalar(0.0)
        if wp.static(history):
            subcycled.held.history[p] = pack(new_history, scalar(0.0))
        if wp.static(dissipation):
            subcycled.lost[p] = subcycled.lost[p] + wp.float64(lost)
        return total, moment

    return stiff_pair


@functools.cache
def pair_round_function(scalar, law, history: bool, healing: bool, dissipation: bool):
    """Return the function `pair_round`, which computes contact and stiff bond of a pair in one sub-cycling round.

    Pairs with stiff bonds are computed in several such rounds per time step.
    """
    t = types(scalar)
    structs = array_structs(scalar)
    Scenes, Pairs = structs.Scenes, structs.Pairs
    Subcycled = subcycled_struct(scalar)
    Parameters = law.functions(scalar).Parameters
    Bond = bond_functions(scalar).Bond
    pair_touch = pair_functions(scalar).pair_touch
    stiff_pair = stiff_pair_function(scalar, law, history, dissipation)
    xyz, pack = vector_functions(scalar).xyz, vector_functions(scalar).pack

    @wp.func
    def keep(pairs: Pairs, subcycled: Subcycled, p: wp.int32, first_load: wp.int32, k: wp.int32):
        """Copy bond, bond force and contact history of a stiffly bonded pair back to its entry in the pair list."""
        if pairs.bond[k] > 0:
            pairs.load[first_load + load_row(pairs.bond[k])] = subcycled.held.load[p]
        if subcycled.held.bond[p] <= 0:
            pairs.bond[k] = subcycled.held.bond[p]
        if wp.static(history):
            pairs.history[k] = subcycled.held.history[p]

    @wp.func
    def pair_round(
        p: wp.int32, turn: wp.int32, pair_parameters: wp.array(dtype=Parameters), bond_parameters: wp.array(dtype=Bond),
        flags: wp.array2d(dtype=wp.int32), scenes: Scenes, pairs: Pairs, subcycled: Subcycled,
    ):  # fmt: skip
        s = subcycled.pair_scene[p]
        rounds = subcycled.rounds[s]
        if flags[s, HALTED] != 0 or turn >= rounds or subcycled.active[p] == 0:
            return
        step = scalar(0.5) * scalar(scenes.clock[s, DT] + scenes.clock[s, DT_PREVIOUS])
        dt = step / scalar(rounds)
        ends = subcycled.ends[p]
        a, b = ends[0], ends[1]
        arm_a = wp.quat_rotate(subcycled.orientation[a], xyz(subcycled.lower_offset[p]))
        arm_b = wp.quat_rotate(subcycled.orientation[b], xyz(subcycled.higher_offset[p]))
        spin_a, spin_b = subcycled.spin[a], subcycled.spin[b]
        pair = pair_touch(
            pack(subcycled.position[a] + arm_a, subcycled.lower_offset[p][3]),
            pack(subcycled.velocity[a] + wp.cross(spin_a, arm_a), subcycled.mass[a]), spin_a,
            pack(subcycled.position[b] + arm_b, subcycled.higher_offset[p][3]),
            pack(subcycled.velocity[b] + wp.cross(spin_b, arm_b), subcycled.mass[b]), spin_b,
            scalar(1.0), dt,
        )  # fmt: skip
        total, moment = stiff_pair(
            subcycled, pair_parameters, bond_parameters, scenes.row[s].bonds, p, pair, spin_b - spin_a,
            scalar(RELAXATION) * step, dt,
        )  # fmt: skip
        if turn + 1 == rounds:
            # If the bond broke, the contact kernels evaluate the pair from the next step on.
            if subcycled.held.bond[p] <= 0:
                subcycled.active[p] = 0
                total = t.vec3()
                moment = t.vec3()
                if wp.static(healing):
                    if pair.touch.gap >= scalar(0.0):
                        # Reset the broken bond, so that the pair may bond again when its spheres next touch.
                        subcycled.held.bond[p] = 0
            first_load = scenes.row[s].loads
            keep(pairs, subcycled, p, first_load, subcycled.entry[p])
            if subcycled.copy[p] >= 0:
                keep(pairs, subcycled, p, first_load, subcycled.copy[p])
        bent = wp.cross(pair.touch.normal, total)
        subcycled.force[ends[2]] = total
        subcycled.torque[ends[2]] = pair.arm_i * bent + moment + wp.cross(arm_a, total)
        subcycled.force[ends[3]] = -total
        subcycled.torque[ends[3]] = pair.arm_j * bent - moment - wp.cross(arm_b, total)

    return pair_round


@functools.cache
def pair_kernel(scalar, law, history: bool, healing: bool, dissipation: bool) -> wp.Kernel:
    """Return the CPU kernel that computes all pairs with stiff bonds in one of the sub-cycling rounds of a step.

    The class `Features` in `warpcrete/dem/engine/model.py` explains the flags.
    """
    structs = array_structs(scalar)
    Scenes, Pairs = structs.Scenes, structs.Pairs
    Subcycled = subcycled_struct(scalar)
    Parameters, Bond = law.functions(scalar).Parameters, bond_functions(scalar).Bond
    pair_round = pair_round_function(scalar, law, history, healing, dissipation)

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False, module_options=contact_options(True))
    def subcycle_pairs(
        # The next arguments are arrays of the model, which are constant during a run.
        pair_parameters: wp.array(dtype=Parameters),
        bond_parameters: wp.array(dtype=Bond),
        # The next arguments are the range of pairs that this launch processes, and the number of the sub-cycling round.
        first: wp.int32,
        last: wp.int32,
        turn: wp.int32,
        # The next arguments are arrays of the simulated state that this kernel only reads.
        flags: wp.array2d(dtype=wp.int32),
        scenes: Scenes,
        # The next arguments are arrays of the simulated state that this kernel reads and writes.
        pairs: Pairs,
        subcycled: Subcycled,
    ):
        begin_p = first + wp.tid() * SPAN
        for p in range(begin_p, wp.min(begin_p + SPAN, last)):
            pair_round(p, turn, pair_parameters, bond_parameters, flags, scenes, pairs, subcycled)

    return subcycle_pairs


@functools.cache
def kick_functions(scalar, dissipation: bool):
    """Return the functions `apply_kick` and `record_losses` for bodies that move in sub-cycling rounds.

    `apply_kick` applies the forces on a body for a given time. `record_losses` records the energy that the stiff pairs
    of a body lose in the rounds of a step, and the bonds that break.
    """
    Spheres = array_structs(scalar).Spheres
    Subcycled = subcycled_struct(scalar)
    count_broken = broken_function(scalar)

    @wp.func
    def apply_kick(subcycled: Subcycled, q: wp.int32, kick: scalar):
        """Return velocity and angular momentum of body q after all forces have acted on it for the time `kick` [s]."""
        total = subcycled.other_force[q]
        torque = subcycled.other_torque[q]
        for place in range(subcycled.start[q], subcycled.start[q + 1]):
            total += subcycled.force[place]
            torque += subcycled.torque[place]
        velocity = subcycled.velocity[q] + (kick / subcycled.mass[q]) * total
        return velocity, subcycled.angular_momentum[q] + kick * torque

    @wp.func
    def record_losses(subcycled: Subcycled, spheres: Spheres, q: wp.int32, i: wp.int32):
        """Add the energy loss and the broken bonds of body q's stiff pairs to the totals that are recorded at sphere i.

        A pair is counted at only one of its two bodies: that of the sphere with the lower permanent number.
        """
        for place in range(subcycled.start[q], subcycled.start[q + 1]):
            if subcycled.ref[place] % 2 == 0:
                p = subcycled.ref[place] / 2
                if subcycled.outcome[p] < 0:
                    count_broken(spheres, i, subcycled.outcome[p])
                    subcycled.outcome[p] = 1
                if wp.static(dissipation):
                    spheres.dissipated_energy[i] = spheres.dissipated_energy[i] + subcycled.lost[p]
                    subcycled.lost[p] = wp.float64(0.0)

    return apply_kick, record_losses


@functools.cache
def body_round_function(scalar):
    """Return the function `body_round`, which moves a body with stiff bonds through one sub-cycling round."""
    Scenes = array_structs(scalar).Scenes
    Subcycled = subcycled_struct(scalar)
    turned, spin_at_middle = rotation_functions(scalar)
    new_position, apply_kick = motion_functions(scalar, False).new_position, kick_functions(scalar, False)[0]

    @wp.func
    def body_round(
        q: wp.int32, turn: wp.int32, flags: wp.array2d(dtype=wp.int32), scenes: Scenes, subcycled: Subcycled
    ):  # fmt: skip
        s = subcycled.body_scene[q]
        rounds = subcycled.rounds[s]
        if flags[s, HALTED] != 0 or turn >= rounds:
            return
        dt = scalar(0.5) * scalar(scenes.clock[s, DT] + scenes.clock[s, DT_PREVIOUS]) / scalar(rounds)
        kick = dt
        if turn == 0:
            kick = scalar(0.5) * dt
        velocity, angular_momentum = apply_kick(subcycled, q, kick)
        x, rounding = new_position(subcycled.position[q], dt * velocity, subcycled.rounding[q])
        spin = spin_at_middle(subcycled.orientation[q], angular_momentum, subcycled.inertia[q], dt)
        subcycled.orientation[q] = wp.normalize(turned(subcycled.orientation[q], dt * spin))
        subcycled.rounding[q] = rounding
        subcycled.position[q] = x
        subcycled.velocity[q] = velocity
        subcycled.angular_momentum[q] = angular_momentum
        subcycled.spin[q] = spin

    return body_round


@functools.cache
def body_kernel(scalar) -> wp.Kernel:
    """Return the CPU kernel that moves all bodies with stiff bonds through one of the sub-cycling rounds of a step."""
    Scenes = array_structs(scalar).Scenes
    Subcycled = subcycled_struct(scalar)
    body_round = body_round_function(scalar)

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False)
    def subcycle_bodies(
        # The next arguments are the range of bodies that this launch processes, and the number of the sub-cycling
        # round.
        first: wp.int32,
        last: wp.int32,
        turn: wp.int32,
        # The next arguments are arrays of the simulated state that this kernel only reads.
        flags: wp.array2d(dtype=wp.int32),
        scenes: Scenes,
        # The next arguments are arrays of the simulated state that this kernel reads and writes.
        subcycled: Subcycled,
    ):
        begin_q = first + wp.tid() * SPAN
        for q in range(begin_q, wp.min(begin_q + SPAN, last)):
            body_round(q, turn, flags, scenes, subcycled)

    return subcycle_bodies


@functools.cache
def rounds_kernel(scalar, law, history: bool, healing: bool, dissipation: bool) -> wp.Kernel:
    """Return the GPU kernel that performs all sub-cycling rounds of a step in one launch with `threads` threads.

    Its blocks stay on the GPU and wait for each other at barriers. Two kernel launches per round, each of which must
    wait for the previous launch, would be slower. The class `Features` in `warpcrete/dem/engine/model.py` explains the
    flags.
    """
    structs = array_structs(scalar)
    Scenes, Pairs = structs.Scenes, structs.Pairs
    Subcycled = subcycled_struct(scalar)
    Parameters, Bond = law.functions(scalar).Parameters, bond_functions(scalar).Bond
    pair_round = pair_round_function(scalar, law, history, healing, dissipation)
    body_round = body_round_function(scalar)

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False, module_options=contact_options(False))
    def subcycle_all(
        # The next arguments are arrays of the model, which are constant during a run.
        pair_parameters: wp.array(dtype=Parameters),
        bond_parameters: wp.array(dtype=Bond),
        # The next arguments are the number of threads, the number of blocks that meet at barriers, and the sizes of the
        # arrays.
        threads: wp.int32,
        parties: wp.int32,
        body_count: wp.int32,
        pair_count: wp.int32,
        # The next arguments are arrays of the simulated state that this kernel only reads.
        flags: wp.array2d(dtype=wp.int32),
        scenes: Scenes,
        # The next arguments are arrays of the simulated state that this kernel reads and writes.
        pairs: Pairs,
        subcycled: Subcycled,
        gate: wp.array(dtype=wp.int32),
    ):
        thread = wp.tid()
        # `flags` do not change in this kernel, so all threads compute the same number of rounds and meet at the same
        # barriers. If all scenes are halted, no barrier is needed.
        most = wp.int32(0)
        for s in range(flags.shape[0]):
            if flags[s, HALTED] == 0:
                most = wp.max(most, subcycled.rounds[s])
        for turn in range(most):
            for q in range(thread, body_count, threads):
                body_round(q, turn, flags, scenes, subcycled)
            gather(gate, parties)
            for p in range(thread, pair_count, threads):
                pair_round(p, turn, pair_parameters, bond_parameters, flags, scenes, pairs, subcycled)
            gather(gate, parties)

    return subcycle_all


@functools.cache
def prediction_kernel(scalar, meshes: bool, half: bool, dissipation: bool) -> wp.Kernel:
    """Return the kernel over bodies with stiff bonds that runs after the last sub-cycling round of a step.

    It applies the last half kick, and predicts the bodies' positions at the end of the step for the contact kernels. It
    also records the energy losses and the broken bonds of the bodies' stiff pairs.
    """
    span = SPAN if half else 1
    structs = array_structs(scalar)
    Scenes, Bodies, Spheres = structs.Scenes, structs.Bodies, structs.Spheres
    Subcycled = subcycled_struct(scalar)
    turned, spin_at_middle = rotation_functions(scalar)
    move_sphere, Links = sphere_motion_function(scalar, False, meshes, half), links_struct(scalar)
    apply_kick, record_losses = kick_functions(scalar, dissipation)

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False)
    def predict_bodies(
        # The next arguments are the range of bodies that this launch processes.
        first: wp.int32,
        last: wp.int32,
        # The next arguments are arrays of the simulated state that this kernel only reads.
        scenes: Scenes,
        # The next arguments are arrays of the simulated state that this kernel reads and writes.
        flags: wp.array2d(dtype=wp.int32),
        bodies: Bodies,
        spheres: Spheres,
        links: Links,
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
            velocity, angular_momentum = apply_kick(subcycled, q, kick)
            if not (wp.length_sq(velocity) <= scenes.row[s].speed_limit * scenes.row[s].speed_limit):
                wp.atomic_cas(flags, s, FAILED, 0, 1 + b - scenes.row[s].bodies)
                continue
            subcycled.velocity[q] = velocity
            subcycled.angular_momentum[q] = angular_momentum
            spin = spin_at_middle(subcycled.orientation[q], angular_momentum, subcycled.inertia[q], ahead)
            orientation = wp.normalize(turned(subcycled.orientation[q], ahead * spin))
            x = subcycled.position[q] + ahead * velocity
            bodies.position[b] = x
            bodies.rounding[b] = subcycled.rounding[q]
            bodies.orientation[b] = orientation
            bodies.velocity[b] = velocity
            bodies.angular_momentum[b] = angular_momentum
            bodies.spin[b] = spin
            begin = scenes.row[s].spheres + bodies.first[b + s]
            record_losses(subcycled, spheres, q, begin)
            for i in range(begin, scenes.row[s].spheres + bodies.first[b + s + 1]):
                move_sphere(
                    flags, scenes, spheres, links, s, i, x, orientation, scalar(1.0), velocity, spin,
                    subcycled.mass[q], scalar(2.0) * ahead,
                )  # fmt: skip

    return predict_bodies
