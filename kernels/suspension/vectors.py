"""Vectors of the coupled equations of mortar and aggregates, and functions for them.

The functions distribute the entries of vectors over tasks, compute inner products, and add multiples of vectors.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.reductions import BLOCK, keep, total
from ..common.types import types
from ..mps.coarse import lanes

# The next constants are indices into `sums`, the array of inner products of a solve by conjugate gradients. The vectors
# are the residual r, the preconditioned residual z and the search direction p; A is the matrix.
RZ = wp.constant(0)  # Entry of `sums`: r z before the iteration.
PQ = wp.constant(1)  # Entry of `sums`: p A p.
RZ_AFTER = wp.constant(2)  # Entry of `sums`: r z after the iteration.
RZ_FIRST = wp.constant(3)  # Entry of `sums`: r z at the start of the solve.
SUMS = 4


@functools.cache
def vector_struct(scalar):
    """Build the struct `Vector`, which holds the values of all unknowns, or the residuals of all equations."""
    vec3 = types(scalar).vec3

    @wp.struct
    class Vector:
        faces: wp.array(dtype=scalar)  # Velocity of each face, or the force on it, shape (3 * cells,).
        linear: wp.array(dtype=vec3)  # Velocity of each aggregate, or the force on it, shape (n,).
        angular: wp.array(dtype=vec3)  # Spin of each aggregate, or the torque on it, shape (n,).
        cells: wp.array(dtype=scalar)  # Pressure in each cell, or the net inflow into it, shape (cells,).

    return Vector


@functools.cache
def share_functions(serial: bool) -> SimpleNamespace:
    """Build the functions `first`, `end` and `stride`, which give the range of items that one task processes.

    A task on a CPU gets a contiguous range of items. On a GPU, a task gets every n-th item, where n is the number of
    tasks.
    """

    @wp.func
    def first(task: wp.int32, tasks: wp.int32, items: wp.int32) -> wp.int32:
        if wp.static(serial):
            return wp.int32(wp.int64(task) * wp.int64(items) / wp.int64(tasks))
        return task

    @wp.func
    def end(task: wp.int32, tasks: wp.int32, items: wp.int32) -> wp.int32:
        if wp.static(serial):
            return wp.int32(wp.int64(task + 1) * wp.int64(items) / wp.int64(tasks))
        return items

    @wp.func
    def stride(tasks: wp.int32) -> wp.int32:
        return wp.where(wp.static(serial), 1, tasks)

    return SimpleNamespace(first=first, end=end, stride=stride)


@wp.func
def share_of_body(task: wp.int32, tasks: wp.int32):
    """Return the number of the aggregate that a task works on, and the lane of the task.

    Tasks from number `tasks` on work on aggregates: one task on each aggregate on a CPU, and the 32 lanes (threads) of
    a warp on a GPU. A GPU starts whole blocks of tasks, so the returned number may be larger than that of the last
    aggregate.
    """
    return (task - tasks) / lanes(), (task - tasks) % lanes()


@functools.cache
def store_function(serial: bool):
    """Build the function that stores a task's partial sum of an inner product in `partial`, from the index `first` on.

    A CPU stores a sum for each task. A GPU stores one for each block of BLOCK tasks, all of which must call the
    function together.
    """

    @wp.func
    def store(task: wp.int32, partial: wp.array(dtype=wp.float64), first: wp.int32, sum: wp.float64):
        if wp.static(serial):
            partial[first + task] = sum
        else:
            keep(task, partial, first, sum)

    return store


@functools.cache
def sum_kernel(serial: bool):
    """Build the kernel that adds up the `count` partial sums of each of several inner products.

    `slot` is the index at which the first inner product is stored. The kernel runs with one task for each inner product
    on a CPU, and with one block for each on a GPU.
    """

    @wp.kernel(enable_backward=False, module="unique")
    def add_up(count: wp.int32, slot: wp.int32, partial: wp.array(dtype=wp.float64), sums: wp.array(dtype=wp.float64)):
        if wp.static(serial):
            part = wp.tid()
            sum = wp.float64(0.0)
            for k in range(part * count, (part + 1) * count):
                sum += partial[k]
            sums[slot + part] = sum
        else:
            part = wp.tid() / BLOCK
            sum = total(wp.tid(), partial, part * count, count)
            if wp.tid() % BLOCK == 0:
                sums[slot + part] = sum

    return add_up


DOT = """
    const SCALAR* __restrict__ x = one.data;
    const SCALAR* __restrict__ y = many.data + offset;
    double a = 0.0, b = 0.0, c = 0.0, d = 0.0;
    int i = first;
    for (; i + 3 * STRIDE < end; i += 4 * STRIDE) {
        a += double(x[i]) * double(y[i]);
        b += double(x[i + STRIDE]) * double(y[i + STRIDE]);
        c += double(x[i + 2 * STRIDE]) * double(y[i + 2 * STRIDE]);
        d += double(x[i + 3 * STRIDE]) * double(y[i + 3 * STRIDE]);
    }
    for (; i < end; i += STRIDE)
        a += double(x[i]) * double(y[i]);
    return (a + b) + (c + d);
"""
ADD = """
    const SCALAR* __restrict__ x = many.data + offset;
    SCALAR* __restrict__ y = result.data;
    for (int i = first; i < end; i += STRIDE)
        y[i] += factor * x[i];
"""
MOVE = """
    const SCALAR* __restrict__ p = direction.data;
    const SCALAR* __restrict__ s = inverse.data;
    SCALAR* __restrict__ x = solution.data;
    SCALAR* __restrict__ r = residual.data;
    SCALAR* __restrict__ q = product.data;
    double sum = 0.0;
UNROLL
    for (int i = first; i < end; i += STRIDE) {
        x[i] += alpha * p[i];
        const SCALAR left = r[i] - alpha * q[i], next = s[i] * left;
        r[i] = left;
        q[i] = next;
#if defined(__CUDA_ARCH__)
        sum += double(next) * double(left);
#endif
    }
    return sum;
"""
TURN = """
    const SCALAR* __restrict__ z = product.data;
    const SCALAR* __restrict__ s = inverse.data;
    SCALAR* __restrict__ p = direction.data;
UNROLL
    for (int i = first; i < end; i += STRIDE)
        if (s[i] != 0)
            p[i] = z[i] + beta * p[i];
"""


@functools.cache
def range_functions(scalar, serial: bool) -> SimpleNamespace:
    """Build the vector operations of a conjugate-direction solver; each call works on a range of the vectors' entries.

    - `dot` returns the inner product of `one` and of the vector that begins at the index `offset` of `many`.
    - `add` adds a multiple of the vector that begins at the index `offset` of `many` to `result`.
    - `move` adds `alpha` times a search direction to the solution, and subtracts `alpha` times `product` from the
      residual, where `product` holds the matrix times the direction. Then it overwrites `product` with the new residual
      times `inverse`, the inverse of the matrix's diagonal. On a GPU, it returns the inner product of the new residual
      and the new `product`, because this saves reading them again; on a CPU, it returns 0.
    - `turn` computes the next search direction for entries that are unknowns, that is, whose `inverse` is not 0.
    """
    name, stride = "double" if scalar is wp.float64 else "float", "1" if serial else "stride"
    array, integer = wp.array(dtype=scalar), wp.int32

    def source(text: str) -> str:
        # A GPU thread processes three or four entries. With an unrolled loop, it reads them without waiting for each.
        text = text.replace("UNROLL", "" if serial else "#pragma unroll 3")
        return text.replace("SCALAR", name).replace("STRIDE", stride)

    @wp.func_native(source(DOT))
    def dot(one: array, many: array, offset: integer, first: integer, end: integer, stride: integer) -> wp.float64: ...

    @wp.func_native(source(ADD))
    def add(
        factor: scalar, many: array, offset: integer, result: array, first: integer, end: integer, stride: integer
    ): ...

    @wp.func_native(source(MOVE))
    def move(
        alpha: scalar, direction: array, inverse: array, solution: array, residual: array, product: array,
        first: integer, end: integer, stride: integer,
    ) -> wp.float64: ...  # fmt: skip

    @wp.func_native(source(TURN))
    def turn(
        beta: scalar, product: array, inverse: array, direction: array, first: integer, end: integer, stride: integer
    ): ...

    return SimpleNamespace(dot=dot, add=add, move=move, turn=turn)


@functools.cache
def add_kernel(scalar):
    """Build the kernel that adds a multiple of an array to another one, with one task per element."""

    @wp.kernel(enable_backward=False, module="unique")
    def add_multiple(one: wp.array(dtype=scalar), factor: scalar, result: wp.array(dtype=scalar)):
        k = wp.tid()
        result[k] = result[k] + factor * one[k]

    return add_multiple
