"""Kernels that estimate the stable time step from masses, stiffness and dashpots of contacts and bonds.

For each body, the 3x3 stiffness K and damping C of all its touching or bonded contacts are added up. The same is done
for rotation about the centroid, from the lever arms of contacts and the moments of bonds; these matrices are rotated to
principal axes and scaled by the moments of inertia. Let k and c be the largest absolute row sums of K and C, and let m
be the body's mass. The step is the minimum over all bodies of

    dt = 2 m / (c + sqrt(c^2 + 4 m k)).

This is half the stability limit of leapfrog for a body between fixed neighbours, with dashpots that use the velocity of
half a step ago. The factor of a half allows neighbours of equal mass to move in opposition. For a body with one
contact, dt equals the step of the program PFC, sqrt(m/k) (sqrt(1 + beta^2) - beta), where beta is the contact's
critical damping ratio. For several contacts, dt takes all dashpots into account, unlike PFC's formula.

An automatic step obeys two more limits. First, the step must resolve impacts: time integration must not add energy to
an impact that loses little. Second, no sphere may move further in a step than a fraction LEAP of its radius.
"""

import functools
import math
from types import SimpleNamespace

import warp as wp

from ..common.control import ARRIVED, ESTIMATED, FAILED, HALTED, STALE, STEPS
from ..common.rows import row_functions
from ..common.types import types, vector_functions
from ..common.walls import DRIVEN
from .clock import arrived_function
from .contact_law import contact_functions
from .contacts import contact_options
from .stiffness import estimate_struct, stiffness_functions
from .structs import DT, STABLE, array_structs, subcycled_struct
from .subcycling import RELAXATION, SUBCYCLED_STEP_FRACTION

DEFAULT_SAFETY = 0.8
"""Default safety factor: the time step as a fraction of the stable step."""
LEAP = 0.4
"""Largest motion of a sphere in an automatic time step, as a fraction of the sphere's radius.

The gap between two spheres that approach each other may shrink by twice that distance in a step.
"""
LONGEST = 1.0e30
"""Time step [s] that stands for "no limit"."""


@functools.cache
def begin_kernel(scalar) -> wp.Kernel:
    """Return the kernel over scenes that selects the scenes whose stable step is estimated, and prepares the estimate.

    Without `by_device`, these are the scenes that the host has marked in `requested`. With `by_device`, these are the
    scenes that have halted because their interval between two estimates is over. The kernel resets the largest speeds,
    the smallest time steps and the stiffness sums of the walls.
    """
    structs = array_structs(scalar)
    Scenes = structs.Scenes
    Estimate = estimate_struct(scalar)

    @wp.kernel(module="unique", enable_backward=False)
    def begin_estimate(
        # The next arguments are arrays that this kernel only reads.
        requested: wp.array(dtype=wp.int32),
        by_device: wp.bool,
        flags: wp.array2d(dtype=wp.int32),
        scenes: Scenes,
        # The next arguments are arrays that this kernel writes.
        due: wp.array(dtype=wp.int32),
        estimate: Estimate,
    ):
        s = wp.tid()
        wanted = requested[s] != 0
        if by_device:
            # If the neighbour lists of a scene are out of date, its estimate waits until they are rebuilt, on a GPU as
            # on a CPU. The sums depend on the order of the list entries, so an estimate with the old lists would
            # differ.
            wanted = flags[s, HALTED] == ARRIVED and flags[s, STALE] == 0 and flags[s, FAILED] == 0
            wanted = wanted and flags[s, STEPS] - flags[s, ESTIMATED] >= scenes.row[s].interval
        due[s] = wp.where(wanted, 1, 0)
        if not wanted:
            return
        for part in range(estimate.smallest.shape[0]):
            estimate.smallest[part, s] = wp.float64(wp.static(LONGEST))
            estimate.resolution_step[part, s] = wp.float64(wp.static(LONGEST))
            estimate.fastest[part, s] = scenes.row[s].expected_speed
            for w in range(scenes.row[s].walls, scenes.row[s].walls + scenes.row[s].wall_count):
                estimate.wall_load[part, w, 0] = wp.int64(0)
                estimate.wall_load[part, w, 1] = wp.int64(0)

    return begin_estimate


@functools.cache
def recording_functions(scalar):
    """Return functions that collect speeds and the stiffness of wall contacts for the stable step estimate.

    They use the struct `Estimate`, in whose arrays each CPU thread has its own part.

    - `record_speed` updates the largest speed in a thread's part.
    - `add_wall_stiffness` adds the stiffness and damping of a contact to the sums of a wall.
    - `fastest` returns the largest speed in a scene over the parts of all threads.
    - `least` returns the smallest value of a scene in a given array over the parts of all threads.
    """
    t = types(scalar)
    Estimate = estimate_struct(scalar)

    @wp.func
    def record_speed(estimate: Estimate, part: wp.int32, s: wp.int32, speed: scalar):
        # Read the present maximum first, because this avoids nearly all atomic operations. The value may be outdated,
        # but it is never too high, so no new maximum is missed.
        if wp.float64(speed) > estimate.fastest[part, s]:
            wp.atomic_max(estimate.fastest, part, s, wp.float64(speed))

    @wp.func
    def add_wall_stiffness(estimate: Estimate, part: wp.int32, w: wp.int32, k: t.vec4):
        # Add integers, because their sum does not depend on the order in which threads add them.
        wp.atomic_add(estimate.wall_load, part, w, 0, wp.int64(wp.float64(k[0]) * wp.float64(1000.0)))
        wp.atomic_add(estimate.wall_load, part, w, 1, wp.int64(wp.float64(k[2]) * wp.float64(1000.0)))

    @wp.func
    def fastest(estimate: Estimate, s: wp.int32):
        found = estimate.fastest[0, s]
        for part in range(1, estimate.fastest.shape[0]):
            found = wp.max(found, estimate.fastest[part, s])
        return found

    @wp.func
    def least(parts: wp.array2d(dtype=wp.float64), s: wp.int32):
        found = parts[0, s]
        for part in range(1, parts.shape[0]):
            found = wp.min(found, parts[part, s])
        return found

    return SimpleNamespace(
        record_speed=record_speed, add_wall_stiffness=add_wall_stiffness, fastest=fastest, least=least
    )


@functools.cache
def floor_function(scalar, pair_law, wall_law):
    """Return `floor_of`, which computes the smallest stiffness and damping for which a body's time step must be stable.

    A body in free flight has no contact, but its time step must already be stable for the next contact.
    """
    t = types(scalar)
    Pair, pair_stiffness = pair_law.functions(scalar).Parameters, pair_law.functions(scalar).stiffness
    Wall, wall_stiffness = wall_law.functions(scalar).Parameters, wall_law.functions(scalar).stiffness
    wall_touch = contact_functions(scalar).wall_touch

    @wp.func
    def resolved(k: t.vec4, onset: scalar, mass: scalar):
        """Return the stiffness K for which a time step of sqrt(`mass` / K) keeps an impact's energy within a tolerance.

        The tolerance is 1 % of the impact's energy plus a quarter of the energy that the impact loses. `onset` is the
        stiffness of the contact at first touch. `k[0]` and `k[2]` are the stiffness and the damping that the contact
        reaches during the impact.

        The largest error occurs if the bodies touch and separate again within one time step dt. The error is then a
        fraction of up to (w dt)^2 / 4 of the energy, where w = sqrt(`onset` / `mass`). If the stiffness of the contact
        grows from zero, the fraction is less than 0.3 (w dt)^2 / 4 with w = sqrt(`k[0]` / `mass`).
        """
        stiffest = wp.max(onset, scalar(0.3) * k[0])
        if stiffest <= scalar(0.0):
            return scalar(0.0)
        lost = scalar(1.0) - wp.exp(-scalar(wp.static(math.pi)) * k[2] / wp.sqrt(mass * wp.max(onset, k[0])))
        return scalar(0.25) * stiffest / (scalar(0.01) + scalar(0.25) * lost)

    @wp.func
    def floor_of(
        pair_parameters: wp.array(dtype=Pair),
        wall_parameters: wp.array(dtype=Wall),
        row: wp.int32,
        materials: wp.int32,
        radius: scalar,
        speed: scalar,
        mass: scalar,
        turn: scalar,
        tip: scalar,
    ):
        """Return stiffness and damping of the next contact of a body in flight, and the stiffness that limits errors.

        The next contact is assumed to be the stiffest one with a sphere or wall of any material. A force at a contact
        moves and rotates the body. `turn` is the resulting acceleration of the contact point under a shear force,
        divided by the acceleration without rotation. `tip` is the same ratio for a normal force.

        The limit of the time step contains a reserve of a factor of two in stiffness, for neighbours that move in
        opposition. A body with a single contact does not need this reserve, so only half of the shear stiffness counts.
        Damping counts in full, because its limit contains no reserve: dashpots act half a step late.

        The third result is the stiffness from `resolved`, corrected by `tip`: a time step that fits this stiffness
        keeps the energy of the contact within the tolerance.
        """
        n = t.vec3(scalar(0.0), scalar(0.0), scalar(1.0))
        touch = wall_touch(n, scalar(0.0), -speed * n, scalar(0.0), radius, mass)
        gentle = wall_touch(n, scalar(0.0), t.vec3(), scalar(0.0), radius, mass)
        k_floor = scalar(0.0)
        c_floor = scalar(0.0)
        k_resolved = scalar(0.0)
        for m in range(materials):
            k = pair_stiffness(pair_parameters[row + m], touch)
            k_floor = wp.max(k_floor, wp.max(k[0], scalar(0.5) * turn * k[1]))
            c_floor = wp.max(c_floor, wp.max(k[2], turn * k[3]))
            k_resolved = wp.max(k_resolved, resolved(k, pair_stiffness(pair_parameters[row + m], gentle)[0], mass))
            k = wall_stiffness(wall_parameters[row + m], touch)
            k_floor = wp.max(k_floor, wp.max(k[0], scalar(0.5) * turn * k[1]))
            c_floor = wp.max(c_floor, wp.max(k[2], turn * k[3]))
            k_resolved = wp.max(k_resolved, resolved(k, wall_stiffness(wall_parameters[row + m], gentle)[0], mass))
        return k_floor, c_floor, tip * k_resolved

    return floor_of


@functools.cache
def reduce_kernel(scalar, pair_law, wall_law, half: bool) -> wp.Kernel:
    """Return the kernel that finds the smallest stable step of each scene.

    It runs with one task per body, beginning with the body `begin`. With half lists, another kernel adds each pair's
    stiffness to entries of `estimate.sums` for both of its spheres. The returned kernel sets these entries to zero
    after use, for the next estimate.
    """
    t = types(scalar)
    structs = array_structs(scalar)
    Scenes, Bodies, Spheres = structs.Scenes, structs.Bodies, structs.Spheres
    Estimate = estimate_struct(scalar)
    PairParameters = pair_law.functions(scalar).Parameters
    WallParameters = wall_law.functions(scalar).Parameters
    floor_of = floor_function(scalar, pair_law, wall_law)
    matrices = stiffness_functions(scalar)
    full, row_sum, stable = matrices.full, matrices.row_sum, matrices.stable
    vec6 = wp.types.vector(6, scalar)
    xyz = vector_functions(scalar).xyz
    fastest = recording_functions(scalar).fastest
    rows = row_functions(scalar)
    read_vec3, read_vec4 = rows.read_vec3, rows.read_vec4

    # Compile without `fast_math` even on a GPU, because `fast_math` flushes very small numbers to zero, such as
    # products of the moments of inertia of small bodies.
    @wp.kernel(module="unique", enable_backward=False, module_options=contact_options(True))
    def reduce_step(
        # The next arguments are arrays of the model, which are constant during a run.
        pair_parameters: wp.array(dtype=PairParameters),
        wall_parameters: wp.array(dtype=WallParameters),
        # The next arguments are arrays of the simulated state that this kernel only reads.
        due: wp.array(dtype=wp.int32),
        begin: wp.int32,
        part: wp.int32,
        stiff: wp.bool,
        scenes: Scenes,
        bodies: Bodies,
        spheres: Spheres,
        # The next arguments are arrays that this kernel writes.
        estimate: Estimate,
    ):
        b = begin + wp.tid()
        s = bodies.scene[b]
        if due[s] == 0:
            return
        base = scenes.row[s].spheres
        materials = scenes.row[s].materials
        top = scalar(fastest(estimate, s))
        mass = bodies.mass[b]
        inertia = bodies.inertia[b]
        smallest_inertia = wp.min(inertia)
        largest_inertia = wp.max(inertia)
        k_sum = vec6()
        c_sum = vec6()
        k_turn = vec6()
        c_turn = vec6()
        k_floor = scalar(0.0)
        c_floor = scalar(0.0)
        k_resolved = scalar(0.0)
        leap = scalar(wp.static(LONGEST))
        for place in range(base + bodies.first[b + s], base + bodies.first[b + s + 1]):
            k_sum += estimate.sums[place, 0]
            c_sum += estimate.sums[place, 1]
            k_turn += estimate.sums[place, 2]
            c_turn += estimate.sums[place, 3]
            if wp.static(half):
                for column in range(4):
                    estimate.sums[place, column] = vec6()
            # The stable step must also suit the next contact of a body that touches nothing now. Assume a contact of
            # this sphere with the fastest object in the scene. A tangential force on the sphere turns the body about
            # its long axis with the sphere's radius as lever arm. It turns the body about the other axes with `lever`,
            # the distance from the body's centre to the far side of the sphere, as lever arm.
            position = read_vec4(spheres.position, place)
            radius = position[3]
            own = wp.length(xyz(read_vec4(spheres.velocity, place)))
            speed = own + top
            lever = radius + wp.length(xyz(position) - read_vec3(bodies.position, b))
            turn = scalar(1.0) + mass * wp.max(radius * radius / smallest_inertia, lever * lever / largest_inertia)
            row = scenes.row[s].laws + spheres.material[place] * materials
            tip = scalar(1.0) + mass * (lever - radius) * (lever - radius) / largest_inertia
            k, c, k_smooth = floor_of(pair_parameters, wall_parameters, row, materials, radius, speed, mass, turn, tip)
            k_floor = wp.max(k_floor, k)
            k_resolved = wp.max(k_resolved, k_smooth)
            leap = wp.min(leap, scalar(wp.static(LEAP)) * radius / wp.max(own, scalar(wp.static(1.0 / LONGEST))))
            c_floor = wp.max(c_floor, c)
        if stiff:
            k_floor = scalar(0.0)
            c_floor = scalar(0.0)
        unit = t.vec3(mass, mass, mass)
        k_move = wp.max(row_sum(full(k_sum), unit), k_floor / mass)
        step = stable(k_move, wp.max(row_sum(full(c_sum), unit), c_floor / mass))
        axes = wp.quat_to_matrix(bodies.orientation[b])
        k_spin = row_sum(wp.transpose(axes) * full(k_turn) * axes, inertia)
        if k_spin > scalar(0.0):
            step = wp.min(step, stable(k_spin, row_sum(wp.transpose(axes) * full(c_turn) * axes, inertia)))
        fine = leap
        if k_resolved > scalar(0.0):
            fine = wp.min(fine, wp.sqrt(mass / k_resolved))
        if not stiff and wp.float64(fine) < estimate.resolution_step[part, s]:
            wp.atomic_min(estimate.resolution_step, part, s, wp.float64(fine))
        if wp.float64(step) < estimate.smallest[part, s]:
            wp.atomic_min(estimate.smallest, part, s, wp.float64(step))
        elif not (step >= scalar(0.0)):
            estimate.smallest[part, s] = wp.float64(-1.0)

    return reduce_step


@functools.cache
def keep_kernel(scalar) -> wp.Kernel:
    """Return the kernel over scenes that stores the new estimate of the stable step of pairs with stiff bonds [s]."""
    Estimate, Subcycled = estimate_struct(scalar), subcycled_struct(scalar)
    least = recording_functions(scalar).least

    @wp.kernel(module="unique", enable_backward=False)
    def keep_stable(due: wp.array(dtype=wp.int32), estimate: Estimate, subcycled: Subcycled):
        s = wp.tid()
        if due[s] == 0:
            return
        subcycled.stable[s] = least(estimate.smallest, s)

    return keep_stable


@functools.cache
def step_kernel(scalar, subcycling: bool) -> wp.Kernel:
    """Return the kernel that computes the stable step and the next time step of each scene, with one thread per scene.

    A wall that a force drives can limit the stable step, too. A scene halts while its stable step is estimated. With
    `by_device`, this kernel lets the scene continue. If no valid step was found, the scene stays halted, so that the
    host can report it.
    """
    structs = array_structs(scalar)
    Scenes, Walls = structs.Scenes, structs.Walls
    Estimate, Subcycled = estimate_struct(scalar), subcycled_struct(scalar)
    arrived = arrived_function(scalar)
    least = recording_functions(scalar).least

    @wp.kernel(module="unique", enable_backward=False)
    def set_step(
        # The next arguments are arrays that this kernel only reads.
        due: wp.array(dtype=wp.int32),
        by_device: wp.bool,
        estimate: Estimate,
        subcycled: Subcycled,
        walls: Walls,
        # The next arguments are arrays that this kernel reads and writes.
        flags: wp.array2d(dtype=wp.int32),
        scenes: Scenes,
    ):
        s = wp.tid()
        if due[s] == 0:
            return
        one = wp.float64(1.0)
        step = least(estimate.smallest, s)
        if wp.static(subcycling):
            if subcycled.rounds[s] > 0:
                # A sub-cycling round has the length h = step / rounds. It is stable for a mass m on a spring k with a
                # dashpot c if k h^2 + c h <= m. The dashpot of a stiff bond is c = RELAXATION step k, so c h =
                # RELAXATION rounds k h^2. Let `stable` be the stable step of the stiff pairs without dashpots, so that
                # m / k = stable^2. It follows that h <= stable / sqrt(1 + RELAXATION rounds).
                rounds = wp.float64(subcycled.rounds[s])
                stiff = subcycled.stable[s] * rounds / wp.sqrt(one + wp.float64(RELAXATION) * rounds)
                step = wp.min(wp.float64(SUBCYCLED_STEP_FRACTION) * step, stiff)
        for w in range(scenes.row[s].walls, scenes.row[s].walls + scenes.row[s].wall_count):
            if walls.table[w].motion == DRIVEN:
                # A driven wall has a mass like a body, so it also limits the step. Its stiffness is at least that of
                # one contact with the largest sphere, because a sphere may touch the wall in the coming steps.
                spring = wp.int64(0)
                dashpot = wp.int64(0)
                for part in range(estimate.wall_load.shape[0]):
                    spring += estimate.wall_load[part, w, 0]
                    dashpot += estimate.wall_load[part, w, 1]
                load = wp.float64(1.0e-3) * wp.float64(spring)
                stiffness = wp.max(load, scenes.row[s].wall_stiffness)
                mass = walls.table[w].mass
                # Dashpots are sized for the masses of aggregates, so they may be far above critical damping for the
                # mass of the wall. The stable step of the wall therefore accounts for damping.
                ratio = wp.float64(0.5e-3) * wp.float64(dashpot) / wp.sqrt(mass * stiffness)
                own = wp.sqrt(mass / stiffness) * (wp.sqrt(one + ratio * ratio) - ratio)
                step = wp.min(step, own)
        scenes.clock[s, STABLE] = step
        usable = step > wp.float64(0.0)
        if scenes.row[s].fixed_step > wp.float64(0.0):
            scenes.clock[s, DT] = scenes.row[s].fixed_step
            usable = usable and scenes.row[s].fixed_step <= step * wp.max(one, scenes.row[s].safety)
        else:
            bold = wp.max(one, scenes.row[s].safety / wp.float64(wp.static(DEFAULT_SAFETY)))
            fine = bold * least(estimate.resolution_step, s)
            scenes.clock[s, DT] = wp.min(wp.min(scenes.row[s].safety * step, fine), scenes.row[s].largest_step)
        if by_device and usable:
            flags[s, ESTIMATED] = flags[s, STEPS]
            if not arrived(flags, scenes, s):
                flags[s, HALTED] = 0

    return set_step
