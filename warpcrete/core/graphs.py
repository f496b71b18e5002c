"""Launches recorded as a graph, which a device takes at one go."""

from __future__ import annotations

import gc
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import warp as wp

from .interrupts import put_off

_counting = threading.Lock()
_capturing, _collected = 0, False
"""Captures of this process that are under way, and whether Python collected cycles before the first."""


@contextmanager
def _uncollected() -> Iterator[None]:
    """Python collects no cycles: in a recorder's thread it might come upon arrays of a run that has ended, and free
    them while this thread captures. Warp puts off what it is to free then, but looks without a lock whether it must:
    of forty runs with recorders, one after the other, two were told of CUDA's error 906 (legacy stream, capturing).
    """
    global _capturing, _collected
    with _counting:
        if _capturing == 0:
            _collected = gc.isenabled()
            gc.disable()
        _capturing += 1
    try:
        yield
    finally:
        with _counting:
            _capturing -= 1
            if _capturing == 0 and _collected:
                gc.enable()


def captured(device: Any, launch: Callable[[], None]) -> Any:
    """The graph of what `launch` launches, which does not run. An interruption waits: captures within captures of
    Warp's would not end well."""
    with put_off(), _uncollected(), wp.ScopedCapture(device=device) as capture:
        launch()
    return capture.graph


class Zero:
    """Setting an array to zero, as a stage."""

    def __init__(self, array: wp.array) -> None:
        self.array = array

    def record(self) -> None:
        """There is nothing to make ready."""

    def __call__(self) -> None:
        self.array.zero_()


class AtOnce:
    """Stages, or what can be recorded and called like some, as one launch: on a GPU a graph, since launching a short
    kernel takes longer than the kernel."""

    def __init__(self, stages: Sequence[Any], device: Any) -> None:
        self.stages = tuple(stages)  # their arrays are the graph's, which does not hold them
        self._graph = None
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
