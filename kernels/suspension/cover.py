"""Cells, cell edges and faces that aggregates cover, and faces in narrow gaps that must not move with aggregates."""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.control import HALTED
from ..mps.coarse import lanes
from ..mps.grid.cells import LIQUID, GridKind, grid_parameters_struct, grid_structs
from ..mps.grid.places import grid_functions, place_functions
from ..mps.structs import mps_types
from .bodies import COVER_LOOPS, FULL, BodyKind, body_functions, body_structs, shape_functions
from .vectors import share_of_body


@functools.cache
def cover_functions(scalar, of: GridKind, kind: BodyKind) -> SimpleNamespace:
    """Build functions that return the cells near an aggregate, and the parts of cells and faces that it covers."""
    t = mps_types(scalar, 3)
    vec, whole = t.vec, t.whole
    Grid, Bodies = grid_parameters_struct(scalar, 3), body_structs(scalar).Bodies
    shape = shape_functions(scalar, kind)

    @wp.func
    def box(g: Grid, bodies: Bodies, b: wp.int32):
        """Return the lowest and the highest indices along each axis of the cells that an aggregate may touch."""
        low = whole()
        high = whole()
        for axis in range(3):
            for s in range(shape.first(bodies, b), shape.end(bodies, b)):
                x = (shape.centre(bodies, s)[axis] - g.origin[axis]) / g.width[axis]
                reach = shape.radius(bodies, s) / g.width[axis]
                lowest = wp.int32(wp.floor(x - reach)) - 1
                highest = wp.int32(wp.floor(x + reach)) + 1
                if s > shape.first(bodies, b):
                    lowest = wp.min(lowest, low[axis])
                    highest = wp.max(highest, high[axis])
                low[axis] = lowest
                high[axis] = highest
            if axis < 2 or wp.static(not of.periodic):
                low[axis] = wp.max(low[axis], 0)
                high[axis] = wp.min(high[axis], g.n[axis])
        return low, high

    @wp.func
    def solid_part(g: Grid, bodies: Bodies, b: wp.int32, middle: vec) -> scalar:
        """Return the fraction of a cell-sized box about `middle` that lies in an aggregate.

        The box is divided into 27 smaller boxes. In each of them, a plane approximates the surface of the aggregate.
        """
        offset = middle - bodies.centre[b]
        d, radius = shape.nearest(bodies, b, offset)
        half = scalar(0.5) * wp.length(g.width)
        away = wp.length(d) - radius
        if away > half:
            return scalar(0.0)
        if away < -half:
            return scalar(1.0)
        sum = scalar(0.0)
        for i in range(3):
            for j in range(3):
                for k in range(3):
                    x = offset + wp.cw_mul(vec(scalar(i - 1), scalar(j - 1), scalar(k - 1)), g.width) / scalar(3.0)
                    x, radius = shape.nearest(bodies, b, x)
                    size = wp.max(wp.length(x), scalar(1.0e-6) * radius)
                    # Length of a smaller box, a third of the cell-sized box along each axis, measured along the normal
                    # of the aggregate's surface.
                    extent = wp.dot(wp.abs(x), g.width) / (size * scalar(3.0))
                    sum += wp.clamp(scalar(0.5) - (size - radius) / extent, scalar(0.0), scalar(1.0))
        return sum / scalar(27.0)

    @wp.func
    def covered_part(g: Grid, bodies: Bodies, b: wp.int32, middle: vec, axis: wp.int32) -> scalar:
        """Return the fraction of a face's area that lies in an aggregate; `middle` is the face's centre.

        The face is divided into 9 rectangles. In each of them, a line approximates the outline of the aggregate.
        """
        offset = middle - bodies.centre[b]
        d, radius = shape.nearest(bodies, b, offset)
        if wp.abs(wp.length(d) - radius) > wp.length(g.width):
            return wp.where(wp.length(d) < radius, scalar(1.0), scalar(0.0))
        one, two = (axis + 1) % 3, (axis + 2) % 3
        sum = scalar(0.0)
        for i in range(3):
            for j in range(3):
                x = offset
                x[one] = x[one] + scalar(i - 1) * g.width[one] / scalar(3.0)
                x[two] = x[two] + scalar(j - 1) * g.width[two] / scalar(3.0)
                x, radius = shape.nearest(bodies, b, x)
                size = wp.max(wp.length(x), scalar(1.0e-6) * radius)
                extent = (wp.abs(x[one]) * g.width[one] + wp.abs(x[two]) * g.width[two]) / (size * scalar(3.0))
                extent = wp.max(extent, scalar(1.0e-3) * g.width[one])
                sum += wp.clamp(scalar(0.5) - (size - radius) / extent, scalar(0.0), scalar(1.0))
        return sum / scalar(9.0)

    return SimpleNamespace(box=box, solid_part=solid_part, covered_part=covered_part)


@functools.cache
def cover_kernels(scalar, of: GridKind, kind: BodyKind) -> SimpleNamespace:
    """Build the kernels that find the faces and samples (cells and cell edges) that aggregates cover.

    - `clear` deletes the results of the previous step, with one task per sample.
    - `claim` marks covered faces and adds up the fractions of samples that aggregates fill. Its tasks work on the
      aggregates, which :func:`share_of_body` distributes.
    - `collect` lists the faces of each aggregate, with one task per aggregate. It runs after the kernels of
      `release_kernels`.
    """
    whole = mps_types(scalar, 3).whole
    Grid = grid_parameters_struct(scalar, 3)
    structs = body_structs(scalar)
    Bodies, Cover = structs.Bodies, structs.Cover
    Fields = grid_structs(scalar, 3).Fields
    places, f, body = place_functions(scalar, of), cover_functions(scalar, of, kind), body_functions(scalar, of)
    shape = shape_functions(scalar, kind)

    @wp.kernel(enable_backward=False, module="unique")
    def clear(g: Grid, cover: Cover):
        k = wp.tid()
        cover.solid[k] = 0
        if k < 3 * g.slots:
            cover.owner[k] = 0
            cover.claims[k] = 0
            cover.touches[k] = 0
            cover.closing[k] = 0
            cover.closer[k] = 0
            cover.toucher[k] = 0
            cover.covered[k] = 0

    @wp.kernel(enable_backward=False, module="unique", module_options=COVER_LOOPS)
    def claim(g: Grid, flags: wp.array(dtype=wp.int32), bodies: Bodies, mesh: Fields, cover: Cover):
        if flags[HALTED] != 0:
            return
        b, lane = share_of_body(wp.tid(), 0)
        low, high = f.box(g, bodies, b)
        across = wp.max(high - low + whole(1, 1, 1), whole())
        for n in range(lane, across[0] * across[1] * across[2], lanes()):
            c = low + whole(n % across[0], n / across[0] % across[1], n / across[0] / across[1])
            number = places.at(g, c)
            for axis in range(3):
                middle = places.face_middle(g, c, axis)
                r = number + axis * g.slots
                if mesh.kind[r] == LIQUID:
                    d, radius = shape.nearest(bodies, b, middle - bodies.centre[b])
                    if wp.length(d) < radius:
                        wp.atomic_add(cover.claims, r, 1)
                        wp.atomic_max(cover.owner, r, b + 1)
                    area = wp.int32(f.covered_part(g, bodies, b, middle, axis) * scalar(FULL))
                    if area > 0:
                        wp.atomic_add(cover.touches, r, 1)
                        wp.atomic_max(cover.toucher, r, b + 1)
                        wp.atomic_add(cover.covered, r, area)
            for sample in range(4):
                part = f.solid_part(g, bodies, b, body.sample_middle(g, c, sample))
                if part > scalar(0.0):
                    wp.atomic_add(cover.solid, number + sample * g.slots, wp.int32(part * scalar(FULL)))

    @wp.kernel(enable_backward=False, module="unique")
    def collect(g: Grid, flags: wp.array(dtype=wp.int32), bodies: Bodies, cover: Cover):
        if flags[HALTED] != 0:
            return
        b = wp.tid()
        count = wp.int32(0)
        low, high = f.box(g, bodies, b)
        # List the faces axis by axis, in the order in which arrays of faces store them.
        for axis in range(3):
            for k in range(low[2], high[2] + 1):
                for j in range(low[1], high[1] + 1):
                    for i in range(low[0], high[0] + 1):
                        r = places.at(g, whole(i, j, k)) + axis * g.slots
                        if cover.owner[r] == b + 1:
                            cover.faces[cover.first[b] + count] = r
                            cover.part[cover.first[b] + count] = scalar(1.0)
                            cover.lever[cover.first[b] + count] = body.lever(g, bodies, b, r)
                            count += 1
        cover.count[b] = count
        for axis in range(3):
            for k in range(low[2], high[2] + 1):
                for j in range(low[1], high[1] + 1):
                    for i in range(low[0], high[0] + 1):
                        r = places.at(g, whole(i, j, k)) + axis * g.slots
                        # If two aggregates cover parts of a face, list the face for neither of them.
                        if cover.claims[r] == 0 and cover.touches[r] == 1 and cover.toucher[r] == b + 1:
                            cover.faces[cover.first[b] + count] = r
                            cover.part[cover.first[b] + count] = scalar(cover.covered[r]) / scalar(FULL)
                            cover.lever[cover.first[b] + count] = body.lever(g, bodies, b, r)
                            count += 1
        cover.touched[b] = count

    return SimpleNamespace(clear=clear, claim=claim, collect=collect)


@functools.cache
def release_kernels(scalar, of: GridKind) -> SimpleNamespace:
    """Build the kernels that decide which faces in narrow gaps between aggregates and walls move with an aggregate.

    They are launched in the order `close`, `shut`, `share`, `release`. `shut` runs with one task per face, and the
    other kernels with one task per cell.
    """
    Grid = grid_parameters_struct(scalar, 3)
    Cover = body_structs(scalar).Cover
    fields = grid_structs(scalar, 3)
    Fields, Geometry = fields.Fields, fields.Geometry
    places = grid_functions(scalar, of)

    @wp.func
    def is_cut(g: Grid, geometry: Geometry, number: wp.int32) -> wp.bool:
        """Return whether a wall cuts a cell or closes one of its sides, so that open areas of opposite faces differ."""
        if wp.static(of.cut):
            c = places.cell(g, number)
            for axis in range(3):
                high = places.open_area(g, geometry, places.moved(c, axis, 1), axis)
                if places.open_area(g, geometry, c, axis) != high:
                    return True
        return False

    @wp.kernel(enable_backward=False, module="unique")
    def close(g: Grid, flags: wp.array(dtype=wp.int32), geometry: Geometry, mesh: Fields, cover: Cover):
        """Find cells in which all faces except one move with the same aggregate, and mark the remaining face.

        Mortar is incompressible, so the remaining face has the aggregate's velocity anyway. This is not so if a wall
        cuts the cell or closes one of its sides. The result is stored in `closing` and `closer`, because other tasks of
        this kernel still read `claims` and `owner`.
        """
        if flags[HALTED] != 0:
            return
        number = wp.tid()
        if mesh.liquid[number] == 0 or is_cut(g, geometry, number):
            return
        c = places.cell(g, number)
        owner = wp.int32(0)
        left = wp.int32(-1)
        free = wp.int32(0)
        for axis in range(3):
            for side in range(2):
                r = places.at(g, places.moved(c, axis, side)) + axis * g.slots
                own = cover.owner[r]
                if own == 0 or mesh.kind[r] != LIQUID:
                    free += 1
                    left = r
                elif owner == 0 or own == owner:
                    owner = own
                else:
                    free += 2
        if free == 1 and owner != 0 and mesh.kind[left] == LIQUID:
            wp.atomic_add(cover.closing, left, 1)
            wp.atomic_max(cover.closer, left, owner)

    @wp.kernel(enable_backward=False, module="unique")
    def shut(g: Grid, flags: wp.array(dtype=wp.int32), cover: Cover):
        """Let the faces that `close` has marked move with their aggregate."""
        if flags[HALTED] != 0:
            return
        r = wp.tid()
        if cover.closing[r] > 0:
            cover.claims[r] = cover.claims[r] + cover.closing[r]
            cover.owner[r] = cover.closer[r]

    @wp.kernel(enable_backward=False, module="unique")
    def share(g: Grid, flags: wp.array(dtype=wp.int32), geometry: Geometry, mesh: Fields, cover: Cover):
        """Find the cells that would prevent two aggregates, or an aggregate and a wall, from moving apart.

        In such a cell, two faces move with different aggregates, or the centre of a face lies in two aggregates, or
        each face moves with an aggregate or belongs to a wall. If a wall cuts the cell or closes one of its sides, the
        inflow and the outflow of mortar through the faces that move with the aggregate differ. One free face is then
        not enough either, because two cells at the wall that share their only free face would form a closed pocket.
        """
        if flags[HALTED] != 0:
            return
        number = wp.tid()
        c = places.cell(g, number)
        found = wp.int32(0)
        shared = wp.int32(0)
        free = wp.int32(0)
        closed = wp.int32(0)
        if mesh.liquid[number] != 0:
            for axis in range(3):
                for side in range(2):
                    r = places.at(g, places.moved(c, axis, side)) + axis * g.slots
                    own = cover.owner[r]
                    if own != 0:
                        if cover.claims[r] > 1 or (found != 0 and own != found):
                            shared = 1
                        found = own
                    elif mesh.kind[r] == LIQUID:
                        free += 1
                    else:
                        closed += 1
            if found != 0 and free == 0 and closed > 0:
                shared = 1
            if found != 0 and free <= 1 and is_cut(g, geometry, number):
                shared = 1
        cover.shared[number] = shared

    @wp.kernel(enable_backward=False, module="unique")
    def release(g: Grid, flags: wp.array(dtype=wp.int32), cover: Cover):
        """Release the faces of the cells that `share` has found: their velocities become unknowns again.

        If all faces of a cell moved with two aggregates, mortar could neither enter nor leave the cell, and the
        aggregates would stick together.
        """
        if flags[HALTED] != 0:
            return
        number = wp.tid()
        c = places.cell(g, number)
        for axis in range(3):
            r = number + axis * g.slots
            if cover.owner[r] != 0:
                if cover.shared[number] != 0 or cover.shared[places.at(g, places.moved(c, axis, -1))] != 0:
                    cover.owner[r] = 0

    return SimpleNamespace(close=close, shut=shut, share=share, release=release)
