"""Conjugate gradients whose preconditioner contains the coarse grid of `coarse.py`; a whole solve is one kernel.

The solve is structured as in `conjugate_gradient.py` (CPU) and `resident_solver.py` (GPU). In those files the
preconditioner is only the diagonal of the matrix. On a CPU every thread processes some chunks of rows. On a GPU the
blocks stay resident and meet at barriers.
"""

import functools

import warp as wp

from ..common.barrier import meet
from ..common.control import FAILED, HALTED
from ..common.reductions import BLOCK, block_sums
from ..common.resident import gather
from ..common.rows import entry_product
from ..common.types import cpu_flags
from .coarse import DEGREE, MIDDLE, REACH, coarse_functions, lanes
from .conjugate_gradient import AFTER, BEFORE, ITERATIONS, serial_rows, solver_functions, sum_of
from .resident_solver import RESIDENT, WIDE, row_functions, sum_functions
from .structs import array_structs, flow_struct


@functools.cache
def serial_correction(scalar, dimensions: int, vector: bool):
    """Build `correct`, which solves the coarse equations for the current residual on a CPU.

    It returns the index at which the coarse solution begins in the array `lift`. It also stores, in the array
    `partial`, the inner product of residual and coarse solution over each chunk of cubes, which are the cells of the
    coarse grid.
    """
    cube, Solve = coarse_functions(scalar, dimensions, vector), solver_functions(scalar, dimensions, vector).Solve
    Matrix = array_structs(scalar, dimensions).Matrix

    @wp.func
    def correct(
        parts: wp.int32, lower: wp.int32, upper: wp.int32, workers: wp.int32, gate: wp.array(dtype=wp.int32),
        matrix: Matrix, system: Solve,
    ) -> wp.int32:  # fmt: skip
        count = matrix.coarse.count
        first = count * lower / parts
        end = count * upper / parts
        cube.load(first, end, 1, 0, 1, matrix, system)
        old = wp.int32(0)
        factor = scalar(wp.static(REACH / MIDDLE))
        for _ in range(wp.static(DEGREE - 1)):
            meet(gate, workers)
            factor = cube.sweep(first, end, 1, 0, 1, old, factor, matrix, system)
            old = count - old
        for part in range(lower, upper):
            own = wp.float64(0.0)
            for a in range(count * part / parts, count * (part + 1) / parts):
                own += system.inner[a]
            system.partial[2 * parts + part] = own
        meet(gate, workers)
        return old

    return correct


@functools.cache
def serial_two_level(scalar, dimensions: int, vector: bool):
    """Build the CPU kernel that solves a linear system by conjugate gradients and adds the solution to `x`.

    The preconditioner contains the coarse grid. Each thread launches the kernel with a single task. The kernel has the
    same parameters as `serial_solver` in `conjugate_gradient.py`.
    """
    f, rows = solver_functions(scalar, dimensions, vector), serial_rows(scalar, dimensions, vector, False)
    Solve, value = f.Solve, f.value
    FlowConstants = flow_struct(scalar)
    Matrix = array_structs(scalar, dimensions).Matrix
    correct = serial_correction(scalar, dimensions, vector)

    @wp.func
    def turn(first: wp.int32, end: wp.int32, beta: scalar, old: wp.int32, matrix: Matrix, system: Solve):
        """Compute the new search direction of each row from the preconditioned residual and the old direction.

        The preconditioned residual is the sum of two terms: the residual divided by the diagonal, which is stored in
        `product`, and the coarse solution, which begins at index `old` in `lift`.
        """
        for i in range(first, end):
            now = system.product[i]
            if wp.static(vector) or matrix.free[i] == 0:
                now += system.lift[old + matrix.coarse.of[i]]
            system.direction[i] = now + beta * system.direction[i]

    @wp.kernel(enable_backward=False, module="unique", module_options={"cpu_compiler_flags": cpu_flags()})
    def solve(
        # The next arguments are:
        # - the flow's parameters, of which only the number of rows is read,
        # - the error code that is stored if the solve fails,
        # - the relative tolerance,
        # - the maximum number of iterations.
        flow: FlowConstants,
        what: wp.int32,
        tolerance: wp.float64,
        maximum: wp.int32,
        # The rows of the equations are divided into chunks. The next arguments are the number of all chunks, the range
        # of this thread's chunks, the number of threads, and the barrier at which the threads wait for each other.
        parts: wp.int32,
        lower: wp.int32,
        upper: wp.int32,
        workers: wp.int32,
        gate: wp.array(dtype=wp.int32),
        # The next arguments hold the state of the flow, which this kernel only reads.
        matrix: Matrix,
        # The next arguments are arrays that this kernel writes.
        flags: wp.array(dtype=wp.int32),
        system: Solve,
        x: wp.array(dtype=value),
    ):
        if flags[HALTED] != 0:
            return
        begin = flow.count * lower / parts
        end = flow.count * upper / parts
        for part in range(lower, upper):
            own_rz, own_rr = rows.begin(
                flow.count * part / parts, flow.count * (part + 1) / parts, matrix, system
            )  # fmt: skip
            system.partial[part] = own_rz
            system.partial[parts + part] = own_rr
        meet(gate, workers)
        old = correct(parts, lower, upper, workers, gate, matrix, system)
        rz = wp.float64(0.0)
        rr = wp.float64(0.0)
        for k in range(parts):
            rz += system.partial[k] + system.partial[2 * parts + k]
            rr += system.partial[parts + k]
        for i in range(begin, end):
            system.product[i] = system.direction[i]
        turn(begin, end, scalar(0.0), old, matrix, system)
        meet(gate, workers)
        start = wp.sqrt(rr)
        goal = wp.max(tolerance * tolerance * rr, system.stop_norm[0] * system.stop_norm[0])
        count = wp.int32(0)
        while rr > goal and count < maximum:
            for part in range(lower, upper):
                system.partial[2 * parts + part] = rows.multiply(
                    flow.count * part / parts, flow.count * (part + 1) / parts, matrix, system
                )
            meet(gate, workers)
            pq = sum_of(system.partial, 2 * parts, parts)
            if pq <= wp.float64(0.0):
                break
            for part in range(lower, upper):
                own_rz, own_rr = rows.update(
                    flow.count * part / parts, flow.count * (part + 1) / parts, scalar(rz / pq), matrix, system, x
                )
                system.partial[part] = own_rz
                system.partial[parts + part] = own_rr
            meet(gate, workers)
            old = correct(parts, lower, upper, workers, gate, matrix, system)
            rz_after = wp.float64(0.0)
            rr = wp.float64(0.0)
            for k in range(parts):
                rz_after += system.partial[k] + system.partial[2 * parts + k]
                rr += system.partial[parts + k]
            beta = scalar(rz_after / rz)
            rz = rz_after
            turn(begin, end, beta, old, matrix, system)
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
        # All threads must have left the loop before any thread changes the flag that halts the flow.
        meet(gate, workers)
        if lower == 0 and flags[FAILED] != 0:
            flags[HALTED] = 1
        meet(gate, workers)

    return solve


@functools.cache
def resident_correction(scalar, dimensions: int, vector: bool, width: int):
    """Build `correct`, which solves the coarse equations for the current residual on a GPU.

    Each warp computes one cube (cell of the coarse grid) at a time. `correct` returns the index at which the coarse
    solution begins in the array `lift`. The caller must place a barrier between the computation of the residual and the
    call of `correct`, which itself ends with a barrier.
    """
    cube, Solve = coarse_functions(scalar, dimensions, vector), solver_functions(scalar, dimensions, vector).Solve
    Matrix = array_structs(scalar, dimensions).Matrix

    @wp.func
    def correct(
        thread: wp.int32, parties: wp.int32, gate: wp.array(dtype=wp.int32), matrix: Matrix, system: Solve
    ) -> wp.int32:  # fmt: skip
        count = matrix.coarse.count
        abreast = lanes()
        lane = thread % abreast
        warps = parties * width / abreast
        first = thread / abreast
        cube.load(first, count, warps, lane, abreast, matrix, system)
        old = wp.int32(0)
        factor = scalar(wp.static(REACH / MIDDLE))
        for _ in range(wp.static(DEGREE - 1)):
            gather(gate, parties)
            factor = cube.sweep(first, count, warps, lane, abreast, old, factor, matrix, system)
            old = count - old
        gather(gate, parties)
        return old

    return correct


@functools.cache
def resident_two_level(scalar, dimensions: int, vector: bool, width: int = BLOCK):
    """Build the GPU kernel that solves a linear system by conjugate gradients and adds the solution to `x`.

    The caller launches `parties` blocks of `width` threads, which wait for each other at barriers. If `width` is WIDE,
    `parties` must be 1.
    """
    accumulate, total_of = sum_functions(width).accumulate, sum_functions(width).total_of
    total = block_sums(width).total
    f, row = solver_functions(scalar, dimensions, vector), row_functions(scalar, dimensions, vector, False)
    Solve, value = f.Solve, f.value
    Matrix = array_structs(scalar, dimensions).Matrix
    product = entry_product(scalar, value)
    correct = resident_correction(scalar, dimensions, vector, width)

    @wp.func
    def turn(i: wp.int32, count: wp.int32, beta: scalar, old: wp.int32, matrix: Matrix, system: Solve):
        """Compute the new search direction of the conjugate gradients at row `i` of the linear system.

        The direction is the sum of the residual divided by the matrix's diagonal, the solution of the coarse equations,
        and `beta` times the previous direction.
        """
        if i < count:
            now = system.preconditioned[i]
            if wp.static(vector) or matrix.free[i] == 0:
                now += system.lift[old + matrix.coarse.of[i]]
            if beta != scalar(0.0):
                now += beta * system.direction[i]
            system.direction[i] = now

    @wp.func
    def multiply(i: wp.int32, count: wp.int32, matrix: Matrix, system: Solve) -> wp.float64:
        if i >= count:
            return wp.float64(0.0)
        own = system.direction[i]
        sum = matrix.diagonal[i] * own - product(
            matrix.near, matrix.coefficient, system.direction, i, count, matrix.near_count[i]
        )  # fmt: skip
        sum = f.bounded(sum, own, matrix.position[i], matrix.free[i], matrix.drag[i])
        system.product[i] = sum
        return f.inner(own, sum)

    @wp.kernel(enable_backward=False, module="unique", launch_bounds=(width, 1 if width == WIDE else RESIDENT))
    def solve(
        # The next arguments are:
        # - the number of rows,
        # - the error code that is stored if the solve fails,
        # - the relative tolerance,
        # - the maximum number of iterations.
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
        thread = wp.tid()
        lane = thread % width
        block = thread / width
        halted = flags[HALTED]
        sums = (count + width - 1) / width
        rz = wp.float64(0.0)
        rr = wp.float64(0.0)
        for chunk in range(block, sums, parties):
            own_rz, own_rr = row.begin(chunk * width + lane, count, matrix, system)
            rz += accumulate(chunk * width + lane, system.partial, 0, own_rz)
            rr += accumulate(chunk * width + lane, system.partial, sums, own_rr)
        gather(gate, parties)
        rr = total_of(rr, lane, system.partial, sums, sums)
        start = wp.sqrt(rr)
        goal = wp.max(tolerance * tolerance * rr, system.stop_norm[0] * system.stop_norm[0])
        done = wp.int32(0)
        beta = scalar(0.0)
        before = wp.float64(1.0)
        if halted != 0:
            rr = wp.float64(0.0)
            goal = wp.float64(0.0)
        while rr > goal and done < maximum:
            old = correct(thread, parties, gate, matrix, system)
            rz = total_of(rz, lane, system.partial, 0, sums) + total(lane, system.inner, 0, matrix.coarse.count)
            if done > 0:
                beta = scalar(rz / before)
            before = rz
            for chunk in range(block, sums, parties):
                turn(chunk * width + lane, count, beta, old, matrix, system)
            gather(gate, parties)
            pq = wp.float64(0.0)
            for chunk in range(block, sums, parties):
                pq += accumulate(chunk * width + lane, system.partial, 2 * sums, multiply(
                    chunk * width + lane, count, matrix, system
                ))  # fmt: skip
            gather(gate, parties)
            pq = total_of(pq, lane, system.partial, 2 * sums, sums)
            alpha = scalar(0.0)
            if pq > wp.float64(0.0):
                alpha = scalar(rz / pq)
            rz = wp.float64(0.0)
            rr = wp.float64(0.0)
            for chunk in range(block, sums, parties):
                own_rz, own_rr = row.update(chunk * width + lane, count, alpha, count, matrix, system, x)
                rz += accumulate(chunk * width + lane, system.partial, 0, own_rz)
                rr += accumulate(chunk * width + lane, system.partial, sums, own_rr)
            gather(gate, parties)
            rr = total_of(rr, lane, system.partial, sums, sums)
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
