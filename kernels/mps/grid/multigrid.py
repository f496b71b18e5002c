"""Operations of the multigrid preconditioner for the linear systems of a flow on a grid.

The preconditioner is a multigrid cycle over the levels that `levels.py` describes. The cycle is a list of operations,
each on all rows of a level:

- SMOOTH changes the solution of each row by its residual times `smoothing` (a damped Jacobi step).
- RESTRICT sets the right-hand side of each row of the next coarser level to the sum of its finer rows' residuals.
- PROLONG adds the solution of the next coarser level, multiplied by OVERCORRECTION, to the finer rows.

The preconditioner is symmetric, because smoothing before and after a visit of the coarser level is the same. Only the
first thread or block processes levels with few rows, so that these levels need no barriers.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ...common.rows import entry_product, row_product
from ..coarse import lanes
from .levels import system_structs

# Operations of the multigrid cycle. Each entry of `Matrix.cycle` consists of four numbers: the operation, its level,
# and the arrays that hold the solutions of this level and of the next coarser level (0 for the array `even`, 1 for
# `odd`).
SMOOTH = wp.constant(0)
RESTRICT = wp.constant(1)
PROLONG = wp.constant(2)
OVERCORRECTION = 1.4
"""Factor by which coarse corrections are multiplied.

A coarse correction is constant over groups of cells and jumps between them. The jumps add energy, so the solve that
minimises the energy norm of the error yields a correction that is too small (Braess 1995). The factor enlarges it.
"""
FEW = {"cpu": 256, "gpu": 256}
"""Largest number of rows of a coarser level that only the first thread (CPU) or block (GPU) processes, so that the
level needs no barriers."""


FAMILY_SUM = """
#if defined(__CUDA_ARCH__)
    for (int step = members / 2; step > 0; step /= 2)
        part += __shfl_xor_sync(0xffffffffu, part, step);
#endif
    return part;
"""


@functools.cache
def family_sum_function(scalar):
    """Build the function that sums a value over `members` adjacent GPU threads; on a CPU it returns its argument."""

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

        On a GPU, each thread computes the residual of one finer row. The threads whose rows belong to the same coarser
        row then add up their residuals.
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
        """Return the level of the rows that operation number `turn` of the multigrid cycle changes."""
        return matrix.cycle[4 * turn + 1] + wp.where(matrix.cycle[4 * turn] == RESTRICT, 1, 0)

    @wp.func
    def is_few(matrix: Matrix, turn: wp.int32) -> wp.bool:
        """Return whether the first thread or block alone performs operation number `turn` of the multigrid cycle."""
        level = target(matrix, turn)
        few = wp.static(FEW["cpu"] if serial else FEW["gpu"])
        return level > 0 and matrix.begin[level + 1] - matrix.begin[level] <= few

    return SimpleNamespace(operate=operate, target=target, is_few=is_few)
