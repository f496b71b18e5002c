"""Conjugate gradients on a GPU: a whole solve in one kernel, whose blocks stay and wait for one another.

Rows are in chunks of a block's threads, each of which forms one partial sum; blocks share out chunks. So sums are the
same to the bit however many blocks there are, and a flow may have many of them while it is alone and few beside others.
Nobody launches iterations, so solves of many flows go on at once. A small system has one wide block, which waits for
nobody and keeps its sums to itself. `conjugate_gradient.py` has what a row is.
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
"""Blocks that a multiprocessor surely has room for at once: their kernel takes 85 registers a thread at most."""
WIDE, SMALL = 1024, 40_000
"""Threads of the one block of a small system, and its matrix's entries at most."""


def resident_blocks(device, rows: int, near_capacity: int, abreast: int) -> tuple[int, int]:
    """Threads of a block, and blocks that a solve gets of a device, `abreast` of which may run at once."""
    if rows * near_capacity <= SMALL:
        return WIDE, 1
    room = RESIDENT * device.sm_count // abreast if device.is_cuda else 1
    return BLOCK, max(1, min(-(-rows // BLOCK), room))


@functools.cache
def sum_functions(width: int) -> SimpleNamespace:
    """`kept`, by each thread of blocks of so many, and `summed` over all."""
    alone = width == WIDE
    keep, total = block_sums(width).keep, block_sums(width).total

    @wp.func
    def kept(thread: wp.int32, partial: wp.array(dtype=wp.float64), first: wp.int32, own: wp.float64) -> wp.float64:
        """What a thread itself adds up: all if its block is alone, else nothing, as blocks keep sums of chunks."""
        if wp.static(alone):
            return own
        else:
            keep(thread, partial, first, own)
            return wp.float64(0.0)

    @wp.func
    def summed(own: wp.float64, lane: wp.int32, partial: wp.array(dtype=wp.float64), first: wp.int32, sums: wp.int32):
        """Over all threads; all must have waited for one another."""
        if wp.static(alone):
            whole = wp.tile_sum(wp.tile(own))
            return whole[0]
        else:
            return total(lane, partial, first, sums)

    return SimpleNamespace(kept=kept, summed=summed)


@functools.cache
def row_functions(scalar, dimensions: int, vector: bool, rigid: bool) -> SimpleNamespace:
    """What a thread does for its row, or grain, in a solve; each gives what it adds to the sums.

    `begin` and `update` give inner products of residual and preconditioned residual, and of the residual with itself;
    so does `share` for a grain; `multiply` that of direction and product.
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
            mine = mine and i >= matrix.bound
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
        """`old` is where the last directions begin; neighbours' new ones are formed anew: nobody waits for them."""
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
            if not wp.static(rigid) or i >= matrix.bound:
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
    """Kernel of `parties` blocks of `width` threads: the whole solve; adds to `x`. A wide block is alone."""
    kept, summed = sum_functions(width).kept, sum_functions(width).summed
    f, row = solver_functions(scalar, dimensions, vector), row_functions(scalar, dimensions, vector, rigid)
    Solve, value = f.Solve, f.value
    Matrix = array_structs(scalar, dimensions).Matrix

    @wp.kernel(enable_backward=False, module="unique", launch_bounds=(width, 1 if width == WIDE else RESIDENT))
    def solve(
        # Input: equations, error code, tolerance and iteration limit.
        count: wp.int32,
        what: wp.int32,
        tolerance: wp.float64,
        maximum: wp.int32,
        # Input: number of blocks, and their barrier.
        parties: wp.int32,
        gate: wp.array(dtype=wp.int32),
        # Input: state, which is only read.
        matrix: Matrix,
        # Output: arrays that are written.
        flags: wp.array(dtype=wp.int32),
        system: Solve,
        x: wp.array(dtype=value),
    ):
        thread = wp.tid()
        lane = thread % width
        block = thread / width
        halted = flags[HALTED]
        # Partial sums: of chunks of rows, then of chunks of grains.
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
            rz += kept(chunk * width + lane, system.partial, 0, own_rz)
            rr += kept(chunk * width + lane, system.partial, sums, own_rr)
        gather(gate, parties)
        rz = summed(rz, lane, system.partial, 0, sums)
        rr = summed(rr, lane, system.partial, sums, sums)
        start = wp.sqrt(rr)
        goal = wp.max(tolerance * tolerance * rr, system.least[0] * system.least[0])
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
                pq += kept(chunk * width + lane, system.partial, 2 * sums, own_pq)
            gather(gate, parties)
            pq = summed(pq, lane, system.partial, 2 * sums, blocks)
            alpha = scalar(0.0)
            if pq > wp.float64(0.0):
                alpha = scalar(rz / pq)
            rz_after = wp.float64(0.0)
            rr = wp.float64(0.0)
            for chunk in range(block, blocks, parties):
                own_rz, own_rr = row.update(chunk * width + lane, count, alpha, old, matrix, system, x)
                rz_after += kept(chunk * width + lane, system.partial, 0, own_rz)
                rr += kept(chunk * width + lane, system.partial, sums, own_rr)
            if wp.static(rigid):
                gather(gate, parties)
                for chunk in range(blocks + block, sums, parties):
                    own_rz, own_rr = row.share((chunk - blocks) * width + lane, matrix, system)
                    rz_after += kept(chunk * width + lane, system.partial, 0, own_rz)
                    rr += kept(chunk * width + lane, system.partial, sums, own_rr)
            gather(gate, parties)
            rz_after = summed(rz_after, lane, system.partial, 0, sums)
            rr = summed(rr, lane, system.partial, sums, sums)
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
