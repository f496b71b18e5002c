"""Phases of a rebuild of the neighbour lists, in the one fixed order that the host and CUDA graphs use."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import warp as wp

from ...core.device.graphs import Recordable, captured
from ...core.device.launching import Stage


@dataclass
class Phase:
    """Named group of consecutive launches in a rebuild of the neighbour lists; a rebuild runs all of them or none."""

    name: str
    stages: Sequence[Recordable]
    """Kernel launches of this phase in the order in which they run; empty if the scenes or the device need none."""


class Chunks:
    """Group of launches of one kernel: one launch for each CPU thread, which processes its share of the bodies."""

    def __init__(self, stages: list[Stage], launch_chunks: Callable[[list[Stage]], None]) -> None:
        """Create a group of the launches `stages`, which `launch_chunks` will launch, each on its own CPU thread."""
        self.stages, self._in_parts = stages, launch_chunks

    def record(self) -> None:
        """Record the launches of this group for a later replay, without running them."""
        for stage in self.stages:
            stage.record()

    def __call__(self) -> None:
        self._in_parts(self.stages)


class Rebuild:
    """All phases of a rebuild of the neighbour lists, as recorded launches of kernels on the batch's current arrays.

    A section is a sequence of consecutive phases. A rebuild by the host, a rebuild that a CUDA graph starts by itself,
    and a restart from a checkpoint launch different sections. Between two sections, the host or the graph checks
    whether the new lists fit into the arrays.
    """

    def __init__(self, phases: Sequence[Phase], device: wp.Device) -> None:
        self.phases, self._device = list(phases), device
        self._places = {phase.name: place for place, phase in enumerate(self.phases)}
        self.graphs: dict[tuple[str, str], wp.Graph] = {}
        """CUDA graphs of sections, which are sequences of phases. The keys are the names of a section's first and last
        phase."""
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
        """Launch the kernels of the phases from `first` to `last` one by one, for example to capture a graph."""
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
