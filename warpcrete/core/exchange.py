"""Small arrays to and from a GPU, by page-locked memory: flags and clocks together take less than one of them did."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import warp as wp

from .graphs import AtOnce, captured
from .turns import waiting

KEPT = 2048
"""Sets of arrays for which there is memory, at most: a batch of 128 runs reads some 600."""


class Beside:
    """Page-locked memory for arrays of a GPU, and the copies of all of them there or back as one launch.

    From the second time on they are a graph, which the host launches in less time than a single copy. It is of arrays
    by where they are, and keeps none of them.
    """

    def __init__(self, arrays: Sequence[wp.array], device: Any) -> None:
        self._device = device
        self._memory = [wp.empty(a.shape, dtype=a.dtype, device="cpu", pinned=True) for a in arrays]
        self.views = [memory.numpy() for memory in self._memory]
        """Of what was copied here, or is to be copied from here, as NumPy arrays."""
        self.written = 0
        """Number of the last write from here, of an :class:`Exchange`."""
        self._copied, self._graph = False, None

    def take(self, arrays: Sequence[wp.array]) -> None:
        """Copy what the arrays hold, in the order of the device's work; always the same arrays."""
        self._launch(lambda: self.copy(arrays))

    def copy(self, arrays: Sequence[wp.array]) -> None:
        """The same one by one, which may be captured."""
        for memory, array in zip(self._memory, arrays):
            wp.copy(memory, array)

    def give(self, arrays: Sequence[wp.array]) -> None:
        """Copy to the arrays, likewise."""

        def copy() -> None:
            for array, memory in zip(arrays, self._memory):
                wp.copy(array, memory)

        self._launch(copy)

    def _launch(self, copy: Callable[[], None]) -> None:
        if not self._copied or not any(array.size for array in self._memory):
            copy()
            self._copied = True
            return
        if self._graph is None:
            self._graph = captured(self._device, copy)
        wp.capture_launch(self._graph)


class _Copying:
    """Copies as a stage."""

    def __init__(self, beside: Beside, arrays: Sequence[wp.array]) -> None:
        self._beside, self._arrays = beside, arrays

    def record(self) -> None:
        """There is nothing to make ready."""

    def __call__(self) -> None:
        self._beside.copy(self._arrays)


class Reading:
    """Stages, and copies of what they leave, as one launch."""

    def __init__(self, stages: Sequence[Any], arrays: Sequence[wp.array], device: Any) -> None:
        self._device, self._arrays = device, tuple(arrays)
        self._beside = Beside(arrays, device) if device.is_cuda else None
        self._done = wp.Event(device) if device.is_cuda else None
        copies = [] if self._beside is None else [_Copying(self._beside, self._arrays)]
        self._launch = AtOnce([*stages, *copies], device)

    def begin(self) -> Callable[[], list[np.ndarray]]:
        """Launch; what is returned waits for the copies. Before the next time it must have been called."""
        self._launch()
        if self._beside is None:
            copies = [array.numpy().copy() for array in self._arrays]
            return lambda: copies
        self._device.stream.record_event(self._done)
        return self._wait

    def _wait(self) -> list[np.ndarray]:
        assert self._beside is not None
        with waiting():
            wp.synchronize_event(self._done)
        return [view.copy() for view in self._beside.views]


class Exchange:
    """Reads and writes arrays of one device from the host; of a CPU itself."""

    def __init__(self, device: Any) -> None:
        self.device = device
        self._kept: dict[Any, Beside] = {}
        self._asked: tuple[wp.array, ...] = ()
        self._beside_asked: Beside | None = None
        self._answered: Any = wp.Event(device) if device.is_cuda else None
        # Writes are numbered: the last of all, that before the last question, and that which is known to be done.
        self._written = self._before_asked = self._arrived = 0

    def read(self, *arrays: wp.array) -> list[np.ndarray]:
        """Copies of arrays as they are after all that was launched so far; the host waits once for all of them."""
        if not self.device.is_cuda:
            return [array.numpy().copy() for array in arrays]
        beside = self._beside("read", arrays)
        beside.take(arrays)
        self._wait()
        return [view.copy() for view in beside.views]

    def begin(self, *arrays: wp.array) -> Callable[[], list[np.ndarray]]:
        """Begin a read beside all others; what is returned waits for the copies, as the arrays are now. Before values
        change, and are read again, it must have been called."""
        if not self.device.is_cuda:
            copies = [array.numpy().copy() for array in arrays]
            return lambda: copies
        beside = self._beside("begun", arrays)
        beside.take(arrays)
        done = self.device.stream.record_event()

        def wait() -> list[np.ndarray]:
            with waiting():
                wp.synchronize_event(done)
            return [view.copy() for view in beside.views]

        return wait

    def ask(self, *arrays: wp.array) -> None:
        """Begin a read, with no other on the way: the host goes on until it wants the :meth:`answer`."""
        self._asked = arrays
        if self.device.is_cuda:
            before = self._written
            # Held here: where there are many arrays, memory for some may be given up for that of the next.
            self._beside_asked = self._beside("asked", arrays)
            self._beside_asked.take(arrays)
            self._answered = self.device.stream.record_event(self._answered)
            self._before_asked = before

    @property
    def answered(self) -> bool:
        """Whether what was asked for is there."""
        return not self.device.is_cuda or self._answered.is_complete

    def answer(self) -> list[np.ndarray]:
        """Copies of the arrays that were asked for, as they were then."""
        if not self.device.is_cuda:
            return [array.numpy().copy() for array in self._asked]
        assert self._beside_asked is not None
        with waiting():
            wp.synchronize_event(self._answered)
        self._arrived = max(self._arrived, self._before_asked)
        return [view.copy() for view in self._beside_asked.views]

    def write(self, *pairs: tuple[wp.array, np.ndarray]) -> None:
        """Set arrays to values after all that was launched so far."""
        if not self.device.is_cuda:
            for array, values in pairs:
                array.assign(values)
            return
        arrays = [array for array, _ in pairs]
        beside = self._beside("written", arrays)
        if beside.written > self._arrived:  # what was written may not have left its memory yet
            self._wait()
        for view, (_, values) in zip(beside.views, pairs):
            view[...] = values
        # First: a copy that is on its way when it is interrupted must have its number.
        self._written += 1
        beside.written = self._written
        beside.give(arrays)

    def _wait(self) -> None:
        with waiting():
            wp.synchronize_stream(self.device.stream)
        self._arrived = self._written

    def _beside(self, use: str, arrays: Sequence[wp.array]) -> Beside:
        key = use, *((array.ptr, array.shape, array.dtype) for array in arrays)
        if key not in self._kept:
            if len(self._kept) == KEPT:
                self._wait()
                self._kept.clear()
            self._kept[key] = Beside(arrays, self.device)
        return self._kept[key]
