"""Conjugate gradients on a GPU: a whole solve is one kernel, whose blocks stay resident and meet at barriers.

The rows of the matrix are divided into chunks with as many rows as a block has threads. Each block processes several
chunks, and each chunk forms one partial sum. Sums therefore have the same bits however many blocks there are. A flow
may use many blocks while no other flow runs, and few while it shares the GPU.

Iterations need no launches by the host, so the solves of many flows can run at the same time. A small system gets a
single wide block, which needs no barrier and no partial sums. `conjugate_gradient.py` explains the rows of the matrix.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.control import FAILED, HALTED
from ..common.reductions import BLOCK, block_sums
from ..common.resident import gather
from ..common.rows import directed_product
from .conjugate_gradient import AFTER, BEFORE, ITERATIONS, solver_functions
from .structs import array_structs

RESIDENT = 3
"""Number of blocks that must fit on a multiprocessor of the GPU at once. The launch bounds of the kernels therefore
limit a thread to 85 registers."""
WIDE, SMALL = 1024, 40_000
"""A linear system with at most SMALL matrix entries is solved by a single block of WIDE threads."""


def resident_blocks(device, rows: int, near_capacity: int, abreast: int) -> tuple[int, int]:
    """Return the threads per block and the number of blocks for one of `abreast` solves that share the device.

    The matrix of the solve has the given number of `rows` with at most `near_capacity` off-diagonal entries each.
    """
    if rows * near_capacity <= SMALL:
        return WIDE, 1
    room = RESIDENT * device.sm_count // abreast if device.is_cuda else 1
    return BLOCK, max(1, min(-(-rows // BLOCK), room))


@functools.cache
def sum_functions(width: int) -> SimpleNamespace:
    """Build `accumulate` and `total_of`, which sum a value over all threads of all blocks; a block has `width` threads.

    Each thread passes its contributions to `accumulate` and adds up the results. After a barrier, it passes this sum to
    `total_of`, which returns the total. If there are several blocks, `accumulate` stores the sum of each block in the
    array `partial` and returns 0. All sums of threads are then zero, and `total_of` adds up the values in `partial`.
    """
    alone = width == WIDE
    keep, total = block_sums(width).keep, block_sums(width).total

    @wp.func
    def accumulate(
        thread: wp.int32, partial: wp.array(dtype=wp.float64), first: wp.int32, own: wp.float64
    ) -> wp.float64:
        """Add a thread's contribution `own` to a sum that `total_of` completes after a barrier.

        If there are several blocks, the contributions of a block's threads are summed and stored in `partial`, and the
        result is 0. If there is only one block, nothing is stored and the result is `own`. Each thread adds up its
        results of this function and passes the sum to `total_of`.
        """
        if wp.static(alone):
            return own
        else:
            keep(thread, partial, first, own)
            return wp.float64(0.0)

    @wp.func
    def total_of(own: wp.float64, lane: wp.int32, partial: wp.array(dtype=wp.float64), first: wp.int32, sums: wp.int32):
        """Return the sum over all threads of all blocks; all blocks must have met at a barrier after `accumulate`."""
        if wp.static(alone):
            whole = wp.tile_sum(wp.tile(own))
            return whole[0]
        else:
            return total(lane, partial, first, sums)

    return SimpleNamespace(accumulate=accumulate, total_of=total_of)


@functools.cache
def row_functions(scalar, dimensions: int, vector: bool, rigid: bool) -> SimpleNamespace:
    """Build the functions that a GPU thread applies to a row of the equations, or to a rigid grain, in a solve.

    Here r is the residual, z the preconditioned residual, p the search direction and A the matrix. `begin` and `update`
    return the contributions of one row to the inner products of r with z and of r with itself, and `share` returns the
    contributions of one grain. `multiply` returns the row's contribution to the inner product of p with A p.
    """
    f = solver_functions(scalar, dimensions, vector)
    Solve, value = f.Solve, f.value
    Matrix = array_structs(scalar, dimensions).Matrix
    product = directed_product(scalar, value)

    @wp.func
    def begin(i: wp.int32, count: wp.int32, matrix: Matrix, system: Solve):
        rz = wp.float64(0.0)
        rr = wp.float64(0.0)
        mine = i < count
        if wp.static(rigid):
            mine = mine and i >= matrix.grain_rows
        if mine:
            z = f.divided(system.residual[i], matrix.free[i], matrix.diagonal[i], matrix.drag[i])
            system.preconditioned[i] = z
            rz = f.inner(system.residual[i], z)
            rr = f.inner(system.residual[i], system.residual[i])
        return rz, rr

    @wp.func
    def multiply(
        i: wp.int32, count: wp.int32, beta: scalar, old: wp.int32, matrix: Matrix, system: Solve
    ) -> wp.float64:
        """Compute the new search direction of row `i`, and this row of the matrix times the search directions.

        `old` is the index in the array `direction` at which the previous search directions begin. The function computes
        the new directions of the neighbouring rows itself from their previous directions. No barrier is therefore
        needed before the product.
        """
        if i >= count:
            return wp.float64(0.0)
        own = system.preconditioned[i] + beta * system.direction[old + i]
        system.direction[count - old + i] = own
        sum = matrix.diagonal[i] * own - product(
            matrix.near, matrix.coefficient, system.preconditioned, system.direction, beta, old, i, count,
            matrix.near_count[i],
        )  # fmt: skip
        sum = f.bounded(sum, own, matrix.position[i], matrix.free[i], matrix.drag[i])
        system.product[i] = sum
        return f.inner(own, sum)

    @wp.func
    def update(
        i: wp.int32, count: wp.int32, alpha: scalar, old: wp.int32, matrix: Matrix, system: Solve,
        x: wp.array(dtype=value),
    ):  # fmt: skip
        rz = wp.float64(0.0)
        rr = wp.float64(0.0)
        if i < count:
            x[i] = x[i] + alpha * system.direction[count - old + i]
            left = system.residual[i] - alpha * system.product[i]
            system.residual[i] = left
            if not wp.static(rigid) or i >= matrix.grain_rows:
                z = f.divided(left, matrix.free[i], matrix.diagonal[i], matrix.drag[i])
                system.preconditioned[i] = z
                rz = f.inner(left, z)
                rr = f.inner(left, left)
        return rz, rr

    @wp.func
    def share(g: wp.int32, matrix: Matrix, system: Solve):
        rz = wp.float64(0.0)
        rr = wp.float64(0.0)
        if wp.static(rigid):
            if g < matrix.grains.mobility.shape[0]:
                rz, rr = f.share(g, matrix.grains, matrix.position, system.residual, system.preconditioned)
        return rz, rr

    return SimpleNamespace(begin=begin, multiply=multiply, update=update, share=share)


@functools.cache
def resident_solver(scalar, dimensions: int, vector: bool, rigid: bool = False, width: int = BLOCK):
    """Build the GPU kernel that solves a linear system by conjugate gradients and adds the solution to `x`.

    The kernel runs as `parties` blocks of `width` threads. With `width` = WIDE there must be only one block.
    """
    accumulate, total_of = sum_functions(width).accumulate, sum_functions(width).total_of
    f, row = solver_functions(scalar, dimensions, vector), row_functions(scalar, dimensions, vector, rigid)
    Solve, value = f.Solve, f.value
    Matrix = array_structs(scalar, dimensions).Matrix

    @wp.kernel(enable_backward=False, module="unique", launch_bounds=(width, 1 if width == WIDE else RESIDENT))
    def solve(
        # The next arguments are the number of rows, the error code that is stored if the solve fails, the relative
        # tolerance, and the maximum number of iterations.
        count: wp.int32,
        what: wp.int32,
        tolerance: wp.float64,
        maximum: wp.int32,
        # The next arguments are the number of blocks, and the barrier at which the blocks wait for each other.
        parties: wp.int32,
        gate: wp.array(dtype=wp.int32),
        # The next arguments hold the state of the flow, which this kernel only reads.
        matrix: Matrix,
        # The next arguments are arrays that this kernel writes.
        flags: wp.array(dtype=wp.int32),
        system: Solve,
        x: wp.array(dtype=value),
    ):
        # Preconditioned conjugate gradients (Saad, Iterative Methods for Sparse Linear Systems, 2nd ed., algorithm
        # 9.1). With residual r, preconditioned residual z, search direction p and q = A p, the names of the inner
        # products are rz = r.z, rr = r.r and pq = p.q.
        thread = wp.tid()
        lane = thread % width
        block = thread / width
        halted = flags[HALTED]
        # In the array `partial`, the sums of the chunks of rows come first, then those of the chunks of rigid grains.
        blocks = (count + width - 1) / width
        sums = blocks
        if wp.static(rigid):
            sums += (matrix.grains.mobility.shape[0] + width - 1) / width
        rz = wp.float64(0.0)
        rr = wp.float64(0.0)
        for chunk in range(block, sums, parties):
            if chunk < blocks:
                own_rz, own_rr = row.begin(chunk * width + lane, count, matrix, system)
            else:
                own_rz, own_rr = row.share((chunk - blocks) * width + lane, matrix, system)
            rz += accumulate(chunk * width + lane, system.partial, 0, own_rz)
            rr += accumulate(chunk * width + lane, system.partial, sums, own_rr)
        gather(gate, parties)
        rz = total_of(rz, lane, system.partial, 0, sums)
        rr = total_of(rr, lane, system.partial, sums, sums)
        start = wp.sqrt(rr)
        goal = wp.max(tolerance * tolerance * rr, system.stop_norm[0] * system.stop_norm[0])
        done = wp.int32(0)
        beta = scalar(0.0)
        old = count
        if halted != 0:
            rr = wp.float64(0.0)
            goal = wp.float64(0.0)
        while rr > goal and done < maximum:
            pq = wp.float64(0.0)
            for chunk in range(block, blocks, parties):
                own_pq = row.multiply(chunk * width + lane, count, beta, old, matrix, system)
                pq += accumulate(chunk * width + lane, system.partial, 2 * sums, own_pq)
            gather(gate, parties)
            pq = total_of(pq, lane, system.partial, 2 * sums, blocks)
            alpha = scalar(0.0)
            if pq > wp.float64(0.0):
                alpha = scalar(rz / pq)
            rz_after = wp.float64(0.0)
            rr = wp.float64(0.0)
            for chunk in range(block, blocks, parties):
                own_rz, own_rr = row.update(chunk * width + lane, count, alpha, old, matrix, system, x)
                rz_after += accumulate(chunk * width + lane, system.partial, 0, own_rz)
                rr += accumulate(chunk * width + lane, system.partial, sums, own_rr)
            if wp.static(rigid):
                gather(gate, parties)
                for chunk in range(blocks + block, sums, parties):
                    own_rz, own_rr = row.share((chunk - blocks) * width + lane, matrix, system)
                    rz_after += accumulate(chunk * width + lane, system.partial, 0, own_rz)
                    rr += accumulate(chunk * width + lane, system.partial, sums, own_rr)
            gather(gate, parties)
            rz_after = total_of(rz_after, lane, system.partial, 0, sums)
            rr = total_of(rr, lane, system.partial, sums, sums)
            beta = scalar(rz_after / rz)
            rz = rz_after
            old = count - old
            if thread == 0 and done < system.history.shape[0]:
                system.history[done] = wp.sqrt(rr)
            done += 1
        if thread == 0 and halted == 0:
            system.outcome[ITERATIONS] = wp.float64(done)
            system.outcome[BEFORE] = start
            system.outcome[AFTER] = wp.sqrt(rr)
            if not rr <= goal:
                flags[FAILED] = what
                flags[HALTED] = 1

    return solve
