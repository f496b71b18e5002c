"""Projection of a grid's velocities onto those without divergence, and what drives a periodic pipe."""

import functools
from types import SimpleNamespace

import warp as wp

from ...common.control import HALTED
from ...common.reductions import keep, total
from ..structs import array_structs, mps_types, row_place
from .cells import ACTED, DT, FORCE, LIQUID, OPEN, PUSH, ROUGH, Kind, cells_struct, grid_functions, grid_structs

CORRECTED = 0.1
"""Part of what is too much or too little in a cell that a step takes away."""


@functools.cache
def pressure_kernels(scalar, serial: bool, of: Kind) -> SimpleNamespace:
    """Kernels `divergence` before the solve, `project` after it, a task a slot each."""
    dims = of.dimensions
    Cells = cells_struct(scalar, dims)
    structs = grid_structs(scalar, dims)
    Mesh, Geometry, Walls = structs.Mesh, structs.Geometry, structs.Walls
    solves = array_structs(scalar, 2)
    Matrix, Solve = solves.Matrix, solves.NumberSolve
    f = grid_functions(scalar, of)
    entry = row_place(serial)

    @wp.kernel(enable_backward=False, module="unique")
    def divergence(
        g: Cells, flags: wp.array(dtype=wp.int32), geometry: Geometry, walls: Walls, mesh: Mesh, matrix: Matrix,
        projection: Solve,
    ):  # fmt: skip
        """Volume that flows into a cell, and its row of the matrix of the pressure's increment."""
        if flags[HALTED] != 0:
            return
        number = wp.tid()
        c = f.cell(g, number)
        count = wp.int32(0)
        diagonal = scalar(0.0)
        into = scalar(0.0)
        mesh.increment[number] = scalar(0.0)
        liquid = mesh.liquid[number]
        if liquid != 0:
            for axis in range(dims):
                for side in range(2):
                    face = f.moved(c, axis, side)
                    r = f.at(g, face) + axis * g.slots
                    area = f.open_area(g, geometry, face, axis)
                    flux = area * mesh.velocity[r]
                    if wp.static(of.cut):
                        wall = geometry.surface[r]
                        if wall > ROUGH:  # what goes with a wall flows through the rest of the face
                            x = f.face_middle(g, face, axis)
                            flux += (f.face_area(g, face, axis) - area) * f.wall_speed(walls, wall, x, axis)
                    into += wp.where(side == 0, flux, -flux)
                    if mesh.kind[r] == LIQUID:
                        ease = area * area / mesh.volume[r]
                        diagonal += ease
                        next = f.at(g, f.moved(c, axis, 2 * side - 1))
                        if mesh.liquid[next] != 0:
                            place = entry(number, count, g.slots, matrix.near_capacity)
                            matrix.near[place] = next
                            matrix.coefficient[place] = ease
                            count += 1
        matrix.free[number] = 1 - liquid
        matrix.near_count[number] = count
        matrix.diagonal[number] = diagonal
        projection.residual[number] = g.density / scalar(mesh.clock[DT]) * into

    @wp.kernel(enable_backward=False, module="unique")
    def project(g: Cells, flags: wp.array(dtype=wp.int32), geometry: Geometry, mesh: Mesh):
        """Velocities without divergence; the pressure of this step."""
        if flags[HALTED] != 0:
            return
        number = wp.tid()
        c = f.cell(g, number)
        if not f.on_grid(g, c):
            return
        for axis in range(dims):
            r = number + axis * g.slots
            kind = mesh.kind[r]
            if wp.static(not of.cut) and kind == LIQUID:  # what walls did bear in the end
                mesh.traction[r] = mesh.traction[r] + mesh.growth[r] * (mesh.velocity[r] - mesh.start[r])
            if kind == LIQUID:
                rise = mesh.increment[number] - mesh.increment[f.at(g, f.moved(c, axis, -1))]
                ease = scalar(mesh.clock[DT]) / g.density * f.open_area(g, geometry, c, axis) / mesh.volume[r]
                mesh.velocity[r] = mesh.velocity[r] - ease * rise
        mesh.pressure[number] = wp.where(
            mesh.liquid[number] != 0, mesh.pressure[number] + mesh.increment[number], scalar(0.0)
        )

    return SimpleNamespace(divergence=divergence, project=project)


@functools.cache
def crowd_kernels(scalar, of: Kind) -> SimpleNamespace:
    """Kernels `source` and `disperse`, before and after a solve with the matrix of the pressure, a task a slot each.

    Particles drift together and apart, as no divergence in the cells does not keep them; a part of what is too much or
    too little is taken away by a displacement that no velocity feels.
    """
    dims = of.dimensions
    Cells = cells_struct(scalar, dims)
    structs = grid_structs(scalar, dims)
    Mesh, Geometry = structs.Mesh, structs.Geometry
    Solve = array_structs(scalar, 2).NumberSolve
    f = grid_functions(scalar, of)
    whole = mps_types(scalar, dims).whole

    @wp.func
    def missing(g: Cells, mesh: Mesh, c: whole) -> scalar:
        """What a crowd lacks of 1 because cells around are not full, if these are filled evenly."""
        sum = scalar(0.0)
        for n in range(wp.static(3**dims)):
            o = whole()
            rest = n
            part = scalar(1.0)
            for b in range(dims):
                by = rest % 3 - 1
                rest = rest / 3
                o[b] = c[b] + by
                part *= wp.where(by == 0, scalar(0.75), scalar(0.125))
            near = f.at(g, o)
            if mesh.solid[near] == OPEN:
                sum += part * (scalar(1.0) - mesh.fill[near])
        return sum

    @wp.kernel(enable_backward=False, module="unique")
    def source(g: Cells, flags: wp.array(dtype=wp.int32), geometry: Geometry, mesh: Mesh, projection: Solve):
        if flags[HALTED] != 0:
            return
        number = wp.tid()
        c = f.cell(g, number)
        mesh.potential[number] = scalar(0.0)
        excess = scalar(0.0)
        dt = scalar(mesh.clock[DT])
        if mesh.liquid[number] != 0:
            excess = mesh.crowd[number] - scalar(1.0)
            if excess < scalar(0.0):
                # Less than full may be the surface's right: so much as its cells, evenly filled, would leave here.
                excess = wp.where(mesh.fill[number] < scalar(1.0), scalar(0.0), excess + missing(g, mesh, c))
                excess = wp.min(excess, scalar(0.0))
            excess = wp.clamp(excess, scalar(-0.1), scalar(0.1))
            excess *= scalar(CORRECTED) * geometry.room[number] * f.cell_volume(g, c) / dt
        projection.residual[number] = g.density / dt * excess

    @wp.kernel(enable_backward=False, module="unique")
    def disperse(g: Cells, flags: wp.array(dtype=wp.int32), geometry: Geometry, mesh: Mesh):
        if flags[HALTED] != 0:
            return
        number = wp.tid()
        c = f.cell(g, number)
        dt = scalar(mesh.clock[DT])
        for axis in range(dims):
            r = number + axis * g.slots
            speed = scalar(0.0)
            if f.on_grid(g, c) and mesh.kind[r] == LIQUID:
                rise = mesh.potential[number] - mesh.potential[f.at(g, f.moved(c, axis, -1))]
                speed = -dt / g.density * f.open_area(g, geometry, c, axis) / mesh.volume[r] * rise
                most = scalar(0.05) * g.width[axis] / dt
                speed = wp.clamp(speed, -most, most)
            mesh.shift[r] = speed

    return SimpleNamespace(source=source, disperse=disperse)


@functools.cache
def drive_kernels(scalar, dimensions: int) -> SimpleNamespace:
    """Kernels that hold the mean velocity along a periodic pipe: `lacking`, or `sums` and `lacking_of_sums`; `shove`.

    All faces are given what the mean lacks, which is a uniform force; the next step begins with that force, and with
    what the wall will answer.
    """
    Cells = cells_struct(scalar, dimensions)
    Mesh = grid_structs(scalar, dimensions).Mesh

    @wp.func
    def book(g: Cells, clock: wp.array(dtype=wp.float64), drive: wp.array(dtype=wp.float64), mean: wp.float64):
        lacks = wp.float64(g.frame) - mean
        inertia = wp.float64(g.density) / clock[DT]
        drive[ACTED] = drive[FORCE] + inertia * lacks
        drive[FORCE] = drive[FORCE] + (inertia + g.resistance) * lacks
        drive[PUSH] = lacks

    @wp.kernel(enable_backward=False, module="unique")
    def lacking(g: Cells, flags: wp.array(dtype=wp.int32), mesh: Mesh):
        """One task."""
        if flags[HALTED] != 0:
            return
        sum = wp.float64(0.0)
        whole = wp.float64(0.0)
        for r in range((dimensions - 1) * g.slots, dimensions * g.slots):
            if mesh.kind[r] == LIQUID:
                sum += wp.float64(mesh.volume[r]) * wp.float64(mesh.velocity[r])
                whole += wp.float64(mesh.volume[r])
        book(g, mesh.clock, mesh.drive, sum / whole)

    @wp.kernel(enable_backward=False, module="unique")
    def sums(g: Cells, blocks: wp.int32, mesh: Mesh, partial: wp.array(dtype=wp.float64)):
        """Whole blocks."""
        c = wp.tid()
        own = wp.float64(0.0)
        volume = wp.float64(0.0)
        if c < g.slots:
            r = c + (dimensions - 1) * g.slots
            if mesh.kind[r] == LIQUID:
                volume = wp.float64(mesh.volume[r])
                own = volume * wp.float64(mesh.velocity[r])
        keep(c, partial, 0, own)
        keep(c, partial, blocks, volume)

    @wp.kernel(enable_backward=False, module="unique")
    def lacking_of_sums(
        g: Cells, blocks: wp.int32, flags: wp.array(dtype=wp.int32), partial: wp.array(dtype=wp.float64), mesh: Mesh
    ):
        """One block."""
        c = wp.tid()
        sum = total(c, partial, 0, blocks)
        whole = total(c, partial, blocks, blocks)
        if c == 0 and flags[HALTED] == 0:
            book(g, mesh.clock, mesh.drive, sum / whole)

    @wp.kernel(enable_backward=False, module="unique")
    def shove(g: Cells, flags: wp.array(dtype=wp.int32), mesh: Mesh):
        """A task a slot."""
        if flags[HALTED] != 0:
            return
        r = wp.tid() + (dimensions - 1) * g.slots
        if mesh.kind[r] == LIQUID:
            mesh.velocity[r] = mesh.velocity[r] + scalar(mesh.drive[PUSH])

    return SimpleNamespace(lacking=lacking, sums=sums, lacking_of_sums=lacking_of_sums, shove=shove)
