"""Numbers, arrays and small functions of a grid, in a plane or about an axis.

Cells are counted from the lower left one, (0, 0); a frame of one cell lies around them. Faces, corners and cells share
one numbering, (k + 1) (nx + 2) + i + 1: face u(i, k) is the left side of its cell, w(i, k) its lower side (their rows
follow those of u), corner (i, k) its lower left one. Velocities are those of the room and means over their faces,
places are counted from the grid. Volumes and areas are those of a metre's depth, or of a radian.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ...common.types import types
from ..structs import mps_types

OPEN = wp.constant(0)  # of `solid`: a cell that concrete may fill; above it, number of the wall that fills it
GATE = wp.constant(3)  # one that opens
# Kinds of faces.
AIR = wp.constant(0)  # no concrete on either side
LIQUID = wp.constant(1)  # concrete on one side or both: unknown
FIXED = wp.constant(2)  # side of a wall, which has its velocity across it
INSIDE = wp.constant(3)  # within walls
VELOCITY_NEIGHBOURS = 8
PRESSURE_NEIGHBOURS = 4
BIN = wp.constant(40)
"""Particles that a cell has room for; more do not count."""
# Slots of `drive`.
FORCE = wp.constant(0)  # per volume that the next step begins with [N/m3]
ACTED = wp.constant(1)  # per volume that acted in this step [N/m3]
PUSH = wp.constant(2)  # velocity that all faces along the pipe are given at the end of this step [m/s]
DRIVE = 3


@functools.cache
def cells_struct(scalar):
    """Numbers of a grid and of the flow on it."""

    @wp.struct
    class Cells:
        nx: wp.int32  # cells across
        nz: wp.int32  # cells along
        slots: wp.int32  # (nx + 2) (nz + 2)
        dx: scalar  # width of a cell [m]
        dz: scalar  # height [m]
        left: scalar  # place of the left side [m]
        frame: scalar  # velocity along z with which the grid moves, and that of the mean of a periodic pipe [m/s]
        gravity: scalar  # against z [m/s2]
        dt: scalar  # [s]
        density: scalar  # [kg/m3]
        viscosity: scalar  # plastic [Pa s]
        yield_stress: scalar  # [Pa]
        regularisation: scalar  # beta [s]
        volume: scalar  # of the mean particle, of a metre's depth or a radian
        resistance: wp.float64  # growth of the wall's force per volume with the mean velocity [kg/m3/s]

    return Cells


@functools.cache
def grid_structs(scalar) -> SimpleNamespace:
    """Structs `Particles`, `Mesh` (what lies on the grid) and `Walls`."""
    t = mps_types(scalar, 2)

    @wp.struct
    class Particles:
        position: wp.array(dtype=t.vec)  # from the middle or axis, and from the lower side [m], shape (n,) as the rest
        velocity: wp.array(dtype=t.vec)  # [m/s]
        gradient: wp.array(dtype=t.mat)  # of the velocity [1/s]
        pressure: wp.array(dtype=scalar)  # [Pa]
        mass: wp.array(dtype=scalar)  # over that of the mean particle

    @wp.struct
    class Mesh:
        solid: wp.array(dtype=wp.int32)  # OPEN or number of the wall, shape (slots,) as the next
        opens: wp.array(dtype=scalar)  # when a gate's cell opens [s]; without gates it has no rows
        liquid: wp.array(dtype=wp.int32)  # 1 where there is concrete
        crowd: wp.array(dtype=scalar)  # of particles around a cell's middle, over as many as fill it
        fill: wp.array(dtype=scalar)  # part of the cell that concrete fills
        count: wp.array(dtype=wp.int32)  # particles in a cell
        bin: wp.array(dtype=wp.int32)  # which, shape (slots * BIN,)
        kind: wp.array(dtype=wp.int32)  # of a face, shape (2 slots,) as the next
        velocity: wp.array(dtype=scalar)  # across a face [m/s]
        start: wp.array(dtype=scalar)  # that velocity before forces act [m/s]
        volume: wp.array(dtype=scalar)  # of concrete that a face stands for
        pressure: wp.array(dtype=scalar)  # in the cells [Pa], shape (slots,) as the next
        increment: wp.array(dtype=scalar)  # of the pressure in this step [Pa]
        potential: wp.array(dtype=scalar)  # whose slope moves particles off crowds, as a pressure would [Pa]
        shift: wp.array(dtype=scalar)  # velocity of that, across a face [m/s], shape (2 slots,)
        in_cell: wp.array(dtype=scalar)  # apparent viscosity [Pa s]
        in_corner: wp.array(dtype=scalar)  # likewise
        stress: wp.array(dtype=scalar)  # shear stress at a corner in the step before, a wall's where there is one [Pa]
        traction: wp.array(dtype=scalar)  # stress on a face of the wall to its left, its right (of u: below, above)
        # [Pa], shape (4 slots,) as the next: u below, u above, w left, w right
        growth: wp.array(dtype=scalar)  # of that with the face's velocity [Pa s/m]
        slip: wp.array(dtype=scalar)  # velocity at that wall [m/s]
        drive: wp.array(dtype=wp.float64)  # of a periodic pipe, slots above, shape (DRIVE,)

    @wp.struct
    class Walls:
        velocity: wp.array(dtype=t.vec)  # [m/s], rows by the wall's number, none in row 0, as the next
        slip_viscosity: wp.array(dtype=scalar)  # of the slip layer [Pa s/m]; below 0: smooth
        slip_yield: wp.array(dtype=scalar)  # [Pa]

    return SimpleNamespace(Particles=Particles, Mesh=Mesh, Walls=Walls)


@functools.cache
def grid_functions(scalar, axial: bool, periodic: bool) -> SimpleNamespace:
    """Numbers, places and weights of cells, faces and corners, and rates of shear."""
    t = mps_types(scalar, 2)
    vec3 = types(scalar).vec3
    Cells = cells_struct(scalar)
    Mesh = grid_structs(scalar).Mesh

    @wp.func
    def at(g: Cells, i: wp.int32, k: wp.int32) -> wp.int32:
        """Number of a cell, corner or face across."""
        if wp.static(periodic):
            k = (k + g.nz) % g.nz
        return (k + 1) * (g.nx + 2) + i + 1

    @wp.func
    def column(g: Cells, task: wp.int32) -> wp.int32:
        return task % (g.nx + 2) - 1

    @wp.func
    def row(g: Cells, task: wp.int32) -> wp.int32:
        return task / (g.nx + 2) - 1

    @wp.func
    def on_grid(g: Cells, i: wp.int32, k: wp.int32) -> wp.bool:
        """May there be a face or a corner?"""
        highest = g.nz
        if wp.static(periodic):
            highest = g.nz - 1
        return i >= 0 and k >= 0 and i <= g.nx and k <= highest

    @wp.func
    def side_weight(g: Cells, i: wp.int32) -> scalar:
        """Radius of a side; 1 in a plane."""
        if wp.static(axial):
            return scalar(i) * g.dx
        return scalar(1.0)

    @wp.func
    def cell_weight(g: Cells, i: wp.int32) -> scalar:
        """Radius of a cell's middle; 1 in a plane."""
        if wp.static(axial):
            return (scalar(i) + scalar(0.5)) * g.dx
        return scalar(1.0)

    @wp.func
    def cell_volume(g: Cells, i: wp.int32) -> scalar:
        return cell_weight(g, i) * g.dx * g.dz

    @wp.func
    def face_area(g: Cells, i: wp.int32, axis: wp.int32) -> scalar:
        if axis == 0:
            return g.dz * side_weight(g, i)
        return g.dx * cell_weight(g, i)

    @wp.func
    def cell_of(g: Cells, x: t.vec) -> wp.int32:
        """Cell at a place, or the nearest."""
        i = wp.clamp(wp.int32(wp.floor((x[0] - g.left) / g.dx)), 0, g.nx - 1)
        k = wp.clamp(wp.int32(wp.floor(x[1] / g.dz)), 0, g.nz - 1)
        return at(g, i, k)

    @wp.func
    def known(kind: wp.int32) -> wp.bool:
        return wp.where(kind == LIQUID, True, kind == FIXED)

    @wp.func
    def shear(g: Cells, mesh: Mesh, i: wp.int32, k: wp.int32):
        """Rate of shear at a corner, and the volume of concrete that it stands for; none at walls and in the air."""
        here, left, below = at(g, i, k), at(g, i - 1, k), at(g, i, k - 1)
        rate = scalar(0.0)
        volume = scalar(0.0)
        u0, u1, w0, w1 = below, here, left + g.slots, here + g.slots
        if known(mesh.kind[u0]) and known(mesh.kind[u1]) and known(mesh.kind[w0]) and known(mesh.kind[w1]):
            rate = (mesh.velocity[u1] - mesh.velocity[u0]) / g.dz + (mesh.velocity[w1] - mesh.velocity[w0]) / g.dx
            across = at(g, i - 1, k - 1)
            wet = mesh.fill[here] + mesh.fill[left] + mesh.fill[below] + mesh.fill[across]
            if wp.static(not periodic):
                # The stairs of a gate are smooth, as what they stand for is.
                shut = mesh.solid[here] == GATE or mesh.solid[left] == GATE
                if shut or mesh.solid[below] == GATE or mesh.solid[across] == GATE:
                    wet = scalar(0.0)
            volume = scalar(0.25) * wet * side_weight(g, i) * g.dx * g.dz
        return rate, volume

    @wp.func
    def stretch(g: Cells, mesh: Mesh, i: wp.int32, k: wp.int32) -> vec3:
        """Rates of stretch of a cell: across, along, around the axis."""
        here, right, above = at(g, i, k), at(g, i + 1, k), at(g, i, k + 1)
        u0, u1 = mesh.velocity[here], mesh.velocity[right]
        w0, w1 = mesh.velocity[here + g.slots], mesh.velocity[above + g.slots]
        around = scalar(0.0)
        if wp.static(axial):
            around = scalar(0.5) * (u0 + u1) / cell_weight(g, i)
        return vec3((u1 - u0) / g.dx, (w1 - w0) / g.dz, around)

    return SimpleNamespace(
        at=at, column=column, row=row, on_grid=on_grid, side_weight=side_weight, cell_weight=cell_weight,
        cell_volume=cell_volume, face_area=face_area, cell_of=cell_of, known=known, shear=shear, stretch=stretch,
    )  # fmt: skip
