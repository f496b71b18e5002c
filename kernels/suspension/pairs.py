"""Lubrication and contacts between aggregates, and between aggregates and walls.

The grid resolves the flow between two aggregates only in part if their gap is narrower than about two cells (the
cut-off gap). In such gaps, the part of the lubrication force that is missing on the grid is added as a force.
Touching aggregates repel each other. Both forces depend linearly on the relative velocity along the line of centres, so
they are part of the matrix of the implicit solve and do not limit the time step.

Every sphere has its own list of neighbours, also within a clump. Forces on a sphere of a clump also exert a torque on
the clump. In comments on array shapes, m is the number of spheres of all aggregates; it is the number n of aggregates
if each of them is one sphere.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.control import HALTED
from ..common.types import types
from ..mps.grid.cells import DT, grid_parameters_struct, grid_structs
from ..mps.structs import mps_types
from .bodies import BodyKind, body_structs, shape_functions
from .vectors import vector_struct

CAPACITY = wp.constant(48)
"""Maximum number of neighbours of a sphere, including walls."""
WALL = wp.constant(-1)
"""Value that is stored instead of a neighbour's index if the neighbour is a wall."""
NEW = wp.constant(2)
"""Value of `touching` for a pair that touches, but has no contact force in the solution yet.

The latest check of a solution has found that the pair would overlap at the end of this time step. The solve is then
repeated with the contact force of the pair, if fewer than the maximum number of repetitions were made. The next check
changes the value to 1."""
MISSING, MISSING_AT_WALL = wp.constant(0.3), wp.constant(0.6)
"""Constants of the lubrication force that is missing on the grid, between two aggregates and at a wall.

At a gap h, the grid gives about the lubrication force at the larger gap h + d. The length d is the constant times
w sqrt(w / a), where w is the width of a cell, and 1 / a = 1 / R1 + 1 / R2 with the radii R1 and R2 of the spheres. At a
wall, a is the radius of the sphere. The constants were fitted to the approach of two spheres and of a sphere and a wall
(Brenner 1961) with 4 and 8 cells across a sphere."""
HOLD = wp.constant(300.0)
"""Resistance of a contact to approach, divided by the resistance of the aggregate to motion by drag and inertia.

A time step of the largest allowed duration reduces an overlap to about 1 / (1 + HOLD) of its value."""
SAME = wp.constant(0.8)
"""Cosine of the angle between the normals of two walls above which they may be the same wall."""
LOOKED_AT = wp.constant(2.0)
"""Largest gap at which two aggregates count as neighbours, divided by the width of a cell. In one time step each
aggregate moves by at most one cell, so the gap between two aggregates shrinks by at most two cells."""


@functools.cache
def pair_struct(scalar):
    """Build the struct `Pairs`: the neighbours of all aggregates and the forces between them."""
    vec3 = types(scalar).vec3

    @wp.struct
    class Pairs:
        count: wp.array(dtype=wp.int32)  # Number of neighbours of each sphere, shape (m,).

        # The following arrays have one entry for each neighbour, shape (m * CAPACITY,).
        other: wp.array(dtype=wp.int32)  # Index of the neighbouring sphere, or WALL for a wall.
        normal: wp.array(dtype=vec3)  # Unit vector from the sphere towards the neighbour.

        # Gap between sphere and neighbour at the start of the step, negative for an overlap [m].
        gap: wp.array(dtype=scalar)
        rough: wp.array(dtype=scalar)  # Gap below which two neighbours count as touching [m].
        still: wp.array(dtype=scalar)  # Velocity of a wall along `normal` [m/s]; 0 if the neighbour is a sphere.

        # Lubrication force per speed of approach, in addition to the force that the grid resolves [N s/m].
        lubrication: wp.array(dtype=scalar)
        hold: wp.array(dtype=scalar)  # Contact force per speed of approach [N s/m].

        # 0 if sphere and neighbour do not touch in this step; 1 if they touch; NEW if they touch, but the solution does
        # not contain their contact force yet, because the latest check of the solution has found the contact.
        touching: wp.array(dtype=wp.int32)
        # The next arrays are empty without friction.
        grip: wp.array(dtype=scalar)  # Friction force per speed at which the surfaces slide [N s/m].
        drift: wp.array(dtype=vec3)  # Velocity of a wall along its surface [m/s]; 0 if the neighbour is a sphere.

        # The next arrays describe the contacts at the end of the last step: the number of contacts of each sphere,
        # shape (m,), and for each contact the neighbour, the unit vector towards it and the normal force [N], shape
        # (m * CAPACITY,).
        last_count: wp.array(dtype=wp.int32)
        last_other: wp.array(dtype=wp.int32)
        last_normal: wp.array(dtype=vec3)
        last_force: wp.array(dtype=scalar)
        # `smallest_gap` has one entry for each sphere, shape (m,); `full` and `changed` have a single entry.
        smallest_gap: wp.array(dtype=scalar)  # Smallest gap to a neighbour, divided by the sphere's radius.
        full: wp.array(dtype=wp.int32)  # 1 if a sphere has more neighbours than CAPACITY.
        changed: wp.array(dtype=wp.int32)  # 1 if the last coupled solve has found a new contact.

    return Pairs


@functools.cache
def store_functions(scalar) -> SimpleNamespace:
    """Build functions for the list of a sphere's neighbours.

    - `store` stores a neighbour of a sphere.
    - `is_known` tells whether a wall is already stored.
    """
    vec = mps_types(scalar, 3).vec
    Grid, Pairs = grid_parameters_struct(scalar, 3), pair_struct(scalar)

    @wp.func
    def store(
        g: Grid, pairs: Pairs, b: wp.int32, count: wp.int32, other: wp.int32, normal: vec, gap: scalar,
        approach: scalar, still: scalar, reduced: scalar, radius: scalar, cutoff: scalar, missing: scalar,
        roughness: scalar, dt: scalar, longest: scalar,
    ) -> wp.int32:  # fmt: skip
        """Store a neighbour of sphere `b` with the coefficients of its forces, and return the new number of neighbours.

        `approach` is the speed of approach at the start of the step [m/s]. `reduced` is the product of both radii
        divided by their sum [m], which is the radius of the sphere if the neighbour is a wall. `missing` is the
        constant of the lubrication force that is missing on the grid, such as MISSING.
        """
        if count == CAPACITY:
            pairs.full[0] = 1
            return count
        place = b * CAPACITY + count
        rough = roughness * reduced
        open = wp.max(gap, rough)
        lubrication = scalar(0.0)
        if open < cutoff:
            # At a small gap h, the force per speed of approach is 6 pi mu a^2 / h, where mu is the viscosity and
            # 1 / a = 1 / R1 + 1 / R2 with the radii R1 and R2 of the spheres (Brenner 1961). The grid gives the force
            # at the gap h + d. The added force is zero at the cut-off gap.
            width = wp.max(g.width)
            d = missing * width * wp.sqrt(width / reduced)
            inverse = scalar(1.0) / open - scalar(1.0) / (open + d)
            inverse -= scalar(1.0) / cutoff - scalar(1.0) / (cutoff + d)
            lubrication = scalar(6.0 * wp.pi) * g.viscosity * reduced * reduced * inverse
        pairs.other[place] = other
        pairs.normal[place] = normal
        pairs.gap[place] = gap
        pairs.rough[place] = rough
        pairs.still[place] = still
        pairs.lubrication[place] = lubrication
        drag = scalar(6.0 * wp.pi) * g.viscosity * reduced
        pairs.hold[place] = scalar(HOLD) * (drag + g.density * reduced * reduced * reduced / dt)
        # A contact force removes an overlap within the time `longest`. It would slow down aggregates that already
        # separate faster than that, so do not count such aggregates as touching.
        parting = gap < rough and -approach * longest > rough - gap
        pairs.touching[place] = wp.where(gap - approach * dt < rough and not parting, 1, 0)
        pairs.smallest_gap[b] = wp.min(pairs.smallest_gap[b], gap / radius)
        return count + 1

    @wp.func
    def is_known(pairs: Pairs, b: wp.int32, count: wp.int32, normal: vec, gap: scalar, radius: scalar) -> wp.bool:
        """Return whether the stored neighbours of a sphere include a wall with nearly the given normal and gap."""
        for k in range(count):
            place = b * CAPACITY + k
            if pairs.other[place] == WALL and wp.dot(pairs.normal[place], normal) > scalar(SAME):
                if wp.abs(pairs.gap[place] - gap) < scalar(0.1) * radius:
                    return True
        return False

    return SimpleNamespace(store=store, is_known=is_known)


@functools.cache
def pair_functions(scalar, kind: BodyKind) -> SimpleNamespace:
    """Build functions for the forces between aggregates and their neighbours.

    - `resistance` returns the force of a pair per speed of approach [N s/m].
    - `lever` returns the vector from the centre of an aggregate to the point at which a neighbour acts on it.
    - `relative` returns the velocity of a sphere relative to a neighbour.
    - `between` returns the force and the torque by which the neighbours of an aggregate oppose the given velocities. It
      adds up every `by`-th neighbour from number `lane` on.
    - `blocks` returns two 3 x 3 matrices. The first one times the aggregate's own velocity is the force of `between`,
      and the second one times its own spin is the torque, if all neighbours are at rest.
    """
    vec, mat33 = mps_types(scalar, 3).vec, types(scalar).mat33
    Pairs, Bodies, shape = pair_struct(scalar), body_structs(scalar).Bodies, shape_functions(scalar, kind)

    @wp.func
    def resistance(pairs: Pairs, place: wp.int32) -> scalar:
        return pairs.lubrication[place] + wp.where(pairs.touching[place] != 0, pairs.hold[place], scalar(0.0))

    @wp.func
    def lever(bodies: Bodies, pairs: Pairs, s: wp.int32, n: vec, place: wp.int32) -> vec:
        """Return the vector from the centre of an aggregate to the point at which a neighbour of sphere `s` acts [m].

        `n` is the unit vector towards the neighbour. Forces along `n` exert the same torque at any point of the line
        along `n`, so that without friction the point is the centre of the sphere.
        """
        arm = vec()
        if wp.static(kind.clumps):
            arm = bodies.arm[s]
        if wp.static(kind.friction):
            arm = arm + (shape.radius(bodies, s) + scalar(0.5) * pairs.gap[place]) * n
        return arm

    @wp.func
    def relative(
        bodies: Bodies, pairs: Pairs, linear: wp.array(dtype=vec), angular: wp.array(dtype=vec), start: wp.int32,
        s: wp.int32, place: wp.int32,
    ) -> vec:  # fmt: skip
        """Return the velocity of sphere `s` relative to the neighbour at index `place`, where the two touch.

        Walls are treated as if they were at rest. The velocities and spins of the aggregates begin at the index `start`
        of both arrays.
        """
        o = pairs.other[place]
        if wp.static(kind.turning):
            n = pairs.normal[place]
            b = shape.body(bodies, s)
            u = linear[start + b] + wp.cross(angular[start + b], lever(bodies, pairs, s, n, place))
            if o != WALL:
                c = shape.body(bodies, o)
                u = u - (linear[start + c] + wp.cross(angular[start + c], lever(bodies, pairs, o, -n, place)))
            return u
        else:
            u = linear[start + s]
            if o != WALL:
                u = u - linear[start + o]
            return u

    @wp.func
    def along(u: vec, n: vec) -> vec:
        """Return the part of a velocity along a surface with the unit normal `n`."""
        return u - wp.dot(u, n) * n

    @wp.func
    def between(
        bodies: Bodies, pairs: Pairs, linear: wp.array(dtype=vec), angular: wp.array(dtype=vec), b: wp.int32,
        lane: wp.int32, by: wp.int32,
    ):  # fmt: skip
        force = vec()
        torque = vec()
        for s in range(shape.first(bodies, b), shape.end(bodies, b)):
            for k in range(lane, pairs.count[s], by):
                place = s * CAPACITY + k
                n = pairs.normal[place]
                u = relative(bodies, pairs, linear, angular, 0, s, place)
                push = resistance(pairs, place) * wp.dot(u, n) * n
                if wp.static(kind.friction):
                    push += pairs.grip[place] * along(u, n)
                force += push
                if wp.static(kind.turning):
                    torque += wp.cross(lever(bodies, pairs, s, n, place), push)
        return force, torque

    @wp.func
    def blocks(bodies: Bodies, pairs: Pairs, b: wp.int32):
        whole = mat33()
        round = mat33()
        for s in range(shape.first(bodies, b), shape.end(bodies, b)):
            for k in range(pairs.count[s]):
                place = s * CAPACITY + k
                n = pairs.normal[place]
                whole += resistance(pairs, place) * wp.outer(n, n)
                if wp.static(kind.turning):
                    arm = lever(bodies, pairs, s, n, place)
                    turned = wp.cross(arm, n)
                    round += resistance(pairs, place) * wp.outer(turned, turned)
                    if wp.static(kind.friction):
                        across = wp.identity(n=3, dtype=scalar) - wp.outer(n, n)
                        turn = wp.skew(arm)
                        whole += pairs.grip[place] * across
                        round += pairs.grip[place] * (turn * across * wp.transpose(turn))
        return whole, round

    return SimpleNamespace(
        resistance=resistance, lever=lever, relative=relative, along=along, between=between, blocks=blocks
    )


@functools.cache
def pair_kernels(scalar, kind: BodyKind) -> SimpleNamespace:
    """Build the kernels `load`, `touch` and `stiffen`, each with one task per aggregate.

    - `load` adds the forces between neighbours at the start of the step to the forces on the aggregates, and the
      gyroscopic torques of clumps. Contacts remove an overlap within the time `longest`, the maximum time step. In a
      shorter step, removing the whole overlap would fling the aggregates apart.
    - `touch` finds pairs that would overlap at the end of the step, and marks them as touching.
    - `stiffen` adds the forces of these new contacts to `effect`, the products of the matrix with the `count` vectors
      of `change`.
    """
    vec = mps_types(scalar, 3).vec
    Fields = grid_structs(scalar, 3).Fields
    Bodies, Vector = body_structs(scalar).Bodies, vector_struct(scalar)
    Pairs, pair, shape = pair_struct(scalar), pair_functions(scalar, kind), shape_functions(scalar, kind)

    @wp.func
    def after(bodies: Bodies, change: Vector, s: wp.int32) -> vec:
        """Return the velocity of a sphere's centre after the aggregates' velocities have changed by `change`."""
        before = shape.velocity(bodies, bodies.velocity, bodies.spin, 0, s)
        return before + shape.velocity(bodies, change.linear, change.angular, 0, s)

    @wp.kernel(enable_backward=False, module="unique")
    def load(flags: wp.array(dtype=wp.int32), bodies: Bodies, pairs: Pairs, longest: scalar, forces: Vector):
        if flags[HALTED] != 0:
            return
        b = wp.tid()
        push, twist = pair.between(bodies, pairs, bodies.velocity, bodies.spin, b, 0, 1)
        force = -push
        torque = -twist
        for s in range(shape.first(bodies, b), shape.end(bodies, b)):
            for k in range(pairs.count[s]):
                place = s * CAPACITY + k
                size = pair.resistance(pairs, place) * pairs.still[place]
                if pairs.touching[place] != 0:
                    size -= pairs.hold[place] / longest * (pairs.rough[place] - pairs.gap[place])
                more = size * pairs.normal[place]
                if wp.static(kind.friction):
                    more += pairs.grip[place] * pairs.drift[place]
                force += more
                if wp.static(kind.turning):
                    torque += wp.cross(pair.lever(bodies, pairs, s, pairs.normal[place], place), more)
        forces.linear[b] = forces.linear[b] + force
        if wp.static(kind.clumps):
            torque += bodies.gyration[b]
        if wp.static(kind.turning):
            forces.angular[b] = forces.angular[b] + torque

    @wp.kernel(enable_backward=False, module="unique")
    def touch(
        flags: wp.array(dtype=wp.int32), mesh: Fields, bodies: Bodies, pairs: Pairs, change: Vector, certain: scalar
    ):
        if flags[HALTED] != 0:
            return
        b = wp.tid()
        dt = scalar(mesh.clock[DT])
        for s in range(shape.first(bodies, b), shape.end(bodies, b)):
            for k in range(pairs.count[s]):
                place = s * CAPACITY + k
                pairs.touching[place] = wp.min(pairs.touching[place], 1)
                u = after(bodies, change, s)
                if pairs.other[place] != WALL:
                    u = u - after(bodies, change, pairs.other[place])
                approach = wp.dot(u, pairs.normal[place]) - pairs.still[place]
                # Before the solve has converged, the speed of approach has an error, so use a cautious value: `certain`
                # times the speed, or 2 - `certain` times the speed at which a pair separates. Only pairs that would
                # overlap at the end of the step with this value count as touching.
                approach *= wp.where(approach > scalar(0.0), certain, scalar(2.0) - certain)
                if pairs.touching[place] == 0 and pairs.gap[place] - approach * dt < scalar(0.0):
                    pairs.touching[place] = NEW
                    pairs.changed[0] = 1

    @wp.kernel(enable_backward=False, module="unique")
    def stiffen(bodies: Bodies, pairs: Pairs, count: wp.int32, change: Vector, effect: Vector):
        b = wp.tid()
        aggregates = bodies.centre.shape[0]
        for s in range(shape.first(bodies, b), shape.end(bodies, b)):
            for k in range(pairs.count[s]):
                place = s * CAPACITY + k
                if pairs.touching[place] == NEW:
                    n = pairs.normal[place]
                    for number in range(count):
                        start = number * aggregates
                        u = pair.relative(bodies, pairs, change.linear, change.angular, start, s, place)
                        push = pairs.hold[place] * wp.dot(u, n) * n
                        effect.linear[start + b] = effect.linear[start + b] + push
                        if wp.static(kind.clumps):
                            turn = wp.cross(bodies.arm[s], push)
                            effect.angular[start + b] = effect.angular[start + b] + turn

    return SimpleNamespace(load=load, touch=touch, stiffen=stiffen)
