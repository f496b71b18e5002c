"""Launches recorded as a graph, which a device takes at one go."""

from __future__ import annotations

import gc
from collections.abc import Callable, Sequence
from typing import Any

import warp as wp


def captured(device: Any, launch: Callable[[], None]) -> Any:
    """The graph of what `launch` launches, which does not run.

    Python collects no cycles meanwhile: a recorder's thread might come upon arrays of a run that has ended, and a GPU
    refuses to free any while launches are captured.
    """
    collecting = gc.isenabled()
    gc.disable()
    try:
        with wp.ScopedCapture(device=device) as capture:
            launch()
    finally:
        if collecting:
            gc.enable()
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
