"""Conjugate gradients for the viscous matrix of mortar and aggregates, and forces on aggregates.

The unknowns are the velocities of the faces that do not move with an aggregate, and the velocities and spins of the
aggregates. The matrix is P^T A P + E, see `coupling.py`. The preconditioner is the diagonal of the matrix for faces,
and the 3 x 3 diagonal blocks of `blocks.py` for aggregates.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.rows import entry_product, row_product
from ..common.types import types
from ..mps.grid.cells import DT, GridKind, grid_parameters_struct, grid_structs
from ..mps.grid.levels import system_structs
from .bodies import body_functions, body_structs
from .pairs import pair_functions, pair_struct
from .vectors import PQ, RZ, RZ_AFTER, RZ_FIRST, share_functions, vector_struct


@functools.cache
def velocity_functions(scalar, of: GridKind) -> SimpleNamespace:
    """Build functions for aggregates and their faces.

    - `give` sets the velocities of the faces that move with an aggregate.
    - `resultant` adds up the forces on these faces.
    - `pair` returns an aggregate's contribution to the inner product of two vectors.
    - `is_mortar` returns whether the velocity of a face is an unknown.
    """
    Grid = grid_parameters_struct(scalar, 3)
    structs = body_structs(scalar)
    Bodies, Cover = structs.Bodies, structs.Cover
    Matrix, Vector = system_structs(scalar).Matrix, vector_struct(scalar)
    body, vec3 = body_functions(scalar, of), types(scalar).vec3

    @wp.func
    def give(g: Grid, cover: Cover, b: wp.int32, x: Vector):
        """Set the velocities in `x` of the faces that move with an aggregate, from its velocity and spin in `x`."""
        for k in range(cover.count[b]):
            place = cover.first[b] + k
            r = cover.faces[place]
            x.faces[r] = body.carried(x.linear[b], x.angular[b], cover.lever[place], r / g.slots)

    @wp.func
    def resultant(g: Grid, cover: Cover, b: wp.int32, forces: wp.array(dtype=scalar)):
        """Return the total force on the faces that move with an aggregate, and its torque about the centre."""
        force = vec3()
        torque = vec3()
        for k in range(cover.count[b]):
            place = cover.first[b] + k
            r = cover.faces[place]
            e = vec3()
            e[r / g.slots] = forces[r]
            force += e
            torque += wp.cross(cover.lever[place], e)
        return force, torque

    @wp.func
    def pair(x: Vector, y: Vector, b: wp.int32) -> wp.float64:
        return wp.float64(wp.dot(x.linear[b], y.linear[b])) + wp.float64(wp.dot(x.angular[b], y.angular[b]))

    @wp.func
    def is_mortar(matrix: Matrix, cover: Cover, r: wp.int32) -> wp.bool:
        """Return whether the velocity of a face is an unknown, so that the face does not move with an aggregate."""
        return matrix.free[r] == 0 and cover.owner[r] == 0

    return SimpleNamespace(give=give, resultant=resultant, pair=pair, is_mortar=is_mortar)


@functools.cache
def search_kernels(scalar, serial: bool, of: GridKind) -> SimpleNamespace:
    """Build the kernels that compute search directions and their products with the matrix.

    Unless stated otherwise, the kernels run with `tasks` tasks for the faces and one more task for each aggregate:

    - `begin` computes the first search direction.
    - `turn` computes the next search direction.
    - `multiply` computes the product of the viscous matrix A and a direction on all faces, with `tasks` tasks.
    - `gather` adds up these products on the faces of each aggregate, with one task per aggregate.
    """
    Grid = grid_parameters_struct(scalar, 3)
    structs = body_structs(scalar)
    Bodies, Cover = structs.Bodies, structs.Cover
    Matrix, Vector = system_structs(scalar).Matrix, vector_struct(scalar)
    own = share_functions(serial)
    Fields = grid_structs(scalar, 3).Fields
    v = velocity_functions(scalar, of)
    Pairs, between = pair_struct(scalar), pair_functions(scalar, of).between
    product = (row_product if serial else entry_product)(scalar, scalar)
    vec3 = types(scalar).vec3

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
                if v.is_mortar(matrix, cover, r):
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
            v.give(g, cover, b, direction)
            sum = v.pair(direction, residual, b)
        partial[task] = sum

    @wp.kernel(enable_backward=False, module="unique")
    def turn(
        g: Grid, tasks: wp.int32, cover: Cover, matrix: Matrix, direction: Vector, result: Vector,
        sums: wp.array(dtype=wp.float64),
    ):  # fmt: skip
        task = wp.tid()
        rows = 3 * g.slots
        beta = scalar(0.0)
        if sums[RZ] > wp.float64(0.0):
            beta = scalar(sums[RZ_AFTER] / sums[RZ])
        if task < tasks:
            for r in range(own.first(task, tasks, rows), own.end(task, tasks, rows), own.stride(tasks)):
                if v.is_mortar(matrix, cover, r):
                    direction.faces[r] = result.faces[r] + beta * direction.faces[r]
        else:
            b = task - tasks
            direction.linear[b] = result.linear[b] + beta * direction.linear[b]
            direction.angular[b] = result.angular[b] + beta * direction.angular[b]
            v.give(g, cover, b, direction)

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
        force, torque = v.resultant(g, cover, b, result.faces)
        force += bodies.extra_mass[b] / dt * direction.linear[b] + between(pairs, direction.linear, b)
        result.linear[b] = force
        result.angular[b] = torque + bodies.extra_inertia[b] / dt * direction.angular[b]
        partial[tasks + b] = v.pair(direction, result, b)

    return SimpleNamespace(begin=begin, turn=turn, multiply=multiply, gather=gather)


@functools.cache
def update_kernels(scalar, serial: bool, of: GridKind) -> SimpleNamespace:
    """Build the kernels `update`, which updates solution and residual, and `shift`, which ends an iteration."""
    Grid = grid_parameters_struct(scalar, 3)
    structs = body_structs(scalar)
    Bodies, Cover = structs.Bodies, structs.Cover
    Matrix, Vector = system_structs(scalar).Matrix, vector_struct(scalar)
    own = share_functions(serial)
    v = velocity_functions(scalar, of)

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
            sum = v.pair(result, residual, b)
        partial[task] = sum

    @wp.kernel(enable_backward=False, module="unique")
    def shift(first: wp.int32, sums: wp.array(dtype=wp.float64)):
        """Move the inner products of this iteration to where the next iteration expects them, with one task."""
        if first != 0:
            sums[RZ_FIRST] = sums[RZ]
        else:
            sums[RZ] = sums[RZ_AFTER]

    return SimpleNamespace(update=update, shift=shift)


@functools.cache
def force_kernels(scalar, of: GridKind) -> SimpleNamespace:
    """Build the kernels for forces on aggregates and for the flow through faces that aggregates cover partly.

    Each kernel runs with one task per aggregate:

    - `spread` sets the velocities of the faces that move with an aggregate.
    - `reduce` adds the forces on these faces to the force and torque on the aggregate.
    - `push` adds pressure forces to an aggregate, also those on faces that it covers partly.
    - `blend` computes mean velocities of faces that aggregates cover partly.
    """
    Grid = grid_parameters_struct(scalar, 3)
    structs = body_structs(scalar)
    Bodies, Cover = structs.Bodies, structs.Cover
    Vector = vector_struct(scalar)
    body, v = body_functions(scalar, of), velocity_functions(scalar, of)
    vec3 = types(scalar).vec3

    @wp.kernel(enable_backward=False, module="unique")
    def spread(g: Grid, cover: Cover, x: Vector):
        v.give(g, cover, wp.tid(), x)

    @wp.kernel(enable_backward=False, module="unique")
    def reduce(g: Grid, cover: Cover, forces: wp.array(dtype=scalar), factor: scalar, result: Vector):
        """Add a multiple of the forces on the faces that move with each aggregate to its force and torque."""
        b = wp.tid()
        force, torque = v.resultant(g, cover, b, forces)
        result.linear[b] = result.linear[b] + factor * force
        result.angular[b] = result.angular[b] + factor * torque

    @wp.kernel(enable_backward=False, module="unique")
    def push(g: Grid, cover: Cover, forces: wp.array(dtype=scalar), factor: scalar, result: Vector):
        """Add a multiple of the pressure forces on the covered parts of faces to the forces on each aggregate.

        The mortar bears only the force on the uncovered part of a face, so the kernel subtracts the covered part there.
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
            torque += wp.cross(cover.lever[place], e)
            if k >= cover.count[b]:
                # The force on this face already contains the whole pressure force, so subtract the covered part.
                result.faces[r] = result.faces[r] - factor * cover.part[place] * forces[r]
        result.linear[b] = result.linear[b] + factor * force
        result.angular[b] = result.angular[b] + factor * torque

    @wp.kernel(enable_backward=False, module="unique")
    def blend(g: Grid, cover: Cover, x: Vector, flow: wp.array(dtype=scalar)):
        """Replace the mortar velocities in `flow` by the mean velocities of partly covered faces.

        The mean of the velocities of mortar and aggregate is weighted by the area of the face that each of them has.
        """
        b = wp.tid()
        for k in range(cover.count[b], cover.touched[b]):
            place = cover.first[b] + k
            r = cover.faces[place]
            own = body.carried(x.linear[b], x.angular[b], cover.lever[place], r / g.slots)
            flow[r] = flow[r] + cover.part[place] * (own - flow[r])

    return SimpleNamespace(spread=spread, reduce=reduce, push=push, blend=blend)
