"""Linear systems of a flow on a grid, with the coarser matrices of their multigrid preconditioner.

A system has a row for each cell (pressure), or for each face (velocity). The rows of 2 x 2 x 2 cells (2 x 2 in a
plane) form one row of the next coarser level. The same holds for the rows of the faces with the same axis in these
cells. With the matrix A of a level, and the matrix P that gives each row the value of its coarser row, the matrix of
the next coarser level is P^T A P (unsmoothed aggregation). Rows couple neighbours only, on coarser levels as well, so
rows of coarser matrices have no more entries than rows of the finest matrix.

All levels share the same arrays, which contain the finest level first and the coarsest last. One task computes each row
of a coarser matrix and adds up its entries in a fixed order, so the matrix has the same bits for any number of threads.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ...common.control import HALTED
from ..structs import row_place
from .cells import item

DAMPING = wp.constant(1.8)
"""Upper limit of the eigenvalues of the matrix times the smoothing factors. With a limit below 2, every smoothing step
reduces all components of the error."""
SINGULAR = wp.constant(1.0e-4)
"""Lower limit of a coarse row's diagonal, divided by the sum of the diagonals of its finer rows.

Rows with a smaller ratio get a diagonal of 0, so that smoothing leaves their unknowns unchanged. Only the system for
the pressure in a closed space full of concrete has such a row. Its matrix is singular, because a constant pressure
exerts no net force.
"""


@functools.cache
def system_structs(scalar) -> SimpleNamespace:
    """Build the structs `Matrix`, which holds the matrices of all levels, and `Solve`, the working arrays of a solve.

    In the shapes of the arrays, n is the number of rows of all levels, and m the number of rows of the finest level.
    """

    @wp.struct
    class Matrix:
        near_capacity: wp.int32  # Maximum number of off-diagonal entries in a row of the matrices.
        rows: wp.int32  # Number n of matrix rows in all levels together.
        levels: wp.int32  # Number of multigrid levels, at least 1.

        # Maximum number of matrix rows that are merged into one row of the next coarser level of the multigrid.
        children: wp.int32
        free: wp.array(dtype=wp.int32)  # 1 for unused matrix rows, which hold no unknown; else 0. Shape (n,).
        diagonal: wp.array(dtype=scalar)  # Diagonal of the matrix, shape (n,).
        near_count: wp.array(dtype=wp.int32)  # Number of off-diagonal entries in each matrix row, shape (n,).
        # Matrix column of each off-diagonal entry, shape (n * near_capacity,).
        near: wp.array(dtype=wp.int32)
        # Value of each off-diagonal entry of the matrix times -1, shape (n * near_capacity,).
        coefficient: wp.array(dtype=scalar)
        # Factor of each row in a smoothing step, which adds this factor times the residual to the unknown, shape (n,).
        smoothing: wp.array(dtype=scalar)
        # For each matrix row, the row of the next coarser multigrid level into which it is merged, or -1, shape (n,).
        parent: wp.array(dtype=wp.int32)
        # Rows of the finer matrix that form each row of a coarser one, with n rows in all multigrid levels and m in the
        # finest level. Unused entries are -1. The shape is ((n - m) * children,).
        child: wp.array(dtype=wp.int32)
        # Index of the first matrix row of each multigrid level, followed by the number of all rows, shape
        # (levels + 1,).
        first: wp.array(dtype=wp.int32)
        # Number of matrix rows without an unknown before each row, shape (n,); GPU only.
        before: wp.array(dtype=wp.int32)
        used: wp.array(dtype=wp.int32)  # Matrix rows with an unknown, in increasing order, shape (n,).

        # Index in `used` of the first entry of each multigrid level, followed by the number of entries, shape
        # (levels + 1,).
        begin: wp.array(dtype=wp.int32)
        # Operations of the multigrid cycle, four numbers each, see `multigrid.py`, shape (4 * operations,).
        cycle: wp.array(dtype=wp.int32)

    @wp.struct
    class Solve:
        residual: wp.array(dtype=scalar)  # Residuals of the equations of all multigrid levels, shape (n,).

        # First array of solutions of all multigrid levels, shape (n,); smoothing writes to `even` and `odd` in turn.
        even: wp.array(dtype=scalar)
        # Second array of solutions of all multigrid levels, shape (n,); smoothing writes to `even` and `odd` in turn.
        odd: wp.array(dtype=scalar)
        # Search direction, shape (m,); on a GPU the old and the new direction, shape (2 m,).
        direction: wp.array(dtype=scalar)
        product: wp.array(dtype=scalar)  # Product of the matrix and the search direction, shape (m,).
        partial: wp.array(dtype=wp.float64)  # Partial sums of each block or chunk, for three inner products.
        stop_norm: wp.array(dtype=wp.float64)  # Residual norm at which the solve stops, shape (1,).

        # Number of iterations, and norm of the residual at the start and at the end of the solve, shape (OUTCOME,).
        outcome: wp.array(dtype=wp.float64)
        history: wp.array(dtype=wp.float64)  # Residual norm after each iteration, up to the array's length.

    return SimpleNamespace(Matrix=Matrix, Solve=Solve)


@functools.cache
def level_kernels(scalar, serial: bool) -> SimpleNamespace:
    """Build the kernels that compute the coarser matrices and the row lists of a system from its finest matrix.

    - `coarsen` computes the matrix of one level from the matrix of the next finer level, with one task per coarse row.
    - `damp` computes the factors of the smoothing steps, with one task per row of all levels.
    - `list_rows` lists the rows with an unknown. On a CPU the kernel runs as one task. On a GPU it runs with one task
      per row; `before` must then hold the exclusive prefix sums of `free`, which is 1 for rows without an unknown.
    """
    Matrix = system_structs(scalar).Matrix
    entry = row_place(serial)

    @wp.func
    def add_entry(matrix: Matrix, row: wp.int32, count: wp.int32, column: wp.int32, c: scalar) -> wp.int32:
        """Add a coefficient to a row that has `count` entries, and return the new number of entries."""
        for n in range(count):
            place = entry(row, n, matrix.rows, matrix.near_capacity)
            if matrix.near[place] == column:
                matrix.coefficient[place] = matrix.coefficient[place] + c
                return count
        place = entry(row, count, matrix.rows, matrix.near_capacity)
        matrix.near[place] = column
        matrix.coefficient[place] = c
        return count + 1

    @wp.kernel(enable_backward=False, module="unique")
    def coarsen(
        level: wp.int32, flags: wp.array(dtype=wp.int32), matrix: Matrix, worker: wp.int32, workers: wp.int32
    ):  # fmt: skip
        if flags[HALTED] != 0:
            return
        row = matrix.first[level] + item(wp.tid(), worker, workers)
        count = wp.int32(0)
        diagonal = scalar(0.0)
        whole = scalar(0.0)
        found = wp.int32(0)
        for k in range(matrix.children):
            i = matrix.child[(row - matrix.first[1]) * matrix.children + k]
            if i >= 0:
                if matrix.free[i] == 0:
                    found = 1
                    own = matrix.diagonal[i]
                    whole += own
                    for n in range(matrix.near_count[i]):
                        place = entry(i, n, matrix.rows, matrix.near_capacity)
                        column = matrix.parent[matrix.near[place]]
                        if column == row:
                            own -= matrix.coefficient[place]
                        else:
                            count = add_entry(matrix, row, count, column, matrix.coefficient[place])
                    diagonal += own
        matrix.free[row] = 1 - found
        matrix.near_count[row] = count
        matrix.diagonal[row] = wp.where(diagonal > scalar(SINGULAR) * whole, diagonal, scalar(0.0))

    @wp.kernel(enable_backward=False, module="unique")
    def damp(flags: wp.array(dtype=wp.int32), matrix: Matrix, worker: wp.int32, workers: wp.int32):
        # Let D be the diagonal of the matrix A, and R the sums of the magnitudes of the entries of its rows. The
        # eigenvalues of R^-1 A are at most 1 (l1-Jacobi smoother, Baker, Falgout, Kolev & Yang 2011). The smoothing
        # factors are S = min(1 / D, DAMPING / R), so the eigenvalues of S A are at most DAMPING. With a single level,
        # the smoothing step is the whole preconditioner, and S = 1 / D.
        if flags[HALTED] != 0:
            return
        i = item(wp.tid(), worker, workers)
        if matrix.free[i] != 0:
            return
        diagonal = matrix.diagonal[i]
        sum = diagonal
        for n in range(matrix.near_count[i]):
            sum += wp.abs(matrix.coefficient[entry(i, n, matrix.rows, matrix.near_capacity)])
        factor = scalar(0.0)
        if diagonal > scalar(0.0):
            factor = scalar(1.0) / diagonal
            if matrix.levels > 1:
                factor = wp.min(factor, scalar(DAMPING) / sum)
        matrix.smoothing[i] = factor

    @wp.kernel(enable_backward=False, module="unique")
    def list_serially(flags: wp.array(dtype=wp.int32), matrix: Matrix):
        if flags[HALTED] != 0:
            return
        count = wp.int32(0)
        for level in range(matrix.levels):
            matrix.begin[level] = count
            for i in range(matrix.first[level], matrix.first[level + 1]):
                if matrix.free[i] == 0:
                    matrix.used[count] = i
                    count += 1
        matrix.begin[matrix.levels] = count

    @wp.kernel(enable_backward=False, module="unique")
    def list_in_parallel(flags: wp.array(dtype=wp.int32), matrix: Matrix):
        if flags[HALTED] != 0:
            return
        i = wp.tid()
        if matrix.free[i] == 0:
            matrix.used[i - matrix.before[i]] = i
        if i < matrix.levels:
            matrix.begin[i] = matrix.first[i] - matrix.before[matrix.first[i]]
        if i == matrix.rows - 1:
            matrix.begin[matrix.levels] = matrix.rows - matrix.before[i] - matrix.free[i]

    return SimpleNamespace(coarsen=coarsen, damp=damp, list_rows=list_serially if serial else list_in_parallel)
