"""Conjugate gradients on a GPU: a whole solve in one kernel, whose blocks stay and wait for one another.

Rows are in chunks of a block's threads, each of which forms one partial sum; blocks share out chunks. So sums are the
same to the bit however many blocks there are, and a flow may have many of them while it is alone and few beside others.
Nobody launches iterations, so solves of many flows go on at once. A small system has one wide block, which waits for
nobody. `conjugate_gradient.py` has what a row is.
"""

import functools

import warp as wp

from ..common.control import FAILED, HALTED
from ..common.reductions import BLOCK, block_sums
from ..common.rows import directed_product
from .conjugate_gradient import AFTER, BEFORE, ITERATIONS, solver_functions
from .structs import array_structs

RESIDENT = 3
"""Blocks that a multiprocessor surely has room for at once: their kernel takes 85 registers a thread at most."""
WIDE, SMALL = 1024, 2048
"""Threads of the one block of a small system, and its rows at most."""


def resident_blocks(device, rows: int, abreast: int) -> tuple[int, int]:
    """Threads of a block, and blocks that a solve gets of a device, `abreast` of which may run at once."""
    if rows <= SMALL or not device.is_cuda:
        return WIDE if rows <= SMALL else BLOCK, 1
    return BLOCK, max(1, min(-(-rows // BLOCK), RESIDENT * device.sm_count // abreast))


GATHER = """
    WP_TILE_SYNC();
#if defined(__CUDA_ARCH__)
    if (parties > 1) {
        if (threadIdx.x == 0) {
            // The highest bit turns when all are here, and those below are 0 again.
            unsigned* here = reinterpret_cast<unsigned*>(gate.data);
            __threadfence();
            const unsigned before = atomicAdd(here, blockIdx.x == 0 ? 0x80000000u - (parties - 1) : 1u);
            while (((before ^ *reinterpret_cast<volatile unsigned*>(here)) & 0x80000000u) == 0) {}
            __threadfence();
        }
        WP_TILE_SYNC();
    }
#endif
"""


@wp.func_native(GATHER)
def gather(gate: wp.array(dtype=wp.int32), parties: wp.int32):
    """All threads of a kernel's blocks, `parties` of them, wait here for the last. A CPU has one block."""


@functools.cache
def resident_solver(scalar, dimensions: int, vector: bool, rigid: bool = False, width: int = BLOCK):
    """Kernel of `parties` blocks of `width` threads: the whole solve; adds to `x`."""
    keep, total = block_sums(width).keep, block_sums(width).total
    f = solver_functions(scalar, dimensions, vector)
    Solve, value = f.Solve, f.value
    Matrix = array_structs(scalar, dimensions).Matrix
    product = directed_product(scalar, value)

    @wp.kernel(enable_backward=False, module="unique", launch_bounds=(width, RESIDENT if width == BLOCK else 1))
    def solve(
        # what is solved, and how well
        count: wp.int32,
        what: wp.int32,
        tolerance: wp.float64,
        absolute_tolerance: wp.float64,
        maximum: wp.int32,
        # blocks
        parties: wp.int32,
        gate: wp.array(dtype=wp.int32),
        # state, read
        matrix: Matrix,
        # written
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
        bound = wp.int32(0)
        if wp.static(rigid):
            bound = matrix.bound
            sums += (matrix.grains.mobility.shape[0] + width - 1) / width
        for chunk in range(block, blocks, parties):
            i = chunk * width + lane
            own_rz = wp.float64(0.0)
            own_rr = wp.float64(0.0)
            if i >= bound and i < count:
                z = f.divided(system.residual[i], matrix.free[i], matrix.diagonal[i], matrix.drag[i])
                system.preconditioned[i] = z
                own_rz = f.inner(system.residual[i], z)
                own_rr = f.inner(system.residual[i], system.residual[i])
            keep(i, system.partial, 0, own_rz)
            keep(i, system.partial, sums, own_rr)
        if wp.static(rigid):
            for chunk in range(block, sums - blocks, parties):
                g = chunk * width + lane
                own_rz = wp.float64(0.0)
                own_rr = wp.float64(0.0)
                if g < matrix.grains.mobility.shape[0]:
                    own_rz, own_rr = f.share(g, matrix.grains, matrix.position, system.residual, system.preconditioned)
                keep(g, system.partial, blocks, own_rz)
                keep(g, system.partial, sums + blocks, own_rr)
        gather(gate, parties)
        rz = total(lane, system.partial, 0, sums)
        rr = total(lane, system.partial, sums, sums)
        start = wp.sqrt(rr)
        goal = wp.max(tolerance * tolerance * rr, absolute_tolerance * absolute_tolerance)
        done = wp.int32(0)
        beta = scalar(0.0)
        old = count
        if halted != 0:
            rr = wp.float64(0.0)
            goal = wp.float64(0.0)
        while rr > goal and done < maximum:
            for chunk in range(block, blocks, parties):
                i = chunk * width + lane
                own_pq = wp.float64(0.0)
                if i < count:
                    # Neighbours' new directions are formed anew, which spares a wait for them.
                    own = system.preconditioned[i] + beta * system.direction[old + i]
                    system.direction[count - old + i] = own
                    sum = matrix.diagonal[i] * own - product(
                        matrix.near, matrix.coefficient, system.preconditioned, system.direction, beta, old, i, count,
                        matrix.near_count[i],
                    )  # fmt: skip
                    sum = f.bounded(sum, own, matrix.position[i], matrix.free[i], matrix.drag[i])
                    system.product[i] = sum
                    own_pq = f.inner(own, sum)
                keep(i, system.partial, 2 * sums, own_pq)
            gather(gate, parties)
            pq = total(lane, system.partial, 2 * sums, blocks)
            alpha = scalar(0.0)
            if pq > wp.float64(0.0):
                alpha = scalar(rz / pq)
            for chunk in range(block, blocks, parties):
                i = chunk * width + lane
                own_rz = wp.float64(0.0)
                own_rr = wp.float64(0.0)
                if i < count:
                    x[i] = x[i] + alpha * system.direction[count - old + i]
                    left = system.residual[i] - alpha * system.product[i]
                    system.residual[i] = left
                    if not wp.static(rigid) or i >= bound:
                        z = f.divided(left, matrix.free[i], matrix.diagonal[i], matrix.drag[i])
                        system.preconditioned[i] = z
                        own_rz = f.inner(left, z)
                        own_rr = f.inner(left, left)
                keep(i, system.partial, 0, own_rz)
                keep(i, system.partial, sums, own_rr)
            if wp.static(rigid):
                gather(gate, parties)
                for chunk in range(block, sums - blocks, parties):
                    g = chunk * width + lane
                    own_rz = wp.float64(0.0)
                    own_rr = wp.float64(0.0)
                    if g < matrix.grains.mobility.shape[0]:
                        own_rz, own_rr = f.share(
                            g, matrix.grains, matrix.position, system.residual, system.preconditioned
                        )
                    keep(g, system.partial, blocks, own_rz)
                    keep(g, system.partial, sums + blocks, own_rr)
            gather(gate, parties)
            rz_after = total(lane, system.partial, 0, sums)
            rr = total(lane, system.partial, sums, sums)
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
