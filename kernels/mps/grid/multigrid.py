"""Conjugate gradients with a multigrid preconditioner for the linear systems of a flow on a grid.

The preconditioner is a multigrid cycle over the levels that `levels.py` describes. The cycle is a list of operations,
each on all rows of a level:

- SMOOTH changes the solution of each row by its residual times `smoothing` (a damped Jacobi step).
- RESTRICT sets the right-hand side of each row of the next coarser level to the sum of its finer rows' residuals.
- PROLONG adds the solution of the next coarser level, multiplied by OVERCORRECTION, to the finer rows.

The preconditioner is symmetric, because smoothing before and after a visit of the coarser level is the same. One kernel
performs a whole solve. Each CPU thread, or each GPU block, processes some chunks of rows and waits for the others at
barriers. The first thread or block alone processes levels with few rows, so that these levels need no barriers. Sums
are computed in the same order for any number of threads or blocks, so results are reproducible.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ...common.barrier import meet
from ...common.control import FAILED, HALTED
from ...common.reductions import BLOCK
from ...common.resident import gather
from ...common.rows import directed_product, entry_product, row_product
from ...common.types import cpu_flags
from ..coarse import lanes
from ..conjugate_gradient import AFTER, BEFORE, ITERATIONS
from ..resident_solver import RESIDENT, WIDE, sum_functions
from .levels import system_structs

# Operations of a cycle. Each entry of `Matrix.cycle` consists of four numbers: the operation, its level, and the arrays
# that hold the solutions of this level and of the next coarser level (0 for the array `even`, 1 for `odd`).
SMOOTH = wp.constant(0)
RESTRICT = wp.constant(1)
PROLONG = wp.constant(2)
OVERCORRECTION = 1.4
"""Factor by which coarse corrections are multiplied.

Corrections that are constant over several cells are too small, because their jumps between these groups of cells cost
too much energy (Braess 1995)."""
FEW = {"cpu": 256, "gpu": 256}
"""Maximum number of rows of a coarser level that the first thread or block processes alone."""


FAMILY_SUM = """
#if defined(__CUDA_ARCH__)
    for (int step = members / 2; step > 0; step /= 2)
        part += __shfl_xor_sync(0xffffffffu, part, step);
#endif
    return part;
"""


@functools.cache
def family_sum_function(scalar):
    """Build the function that adds up the values of `members` neighbouring GPU threads; on a CPU there is only one."""

    @wp.func_native(FAMILY_SUM)
    def family_sum(part: scalar, members: wp.int32) -> scalar: ...

    return family_sum


@functools.cache
def cycle_functions(scalar, serial: bool) -> SimpleNamespace:
    """Build the functions that apply one operation of the multigrid cycle to a range of rows.

    `operate` applies operation number `turn` of the cycle to the rows at the positions from `begin` to `end` - 1 in the
    list of rows with unknowns. `by` threads share these rows, and `thread` is the index of the calling thread. The
    loops over rows are inside the functions, because on a CPU each function call copies the structs passed to it.
    """
    structs = system_structs(scalar)
    Matrix, Solve = structs.Matrix, structs.Solve
    family_sum = family_sum_function(scalar)
    by_row, by_entry = row_product(scalar, scalar), entry_product(scalar, scalar)

    @wp.func
    def place(i: wp.int32, near_capacity: wp.int32) -> wp.int32:
        if wp.static(serial):
            return i * near_capacity
        else:
            return i

    @wp.func
    def multiply(
        near: wp.array(dtype=wp.int32), coefficient: wp.array(dtype=scalar), value: wp.array(dtype=scalar),
        first: wp.int32, count: wp.int32, rows: wp.int32,
    ) -> scalar:  # fmt: skip
        """Return the product of a matrix row and the vector `value`; the row has `count` entries from `first` on."""
        if wp.static(serial):
            return by_row(near, coefficient, value, first, count)
        else:
            return by_entry(near, coefficient, value, first, rows, count)

    @wp.func
    def smooth(
        first: wp.int32, end: wp.int32, by: wp.int32, matrix: Matrix, system: Solve, before: wp.array(dtype=scalar),
        after: wp.array(dtype=scalar),
    ):  # fmt: skip
        for k in range(first, end, by):
            i = matrix.used[k]
            own = before[i]
            left = system.residual[i] - matrix.diagonal[i] * own + multiply(
                matrix.near, matrix.coefficient, before, place(i, matrix.near_capacity), matrix.near_count[i],
                matrix.rows,
            )  # fmt: skip
            after[i] = own + matrix.smoothing[i] * left

    @wp.func
    def restrict(
        begin: wp.int32, thread: wp.int32, end: wp.int32, by: wp.int32, matrix: Matrix, system: Solve,
        finer: wp.array(dtype=scalar), coarser: wp.array(dtype=scalar),
    ):  # fmt: skip
        """Compute the right-hand sides of coarser rows, and apply the first smoothing step to a solution of zero.

        On a GPU, each thread computes the residual of one finer row. The threads that belong to the same coarser row
        then add up their residuals.
        """
        abreast = wp.where(lanes() > 1, matrix.children, 1)
        for n in range(thread, ((end - begin) * abreast + lanes() - 1) / lanes() * lanes(), by):
            sum = scalar(0.0)
            row = wp.int32(0)
            inside = begin + n / abreast < end
            if inside:
                row = matrix.used[begin + n / abreast]
                family = (row - matrix.first[1]) * matrix.children
                for member in range(n % abreast, matrix.children, abreast):
                    i = matrix.child[family + member]
                    if i >= 0:
                        if matrix.free[i] == 0:
                            sum += system.residual[i] - matrix.diagonal[i] * finer[i] + multiply(
                                matrix.near, matrix.coefficient, finer, place(i, matrix.near_capacity),
                                matrix.near_count[i], matrix.rows,
                            )  # fmt: skip
            sum = family_sum(sum, matrix.children)
            if inside and n % abreast == 0:
                system.residual[row] = sum
                coarser[row] = matrix.smoothing[row] * sum

    @wp.func
    def prolong(
        first: wp.int32, end: wp.int32, by: wp.int32, matrix: Matrix, finer: wp.array(dtype=scalar),
        coarser: wp.array(dtype=scalar),
    ):  # fmt: skip
        for k in range(first, end, by):
            i = matrix.used[k]
            finer[i] = finer[i] + scalar(OVERCORRECTION) * coarser[matrix.parent[i]]

    @wp.func
    def operate(
        turn: wp.int32, begin: wp.int32, thread: wp.int32, end: wp.int32, by: wp.int32, matrix: Matrix, system: Solve
    ):  # fmt: skip
        operation = matrix.cycle[4 * turn]
        own = matrix.cycle[4 * turn + 2]
        next = matrix.cycle[4 * turn + 3]
        if operation == SMOOTH:
            if own == 0:
                smooth(begin + thread, end, by, matrix, system, system.even, system.odd)
            else:
                smooth(begin + thread, end, by, matrix, system, system.odd, system.even)
        elif operation == RESTRICT:
            if own == 0:
                restrict(begin, thread, end, by, matrix, system, system.even, system.even)
            else:
                restrict(begin, thread, end, by, matrix, system, system.odd, system.even)
        elif own == 0:
            if next == 0:
                prolong(begin + thread, end, by, matrix, system.even, system.even)
            else:
                prolong(begin + thread, end, by, matrix, system.even, system.odd)
        else:
            if next == 0:
                prolong(begin + thread, end, by, matrix, system.odd, system.even)
            else:
                prolong(begin + thread, end, by, matrix, system.odd, system.odd)

    @wp.func
    def target(matrix: Matrix, turn: wp.int32) -> wp.int32:
        """Return the level of the rows that operation number `turn` of the cycle changes."""
        return matrix.cycle[4 * turn + 1] + wp.where(matrix.cycle[4 * turn] == RESTRICT, 1, 0)

    @wp.func
    def is_few(matrix: Matrix, turn: wp.int32) -> wp.bool:
        """Return whether operation number `turn` of the cycle is left to the first thread or block."""
        level = target(matrix, turn)
        few = wp.static(FEW["cpu"] if serial else FEW["gpu"])
        return level > 0 and matrix.begin[level + 1] - matrix.begin[level] <= few

    return SimpleNamespace(operate=operate, target=target, is_few=is_few)


@functools.cache
def serial_functions(scalar) -> SimpleNamespace:
    """Build the functions by which a CPU thread processes its rows in a solve.

    `precondition` applies the preconditioner. Each of the other functions processes a range of the list of rows.
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
        """Compute the preconditioned residual, after `start` has run in all threads and they have met at a barrier."""
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
        """Multiply the matrix by the search direction, and return the inner product of direction and product."""
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

    @wp.func
    def total(first: wp.int32, parts: wp.int32, system: Solve) -> wp.float64:
        sum = wp.float64(0.0)
        for k in range(parts):
            sum += system.partial[first + k]
        return sum

    return SimpleNamespace(
        precondition=precondition,
        start=start,
        multiply=multiply,
        inner=inner,
        turn_direction=turn_direction,
        total=total,
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
        # The matrix is only read.
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
        rr = f.total(0, parts, system)
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
            rz = f.total(parts, parts, system)
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
            pq = f.total(2 * parts, parts, system)
            if pq <= wp.float64(0.0):
                break
            alpha = scalar(rz / pq)
            for part in range(lower, upper):
                system.partial[part] = f.start(rows * part / parts, rows * (part + 1) / parts, alpha, matrix, system, x)
            meet(gate, workers)
            rr = f.total(0, parts, system)
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


@functools.cache
def resident_functions(scalar, width: int) -> SimpleNamespace:
    """Build the functions by which a GPU thread processes its rows in a solve; a block has `width` threads.

    `precondition` applies the preconditioner. Each of the other functions processes the row at position `k` of the list
    of rows.
    """
    structs = system_structs(scalar)
    Matrix, Solve = structs.Matrix, structs.Solve
    f = cycle_functions(scalar, False)
    product = directed_product(scalar, scalar)

    @wp.func
    def precondition(
        thread: wp.int32, parties: wp.int32, gate: wp.array(dtype=wp.int32), matrix: Matrix, system: Solve
    ):
        """Compute the preconditioned residual, after `start` has run in all blocks and they have met at a barrier.

        All blocks meet at another barrier at the end.
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

        In `Solve.direction`, the previous direction begins at index `old`, and the new one at `new`. The function
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
        # The matrix is only read.
        matrix: Matrix,
        # The next arguments are arrays that this kernel writes.
        flags: wp.array(dtype=wp.int32),
        system: Solve,
        x: wp.array(dtype=scalar),
    ):
        # The names of the inner products are those of `serial_multigrid`.
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
