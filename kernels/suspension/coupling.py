"""Kernels for the coupled equations of mortar velocities, rigid aggregates and pressure.

The unknowns of a time step are the changes of the face velocities u, of the velocities and spins U of the aggregates,
and of the cell pressures p. A is the viscous matrix of all faces. P maps U to the velocities of the faces that move
with aggregates, and keeps the velocities of all others. G p are the pressure forces on the faces, and D u is the net
inflow into the cells. The equations are

    P^T (A u - G p) + E U = P^T F + L,    D u = -inflow at the start,

where F are the forces on faces at the start of the step, L are the weight and contact forces of the aggregates, and E
is the inertia of the aggregates minus the inertia of an equal volume of mortar, divided by the time step. Faces that
move with an aggregate have no equations of their own.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.control import HALTED
from ..common.types import cpu_flags
from ..mps.grid.cells import DT, LIQUID, GridKind, grid_parameters_struct, grid_structs
from ..mps.grid.levels import system_structs
from ..mps.grid.places import grid_functions
from ..mps.structs import row_place
from .bodies import FULL, body_structs
from .vectors import range_functions, share_functions, share_of_body, store_function, vector_struct

COMPRESSION = wp.constant(1.0)
"""Factor of the viscosity in the weight of a cell's net inflow.

The norm of the residual contains forces and net inflows, and the weight makes an inflow comparable with a force. The
weight is (density width^2 / dt + COMPRESSION viscosity) / volume.
"""
YIELDING = wp.constant(0.4)
"""Factor in the preconditioner. It computes the pressure in a cell as a sum of two parts, one of which depends only on
the net inflow into this cell. This part is the inflow times YIELDING / (D a^-1 D^T), where D maps face velocities to
net inflows and a is the diagonal of the viscous matrix. The factor was chosen by the number of iterations in eight
flows."""

BODY_RESISTANCE = wp.constant(0.5)
"""Factor by which the mean resistance of an aggregate's faces is multiplied in the matrix of the preconditioner's
pressure solve.

With factors from 0.2 to 1, the coupled solve needs the same number of iterations."""


@functools.cache
def residual_kernels(scalar, serial: bool, of: GridKind) -> SimpleNamespace:
    """Build the kernels that compute residuals.

    - `start` sets the residual from the forces and inflows at the start of the step. It also sets `inverse`, the
      inverse diagonal of the viscous matrix, which is 0 for faces whose velocities are not unknowns.
    - `pressure_force` computes the forces of a pressure field on the faces.
    - `inflow` computes the net inflow into the cells that a change of the velocities causes.
    """
    Grid = grid_parameters_struct(scalar, 3)
    structs = body_structs(scalar)
    Bodies, Cover = structs.Bodies, structs.Cover
    fields = grid_structs(scalar, 3)
    Fields, Geometry = fields.Fields, fields.Geometry
    systems = system_structs(scalar)
    Matrix, Solve = systems.Matrix, systems.Solve
    Vector = vector_struct(scalar)
    f = grid_functions(scalar, of)
    own = share_functions(serial)

    @wp.kernel(enable_backward=False, module="unique")
    def start(
        g: Grid, tasks: wp.int32, bodies: Bodies, cover: Cover, matrix: Matrix, viscous: Solve, projection: Solve,
        mesh: Fields, inflow: wp.array(dtype=scalar), again: wp.int32, residual: Vector,
        inverse: wp.array(dtype=scalar),
    ):  # fmt: skip
        task = wp.tid()
        if task < tasks:
            rows = 3 * g.slots
            for r in range(own.first(task, tasks, rows), own.end(task, tasks, rows), own.stride(tasks)):
                residual.faces[r] = wp.where(matrix.free[r] == 0, viscous.residual[r], scalar(0.0))
                value = scalar(0.0)
                if matrix.free[r] == 0 and cover.owner[r] == 0:
                    value = scalar(1.0) / matrix.diagonal[r]
                inverse[r] = value
            for c in range(own.first(task, tasks, g.slots), own.end(task, tasks, g.slots), own.stride(tasks)):
                if again == 0:
                    # Keep a copy of the inflow for a repeated solve of the step, because pressure solves overwrite
                    # `projection.residual`.
                    inflow[c] = projection.residual[c] * scalar(mesh.clock[DT]) / g.density
                residual.cells[c] = residual.cells[c] + inflow[c]
        else:
            b, lane = share_of_body(task, tasks)
            if b < bodies.centre.shape[0] and lane == 0:
                residual.linear[b] = bodies.force[b]
                residual.angular[b] = bodies.torque[b]

    @wp.kernel(enable_backward=False, module="unique")
    def pressure_force(g: Grid, geometry: Geometry, mesh: Fields, pressure: wp.array(dtype=scalar),
                       forces: wp.array(dtype=scalar)):  # fmt: skip
        number = wp.tid()
        c = f.cell(g, number)
        for axis in range(3):
            r = number + axis * g.slots
            force = scalar(0.0)
            if mesh.kind[r] == LIQUID and f.on_grid(g, c):
                low = f.at(g, f.moved(c, axis, -1))
                force = f.open_area(g, geometry, c, axis) * (pressure[low] - pressure[number])
            forces[r] = force

    @wp.kernel(enable_backward=False, module="unique")
    def inflow(g: Grid, geometry: Geometry, mesh: Fields, change: wp.array(dtype=scalar), sign: scalar,
               result: wp.array(dtype=scalar)):  # fmt: skip
        number = wp.tid()
        c = f.cell(g, number)
        into = scalar(0.0)
        if mesh.liquid[number] != 0:
            for axis in range(3):
                for side in range(2):
                    face = f.moved(c, axis, side)
                    r = f.at(g, face) + axis * g.slots
                    if mesh.kind[r] == LIQUID:
                        flux = f.open_area(g, geometry, face, axis) * change[r]
                        into += wp.where(side == 0, flux, -flux)
        result[number] = sign * into

    return SimpleNamespace(start=start, pressure_force=pressure_force, inflow=inflow)


@functools.cache
def pressure_kernels(scalar, serial: bool, of: GridKind) -> SimpleNamespace:
    """Build the kernels of the pressure in the preconditioner, with one task per cell.

    - `resist` sets the matrix of the preconditioner's pressure solve.
    - `request` sets the right-hand side of this solve, so that its solution removes the net inflow of the residual.
    - `press` computes the pressure of the preconditioner, which is the solution of that pressure solve plus a multiple
      of the net inflow (Cahouet & Chabard 1988).
    """
    Grid = grid_parameters_struct(scalar, 3)
    Bodies, Cover = body_structs(scalar).Bodies, body_structs(scalar).Cover
    fields, systems = grid_structs(scalar, 3), system_structs(scalar)
    Fields, Geometry = fields.Fields, fields.Geometry
    Matrix, Solve, Vector = systems.Matrix, systems.Solve, vector_struct(scalar)
    f, entry = grid_functions(scalar, of), row_place(serial)

    @wp.kernel(enable_backward=False, module="unique")
    def resist(
        g: Grid, flags: wp.array(dtype=wp.int32), geometry: Geometry, mesh: Fields, cover: Cover, matrix: Matrix,
        pressures: Matrix, drag: scalar, bodies: Bodies, yielding: wp.array(dtype=scalar),
    ):  # fmt: skip
        """Set a cell's row of the matrix `pressures` of the pressure solve, and its entry of `yielding`.

        A pressure gradient that changes slowly in space accelerates mortar, and drives it past aggregates and walls.
        The resistance of a face to this motion is its inertia plus a part of its viscous resistance. The viscous
        resistance is the diagonal of the viscous matrix without inertia, and the fraction `drag` of it is included.
        Inside an aggregate the viscous resistance is 0, so a face that moves with an aggregate has BODY_RESISTANCE
        times the mean resistance of the aggregate's faces instead. With zero resistances, the matrix would be so
        ill-conditioned in long time steps that a pressure solve would need a hundred iterations.

        `yielding` is YIELDING times the pressure per net inflow if the velocities of all other faces are fixed. It is 0
        if all faces of the cell move with aggregates, because the cell's pressure then has no effect.
        """
        if flags[HALTED] != 0:
            return
        number = wp.tid()
        c = f.cell(g, number)
        diagonal = scalar(0.0)
        compliance = scalar(0.0)
        count = wp.int32(0)
        if mesh.liquid[number] != 0:
            for axis in range(3):
                for side in range(2):
                    face = f.moved(c, axis, side)
                    r = f.at(g, face) + axis * g.slots
                    if mesh.kind[r] == LIQUID:
                        area = f.open_area(g, geometry, face, axis)
                        inertia = g.density * mesh.volume[r] / scalar(mesh.clock[DT])
                        viscous = wp.max(matrix.diagonal[r] - inertia, scalar(0.0))
                        if cover.owner[r] != 0:
                            viscous = scalar(BODY_RESISTANCE) * bodies.resistance[cover.owner[r] - 1]
                        ease = area * area / (mesh.volume[r] * (scalar(1.0) + drag * viscous / inertia))
                        diagonal += ease
                        next = f.at(g, f.moved(c, axis, 2 * side - 1))
                        if mesh.liquid[next] != 0:
                            place = entry(number, count, pressures.rows, pressures.near_capacity)
                            pressures.near[place] = next
                            pressures.coefficient[place] = ease
                            count += 1
                        if cover.owner[r] == 0:
                            if cover.claims[r] == 0 and cover.touches[r] == 1:
                                area *= scalar(1.0) - scalar(cover.covered[r]) / scalar(FULL)
                            compliance += area * area / matrix.diagonal[r]
        pressures.near_count[number] = count
        pressures.diagonal[number] = diagonal
        yielding[number] = wp.where(compliance > scalar(0.0), scalar(YIELDING) / compliance, scalar(0.0))

    @wp.kernel(enable_backward=False, module="unique")
    def request(g: Grid, mesh: Fields, inflow: Vector, projection: Solve):
        """Set the right-hand side of a pressure solve from the net inflow into the cells."""
        number = wp.tid()
        mesh.increment[number] = scalar(0.0)
        projection.residual[number] = g.density / scalar(mesh.clock[DT]) * inflow.cells[number]

    @wp.kernel(enable_backward=False, module="unique")
    def press(
        mesh: Fields, residual: Vector, solved: wp.array(dtype=scalar), yielding: wp.array(dtype=scalar), result: Vector
    ):
        number = wp.tid()
        value = scalar(0.0)
        if mesh.liquid[number] != 0:
            value = solved[number] + yielding[number] * residual.cells[number]
        result.cells[number] = value

    return SimpleNamespace(resist=resist, request=request, press=press)


@functools.cache
def cell_weight_function(scalar, of: GridKind):
    """Build the function that returns the weight of a cell's net inflow in inner products."""
    Grid, Fields = grid_parameters_struct(scalar, 3), grid_structs(scalar, 3).Fields
    f = grid_functions(scalar, of)

    @wp.func
    def cell_weight(g: Grid, mesh: Fields, cut: Fields, c: wp.int32) -> scalar:
        """Return the weight of a cell's net inflow in inner products.

        The weight is approximately the pressure that removes a unit of inflow [Pa s/m3].
        """
        inertia = g.density * g.width[0] * g.width[0] / scalar(cut.clock[DT])
        return wp.where(mesh.liquid[c] != 0, (inertia + scalar(COMPRESSION) * cut.in_cell[c]) / f.block(g), scalar(0.0))

    return cell_weight


@functools.cache
def product_kernels(scalar, serial: bool, of: GridKind) -> SimpleNamespace:
    """Build the kernels that make search directions orthogonal to each other.

    They run with `tasks` tasks for faces and cells, and with further tasks for the aggregates, which
    :func:`share_of_body` distributes. `many` holds `count` vectors one after the other.

    - `weigh` multiplies each entry of a vector by the weight of this entry in inner products.
    - `products` computes partial sums of the inner products of a weighted vector and each vector of `many`. Each inner
      product has `partials` partial sums; those of inner product k begin at index k * `partials`.
    - `combine` subtracts a multiple of each vector of `many` from a vector.
    """
    Grid = grid_parameters_struct(scalar, 3)
    Bodies, Fields = body_structs(scalar).Bodies, grid_structs(scalar, 3).Fields
    Vector, cell_weight = vector_struct(scalar), cell_weight_function(scalar, of)
    own, ranges, store = share_functions(serial), range_functions(scalar, serial), store_function(serial)

    @wp.kernel(enable_backward=False, module="unique", module_options={"cpu_compiler_flags": cpu_flags()})
    def weigh(
        g: Grid, tasks: wp.int32, bodies: Bodies, inverse: wp.array(dtype=scalar), mesh: Fields, cut: Fields,
        one: Vector, weighted: Vector,
    ):  # fmt: skip
        task = wp.tid()
        if task < tasks:
            rows = 3 * g.slots
            for r in range(own.first(task, tasks, rows), own.end(task, tasks, rows), own.stride(tasks)):
                weighted.faces[r] = inverse[r] * one.faces[r]
            for c in range(own.first(task, tasks, g.slots), own.end(task, tasks, g.slots), own.stride(tasks)):
                weighted.cells[c] = one.cells[c] * cell_weight(g, mesh, cut, c)
        else:
            b, lane = share_of_body(task, tasks)
            if b < bodies.centre.shape[0] and lane == 0:
                weighted.linear[b] = bodies.mobility[b] * one.linear[b]
                weighted.angular[b] = bodies.spin_mobility[b] * one.angular[b]

    @wp.kernel(enable_backward=False, module="unique", module_options={"cpu_compiler_flags": cpu_flags()})
    def products(
        g: Grid, tasks: wp.int32, partials: wp.int32, bodies: Bodies, count: wp.int32, slot: wp.int32,
        weighted: Vector, many: Vector, partial: wp.array(dtype=wp.float64),
    ):  # fmt: skip
        task = wp.tid()
        rows = 3 * g.slots
        aggregates = bodies.centre.shape[0]
        for k in range(count):
            sum = wp.float64(0.0)
            if task < tasks:
                sum = ranges.dot(
                    weighted.faces, many.faces, k * rows, own.first(task, tasks, rows), own.end(task, tasks, rows),
                    tasks,
                ) + ranges.dot(
                    weighted.cells, many.cells, k * g.slots, own.first(task, tasks, g.slots),
                    own.end(task, tasks, g.slots), tasks,
                )  # fmt: skip
            else:
                b, lane = share_of_body(task, tasks)
                if b < aggregates and lane == 0:
                    sum = wp.float64(wp.dot(weighted.linear[b], many.linear[k * aggregates + b])) + wp.float64(
                        wp.dot(weighted.angular[b], many.angular[k * aggregates + b])
                    )
            store(task, partial, (slot + k) * partials, sum)

    @wp.kernel(enable_backward=False, module="unique", module_options={"cpu_compiler_flags": cpu_flags()})
    def combine(
        g: Grid, tasks: wp.int32, bodies: Bodies, count: wp.int32, factors: wp.array(dtype=wp.float64), many: Vector,
        result: Vector,
    ):  # fmt: skip
        task = wp.tid()
        rows = 3 * g.slots
        aggregates = bodies.centre.shape[0]
        for k in range(count):
            factor = -scalar(factors[k])
            if task < tasks:
                ranges.add(
                    factor, many.faces, k * rows, result.faces, own.first(task, tasks, rows),
                    own.end(task, tasks, rows), tasks,
                )  # fmt: skip
                ranges.add(
                    factor, many.cells, k * g.slots, result.cells, own.first(task, tasks, g.slots),
                    own.end(task, tasks, g.slots), tasks,
                )  # fmt: skip
            else:
                b, lane = share_of_body(task, tasks)
                if b < aggregates and lane == 0:
                    result.linear[b] = result.linear[b] + factor * many.linear[k * aggregates + b]
                    result.angular[b] = result.angular[b] + factor * many.angular[k * aggregates + b]

    return SimpleNamespace(weigh=weigh, products=products, combine=combine)


@functools.cache
def advance_kernels(scalar, serial: bool, of: GridKind) -> SimpleNamespace:
    """Build the kernels that change the solution.

    They run with `tasks` tasks for faces and cells, and with further tasks for the aggregates, which
    :func:`share_of_body` distributes.

    - `advance` adds a search direction times `factor` to the solution, and subtracts the product of matrix and
      direction (`effect`) times `factor` from the residual. It then computes the squared norm of the residual, and the
      squared norm of the flow's momentum, with which the residual is compared. Each norm is stored as `partials`
      partial sums.
    - `finish` adds the solution to the velocities and pressures of the flow.
    """
    Grid = grid_parameters_struct(scalar, 3)
    Bodies, Fields = body_structs(scalar).Bodies, grid_structs(scalar, 3).Fields
    Matrix, Vector = system_structs(scalar).Matrix, vector_struct(scalar)
    own, store, cell_weight = share_functions(serial), store_function(serial), cell_weight_function(scalar, of)

    @wp.kernel(enable_backward=False, module="unique", module_options={"cpu_compiler_flags": cpu_flags()})
    def advance(
        g: Grid, tasks: wp.int32, partials: wp.int32, bodies: Bodies, inverse: wp.array(dtype=scalar), matrix: Matrix,
        mesh: Fields, cut: Fields, factor: scalar, change: Vector, effect: Vector, solution: Vector, residual: Vector,
        partial: wp.array(dtype=wp.float64),
    ):  # fmt: skip
        task = wp.tid()
        left = wp.float64(0.0)
        whole = wp.float64(0.0)
        if task < tasks:
            rows = 3 * g.slots
            for r in range(own.first(task, tasks, rows), own.end(task, tasks, rows), own.stride(tasks)):
                if matrix.free[r] == 0:
                    x = solution.faces[r] + factor * change.faces[r]
                    solution.faces[r] = x
                    u = mesh.velocity[r] + x
                    whole += wp.float64(matrix.diagonal[r] * u * u)
                    rest = residual.faces[r] - factor * effect.faces[r]
                    residual.faces[r] = rest
                    left += wp.float64(inverse[r] * rest * rest)
            for c in range(own.first(task, tasks, g.slots), own.end(task, tasks, g.slots), own.stride(tasks)):
                solution.cells[c] = solution.cells[c] + factor * change.cells[c]
                rest = residual.cells[c] - factor * effect.cells[c]
                residual.cells[c] = rest
                left += wp.float64(rest * cell_weight(g, mesh, cut, c) * rest)
        else:
            b, lane = share_of_body(task, tasks)
            if b < bodies.centre.shape[0] and lane == 0:
                solution.linear[b] = solution.linear[b] + factor * change.linear[b]
                solution.angular[b] = solution.angular[b] + factor * change.angular[b]
                force = residual.linear[b] - factor * effect.linear[b]
                torque = residual.angular[b] - factor * effect.angular[b]
                residual.linear[b] = force
                residual.angular[b] = torque
                left = wp.float64(wp.dot(force, bodies.mobility[b] * force))
                left += wp.float64(wp.dot(torque, bodies.spin_mobility[b] * torque))
        store(task, partial, 0, left)
        store(task, partial, partials, whole)

    @wp.kernel(enable_backward=False, module="unique")
    def finish(g: Grid, tasks: wp.int32, matrix: Matrix, solution: Vector, mesh: Fields, bodies: Bodies):
        task = wp.tid()
        if task < tasks:
            rows = 3 * g.slots
            for r in range(own.first(task, tasks, rows), own.end(task, tasks, rows), own.stride(tasks)):
                if matrix.free[r] == 0:
                    mesh.velocity[r] = mesh.velocity[r] + solution.faces[r]
            for c in range(own.first(task, tasks, g.slots), own.end(task, tasks, g.slots), own.stride(tasks)):
                mesh.pressure[c] = wp.where(mesh.liquid[c] != 0, mesh.pressure[c] + solution.cells[c], scalar(0.0))
        else:
            b, lane = share_of_body(task, tasks)
            if b < bodies.centre.shape[0] and lane == 0:
                bodies.velocity[b] = bodies.velocity[b] + solution.linear[b]
                bodies.spin[b] = bodies.spin[b] + solution.angular[b]

    return SimpleNamespace(advance=advance, finish=finish)
