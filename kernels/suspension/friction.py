"""Coulomb friction where aggregates touch each other or a wall.

The friction force opposes the sliding of two surfaces with the force c v, where v is the speed of sliding. The
coefficient c is the limit mu N of friction divided by v, with the coefficient of friction mu and the normal force N.
However, c is at most the resistance of the contact to approach, so that surfaces stick, apart from a slow creep, if a
force below the limit acts on them. Both N and v are values from the end of the last step, which makes the force linear
in the velocities, as part of the matrix of the implicit solve. A contact therefore has no friction in its first step.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.control import HALTED
from ..mps.grid.cells import GridKind, grid_parameters_struct, grid_structs
from ..mps.grid.places import grid_functions
from ..mps.structs import mps_types
from .bodies import BodyKind, body_structs, shape_functions
from .neighbours import wall_gap_function
from .pairs import CAPACITY, SAME, WALL, pair_functions, pair_struct


@functools.cache
def friction_kernels(scalar, of: GridKind, kind: BodyKind) -> SimpleNamespace:
    """Build the kernels `rub` and `remember`, each with one task per sphere.

    - `rub` sets the coefficients of friction forces at the start of a step, for the coefficient of friction `friction`.
    - `remember` stores the normal forces of contacts at the end of a step.
    """
    vec = mps_types(scalar, 3).vec
    Grid = grid_parameters_struct(scalar, 3)
    fields = grid_structs(scalar, 3)
    Geometry, Walls = fields.Geometry, fields.Walls
    Bodies, Pairs = body_structs(scalar).Bodies, pair_struct(scalar)
    f, pair, shape = grid_functions(scalar, of), pair_functions(scalar, kind), shape_functions(scalar, kind)
    wall_gap = wall_gap_function(scalar, of)

    @wp.func
    def last_force(pairs: Pairs, s: wp.int32, place: wp.int32) -> scalar:
        """Return the normal force between a sphere and a neighbour at the end of the last step [N]."""
        force = scalar(0.0)
        closest = scalar(SAME)
        for k in range(pairs.last_count[s]):
            old = s * CAPACITY + k
            if pairs.last_other[old] == pairs.other[place]:
                likeness = scalar(1.0)
                if pairs.other[place] == WALL:
                    likeness = wp.dot(pairs.last_normal[old], pairs.normal[place])
                if likeness > closest:
                    closest = likeness
                    force = pairs.last_force[old]
        return force

    @wp.func
    def is_mirror(mirrors: wp.int32, n: vec) -> wp.bool:
        """Return whether `n` is the normal of a side of the box that is a plane of symmetry, and thus frictionless."""
        found = wp.bool(False)
        for side in range(6):
            if (mirrors >> side) % 2 == 1 and n[side / 2] == wp.where(side % 2 == 0, scalar(-1.0), scalar(1.0)):
                found = True
        return found

    @wp.kernel(enable_backward=False, module="unique")
    def rub(
        g: Grid, flags: wp.array(dtype=wp.int32), geometry: Geometry, walls: Walls, bodies: Bodies, pairs: Pairs,
        mirrors: wp.int32, friction: scalar,
    ):  # fmt: skip
        if flags[HALTED] != 0:
            return
        s = wp.tid()
        for k in range(pairs.count[s]):
            place = s * CAPACITY + k
            n = pairs.normal[place]
            drift = vec()
            limit = scalar(0.0)
            if pairs.touching[place] != 0:
                limit = friction * last_force(pairs, s, place)
            if pairs.other[place] == WALL:
                if is_mirror(mirrors, n):
                    limit = scalar(0.0)
                x = shape.centre(bodies, s) + shape.radius(bodies, s) * n
                gap, slope, wall = wall_gap(g, geometry, x)
                for axis in range(3):
                    drift[axis] = f.wall_speed(walls, wall, x, axis)
                drift = pair.along(drift, n)
            grip = scalar(0.0)
            if limit > scalar(0.0):
                slides = pair.along(pair.relative(bodies, pairs, bodies.velocity, bodies.spin, 0, s, place), n) - drift
                grip = limit / wp.max(wp.length(slides), limit / pairs.hold[place])
            pairs.grip[place] = grip
            pairs.drift[place] = drift

    @wp.kernel(enable_backward=False, module="unique")
    def remember(flags: wp.array(dtype=wp.int32), bodies: Bodies, pairs: Pairs, longest: scalar):
        if flags[HALTED] != 0:
            return
        s = wp.tid()
        count = wp.int32(0)
        for k in range(pairs.count[s]):
            place = s * CAPACITY + k
            n = pairs.normal[place]
            u = pair.relative(bodies, pairs, bodies.velocity, bodies.spin, 0, s, place)
            approach = wp.dot(u, n) - pairs.still[place] + (pairs.rough[place] - pairs.gap[place]) / longest
            if pairs.touching[place] == 1 and approach > scalar(0.0):
                new = s * CAPACITY + count
                pairs.last_other[new] = pairs.other[place]
                pairs.last_normal[new] = n
                pairs.last_force[new] = pairs.hold[place] * approach
                count += 1
        pairs.last_count[s] = count

    return SimpleNamespace(rub=rub, remember=remember)
