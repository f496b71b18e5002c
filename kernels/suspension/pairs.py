"""Lubrication and contacts between aggregates, and between aggregates and walls.

The grid resolves the mortar between two aggregates down to about one cell. Narrower gaps get what is missing: the
lubrication force at their gap minus that at the cut-off gap. Touching aggregates repel each other. Both forces depend
linearly on the relative velocity along the line of centres, so they enter the matrix of the velocities, and neither
limits the time step.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.control import HALTED
from ..common.types import types
from ..mps.grid.cells import DT, GridKind, grid_parameters_struct, grid_structs
from ..mps.grid.places import grid_functions
from ..mps.structs import mps_types
from .bodies import body_functions, body_structs

CAPACITY = wp.constant(48)
"""Maximum number of neighbours of an aggregate, including walls."""
WALL = wp.constant(-1)
"""Number that stands for a wall in place of a neighbour."""
HOLD = wp.constant(300.0)
"""Stiffness of a contact times the time step, relative to the resistance of the aggregate to motion.

A step of the longest duration removes all but about 1 / (1 + HOLD) of an overlap."""
LOOKED_AT = wp.constant(2.0)
"""Largest gap of a neighbour, in cells. In a step, an aggregate moves by at most one cell."""


@functools.cache
def pair_struct(scalar):
    """Build the struct `Pairs`: the neighbours of all aggregates and the forces between them."""
    vec3 = types(scalar).vec3

    @wp.struct
    class Pairs:
        count: wp.array(dtype=wp.int32)  # Number of neighbours of each aggregate, shape (n,).
        # The following arrays have one entry for each neighbour, shape (n * CAPACITY,).
        other: wp.array(dtype=wp.int32)  # Number of the neighbour, or WALL.
        normal: wp.array(dtype=vec3)  # Unit vector towards the neighbour.
        gap: wp.array(dtype=scalar)  # Gap at the start of the step, negative for an overlap [m].
        rough: wp.array(dtype=scalar)  # Gap at which the two touch [m].
        still: wp.array(dtype=scalar)  # Velocity of a wall along the normal [m/s]; 0 for an aggregate.
        lubrication: wp.array(dtype=scalar)  # Lubrication force per velocity of approach [N s/m].
        hold: wp.array(dtype=scalar)  # Force of a contact per velocity of approach [N s/m].
        touching: wp.array(dtype=wp.int32)  # 1 if the two touch in this step.
        # The following arrays have one entry for each aggregate, shape (n,), or one in all.
        smallest_gap: wp.array(dtype=scalar)  # Smallest gap of each aggregate, divided by its radius.
        full: wp.array(dtype=wp.int32)  # 1 if an aggregate has more neighbours than CAPACITY.
        changed: wp.array(dtype=wp.int32)  # 1 if a pair has begun to touch during the solve.

    return Pairs


@functools.cache
def wall_gap_function(scalar, of: GridKind):
    """Build the function that returns the distance of a point from the nearest wall, its gradient, and the wall."""
    t = mps_types(scalar, 3)
    vec, whole = t.vec, t.whole
    Grid = grid_parameters_struct(scalar, 3)
    Geometry = grid_structs(scalar, 3).Geometry
    f = grid_functions(scalar, of)

    @wp.func
    def wall_gap(g: Grid, geometry: Geometry, x: vec):
        base = whole()
        s = vec()
        for b in range(3):
            half = wp.where(b == 0, scalar(0.0), scalar(0.5))
            along = (x[b] - g.origin[b]) / g.width[b] - half
            base[b] = wp.int32(wp.floor(along))
            if b < 2 or wp.static(not of.periodic):
                base[b] = wp.clamp(base[b], 0, g.n[b] - 1)
            s[b] = along - scalar(base[b])
        value = scalar(0.0)
        slope = vec()
        nearest = scalar(1.0e30)
        wall = wp.int32(0)
        for n in range(8):
            c = whole(base[0] + n % 2, base[1] + n / 2 % 2, base[2] + n / 4)
            weight = vec()
            sign = vec()
            for b in range(3):
                upper = c[b] - base[b]
                weight[b] = wp.where(upper == 0, scalar(1.0) - s[b], s[b])
                sign[b] = wp.where(upper == 0, scalar(-1.0), scalar(1.0)) / g.width[b]
            number = f.at(g, c)
            distance = geometry.gap[number]
            value += weight[0] * weight[1] * weight[2] * distance
            slope += distance * vec(
                sign[0] * weight[1] * weight[2], weight[0] * sign[1] * weight[2], weight[0] * weight[1] * sign[2]
            )
            if distance < nearest:
                nearest = distance
                wall = geometry.surface[number]
        return value, slope, wall

    return wall_gap


@functools.cache
def pair_functions(scalar, of: GridKind) -> SimpleNamespace:
    """Build functions of an aggregate and its neighbours.

    `store` stores a neighbour. `between` is the force with which the neighbours of an aggregate oppose given
    velocities, and `resistance_block` the matrix of this force for the aggregate's own velocity. `resistance` is that
    of one pair.
    """
    vec, mat33 = mps_types(scalar, 3).vec, types(scalar).mat33
    Grid = grid_parameters_struct(scalar, 3)
    Pairs = pair_struct(scalar)

    @wp.func
    def store(
        g: Grid, pairs: Pairs, b: wp.int32, count: wp.int32, other: wp.int32, normal: vec, gap: scalar,
        approach: scalar, still: scalar, reduced: scalar, radius: scalar, cutoff: scalar, roughness: scalar, dt: scalar,
    ) -> wp.int32:  # fmt: skip
        """Store a neighbour with its forces, and return the new number of neighbours.

        `approach` is the present speed of approach, and `reduced` the product of both radii over their sum.
        """
        if count == CAPACITY:
            pairs.full[0] = 1
            return count
        place = b * CAPACITY + count
        rough = roughness * reduced
        open = wp.max(gap, rough)
        lubrication = scalar(0.0)
        if open < cutoff:
            # Lubrication of two spheres at a small gap (Brenner 1961): 6 pi mu a^2 / gap, 1/a = 1/R1 + 1/R2.
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
        pairs.touching[place] = wp.where(gap - approach * dt < rough, 1, 0)
        pairs.smallest_gap[b] = wp.min(pairs.smallest_gap[b], gap / radius)
        return count + 1

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

    return SimpleNamespace(store=store, resistance=resistance, resistance_block=resistance_block, between=between)


@functools.cache
def pair_kernels(scalar, of: GridKind) -> SimpleNamespace:
    """Build the kernels `find`, `load` and `touch`, each with one task per aggregate.

    - `find` finds the neighbours of each aggregate.
    - `load` adds the forces of the neighbours to the forces on the aggregates. An overlap disappears in the time
      `longest`, because in a shorter step it would fling the two apart.
    - `touch` finds pairs that would overlap at the end of the step, and lets them touch.
    """
    vec = mps_types(scalar, 3).vec
    Grid = grid_parameters_struct(scalar, 3)
    fields = grid_structs(scalar, 3)
    Geometry, Walls, Fields = fields.Geometry, fields.Walls, fields.Fields
    Bodies = body_structs(scalar).Bodies
    Pairs = pair_struct(scalar)
    f, body, pair = grid_functions(scalar, of), body_functions(scalar, of), pair_functions(scalar, of)
    wall_gap = wall_gap_function(scalar, of)

    @wp.kernel(enable_backward=False, module="unique")
    def find(
        g: Grid, flags: wp.array(dtype=wp.int32), geometry: Geometry, walls: Walls, mesh: Fields, bodies: Bodies,
        pairs: Pairs, aggregates: wp.int32, sides: wp.int32, cutoff: scalar, roughness: scalar,
    ):  # fmt: skip
        if flags[HALTED] != 0:
            return
        b = wp.tid()
        dt = scalar(mesh.clock[DT])
        x = bodies.centre[b]
        radius = bodies.radius[b]
        reach = scalar(LOOKED_AT) * wp.max(g.width)
        count = wp.int32(0)
        pairs.smallest_gap[b] = scalar(1.0e30)
        for o in range(aggregates):
            if o != b:
                d = body.nearest_image(g, bodies.centre[o] - x)
                away = wp.length(d)
                gap = away - (radius + bodies.radius[o])
                if gap < reach:
                    n = d / away
                    approach = wp.dot(bodies.velocity[b] - bodies.velocity[o], n)
                    reduced = radius * bodies.radius[o] / (radius + bodies.radius[o])
                    count = pair.store(
                        g, pairs, b, count, o, n, gap, approach, scalar(0.0), reduced, radius, cutoff, roughness, dt
                    )
        # Sides of the room that are walls or planes of symmetry.
        plane_gap = scalar(1.0e30)
        for side in range(6):
            if (sides >> side) % 2 == 1:
                axis = side / 2
                n = vec()
                n[axis] = wp.where(side % 2 == 0, scalar(-1.0), scalar(1.0))
                gap = x[axis] - g.origin[axis] - radius
                if side % 2 == 1:
                    gap = scalar(g.n[axis]) * g.width[axis] - (x[axis] - g.origin[axis]) - radius
                plane_gap = wp.min(plane_gap, gap)
                if gap < reach:
                    approach = wp.dot(bodies.velocity[b], n)
                    count = pair.store(
                        g, pairs, b, count, WALL, n, gap, approach, scalar(0.0), radius, radius, cutoff, roughness, dt
                    )
        distance, slope, wall = wall_gap(g, geometry, x)
        steep = wp.length(slope)
        gap = distance - radius
        # The nearest wall may be a side of the room, which has been stored.
        if gap < reach and gap < plane_gap - scalar(1.0e-3) * radius and steep > scalar(0.0):
            n = -slope / steep
            moving = vec()
            for axis in range(3):
                moving[axis] = f.wall_speed(walls, wall, x + radius * n, axis)
            still = wp.dot(moving, n)
            approach = wp.dot(bodies.velocity[b], n) - still
            count = pair.store(g, pairs, b, count, WALL, n, gap, approach, still, radius, radius, cutoff, roughness, dt)
        pairs.count[b] = count

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
    def touch(flags: wp.array(dtype=wp.int32), mesh: Fields, bodies: Bodies, pairs: Pairs, change: wp.array(dtype=vec)):
        if flags[HALTED] != 0:
            return
        b = wp.tid()
        dt = scalar(mesh.clock[DT])
        for k in range(pairs.count[b]):
            place = b * CAPACITY + k
            relative = bodies.velocity[b] + change[b]
            o = pairs.other[place]
            if o != WALL:
                relative = relative - (bodies.velocity[o] + change[o])
            approach = wp.dot(relative, pairs.normal[place]) - pairs.still[place]
            if pairs.touching[place] == 0 and pairs.gap[place] - approach * dt < scalar(0.0):
                pairs.touching[place] = 1
                pairs.changed[0] = 1

    return SimpleNamespace(find=find, load=load, touch=touch)
