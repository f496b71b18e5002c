"""Phases of a list rebuild: recorded launches in one fixed order, which the host and CUDA graphs share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import warp as wp

from ...core.device.graphs import Recordable, captured
from ...core.device.launching import Stage


@dataclass
class Phase:
    """Part of a rebuild that always runs as a whole."""

    name: str
    stages: Sequence[Recordable]
    """Launches in their order; empty if the scenes or the device do not need this phase."""


class Chunks:
    """Stages that do the same work on the chunks of several CPU threads, each on its own thread."""

    def __init__(self, stages: list[Stage], launch_chunks: Callable[[list[Stage]], None]) -> None:
        """Group one stage for each chunk; `launch_chunks` launches all of them, as `Batch.launch_chunks` does."""
        self.stages, self._in_parts = stages, launch_chunks

    def record(self) -> None:
        """Record the launches of all chunks, without running them."""
        for stage in self.stages:
            stage.record()

    def __call__(self) -> None:
        self._in_parts(self.stages)


class Rebuild:
    """All phases of a rebuild, recorded on the arrays that exist now.

    Every rebuild launches sections of this one list: the host, a CUDA graph that decides by itself when to rebuild,
    and a restart from a checkpoint. Between two sections, the host or the graph checks whether the new lists fit.
    """

    def __init__(self, phases: Sequence[Phase], device: wp.Device) -> None:
        self.phases, self._device = list(phases), device
        self._places = {phase.name: place for place, phase in enumerate(self.phases)}
        self.graphs: dict[tuple[str, str], wp.Graph] = {}
        """CUDA graphs of sections, by the names of their first and last phase."""
        self._launched: set[tuple[str, str]] = set()

    def section(self, first: str, last: str) -> list[Recordable]:
        """Return the launches of the phases from `first` to `last`, both included."""
        phases = self.phases[self._places[first] : self._places[last] + 1]
        return [stage for phase in phases for stage in phase.stages]

    def launch(self, first: str, last: str) -> None:
        """Launch the phases from `first` to `last`; on a GPU as a graph from the second time on.

        Most of the time of a rebuild on a GPU is spent waiting for launches, which a graph avoids. The first time is an
        ordinary launch, which loads the kernels.
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
        """Record all launches, which loads their kernels; nothing runs yet."""
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
