"""Numbers, arrays and small functions of a grid: in a plane, about an axis, or in space.

Cells are counted from the lowest one, (0, 0) or (0, 0, 0), the last coordinate up or along; a frame of one cell lies
around them. Cells, faces and edges share one numbering: face c of axis a is the side of cell c that looks down that
axis (its row is c + a slots), edge c of the pair of axes a and b the lowest of its cell's that runs along neither (row
c + (a + b - 1) slots; in a plane, the lower left corner). Velocities are those of the room. Volumes and areas are those
of a metre's depth, or of a radian.

Walls are sides of cells, or (`Kind.cut`) pass through them: then a face has its distance from the nearest wall and an
open part, a cell and an edge the part that there is room in. What flows in and out of a cell does so through the open
parts, as in Ng, Min & Gibou (2009). Shear and stretch count by what is open of edges and cells, as in Batty & Bridson
(2008); faces within walls that these need are unknown too, and the wall rubs on the velocity where it is, between such
a face and the next.
"""

import functools
from types import SimpleNamespace
from typing import NamedTuple

import warp as wp

from ...common.types import types
from ..structs import mps_types

OPEN = wp.constant(0)  # of `solid`: a cell that concrete may fill; above it, number of the wall that fills it
SMOOTH = wp.constant(2)  # wall that nothing rubs on: an axis, a plane of symmetry
GATE = wp.constant(3)  # wall that opens
# Kinds of faces.
AIR = wp.constant(0)  # no concrete on either side
LIQUID = wp.constant(1)  # concrete on one side or both, which flows through it: unknown
FIXED = wp.constant(2)  # side of a wall, which has its velocity across it
INSIDE = wp.constant(3)  # within walls
ROUGH = wp.constant(4)  # wall that concrete sticks to; those above have velocities
GHOST = wp.constant(4)  # within a wall, of a cell or an edge that is not
# Slots of `drive`.
FORCE = wp.constant(0)  # per volume that the next step begins with [N/m3]
ACTED = wp.constant(1)  # per volume that acted in this step [N/m3]
PUSH = wp.constant(2)  # velocity that all faces along the pipe are given at the end of this step [m/s]
DRIVE = 3
# Slots of `clock`.
DT = wp.constant(0)  # step [s]
NOW = wp.constant(1)  # time [s]
UNTIL = wp.constant(2)  # time to stop at [s]
WANTED = wp.constant(3)  # step that is wanted; one that ends at a time may be shorter [s]
SPEED = wp.constant(4)  # of the concrete, rms [m/s]
SWIFT = wp.constant(5)  # cells that the fastest passes in a second [1/s]
BEFORE = wp.constant(6)  # SPEED of the step before [m/s]
RATE = wp.constant(7)  # at which it grew then [m/s2]
LAST = wp.constant(8)  # step before [s]
CLOCK = 9


class Kind(NamedTuple):
    """What a grid's kernels are made for."""

    dimensions: int = 2
    axial: bool = False
    """About an axis, which is the left side."""
    periodic: bool = False
    """Goes on below as it ends above, and is full; else there is a free surface."""
    cut: bool = False
    """Walls pass through cells."""
    thixotropic: bool = False
    """Concrete of a periodic pipe has gained structure that flow breaks."""

    @property
    def pairs(self) -> int:
        """Of axes."""
        return 1 if self.dimensions == 2 else 3

    @property
    def velocity_neighbours(self) -> int:
        """Faces that one may be coupled with."""
        return 2 + 6 * (self.dimensions - 1)

    @property
    def pressure_neighbours(self) -> int:
        """Cells that one may be coupled with."""
        return 2 * self.dimensions


@functools.cache
def cells_struct(scalar, dimensions: int):
    """Numbers of a grid and of the flow on it."""
    t = mps_types(scalar, dimensions)

    @wp.struct
    class Cells:
        n: t.whole  # cells along each axis
        slots: wp.int32  # of those and their frame
        width: t.vec  # of a cell [m]
        origin: t.vec  # lowest corner [m]
        frame: scalar  # velocity along the last axis of the grid, and of the mean of a periodic pipe [m/s]
        gravity: t.vec  # acceleration [m/s2]
        density: scalar  # [kg/m3]
        viscosity: scalar  # plastic [Pa s]
        yield_stress: scalar  # [Pa]
        regularisation: scalar  # beta [s]
        volume: scalar  # of the mean particle
        inflow: t.vec  # velocity with which particles come in again that have left [m/s]
        resistance: wp.float64  # growth of the wall's force per volume with the mean velocity [kg/m3/s]

    return Cells


@functools.cache
def grid_structs(scalar, dimensions: int) -> SimpleNamespace:
    """Structs `Particles`, `Mesh` (what lies on the grid), `Geometry` (where walls are) and `Walls`."""
    t = mps_types(scalar, dimensions)
    vec3 = types(scalar).vec3

    @wp.struct
    class Particles:
        position: wp.array(dtype=t.vec)  # [m], shape (n,) as the rest
        velocity: wp.array(dtype=t.vec)  # [m/s]
        gradient: wp.array(dtype=t.mat)  # of the velocity [1/s]
        pressure: wp.array(dtype=scalar)  # [Pa]
        mass: wp.array(dtype=scalar)  # over that of the mean particle; 0 of one that has left

    @wp.struct
    class Mesh:
        solid: wp.array(dtype=wp.int32)  # OPEN or number of the wall, shape (slots,) as the next
        liquid: wp.array(dtype=wp.int32)  # 1 where there is concrete
        crowd: wp.array(dtype=scalar)  # of particles around a cell's middle, over as many as fill it
        fill: wp.array(dtype=scalar)  # part of the cell's room that concrete fills
        count: wp.array(dtype=wp.int32)  # particles in a cell
        begin: wp.array(dtype=wp.int32)  # where they are in `bin`
        listed: wp.array(dtype=wp.int32)  # particles that cells have room for in it so far, shape (1,)
        home: wp.array(dtype=wp.int32)  # cell of a particle, or -1, shape (n,) as the next
        place: wp.array(dtype=wp.int32)  # of a particle among those of its cell
        bin: wp.array(dtype=wp.int32)  # particles of a cell, then those of another
        kind: wp.array(dtype=wp.int32)  # of a face, shape (axes * slots,) as the next
        velocity: wp.array(dtype=scalar)  # across a face [m/s]
        start: wp.array(dtype=scalar)  # that velocity before forces act [m/s]
        volume: wp.array(dtype=scalar)  # of concrete that a face stands for
        rubbed: wp.array(dtype=scalar)  # area of a pipe's walls along that volume
        traction: wp.array(dtype=scalar)  # stress of those walls, of the sign of the velocity [Pa]
        growth: wp.array(dtype=scalar)  # of that with the face's velocity [Pa s/m]
        slip: wp.array(dtype=scalar)  # velocity at those walls, of the face without any [m/s]
        grip: wp.array(dtype=scalar)  # force of a wall between a face and the next along an axis over the velocity at
        # the wall, shape (axes^2 * slots,) as the next: faces of the first axis and their next along each
        pull: wp.array(dtype=scalar)  # that force at the known velocity
        lean: wp.array(dtype=scalar)  # share of the next face in that velocity, the rest is the face's own
        shift: wp.array(dtype=scalar)  # velocity that moves particles off crowds [m/s]
        pressure: wp.array(dtype=scalar)  # in the cells [Pa], shape (slots,) as the next
        increment: wp.array(dtype=scalar)  # of the pressure in this step [Pa]
        potential: wp.array(dtype=scalar)  # whose slope moves particles off crowds, as a pressure would [Pa]
        in_cell: wp.array(dtype=scalar)  # apparent viscosity [Pa s]
        in_corner: wp.array(dtype=scalar)  # likewise, at an edge, shape (pairs * slots,) as the next
        stress: wp.array(
            dtype=scalar
        )  # shear stress at a pipe's corner in the step before, or of its wall [Pa], (slots,)
        strain: wp.array(dtype=scalar)  # square of a cell's rate of shear [1/s2], shape (slots,)
        besides: wp.array(dtype=scalar)  # square of a cell's rate of shear without that of the pair [1/s2]
        gained: wp.array(dtype=scalar)  # by a cell's yield stress at rest [Pa], shape (slots,), or none
        layer: wp.array(dtype=scalar)  # likewise by a wall's along a face, shape (axes * slots,), or none
        drive: wp.array(dtype=wp.float64)  # of a periodic pipe, slots above, shape (DRIVE,)
        clock: wp.array(dtype=wp.float64)  # slots above, shape (CLOCK,)

    @wp.struct
    class Geometry:
        depth: wp.array(dtype=scalar)  # distance from the nearest wall, negative in it, of two places of a cell along
        # each axis, a quarter and three quarters on [m], shape (slots * 2^axes,), the first axis fastest
        room: wp.array(dtype=scalar)  # part of a cell that is not wall, shape (slots,)
        nook: wp.array(dtype=scalar)  # likewise, of the quarters of a cell around its edges of each pair, shape
        # (slots * pairs * 4,), the pair's first axis fastest
        hold: wp.array(dtype=scalar)  # volume of what is open around its middle, weighted as particles are, (slots,)
        opens: wp.array(dtype=scalar)  # when what is shut here opens [s], shape (slots,); no rows where nothing does
        inlet: wp.array(dtype=t.vec)  # places at which particles come in that have left [m], shape (n,); n may be 0
        gap: wp.array(dtype=scalar)  # distance of a face's middle from the nearest wall [m], shape (axes * slots,) as
        part: wp.array(dtype=scalar)  # of a face that is open
        shut: wp.array(dtype=wp.int32)  # kind of a face that is not
        surface: wp.array(dtype=wp.int32)  # number of the nearest wall

    @wp.struct
    class Walls:
        velocity: wp.array(dtype=t.vec)  # [m/s], rows by the wall's number, none in row 0, as the next
        spin: wp.array(dtype=vec3)  # about `pivot` [rad/s]; in a plane, the middle one counts
        pivot: wp.array(dtype=t.vec)  # [m]
        slip_viscosity: wp.array(dtype=scalar)  # of the slip layer [Pa s/m]; below 0: smooth
        slip_yield: wp.array(dtype=scalar)  # [Pa]

    return SimpleNamespace(Particles=Particles, Mesh=Mesh, Geometry=Geometry, Walls=Walls)


@functools.cache
def place_functions(scalar, of: Kind) -> SimpleNamespace:
    """Numbers, places and weights of cells, faces and edges."""
    dims, last = of.dimensions, of.dimensions - 1
    t = mps_types(scalar, dims)
    whole, vec = t.whole, t.vec
    Cells = cells_struct(scalar, dims)

    @wp.func
    def at(g: Cells, c: whole) -> wp.int32:
        """Number of a cell, edge or face of axis 0."""
        k = c[last]
        if wp.static(of.periodic):
            k = (k + g.n[last]) % g.n[last]
        if wp.static(of.dimensions == 2):
            return (k + 1) * (g.n[0] + 2) + c[0] + 1
        else:
            return ((k + 1) * (g.n[1] + 2) + c[1] + 1) * (g.n[0] + 2) + c[0] + 1

    @wp.func
    def cell(g: Cells, number: wp.int32) -> whole:
        """Where a cell, edge or face of axis 0 is."""
        across = g.n[0] + 2
        if wp.static(of.dimensions == 2):
            return whole(number % across - 1, number / across - 1)
        else:
            rest = number / across
            deep = g.n[1] + 2
            return whole(number % across - 1, rest % deep - 1, rest / deep - 1)

    @wp.func
    def moved(c: whole, axis: wp.int32, by: wp.int32) -> whole:
        """So many cells on along an axis."""
        c[axis] = c[axis] + by
        return c

    @wp.func
    def on_grid(g: Cells, c: whole) -> wp.bool:
        """May there be a face or an edge?"""
        found = c[last] >= 0 and c[last] <= g.n[last] - wp.static(1 if of.periodic else 0)
        for b in range(last):
            if c[b] < 0 or c[b] > g.n[b]:
                found = False
        return found

    @wp.func
    def reached(g: Cells, c: whole) -> wp.bool:
        """Likewise; a periodic grid goes on."""
        found = wp.bool(True)
        for b in range(wp.static(last if of.periodic else dims)):
            if c[b] < 0 or c[b] > g.n[b]:
                found = False
        return found

    @wp.func
    def in_grid(g: Cells, c: whole) -> wp.bool:
        """Is the cell none of the frame's?"""
        found = wp.bool(True)
        for b in range(dims):
            if c[b] < 0 or c[b] >= g.n[b]:
                found = False
        return found

    @wp.func
    def face_middle(g: Cells, c: whole, axis: wp.int32) -> vec:
        """[m]"""
        x = vec()
        for b in range(dims):
            x[b] = g.origin[b] + (scalar(c[b]) + wp.where(b == axis, scalar(0.0), scalar(0.5))) * g.width[b]
        return x

    @wp.func
    def side_weight(g: Cells, c: whole) -> scalar:
        """Radius of a side; 1 in a plane."""
        if wp.static(of.axial):
            return scalar(c[0]) * g.width[0]
        return scalar(1.0)

    @wp.func
    def cell_weight(g: Cells, c: whole) -> scalar:
        """Radius of a cell's middle; 1 in a plane."""
        if wp.static(of.axial):
            return (scalar(c[0]) + scalar(0.5)) * g.width[0]
        return scalar(1.0)

    @wp.func
    def block(g: Cells) -> scalar:
        """Volume of a cell, but for its weight."""
        if wp.static(of.dimensions == 2):
            return g.width[0] * g.width[1]
        else:
            return g.width[0] * g.width[1] * g.width[2]

    @wp.func
    def cell_volume(g: Cells, c: whole) -> scalar:
        return cell_weight(g, c) * block(g)

    @wp.func
    def face_area(g: Cells, c: whole, axis: wp.int32) -> scalar:
        return wp.where(axis == 0, side_weight(g, c), cell_weight(g, c)) * block(g) / g.width[axis]

    @wp.func
    def cell_of(g: Cells, x: vec) -> wp.int32:
        """Cell at a place, or the nearest."""
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
def grid_functions(scalar, of: Kind) -> SimpleNamespace:
    """Those of places, and rates of shear."""
    dims = of.dimensions
    t = mps_types(scalar, dims)
    whole, vec = t.whole, t.vec
    vec3 = types(scalar).vec3
    Cells = cells_struct(scalar, dims)
    structs = grid_structs(scalar, dims)
    Mesh, Walls, Geometry = structs.Mesh, structs.Walls, structs.Geometry
    places = place_functions(scalar, of)
    at, moved, side_weight, cell_weight, block = (
        places.at, places.moved, places.side_weight, places.cell_weight, places.block,
    )  # fmt: skip

    @wp.func
    def open_area(g: Cells, geometry: Geometry, c: whole, axis: wp.int32) -> scalar:
        """Of a face that concrete flows through."""
        if wp.static(of.cut):
            return places.face_area(g, c, axis) * geometry.part[at(g, c) + axis * g.slots]
        return places.face_area(g, c, axis)

    @wp.func
    def unknown(kind: wp.int32) -> wp.bool:
        """Do viscosity and walls change the face's velocity?"""
        if wp.static(of.cut):
            return wp.where(kind == LIQUID, True, kind == GHOST)
        return kind == LIQUID

    @wp.func
    def sheared(kind: wp.int32) -> wp.bool:
        """Has a face a velocity whose change beside it is a shear or a stretch?"""
        return unknown(kind) or kind == FIXED

    @wp.func
    def wetness(g: Cells, mesh: Mesh, geometry: Geometry, c: whole, pair: wp.int32) -> scalar:
        """Part of what lies around an edge that concrete fills."""
        a = wp.where(pair == 2, 1, 0)
        b = wp.where(pair == 0, 1, 2)
        sum = scalar(0.0)
        for n in range(4):
            o = at(g, moved(moved(c, a, -(n % 2)), b, -(n / 2)))
            if wp.static(of.cut):
                sum += mesh.fill[o] * geometry.nook[(o * wp.static(of.pairs) + pair) * 4 + n]
            else:
                sum += mesh.fill[o]
        return scalar(0.25) * sum

    @wp.func
    def shear(g: Cells, mesh: Mesh, geometry: Geometry, c: whole, pair: wp.int32):
        """Rate of shear at an edge, and the volume of concrete that it stands for; none in the air."""
        a = wp.where(pair == 2, 1, 0)
        b = wp.where(pair == 0, 1, 2)
        here, left, below = at(g, c), at(g, moved(c, a, -1)), at(g, moved(c, b, -1))
        rate = scalar(0.0)
        volume = scalar(0.0)
        u0, u1, w0, w1 = below + a * g.slots, here + a * g.slots, left + b * g.slots, here + b * g.slots
        if sheared(mesh.kind[u0]) and sheared(mesh.kind[u1]) and sheared(mesh.kind[w0]) and sheared(mesh.kind[w1]):
            rate = (mesh.velocity[u1] - mesh.velocity[u0]) / g.width[b]
            rate += (mesh.velocity[w1] - mesh.velocity[w0]) / g.width[a]
            volume = wetness(g, mesh, geometry, c, pair) * side_weight(g, c) * block(g)
        return rate, volume

    @wp.func
    def stretch(g: Cells, mesh: Mesh, c: whole) -> vec3:
        """Rates of stretch of a cell: across, along (or in depth), around the axis (or along)."""
        rates = vec3()
        here = at(g, c)
        for axis in range(dims):
            r = here + axis * g.slots
            s = at(g, moved(c, axis, 1)) + axis * g.slots
            if wp.static(of.cut):
                both = sheared(mesh.kind[r]) and sheared(mesh.kind[s])
                if both:
                    rates[axis] = (mesh.velocity[s] - mesh.velocity[r]) / g.width[axis]
            else:
                rates[axis] = (mesh.velocity[s] - mesh.velocity[r]) / g.width[axis]
        if wp.static(of.axial):
            right = at(g, moved(c, 0, 1))
            sum = mesh.velocity[here] + mesh.velocity[right]
            if wp.static(of.cut):
                if not sheared(mesh.kind[here]):
                    sum = scalar(2.0) * mesh.velocity[right]
                if not sheared(mesh.kind[right]):
                    sum = wp.where(sheared(mesh.kind[here]), scalar(2.0) * mesh.velocity[here], scalar(0.0))
            rates[2] = scalar(0.5) * sum / cell_weight(g, c)
        return rates

    @wp.func
    def wall_speed(walls: Walls, wall: wp.int32, x: vec, axis: wp.int32) -> scalar:
        """Of a point of a wall [m/s]."""
        d = x - walls.pivot[wall]
        w = walls.spin[wall]
        if wp.static(of.dimensions == 2):
            return walls.velocity[wall][axis] + w[1] * wp.where(axis == 0, d[1], -d[0])
        else:
            return walls.velocity[wall][axis] + wp.cross(w, d)[axis]

    return SimpleNamespace(
        **vars(places), open_area=open_area, unknown=unknown, sheared=sheared, wetness=wetness,
        shear=shear, stretch=stretch, wall_speed=wall_speed,
    )  # fmt: skip
