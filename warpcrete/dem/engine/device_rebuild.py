"""Rebuilds of neighbour lists that a GPU starts and performs without the host, inside a CUDA graph, for one scene."""

from __future__ import annotations

from typing import TYPE_CHECKING

import warp as wp

from ...core.device.arrays import capture_if, zeros
from ...core.device.launching import Stage
from ...kernels.dem.rebuilding import rebuilding_kernels
from .batch import Batch

if TYPE_CHECKING:
    from .neighbors import NeighborLists


class DeviceRebuild:
    """Launches that rebuild the neighbour lists inside a CUDA graph, or do nothing if the lists are up to date.

    If bodies are due for re-sorting, or the new lists do not fit into the arrays, the lists stay marked as stale, and
    the host rebuilds them.
    """

    def __init__(self, lists: NeighborLists) -> None:
        b = lists.batch
        self.lists = lists
        self._rebuild = lists.device_rebuild()
        self._rebuild_requested, self._lists_fit = (zeros(1, dtype=wp.int32, device=b.device) for _ in range(2))
        kernels = rebuilding_kernels(b.scalar)
        self.needs_rebuild = b.stage(kernels.needs_rebuild, 1, requested=self._rebuild_requested)
        self.fit = b.stage(
            kernels.fit, 1, scanned=lists.scanned, room=self.room(), face_scanned=lists.face_scanned,
            face_room=int(b.face_capacity[0]), fits=self._lists_fit, built=lists.by_device,
        )  # fmt: skip

    @staticmethod
    def possible(batch: Batch) -> bool:
        """Return whether the device can rebuild the neighbour lists of this batch without the host.

        The batch must use kernels for GPUs and must contain exactly one scene, whose spheres do not grow. A GPU must
        also support conditional CUDA graphs.
        """
        able = not batch.device.is_cuda or wp.is_conditional_graph_supported()
        return batch.parallel and batch.count == 1 and batch.sphere_count > 0 and not batch.features.growth and able

    def room(self) -> int:
        """Return the number of neighbour list entries for which memory is allocated."""
        return int(self.lists.batch.capacity[0])

    def stages(self) -> list[Stage]:
        """Return the launches that decide whether a rebuild is needed and whether the new lists fit into the arrays."""
        return [self.needs_rebuild, self.fit]

    def record(self) -> None:
        """Record all launches of a rebuild without running them; recording loads the kernels."""
        self._rebuild.record()
        for stage in self.stages():
            stage.record()

    def __call__(self) -> None:
        self.needs_rebuild()
        capture_if(self._rebuild_requested, self._search)

    def _search(self) -> None:
        self._rebuild.launch_singly("bodies", "count")
        self.fit()
        capture_if(self._lists_fit, self._complete)

    def _complete(self) -> None:
        self._rebuild.launch_singly("starts", "near")
