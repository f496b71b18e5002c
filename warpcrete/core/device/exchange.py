"""Transfers of small arrays between host and GPU through page-locked memory.

Several arrays, such as flags and simulated times, are copied with one launch, which takes less time than a single
ordinary copy.
"""

from collections.abc import Callable, Sequence

import warp as wp

from .arrays import DeviceArray, HostArray, copy_array, empty
from .graphs import Call, GraphLaunch, Recordable, captured
from .interpreter_priority import run_is_waiting

MAXIMUM_BUFFERS = 2048
"""Maximum number of :class:`PinnedBuffers` that are kept, one for each set of arrays that are copied together. A batch
of 128 runs reads about 600 such sets."""


class PinnedBuffers:
    """Page-locked memory for a set of GPU arrays; one launch copies the whole set to the GPU or from it.

    The set is copied array by array the first time. Later copies replay a CUDA graph, whose launch takes the host less
    time than a single copy. The graph refers to the arrays by address and does not keep them alive.
    """

    def __init__(self, arrays: Sequence[DeviceArray], device: wp.Device) -> None:
        self._device = device
        self._memory = [empty(a.shape, dtype=a.dtype, device="cpu", pinned=True) for a in arrays]
        self.views = [memory.numpy() for memory in self._memory]
        """NumPy views of the page-locked memory: the data copied from the device, or the data to copy to the device."""
        self.last_write = 0
        """Serial number of the last write that used this page-locked memory; :class:`Exchange` counts the writes."""
        self._copied_once = False
        self._graph: wp.Graph | None = None

    def gather(self, arrays: Sequence[DeviceArray]) -> None:
        """Copy the arrays into this page-locked memory, in stream order.

        Pass the same arrays each time, because the copies are recorded once as a CUDA graph.
        """
        self._launch(lambda: self.copy(arrays))

    def copy(self, arrays: Sequence[DeviceArray]) -> None:
        """Copy the arrays into this page-locked memory one by one; a CUDA graph may record these copies."""
        for memory, array in zip(self._memory, arrays):
            copy_array(memory, array)

    def scatter(self, arrays: Sequence[DeviceArray]) -> None:
        """Copy this page-locked memory to the arrays, in stream order.

        Pass the same arrays each time, because the copies are recorded once as a CUDA graph.
        """

        def copy() -> None:
            for array, memory in zip(arrays, self._memory):
                copy_array(array, memory)

        self._launch(copy)

    def _launch(self, copy: Callable[[], None]) -> None:
        if not self._copied_once or not any(array.size for array in self._memory):
            copy()
            self._copied_once = True
            return
        if self._graph is None:
            self._graph = captured(self._device, copy)
        wp.capture_launch(self._graph)


class LaunchAndRead:
    """Callable that launches several stages (recorded kernel launches), then copies device arrays to the host."""

    def __init__(self, stages: Sequence[Recordable], arrays: Sequence[DeviceArray], device: wp.Device) -> None:
        self._device, self._arrays = device, tuple(arrays)
        self._buffers = PinnedBuffers(arrays, device) if device.is_cuda else None
        copies = [] if self._buffers is None else [Call(self._buffers.copy, self._arrays)]
        self._launch = GraphLaunch([*stages, *copies], device)

    def __call__(self) -> list[HostArray]:
        """Launch the stages, copy the arrays to the host, and return the copies."""
        self._launch()
        if self._buffers is None:
            return [array.numpy().copy() for array in self._arrays]
        with run_is_waiting():
            wp.synchronize_stream(self._device.stream)
        return [view.copy() for view in self._buffers.views]


class Exchange:
    """Reader and writer of arrays on one device: by asynchronous copies to and from a GPU, directly on a CPU."""

    def __init__(self, device: wp.Device) -> None:
        self.device = device
        self._buffers_by_use: dict[tuple[object, ...], PinnedBuffers] = {}
        self._pending_arrays: tuple[DeviceArray, ...] = ()
        self._pending_buffers: PinnedBuffers | None = None
        self._read_event: wp.Event | None = wp.Event(device) if device.is_cuda else None
        # Writes have serial numbers. `_last_write` is the number of the last write, `_last_write_before_read` is the
        # number of the last write before the pending read, and `_last_completed_write` is the number of the last write
        # that is known to be complete.
        self._last_write = self._last_write_before_read = self._last_completed_write = 0

    def read(self, *arrays: DeviceArray) -> list[HostArray]:
        """Wait until all work launched so far is complete, and return copies of device arrays in host memory."""
        if not self.device.is_cuda:
            return [array.numpy().copy() for array in arrays]
        buffers = self._buffers("read", arrays)
        buffers.gather(arrays)
        self._wait()
        return [view.copy() for view in buffers.views]

    def begin_read(self, *arrays: DeviceArray) -> None:
        """Start an asynchronous read, whose values :meth:`finish_read` returns; only one read may be in flight."""
        self._pending_arrays = arrays
        if self.device.is_cuda:
            before = self._last_write
            # Keep a reference to the page-locked memory of the pending read. The cache of page-locked memory may drop
            # its own reference when a set of other arrays is read or written.
            self._pending_buffers = self._buffers("asynchronous read", arrays)
            self._pending_buffers.gather(arrays)
            self._read_event = self.device.stream.record_event(self._read_event)
            self._last_write_before_read = before

    @property
    def read_is_done(self) -> bool:
        """True if the values of the asynchronous read have arrived."""
        return self._read_event is None or self._read_event.is_complete

    def finish_read(self) -> list[HostArray]:
        """Wait for the asynchronous read that :meth:`begin_read` started, and return copies of its arrays.

        On a GPU, the copies hold the values at the time of `begin_read`.
        """
        if not self.device.is_cuda:
            return [array.numpy().copy() for array in self._pending_arrays]
        assert self._pending_buffers is not None and self._read_event is not None
        with run_is_waiting():
            wp.synchronize_event(self._read_event)
        self._last_completed_write = max(self._last_completed_write, self._last_write_before_read)
        return [view.copy() for view in self._pending_buffers.views]

    def write(self, *pairs: tuple[DeviceArray, HostArray]) -> None:
        """Copy values from the host into device arrays, after all work that was launched so far."""
        if not self.device.is_cuda:
            for array, values in pairs:
                array.assign(values)
            return
        arrays = [array for array, _ in pairs]
        buffers = self._buffers("write", arrays)
        # Before the page-locked memory is reused, wait until its last copy to the device is complete.
        if buffers.last_write > self._last_completed_write:
            self._wait()
        for view, (_, values) in zip(buffers.views, pairs):
            view[...] = values
        # Increment the write's serial number before the copy is launched. If an exception interrupts the launch, the
        # copy may be in flight, and the next write must then wait for this number before it reuses the buffers.
        self._last_write += 1
        buffers.last_write = self._last_write
        buffers.scatter(arrays)

    def _wait(self) -> None:
        with run_is_waiting():
            wp.synchronize_stream(self.device.stream)
        self._last_completed_write = self._last_write

    def _buffers(self, use: str, arrays: Sequence[DeviceArray]) -> PinnedBuffers:
        key = use, *((array.ptr, array.shape, array.dtype) for array in arrays)
        if key not in self._buffers_by_use:
            if len(self._buffers_by_use) == MAXIMUM_BUFFERS:
                self._wait()
                self._buffers_by_use.clear()
            self._buffers_by_use[key] = PinnedBuffers(arrays, self.device)
        return self._buffers_by_use[key]
