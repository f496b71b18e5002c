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
HOLD = wp.constant(30.0)
"""Stiffness of a contact times the time step, relative to the resistance of the aggregate to motion.

A step removes all but 1 / (1 + HOLD) of an overlap."""


@functools.cache
def pair_struct(scalar):
    """Build the struct `Pairs`: the neighbours of all aggregates and the forces between them."""
    vec3 = types(scalar).vec3

    @wp.struct
    class Pairs:
        count: wp.array(dtype=wp.int32)  # Number of neighbours of each aggregate, shape (n,).
        other: wp.array(dtype=wp.int32)  # Number of each neighbour, or WALL, shape (n * CAPACITY,).
        normal: wp.array(dtype=vec3)  # Unit vector towards each neighbour, shape (n * CAPACITY,).
        # Force that resists the approach of each neighbour, per velocity [N s/m], shape (n * CAPACITY,).
        resistance: wp.array(dtype=scalar)
        push: wp.array(dtype=scalar)  # Force of each neighbour on the aggregate without motion [N], same shape.
        gap: wp.array(dtype=scalar)  # Gap to each neighbour, negative for an overlap [m], same shape.
        smallest_gap: wp.array(dtype=scalar)  # Smallest gap of each aggregate, divided by its radius, shape (n,).
        full: wp.array(dtype=wp.int32)  # 1 if an aggregate has more neighbours than CAPACITY, shape (1,).

    return Pairs


@functools.cache
def pair_kernels(scalar, of: GridKind) -> SimpleNamespace:
    """Build the kernels `find`, which finds neighbours and their forces, and `load`, which adds constant forces.

    Both run with one task per aggregate. `apply` is a function: the force of the neighbours on one aggregate that
    opposes given velocities.
    """
    t = mps_types(scalar, 3)
    vec, whole = t.vec, t.whole
    mat33 = types(scalar).mat33
    Grid = grid_parameters_struct(scalar, 3)
    fields = grid_structs(scalar, 3)
    Geometry, Walls, Fields = fields.Geometry, fields.Walls, fields.Fields
    Bodies = body_structs(scalar).Bodies
    Pairs = pair_struct(scalar)
    f, body = grid_functions(scalar, of), body_functions(scalar, of)

    @wp.func
    def wall_gap(g: Grid, geometry: Geometry, x: vec):
        """Return the distance of a point from the nearest wall, its gradient, and the number of the wall."""
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

    @wp.func
    def store(
        pairs: Pairs, b: wp.int32, count: wp.int32, other: wp.int32, normal: vec, gap: scalar, approach: scalar,
        reduced: scalar, radius: scalar, viscosity: scalar, cutoff: scalar, roughness: scalar, stiff: scalar,
        dt: scalar,
    ) -> wp.int32:  # fmt: skip
        """Store a neighbour with its forces, and return the new number of neighbours.

        `approach` is the present speed of approach, and `reduced` the harmonic mean of both radii, divided by two.
        """
        if count == CAPACITY:
            pairs.full[0] = 1
            return count
        place = b * CAPACITY + count
        rough = roughness * reduced
        open = wp.max(gap, rough)
        resistance = scalar(0.0)
        if open < cutoff:
            # Lubrication of two spheres at a small gap (Brenner 1961): 6 pi mu a^2 / gap, 1/a = 1/R1 + 1/R2.
            resistance = (
                scalar(6.0 * wp.pi) * viscosity * reduced * reduced * (scalar(1.0) / open - scalar(1.0) / cutoff)
            )
        push = scalar(0.0)
        if gap - approach * dt < rough:
            push = stiff / dt * (rough - gap)
            resistance += stiff
        pairs.other[place] = other
        pairs.normal[place] = normal
        pairs.resistance[place] = resistance
        pairs.push[place] = push
        pairs.gap[place] = gap
        pairs.smallest_gap[b] = wp.min(pairs.smallest_gap[b], gap / radius)
        return count + 1

    @wp.func
    def hold(g: Grid, radius: scalar, dt: scalar) -> scalar:
        """Return the resistance of a contact between surfaces whose reduced radius is given [N s/m]."""
        drag = scalar(6.0 * wp.pi) * g.viscosity * radius
        return scalar(HOLD) * (drag + g.density * radius * radius * radius / dt)

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
        count = wp.int32(0)
        pairs.smallest_gap[b] = scalar(1.0e30)
        for o in range(aggregates):
            if o != b:
                d = body.nearest_image(g, bodies.centre[o] - x)
                away = wp.length(d)
                gap = away - radius - bodies.radius[o]
                if gap < wp.max(cutoff, scalar(0.1) * radius):
                    n = d / away
                    approach = wp.dot(bodies.velocity[b] - bodies.velocity[o], n)
                    if gap < cutoff or gap - approach * dt < scalar(0.0):
                        reduced = radius * bodies.radius[o] / (radius + bodies.radius[o])
                        count = store(
                            pairs, b, count, o, n, gap, approach, reduced, radius, g.viscosity, cutoff, roughness,
                            hold(g, reduced, dt), dt,
                        )  # fmt: skip
        # Sides of the room that are walls or planes of symmetry.
        plane_gap = scalar(1.0e30)
        for side in range(6):
            if (sides >> side) % 2 == 1:
                axis = side / 2
                n = vec()
                n[axis] = wp.where(side % 2 == 0, scalar(-1.0), scalar(1.0))
                away = x[axis] - g.origin[axis]
                if side % 2 == 1:
                    away = scalar(g.n[axis]) * g.width[axis] - away
                plane_gap = wp.min(plane_gap, away - radius)
                if away - radius < cutoff:
                    count = store(
                        pairs, b, count, WALL, n, away - radius, wp.dot(bodies.velocity[b], n), radius, radius,
                        g.viscosity, cutoff, roughness, hold(g, radius, dt), dt,
                    )  # fmt: skip
        distance, slope, wall = wall_gap(g, geometry, x)
        steep = wp.length(slope)
        gap = distance - radius
        # The nearest wall may be a side of the room, which has been stored.
        if gap < cutoff and gap < plane_gap - scalar(1.0e-3) * radius and steep > scalar(0.0):
            n = -slope / steep
            still = vec()
            for axis in range(3):
                still[axis] = f.wall_speed(walls, wall, x + radius * n, axis)
            approach = wp.dot(bodies.velocity[b] - still, n)
            before = count
            count = store(
                pairs, b, count, WALL, n, gap, approach, radius, radius, g.viscosity, cutoff, roughness,
                hold(g, radius, dt), dt,
            )  # fmt: skip
            if count > before:
                place = b * CAPACITY + before
                pairs.push[place] = pairs.push[place] - pairs.resistance[place] * wp.dot(still, n)
        pairs.count[b] = count

    @wp.func
    def resistance_block(pairs: Pairs, b: wp.int32) -> mat33:
        """Return the sum of the resistances of an aggregate's neighbours as a matrix."""
        sum = mat33()
        for k in range(pairs.count[b]):
            n = pairs.normal[b * CAPACITY + k]
            sum += pairs.resistance[b * CAPACITY + k] * wp.outer(n, n)
        return sum

    @wp.func
    def apply(pairs: Pairs, velocity: wp.array(dtype=vec), b: wp.int32) -> vec:
        """Return the force with which an aggregate's neighbours oppose the given velocities."""
        sum = vec()
        for k in range(pairs.count[b]):
            place = b * CAPACITY + k
            n = pairs.normal[place]
            relative = velocity[b]
            if pairs.other[place] != WALL:
                relative = relative - velocity[pairs.other[place]]
            sum += pairs.resistance[place] * wp.dot(relative, n) * n
        return sum

    @wp.kernel(enable_backward=False, module="unique")
    def load(flags: wp.array(dtype=wp.int32), bodies: Bodies, pairs: Pairs, force: wp.array(dtype=vec)):
        """Add the forces of the neighbours at the present velocities to the forces on the aggregates."""
        if flags[HALTED] != 0:
            return
        b = wp.tid()
        sum = -apply(pairs, bodies.velocity, b)
        for k in range(pairs.count[b]):
            place = b * CAPACITY + k
            sum -= pairs.push[place] * pairs.normal[place]
        force[b] = force[b] + sum

    return SimpleNamespace(find=find, load=load, apply=apply, resistance_block=resistance_block)
