"""Where each of many rows begins: the sum of the lengths of all before it."""

import functools
from types import SimpleNamespace

import warp as wp

from .reductions import BLOCK, block_sums

EACH = 8
"""Numbers that fall to a thread of a GPU, one after the other."""


@functools.cache
def scanning_kernels(alone: bool) -> SimpleNamespace:
    """Kernels that make of `values` their sums so far, `before` each, both of shape (count,): ``spread`` in one task if
    it is `alone`; else ``add_up``, then ``spread``, in whole blocks of which each leaves a `partial` sum.
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
        for i in range(thread * EACH, wp.min((thread + 1) * EACH, count)):
            sum += values[i]
        return sum

    @wp.kernel(enable_backward=False, module="unique", grid_stride=False)
    def add_up(count: wp.int32, values: wp.array(dtype=wp.int32), partial: wp.array(dtype=wp.float64)):
        # Whole numbers below 2^53, so no sum is rounded.
        keep(wp.tid(), partial, 0, wp.float64(own_sum(values, wp.tid(), count)))

    @wp.kernel(enable_backward=False, module="unique", grid_stride=False)
    def spread(
        count: wp.int32, values: wp.array(dtype=wp.int32), partial: wp.array(dtype=wp.float64),
        before: wp.array(dtype=wp.int32),
    ):  # fmt: skip
        thread = wp.tid()
        behind = wp.untile(wp.tile_scan_exclusive(wp.tile(own_sum(values, thread, count))))
        sum = wp.int32(total(thread, partial, 0, thread / BLOCK)) + behind
        for i in range(thread * EACH, wp.min((thread + 1) * EACH, count)):
            before[i] = sum
            sum += values[i]

    return SimpleNamespace(spread=spread_alone) if alone else SimpleNamespace(add_up=add_up, spread=spread)
