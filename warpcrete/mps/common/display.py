"""Base class of objects that tell recorders what to draw for a flow (displays)."""

from typing import Any

from ...core.drawing.display import Display
from .run import FlowRun


class FlowRunDisplay(Display):
    """Display that also reads the flow of a simulation, which does not exist before its particles have been placed."""

    def __init__(self, simulation: FlowRun, colouring: str | None = None) -> None:
        super().__init__(simulation, colouring)
        self._flow_run = simulation

    @property
    def flow(self) -> Any:
        """Flow that the simulation advances in time; its type depends on the simulation method."""
        return self._flow_run.flow
