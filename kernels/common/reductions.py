"""Sums over all elements of an array, always added in the same order so that every run gives the same bits."""

import functools
from types import SimpleNamespace

import warp as wp

BLOCK = 256
"""Number of threads in a CUDA block; each block forms one partial sum."""


@functools.cache
def block_sums(width: int) -> SimpleNamespace:
    """Build the functions `keep` and `total`, with which kernels sum a value over all threads of all blocks.

    A block has `width` threads. `keep` stores the sum over the threads of one block, and `total` adds up the stored
    sums of all blocks.
    """

    @wp.func
    def keep(thread: wp.int32, partial: wp.array(dtype=wp.float64), first: wp.int32, own: wp.float64):
        """Store the sum of `own` over the threads of a block in `partial[first + block]`.

        All threads of the block must call this function together.
        """
        whole = wp.tile_sum(wp.tile(own))
        sum = whole[0]
        if thread % width == 0:
            partial[first + thread / width] = sum

    @wp.func
    def total(thread: wp.int32, partial: wp.array(dtype=wp.float64), first: wp.int32, blocks: wp.int32) -> wp.float64:
        """Return the sum of the `blocks` values that start at `partial[first]`.

        All threads of the block must call this function together.
        """
        own = wp.float64(0.0)
        for k in range(thread % width, blocks, width):
            own += partial[first + k]
        whole = wp.tile_sum(wp.tile(own))
        return whole[0]

    return SimpleNamespace(keep=keep, total=total)


keep, total = block_sums(BLOCK).keep, block_sums(BLOCK).total


@functools.cache
def serial_scale(scalar):
    """Build the CPU kernel (one task) that computes the factor by which weights are scaled to add up to `wanted`."""

    @wp.kernel(enable_backward=False, module="unique")
    def scale_alone(
        count: wp.int32, wanted: wp.float64, weight: wp.array(dtype=scalar), factor: wp.array(dtype=wp.float64)
    ):
        sum = wp.float64(0.0)
        for i in range(count):
            sum += wp.float64(weight[i])
        factor[0] = wp.where(sum > wp.float64(0.0), wanted / sum, wp.float64(0.0))

    return scale_alone


@functools.cache
def parallel_scale(scalar):
    """Build the GPU kernels that compute the factor by which weights must be scaled to add up to `wanted`.

    `gather` runs in whole blocks and stores partial sums of `weight`. `divide` then runs in a single block and divides
    `wanted` by the sum of all weights.
    """

    @wp.kernel(enable_backward=False, module="unique")
    def gather(count: wp.int32, weight: wp.array(dtype=scalar), partial: wp.array(dtype=wp.float64)):
        i = wp.tid()
        own = wp.float64(0.0)
        if i < count:
            own = wp.float64(weight[i])
        keep(i, partial, 0, own)

    @wp.kernel(enable_backward=False, module="unique")
    def divide(
        blocks: wp.int32, wanted: wp.float64, partial: wp.array(dtype=wp.float64), factor: wp.array(dtype=wp.float64)
    ):
        i = wp.tid()
        sum = total(i, partial, 0, blocks)
        if i == 0:
            factor[0] = wp.where(sum > wp.float64(0.0), wanted / sum, wp.float64(0.0))

    return gather, divide
