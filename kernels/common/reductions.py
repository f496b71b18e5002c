"""Sums over all rows that are the same to the bit every time."""

import functools
from types import SimpleNamespace

import warp as wp

BLOCK = 256
"""Threads of a CUDA block, which forms one partial sum."""


@functools.cache
def block_sums(width: int) -> SimpleNamespace:
    """`keep` and `total` of blocks of so many threads."""

    @wp.func
    def keep(thread: wp.int32, partial: wp.array(dtype=wp.float64), first: wp.int32, own: wp.float64):
        """Add up what the threads of a block bring, into `partial[first + block]`. All of them must call."""
        whole = wp.tile_sum(wp.tile(own))
        sum = whole[0]
        if thread % width == 0:
            partial[first + thread / width] = sum

    @wp.func
    def total(thread: wp.int32, partial: wp.array(dtype=wp.float64), first: wp.int32, blocks: wp.int32) -> wp.float64:
        """Sum of the partial sums of all blocks, for every thread of a block. All of them must call."""
        own = wp.float64(0.0)
        for k in range(thread % width, blocks, width):
            own += partial[first + k]
        whole = wp.tile_sum(wp.tile(own))
        return whole[0]

    return SimpleNamespace(keep=keep, total=total)


keep, total = block_sums(BLOCK).keep, block_sums(BLOCK).total


@functools.cache
def serial_scale(scalar):
    """Factor that gives weights a wanted sum, on a CPU: a kernel of one task."""

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
    """The same on a GPU: `gather` in whole blocks, `divide` in one."""

    @wp.kernel(enable_backward=False, module="unique")
    def gather(count: wp.int32, weight: wp.array(dtype=scalar), partial: wp.array(dtype=wp.float64)):
        i = wp.tid()
        own = wp.float64(0.0)
        if i < count:
            own = wp.float64(weight[i])
        keep(i, partial, 0, own)

    @wp.kernel(enable_backward=False, module="unique")
    def divide(
        blocks: wp.int32,
        wanted: wp.float64,
        partial: wp.array(dtype=wp.float64),
        factor: wp.array(dtype=wp.float64),
    ):
        i = wp.tid()
        sum = total(i, partial, 0, blocks)
        if i == 0:
            factor[0] = wp.where(sum > wp.float64(0.0), wanted / sum, wp.float64(0.0))

    return gather, divide
