"""Vectors and operators of the coupled equations of mortar velocity, rigid aggregates and pressure.

The unknowns of a time step are the changes of the face velocities u, of the velocities and spins U of the aggregates,
and of the cell pressures p. With the viscous matrix A, the rigid motion P, the pressure forces G and the net inflow D
of the cells, the equations are

    P^T (A u - G p) + E U = P^T F + L,    D u = -inflow at the start,

where F are the forces at the start of the step, L are forces on the aggregates, and E is the inertia that aggregates
have in excess of the mortar in their place. A face of an aggregate has no equation of its own.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.reductions import total
from ..common.rows import entry_product, row_product
from ..common.types import types
from ..mps.grid.cells import DT, LIQUID, GridKind, grid_parameters_struct, grid_structs
from ..mps.grid.levels import system_structs
from ..mps.grid.places import grid_functions
from .bodies import body_functions, body_structs
from .pairs import pair_functions, pair_struct

# Indices of the array of sums of a solve by conjugate gradients.
RZ = wp.constant(0)  # Product of residual and preconditioned residual.
PQ = wp.constant(1)  # Product of the search direction and its product with the matrix.
RZ_AFTER = wp.constant(2)  # Product of residual and preconditioned residual after the step.
RZ_FIRST = wp.constant(3)  # Product of residual and preconditioned residual at the start of the solve.
SUMS = 4
COMPRESSION = wp.constant(1.0)
"""Pressure that a divergence of the velocity causes in a viscous fluid, over viscosity and divergence.

A velocity field that is the gradient of a potential has the viscous force 2 mu times the gradient of its divergence."""


@functools.cache
def vector_struct(scalar):
    """Build the struct `Vector`: values of all unknowns, or of the residuals of all equations."""
    vec3 = types(scalar).vec3

    @wp.struct
    class Vector:
        faces: wp.array(dtype=scalar)  # Values of the faces, shape (3 slots,).
        linear: wp.array(dtype=vec3)  # Velocity of or force on each aggregate, shape (n,).
        angular: wp.array(dtype=vec3)  # Spin of or torque on each aggregate, shape (n,).
        cells: wp.array(dtype=scalar)  # Values of the cells, shape (slots,).

    return Vector


@functools.cache
def share_functions(serial: bool) -> SimpleNamespace:
    """Build functions that divide items among tasks: `first`, `end` and `stride` of the items of one task.

    A CPU task gets a contiguous range of items; the tasks of a GPU take the items in turn.
    """

    @wp.func
    def first(task: wp.int32, tasks: wp.int32, items: wp.int32) -> wp.int32:
        if wp.static(serial):
            return wp.int32(wp.int64(task) * wp.int64(items) / wp.int64(tasks))
        return task

    @wp.func
    def end(task: wp.int32, tasks: wp.int32, items: wp.int32) -> wp.int32:
        if wp.static(serial):
            return wp.int32(wp.int64(task + 1) * wp.int64(items) / wp.int64(tasks))
        return items

    @wp.func
    def stride(tasks: wp.int32) -> wp.int32:
        return wp.where(wp.static(serial), 1, tasks)

    return SimpleNamespace(first=first, end=end, stride=stride)


@functools.cache
def sum_kernel(serial: bool):
    """Build the kernel that adds up partial sums; on a GPU it runs in one block."""

    @wp.kernel(enable_backward=False, module="unique")
    def add_up(count: wp.int32, slot: wp.int32, partial: wp.array(dtype=wp.float64), sums: wp.array(dtype=wp.float64)):
        if wp.static(serial):
            sum = wp.float64(0.0)
            for k in range(count):
                sum += partial[k]
            sums[slot] = sum
        else:
            sum = total(wp.tid(), partial, 0, count)
            if wp.tid() == 0:
                sums[slot] = sum

    return add_up


@functools.cache
def velocity_kernels(scalar, serial: bool, of: GridKind) -> SimpleNamespace:
    """Build the kernels of the conjugate gradients for the reduced viscous matrix P^T A P + E.

    The preconditioner is the diagonal, for aggregates their blocks. Kernels run with `tasks` tasks for the faces, and
    one further task for each aggregate:

    - `begin` computes the first search direction.
    - `spread` gives the faces of each aggregate its motion (only one task per aggregate).
    - `multiply` computes the product of the matrix A and the search direction on all faces (only `tasks` tasks).
    - `gather` adds up these products on the faces of each aggregate (only one task per aggregate).
    - `update` changes solution and residual.
    - `turn` computes the next search direction.
    """
    Grid = grid_parameters_struct(scalar, 3)
    structs = body_structs(scalar)
    Bodies, Cover = structs.Bodies, structs.Cover
    Matrix = system_structs(scalar).Matrix
    Vector = vector_struct(scalar)
    Fields = grid_structs(scalar, 3).Fields
    f = body_functions(scalar, of)
    Pairs, between = pair_struct(scalar), pair_functions(scalar, of).between
    own = share_functions(serial)
    product = (row_product if serial else entry_product)(scalar, scalar)
    vec3 = types(scalar).vec3

    @wp.func
    def give(g: Grid, bodies: Bodies, cover: Cover, b: wp.int32, x: Vector):
        """Give the faces of an aggregate the components of its rigid motion."""
        for k in range(cover.count[b]):
            r = cover.faces[cover.first[b] + k]
            x.faces[r] = f.carried(x.linear[b], x.angular[b], f.lever(g, bodies, b, r), r / g.slots)

    @wp.func
    def resultant(g: Grid, bodies: Bodies, cover: Cover, b: wp.int32, forces: wp.array(dtype=scalar)):
        """Return the sum of the forces on the faces of an aggregate, and their torque about its centre."""
        force = vec3()
        torque = vec3()
        for k in range(cover.count[b]):
            r = cover.faces[cover.first[b] + k]
            e = vec3()
            e[r / g.slots] = forces[r]
            force += e
            torque += wp.cross(f.lever(g, bodies, b, r), e)
        return force, torque

    @wp.func
    def pair(x: Vector, y: Vector, b: wp.int32) -> wp.float64:
        return wp.float64(wp.dot(x.linear[b], y.linear[b])) + wp.float64(wp.dot(x.angular[b], y.angular[b]))

    @wp.func
    def is_mortar(matrix: Matrix, cover: Cover, r: wp.int32) -> wp.bool:
        """Return whether the velocity of a face is an unknown of its own."""
        return matrix.free[r] == 0 and cover.owner[r] == 0

    @wp.kernel(enable_backward=False, module="unique")
    def begin(
        g: Grid, tasks: wp.int32, bodies: Bodies, cover: Cover, matrix: Matrix, solution: Vector, residual: Vector,
        direction: Vector, partial: wp.array(dtype=wp.float64),
    ):  # fmt: skip
        task = wp.tid()
        rows = 3 * g.slots
        sum = wp.float64(0.0)
        if task < tasks:
            for r in range(own.first(task, tasks, rows), own.end(task, tasks, rows), own.stride(tasks)):
                solution.faces[r] = scalar(0.0)
                if is_mortar(matrix, cover, r):
                    z = residual.faces[r] / matrix.diagonal[r]
                    direction.faces[r] = z
                    sum += wp.float64(z * residual.faces[r])
                elif matrix.free[r] != 0:
                    direction.faces[r] = scalar(0.0)
        else:
            b = task - tasks
            solution.linear[b] = vec3()
            solution.angular[b] = vec3()
            direction.linear[b] = bodies.mobility[b] * residual.linear[b]
            direction.angular[b] = bodies.spin_mobility[b] * residual.angular[b]
            give(g, bodies, cover, b, direction)
            sum = pair(direction, residual, b)
        partial[task] = sum

    @wp.kernel(enable_backward=False, module="unique")
    def spread(g: Grid, bodies: Bodies, cover: Cover, x: Vector):
        give(g, bodies, cover, wp.tid(), x)

    @wp.kernel(enable_backward=False, module="unique")
    def multiply(
        g: Grid, tasks: wp.int32, cover: Cover, matrix: Matrix, direction: Vector, result: Vector,
        partial: wp.array(dtype=wp.float64),
    ):  # fmt: skip
        task = wp.tid()
        rows = 3 * g.slots
        sum = wp.float64(0.0)
        for r in range(own.first(task, tasks, rows), own.end(task, tasks, rows), own.stride(tasks)):
            if matrix.free[r] == 0:
                other = scalar(0.0)
                if wp.static(serial):
                    other = product(
                        matrix.near, matrix.coefficient, direction.faces, r * matrix.near_capacity, matrix.near_count[r]
                    )
                else:
                    other = product(
                        matrix.near, matrix.coefficient, direction.faces, r, matrix.rows, matrix.near_count[r]
                    )
                q = matrix.diagonal[r] * direction.faces[r] - other
                result.faces[r] = q
                if cover.owner[r] == 0:
                    sum += wp.float64(q * direction.faces[r])
            else:
                result.faces[r] = scalar(0.0)
        partial[task] = sum

    @wp.kernel(enable_backward=False, module="unique")
    def gather(
        g: Grid, tasks: wp.int32, mesh: Fields, bodies: Bodies, cover: Cover, pairs: Pairs, direction: Vector,
        result: Vector, partial: wp.array(dtype=wp.float64),
    ):  # fmt: skip
        b = wp.tid()
        dt = scalar(mesh.clock[DT])
        force, torque = resultant(g, bodies, cover, b, result.faces)
        force += bodies.extra_mass[b] / dt * direction.linear[b] + between(pairs, direction.linear, b)
        result.linear[b] = force
        result.angular[b] = torque + bodies.extra_inertia[b] / dt * direction.angular[b]
        partial[tasks + b] = pair(direction, result, b)

    @wp.kernel(enable_backward=False, module="unique")
    def update(
        g: Grid, tasks: wp.int32, bodies: Bodies, cover: Cover, matrix: Matrix, solution: Vector, residual: Vector,
        direction: Vector, result: Vector, sums: wp.array(dtype=wp.float64), partial: wp.array(dtype=wp.float64),
    ):  # fmt: skip
        task = wp.tid()
        rows = 3 * g.slots
        sum = wp.float64(0.0)
        alpha = scalar(0.0)
        if sums[PQ] > wp.float64(0.0):
            alpha = scalar(sums[RZ] / sums[PQ])
        if task < tasks:
            for r in range(own.first(task, tasks, rows), own.end(task, tasks, rows), own.stride(tasks)):
                if matrix.free[r] == 0:
                    solution.faces[r] = solution.faces[r] + alpha * direction.faces[r]
                    if cover.owner[r] == 0:
                        left = residual.faces[r] - alpha * result.faces[r]
                        residual.faces[r] = left
                        z = left / matrix.diagonal[r]
                        result.faces[r] = z
                        sum += wp.float64(z * left)
        else:
            b = task - tasks
            solution.linear[b] = solution.linear[b] + alpha * direction.linear[b]
            solution.angular[b] = solution.angular[b] + alpha * direction.angular[b]
            residual.linear[b] = residual.linear[b] - alpha * result.linear[b]
            residual.angular[b] = residual.angular[b] - alpha * result.angular[b]
            result.linear[b] = bodies.mobility[b] * residual.linear[b]
            result.angular[b] = bodies.spin_mobility[b] * residual.angular[b]
            sum = pair(result, residual, b)
        partial[task] = sum

    @wp.kernel(enable_backward=False, module="unique")
    def turn(
        g: Grid, tasks: wp.int32, bodies: Bodies, cover: Cover, matrix: Matrix, direction: Vector, result: Vector,
        sums: wp.array(dtype=wp.float64),
    ):  # fmt: skip
        task = wp.tid()
        rows = 3 * g.slots
        beta = scalar(0.0)
        if sums[RZ] > wp.float64(0.0):
            beta = scalar(sums[RZ_AFTER] / sums[RZ])
        if task < tasks:
            for r in range(own.first(task, tasks, rows), own.end(task, tasks, rows), own.stride(tasks)):
                if is_mortar(matrix, cover, r):
                    direction.faces[r] = result.faces[r] + beta * direction.faces[r]
        else:
            b = task - tasks
            direction.linear[b] = result.linear[b] + beta * direction.linear[b]
            direction.angular[b] = result.angular[b] + beta * direction.angular[b]
            give(g, bodies, cover, b, direction)

    @wp.kernel(enable_backward=False, module="unique")
    def shift(first: wp.int32, sums: wp.array(dtype=wp.float64)):
        """Start the next iteration with the sums of this one, in one task."""
        if first != 0:
            sums[RZ_FIRST] = sums[RZ]
        else:
            sums[RZ] = sums[RZ_AFTER]

    @wp.kernel(enable_backward=False, module="unique")
    def reduce(g: Grid, bodies: Bodies, cover: Cover, forces: wp.array(dtype=scalar), factor: scalar, result: Vector):
        """Add a multiple of the forces on the faces of each aggregate to its force and torque; a task for each."""
        b = wp.tid()
        force, torque = resultant(g, bodies, cover, b, forces)
        result.linear[b] = result.linear[b] + factor * force
        result.angular[b] = result.angular[b] + factor * torque

    @wp.kernel(enable_backward=False, module="unique")
    def push(g: Grid, bodies: Bodies, cover: Cover, forces: wp.array(dtype=scalar), factor: scalar, result: Vector):
        """Add a multiple of pressure forces to the forces on each aggregate and on the faces that it covers in part.

        An aggregate bears the part of a face's force that it covers, and the mortar the rest. One task per aggregate.
        """
        b = wp.tid()
        force = vec3()
        torque = vec3()
        for k in range(cover.touched[b]):
            place = cover.first[b] + k
            r = cover.faces[place]
            e = vec3()
            e[r / g.slots] = cover.part[place] * forces[r]
            force += e
            torque += wp.cross(f.lever(g, bodies, b, r), e)
            if k >= cover.count[b]:
                # All faces have been given the whole force; take the covered part back.
                result.faces[r] = result.faces[r] - factor * cover.part[place] * forces[r]
        result.linear[b] = result.linear[b] + factor * force
        result.angular[b] = result.angular[b] + factor * torque

    @wp.kernel(enable_backward=False, module="unique")
    def blend(g: Grid, bodies: Bodies, cover: Cover, x: Vector, flow: wp.array(dtype=scalar)):
        """Replace the velocity of covered parts of faces by that of the aggregate, with one task per aggregate.

        `flow` holds the velocities of the mortar at the faces, and receives the mean velocities of the faces.
        """
        b = wp.tid()
        for k in range(cover.count[b], cover.touched[b]):
            place = cover.first[b] + k
            r = cover.faces[place]
            own = f.carried(x.linear[b], x.angular[b], f.lever(g, bodies, b, r), r / g.slots)
            flow[r] = flow[r] + cover.part[place] * (own - flow[r])

    return SimpleNamespace(
        begin=begin, multiply=multiply, gather=gather, update=update, turn=turn, shift=shift, reduce=reduce,
        push=push, blend=blend, spread=spread,
    )  # fmt: skip


@functools.cache
def coupling_kernels(scalar, serial: bool, of: GridKind) -> SimpleNamespace:
    """Build the kernels of the coupled solve for velocities and pressure (generalised conjugate residuals).

    - `start` sets the residual from the forces and inflows at the beginning of the step.
    - `pressure_force` computes the forces of a pressure field on the faces.
    - `inflow` computes the net inflow into the cells that a change of the velocities causes.
    - `request` sets up a pressure solve that removes an inflow.
    - `press` computes the pressure of the preconditioner: the solution of the pressure solve plus the viscous part.
    - `inner` computes partial sums of the weighted inner product of two vectors.
    - `scale_of` does the same for the squared momentum of the flow, with which residuals are compared.
    - `add` adds a multiple of a vector to another one.
    - `finish` adds the solution to the velocities and pressures of the flow.
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

    @wp.func
    def cell_weight(g: Grid, cut: Fields, c: wp.int32) -> scalar:
        """Return the pressure that a net inflow of one unit of volume per time into a cell is worth."""
        inertia = g.density * g.width[0] * g.width[0] / scalar(cut.clock[DT])
        return (inertia + scalar(COMPRESSION) * cut.in_cell[c]) / f.block(g)

    @wp.kernel(enable_backward=False, module="unique")
    def start(
        g: Grid, tasks: wp.int32, bodies: Bodies, cover: Cover, matrix: Matrix, viscous: Solve, projection: Solve,
        mesh: Fields, inflow: wp.array(dtype=scalar), again: wp.int32, residual: Vector,
    ):  # fmt: skip
        task = wp.tid()
        if task < tasks:
            rows = 3 * g.slots
            for r in range(own.first(task, tasks, rows), own.end(task, tasks, rows), own.stride(tasks)):
                residual.faces[r] = wp.where(matrix.free[r] == 0, viscous.residual[r], scalar(0.0))
            for c in range(own.first(task, tasks, g.slots), own.end(task, tasks, g.slots), own.stride(tasks)):
                if again == 0:
                    # Pressure solves overwrite this residual, so keep the inflow in case the step is solved again.
                    inflow[c] = projection.residual[c] * scalar(mesh.clock[DT]) / g.density
                residual.cells[c] = residual.cells[c] + inflow[c]
        else:
            b = task - tasks
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

    @wp.kernel(enable_backward=False, module="unique")
    def press(g: Grid, mesh: Fields, cut: Fields, residual: Vector, solved: wp.array(dtype=scalar), result: Vector):
        number = wp.tid()
        value = scalar(0.0)
        if mesh.liquid[number] != 0:
            value = solved[number] + scalar(COMPRESSION) * cut.in_cell[number] * residual.cells[number] / f.block(g)
        result.cells[number] = value

    @wp.kernel(enable_backward=False, module="unique")
    def request(g: Grid, mesh: Fields, inflow: Vector, projection: Solve):
        """Set the residual of a pressure solve from the net inflow into the cells."""
        number = wp.tid()
        mesh.increment[number] = scalar(0.0)
        projection.residual[number] = g.density / scalar(mesh.clock[DT]) * inflow.cells[number]

    @wp.kernel(enable_backward=False, module="unique")
    def inner(
        g: Grid, tasks: wp.int32, bodies: Bodies, cover: Cover, matrix: Matrix, mesh: Fields, cut: Fields,
        one: Vector, two: Vector, partial: wp.array(dtype=wp.float64),
    ):  # fmt: skip
        task = wp.tid()
        sum = wp.float64(0.0)
        if task < tasks:
            rows = 3 * g.slots
            for r in range(own.first(task, tasks, rows), own.end(task, tasks, rows), own.stride(tasks)):
                if matrix.free[r] == 0 and cover.owner[r] == 0:
                    sum += wp.float64(one.faces[r] / matrix.diagonal[r] * two.faces[r])
            for c in range(own.first(task, tasks, g.slots), own.end(task, tasks, g.slots), own.stride(tasks)):
                if mesh.liquid[c] != 0:
                    sum += wp.float64(one.cells[c] * cell_weight(g, cut, c) * two.cells[c])
        else:
            b = task - tasks
            sum = wp.float64(wp.dot(one.linear[b], bodies.mobility[b] * two.linear[b]))
            sum += wp.float64(wp.dot(one.angular[b], bodies.spin_mobility[b] * two.angular[b]))
        partial[task] = sum

    @wp.kernel(enable_backward=False, module="unique")
    def scale_of(
        g: Grid, tasks: wp.int32, cover: Cover, matrix: Matrix, mesh: Fields, change: Vector,
        partial: wp.array(dtype=wp.float64),
    ):  # fmt: skip
        task = wp.tid()
        sum = wp.float64(0.0)
        if task < tasks:
            rows = 3 * g.slots
            for r in range(own.first(task, tasks, rows), own.end(task, tasks, rows), own.stride(tasks)):
                if matrix.free[r] == 0:
                    u = mesh.velocity[r] + change.faces[r]
                    sum += wp.float64(matrix.diagonal[r] * u * u)
        partial[task] = sum

    @wp.kernel(enable_backward=False, module="unique")
    def add(g: Grid, tasks: wp.int32, factor: scalar, one: Vector, result: Vector):
        task = wp.tid()
        if task < tasks:
            rows = 3 * g.slots
            for r in range(own.first(task, tasks, rows), own.end(task, tasks, rows), own.stride(tasks)):
                result.faces[r] = result.faces[r] + factor * one.faces[r]
            for c in range(own.first(task, tasks, g.slots), own.end(task, tasks, g.slots), own.stride(tasks)):
                result.cells[c] = result.cells[c] + factor * one.cells[c]
        else:
            b = task - tasks
            result.linear[b] = result.linear[b] + factor * one.linear[b]
            result.angular[b] = result.angular[b] + factor * one.angular[b]

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
            b = task - tasks
            bodies.velocity[b] = bodies.velocity[b] + solution.linear[b]
            bodies.spin[b] = bodies.spin[b] + solution.angular[b]

    return SimpleNamespace(
        start=start, pressure_force=pressure_force, inflow=inflow, press=press,
        request=request, inner=inner, scale_of=scale_of, add=add, finish=finish,
    )  # fmt: skip


@functools.cache
def add_kernel(scalar):
    """Build the kernel that adds a multiple of an array to another one, with one task per element."""

    @wp.kernel(enable_backward=False, module="unique")
    def add_multiple(one: wp.array(dtype=scalar), factor: scalar, result: wp.array(dtype=scalar)):
        k = wp.tid()
        result[k] = result[k] + factor * one[k]

    return add_multiple
