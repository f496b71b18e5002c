"""Forces on the faces of a grid, and the matrix of their implicit change.

Stretch in cells and shear at corners are what moves each face: forces are derivatives of one dissipation, so that what
a face loses its neighbours win, whatever the viscosity does between them.
"""

import functools

import warp as wp

from ...common.control import HALTED
from ..structs import array_structs, row_place
from .bingham import bingham_functions
from .cells import FORCE, INSIDE, LIQUID, OPEN, cells_struct, grid_functions, grid_structs


@functools.cache
def viscosity_kernel(scalar, axial: bool, periodic: bool):
    """Apparent viscosity of a cell and of its corner, each for the whole rate of shear there."""
    Cells = cells_struct(scalar)
    Mesh = grid_structs(scalar).Mesh
    f = grid_functions(scalar, axial, periodic)
    law = bingham_functions(scalar)

    @wp.func
    def stretch_square(g: Cells, mesh: Mesh, i: wp.int32, k: wp.int32) -> scalar:
        return scalar(2.0) * wp.length_sq(f.stretch(g, mesh, i, k))

    @wp.func
    def change(g: Cells, mesh: Mesh, i: wp.int32, k: wp.int32, axis: wp.int32) -> scalar:
        """Of the shear stress at a corner over a cell, smoothed aside: what swings between cells must not feed it."""
        sum = scalar(0.0)
        for n in range(3):
            a, b = i + (n - 1) * axis, k + (n - 1) * (1 - axis)
            after, before = f.at(g, a + 1 - axis, b + axis), f.at(g, a - 1 + axis, b - axis)
            sum += wp.where(n == 1, scalar(0.5), scalar(0.25)) * (mesh.stress[after] - mesh.stress[before])
        return scalar(0.5) * wp.abs(sum)

    @wp.func
    def relaxed(before: scalar, now: scalar) -> scalar:
        """Half the way in logarithms: with the whole of it plugs thinner than a cell short of the wall swing."""
        if before > scalar(0.0):
            return wp.sqrt(before * now)
        return now

    @wp.kernel(enable_backward=False, module="unique")
    def viscosity(g: Cells, flags: wp.array(dtype=wp.int32), mesh: Mesh):
        if flags[HALTED] != 0:
            return
        c = wp.tid()
        i, k = f.column(g, c), f.row(g, c)
        if not f.on_grid(g, i, k):
            return
        if mesh.liquid[c] != 0:
            sum = scalar(0.0)
            count = scalar(0.0)
            for a in range(2):
                for b in range(2):
                    rate, volume = f.shear(g, mesh, i + a, k + b)
                    if volume > scalar(0.0):
                        sum += rate * rate
                        count += scalar(1.0)
            square = stretch_square(g, mesh, i, k) + sum / wp.max(count, scalar(1.0))
            mesh.in_cell[c] = relaxed(mesh.in_cell[c], law.apparent(g, wp.sqrt(square)))
        rate, volume = f.shear(g, mesh, i, k)
        if volume > scalar(0.0):
            sum = scalar(0.0)
            count = scalar(0.0)
            for a in range(2):
                for b in range(2):
                    if mesh.liquid[f.at(g, i - a, k - b)] != 0:
                        sum += stretch_square(g, mesh, i - a, k - b)
                        count += scalar(1.0)
            whole = wp.sqrt(rate * rate + sum / wp.max(count, scalar(1.0)))
            # Beside a free surface stress varies both ways, and by what particles happen to do.
            most = scalar(0.0)
            if wp.static(periodic):
                most = wp.max(change(g, mesh, i, k, 0), change(g, mesh, i, k, 1))
            mesh.in_corner[c] = relaxed(mesh.in_corner[c], law.apparent_at_edge(g, whole, most))

    return viscosity


@functools.cache
def wall_kernel(scalar, axial: bool, periodic: bool):
    """Stress of walls on the faces along them."""
    Cells = cells_struct(scalar)
    structs = grid_structs(scalar)
    Mesh, Walls = structs.Mesh, structs.Walls
    f = grid_functions(scalar, axial, periodic)
    law = bingham_functions(scalar)

    @wp.kernel(enable_backward=False, module="unique")
    def wall_stress(g: Cells, flags: wp.array(dtype=wp.int32), walls: Walls, mesh: Mesh):
        if flags[HALTED] != 0:
            return
        c = wp.tid()
        i, k = f.column(g, c), f.row(g, c)
        if not f.on_grid(g, i, k):
            return
        for axis in range(2):
            r = c + axis * g.slots
            for side in range(2):
                place = c + (2 * axis + side) * g.slots
                mesh.traction[place] = scalar(0.0)
                mesh.growth[place] = scalar(0.0)
                if mesh.kind[r] == LIQUID:
                    mesh.slip[place] = mesh.velocity[r]
                    a = i + (2 * side - 1) * axis
                    b = k + (2 * side - 1) * (1 - axis)
                    o = f.at(g, a, b)
                    if mesh.kind[o + axis * g.slots] == INSIDE:
                        wall = mesh.solid[o]
                        if wall == OPEN:
                            wall = mesh.solid[f.at(g, a - 1 + axis, b - axis)]
                        if walls.slip_viscosity[wall] >= scalar(0.0):
                            still = walls.velocity[wall][axis]
                            relative = mesh.velocity[r] - still
                            way = wp.where(relative < scalar(0.0), scalar(-1.0), scalar(1.0))
                            # A wall to the left or below slows what goes along it by a shear of the same sign.
                            turn = way * wp.where(side == 0, scalar(1.0), scalar(-1.0))
                            width = wp.where(axis == 0, g.dz, g.dx)
                            ring = scalar(1.0)
                            if wp.static(axial):
                                if axis == 1:
                                    # More of a ring's area lies on its outer side.
                                    outer = wp.where(side == 1, scalar(1.0), scalar(-1.0))
                                    radius = f.side_weight(g, i + side)
                                    ring -= outer * width / (scalar(6.0) * radius - outer * scalar(3.0) * width)
                            ci = i + (1 - side) * axis
                            ck = k + (1 - side) * (1 - axis)
                            inner = wp.max(turn * mesh.stress[f.at(g, ci, ck)], scalar(0.0))
                            stress, growth, slip = law.at_wall(
                                g, wp.abs(relative), inner, width, ring, walls.slip_viscosity[wall],
                                walls.slip_yield[wall],
                            )  # fmt: skip
                            mesh.traction[place] = way * stress
                            mesh.growth[place] = growth
                            mesh.slip[place] = still + way * slip
                            mesh.stress[f.at(g, i + side * axis, k + side * (1 - axis))] = turn * stress

    return wall_stress


@functools.cache
def momentum_kernel(scalar, serial: bool, axial: bool, periodic: bool):
    """Forces on the faces at the known velocities, and rows of the matrix of their implicit change."""
    Cells = cells_struct(scalar)
    Mesh = grid_structs(scalar).Mesh
    solves = array_structs(scalar, 2)
    Matrix, Solve = solves.Matrix, solves.NumberSolve
    f = grid_functions(scalar, axial, periodic)
    entry = row_place(serial)

    @wp.func
    def put(
        mesh: Mesh, matrix: Matrix, rows: wp.int32, r: wp.int32, count: wp.int32, near: wp.int32, c: scalar
    ) -> wp.int32:
        """One more neighbour in a row, if it is unknown; entries that there are then."""
        if mesh.kind[near] != LIQUID:
            return count
        place = entry(r, count, rows, matrix.near_capacity)
        matrix.near[place] = near
        matrix.coefficient[place] = c
        return count + 1

    @wp.kernel(enable_backward=False, module="unique")
    def momentum(g: Cells, flags: wp.array(dtype=wp.int32), mesh: Mesh, matrix: Matrix, viscous: Solve):
        if flags[HALTED] != 0:
            return
        c = wp.tid()
        i, k = f.column(g, c), f.row(g, c)
        rows = 2 * g.slots
        if f.on_grid(g, i, k):
            corner_rate, corner_volume = f.shear(g, mesh, i, k)
            if corner_volume > scalar(0.0):
                # Half the way: what takes this stress into account is of the next step, and would swing.
                mesh.stress[c] = scalar(0.5) * (mesh.stress[c] + corner_rate * mesh.in_corner[c])
        for axis in range(2):
            r = c + axis * g.slots
            count = wp.int32(0)
            diagonal = scalar(0.0)
            force = scalar(0.0)
            unknown = f.on_grid(g, i, k) and mesh.kind[r] == LIQUID
            if unknown:
                volume = mesh.volume[r]
                mesh.start[r] = mesh.velocity[r]
                low = f.at(g, i - 1 + axis, k - axis)
                diagonal = g.density * volume / g.dt
                force = f.face_area(g, i, axis) * (mesh.pressure[low] - mesh.pressure[c])
                if axis == 1:
                    force -= volume * g.density * g.gravity
                    if wp.static(periodic):
                        force += volume * scalar(mesh.drive[FORCE])
                along = wp.where(axis == 0, g.dx, g.dz)
                across = wp.where(axis == 0, g.dz, g.dx)
                for side in range(2):
                    way = wp.where(side == 0, scalar(1.0), scalar(-1.0))
                    step = 2 * side - 1
                    # Stretch of the cell on this side.
                    a = i - (1 - side) * (1 - axis)
                    b = k - (1 - side) * axis
                    o = f.at(g, a, b)
                    if mesh.liquid[o] != 0:
                        both = scalar(2.0) * mesh.fill[o] * f.cell_volume(g, a) * mesh.in_cell[o]
                        rates = f.stretch(g, mesh, a, b)
                        force -= both * way * rates[axis] / along
                        own = both / (along * along)
                        other = own
                        if wp.static(axial):
                            if axis == 0:
                                half = scalar(0.5) / f.cell_weight(g, a)
                                force -= both * rates[2] * half
                                own += both * half * half
                                other -= both * half * half
                        diagonal += own
                        next = f.at(g, i + step * (1 - axis), k + step * axis) + axis * g.slots
                        count = put(mesh, matrix, rows, r, count, next, other)
                    # Shear of the corner at this end.
                    a = i + side * axis
                    b = k + side * (1 - axis)
                    rate, wet = f.shear(g, mesh, a, b)
                    if wet > scalar(0.0):
                        both = wet * mesh.in_corner[f.at(g, a, b)]
                        force -= both * way * rate / across
                        own = both / (across * across)
                        diagonal += own
                        next = f.at(g, i + step * axis, k + step * (1 - axis)) + axis * g.slots
                        count = put(mesh, matrix, rows, r, count, next, own)
                        cross = way * both / (g.dx * g.dz)
                        other_axis = (1 - axis) * g.slots
                        count = put(mesh, matrix, rows, r, count, f.at(g, a, b) + other_axis, -cross)
                        next = f.at(g, a - (1 - axis), b - axis) + other_axis
                        count = put(mesh, matrix, rows, r, count, next, cross)
                    # The wall along this end.
                    place = c + (2 * axis + side) * g.slots
                    if mesh.growth[place] > scalar(0.0):
                        area = scalar(0.5) * (mesh.fill[low] + mesh.fill[c]) * along * f.side_weight(g, a)
                        force -= area * mesh.traction[place]
                        diagonal += area * mesh.growth[place]
            matrix.free[r] = wp.where(unknown, 0, 1)
            matrix.near_count[r] = count
            matrix.diagonal[r] = diagonal
            viscous.residual[r] = force

    return momentum
