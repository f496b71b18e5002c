"""Conjugate gradients with a multigrid preconditioner on a GPU, for the linear systems of a flow on a grid.

One kernel performs a whole solve. Each block of threads processes some chunks of rows and waits for the other blocks at
barriers. Sums are computed in the same order for any number of blocks, so results are reproducible. `multigrid.py` has
the operations of the preconditioner, and `serial_multigrid.py` the solver for a CPU.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ...common.control import FAILED, HALTED
from ...common.reductions import BLOCK
from ...common.resident import gather
from ...common.rows import directed_product
from ..conjugate_gradient import AFTER, BEFORE, ITERATIONS
from ..resident_solver import RESIDENT, WIDE, sum_functions
from .levels import system_structs
from .multigrid import cycle_functions


@functools.cache
def resident_functions(scalar, width: int) -> SimpleNamespace:
    """Build the functions by which a GPU thread processes its rows in a solve; a block has `width` threads.

    `precondition` applies the preconditioner. Each of the other functions processes one row: the row at position `k` in
    the list of rows with unknowns.
    """
    structs = system_structs(scalar)
    Matrix, Solve = structs.Matrix, structs.Solve
    f = cycle_functions(scalar, False)
    product = directed_product(scalar, scalar)

    @wp.func
    def precondition(
        thread: wp.int32, parties: wp.int32, gate: wp.array(dtype=wp.int32), matrix: Matrix, system: Solve
    ):
        """Compute the preconditioned residual by one multigrid cycle.

        The caller must first run `start` in all blocks and place a barrier. All blocks meet at another barrier at the
        end.
        """
        turns = matrix.cycle.shape[0] / 4
        for turn in range(turns):
            few = f.is_few(matrix, turn)
            next_few = wp.bool(False)
            if turn + 1 < turns:
                next_few = f.is_few(matrix, turn + 1)
            level = f.target(matrix, turn)
            begin = matrix.begin[level]
            end = matrix.begin[level + 1]
            by = parties * width
            if few:
                by = width
                if thread >= width:
                    end = begin
            f.operate(turn, begin, thread, end, by, matrix, system)
            gather(gate, wp.where(few and next_few, 1, parties))

    @wp.func
    def start(
        k: wp.int32, rows: wp.int32, alpha: scalar, first: wp.int32, matrix: Matrix, system: Solve,
        x: wp.array(dtype=scalar),
    ) -> wp.float64:  # fmt: skip
        """Move the solution by `alpha` along the search direction, update the residual, and begin the preconditioner.

        The preconditioner begins with a smoothing step from zero. `first` is the index in `Solve.direction` at which
        the search direction begins. The function returns the row's contribution to the squared norm of the residual.
        """
        if k >= rows:
            return wp.float64(0.0)
        i = matrix.used[k]
        left = system.residual[i]
        if alpha != scalar(0.0):
            x[i] = x[i] + alpha * system.direction[first + i]
            left = left - alpha * system.product[i]
            system.residual[i] = left
        guess = matrix.smoothing[i] * left
        if matrix.cycle.shape[0] > 0:
            system.odd[i] = guess
        else:
            system.even[i] = guess
        return wp.float64(left) * wp.float64(left)

    @wp.func
    def inner(k: wp.int32, rows: wp.int32, matrix: Matrix, system: Solve) -> wp.float64:
        if k >= rows:
            return wp.float64(0.0)
        i = matrix.used[k]
        return wp.float64(system.residual[i]) * wp.float64(system.even[i])

    @wp.func
    def multiply(
        k: wp.int32, rows: wp.int32, beta: scalar, old: wp.int32, new: wp.int32, matrix: Matrix, system: Solve
    ) -> wp.float64:  # fmt: skip
        """Compute the new search direction in a row, and the product of this row of the matrix and the new direction.

        In `Solve.direction`, the previous direction begins at index `old`, and the new direction at `new`. The function
        computes the new direction in the neighbouring rows itself, so no barrier is needed before the product.
        """
        if k >= rows:
            return wp.float64(0.0)
        i = matrix.used[k]
        own = system.even[i] + beta * system.direction[old + i]
        system.direction[new + i] = own
        sum = matrix.diagonal[i] * own - product(
            matrix.near, matrix.coefficient, system.even, system.direction, beta, old, i, matrix.rows,
            matrix.near_count[i],
        )  # fmt: skip
        system.product[i] = sum
        return wp.float64(own) * wp.float64(sum)

    return SimpleNamespace(precondition=precondition, start=start, inner=inner, multiply=multiply)


@functools.cache
def resident_multigrid(scalar, width: int = BLOCK):
    """Build the GPU kernel that solves a linear system and adds the solution to `x`.

    The kernel runs as `parties` blocks of `width` threads. With `width` = WIDE there must be only one block. The rows
    with unknowns are divided into chunks of `width` rows. Block k processes the chunks k, k + `parties`,
    k + 2 `parties` and so on.
    """
    accumulate, total_of = sum_functions(width).accumulate, sum_functions(width).total_of
    structs, f = system_structs(scalar), resident_functions(scalar, width)
    Matrix, Solve = structs.Matrix, structs.Solve

    @wp.kernel(enable_backward=False, module="unique", launch_bounds=(width, 1 if width == WIDE else RESIDENT))
    def solve(
        # The next arguments are the error code that is stored if the solve fails, the relative tolerance, the maximum
        # number of iterations, the number of blocks, and the barrier at which the blocks wait for each other.
        what: wp.int32,
        tolerance: wp.float64,
        maximum: wp.int32,
        parties: wp.int32,
        gate: wp.array(dtype=wp.int32),
        # The next argument is the matrix of the linear system, which this kernel only reads.
        matrix: Matrix,
        # The next arguments are arrays that this kernel writes.
        flags: wp.array(dtype=wp.int32),
        system: Solve,
        x: wp.array(dtype=scalar),
    ):
        # A comment in `serial_multigrid.py` explains the names of the inner products, such as `rz`.
        thread = wp.tid()
        lane = thread % width
        block = thread / width
        halted = flags[HALTED]
        rows = matrix.begin[1]
        chunks = (rows + width - 1) / width
        finest = matrix.first[1]
        rr = wp.float64(0.0)
        for chunk in range(block, chunks, parties):
            own = f.start(chunk * width + lane, rows, scalar(0.0), 0, matrix, system, x)
            rr += accumulate(chunk * width + lane, system.partial, 0, own)
        gather(gate, parties)
        rr = total_of(rr, lane, system.partial, 0, chunks)
        before = wp.sqrt(rr)
        goal = wp.max(tolerance * tolerance * rr, system.stop_norm[0] * system.stop_norm[0])
        done = wp.int32(0)
        rz = wp.float64(1.0)
        old = finest
        if halted != 0:
            rr = wp.float64(0.0)
            goal = wp.float64(0.0)
        while rr > goal and done < maximum:
            f.precondition(thread, parties, gate, matrix, system)
            last = rz
            rz = wp.float64(0.0)
            for chunk in range(block, chunks, parties):
                own = f.inner(chunk * width + lane, rows, matrix, system)
                rz += accumulate(chunk * width + lane, system.partial, chunks, own)
            gather(gate, parties)
            rz = total_of(rz, lane, system.partial, chunks, chunks)
            beta = scalar(0.0)
            if done > 0:
                beta = scalar(rz / last)
            pq = wp.float64(0.0)
            for chunk in range(block, chunks, parties):
                own = f.multiply(chunk * width + lane, rows, beta, old, finest - old, matrix, system)
                pq += accumulate(chunk * width + lane, system.partial, 2 * chunks, own)
            gather(gate, parties)
            pq = total_of(pq, lane, system.partial, 2 * chunks, chunks)
            alpha = scalar(0.0)
            if pq > wp.float64(0.0):
                alpha = scalar(rz / pq)
            rr = wp.float64(0.0)
            for chunk in range(block, chunks, parties):
                own = f.start(chunk * width + lane, rows, alpha, finest - old, matrix, system, x)
                rr += accumulate(chunk * width + lane, system.partial, 0, own)
            gather(gate, parties)
            rr = total_of(rr, lane, system.partial, 0, chunks)
            old = finest - old
            if thread == 0 and done < system.history.shape[0]:
                system.history[done] = wp.sqrt(rr)
            done += 1
        if thread == 0 and halted == 0:
            system.outcome[ITERATIONS] = wp.float64(done)
            system.outcome[BEFORE] = before
            system.outcome[AFTER] = wp.sqrt(rr)
            if not rr <= goal:
                flags[FAILED] = what
                flags[HALTED] = 1

    return solve
