"""Conjugate gradients for the equations of the moving particle method, whose unknowns are vectors or scalars.

Each row of the matrix belongs to a particle. The product of a row and the unknowns is the diagonal times the particle's
own value, minus the pair coefficients times the neighbours' values. If the unknowns are velocities, the row may also
contain the wall's resistance to motion along the wall. The preconditioner is the diagonal. A whole solve is one kernel.
On a CPU every thread processes some chunks of rows, and all threads wait for each other at barriers before sums are
added up; `resident_solver.py` is the version for a GPU. Sums are always formed in the same order, so results are
reproducible.

If some particles form rigid grains (`rigid`), their rows come first. The search directions are then rigid motions of
each grain, computed from the resultant force and moment of the residual on the grain (`rigid.py`).
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.barrier import meet
from ..common.control import FAILED, HALTED
from ..common.rows import row_product
from ..common.types import cpu_flags
from .rigid import share_function
from .structs import array_structs, flow_struct, mps_functions, mps_types

# The following constants are indices of the array `outcome`, in which a solve stores its number of iterations and its
# residual norms.
ITERATIONS = wp.constant(0)
BEFORE = wp.constant(1)  # Entry of `outcome`: norm of the residual at the start of the solve.
AFTER = wp.constant(2)  # Entry of `outcome`: norm of the residual at the end of the solve.
OUTCOME = 4


@functools.cache
def solver_functions(scalar, dimensions: int, vector: bool) -> SimpleNamespace:
    """Build the functions that a linear solver applies to each row of the equations, for vector or scalar unknowns.

    - `inner`: inner product of two values.
    - `divided`: preconditioned residual of one particle: its residual divided by the diagonal coefficient of its row.
    - `share`: preconditioner for one rigid grain, used instead of `divided` for the grain's particles. It stores their
      preconditioned residual, a rigid motion due to the resultant force and moment of the grain's residual. It returns
      the grain's contribution to two inner products: residual times preconditioned residual, and the residual's
      projection onto rigid motions times itself.
    - `bounded`: the row's product with the unknowns, corrected for boundary conditions. For velocities, it adds the
      resistance of the wall (`drag`) to motion along the wall. For scalars, it returns zero at the free surface.

    The namespace also holds `value`, the type of an unknown, and `Solve`, the struct of the solver's working arrays.
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

    return SimpleNamespace(
        value=value, Solve=Solve, inner=inner, divided=divided, bounded=bounded,
        share=share_function(scalar, dimensions)
    )  # fmt: skip


@wp.func
def sum_of(partial: wp.array(dtype=wp.float64), first: wp.int32, count: wp.int32) -> wp.float64:
    """Return the sum of the entries `first` to `first` + `count` - 1 of `partial`, added up in this order."""
    sum = wp.float64(0.0)
    for k in range(count):
        sum += partial[first + k]
    return sum


@functools.cache
def serial_rows(scalar, dimensions: int, vector: bool, rigid: bool) -> SimpleNamespace:
    """Build the functions that a CPU thread applies to a range of rows, or of rigid grains, in a solve.

    `begin` computes the first search direction of each row. `update` changes solution and residual by a step along the
    search direction. `share` computes the preconditioned residual of rigid grains. Each of these three functions
    returns the contributions of its rows to two inner products: residual times preconditioned residual, and residual
    times residual. `multiply` multiplies the matrix by the search direction, and returns its rows' contribution to the
    inner product of the direction and this product.
    """
    f = solver_functions(scalar, dimensions, vector)
    Solve, value = f.Solve, f.value
    Matrix = array_structs(scalar, dimensions).Matrix
    product = row_product(scalar, value)

    @wp.func
    def begin(first: wp.int32, end: wp.int32, matrix: Matrix, system: Solve):
        rz = wp.float64(0.0)
        rr = wp.float64(0.0)
        for i in range(first, end):
            z = f.divided(system.residual[i], matrix.free[i], matrix.diagonal[i], matrix.drag[i])
            system.direction[i] = z
            rz += f.inner(system.residual[i], z)
            rr += f.inner(system.residual[i], system.residual[i])
        return rz, rr

    @wp.func
    def update(
        first: wp.int32, end: wp.int32, alpha: scalar, matrix: Matrix, system: Solve, x: wp.array(dtype=value)
    ):  # fmt: skip
        rz = wp.float64(0.0)
        rr = wp.float64(0.0)
        for i in range(first, end):
            x[i] = x[i] + alpha * system.direction[i]
            left = system.residual[i] - alpha * system.product[i]
            system.residual[i] = left
            if not wp.static(rigid) or i >= matrix.grain_rows:
                z = f.divided(left, matrix.free[i], matrix.diagonal[i], matrix.drag[i])
                system.product[i] = z
                rz += f.inner(left, z)
                rr += f.inner(left, left)
        return rz, rr

    @wp.func
    def share(first: wp.int32, end: wp.int32, matrix: Matrix, system: Solve, z: wp.array(dtype=value)):
        """Store the preconditioned residual in `z` for all particles of the rigid grains `first` to `end` - 1."""
        rz = wp.float64(0.0)
        rr = wp.float64(0.0)
        if wp.static(rigid):
            for g in range(first, end):
                inner, square = f.share(g, matrix.grains, matrix.position, system.residual, z)
                rz += inner
                rr += square
        return rz, rr

    @wp.func
    def multiply(first: wp.int32, end: wp.int32, matrix: Matrix, system: Solve):
        pq = wp.float64(0.0)
        for i in range(first, end):
            own = system.direction[i]
            sum = matrix.diagonal[i] * own - product(
                matrix.near, matrix.coefficient, system.direction, i * matrix.near_capacity, matrix.near_count[i]
            )
            sum = f.bounded(sum, own, matrix.position[i], matrix.free[i], matrix.drag[i])
            system.product[i] = sum
            pq += f.inner(own, sum)
        return pq

    return SimpleNamespace(begin=begin, update=update, share=share, multiply=multiply)


@functools.cache
def serial_solver(scalar, dimensions: int, vector: bool, rigid: bool = False):
    """Build the CPU kernel that does a whole solve and adds the solution to `x`; each host thread launches it once.

    The rows are divided into `parts` chunks. A host thread processes the chunks `lower` to `upper` - 1. `workers` is
    the number of host threads, which wait for each other at barriers.
    """
    f, rows = solver_functions(scalar, dimensions, vector), serial_rows(scalar, dimensions, vector, rigid)
    Solve, value = f.Solve, f.value
    FlowConstants = flow_struct(scalar)
    structs = array_structs(scalar, dimensions)
    Matrix = structs.Matrix

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
        # The next arguments are:
        # - the number of all chunks,
        # - the first chunk of this thread, and the end of its range of chunks,
        # - the number of threads,
        # - the barrier at which the threads wait for each other.
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
        # Preconditioned conjugate gradients (Saad, Iterative Methods for Sparse Linear Systems, 2nd ed., algorithm
        # 9.1). With residual r, preconditioned residual z, search direction p and q = A p, the names of the inner
        # products are rz = r.z, rr = r.r and pq = p.q.
        total = flow.count
        grain_rows = wp.int32(0)
        bodies = wp.int32(0)
        if wp.static(rigid):
            grain_rows = matrix.grain_rows
            bodies = matrix.grains.mobility.shape[0]
        for part in range(lower, upper):
            first = wp.max(total * part / parts, grain_rows)
            own_rz, own_rr = rows.begin(first, total * (part + 1) / parts, matrix, system)
            grain_rz, grain_rr = rows.share(
                bodies * part / parts, bodies * (part + 1) / parts, matrix, system, system.direction
            )
            system.partial[part] = own_rz + grain_rz
            system.partial[parts + part] = own_rr + grain_rr
        meet(gate, workers)
        rz = sum_of(system.partial, 0, parts)
        rr = sum_of(system.partial, parts, parts)
        start = wp.sqrt(rr)
        goal = wp.max(tolerance * tolerance * rr, system.stop_norm[0] * system.stop_norm[0])
        count = wp.int32(0)
        while rr > goal and count < maximum:
            for part in range(lower, upper):
                system.partial[2 * parts + part] = rows.multiply(
                    total * part / parts, total * (part + 1) / parts, matrix, system
                )
            meet(gate, workers)
            pq = sum_of(system.partial, 2 * parts, parts)
            if pq <= wp.float64(0.0):
                break
            alpha = scalar(rz / pq)
            for part in range(lower, upper):
                own_rz, own_rr = rows.update(total * part / parts, total * (part + 1) / parts, alpha, matrix, system, x)
                system.partial[part] = own_rz
                system.partial[parts + part] = own_rr
            meet(gate, workers)
            if wp.static(rigid):
                for part in range(lower, upper):
                    grain_rz, grain_rr = rows.share(
                        bodies * part / parts, bodies * (part + 1) / parts, matrix, system, system.product
                    )
                    system.partial[part] += grain_rz
                    system.partial[parts + part] += grain_rr
                meet(gate, workers)
            rz_after = sum_of(system.partial, 0, parts)
            rr = sum_of(system.partial, parts, parts)
            beta = scalar(rz_after / rz)
            rz = rz_after
            for i in range(total * lower / parts, total * upper / parts):
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
        # All threads must have left the loop before any thread changes the flag that halts the flow.
        meet(gate, workers)
        if lower == 0 and flags[FAILED] != 0:
            flags[HALTED] = 1
        meet(gate, workers)

    return solve
