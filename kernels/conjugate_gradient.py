"""Conjugate gradients for the two kinds of equations of the moving particle method, matrix-free but for pair weights.

A row is: diagonal times own value, less the pair coefficients times the neighbours' values; rows of velocities may
also resist motion along the wall. The preconditioner is the diagonal. A CPU runs a whole solve in one kernel, a thread
for each chunk of rows, with barriers where sums are formed; a GPU runs three kernels an iteration inside a loop of a
CUDA graph. Sums are formed in the same order every time.
"""

import functools
from types import SimpleNamespace

import warp as wp

from .mps_types import FAILED, HALTED, fluid_struct, mps_functions, mps_types, row_place
from .rows import row_product
from .sums import BLOCK, keep, total
from .threads import meet
from .types import cpu_flags

# Slots of the outcome of a solve.
ITERATIONS = wp.constant(0)
BEFORE = wp.constant(1)  # norm of the residual at the start
AFTER = wp.constant(2)  # and at the end
OUTCOME = 4


@functools.cache
def solver_functions(scalar, dimensions: int, vector: bool) -> SimpleNamespace:
    """What a row of the solution is (`value`), its `inner` product, the preconditioner, and what walls and surface add.

    Rows of velocities are bound to the wall by `drag`, along it only; rows of scalars at the free surface are zero.
    """
    t = mps_types(scalar, dimensions)
    f = mps_functions(scalar, dimensions)
    value = t.vec if vector else scalar

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

    return SimpleNamespace(value=value, inner=inner, divided=divided, bounded=bounded)


@functools.cache
def serial_solver(scalar, dimensions: int, vector: bool):
    """Kernel of one task a thread: the whole solve over rows `first` to `end`."""
    t = mps_types(scalar, dimensions)
    f = solver_functions(scalar, dimensions, vector)
    Flow = fluid_struct(scalar)
    value = f.value
    product = row_product(scalar, value)

    @wp.kernel(enable_backward=False, module="unique", module_options={"cpu_compiler_flags": cpu_flags()})
    def solve(
        flow: Flow,
        part: wp.int32,
        parts: wp.int32,
        first: wp.int32,
        end: wp.int32,
        near_capacity: wp.int32,
        what: wp.int32,
        tolerance: wp.float64,
        enough: wp.float64,
        most: wp.int32,
        gate: wp.array(dtype=wp.int32),
        flags: wp.array(dtype=wp.int32),
        near_count: wp.array(dtype=wp.int32),
        near: wp.array(dtype=wp.int32),
        position: wp.array(dtype=t.vec),
        coefficient: wp.array(dtype=scalar),
        free: wp.array(dtype=wp.int32),
        diagonal: wp.array(dtype=scalar),
        drag: wp.array(dtype=scalar),
        r: wp.array(dtype=value),
        p: wp.array(dtype=value),
        q: wp.array(dtype=value),
        x: wp.array(dtype=value),
        partial: wp.array(dtype=wp.float64),
        outcome: wp.array(dtype=wp.float64),
        history: wp.array(dtype=wp.float64),
    ):
        if flags[HALTED] != 0:
            return
        rz = wp.float64(0.0)
        rr = wp.float64(0.0)
        for i in range(first, end):
            z = f.divided(r[i], free[i], diagonal[i], drag[i])
            p[i] = z
            rz += f.inner(r[i], z)
            rr += f.inner(r[i], r[i])
        partial[part] = rz
        partial[parts + part] = rr
        meet(gate, parts)
        rz = wp.float64(0.0)
        rr = wp.float64(0.0)
        for k in range(parts):
            rz += partial[k]
            rr += partial[parts + k]
        start = wp.sqrt(rr)
        goal = wp.max(tolerance * tolerance * rr, enough * enough)
        count = wp.int32(0)
        while rr > goal and count < most:
            pq = wp.float64(0.0)
            for i in range(first, end):
                own = p[i]
                sum = diagonal[i] * own - product(near, coefficient, p, i * near_capacity, near_count[i])
                sum = f.bounded(sum, own, position[i], free[i], drag[i])
                q[i] = sum
                pq += f.inner(own, sum)
            partial[2 * parts + part] = pq
            meet(gate, parts)
            pq = wp.float64(0.0)
            for k in range(parts):
                pq += partial[2 * parts + k]
            if pq <= wp.float64(0.0):
                break
            alpha = scalar(rz / pq)
            rz_after = wp.float64(0.0)
            rr = wp.float64(0.0)
            for i in range(first, end):
                x[i] = x[i] + alpha * p[i]
                left = r[i] - alpha * q[i]
                r[i] = left
                z = f.divided(left, free[i], diagonal[i], drag[i])
                q[i] = z
                rz_after += f.inner(left, z)
                rr += f.inner(left, left)
            partial[part] = rz_after
            partial[parts + part] = rr
            meet(gate, parts)
            rz_after = wp.float64(0.0)
            rr = wp.float64(0.0)
            for k in range(parts):
                rz_after += partial[k]
                rr += partial[parts + k]
            beta = scalar(rz_after / rz)
            rz = rz_after
            for i in range(first, end):
                p[i] = q[i] + beta * p[i]
            if part == 0 and count < history.shape[0]:
                history[count] = wp.sqrt(rr)
            count += 1
            meet(gate, parts)
        if part == 0:
            outcome[ITERATIONS] = wp.float64(count)
            outcome[BEFORE] = start
            outcome[AFTER] = wp.sqrt(rr)
            if not rr <= goal:
                flags[FAILED] = what
        # Nobody may look at the flags before all have left the loop.
        meet(gate, parts)
        if part == 0 and flags[FAILED] != 0:
            flags[HALTED] = 1
        meet(gate, parts)

    return solve


@functools.cache
def parallel_solver(scalar, dimensions: int, vector: bool):
    """Kernels `begin` and `ready`, then `multiply`, `update` and `direct` in turn, launched in whole blocks.

    `now` is 0 and 1 in turn: which of two numbers holds the inner product of residual and preconditioned residual.
    """
    t = mps_types(scalar, dimensions)
    f = solver_functions(scalar, dimensions, vector)
    Flow = fluid_struct(scalar)
    place = row_place(False)
    value = f.value

    @wp.kernel(enable_backward=False, module="unique")
    def begin(
        flow: Flow,
        blocks: wp.int32,
        free: wp.array(dtype=wp.int32),
        diagonal: wp.array(dtype=scalar),
        drag: wp.array(dtype=scalar),
        r: wp.array(dtype=value),
        p: wp.array(dtype=value),
        partial: wp.array(dtype=wp.float64),
    ):
        i = wp.tid()
        rz = wp.float64(0.0)
        rr = wp.float64(0.0)
        if i < flow.count:
            z = f.divided(r[i], free[i], diagonal[i], drag[i])
            p[i] = z
            rz = f.inner(r[i], z)
            rr = f.inner(r[i], r[i])
        keep(i, partial, 0, rz)
        keep(i, partial, blocks, rr)

    @wp.kernel(enable_backward=False, module="unique")
    def ready(
        blocks: wp.int32,
        tolerance: wp.float64,
        enough: wp.float64,
        flags: wp.array(dtype=wp.int32),
        partial: wp.array(dtype=wp.float64),
        numbers: wp.array(dtype=wp.float64),
        outcome: wp.array(dtype=wp.float64),
        going: wp.array(dtype=wp.int32),
    ):
        i = wp.tid()
        rz = total(i, partial, 0, blocks)
        rr = total(i, partial, blocks, blocks)
        if i == 0:
            goal = wp.max(tolerance * tolerance * rr, enough * enough)
            numbers[0] = rz
            numbers[2] = goal
            going[0] = 0
            if flags[HALTED] == 0:
                outcome[ITERATIONS] = wp.float64(0.0)
                outcome[BEFORE] = wp.sqrt(rr)
                outcome[AFTER] = wp.sqrt(rr)
                if rr > goal:
                    going[0] = 1

    @wp.kernel(enable_backward=False, module="unique")
    def multiply(
        flow: Flow,
        blocks: wp.int32,
        near_capacity: wp.int32,
        near_count: wp.array(dtype=wp.int32),
        near: wp.array(dtype=wp.int32),
        position: wp.array(dtype=t.vec),
        coefficient: wp.array(dtype=scalar),
        free: wp.array(dtype=wp.int32),
        diagonal: wp.array(dtype=scalar),
        drag: wp.array(dtype=scalar),
        going: wp.array(dtype=wp.int32),
        p: wp.array(dtype=value),
        q: wp.array(dtype=value),
        partial: wp.array(dtype=wp.float64),
    ):
        if going[0] == 0:
            return
        i = wp.tid()
        pq = wp.float64(0.0)
        if i < flow.count:
            own = p[i]
            sum = diagonal[i] * own
            for k in range(near_count[i]):
                at = place(i, k, flow.count, near_capacity)
                sum -= coefficient[at] * p[near[at]]
            sum = f.bounded(sum, own, position[i], free[i], drag[i])
            q[i] = sum
            pq = f.inner(own, sum)
        keep(i, partial, 2 * blocks, pq)

    @wp.kernel(enable_backward=False, module="unique")
    def update(
        flow: Flow,
        blocks: wp.int32,
        now: wp.int32,
        free: wp.array(dtype=wp.int32),
        diagonal: wp.array(dtype=scalar),
        drag: wp.array(dtype=scalar),
        going: wp.array(dtype=wp.int32),
        numbers: wp.array(dtype=wp.float64),
        p: wp.array(dtype=value),
        q: wp.array(dtype=value),
        r: wp.array(dtype=value),
        x: wp.array(dtype=value),
        partial: wp.array(dtype=wp.float64),
    ):
        if going[0] == 0:
            return
        i = wp.tid()
        pq = total(i, partial, 2 * blocks, blocks)
        alpha = scalar(0.0)
        if pq > wp.float64(0.0):
            alpha = scalar(numbers[now] / pq)
        rz = wp.float64(0.0)
        rr = wp.float64(0.0)
        if i < flow.count:
            x[i] = x[i] + alpha * p[i]
            left = r[i] - alpha * q[i]
            r[i] = left
            z = f.divided(left, free[i], diagonal[i], drag[i])
            q[i] = z
            rz = f.inner(left, z)
            rr = f.inner(left, left)
        keep(i, partial, 0, rz)
        keep(i, partial, blocks, rr)

    @wp.kernel(enable_backward=False, module="unique")
    def direct(
        flow: Flow,
        blocks: wp.int32,
        now: wp.int32,
        most: wp.int32,
        what: wp.int32,
        flags: wp.array(dtype=wp.int32),
        partial: wp.array(dtype=wp.float64),
        going: wp.array(dtype=wp.int32),
        numbers: wp.array(dtype=wp.float64),
        p: wp.array(dtype=value),
        q: wp.array(dtype=value),
        outcome: wp.array(dtype=wp.float64),
        history: wp.array(dtype=wp.float64),
    ):
        # The first block may end the loop while others set out: what they then leave out, nobody reads.
        if going[0] == 0:
            return
        i = wp.tid()
        rz = total(i, partial, 0, blocks)
        beta = scalar(rz / numbers[now])
        if i < flow.count:
            p[i] = q[i] + beta * p[i]
        if i < BLOCK:
            rr = total(i, partial, blocks, blocks)
            if i == 0:
                count = wp.int32(outcome[ITERATIONS])
                if count < history.shape[0]:
                    history[count] = wp.sqrt(rr)
                count += 1
                outcome[ITERATIONS] = wp.float64(count)
                outcome[AFTER] = wp.sqrt(rr)
                numbers[1 - now] = rz
                if rr <= numbers[2]:
                    going[0] = 0
                elif not (rr > numbers[2]) or count >= most:
                    going[0] = 0
                    flags[FAILED] = what
                    flags[HALTED] = 1

    return begin, ready, multiply, update, direct
