"""Functions of the cells, faces and edges of a staggered grid: numbers, positions, volumes, shear and stretch."""

import functools
from types import SimpleNamespace

import warp as wp

from ...common.types import types
from ..structs import mps_types
from .cells import FIXED, GHOST, LIQUID, GridKind, first, grid_parameters_struct, grid_structs, second


@functools.cache
def place_functions(scalar, of: GridKind) -> SimpleNamespace:
    """Build functions for numbers, positions, areas and volumes of cells, faces and edges."""
    dims, last = of.dimensions, of.dimensions - 1
    t = mps_types(scalar, dims)
    whole, vec = t.whole, t.vec
    Grid = grid_parameters_struct(scalar, dims)

    @wp.func
    def at(g: Grid, c: whole) -> wp.int32:
        """Return the number of the cell with the indices `c`; faces and edges of the cell have the same number."""
        k = c[last]
        if wp.static(of.periodic):
            k = (k + g.n[last]) % g.n[last]
        if wp.static(of.dimensions == 2):
            return (k + 1) * (g.n[0] + 2) + c[0] + 1
        else:
            return ((k + 1) * (g.n[1] + 2) + c[1] + 1) * (g.n[0] + 2) + c[0] + 1

    @wp.func
    def cell(g: Grid, number: wp.int32) -> whole:
        """Return the indices of the cell with the given number; this is the inverse of `at`."""
        across = g.n[0] + 2
        if wp.static(of.dimensions == 2):
            return whole(number % across - 1, number / across - 1)
        else:
            rest = number / across
            deep = g.n[1] + 2
            return whole(number % across - 1, rest % deep - 1, rest / deep - 1)

    @wp.func
    def moved(c: whole, axis: wp.int32, by: wp.int32) -> whole:
        """Return the indices of the cell that lies `by` cells from the cell `c` along an axis."""
        c[axis] = c[axis] + by
        return c

    @wp.func
    def on_grid(g: Grid, c: whole) -> wp.bool:
        """Return whether a face or edge with the indices `c` exists.

        Along a periodic pipe, the faces and edges at the upper end of the grid are the same as those at the lower end.
        The function returns False for them, so that each face and edge counts once.
        """
        found = c[last] >= 0 and c[last] <= g.n[last] - wp.static(1 if of.periodic else 0)
        for b in range(last):
            if c[b] < 0 or c[b] > g.n[b]:
                found = False
        return found

    @wp.func
    def reached(g: Grid, c: whole) -> wp.bool:
        """Return whether a face or edge with the indices `c` exists.

        Unlike `on_grid`, the function returns True for every index along a periodic pipe, because the grid repeats
        itself in this direction.
        """
        found = wp.bool(True)
        for b in range(wp.static(last if of.periodic else dims)):
            if c[b] < 0 or c[b] > g.n[b]:
                found = False
        return found

    @wp.func
    def in_grid(g: Grid, c: whole) -> wp.bool:
        """Return whether the cell lies inside the grid, and not in the frame of extra cells around it."""
        found = wp.bool(True)
        for b in range(dims):
            if c[b] < 0 or c[b] >= g.n[b]:
                found = False
        return found

    @wp.func
    def face_middle(g: Grid, c: whole, axis: wp.int32) -> vec:
        """Return the position of a face's centre [m]."""
        x = vec()
        for b in range(dims):
            x[b] = g.origin[b] + (scalar(c[b]) + wp.where(b == axis, scalar(0.0), scalar(0.5))) * g.width[b]
        return x

    @wp.func
    def side_weight(g: Grid, c: whole) -> scalar:
        """Return the distance of a cell's inner side from the axis of symmetry [m], or 1 without such an axis.

        Multiplied by this weight, the length of the side becomes its area per radian.
        """
        if wp.static(of.axial):
            return scalar(c[0]) * g.width[0]
        return scalar(1.0)

    @wp.func
    def cell_weight(g: Grid, c: whole) -> scalar:
        """Return the distance of a cell's centre from the axis of symmetry [m], or 1 without such an axis.

        Multiplied by this weight, the cell's area becomes its volume per radian.
        """
        if wp.static(of.axial):
            return (scalar(c[0]) + scalar(0.5)) * g.width[0]
        return scalar(1.0)

    @wp.func
    def block(g: Grid) -> scalar:
        """Return the product of a cell's widths along all axes; times `cell_weight`, this is the cell's volume."""
        if wp.static(of.dimensions == 2):
            return g.width[0] * g.width[1]
        else:
            return g.width[0] * g.width[1] * g.width[2]

    @wp.func
    def cell_volume(g: Grid, c: whole) -> scalar:
        return cell_weight(g, c) * block(g)

    @wp.func
    def face_area(g: Grid, c: whole, axis: wp.int32) -> scalar:
        return wp.where(axis == 0, side_weight(g, c), cell_weight(g, c)) * block(g) / g.width[axis]

    @wp.func
    def cell_of(g: Grid, x: vec) -> wp.int32:
        """Return the number of the cell that contains `x`, or of the nearest cell."""
        c = whole()
        for b in range(dims):
            c[b] = wp.clamp(wp.int32(wp.floor((x[b] - g.origin[b]) / g.width[b])), 0, g.n[b] - 1)
        return at(g, c)

    return SimpleNamespace(
        at=at, cell=cell, moved=moved, on_grid=on_grid, reached=reached, in_grid=in_grid, face_middle=face_middle,
        side_weight=side_weight, cell_weight=cell_weight, cell_volume=cell_volume, face_area=face_area, block=block,
        cell_of=cell_of,
    )  # fmt: skip


@functools.cache
def grid_functions(scalar, of: GridKind) -> SimpleNamespace:
    """Build all functions of `place_functions`, and functions for open areas, shear rates and wall velocities."""
    dims = of.dimensions
    t = mps_types(scalar, dims)
    whole, vec = t.whole, t.vec
    vec3 = types(scalar).vec3
    Grid = grid_parameters_struct(scalar, dims)
    structs = grid_structs(scalar, dims)
    Fields, Walls, Geometry = structs.Fields, structs.Walls, structs.Geometry
    places = place_functions(scalar, of)
    at, moved, side_weight, cell_weight = places.at, places.moved, places.side_weight, places.cell_weight
    block = places.block

    @wp.func
    def open_area(g: Grid, geometry: Geometry, c: whole, axis: wp.int32) -> scalar:
        """Return the part of a face's area through which concrete can flow."""
        if wp.static(of.cut):
            return places.face_area(g, c, axis) * geometry.part[at(g, c) + axis * g.slots]
        return places.face_area(g, c, axis)

    @wp.func
    def is_unknown(kind: wp.int32) -> wp.bool:
        """Return whether the velocity of a face is an unknown of the viscous solve."""
        if wp.static(of.cut):
            return wp.where(kind == LIQUID, True, kind == GHOST)
        return kind == LIQUID

    @wp.func
    def has_velocity(kind: wp.int32) -> wp.bool:
        """Return whether a face has a velocity that enters the rates of shear and stretch."""
        return is_unknown(kind) or kind == FIXED

    @wp.func
    def wetness(g: Grid, mesh: Fields, geometry: Geometry, c: whole, pair: wp.int32) -> scalar:
        """Return the fraction of the volume around an edge that concrete fills."""
        a, b = first(pair), second(pair)
        sum = scalar(0.0)
        for n in range(4):
            o = at(g, moved(moved(c, a, -(n % 2)), b, -(n / 2)))
            if wp.static(of.cut):
                sum += mesh.fill[o] * geometry.quarter_fraction[(o * wp.static(of.pairs) + pair) * 4 + n]
            else:
                sum += mesh.fill[o]
        return scalar(0.25) * sum

    @wp.func
    def shear(g: Grid, mesh: Fields, geometry: Geometry, c: whole, pair: wp.int32):
        """Return the shear rate at an edge [1/s] and the volume of concrete that belongs to it; both 0 in the air."""
        a, b = first(pair), second(pair)
        here, left, below = at(g, c), at(g, moved(c, a, -1)), at(g, moved(c, b, -1))
        rate = scalar(0.0)
        volume = scalar(0.0)
        u0, u1, w0, w1 = below + a * g.slots, here + a * g.slots, left + b * g.slots, here + b * g.slots
        if (
            has_velocity(mesh.kind[u0])
            and has_velocity(mesh.kind[u1])
            and has_velocity(mesh.kind[w0])
            and has_velocity(mesh.kind[w1])
        ):
            rate = (mesh.velocity[u1] - mesh.velocity[u0]) / g.width[b]
            rate += (mesh.velocity[w1] - mesh.velocity[w0]) / g.width[a]
            volume = wetness(g, mesh, geometry, c, pair) * side_weight(g, c) * block(g)
        return rate, volume

    @wp.func
    def stretch(g: Grid, mesh: Fields, c: whole) -> vec3:
        """Return the normal strain rates of a cell along its axes [1/s].

        With an axis of symmetry the third component is the strain rate in the circumferential direction.
        """
        rates = vec3()
        here = at(g, c)
        for axis in range(dims):
            r = here + axis * g.slots
            s = at(g, moved(c, axis, 1)) + axis * g.slots
            if wp.static(of.cut):
                both = has_velocity(mesh.kind[r]) and has_velocity(mesh.kind[s])
                if both:
                    rates[axis] = (mesh.velocity[s] - mesh.velocity[r]) / g.width[axis]
            else:
                rates[axis] = (mesh.velocity[s] - mesh.velocity[r]) / g.width[axis]
        if wp.static(of.axial):
            right = at(g, moved(c, 0, 1))
            sum = mesh.velocity[here] + mesh.velocity[right]
            if wp.static(of.cut):
                if not has_velocity(mesh.kind[here]):
                    sum = scalar(2.0) * mesh.velocity[right]
                if not has_velocity(mesh.kind[right]):
                    sum = wp.where(has_velocity(mesh.kind[here]), scalar(2.0) * mesh.velocity[here], scalar(0.0))
            rates[2] = scalar(0.5) * sum / cell_weight(g, c)
        return rates

    @wp.func
    def wall_speed(walls: Walls, wall: wp.int32, x: vec, axis: wp.int32) -> scalar:
        """Return the component along an axis of a wall's velocity at the point `x` [m/s]."""
        d = x - walls.pivot[wall]
        w = walls.spin[wall]
        if wp.static(of.dimensions == 2):
            return walls.velocity[wall][axis] + w[1] * wp.where(axis == 0, d[1], -d[0])
        else:
            return walls.velocity[wall][axis] + wp.cross(w, d)[axis]

    return SimpleNamespace(
        **vars(places), open_area=open_area, is_unknown=is_unknown, has_velocity=has_velocity, wetness=wetness,
        shear=shear, stretch=stretch, wall_speed=wall_speed,
    )  # fmt: skip
