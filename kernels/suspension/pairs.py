"""Lubrication and contacts between aggregates, and between aggregates and walls.

The grid resolves the flow between two aggregates if their gap is at least about one cell wide (the cut-off gap). In
narrower gaps, the lubrication force at the actual gap minus that at the cut-off gap is added. Touching aggregates repel
each other. Both forces depend linearly on the relative velocity along the line of centres, so they are part of the
matrix of the implicit solve and do not limit the time step.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.control import HALTED
from ..common.types import types
from ..mps.grid.cells import DT, GridKind, grid_parameters_struct, grid_structs
from ..mps.structs import mps_types
from .bodies import body_structs

CAPACITY = wp.constant(48)
"""Maximum number of neighbours of an aggregate, including walls."""
WALL = wp.constant(-1)
"""Value that is stored instead of a neighbour's index if the neighbour is a wall."""
NEW = wp.constant(2)
"""Value of `touching` for a contact that the last coupled solve has found; older contacts have the value 1."""
HOLD = wp.constant(300.0)
"""Resistance of a contact to approach, divided by the resistance of the aggregate to motion by drag and inertia.

A time step of the largest allowed duration reduces an overlap to about 1 / (1 + HOLD) of its value."""
SAME = wp.constant(0.8)
"""Cosine of the angle between the normals of two walls above which they may be the same wall."""
LOOKED_AT = wp.constant(2.0)
"""Largest gap at which two aggregates count as neighbours, divided by the width of a cell. In one time step each
aggregate moves by at most one cell, so two aggregates approach by at most two."""


@functools.cache
def pair_struct(scalar):
    """Build the struct `Pairs`: the neighbours of all aggregates and the forces between them."""
    vec3 = types(scalar).vec3

    @wp.struct
    class Pairs:
        count: wp.array(dtype=wp.int32)  # Number of neighbours of each aggregate, shape (n,).
        # The following arrays have one entry for each neighbour, shape (n * CAPACITY,).
        other: wp.array(dtype=wp.int32)  # Index of the neighbour, or WALL for a wall.
        normal: wp.array(dtype=vec3)  # Unit vector from the aggregate towards the neighbour.
        # Gap between aggregate and neighbour at the start of the step, negative for an overlap [m].
        gap: wp.array(dtype=scalar)
        rough: wp.array(dtype=scalar)  # Gap below which two neighbours count as touching [m].
        still: wp.array(dtype=scalar)  # Velocity of a wall along `normal` [m/s]; 0 if the neighbour is an aggregate.
        # Lubrication force per speed of approach, in addition to the force that the grid resolves [N s/m].
        lubrication: wp.array(dtype=scalar)
        hold: wp.array(dtype=scalar)  # Contact force per speed of approach [N s/m].
        # 1 if aggregate and neighbour touch in this step, NEW if the last coupled solve has found this contact,
        # otherwise 0.
        touching: wp.array(dtype=wp.int32)
        # `smallest_gap` has one entry for each aggregate, shape (n,); `full` and `changed` have a single entry.
        smallest_gap: wp.array(dtype=scalar)  # Smallest gap to a neighbour, divided by the aggregate's radius.
        full: wp.array(dtype=wp.int32)  # 1 if an aggregate has more neighbours than CAPACITY.
        changed: wp.array(dtype=wp.int32)  # 1 if the last coupled solve has found a new contact.

    return Pairs


@functools.cache
def pair_functions(scalar, of: GridKind) -> SimpleNamespace:
    """Build functions for the forces between an aggregate and its neighbours.

    - `store` stores a neighbour of an aggregate.
    - `is_known` tells whether a wall is already stored.
    - `resistance` returns the force of a pair per speed of approach [N s/m].
    - `between` returns the force by which all neighbours of an aggregate oppose the given velocities.
    - `resistance_block` returns the 3 x 3 matrix of that force as a function of the aggregate's own velocity.
    """
    vec, mat33 = mps_types(scalar, 3).vec, types(scalar).mat33
    Grid = grid_parameters_struct(scalar, 3)
    Pairs = pair_struct(scalar)

    @wp.func
    def store(
        g: Grid, pairs: Pairs, b: wp.int32, count: wp.int32, other: wp.int32, normal: vec, gap: scalar,
        approach: scalar, still: scalar, reduced: scalar, radius: scalar, cutoff: scalar, roughness: scalar, dt: scalar,
        longest: scalar,
    ) -> wp.int32:  # fmt: skip
        """Store a neighbour with the coefficients of its forces, and return the new number of neighbours.

        `approach` is the speed of approach at the start of the step [m/s]. `reduced` is the product of both radii
        divided by their sum [m], which is the radius of the aggregate if the neighbour is a wall.
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
            # 1 / a = 1 / R1 + 1 / R2 with the radii R1 and R2 of the spheres (Brenner 1961).
            missing = scalar(1.0) / open - scalar(1.0) / cutoff
            lubrication = scalar(6.0 * wp.pi) * g.viscosity * reduced * reduced * missing
        pairs.other[place] = other
        pairs.normal[place] = normal
        pairs.gap[place] = gap
        pairs.rough[place] = rough
        pairs.still[place] = still
        pairs.lubrication[place] = lubrication
        drag = scalar(6.0 * wp.pi) * g.viscosity * reduced
        pairs.hold[place] = scalar(HOLD) * (drag + g.density * reduced * reduced * reduced / dt)
        # A contact force removes an overlap within the time `longest`. It would slow down two aggregates that separate
        # faster than this force would separate them, so they do not count as touching.
        parting = gap < rough and -approach * longest > rough - gap
        pairs.touching[place] = wp.where(gap - approach * dt < rough and not parting, 1, 0)
        pairs.smallest_gap[b] = wp.min(pairs.smallest_gap[b], gap / radius)
        return count + 1

    @wp.func
    def is_known(pairs: Pairs, b: wp.int32, count: wp.int32, normal: vec, gap: scalar, radius: scalar) -> wp.bool:
        """Return whether a wall with about the given normal and gap is already among the neighbours of an aggregate."""
        for k in range(count):
            place = b * CAPACITY + k
            if pairs.other[place] == WALL and wp.dot(pairs.normal[place], normal) > scalar(SAME):
                if wp.abs(pairs.gap[place] - gap) < scalar(0.1) * radius:
                    return True
        return False

    @wp.func
    def resistance(pairs: Pairs, place: wp.int32) -> scalar:
        return pairs.lubrication[place] + wp.where(pairs.touching[place] != 0, pairs.hold[place], scalar(0.0))

    @wp.func
    def resistance_block(pairs: Pairs, b: wp.int32) -> mat33:
        sum = mat33()
        for k in range(pairs.count[b]):
            n = pairs.normal[b * CAPACITY + k]
            sum += resistance(pairs, b * CAPACITY + k) * wp.outer(n, n)
        return sum

    @wp.func
    def between(pairs: Pairs, velocity: wp.array(dtype=vec), b: wp.int32) -> vec:
        sum = vec()
        for k in range(pairs.count[b]):
            place = b * CAPACITY + k
            n = pairs.normal[place]
            relative = velocity[b]
            if pairs.other[place] != WALL:
                relative = relative - velocity[pairs.other[place]]
            sum += resistance(pairs, place) * wp.dot(relative, n) * n
        return sum

    return SimpleNamespace(
        store=store, is_known=is_known, resistance=resistance, resistance_block=resistance_block, between=between
    )


@functools.cache
def pair_kernels(scalar, of: GridKind) -> SimpleNamespace:
    """Build the kernels `load`, `touch` and `stiffen`, each with one task per aggregate.

    - `load` adds the forces between neighbours at the start of the step to the forces on the aggregates. Contacts
      remove an overlap within the time `longest`, the maximum time step. In a shorter step, removing the whole overlap
      would fling the aggregates apart.
    - `touch` finds pairs that would overlap at the end of the step, and marks them as touching.
    - `stiffen` adds the forces of these new contacts to `effect`, the products of the matrix with the `count` vectors
      of `change`.
    """
    vec = mps_types(scalar, 3).vec
    Fields = grid_structs(scalar, 3).Fields
    Bodies = body_structs(scalar).Bodies
    Pairs, pair = pair_struct(scalar), pair_functions(scalar, of)

    @wp.kernel(enable_backward=False, module="unique")
    def load(
        flags: wp.array(dtype=wp.int32),
        bodies: Bodies,
        pairs: Pairs,
        longest: scalar,
        force: wp.array(dtype=vec),
    ):
        if flags[HALTED] != 0:
            return
        b = wp.tid()
        sum = -pair.between(pairs, bodies.velocity, b)
        for k in range(pairs.count[b]):
            place = b * CAPACITY + k
            size = pair.resistance(pairs, place) * pairs.still[place]
            if pairs.touching[place] != 0:
                size -= pairs.hold[place] / longest * (pairs.rough[place] - pairs.gap[place])
            sum += size * pairs.normal[place]
        force[b] = force[b] + sum

    @wp.kernel(enable_backward=False, module="unique")
    def touch(
        flags: wp.array(dtype=wp.int32), mesh: Fields, bodies: Bodies, pairs: Pairs, change: wp.array(dtype=vec),
        certain: scalar,
    ):  # fmt: skip
        if flags[HALTED] != 0:
            return
        b = wp.tid()
        dt = scalar(mesh.clock[DT])
        for k in range(pairs.count[b]):
            place = b * CAPACITY + k
            pairs.touching[place] = wp.min(pairs.touching[place], 1)
            relative = bodies.velocity[b] + change[b]
            o = pairs.other[place]
            if o != WALL:
                relative = relative - (bodies.velocity[o] + change[o])
            approach = wp.dot(relative, pairs.normal[place]) - pairs.still[place]
            # Count a pair as touching only if it would overlap even at the fraction `certain` of its speed of approach.
            approach *= wp.where(approach > scalar(0.0), certain, scalar(2.0) - certain)
            if pairs.touching[place] == 0 and pairs.gap[place] - approach * dt < scalar(0.0):
                pairs.touching[place] = NEW
                pairs.changed[0] = 1

    @wp.kernel(enable_backward=False, module="unique")
    def stiffen(
        bodies: Bodies, pairs: Pairs, count: wp.int32, change: wp.array(dtype=vec), effect: wp.array(dtype=vec)
    ):
        b = wp.tid()
        aggregates = bodies.centre.shape[0]
        for k in range(pairs.count[b]):
            place = b * CAPACITY + k
            if pairs.touching[place] == NEW:
                n = pairs.normal[place]
                o = pairs.other[place]
                for number in range(count):
                    relative = change[number * aggregates + b]
                    if o != WALL:
                        relative = relative - change[number * aggregates + o]
                    own = number * aggregates + b
                    effect[own] = effect[own] + pairs.hold[place] * wp.dot(relative, n) * n

    return SimpleNamespace(load=load, touch=touch, stiffen=stiffen)
