"""Where each of many rows begins, from their lengths: by kernels of its own, so that any graph may hold it."""

from __future__ import annotations

from typing import Any

import warp as wp

from ..kernels.common.reductions import BLOCK
from ..kernels.common.scanning import EACH, scanning_kernels
from .device import parallel
from .launching import Stage


def scan_stages(values: wp.array, before: wp.array) -> list[Stage]:
    """Stages that put into `before` the sum of all `values` before each; both of shape (n,), on one device."""
    device: Any = values.device
    count = len(values)
    kernels = scanning_kernels(not parallel(device))
    named = {"count": count, "values": values, "before": before}
    if not parallel(device):
        return [Stage(kernels.spread, 1, named, device)]
    blocks = -(-count // (EACH * BLOCK))
    partial = wp.zeros(blocks, dtype=wp.float64, device=device)
    added = {"count": count, "values": values, "partial": partial}
    return [
        Stage(kernels.add_up, blocks * BLOCK, added, device, block=BLOCK),
        Stage(kernels.spread, blocks * BLOCK, {**added, "before": before}, device, block=BLOCK),
    ]
