"""Phases of a list rebuild: recorded launches in one fixed order, which the host and CUDA graphs share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import warp as wp

from ...core.device.graphs import Recordable, captured
from ...core.device.launching import Stage


@dataclass
class Phase:
    """Named part of a rebuild of the neighbour lists, which always runs as a whole."""

    name: str
    stages: Sequence[Recordable]
    """Launches in their order; empty if the scenes or the device do not need this phase."""


class Chunks:
    """Launches of one kernel on the chunks of several CPU threads, each on its own thread."""

    def __init__(self, stages: list[Stage], launch_chunks: Callable[[list[Stage]], None]) -> None:
        """Group launches, one for each chunk; the function `launch_chunks` launches all of them on their threads."""
        self.stages, self._in_parts = stages, launch_chunks

    def record(self) -> None:
        """Record the launches of all chunks, without running them."""
        for stage in self.stages:
            stage.record()

    def __call__(self) -> None:
        self._in_parts(self.stages)


class Rebuild:
    """All phases of a rebuild of the neighbour lists, as launches recorded on the batch's present arrays.

    Every rebuild launches consecutive phases (sections) of this one list. It is used by the host, by a CUDA graph that
    decides by itself when to rebuild, and at a restart from a checkpoint. Between two sections, the host or the graph
    checks whether the new lists fit the arrays.
    """

    def __init__(self, phases: Sequence[Phase], device: wp.Device) -> None:
        self.phases, self._device = list(phases), device
        self._places = {phase.name: place for place, phase in enumerate(self.phases)}
        self.graphs: dict[tuple[str, str], wp.Graph] = {}
        """CUDA graphs of sections, by the names of their first and last phase."""
        self._launched: set[tuple[str, str]] = set()

    def section(self, first: str, last: str) -> list[Recordable]:
        """Return the launches of all phases from the one named `first` to the one named `last`, both included."""
        phases = self.phases[self._places[first] : self._places[last] + 1]
        return [stage for phase in phases for stage in phase.stages]

    def launch(self, first: str, last: str) -> None:
        """Launch the phases from `first` to `last`; on a GPU, the second and later calls launch them as a CUDA graph.

        On a GPU most of the time of a rebuild is launch overhead, which a graph avoids. The first call launches the
        kernels one by one, because kernels must be loaded before a graph is captured.
        """
        key = first, last
        if key in self._launched and self._device.is_cuda:
            if key not in self.graphs:
                self.graphs[key] = captured(self._device, lambda: self.launch_singly(first, last))
            wp.capture_launch(self.graphs[key])
        else:
            self.launch_singly(first, last)
            self._launched.add(key)

    def launch_singly(self, first: str, last: str) -> None:
        """Launch the phases from `first` to `last` one by one, for example while a graph is captured."""
        for stage in self.section(first, last):
            stage()

    def record(self) -> None:
        """Record the launches of all phases without running them; recording loads their kernels."""
        for phase in self.phases:
            for stage in phase.stages:
                stage.record()

    def kernel_stages(self, *names: str) -> list[Stage]:
        """Return the kernel launches of the named phases, or of all phases, so that their kernels can be compiled."""
        stages: list[Stage] = []
        for phase in self.phases:
            for stage in phase.stages if not names or phase.name in names else ():
                stages += stage.stages if isinstance(stage, Chunks) else [stage] if isinstance(stage, Stage) else []
        return stages
