"""Conjugate gradients of a small system by one block of a GPU's threads; `conjugate_gradient.py` has the rest."""

import functools

import warp as wp

from ..common.control import FAILED, HALTED
from .conjugate_gradient import AFTER, BEFORE, ITERATIONS, solver_functions
from .structs import array_structs, place_by_entry

SMALL, WIDE = 40_000, 1024
"""Entries of a matrix whose solve one block of a GPU takes on, at most, and threads of that block. On an H200 it takes
0.6 to 0.8 of the time of many blocks at 22,000 to 38,000 entries, 1.3 at 43,000, 2.3 at 82,000.
"""


def in_one_block(scalar, rows: int, near_capacity: int) -> bool:
    """Does one block of a GPU take on a solve of so many rows with so many neighbours each?

    In double precision so many threads would need more registers than a multiprocessor has.
    """
    return scalar is wp.float32 and rows * near_capacity <= SMALL


@functools.cache
def block_solver(scalar, dimensions: int, vector: bool):
    """Kernel of one block of threads: the whole solve; adds to `x`."""
    f = solver_functions(scalar, dimensions, vector)
    Solve, value = f.Solve, f.value
    Matrix = array_structs(scalar, dimensions).Matrix

    @wp.func
    def added(own: wp.float64) -> wp.float64:
        """Sum over the block's threads, all of which have come this far then."""
        whole = wp.tile_sum(wp.tile(own))
        return whole[0]

    @wp.kernel(enable_backward=False, module="unique")
    def solve(
        count: wp.int32,
        what: wp.int32,
        tolerance: wp.float64,
        absolute_tolerance: wp.float64,
        maximum: wp.int32,
        matrix: Matrix,
        flags: wp.array(dtype=wp.int32),
        system: Solve,
        x: wp.array(dtype=value),
    ):
        lane = wp.tid()
        width = wp.block_dim()
        halted = flags[HALTED]
        own_rz = wp.float64(0.0)
        own_rr = wp.float64(0.0)
        for i in range(lane, count, width):
            z = f.divided(system.residual[i], matrix.free[i], matrix.diagonal[i], matrix.drag[i])
            system.direction[i] = z
            own_rz += f.inner(system.residual[i], z)
            own_rr += f.inner(system.residual[i], system.residual[i])
        rz = added(own_rz)
        rr = added(own_rr)
        start = wp.sqrt(rr)
        goal = wp.max(tolerance * tolerance * rr, absolute_tolerance * absolute_tolerance)
        done = wp.int32(0)
        if halted != 0:
            rr = wp.float64(0.0)
            goal = wp.float64(0.0)
        while rr > goal and done < maximum:
            own_pq = wp.float64(0.0)
            for i in range(lane, count, width):
                own = system.direction[i]
                sum = matrix.diagonal[i] * own
                for k in range(matrix.near_count[i]):
                    at = place_by_entry(i, k, count, matrix.near_capacity)
                    sum -= matrix.coefficient[at] * system.direction[matrix.near[at]]
                sum = f.bounded(sum, own, matrix.position[i], matrix.free[i], matrix.drag[i])
                system.product[i] = sum
                own_pq += f.inner(own, sum)
            pq = added(own_pq)
            alpha = scalar(0.0)
            if pq > wp.float64(0.0):
                alpha = scalar(rz / pq)
            own_rz = wp.float64(0.0)
            own_rr = wp.float64(0.0)
            for i in range(lane, count, width):
                x[i] = x[i] + alpha * system.direction[i]
                left = system.residual[i] - alpha * system.product[i]
                system.residual[i] = left
                z = f.divided(left, matrix.free[i], matrix.diagonal[i], matrix.drag[i])
                system.product[i] = z
                own_rz += f.inner(left, z)
                own_rr += f.inner(left, left)
            rz_after = added(own_rz)
            beta = scalar(rz_after / rz)
            rz = rz_after
            for i in range(lane, count, width):
                system.direction[i] = system.product[i] + beta * system.direction[i]
            # The last sum, so that nobody multiplies before all have their new directions.
            rr = added(own_rr)
            if lane == 0 and done < system.history.shape[0]:
                system.history[done] = wp.sqrt(rr)
            done += 1
        if lane == 0 and halted == 0:
            system.outcome[ITERATIONS] = wp.float64(done)
            system.outcome[BEFORE] = start
            system.outcome[AFTER] = wp.sqrt(rr)
            if not rr <= goal:
                flags[FAILED] = what
                flags[HALTED] = 1

    return solve
