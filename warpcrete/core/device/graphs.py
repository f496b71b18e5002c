"""Graphs of kernel launches: recorded sequences, which the host starts with a single launch."""

import gc
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Protocol

import warp as wp

from .interrupts import defer_interrupts

_collecting_or_capturing = threading.RLock()
"""Lock that one thread holds during a garbage collection or during the capture of a graph.

The garbage collector frees the arrays of a run that has ended, in whichever thread it happens to run. CUDA refuses to
capture a graph while another thread frees memory (error 906, a legacy stream operation during a capture). It would not
suffice to disable the collector during a capture: another thread may be in the middle of a collection when the capture
begins, because Warp releases Python's interpreter lock while it frees memory.
"""


_collections: list[int] = []
"""Generation of the latest garbage collection since the callback below was registered; empty before the first
collection."""


def _hold_lock_during_collection(phase: str, info: dict[str, int]) -> None:
    """Acquire the lock `_collecting_or_capturing` when a garbage collection starts, and release it when it stops.

    With this lock, no garbage collection frees an array while another thread captures a graph.
    """
    if phase == "start":
        _collecting_or_capturing.acquire()
        _collections[:] = [info["generation"]]
    else:
        # The release fails if this collection was running when the callback was registered, because the collection then
        # never acquired the lock.
        with suppress(RuntimeError):
            _collecting_or_capturing.release()


def _lock_collections() -> None:
    """Make garbage collections hold the lock `_collecting_or_capturing` from now on.

    A collection that is running already does not hold the lock, so wait until it has ended.

    The lock is set up only when the first graph is captured, because it has a disadvantage: Python drops exceptions
    inside the collector's callback, so a Ctrl-C that arrives during the callback is lost.
    """
    if _hold_lock_during_collection in gc.callbacks:
        return
    gc.callbacks.append(_hold_lock_during_collection)
    while not _collections:
        gc.collect(0)  # This call returns at once if another thread is collecting.


def captured(device: wp.Device, launch: Callable[[], None]) -> wp.Graph:
    """Return a launch graph of all work that the function `launch` launches, without running the work.

    Ctrl-C is deferred until the capture has ended, because an exception inside nested captures would leave Warp in an
    inconsistent state.
    """
    with defer_interrupts():
        _lock_collections()
        with _collecting_or_capturing, wp.ScopedCapture(device=device) as capture:
            launch()
    assert capture.graph is not None
    return capture.graph


class Recordable(Protocol):
    """Work on a device that is prepared once and launched many times, such as a recorded kernel launch."""

    def record(self) -> None:
        """Prepare the work for launches, for example load its kernel, without launching the work."""

    def __call__(self) -> None:
        """Launch the prepared work on the device."""


class Call:
    """Stage of a launch graph that calls a function of Warp with some arguments, for example to copy an array."""

    def __init__(self, function: Callable[..., object], *arguments: object) -> None:
        self._function, self._arguments = function, arguments

    def record(self) -> None:
        """Do nothing, because the function needs no preparation."""

    def __call__(self) -> None:
        self._function(*self._arguments)


class GraphLaunch:
    """Sequence of stages (recorded kernel launches) that runs with a single launch.

    On a GPU, the stages are captured as a graph, because the launch of a short kernel takes longer than the kernel
    itself. `stages` may contain any object that can be recorded and called like a :class:`.Stage`.
    """

    def __init__(self, stages: Sequence[Recordable], device: wp.Device) -> None:
        self.stages = tuple(stages)  # Keep the stages, because they hold references to the arrays of the graph.
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
