"""Exclusive prefix sums on a device: they turn the lengths of rows into the indices at which the rows begin.

The rows are stored end to end. The sums use kernels of this package, so that every launch graph can contain them.
"""

import warp as wp

from ...kernels.common.reductions import BLOCK
from ...kernels.common.scanning import VALUES_PER_THREAD, scanning_kernels
from .arrays import DeviceArray, zeros
from .device import parallel
from .launching import Stage


def scan_stages(values: DeviceArray, before: DeviceArray) -> list[Stage]:
    """Return stages (recorded kernel launches) that write the exclusive prefix sum of `values` to `before`.

    The element `before[i]` is the sum of `values[0]` to `values[i - 1]`. Both arrays have shape (n,) and are on the
    same device.
    """
    device = values.device
    count = len(values)
    kernels = scanning_kernels(not parallel(device))
    named = {"count": count, "values": values, "before": before}
    if not parallel(device):
        return [Stage(kernels.spread, 1, named, device)]
    # The values are divided into blocks, and the first launch stores the sum of each block. For each value, the second
    # launch adds up the sums of all previous blocks and the previous values in the same block.
    blocks = -(-count // (VALUES_PER_THREAD * BLOCK))
    partial = zeros(blocks, dtype=wp.float64, device=device)
    added = {"count": count, "values": values, "partial": partial}
    return [
        Stage(kernels.add_up, blocks * BLOCK, added, device, block=BLOCK),
        Stage(kernels.spread, blocks * BLOCK, {**added, "before": before}, device, block=BLOCK),
    ]
