"""Simulation of a mortar with aggregates in a vessel, from a scene to a finished run."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..core.errors import InstabilityError
from ..mps.free.layout import free_cells, free_layout
from ..mps.free.simulation import FreeSimulation
from ..mps.grid.state import GridState, check_memory
from .display import SuspensionDisplay
from .flow import SuspensionFlow
from .placing import placed_aggregates
from .scene import SuspensionScene

UNITS = {"smallest_gap": "1", "aggregate_height": "m", "coupled_error": "1", "aggregates_inside": "1"}
"""Units of the columns of the time series that describe the aggregates."""
SOLVE_BYTES = 4 * 8 * 64
"""Memory per cell that the coupled solve of mortar and aggregates needs for its search directions [bytes], in single
precision.

With each direction, the solve stores the direction's product with the matrix. A direction and its product have eight
numbers for each cell. A solve of at most 60 iterations stores up to 64 directions.
"""
DEEPEST = 0.3
"""Overlap of two aggregates, or of an aggregate and a wall, above which the run stops with an error. The overlap is
divided by the radius of the aggregate."""


class SuspensionSimulation(FreeSimulation):
    """Simulation of a mortar with aggregates; parameters and errors are those of :class:`warpcrete.Simulation`."""

    scene_type = SuspensionScene
    scene: SuspensionScene  # pyright: ignore[reportIncompatibleVariableOverride]
    method = "suspension"

    def unit(self, column: str) -> str:
        """Return the unit of a column of the time series."""
        return UNITS.get(column) or super().unit(column)

    def display(self, colouring: str | None = None) -> SuspensionDisplay:
        """Return the display, which tells recorders what to draw: concrete, aggregates, walls and curves."""
        return SuspensionDisplay(self, colouring)

    def place_flow(self) -> SuspensionFlow:
        """Return the flow in its initial state, with particles, aggregates and grid."""
        scene = self.scene
        check_memory(free_cells(scene), self.device, self.precision, more=SOLVE_BYTES)
        layout = free_layout(scene)
        self.volume = float(np.sum(layout.mass)) * layout.volume
        return SuspensionFlow(
            GridState(scene, layout, self.device, self.precision), placed_aggregates(scene, layout),
            roughness=scene.roughness,
        )  # fmt: skip

    def measured(self) -> dict[str, float]:
        """Measure the flow and return the results as a row of the time series."""
        flow = self.flow
        gap = flow.aggregates.smallest_gap() if flow.steps else 0.0
        inside = flow.aggregates.inside
        heights = flow.aggregates.bodies.centre.numpy()[inside, 2]
        row = {
            "smallest_gap": min(gap, 1.0),
            "aggregate_height": float(heights.mean()) if len(heights) else 0.0,
            "coupled_error": flow.coupled.error,
        }
        if flow.opens:
            row["aggregates_inside"] = flow.aggregates.volume_inside(flow.opens)
        return super().measured() | row

    def watch_row(self, row: dict[str, float]) -> None:
        """Raise :class:`InstabilityError` if a value is not finite, or if aggregates overlap too far.

        The limit of an overlap with a neighbour or wall is DEEPEST times the radius of the aggregate.
        """
        super().watch_row(row)
        if row["smallest_gap"] < -DEEPEST:
            raise InstabilityError(
                f"t = {row['time']:.6g} s: two aggregates, or an aggregate and a wall, overlap by "
                f"{-row['smallest_gap']:.2g} of a radius; use a smaller 'time_step'"
            )

    def sizes(self) -> dict[str, Any]:
        """Return sizes of the model, such as the number of aggregates, for the run's result."""
        bodies = self.flow.aggregates
        volume = 4 / 3 * np.pi * float(np.sum(bodies.radius**3))
        return super().sizes() | {"aggregates": {"count": bodies.count, "fraction": volume / self.volume}}
