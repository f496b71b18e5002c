"""Projection of a grid's velocities onto a divergence-free field, and the force that drives a periodic pipe."""

import functools
from types import SimpleNamespace

import warp as wp

from ...common.control import HALTED
from ...common.reductions import keep, total
from ..structs import mps_types, row_place
from .cells import (
    CELLS_PER_SECOND,
    DT,
    FORCE,
    LAST,
    LAST_FORCE,
    LIQUID,
    OPEN,
    ROUGH,
    VELOCITY_CORRECTION,
    GridKind,
    grid_parameters_struct,
    grid_structs,
    item,
)
from .levels import system_structs
from .places import grid_functions

CORRECTED, CORRECTED_MOVING = 0.1, 0.5
"""Fraction of a cell's excess or lack of particles that one step corrects. The first value holds for concrete at rest,
the second for concrete that moves by a cell per step. Particles crowd together as they move, most of all at the
surface. If both values were 0.1, an L-box would lose 1.5 % of its volume instead of 0.8 %, and a funnel 4 % instead of
1.2 %. If both were 0.3, the corrections would keep concrete moving that should come to rest."""
CARRIED = 0.8
"""Largest fraction of a cell's last pressure change that is added to its next change, in flows with a free surface."""
STIFF = 5.0
"""Viscous number of a cell, eta dt / (rho h^2), at which half of `CARRIED` is used. The viscosity eta is the apparent
one, and h is the width of the cell. With STIFF = 30, the addition would have only half as much effect in a spreading
heap."""


@functools.cache
def pressure_kernels(scalar, serial: bool, of: GridKind) -> SimpleNamespace:
    """Build the kernels `divergence`, which sets up the pressure solve, and `project`, which applies its solution.

    Both kernels run with one task per cell. In flows with a free surface, `project` stores the pressure change of each
    cell. The next step adds a part of it to its own change (see `carried`), so that the pressure follows the moving
    surface with less lag. The rise of the pressure in a cell that concrete has just reached is not stored, because such
    a rise is no trend.
    """
    dims = of.dimensions
    Grid = grid_parameters_struct(scalar, dims)
    structs = grid_structs(scalar, dims)
    Fields, Geometry, Walls = structs.Fields, structs.Geometry, structs.Walls
    systems = system_structs(scalar)
    Matrix, Solve = systems.Matrix, systems.Solve
    f = grid_functions(scalar, of)
    entry = row_place(serial)

    @wp.func
    def carried(g: Grid, mesh: Fields, number: wp.int32) -> scalar:
        """Return the part of a cell's last pressure change that is added to its pressure change in this step [Pa].

        In concrete of the apparent viscosity eta, an increment corrects only about 1 / (1 + eta dt k^2 / rho) of an
        error of the pressure with the wave number k. The pressure then lags behind the surface of the concrete, which
        flows on under the pressure of an earlier and higher surface, and the lag grows with the time step. Iterations
        of this kind converge faster if a part of the last change is repeated (heavy-ball method, Polyak 1964). With
        the same part in all cells, the method is stable for every part below 1, because an increment corrects at most
        the whole error. In concrete of low viscosity an increment is almost exact, and a repetition would only make the
        pressure oscillate.
        """
        if mesh.pressure[number] == scalar(0.0):
            # Concrete has just reached this cell, so its last pressure change is not known.
            return scalar(0.0)
        viscous_number = mesh.in_cell[number] * scalar(mesh.clock[DT]) / (g.density * g.width[0] * g.width[0])
        part = scalar(CARRIED) * viscous_number / (viscous_number + scalar(STIFF))
        if mesh.clock[DT] < mesh.clock[LAST]:
            # Pressures change less in a shorter step, so repeat a smaller part.
            part *= scalar(mesh.clock[DT] / mesh.clock[LAST])
        return part * mesh.pressure_change[number]

    @wp.kernel(enable_backward=False, module="unique")
    def divergence(
        g: Grid, flags: wp.array(dtype=wp.int32), geometry: Geometry, walls: Walls, mesh: Fields, matrix: Matrix,
        projection: Solve, worker: wp.int32, workers: wp.int32,
    ):  # fmt: skip
        """Compute the net volume flow into each cell, and the cell's row of the matrix for the pressure increment."""
        if flags[HALTED] != 0:
            return
        number = item(wp.tid(), worker, workers)
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
                        # A moving wall displaces concrete with its velocity through the part of this face that it
                        # closes. If the nearest wall stands still, the part belongs to the first moving wall.
                        if geometry.swept.shape[0] > 0:
                            wall = wp.max(geometry.surface[r], ROUGH + 1)
                            x = f.face_middle(g, face, axis)
                            flux += f.face_area(g, face, axis) * geometry.swept[r] * f.wall_speed(walls, wall, x, axis)
                    into += wp.where(side == 0, flux, -flux)
                    if mesh.kind[r] == LIQUID:
                        ease = area * area / mesh.volume[r]
                        diagonal += ease
                        next = f.at(g, f.moved(c, axis, 2 * side - 1))
                        if mesh.liquid[next] != 0:
                            place = entry(number, count, matrix.rows, matrix.near_capacity)
                            matrix.near[place] = next
                            matrix.coefficient[place] = ease
                            count += 1
        matrix.free[number] = 1 - liquid
        matrix.near_count[number] = count
        matrix.diagonal[number] = diagonal
        projection.residual[number] = g.density / scalar(mesh.clock[DT]) * into

    @wp.kernel(enable_backward=False, module="unique")
    def project(
        g: Grid, flags: wp.array(dtype=wp.int32), geometry: Geometry, mesh: Fields, worker: wp.int32, workers: wp.int32
    ):
        """Subtract the gradient of the pressure increment from the velocities, and update the pressure."""
        if flags[HALTED] != 0:
            return
        number = item(wp.tid(), worker, workers)
        c = f.cell(g, number)
        if not f.on_grid(g, c):
            return
        for axis in range(dims):
            r = number + axis * g.slots
            kind = mesh.kind[r]
            # The shear stress of the walls was computed for the velocity before the viscous solve. Update it, with its
            # derivative, to the velocity after this solve.
            if wp.static(not of.cut) and kind == LIQUID:
                mesh.traction[r] = mesh.traction[r] + mesh.traction_slope[r] * (mesh.velocity[r] - mesh.start[r])
            if kind == LIQUID:
                rise = mesh.increment[number] - mesh.increment[f.at(g, f.moved(c, axis, -1))]
                ease = scalar(mesh.clock[DT]) / g.density * f.open_area(g, geometry, c, axis) / mesh.volume[r]
                mesh.velocity[r] = mesh.velocity[r] - ease * rise
        change = mesh.increment[number]
        if mesh.pressure_change.shape[0] > 0:
            change += carried(g, mesh, number)
            # When concrete reaches a cell, the pressure rises from 0. Do not store this change, because it will not
            # repeat itself.
            is_trend = mesh.liquid[number] != 0 and mesh.pressure[number] != scalar(0.0)
            mesh.pressure_change[number] = wp.where(is_trend, change, scalar(0.0))
        mesh.pressure[number] = wp.where(mesh.liquid[number] != 0, mesh.pressure[number] + change, scalar(0.0))

    return SimpleNamespace(divergence=divergence, project=project)


@functools.cache
def crowd_kernels(scalar, of: GridKind) -> SimpleNamespace:
    """Build the kernels `source` and `disperse`, which correct the density of particles.

    Particles slowly accumulate in some places and become sparse in others, because divergence-free velocities in the
    cells do not prevent it. In each step a fraction of the excess or lack is corrected by displacements that do not
    change velocities. The displacements follow from a solve with the matrix of the pressure. `source` sets up this
    solve, and `disperse` applies its solution. Each kernel runs with one task per cell.
    """
    dims = of.dimensions
    Grid = grid_parameters_struct(scalar, dims)
    structs = grid_structs(scalar, dims)
    Fields, Geometry = structs.Fields, structs.Geometry
    Solve = system_structs(scalar).Solve
    f = grid_functions(scalar, of)
    whole = mps_types(scalar, dims).whole

    @wp.func
    def missing(g: Grid, mesh: Fields, c: whole) -> scalar:
        """Return the lack of particle density at a cell's centre due to unfilled parts of the cell and its neighbours.

        Particle densities are divided by the density in full cells. Concrete is assumed to be spread evenly within each
        cell.
        """
        sum = scalar(0.0)
        for n in range(wp.static(3**dims)):
            o = whole()
            rest = n
            part = scalar(1.0)
            for b in range(dims):
                by = rest % 3 - 1
                rest = rest / 3
                o[b] = c[b] + by
                # The density at the cell's centre is a sum over particles, with a weight that falls linearly to zero at
                # a distance of one cell. Along each axis, 3/4 of the weight's integral lie in the cell itself and 1/8
                # in each of the two neighbouring cells.
                part *= wp.where(by == 0, scalar(0.75), scalar(0.125))
            near = f.at(g, o)
            if mesh.solid[near] == OPEN:
                sum += part * (scalar(1.0) - mesh.fill[near])
        return sum

    @wp.kernel(enable_backward=False, module="unique")
    def source(
        g: Grid, flags: wp.array(dtype=wp.int32), geometry: Geometry, mesh: Fields, projection: Solve,
        worker: wp.int32, workers: wp.int32,
    ):  # fmt: skip
        if flags[HALTED] != 0:
            return
        number = item(wp.tid(), worker, workers)
        c = f.cell(g, number)
        mesh.potential[number] = scalar(0.0)
        excess = scalar(0.0)
        dt = scalar(mesh.clock[DT])
        if mesh.liquid[number] != 0:
            excess = mesh.particle_density[number] - scalar(1.0)
            if excess < scalar(0.0):
                # Near a free surface the particle density is below 1 because some cells are partly filled. Only a lack
                # of particles that exceeds this expected lack is corrected.
                excess = wp.where(mesh.fill[number] < scalar(1.0), scalar(0.0), excess + missing(g, mesh, c))
                excess = wp.min(excess, scalar(0.0))
            excess = wp.clamp(excess, scalar(-0.1), scalar(0.1))
            way = scalar(wp.min(mesh.clock[CELLS_PER_SECOND] * mesh.clock[DT], wp.float64(1.0)))
            part = scalar(CORRECTED) + scalar(wp.static(CORRECTED_MOVING - CORRECTED)) * way
            excess *= part * geometry.room[number] * f.cell_volume(g, c) / dt
        projection.residual[number] = g.density / dt * excess

    @wp.kernel(enable_backward=False, module="unique")
    def disperse(
        g: Grid, flags: wp.array(dtype=wp.int32), geometry: Geometry, mesh: Fields, worker: wp.int32, workers: wp.int32
    ):
        if flags[HALTED] != 0:
            return
        number = item(wp.tid(), worker, workers)
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
    """Build the kernels that keep the mean velocity along a periodic pipe constant.

    `deficit` computes the prescribed minus the current mean velocity; on a GPU, `sums` and `deficit_of_sums` do this.
    `correct` adds this difference to the velocity of all faces, which is equivalent to a uniform force. This force and
    the resulting increase of wall friction are added to the driving force of the next step.
    """
    Grid = grid_parameters_struct(scalar, dimensions)
    Fields = grid_structs(scalar, dimensions).Fields

    @wp.func
    def record_deficit(g: Grid, clock: wp.array(dtype=wp.float64), drive: wp.array(dtype=wp.float64), mean: wp.float64):
        lacks = wp.float64(g.frame) - mean
        inertia = wp.float64(g.density) / clock[DT]
        drive[LAST_FORCE] = drive[FORCE] + inertia * lacks
        drive[FORCE] = drive[FORCE] + (inertia + g.resistance) * lacks
        drive[VELOCITY_CORRECTION] = lacks

    @wp.kernel(enable_backward=False, module="unique")
    def deficit(g: Grid, flags: wp.array(dtype=wp.int32), mesh: Fields):
        """Compute by how much the mean velocity along the pipe is too small, and the new driving force, in one task."""
        if flags[HALTED] != 0:
            return
        sum = wp.float64(0.0)
        whole = wp.float64(0.0)
        for r in range((dimensions - 1) * g.slots, dimensions * g.slots):
            if mesh.kind[r] == LIQUID:
                sum += wp.float64(mesh.volume[r]) * wp.float64(mesh.velocity[r])
                whole += wp.float64(mesh.volume[r])
        record_deficit(g, mesh.clock, mesh.drive, sum / whole)

    @wp.kernel(enable_backward=False, module="unique")
    def sums(g: Grid, blocks: wp.int32, mesh: Fields, partial: wp.array(dtype=wp.float64)):
        """Compute partial sums of the concrete's volume and of its flow along the pipe, with one thread per face.

        The kernel runs in whole blocks.
        """
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
    def deficit_of_sums(
        g: Grid, blocks: wp.int32, flags: wp.array(dtype=wp.int32), partial: wp.array(dtype=wp.float64), mesh: Fields
    ):
        """Compute the deficit of the mean velocity, and the new driving force.

        The deficit is the wanted minus the present mean velocity. The present mean velocity follows from the partial
        sums of all blocks. The kernel runs in one block.
        """
        c = wp.tid()
        sum = total(c, partial, 0, blocks)
        whole = total(c, partial, blocks, blocks)
        if c == 0 and flags[HALTED] == 0:
            record_deficit(g, mesh.clock, mesh.drive, sum / whole)

    @wp.kernel(enable_backward=False, module="unique")
    def correct(g: Grid, flags: wp.array(dtype=wp.int32), mesh: Fields):
        """Add the deficit of the mean velocity to the velocity of all faces along the pipe, with one task per cell."""
        if flags[HALTED] != 0:
            return
        r = wp.tid() + (dimensions - 1) * g.slots
        if mesh.kind[r] == LIQUID:
            mesh.velocity[r] = mesh.velocity[r] + scalar(mesh.drive[VELOCITY_CORRECTION])

    return SimpleNamespace(deficit=deficit, sums=sums, deficit_of_sums=deficit_of_sums, correct=correct)
