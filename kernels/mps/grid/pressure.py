"""Projection of a grid's velocities onto those without divergence, and what drives a periodic pipe."""

import functools
from types import SimpleNamespace

import warp as wp

from ...common.control import HALTED
from ...common.reductions import keep, total
from ..structs import array_structs, row_place
from .cells import ACTED, FORCE, LIQUID, OPEN, PUSH, cells_struct, grid_functions, grid_structs

CORRECTED = 0.1
"""Part of what is too much or too little in a cell that a step takes away."""


@functools.cache
def pressure_kernels(scalar, serial: bool, axial: bool, periodic: bool) -> SimpleNamespace:
    """Kernels `divergence` before the solve, `project` after it, a task a slot each."""
    Cells = cells_struct(scalar)
    Mesh = grid_structs(scalar).Mesh
    solves = array_structs(scalar, 2)
    Matrix, Solve = solves.Matrix, solves.NumberSolve
    f = grid_functions(scalar, axial, periodic)
    entry = row_place(serial)

    @wp.kernel(enable_backward=False, module="unique")
    def divergence(g: Cells, flags: wp.array(dtype=wp.int32), mesh: Mesh, matrix: Matrix, projection: Solve):
        """Volume that flows into a cell, and its row of the matrix of the pressure's increment."""
        if flags[HALTED] != 0:
            return
        c = wp.tid()
        i, k = f.column(g, c), f.row(g, c)
        count = wp.int32(0)
        diagonal = scalar(0.0)
        into = scalar(0.0)
        mesh.increment[c] = scalar(0.0)
        liquid = mesh.liquid[c]
        if liquid != 0:
            for axis in range(2):
                for side in range(2):
                    a = i + side * (1 - axis)
                    b = k + side * axis
                    r = f.at(g, a, b) + axis * g.slots
                    area = f.face_area(g, a, axis)
                    into += wp.where(side == 0, area, -area) * mesh.velocity[r]
                    if mesh.kind[r] == LIQUID:
                        ease = area * area / mesh.volume[r]
                        diagonal += ease
                        next = f.at(g, i + (2 * side - 1) * (1 - axis), k + (2 * side - 1) * axis)
                        if mesh.liquid[next] != 0:
                            place = entry(c, count, g.slots, matrix.near_capacity)
                            matrix.near[place] = next
                            matrix.coefficient[place] = ease
                            count += 1
        matrix.free[c] = 1 - liquid
        matrix.near_count[c] = count
        matrix.diagonal[c] = diagonal
        projection.residual[c] = g.density / g.dt * into

    @wp.kernel(enable_backward=False, module="unique")
    def project(g: Cells, flags: wp.array(dtype=wp.int32), mesh: Mesh):
        """Velocities without divergence; the pressure of this step."""
        if flags[HALTED] != 0:
            return
        c = wp.tid()
        i, k = f.column(g, c), f.row(g, c)
        if not f.on_grid(g, i, k):
            return
        for axis in range(2):
            r = c + axis * g.slots
            if mesh.kind[r] == LIQUID:
                for side in range(2):  # what walls did bear in the end
                    place = c + (2 * axis + side) * g.slots
                    change = mesh.growth[place] * (mesh.velocity[r] - mesh.start[r])
                    mesh.traction[place] = mesh.traction[place] + change
                rise = mesh.increment[c] - mesh.increment[f.at(g, i - 1 + axis, k - axis)]
                ease = g.dt / g.density * f.face_area(g, i, axis) / mesh.volume[r]
                mesh.velocity[r] = mesh.velocity[r] - ease * rise
        mesh.pressure[c] = wp.where(mesh.liquid[c] != 0, mesh.pressure[c] + mesh.increment[c], scalar(0.0))

    return SimpleNamespace(divergence=divergence, project=project)


@functools.cache
def crowd_kernels(scalar, axial: bool) -> SimpleNamespace:
    """Kernels `source` and `disperse`, before and after a solve with the matrix of the pressure, a task a slot each.

    Particles drift together and apart, as no divergence in the cells does not keep them; a part of what is too much or
    too little is taken away by a displacement that no velocity feels.
    """
    Cells = cells_struct(scalar)
    Mesh = grid_structs(scalar).Mesh
    Solve = array_structs(scalar, 2).NumberSolve
    f = grid_functions(scalar, axial, False)

    @wp.kernel(enable_backward=False, module="unique")
    def source(g: Cells, flags: wp.array(dtype=wp.int32), mesh: Mesh, projection: Solve):
        if flags[HALTED] != 0:
            return
        c = wp.tid()
        i, k = f.column(g, c), f.row(g, c)
        mesh.potential[c] = scalar(0.0)
        excess = scalar(0.0)
        if mesh.liquid[c] != 0:
            excess = mesh.crowd[c] - scalar(1.0)
            if excess < scalar(0.0):
                # Less than full may be the surface's right.
                for n in range(5):
                    a = wp.where(n == 1, 1, 0) - wp.where(n == 2, 1, 0)
                    b = wp.where(n == 3, 1, 0) - wp.where(n == 4, 1, 0)
                    o = f.at(g, i + a, k + b)
                    if mesh.solid[o] == OPEN and mesh.fill[o] < scalar(1.0):
                        excess = scalar(0.0)
            excess = wp.clamp(excess, scalar(-0.1), scalar(0.1))
            excess *= scalar(CORRECTED) * f.cell_volume(g, i) / g.dt
        projection.residual[c] = g.density / g.dt * excess

    @wp.kernel(enable_backward=False, module="unique")
    def disperse(g: Cells, flags: wp.array(dtype=wp.int32), mesh: Mesh):
        if flags[HALTED] != 0:
            return
        c = wp.tid()
        i, k = f.column(g, c), f.row(g, c)
        for axis in range(2):
            r = c + axis * g.slots
            speed = scalar(0.0)
            if f.on_grid(g, i, k) and mesh.kind[r] == LIQUID:
                rise = mesh.potential[c] - mesh.potential[f.at(g, i - 1 + axis, k - axis)]
                speed = -g.dt / g.density * f.face_area(g, i, axis) / mesh.volume[r] * rise
                width = wp.where(axis == 0, g.dx, g.dz)
                speed = wp.clamp(speed, -scalar(0.05) * width / g.dt, scalar(0.05) * width / g.dt)
            mesh.shift[r] = speed

    return SimpleNamespace(source=source, disperse=disperse)


@functools.cache
def drive_kernels(scalar) -> SimpleNamespace:
    """Kernels that hold the mean velocity along a periodic pipe: `lacking`, or `sums` and `lacking_of_sums`; `shove`.

    All faces are given what the mean lacks, which is a uniform force; the next step begins with that force, and with
    what the wall will answer.
    """
    Cells = cells_struct(scalar)
    Mesh = grid_structs(scalar).Mesh

    @wp.func
    def book(g: Cells, drive: wp.array(dtype=wp.float64), mean: wp.float64):
        lacks = wp.float64(g.frame) - mean
        inertia = wp.float64(g.density) / wp.float64(g.dt)
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
        for r in range(g.slots, 2 * g.slots):
            if mesh.kind[r] == LIQUID:
                sum += wp.float64(mesh.volume[r]) * wp.float64(mesh.velocity[r])
                whole += wp.float64(mesh.volume[r])
        book(g, mesh.drive, sum / whole)

    @wp.kernel(enable_backward=False, module="unique")
    def sums(g: Cells, blocks: wp.int32, mesh: Mesh, partial: wp.array(dtype=wp.float64)):
        """Whole blocks."""
        c = wp.tid()
        own = wp.float64(0.0)
        volume = wp.float64(0.0)
        if c < g.slots:
            if mesh.kind[c + g.slots] == LIQUID:
                volume = wp.float64(mesh.volume[c + g.slots])
                own = volume * wp.float64(mesh.velocity[c + g.slots])
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
            book(g, mesh.drive, sum / whole)

    @wp.kernel(enable_backward=False, module="unique")
    def shove(g: Cells, flags: wp.array(dtype=wp.int32), mesh: Mesh):
        """A task a slot."""
        if flags[HALTED] != 0:
            return
        r = wp.tid() + g.slots
        if mesh.kind[r] == LIQUID:
            mesh.velocity[r] = mesh.velocity[r] + scalar(mesh.drive[PUSH])

    return SimpleNamespace(lacking=lacking, sums=sums, lacking_of_sums=lacking_of_sums, shove=shove)
