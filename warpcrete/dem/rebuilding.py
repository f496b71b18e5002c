"""Rebuilds of the lists of a scene alone that a GPU decides on and does by itself, within a graph."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import warp as wp

from ..core.launching import Stage
from ..kernels.dem.rebuilding import rebuilding_kernels

if TYPE_CHECKING:
    from .neighbors import NeighborLists


class DeviceRebuild:
    """One more thing to launch: it does nothing where lists are fresh.

    Where bodies are to be sorted, or lists have no room for what was found, they stay stale, and the host builds them.
    """

    def __init__(self, lists: NeighborLists) -> None:
        b = lists.batch
        self.lists = lists
        self._stages = lists.device_stages()
        self._asked, self._fits = (wp.zeros(1, dtype=wp.int32, device=b.device) for _ in range(2))
        kernels = rebuilding_kernels(b.scalar)
        self.ask = b.stage(kernels.ask, 1, asked=self._asked)
        self.fit = b.stage(
            kernels.fit, 1, scanned=lists.scanned, room=self.room(), face_scanned=lists.face_scanned,
            face_room=int(b.face_capacity[0]), fits=self._fits, built=lists.by_device,
        )  # fmt: skip

    @staticmethod
    def possible(batch: Any) -> bool:
        """Of a scene alone, whose cells keep their width."""
        able = not batch.device.is_cuda or wp.is_conditional_graph_supported()
        return batch.parallel and batch.count == 1 and batch.sphere_count > 0 and not batch.features.growth and able

    def room(self) -> int:
        """Entries that lists have room for."""
        return int(self.lists.batch.capacity[0])

    def stages(self) -> list[Stage]:
        """Stages of its own."""
        return [self.ask, self.fit]

    def record(self) -> None:
        """Make ready, kernels loaded; nothing runs."""
        for stage in (*self._stages, *self.stages()):
            stage.record()

    def __call__(self) -> None:
        self.ask()
        wp.capture_if(self._asked, self._search)

    def _search(self) -> None:
        self.lists.search_on_device()
        self.fit()
        wp.capture_if(self._fits, self.lists.complete_on_device)
