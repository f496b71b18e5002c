"""Small arrays to and from a GPU, by page-locked memory: flags and clocks together take less than one of them did."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp

from .turns import waiting

KEPT = 2048
"""Arrays for which there is memory, at most: a batch of 128 runs reads some 600."""


class Exchange:
    """Reads and writes arrays of one device from the host; of a CPU itself."""

    def __init__(self, device: Any) -> None:
        self.device = device
        self._kept: dict[Any, tuple[wp.array, np.ndarray]] = {}
        self._asked: tuple[wp.array, ...] = ()
        self._beside_asked: list[tuple[wp.array, np.ndarray]] = []
        self._answered: Any = wp.Event(device) if device.is_cuda else None
        self._under_way: set[Any] = set()  # what was written and may not have left its buffer yet

    def read(self, *arrays: wp.array) -> list[np.ndarray]:
        """Copies of arrays as they are after all that was launched so far; the host waits once for all of them."""
        if not self.device.is_cuda:
            return [array.numpy().copy() for array in arrays]
        beside = [self._beside("read", array) for array in arrays]
        for (buffer, _), array in zip(beside, arrays):
            wp.copy(buffer, array)
        self._wait()
        return [view.copy() for _, view in beside]

    def begin(self, *arrays: wp.array) -> Callable[[], list[np.ndarray]]:
        """Begin a read beside all others; what is returned waits for the copies, as the arrays are now. Before values
        change, and are read again, it must have been called."""
        if not self.device.is_cuda:
            copies = [array.numpy().copy() for array in arrays]
            return lambda: copies
        beside = [self._beside("begun", array) for array in arrays]
        for (buffer, _), array in zip(beside, arrays):
            wp.copy(buffer, array)
        done = self.device.stream.record_event()

        def wait() -> list[np.ndarray]:
            with waiting():
                wp.synchronize_event(done)
            return [view.copy() for _, view in beside]

        return wait

    def ask(self, *arrays: wp.array) -> None:
        """Begin a read, with no other on the way: the host goes on until it wants the :meth:`answer`."""
        self._asked = arrays
        if self.device.is_cuda:
            # Held here: where there are many arrays, memory for one may be given up for that of the next.
            self._beside_asked = [self._beside("asked", array) for array in arrays]
            for (buffer, _), array in zip(self._beside_asked, arrays):
                wp.copy(buffer, array)
            self._answered = self.device.stream.record_event(self._answered)

    @property
    def answered(self) -> bool:
        """Whether what was asked for is there."""
        return not self.device.is_cuda or self._answered.is_complete

    def answer(self) -> list[np.ndarray]:
        """Copies of the arrays that were asked for, as they were then."""
        if not self.device.is_cuda:
            return [array.numpy().copy() for array in self._asked]
        with waiting():
            wp.synchronize_event(self._answered)
        return [view.copy() for _, view in self._beside_asked]

    def write(self, array: wp.array, values: np.ndarray) -> None:
        """Set an array after all that was launched so far."""
        if not self.device.is_cuda:
            array.assign(values)
            return
        key = array.ptr, array.shape
        if key in self._under_way:
            self._wait()
        buffer, view = self._beside("written", array)
        view[...] = values
        wp.copy(array, buffer)
        self._under_way.add(key)

    def _wait(self) -> None:
        with waiting():
            wp.synchronize_stream(self.device.stream)
        self._under_way.clear()

    def _beside(self, use: str, array: wp.array) -> tuple[wp.array, np.ndarray]:
        key = use, array.ptr, array.shape, array.dtype
        if key not in self._kept:
            if len(self._kept) == KEPT:
                self._wait()
                self._kept.clear()
            buffer = wp.empty(array.shape, dtype=array.dtype, device="cpu", pinned=True)
            self._kept[key] = buffer, buffer.numpy()
        return self._kept[key]
