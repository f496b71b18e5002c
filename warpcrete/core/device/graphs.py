"""Sequences of kernel launches recorded as graphs, each of which the host starts with a single launch."""

from __future__ import annotations

import gc
import threading
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from typing import Protocol

import warp as wp

from .arrays import DeviceArray, copy_array
from .interrupts import defer_interrupts

_capture_lock = threading.Lock()
_capturing, _collector_was_on = 0, False
"""Number of graph captures in progress, and whether Python's garbage collector was enabled before the first one."""


@contextmanager
def _garbage_collection_off() -> Generator[None]:
    """Disable Python's cyclic garbage collector while a graph is captured.

    In a recorder thread, the collector might free arrays of a run that has ended while another thread captures a graph.
    Warp defers such frees during a capture, but Warp takes no lock when it checks whether a capture is in progress.
    With the collector enabled, two of forty successive runs with recorders failed with CUDA error 906 (legacy stream
    operation during a capture).
    """
    global _capturing, _collector_was_on
    with _capture_lock:
        if _capturing == 0:
            _collector_was_on = gc.isenabled()
            gc.disable()
        _capturing += 1
    try:
        yield
    finally:
        with _capture_lock:
            _capturing -= 1
            if _capturing == 0 and _collector_was_on:
                gc.enable()


def captured(device: wp.Device, launch: Callable[[], None]) -> wp.Graph:
    """Return the graph of everything that `launch` launches, without running it.

    Ctrl-C is deferred until the capture has ended, because an exception inside nested captures would leave Warp in an
    inconsistent state.
    """
    with defer_interrupts(), _garbage_collection_off(), wp.ScopedCapture(device=device) as capture:
        launch()
    assert capture.graph is not None
    return capture.graph


class Recordable(Protocol):
    """Work on a device that is prepared once and launched many times, such as a recorded kernel launch."""

    def record(self) -> None:
        """Prepare the work for launches, for example load its kernel, without launching the work."""

    def __call__(self) -> None:
        """Launch the prepared work on the device."""


class Copy:
    """Stage that copies one array to another array of the same length."""

    def __init__(self, target: DeviceArray, source: DeviceArray) -> None:
        self.target, self.source = target, source

    def record(self) -> None:
        """Do nothing, because this stage needs no preparation."""

    def __call__(self) -> None:
        copy_array(self.target, self.source)


class Zero:
    """Stage that sets an array to zero."""

    def __init__(self, array: DeviceArray) -> None:
        self.array = array

    def record(self) -> None:
        """Do nothing, because this stage needs no preparation."""

    def __call__(self) -> None:
        self.array.zero_()


class GraphLaunch:
    """Several stages (recorded kernel launches) that run with a single launch.

    On a GPU they are captured as a graph, because the launch of a short kernel takes longer than the kernel itself.
    `stages` may contain any object that can be recorded and called like a :class:`.Stage`.
    """

    def __init__(self, stages: Sequence[Recordable], device: wp.Device) -> None:
        self.stages = tuple(stages)  # Keep the stages, because they hold references to the arrays that the graph uses.
        self._graph: wp.Graph | None = None
        if device.is_cuda:
            for stage in self.stages:
                stage.record()
            self._graph = captured(device, self._one_by_one)

    def _one_by_one(self) -> None:
        for stage in self.stages:
            stage()

    def __call__(self) -> None:
        if self._graph is None:
            self._one_by_one()
        else:
            wp.capture_launch(self._graph)
