"""Search for the neighbours of spheres: other spheres, sides of the simulated box, and other walls."""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.control import HALTED
from ..mps.grid.cells import DT, GridKind, grid_parameters_struct, grid_structs
from ..mps.grid.places import grid_functions
from ..mps.structs import mps_types
from .bodies import SEARCH_LOOPS, BodyKind, body_functions, body_structs, shape_functions
from .pairs import CAPACITY, LOOKED_AT, MISSING, MISSING_AT_WALL, WALL, pair_struct, store_functions

TURNS = 6
"""Number of steps in which a search for a wall moves over the surface of an aggregate."""
FACING = wp.constant(0.9)
"""Minimum cosine of the angle between the direction that a search has found and the normal of the wall. At a smaller
cosine the wall is not closest to the aggregate in this direction."""
FAR = wp.constant(1.0e30)
"""Gap [m] that a search returns if it finds no wall."""


@functools.cache
def wall_gap_function(scalar, of: GridKind):
    """Build the function that returns a point's distance from the nearest wall, its gradient, and the wall's number."""
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
def wall_search_function(scalar, of: GridKind):
    """Build the function that finds the wall near a point of an aggregate's surface.

    The gap between a sphere and a wall is the smallest distance of the sphere's surface from the wall. The function
    moves over the surface from a starting point, in the direction in which the distance decreases. Its first step leads
    to the closest point of a plane wall. Further steps are shorter, because they would go too far at convex walls such
    as bars.
    """
    vec = mps_types(scalar, 3).vec
    Grid = grid_parameters_struct(scalar, 3)
    Geometry = grid_structs(scalar, 3).Geometry
    wall_gap = wall_gap_function(scalar, of)

    @wp.func
    def search(g: Grid, geometry: Geometry, x: vec, radius: scalar, start: vec, known: vec, reach: scalar):
        """Return the gap to a wall [m], the unit vector towards it, and the number of the wall.

        `start` is the unit vector from the centre `x` to the starting point, or zero if the search starts at the centre
        itself. `known` is the unit vector towards another wall, to which the search must not turn, or zero.
        """
        e = start
        distance, slope, wall = wall_gap(g, geometry, x + radius * e)
        size = scalar(1.0)
        # Points of the surface within one radius of the starting point are at least `distance` - `radius` away from a
        # wall.
        if distance < radius + reach:
            for turn in range(wp.static(TURNS)):
                to = e - size * (wp.normalize(slope) + e)
                to = wp.normalize(to - wp.max(wp.dot(to, known), scalar(0.0)) * known)
                there, steep, number = wall_gap(g, geometry, x + radius * to)
                closer = there < distance or (turn == 0 and wp.length(e) == scalar(0.0))
                size = wp.where(closer and turn > 0, size, scalar(0.5) * size)
                if closer:
                    e = to
                    distance = there
                    slope = steep
                    wall = number
        if wp.length(slope) < scalar(0.1) or -wp.dot(wp.normalize(slope), e) < scalar(FACING):
            distance = scalar(FAR)
        return distance, e, wall

    return search


@functools.cache
def others_function(scalar, of: GridKind, kind: BodyKind):
    """Build the function that stores the numbers of the spheres near a sphere, and returns their count.

    A pair of spheres counts only if its closest points lie on the surfaces of the aggregates.
    """
    Grid = grid_parameters_struct(scalar, 3)
    Bodies, Pairs = body_structs(scalar).Bodies, pair_struct(scalar)
    body, shape = body_functions(scalar, of), shape_functions(scalar, kind)

    @wp.func
    def list_others(
        g: Grid, bodies: Bodies, pairs: Pairs, grid: wp.uint64, span: wp.float32, b: wp.int32, reach: scalar
    ) -> wp.int32:
        x = shape.centre(bodies, b)
        first = b * CAPACITY
        count = wp.int32(0)
        # The hash grid yields neighbours in any order, and in a short periodic pipe more than once. They are sorted, so
        # that sums over neighbours are always added up in the same order.
        for image in range(wp.static(3 if of.periodic else 1)):
            here = wp.vec3f(x)
            if wp.static(of.periodic):
                here[2] = here[2] + wp.float32(image - 1) * wp.float32(g.n[2]) * wp.float32(g.width[2])
            for o in wp.hash_grid_query(grid, here, span):
                d = body.nearest_image(g, shape.centre(bodies, o) - x)
                away = wp.length(d)
                near = away - (shape.radius(bodies, b) + shape.radius(bodies, o)) < reach
                if wp.static(kind.clumps) and near:
                    near = shape.body(bodies, o) != shape.body(bodies, b)
                    near = near and shape.exposed(bodies, b, d / away) and shape.exposed(bodies, o, -d / away)
                if o != b and near:
                    at = count
                    known = wp.bool(False)
                    for k in range(count):
                        if pairs.other[first + k] == o:
                            known = True
                    if not known and count == CAPACITY:
                        pairs.full[0] = 1
                    elif not known:
                        while at > 0 and pairs.other[first + wp.max(at - 1, 0)] > o:
                            pairs.other[first + at] = pairs.other[first + at - 1]
                            at -= 1
                        pairs.other[first + at] = o
                        count += 1
        return count

    return list_others


@functools.cache
def neighbour_kernels(scalar, of: GridKind, kind: BodyKind) -> SimpleNamespace:
    """Build the kernels `locate` and `find`, each with one task per sphere.

    - `locate` copies the centres of the spheres to the points of the hash grid.
    - `find` finds the neighbours of each sphere. `span` is the largest distance between the centres of neighbours [m].
    """
    vec = mps_types(scalar, 3).vec
    Grid = grid_parameters_struct(scalar, 3)
    fields = grid_structs(scalar, 3)
    Geometry, Walls, Fields = fields.Geometry, fields.Walls, fields.Fields
    Bodies, Pairs = body_structs(scalar).Bodies, pair_struct(scalar)
    f, body, pair = grid_functions(scalar, of), body_functions(scalar, of), store_functions(scalar)
    search, list_others = wall_search_function(scalar, of), others_function(scalar, of, kind)
    shape = shape_functions(scalar, kind)
    wall_gap = wall_gap_function(scalar, of)

    @wp.kernel(enable_backward=False, module="unique")
    def locate(bodies: Bodies, points: wp.array(dtype=wp.vec3f)):
        points[wp.tid()] = wp.vec3f(shape.centre(bodies, wp.tid()))

    @wp.kernel(enable_backward=False, module="unique", module_options=SEARCH_LOOPS)
    def find(
        g: Grid, flags: wp.array(dtype=wp.int32), geometry: Geometry, walls: Walls, mesh: Fields, bodies: Bodies,
        pairs: Pairs, grid: wp.uint64, span: wp.float32, sides: wp.int32, mirrors: wp.int32,
        cutoff: scalar, roughness: scalar, longest: scalar,
    ):  # fmt: skip
        if flags[HALTED] != 0:
            return
        b = wp.tid()
        dt = scalar(mesh.clock[DT])
        x = shape.centre(bodies, b)
        radius = shape.radius(bodies, b)
        moves = shape.velocity(bodies, bodies.velocity, bodies.spin, 0, b)
        reach = scalar(LOOKED_AT) * wp.max(g.width)
        pairs.smallest_gap[b] = scalar(1.0e30)
        count = list_others(g, bodies, pairs, grid, span, b, reach)
        first = b * CAPACITY
        for k in range(count):
            o = pairs.other[first + k]
            d = body.nearest_image(g, shape.centre(bodies, o) - x)
            away = wp.length(d)
            n = d / away
            approach = wp.dot(moves - shape.velocity(bodies, bodies.velocity, bodies.spin, 0, o), n)
            size = shape.radius(bodies, o)
            reduced = radius * size / (radius + size)
            pair.store(
                g, pairs, b, k, o, n, away - (radius + size), approach, scalar(0.0), reduced, radius,
                cutoff, scalar(MISSING), roughness, dt, longest,
            )  # fmt: skip
        # Neighbours also include the sides of the box that are walls or planes of symmetry. Beyond a plane of symmetry
        # lies the mirror image of the aggregate. For this image, the reduced radius is half the reduced radius for a
        # wall, and the gap and the speed of approach are twice the values for the plane.
        beside = vec()
        closest = reach
        for side in range(6):
            if (sides >> side) % 2 == 1:
                axis = side / 2
                n = vec()
                n[axis] = wp.where(side % 2 == 0, scalar(-1.0), scalar(1.0))
                gap = x[axis] - g.origin[axis] - radius
                if side % 2 == 1:
                    gap = scalar(g.n[axis]) * g.width[axis] - (x[axis] - g.origin[axis]) - radius
                part = wp.where((mirrors >> side) % 2 == 1, scalar(0.5), scalar(1.0))
                missing = wp.where((mirrors >> side) % 2 == 1, scalar(0.5) * scalar(MISSING), scalar(MISSING_AT_WALL))
                if gap < closest and (mirrors >> side) % 2 == 0:
                    # A side that lies behind another wall, such as a pipe's, does not count.
                    there, slope, wall = wall_gap(g, geometry, x + radius * n)
                    if there > gap - scalar(0.25) * g.width[axis]:
                        closest = gap
                        beside = n
                if gap < reach and shape.exposed(bodies, b, n):
                    approach = wp.dot(moves, n)
                    count = pair.store(
                        g, pairs, b, count, WALL, n, gap, approach, scalar(0.0), part * radius, radius, part * cutoff,
                        missing, part * roughness, dt, longest,
                    )  # fmt: skip
        # Search for walls other than the sides of the box, from the centre of the aggregate and from six points of its
        # surface. The grid stores the distance from the nearest wall only, which may be a side of the box. The first
        # search therefore must not turn towards the closest side of the box: another wall, such as a bar on a plate,
        # may stand on this side. If a search finds a wall that is already known, a second search must not turn towards
        # that wall.
        for probe in range(7):
            e = vec()
            if probe > 0:
                e[(probe - 1) / 2] = wp.where(probe % 2 == 1, scalar(-1.0), scalar(1.0))
            known = beside
            for again in range(2):
                if again == 0 or wp.length(known) > scalar(0.0):
                    gap, n, wall = search(g, geometry, x, radius, e, known, reach)
                    known = vec()
                    if gap < reach and pair.is_known(pairs, b, count, n, gap, radius):
                        known = n
                    elif gap < reach and shape.exposed(bodies, b, n):
                        moving = vec()
                        for axis in range(3):
                            moving[axis] = f.wall_speed(walls, wall, x + radius * n, axis)
                        still = wp.dot(moving, n)
                        approach = wp.dot(moves, n) - still
                        count = pair.store(
                            g, pairs, b, count, WALL, n, gap, approach, still, radius, radius, cutoff,
                            scalar(MISSING_AT_WALL), roughness, dt, longest,
                        )  # fmt: skip
        pairs.count[b] = count

    return SimpleNamespace(locate=locate, find=find)
