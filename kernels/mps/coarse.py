"""A coarse grid for the preconditioner of the moving particle method's solves.

Conjugate gradients with a diagonal preconditioner reduce errors that are smooth over many particles only slowly. The
particles are therefore grouped into cubes about four spacings wide. With P the matrix that assigns each particle the
value of its cube, the coarse matrix is A_c = P^T A P (Nicolaides 1987). The preconditioner is D^-1 + P A_c^-1 P^T,
where D is the diagonal of A and a Chebyshev polynomial approximates A_c^-1. With this preconditioner the number of
iterations hardly grows with the number of particles.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.control import HALTED
from .structs import array_structs, flow_struct, row_place

DEGREE = 4
"""Degree of the Chebyshev iteration that solves the coarse equations; it applies the coarse matrix DEGREE - 1 times. If
the fluid forms a tall column, a degree of 6 or 8 saves a third of the conjugate-gradient iterations. Every iteration
then takes longer, however, so a GPU gains nothing."""
RATIO = 20.0
"""Ratio of the largest to the smallest eigenvalue for which the Chebyshev iteration is designed. The eigenvalues belong
to the coarse matrix after each row has been divided by its diagonal element. None of them exceeds 2."""
MIDDLE, REACH = 1.0 + 1.0 / RATIO, 1.0 - 1.0 / RATIO
"""Centre (MIDDLE) and half-width (REACH) of the interval of eigenvalues for which the Chebyshev iteration is designed.
This interval extends from 2 / RATIO to 2."""


@functools.cache
def slot_function(scalar, dimensions: int):
    """Build `slot_of`, which returns a number for the position of the cube `other` relative to the cube `own`.

    Cubes are the cells of the coarse grid. The two cubes must be adjacent or equal, so `other` is either `own` itself
    or one of the cubes around it. In d dimensions these are 3^d positions, with numbers from 0 to 3^d - 1; `own` has
    the middle number. The cubes of neighbouring particles are always adjacent or equal, because a cube is at least as
    wide as the largest distance of two neighbouring particles.
    """
    Matrix = array_structs(scalar, dimensions).Matrix

    @wp.func
    def slot_of(matrix: Matrix, own: wp.int32, other: wp.int32) -> wp.int32:
        wide = matrix.coarse.wide
        if wp.static(dimensions == 2):
            t = other - own + wide + 1
            return t % wide + 3 * (t / wide)
        else:
            layer = wide * wide
            t = other - own + layer + wide + 1
            return t % wide + 3 * ((t / wide) % wide) + 9 * (t / layer)

    return slot_of


@functools.cache
def serial_coarse_kernel(scalar, dimensions: int, vector: bool):
    """Build the CPU kernel (one task) that forms the rows of the coarse matrix for cubes from `begin` to `end`.

    Cubes are the cells of the coarse grid. In d dimensions each row has 3^d coefficients: one for each adjacent cube
    and, in the middle, one for the row's own cube. The kernel stores the reciprocal of the middle coefficient in its
    place, or 0 if the cube contains no unknowns.
    """
    FlowConstants = flow_struct(scalar)
    Matrix = array_structs(scalar, dimensions).Matrix
    slot_of = slot_function(scalar, dimensions)
    slots = 3**dimensions

    @wp.kernel(enable_backward=False, module="unique")
    def cubes(flow: FlowConstants, begin: wp.int32, end: wp.int32, flags: wp.array(dtype=wp.int32), matrix: Matrix):
        if flags[HALTED] != 0:
            return
        count = matrix.coarse.count
        for a in range(begin, end):
            for s in range(slots):
                matrix.coarse.coefficient[s * count + a] = scalar(0.0)
            middle = scalar(0.0)
            for m in range(matrix.coarse.first[a], matrix.coarse.first[a + 1]):
                i = matrix.coarse.member[m]
                if wp.static(vector) or matrix.free[i] == 0:
                    middle += matrix.diagonal[i]
                    if wp.static(vector):
                        middle += matrix.drag[i]
                    row = i * matrix.near_capacity
                    for k in range(row, row + matrix.near_count[i]):
                        j = matrix.near[k]
                        other = matrix.coarse.of[j]
                        if wp.static(vector) or matrix.free[j] == 0:
                            if other == a:
                                middle -= matrix.coefficient[k]
                            else:
                                to = slot_of(matrix, a, other) * count + a
                                matrix.coarse.coefficient[to] = matrix.coarse.coefficient[to] + matrix.coefficient[k]
            matrix.coarse.diagonal[a] = middle
            matrix.coarse.coefficient[wp.static(slots // 2) * count + a] = wp.where(
                middle > scalar(0.0), scalar(1.0) / middle, scalar(0.0)
            )

    return cubes


@functools.cache
def coarse_kernels(scalar, dimensions: int, vector: bool) -> SimpleNamespace:
    """Build the GPU kernels that form the coarse matrix.

    Cubes are the cells of the coarse grid. First, `pairs` adds up the matrix coefficients between a particle and all
    particles of each cube around it (one task per particle). Then `sums` adds up the results of all particles of a cube
    (one task per entry of the coarse matrix).
    """
    FlowConstants = flow_struct(scalar)
    Matrix = array_structs(scalar, dimensions).Matrix
    slot_of = slot_function(scalar, dimensions)
    place = row_place(False)
    slots = 3**dimensions

    @wp.kernel(enable_backward=False, module="unique")
    def pairs(flow: FlowConstants, flags: wp.array(dtype=wp.int32), matrix: Matrix):
        """Sum each particle's matrix coefficients over its own cube of the coarse grid, and over each adjacent cube."""
        if flags[HALTED] != 0:
            return
        i = wp.tid()
        for s in range(slots):
            matrix.coarse.pair[s * flow.count + i] = scalar(0.0)
        middle = scalar(0.0)
        if wp.static(vector) or matrix.free[i] == 0:
            middle = matrix.diagonal[i]
            if wp.static(vector):
                middle += matrix.drag[i]
            own = matrix.coarse.of[i]
            for k in range(matrix.near_count[i]):
                at = place(i, k, flow.count, matrix.near_capacity)
                j = matrix.near[at]
                other = matrix.coarse.of[j]
                if wp.static(vector) or matrix.free[j] == 0:
                    if other == own:
                        middle -= matrix.coefficient[at]
                    else:
                        to = slot_of(matrix, own, other) * flow.count + i
                        matrix.coarse.pair[to] = matrix.coarse.pair[to] + matrix.coefficient[at]
        matrix.coarse.pair[wp.static(slots // 2) * flow.count + i] = middle

    @wp.kernel(enable_backward=False, module="unique")
    def sums(flow: FlowConstants, flags: wp.array(dtype=wp.int32), matrix: Matrix):
        """Compute one entry of the coarse matrix: the sum of the results of `pairs` over the particles of a cube."""
        if flags[HALTED] != 0:
            return
        entry = wp.tid()
        a = entry % matrix.coarse.count
        s = entry / matrix.coarse.count
        sum = scalar(0.0)
        for k in range(matrix.coarse.first[a], matrix.coarse.first[a + 1]):
            sum += matrix.coarse.pair[s * flow.count + matrix.coarse.member[k]]
        if s == wp.static(slots // 2):
            matrix.coarse.diagonal[a] = sum
            sum = wp.where(sum > scalar(0.0), scalar(1.0) / sum, scalar(0.0))
        matrix.coarse.coefficient[entry] = sum

    return SimpleNamespace(pairs=pairs, sums=sums)


LANES = """
#if defined(__CUDA_ARCH__)
    return 32;
#else
    return 1;
#endif
"""
WAIT = """
#if defined(__CUDA_ARCH__)
    __syncwarp();
#endif
"""
SUMMED = """
#if defined(__CUDA_ARCH__)
    for (int step = 16; step > 0; step /= 2)
        EACH += __shfl_xor_sync(0xffffffffu, EACH, step);
#endif
    return part;
"""


@wp.func_native(LANES)
def lanes() -> wp.int32:
    """Return the number of threads that work together: 32 (a warp) on a GPU, 1 on a CPU."""
    ...


@wp.func_native(WAIT)
def wait_for_lanes():
    """Wait until all lanes (threads) of a warp have made this call; each then sees what all others wrote before it."""
    ...


@functools.cache
def lane_sum(value):
    """Build the function that sums a value over all lanes (threads) of a warp and returns the sum to each of them."""
    width = wp.types.type_size(value)
    each, one = (f"for (int c = 0; c < {width}; ++c) part[c]", "part[c]") if width > 1 else ("part", "part")
    snippet = SUMMED.replace("EACH +=", f"{each} +=").replace("EACH", one)

    @wp.func_native(snippet)
    def sum(part: value) -> value: ...

    return sum


@functools.cache
def coarse_functions(scalar, dimensions: int, vector: bool) -> SimpleNamespace:
    """Build `load` and `sweep`, which solve the coarse equations approximately by Chebyshev iteration.

    `load` sums the residual over each cube and computes the first guess. Each call of `sweep` improves the solution by
    one step (Saad, Iterative Methods for Sparse Linear Systems, 2nd ed., algorithm 12.1). A cube is
    a cell of the coarse grid. All threads of a warp call a function together and share the work for each cube; on a
    CPU, a warp is a single thread. A warp handles the cubes `first`, `first + by`, and so on below `end`. The loops
    over cubes are inside the functions, because on a CPU each call copies the structs passed to it.
    """
    structs = array_structs(scalar, dimensions)
    Matrix = structs.Matrix
    Solve = structs.VectorSolve if vector else structs.NumberSolve
    value = Solve.vars["residual"].type.dtype
    whole = lane_sum(value)
    slots = 3**dimensions

    @wp.func
    def load(
        first: wp.int32, end: wp.int32, by: wp.int32, lane: wp.int32, abreast: wp.int32, matrix: Matrix, system: Solve
    ):
        for a in range(first, end, by):
            part = value(scalar(0.0))
            for k in range(matrix.coarse.first[a] + lane, matrix.coarse.first[a + 1], abreast):
                part += system.residual[matrix.coarse.member[k]]
            sum = whole(part)
            if lane == 0:
                inverse = matrix.coarse.coefficient[wp.static(slots // 2) * matrix.coarse.count + a]
                guess = sum * (inverse / scalar(MIDDLE))
                system.load[a] = sum
                system.change[a] = guess
                system.lift[a] = guess

    @wp.func
    def sweep(
        first: wp.int32, end: wp.int32, by: wp.int32, lane: wp.int32, abreast: wp.int32, old: wp.int32, before: scalar,
        matrix: Matrix, system: Solve,
    ) -> scalar:  # fmt: skip
        """Make one step of the Chebyshev iteration, and return the step's coefficient.

        `before` is the coefficient that the previous step returned. The array `lift` has room for two solutions, one in
        each half. The step reads the solution that begins at index `old`, and writes the improved solution to the other
        half.
        """
        count = matrix.coarse.count
        now = scalar(1.0) / (scalar(wp.static(2.0 * MIDDLE / REACH)) - before)
        for a in range(first, end, by):
            part = value(scalar(0.0))
            for s in range(lane, slots, abreast):
                other = matrix.coarse.neighbour[s * count + a]
                if other >= 0 and s != wp.static(slots // 2):
                    part += matrix.coarse.coefficient[s * count + a] * system.lift[old + other]
            sum = whole(part)
            if lane == 0:
                own = system.lift[old + a]
                left = system.load[a] + sum - matrix.coarse.diagonal[a] * own
                inverse = matrix.coarse.coefficient[wp.static(slots // 2) * count + a]
                change = (now * before) * system.change[a] + (scalar(wp.static(2.0 / REACH)) * now * inverse) * left
                system.change[a] = change
                system.lift[count - old + a] = own + change
                if wp.static(vector):
                    system.inner[a] = wp.float64(wp.dot(system.load[a], own + change))
                else:
                    system.inner[a] = wp.float64(system.load[a] * (own + change))
        return now

    return SimpleNamespace(load=load, sweep=sweep)
