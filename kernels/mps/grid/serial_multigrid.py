"""Conjugate gradients with a multigrid preconditioner on a CPU, for the linear systems of a flow on a grid.

One kernel performs a whole solve. Each thread processes some chunks of rows and waits for the others at barriers. Sums
are computed in the same order for any number of threads, so results are reproducible. `multigrid.py` has the operations
of the preconditioner, and `resident_multigrid.py` the solver for a GPU.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ...common.barrier import meet
from ...common.control import FAILED, HALTED
from ...common.rows import row_product
from ...common.types import cpu_flags
from ..conjugate_gradient import AFTER, BEFORE, ITERATIONS, sum_of
from .levels import system_structs
from .multigrid import cycle_functions


@functools.cache
def serial_functions(scalar) -> SimpleNamespace:
    """Build the functions by which a CPU thread processes its rows in a solve.

    `precondition` applies the preconditioner. Each of the other functions processes a range of the list of rows with
    unknowns.
    """
    structs = system_structs(scalar)
    Matrix, Solve = structs.Matrix, structs.Solve
    f = cycle_functions(scalar, True)
    product = row_product(scalar, scalar)

    @wp.func
    def precondition(
        parts: wp.int32, lower: wp.int32, upper: wp.int32, workers: wp.int32, gate: wp.array(dtype=wp.int32),
        matrix: Matrix, system: Solve,
    ):  # fmt: skip
        """Compute the preconditioned residual by one multigrid cycle.

        The caller must first run `start` in all threads and place a barrier.
        """
        turns = matrix.cycle.shape[0] / 4
        few = wp.bool(False)
        for turn in range(turns):
            next_few = wp.bool(False)
            few = f.is_few(matrix, turn)
            if turn + 1 < turns:
                next_few = f.is_few(matrix, turn + 1)
            level = f.target(matrix, turn)
            begin = matrix.begin[level]
            count = matrix.begin[level + 1] - begin
            first = begin + count * lower / parts
            end = begin + count * upper / parts
            if few:
                first = begin
                end = wp.where(lower == 0, begin + count, begin)
            f.operate(turn, first, 0, end, 1, matrix, system)
            if turn + 1 < turns and not (few and next_few):
                meet(gate, workers)

    @wp.func
    def start(first: wp.int32, end: wp.int32, alpha: scalar, matrix: Matrix, system: Solve, x: wp.array(dtype=scalar)):
        """Move the solution by `alpha` along the search direction, update the residual, and begin the preconditioner.

        The preconditioner begins with a smoothing step from zero. The function returns the squared norm of the residual
        of these rows.
        """
        rr = wp.float64(0.0)
        odd = matrix.cycle.shape[0] > 0
        for k in range(first, end):
            i = matrix.used[k]
            left = system.residual[i]
            if alpha != scalar(0.0):
                x[i] = x[i] + alpha * system.direction[i]
                left = left - alpha * system.product[i]
                system.residual[i] = left
            guess = matrix.smoothing[i] * left
            if odd:
                system.odd[i] = guess
            else:
                system.even[i] = guess
            rr += wp.float64(left) * wp.float64(left)
        return rr

    @wp.func
    def multiply(first: wp.int32, end: wp.int32, matrix: Matrix, system: Solve) -> wp.float64:
        """Multiply the matrix by the search direction, and return the inner product of the direction and the result."""
        pq = wp.float64(0.0)
        for k in range(first, end):
            i = matrix.used[k]
            own = system.direction[i]
            sum = matrix.diagonal[i] * own - product(
                matrix.near, matrix.coefficient, system.direction, i * matrix.near_capacity, matrix.near_count[i]
            )
            system.product[i] = sum
            pq += wp.float64(own) * wp.float64(sum)
        return pq

    @wp.func
    def inner(first: wp.int32, end: wp.int32, matrix: Matrix, system: Solve) -> wp.float64:
        """Return the inner product of the residual and the preconditioned residual over some rows."""
        rz = wp.float64(0.0)
        for k in range(first, end):
            i = matrix.used[k]
            rz += wp.float64(system.residual[i]) * wp.float64(system.even[i])
        return rz

    @wp.func
    def turn_direction(first: wp.int32, end: wp.int32, beta: scalar, matrix: Matrix, system: Solve):
        for k in range(first, end):
            i = matrix.used[k]
            now = system.even[i]
            if beta != scalar(0.0):
                now = now + beta * system.direction[i]
            system.direction[i] = now

    return SimpleNamespace(
        precondition=precondition, start=start, multiply=multiply, inner=inner, turn_direction=turn_direction
    )


@functools.cache
def serial_multigrid(scalar):
    """Build the CPU kernel that solves a linear system and adds the solution to `x`.

    Each of `workers` threads launches the kernel once. The rows with unknowns are divided into `parts` chunks, and a
    thread processes the chunks from `lower` to `upper` - 1.
    """
    structs, f = system_structs(scalar), serial_functions(scalar)
    Matrix, Solve = structs.Matrix, structs.Solve

    @wp.kernel(enable_backward=False, module="unique", module_options={"cpu_compiler_flags": cpu_flags()})
    def solve(
        # The next arguments are the error code that is stored if the solve fails, the relative tolerance, and the
        # maximum number of iterations.
        what: wp.int32,
        tolerance: wp.float64,
        maximum: wp.int32,
        # The next arguments are the number of all chunks, the first chunk of this thread and the end of its range of
        # chunks, the number of threads, and the barrier at which the threads wait for each other.
        parts: wp.int32,
        lower: wp.int32,
        upper: wp.int32,
        workers: wp.int32,
        gate: wp.array(dtype=wp.int32),
        # The next argument is the matrix of the linear system, which this kernel only reads.
        matrix: Matrix,
        # The next arguments are arrays that this kernel writes.
        flags: wp.array(dtype=wp.int32),
        system: Solve,
        x: wp.array(dtype=scalar),
    ):
        if flags[HALTED] != 0:
            return
        # Preconditioned conjugate gradients (Saad, Iterative Methods for Sparse Linear Systems, 2nd ed., algorithm
        # 9.1). With residual r, preconditioned residual z, search direction p and q = A p, the names of the inner
        # products are rz = r.z, rr = r.r and pq = p.q.
        rows = matrix.begin[1]
        for part in range(lower, upper):
            system.partial[part] = f.start(
                rows * part / parts, rows * (part + 1) / parts, scalar(0.0), matrix, system, x
            )
        meet(gate, workers)
        rr = sum_of(system.partial, 0, parts)
        before = wp.sqrt(rr)
        goal = wp.max(tolerance * tolerance * rr, system.stop_norm[0] * system.stop_norm[0])
        count = wp.int32(0)
        rz = wp.float64(1.0)
        while rr > goal and count < maximum:
            f.precondition(parts, lower, upper, workers, gate, matrix, system)
            for part in range(lower, upper):
                system.partial[parts + part] = f.inner(rows * part / parts, rows * (part + 1) / parts, matrix, system)
            meet(gate, workers)
            last = rz
            rz = sum_of(system.partial, parts, parts)
            beta = scalar(0.0)
            if count > 0:
                beta = scalar(rz / last)
            f.turn_direction(rows * lower / parts, rows * upper / parts, beta, matrix, system)
            meet(gate, workers)
            for part in range(lower, upper):
                system.partial[2 * parts + part] = f.multiply(
                    rows * part / parts, rows * (part + 1) / parts, matrix, system
                )
            meet(gate, workers)
            pq = sum_of(system.partial, 2 * parts, parts)
            if pq <= wp.float64(0.0):
                break
            alpha = scalar(rz / pq)
            for part in range(lower, upper):
                system.partial[part] = f.start(rows * part / parts, rows * (part + 1) / parts, alpha, matrix, system, x)
            meet(gate, workers)
            rr = sum_of(system.partial, 0, parts)
            if lower == 0 and count < system.history.shape[0]:
                system.history[count] = wp.sqrt(rr)
            count += 1
        if lower == 0:
            system.outcome[ITERATIONS] = wp.float64(count)
            system.outcome[BEFORE] = before
            system.outcome[AFTER] = wp.sqrt(rr)
            if not rr <= goal:
                flags[FAILED] = what
        # All threads must have left the loop before any thread changes the flag that halts the flow.
        meet(gate, workers)
        if lower == 0 and flags[FAILED] != 0:
            flags[HALTED] = 1
        meet(gate, workers)

    return solve
