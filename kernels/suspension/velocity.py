"""Conjugate gradients for the viscous matrix of mortar and aggregates, and forces on aggregates.

The unknowns are the velocities of the faces that do not move with an aggregate, and the velocities and spins of the
aggregates. The matrix is P^T A P + E, see `coupling.py`. The preconditioner is the diagonal of the matrix for faces,
and the 3 x 3 diagonal blocks of `blocks.py` for aggregates.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.rows import entry_product, row_product
from ..common.types import cpu_flags, types
from ..mps.coarse import lane_sum, lanes, wait_for_lanes
from ..mps.grid.cells import DT, GridKind, grid_parameters_struct, grid_structs
from ..mps.grid.levels import system_structs
from .bodies import BodyKind, body_functions, body_structs, shape_functions
from .pairs import pair_functions, pair_struct
from .vectors import (
    PQ,
    RZ,
    RZ_AFTER,
    RZ_FIRST,
    range_functions,
    share_functions,
    share_of_body,
    store_function,
    vector_struct,
)

GIVE = """
    for (int k = first; k < end; k += by) {
        const int r = faces.data[k];
        const wp::vec_t<3, SCALAR> d = lever.data[k];
        result.data[r] = r < slots ? velocity[0] + spin[1] * d[2] - spin[2] * d[1]
            : r < 2 * slots ? velocity[1] + spin[2] * d[0] - spin[0] * d[2]
                            : velocity[2] + spin[0] * d[1] - spin[1] * d[0];
    }
"""
RESULTANT = """
    wp::vec_t<6, SCALAR> sum = {};
    for (int k = first; k < end; k += by) {
        const int r = faces.data[k];
        const SCALAR f = forces.data[r];
        const wp::vec_t<3, SCALAR> d = lever.data[k];
        if (r < slots) {
            sum[0] += f;
            sum[4] += d[2] * f;
            sum[5] -= d[1] * f;
        } else if (r < 2 * slots) {
            sum[1] += f;
            sum[3] -= d[2] * f;
            sum[5] += d[0] * f;
        } else {
            sum[2] += f;
            sum[3] += d[1] * f;
            sum[4] -= d[0] * f;
        }
    }
    return sum;
"""
"""C++ sources of two functions for the faces that move with one aggregate. GIVE sets the velocities of the faces, and
RESULTANT adds up the forces on them and their torques. The faces are the entries `first` to `end` - 1 of the list
`faces`. Each of `by` threads processes every `by`-th entry. Faces perpendicular to axis a have numbers from a * slots
on, where `slots` is the number of cells including the frame around the grid."""


@functools.cache
def velocity_functions(scalar, of: GridKind) -> SimpleNamespace:
    """Build functions for aggregates and their faces.

    - `give` sets the velocities of the faces that move with an aggregate.
    - `resultant` adds up the forces on these faces.
    - `pair` returns an aggregate's contribution to the inner product of two vectors.

    On a GPU, all lanes (threads) of a warp call `give` and `resultant` together and share the faces.
    """
    Grid = grid_parameters_struct(scalar, 3)
    structs = body_structs(scalar)
    Cover = structs.Cover
    Vector = vector_struct(scalar)
    vec3, vec6 = types(scalar).vec3, wp.types.vector(6, scalar)
    all_lanes = lane_sum(vec6)
    name = "double" if scalar is wp.float64 else "float"

    @wp.func_native(GIVE.replace("SCALAR", name))
    def give_range(
        velocity: vec3, spin: vec3, slots: wp.int32, first: wp.int32, end: wp.int32, by: wp.int32,
        faces: wp.array(dtype=wp.int32), lever: wp.array(dtype=vec3), result: wp.array(dtype=scalar),
    ): ...  # fmt: skip

    @wp.func_native(RESULTANT.replace("SCALAR", name))
    def resultant_range(
        slots: wp.int32, first: wp.int32, end: wp.int32, by: wp.int32, faces: wp.array(dtype=wp.int32),
        lever: wp.array(dtype=vec3), forces: wp.array(dtype=scalar),
    ) -> vec6: ...  # fmt: skip

    @wp.func
    def give(
        g: Grid, cover: Cover, b: wp.int32, lane: wp.int32, velocity: vec3, spin: vec3, faces: wp.array(dtype=scalar)
    ):
        """Set the velocities of the faces that move with an aggregate, from its velocity and spin."""
        first = cover.first[b]
        end = first + cover.count[b]
        give_range(velocity, spin, g.slots, first + lane, end, lanes(), cover.faces, cover.lever, faces)

    @wp.func
    def resultant(g: Grid, cover: Cover, b: wp.int32, lane: wp.int32, forces: wp.array(dtype=scalar)):
        """Return force and torque on an aggregate from the forces on the faces that move with it.

        The torque is about the centre of the aggregate.
        """
        first = cover.first[b]
        end = first + cover.count[b]
        both = all_lanes(resultant_range(g.slots, first + lane, end, lanes(), cover.faces, cover.lever, forces))
        return vec3(both[0], both[1], both[2]), vec3(both[3], both[4], both[5])

    @wp.func
    def pair(x: Vector, y: Vector, b: wp.int32) -> wp.float64:
        return wp.float64(wp.dot(x.linear[b], y.linear[b])) + wp.float64(wp.dot(x.angular[b], y.angular[b]))

    return SimpleNamespace(give=give, resultant=resultant, pair=pair)


@functools.cache
def search_kernels(scalar, serial: bool, of: GridKind) -> SimpleNamespace:
    """Build the kernels that compute search directions and their products with the matrix.

    Unless stated otherwise, the kernels run with `tasks` tasks for the faces, and with further tasks for the
    aggregates, which :func:`share_of_body` distributes:

    - `begin` computes the first search direction.
    - `turn` computes the next search direction.
    - `multiply` computes the product of the viscous matrix A and a direction on all faces, with `tasks` tasks.
    """
    Grid = grid_parameters_struct(scalar, 3)
    structs = body_structs(scalar)
    Bodies, Cover = structs.Bodies, structs.Cover
    Matrix, Vector = system_structs(scalar).Matrix, vector_struct(scalar)
    own, ranges, store = share_functions(serial), range_functions(scalar, serial), store_function(serial)
    v = velocity_functions(scalar, of)
    product = (row_product if serial else entry_product)(scalar, scalar)
    vec3 = types(scalar).vec3

    @wp.kernel(enable_backward=False, module="unique")
    def begin(
        g: Grid, tasks: wp.int32, bodies: Bodies, cover: Cover, inverse: wp.array(dtype=scalar), solution: Vector,
        residual: Vector, direction: Vector, partial: wp.array(dtype=wp.float64),
    ):  # fmt: skip
        task = wp.tid()
        rows = 3 * g.slots
        sum = wp.float64(0.0)
        if task < tasks:
            for r in range(own.first(task, tasks, rows), own.end(task, tasks, rows), own.stride(tasks)):
                solution.faces[r] = scalar(0.0)
                if cover.owner[r] == 0:
                    z = inverse[r] * residual.faces[r]
                    direction.faces[r] = z
                    sum += wp.float64(z * residual.faces[r])
        else:
            b, lane = share_of_body(task, tasks)
            if b < bodies.centre.shape[0]:
                linear = bodies.mobility[b] * residual.linear[b]
                angular = bodies.spin_mobility[b] * residual.angular[b]
                v.give(g, cover, b, lane, linear, angular, direction.faces)
                if lane == 0:
                    solution.linear[b] = vec3()
                    solution.angular[b] = vec3()
                    direction.linear[b] = linear
                    direction.angular[b] = angular
                    sum = v.pair(direction, residual, b)
        store(task, partial, 0, sum)

    @wp.kernel(enable_backward=False, module="unique", module_options={"cpu_compiler_flags": cpu_flags()})
    def turn(
        g: Grid, tasks: wp.int32, cover: Cover, inverse: wp.array(dtype=scalar), direction: Vector, result: Vector,
        sums: wp.array(dtype=wp.float64),
    ):  # fmt: skip
        task = wp.tid()
        rows = 3 * g.slots
        beta = scalar(0.0)
        if sums[RZ] > wp.float64(0.0):
            beta = scalar(sums[RZ_AFTER] / sums[RZ])
        if task < tasks:
            ranges.turn(
                beta, result.faces, inverse, direction.faces, own.first(task, tasks, rows), own.end(task, tasks, rows),
                tasks,
            )  # fmt: skip
        else:
            b, lane = share_of_body(task, tasks)
            if b < cover.count.shape[0]:
                linear = result.linear[b] + beta * direction.linear[b]
                angular = result.angular[b] + beta * direction.angular[b]
                v.give(g, cover, b, lane, linear, angular, direction.faces)
                wait_for_lanes()  # All lanes must have read the old direction before the first lane replaces it.
                if lane == 0:
                    direction.linear[b] = linear
                    direction.angular[b] = angular

    @wp.kernel(enable_backward=False, module="unique", module_options={"cpu_compiler_flags": cpu_flags()})
    def multiply(
        g: Grid, tasks: wp.int32, cover: Cover, matrix: Matrix, direction: Vector, result: Vector,
        partial: wp.array(dtype=wp.float64),
    ):  # fmt: skip
        task = wp.tid()
        rows = 3 * g.slots
        sum = wp.float64(0.0)
        for r in range(own.first(task, tasks, rows), own.end(task, tasks, rows), own.stride(tasks)):
            # Read all values before the branch, so that a GPU waits for memory only once.
            free = matrix.free[r]
            count = matrix.near_count[r]
            diagonal = matrix.diagonal[r]
            owner = cover.owner[r]
            x = direction.faces[r]
            q = scalar(0.0)
            if free == 0:
                other = scalar(0.0)
                if wp.static(serial):
                    other = product(matrix.near, matrix.coefficient, direction.faces, r * matrix.near_capacity, count)
                else:
                    other = product(matrix.near, matrix.coefficient, direction.faces, r, matrix.rows, count)
                q = diagonal * x - other
                if owner == 0:
                    sum += wp.float64(q * x)
            result.faces[r] = q
        store(task, partial, 0, sum)

    return SimpleNamespace(begin=begin, turn=turn, multiply=multiply)


@functools.cache
def gather_kernel(scalar, serial: bool, of: GridKind, kind: BodyKind):
    """Build the kernel that computes the product of matrix and search direction for each aggregate.

    It runs after `multiply` of `search_kernels`. For each aggregate, it adds up the products on the faces that move
    with the aggregate, and adds the terms of the aggregate's inertia and of its neighbours. The tasks work on the
    aggregates, which :func:`share_of_body` distributes. `first` is the number of partial sums that `multiply` has
    stored.
    """
    Grid = grid_parameters_struct(scalar, 3)
    structs = body_structs(scalar)
    Bodies, Cover = structs.Bodies, structs.Cover
    Vector, Fields = vector_struct(scalar), grid_structs(scalar, 3).Fields
    v, store = velocity_functions(scalar, of), store_function(serial)
    Pairs, between = pair_struct(scalar), pair_functions(scalar, kind).between
    inertia = shape_functions(scalar, kind).inertia
    all_lanes = lane_sum(types(scalar).vec3)

    @wp.kernel(enable_backward=False, module="unique", module_options={"cpu_compiler_flags": cpu_flags()})
    def gather(
        g: Grid, first: wp.int32, mesh: Fields, bodies: Bodies, cover: Cover, pairs: Pairs, direction: Vector,
        result: Vector, partial: wp.array(dtype=wp.float64),
    ):  # fmt: skip
        task = wp.tid()
        b, lane = share_of_body(task, 0)
        sum = wp.float64(0.0)
        if b < bodies.centre.shape[0]:
            force, torque = v.resultant(g, cover, b, lane, result.faces)
            push, twist = between(bodies, pairs, direction.linear, direction.angular, b, lane, lanes())
            push = all_lanes(push)
            if wp.static(kind.turning):
                twist = all_lanes(twist)
            if lane == 0:
                dt = scalar(mesh.clock[DT])
                force += bodies.extra_mass[b] / dt * direction.linear[b] + push
                torque += inertia(bodies, b) / dt * direction.angular[b]
                if wp.static(kind.turning):
                    torque += twist
                result.linear[b] = force
                result.angular[b] = torque
                sum = v.pair(direction, result, b)
        store(task, partial, first, sum)

    return gather


@functools.cache
def update_kernels(scalar, serial: bool, of: GridKind) -> SimpleNamespace:
    """Build the kernels `update` and `shift` of an iteration of conjugate gradients.

    `update` changes the solution and the residual, and `shift` ends the iteration.
    """
    Grid = grid_parameters_struct(scalar, 3)
    structs = body_structs(scalar)
    Bodies = structs.Bodies
    Vector = vector_struct(scalar)
    own, ranges, store = share_functions(serial), range_functions(scalar, serial), store_function(serial)
    v = velocity_functions(scalar, of)

    @wp.kernel(enable_backward=False, module="unique", module_options={"cpu_compiler_flags": cpu_flags()})
    def update(
        g: Grid, tasks: wp.int32, bodies: Bodies, inverse: wp.array(dtype=scalar), solution: Vector, residual: Vector,
        direction: Vector, result: Vector, sums: wp.array(dtype=wp.float64), partial: wp.array(dtype=wp.float64),
    ):  # fmt: skip
        task = wp.tid()
        rows = 3 * g.slots
        sum = wp.float64(0.0)
        alpha = scalar(0.0)
        if sums[PQ] > wp.float64(0.0):
            alpha = scalar(sums[RZ] / sums[PQ])
        if task < tasks:
            first, end = own.first(task, tasks, rows), own.end(task, tasks, rows)
            sum = ranges.move(
                alpha, direction.faces, inverse, solution.faces, residual.faces, result.faces, first, end, tasks
            )  # fmt: skip
            if wp.static(serial):
                sum = ranges.dot(result.faces, residual.faces, 0, first, end, tasks)
        else:
            b, lane = share_of_body(task, tasks)
            if b < bodies.centre.shape[0] and lane == 0:
                solution.linear[b] = solution.linear[b] + alpha * direction.linear[b]
                solution.angular[b] = solution.angular[b] + alpha * direction.angular[b]
                residual.linear[b] = residual.linear[b] - alpha * result.linear[b]
                residual.angular[b] = residual.angular[b] - alpha * result.angular[b]
                result.linear[b] = bodies.mobility[b] * residual.linear[b]
                result.angular[b] = bodies.spin_mobility[b] * residual.angular[b]
                sum = v.pair(result, residual, b)
        store(task, partial, 0, sum)

    @wp.kernel(enable_backward=False, module="unique")
    def shift(first: wp.int32, sums: wp.array(dtype=wp.float64)):
        """Store the inner product r.z of this iteration where the next iteration reads it, with one task.

        If `first` is not 0, store it as the inner product at the start of the solve (RZ_FIRST) instead.
        """
        if first != 0:
            sums[RZ_FIRST] = sums[RZ]
        else:
            sums[RZ] = sums[RZ_AFTER]

    return SimpleNamespace(update=update, shift=shift)


@functools.cache
def force_kernels(scalar, of: GridKind) -> SimpleNamespace:
    """Build the kernels for forces on aggregates and for the flow through faces that aggregates cover partly.

    The tasks of each kernel work on the aggregates, which :func:`share_of_body` distributes:

    - `reduce` adds the forces on the faces that move with an aggregate to the force and torque on the aggregate.
    - `push` adds pressure forces to an aggregate, also those on faces that it covers partly.
    - `blend` computes mean velocities of faces that aggregates cover partly.
    """
    Grid = grid_parameters_struct(scalar, 3)
    structs = body_structs(scalar)
    Cover = structs.Cover
    Vector = vector_struct(scalar)
    body, v = body_functions(scalar, of), velocity_functions(scalar, of)
    vec3 = types(scalar).vec3
    all_lanes = lane_sum(vec3)

    @wp.kernel(enable_backward=False, module="unique")
    def reduce(g: Grid, cover: Cover, forces: wp.array(dtype=scalar), factor: scalar, result: Vector):
        """Add a multiple of the forces on the faces that move with an aggregate to the aggregate's force and torque."""
        b, lane = share_of_body(wp.tid(), 0)
        if b < cover.count.shape[0]:
            force, torque = v.resultant(g, cover, b, lane, forces)
            if lane == 0:
                result.linear[b] = result.linear[b] + factor * force
                result.angular[b] = result.angular[b] + factor * torque

    @wp.kernel(enable_backward=False, module="unique")
    def push(g: Grid, cover: Cover, forces: wp.array(dtype=scalar), factor: scalar, result: Vector):
        """Add a multiple of the pressure forces on the covered parts of faces to the forces on each aggregate.

        For a partly covered face, the kernel also subtracts this pressure force from the force on the mortar, which
        acts on the uncovered part only.
        """
        b, lane = share_of_body(wp.tid(), 0)
        if b < cover.count.shape[0]:
            force = vec3()
            torque = vec3()
            for k in range(lane, cover.touched[b], lanes()):
                place = cover.first[b] + k
                r = cover.faces[place]
                e = vec3()
                e[r / g.slots] = cover.part[place] * forces[r]
                force += e
                torque += wp.cross(cover.lever[place], e)
                if k >= cover.count[b]:
                    # The pressure force on this face was computed for its whole area, so subtract the share of the
                    # covered part.
                    result.faces[r] = result.faces[r] - factor * cover.part[place] * forces[r]
            force = all_lanes(force)
            torque = all_lanes(torque)
            if lane == 0:
                result.linear[b] = result.linear[b] + factor * force
                result.angular[b] = result.angular[b] + factor * torque

    @wp.kernel(enable_backward=False, module="unique")
    def blend(g: Grid, cover: Cover, x: Vector, flow: wp.array(dtype=scalar)):
        """Replace the mortar velocities in `flow` by the mean velocities of partly covered faces.

        Each mean is taken over mortar and aggregate, weighted with the fractions of the face's area that they cover.
        """
        b, lane = share_of_body(wp.tid(), 0)
        if b < cover.count.shape[0]:
            for k in range(cover.count[b] + lane, cover.touched[b], lanes()):
                place = cover.first[b] + k
                r = cover.faces[place]
                own = body.carried(x.linear[b], x.angular[b], cover.lever[place], r / g.slots)
                flow[r] = flow[r] + cover.part[place] * (own - flow[r])

    return SimpleNamespace(reduce=reduce, push=push, blend=blend)
