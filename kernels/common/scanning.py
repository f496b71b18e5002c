"""Exclusive prefix sums, which turn the lengths of consecutive rows into the index where each row begins."""

import functools
from types import SimpleNamespace

import warp as wp

from .reductions import BLOCK, block_sums

VALUES_PER_THREAD = 8
"""Number of consecutive values that one GPU thread adds up to form prefix sums."""


@functools.cache
def scanning_kernels(alone: bool) -> SimpleNamespace:
    """Build the kernels that write the exclusive prefix sums of `values` to `before`, both of shape (count,).

    The exclusive prefix sum of an element is the sum of all elements before it. If `alone` is true (CPU), the kernel
    ``spread`` computes all sums in a single task. Otherwise (GPU), two kernels run in whole blocks: ``add_up`` stores
    the sum of each block in `partial`, and ``spread`` completes the sums.
    """
    sums = block_sums(BLOCK)
    keep, total = sums.keep, sums.total

    @wp.kernel(enable_backward=False, module="unique")
    def spread_alone(count: wp.int32, values: wp.array(dtype=wp.int32), before: wp.array(dtype=wp.int32)):
        sum = wp.int32(0)
        for i in range(count):
            before[i] = sum
            sum += values[i]

    @wp.func
    def own_sum(values: wp.array(dtype=wp.int32), thread: wp.int32, count: wp.int32) -> wp.int32:
        sum = wp.int32(0)
        for i in range(thread * VALUES_PER_THREAD, wp.min((thread + 1) * VALUES_PER_THREAD, count)):
            sum += values[i]
        return sum

    @wp.kernel(enable_backward=False, module="unique", grid_stride=False)
    def add_up(count: wp.int32, values: wp.array(dtype=wp.int32), partial: wp.array(dtype=wp.float64)):
        # Sums in float64 are exact here, because all values are whole numbers below 2^53.
        keep(wp.tid(), partial, 0, wp.float64(own_sum(values, wp.tid(), count)))

    @wp.kernel(enable_backward=False, module="unique", grid_stride=False)
    def spread(
        count: wp.int32, values: wp.array(dtype=wp.int32), partial: wp.array(dtype=wp.float64),
        before: wp.array(dtype=wp.int32),
    ):  # fmt: skip
        thread = wp.tid()
        behind = wp.untile(wp.tile_scan_exclusive(wp.tile(own_sum(values, thread, count))))
        sum = wp.int32(total(thread, partial, 0, thread / BLOCK)) + behind
        for i in range(thread * VALUES_PER_THREAD, wp.min((thread + 1) * VALUES_PER_THREAD, count)):
            before[i] = sum
            sum += values[i]

    return SimpleNamespace(spread=spread_alone) if alone else SimpleNamespace(add_up=add_up, spread=spread)
