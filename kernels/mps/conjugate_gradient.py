"""Conjugate gradients for the two kinds of equations of the moving particle method, matrix-free but for pair weights.

A row is: diagonal times own value, less the pair coefficients times the neighbours' values; rows of velocities may
also resist motion along the wall. The preconditioner is the diagonal. A CPU runs a whole solve in one kernel, a thread
for each chunk of rows, with barriers where sums are formed; a GPU runs a small solve in one block of threads, which
needs nobody to launch its iterations, so that many flows have theirs at once, and a large one as three kernels an
iteration inside a loop of a CUDA graph, which take the members of matrix and solve one by one: as structs they cost a
channel 1.4 % of its time. Sums are formed in the same order every time.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.barrier import meet
from ..common.control import FAILED, HALTED
from ..common.reductions import BLOCK, keep, total
from ..common.rows import row_product
from ..common.types import cpu_flags
from .structs import array_structs, flow_struct, mps_functions, mps_types, place_by_entry

# Slots of the outcome of a solve.
ITERATIONS = wp.constant(0)
BEFORE = wp.constant(1)  # norm of the residual at the start
AFTER = wp.constant(2)  # and at the end
OUTCOME = 4


@functools.cache
def solver_functions(scalar, dimensions: int, vector: bool) -> SimpleNamespace:
    """What a row of the solution is (`value`), its `inner` product, the preconditioner, and what walls and surface add.

    Rows of velocities are bound to the wall by `drag`, along it only; rows of scalars at the free surface are zero.
    """
    t = mps_types(scalar, dimensions)
    f = mps_functions(scalar, dimensions)
    value = t.vec if vector else scalar
    structs = array_structs(scalar, dimensions)
    Solve = structs.VectorSolve if vector else structs.NumberSolve

    @wp.func
    def inner(a: value, b: value) -> wp.float64:
        if wp.static(vector):
            return wp.float64(wp.dot(a, b))
        else:
            return wp.float64(a * b)

    @wp.func
    def divided(r: value, free: wp.int32, diagonal: scalar, drag: scalar) -> value:
        if wp.static(vector):
            return r / (diagonal + drag)
        else:
            if free == 0 and diagonal > scalar(0.0):
                return r / diagonal
            return scalar(0.0)

    @wp.func
    def bounded(product: value, own: value, x: t.vec, free: wp.int32, drag: scalar) -> value:
        if wp.static(vector):
            if drag > scalar(0.0):
                n = f.outward(x)
                return product + drag * (own - wp.dot(n, own) * n)
            return product
        else:
            if free != 0:
                return scalar(0.0)
            return product

    return SimpleNamespace(value=value, Solve=Solve, inner=inner, divided=divided, bounded=bounded)


@functools.cache
def serial_solver(scalar, dimensions: int, vector: bool):
    """Kernel of one task a thread: the whole solve; adds to `x`.

    Rows are in `parts` chunks, of which a thread takes those from `lower` to `upper`; there are `workers` threads.
    """
    f = solver_functions(scalar, dimensions, vector)
    Solve, value = f.Solve, f.value
    Flow = flow_struct(scalar)
    structs = array_structs(scalar, dimensions)
    Matrix = structs.Matrix
    product = row_product(scalar, value)

    @wp.kernel(enable_backward=False, module="unique", module_options={"cpu_compiler_flags": cpu_flags()})
    def solve(
        # what is solved, and how well
        flow: Flow,
        what: wp.int32,
        tolerance: wp.float64,
        absolute_tolerance: wp.float64,
        maximum: wp.int32,
        # chunks
        parts: wp.int32,
        lower: wp.int32,
        upper: wp.int32,
        workers: wp.int32,
        gate: wp.array(dtype=wp.int32),
        # state, read
        matrix: Matrix,
        # written
        flags: wp.array(dtype=wp.int32),
        system: Solve,
        x: wp.array(dtype=value),
    ):
        if flags[HALTED] != 0:
            return
        for part in range(lower, upper):
            own_rz = wp.float64(0.0)
            own_rr = wp.float64(0.0)
            for i in range(flow.count * part / parts, flow.count * (part + 1) / parts):
                z = f.divided(system.residual[i], matrix.free[i], matrix.diagonal[i], matrix.drag[i])
                system.direction[i] = z
                own_rz += f.inner(system.residual[i], z)
                own_rr += f.inner(system.residual[i], system.residual[i])
            system.partial[part] = own_rz
            system.partial[parts + part] = own_rr
        meet(gate, workers)
        rz = wp.float64(0.0)
        rr = wp.float64(0.0)
        for k in range(parts):
            rz += system.partial[k]
            rr += system.partial[parts + k]
        start = wp.sqrt(rr)
        goal = wp.max(tolerance * tolerance * rr, absolute_tolerance * absolute_tolerance)
        count = wp.int32(0)
        while rr > goal and count < maximum:
            for part in range(lower, upper):
                own_pq = wp.float64(0.0)
                for i in range(flow.count * part / parts, flow.count * (part + 1) / parts):
                    own = system.direction[i]
                    sum = matrix.diagonal[i] * own - product(
                        matrix.near, matrix.coefficient, system.direction, i * matrix.near_capacity,
                        matrix.near_count[i],
                    )  # fmt: skip
                    sum = f.bounded(sum, own, matrix.position[i], matrix.free[i], matrix.drag[i])
                    system.product[i] = sum
                    own_pq += f.inner(own, sum)
                system.partial[2 * parts + part] = own_pq
            meet(gate, workers)
            pq = wp.float64(0.0)
            for k in range(parts):
                pq += system.partial[2 * parts + k]
            if pq <= wp.float64(0.0):
                break
            alpha = scalar(rz / pq)
            for part in range(lower, upper):
                own_rz = wp.float64(0.0)
                own_rr = wp.float64(0.0)
                for i in range(flow.count * part / parts, flow.count * (part + 1) / parts):
                    x[i] = x[i] + alpha * system.direction[i]
                    left = system.residual[i] - alpha * system.product[i]
                    system.residual[i] = left
                    z = f.divided(left, matrix.free[i], matrix.diagonal[i], matrix.drag[i])
                    system.product[i] = z
                    own_rz += f.inner(left, z)
                    own_rr += f.inner(left, left)
                system.partial[part] = own_rz
                system.partial[parts + part] = own_rr
            meet(gate, workers)
            rz_after = wp.float64(0.0)
            rr = wp.float64(0.0)
            for k in range(parts):
                rz_after += system.partial[k]
                rr += system.partial[parts + k]
            beta = scalar(rz_after / rz)
            rz = rz_after
            for i in range(flow.count * lower / parts, flow.count * upper / parts):
                system.direction[i] = system.product[i] + beta * system.direction[i]
            if lower == 0 and count < system.history.shape[0]:
                system.history[count] = wp.sqrt(rr)
            count += 1
            meet(gate, workers)
        if lower == 0:
            system.outcome[ITERATIONS] = wp.float64(count)
            system.outcome[BEFORE] = start
            system.outcome[AFTER] = wp.sqrt(rr)
            if not rr <= goal:
                flags[FAILED] = what
        # Nobody may look at the flags before all have left the loop.
        meet(gate, workers)
        if lower == 0 and flags[FAILED] != 0:
            flags[HALTED] = 1
        meet(gate, workers)

    return solve


@functools.cache
def parallel_start(scalar, dimensions: int, vector: bool):
    """Kernels `begin` and `ready`, launched in whole blocks: the first direction, and whether there is work to do."""
    f = solver_functions(scalar, dimensions, vector)
    Solve = f.Solve
    Flow = flow_struct(scalar)
    structs = array_structs(scalar, dimensions)
    Matrix = structs.Matrix

    @wp.kernel(enable_backward=False, module="unique")
    def begin(flow: Flow, blocks: wp.int32, matrix: Matrix, system: Solve):
        i = wp.tid()
        rz = wp.float64(0.0)
        rr = wp.float64(0.0)
        if i < flow.count:
            z = f.divided(system.residual[i], matrix.free[i], matrix.diagonal[i], matrix.drag[i])
            system.direction[i] = z
            rz = f.inner(system.residual[i], z)
            rr = f.inner(system.residual[i], system.residual[i])
        keep(i, system.partial, 0, rz)
        keep(i, system.partial, blocks, rr)

    @wp.kernel(enable_backward=False, module="unique")
    def ready(
        blocks: wp.int32, tolerance: wp.float64, absolute_tolerance: wp.float64, flags: wp.array(dtype=wp.int32),
        system: Solve,
    ):  # fmt: skip
        i = wp.tid()
        rz = total(i, system.partial, 0, blocks)
        rr = total(i, system.partial, blocks, blocks)
        if i == 0:
            goal = wp.max(tolerance * tolerance * rr, absolute_tolerance * absolute_tolerance)
            system.numbers[0] = rz
            system.numbers[2] = goal
            system.going[0] = 0
            if flags[HALTED] == 0:
                system.outcome[ITERATIONS] = wp.float64(0.0)
                system.outcome[BEFORE] = wp.sqrt(rr)
                system.outcome[AFTER] = wp.sqrt(rr)
                if rr > goal:
                    system.going[0] = 1

    return begin, ready


@functools.cache
def parallel_iteration(scalar, dimensions: int, vector: bool):
    """Kernels `multiply`, `update` and `direct`, one iteration, launched in whole blocks; they add to `x`.

    `now` is 0 and 1 in turn: which of two numbers holds the inner product of residual and preconditioned residual.
    """
    t = mps_types(scalar, dimensions)
    f = solver_functions(scalar, dimensions, vector)
    value = f.value

    @wp.kernel(enable_backward=False, module="unique")
    def multiply(
        count: wp.int32,
        blocks: wp.int32,
        matrix_near_capacity: wp.int32,
        matrix_near_count: wp.array(dtype=wp.int32),
        matrix_near: wp.array(dtype=wp.int32),
        matrix_coefficient: wp.array(dtype=scalar),
        matrix_diagonal: wp.array(dtype=scalar),
        matrix_drag: wp.array(dtype=scalar),
        matrix_free: wp.array(dtype=wp.int32),
        matrix_position: wp.array(dtype=t.vec),
        system_direction: wp.array(dtype=value),
        system_product: wp.array(dtype=value),
        system_partial: wp.array(dtype=wp.float64),
        system_going: wp.array(dtype=wp.int32),
    ):
        if system_going[0] == 0:
            return
        i = wp.tid()
        pq = wp.float64(0.0)
        if i < count:
            own = system_direction[i]
            sum = matrix_diagonal[i] * own
            for k in range(matrix_near_count[i]):
                at = place_by_entry(i, k, count, matrix_near_capacity)
                sum -= matrix_coefficient[at] * system_direction[matrix_near[at]]
            sum = f.bounded(sum, own, matrix_position[i], matrix_free[i], matrix_drag[i])
            system_product[i] = sum
            pq = f.inner(own, sum)
        keep(i, system_partial, 2 * blocks, pq)

    @wp.kernel(enable_backward=False, module="unique")
    def update(
        count: wp.int32,
        blocks: wp.int32,
        now: wp.int32,
        matrix_diagonal: wp.array(dtype=scalar),
        matrix_drag: wp.array(dtype=scalar),
        matrix_free: wp.array(dtype=wp.int32),
        system_residual: wp.array(dtype=value),
        system_direction: wp.array(dtype=value),
        system_product: wp.array(dtype=value),
        system_partial: wp.array(dtype=wp.float64),
        system_numbers: wp.array(dtype=wp.float64),
        system_going: wp.array(dtype=wp.int32),
        x: wp.array(dtype=value),
    ):
        if system_going[0] == 0:
            return
        i = wp.tid()
        pq = total(i, system_partial, 2 * blocks, blocks)
        alpha = scalar(0.0)
        if pq > wp.float64(0.0):
            alpha = scalar(system_numbers[now] / pq)
        rz = wp.float64(0.0)
        rr = wp.float64(0.0)
        if i < count:
            x[i] = x[i] + alpha * system_direction[i]
            left = system_residual[i] - alpha * system_product[i]
            system_residual[i] = left
            z = f.divided(left, matrix_free[i], matrix_diagonal[i], matrix_drag[i])
            system_product[i] = z
            rz = f.inner(left, z)
            rr = f.inner(left, left)
        keep(i, system_partial, 0, rz)
        keep(i, system_partial, blocks, rr)

    @wp.kernel(enable_backward=False, module="unique")
    def direct(
        count: wp.int32,
        blocks: wp.int32,
        now: wp.int32,
        what: wp.int32,
        maximum: wp.int32,
        flags: wp.array(dtype=wp.int32),
        system_direction: wp.array(dtype=value),
        system_product: wp.array(dtype=value),
        system_partial: wp.array(dtype=wp.float64),
        system_numbers: wp.array(dtype=wp.float64),
        system_outcome: wp.array(dtype=wp.float64),
        system_history: wp.array(dtype=wp.float64),
        system_going: wp.array(dtype=wp.int32),
    ):
        # The first block may end the loop while others set out: what they then leave out, nobody reads.
        if system_going[0] == 0:
            return
        i = wp.tid()
        rz = total(i, system_partial, 0, blocks)
        beta = scalar(rz / system_numbers[now])
        if i < count:
            system_direction[i] = system_product[i] + beta * system_direction[i]
        if i < BLOCK:
            rr = total(i, system_partial, blocks, blocks)
            if i == 0:
                done = wp.int32(system_outcome[ITERATIONS])
                if done < system_history.shape[0]:
                    system_history[done] = wp.sqrt(rr)
                done += 1
                system_outcome[ITERATIONS] = wp.float64(done)
                system_outcome[AFTER] = wp.sqrt(rr)
                system_numbers[1 - now] = rz
                if rr <= system_numbers[2]:
                    system_going[0] = 0
                elif not (rr > system_numbers[2]) or done >= maximum:
                    system_going[0] = 0
                    flags[FAILED] = what
                    flags[HALTED] = 1

    return multiply, update, direct
