"""Rebuilds of lists that a GPU decides on and does by itself, within a graph."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from ..kernels.dem.rebuilding import rebuilding_kernels

if TYPE_CHECKING:
    from .neighbors import NeighborLists


class DeviceRebuild:
    """One more thing to launch: it does nothing where all lists are fresh.

    Where bodies are to be sorted, or lists have no room for what was found, they stay stale, and the host builds them.
    """

    def __init__(self, lists: NeighborLists) -> None:
        b = lists.batch
        self.lists = lists
        self._stages = lists.device_stages()

        def numbers(count: int) -> wp.array:
            return wp.zeros(count, dtype=wp.int32, device=b.device)

        self._found, self._asked, self._lacking = numbers(2), numbers(1), numbers(1)
        lasted = wp.zeros(b.count, dtype=wp.float64, device=b.device)
        room, face_room = (wp.array(each.astype(np.int32), device=b.device) for each in (self.room(), b.face_capacity))
        kernels = rebuilding_kernels(b.scalar)
        self._look = b.stage(kernels.look, b.count, found=self._found)
        self._ask = b.stage(kernels.ask, b.count, found=self._found, lasted=lasted, asked=self._asked)
        self._fit = b.stage(
            kernels.fit, b.count, scanned=lists.scanned, room=room, face_scanned=lists.face_scanned,
            face_room=face_room, lacking=self._lacking,
        )  # fmt: skip
        self._note = b.stage(kernels.note, b.count, built=lists.by_device)

    @staticmethod
    def possible(batch: Any) -> bool:
        """Where cells keep their width."""
        able = not batch.device.is_cuda or wp.is_conditional_graph_supported()
        return batch.parallel and batch.sphere_count > 0 and not batch.features.growth and able

    def room(self) -> np.ndarray:
        """Entries that the lists of each scene have room for, shape (scenes,)."""
        return self.lists.batch.capacity

    def record(self) -> None:
        """Make ready, kernels loaded; nothing runs."""
        for stage in (*self._stages, self._look, self._ask, self._fit, self._note):
            stage.record()

    def __call__(self) -> None:
        self._found.zero_()
        self._look()
        self._ask()
        wp.capture_if(self._asked, self._search)

    def _search(self) -> None:
        self._lacking.zero_()
        self.lists.search_on_device()
        self._fit()
        wp.capture_if(self._lacking, on_false=self._complete)

    def _complete(self) -> None:
        self._note()
        self.lists.complete_on_device()
