"""Simulation of a mortar with aggregates in a vessel, from a scene to a finished run."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..core.errors import InstabilityError
from ..core.run.method import results_of
from ..core.run.tables import Table
from ..mps.free.layout import free_cells, free_layout
from ..mps.free.probes import beyond
from ..mps.free.quantities import RunData
from ..mps.free.simulation import FreeSimulation
from ..mps.grid.state import GridState, check_memory
from .display import SuspensionDisplay
from .flow import SuspensionFlow
from .placing import placed_aggregates
from .quantities import QUANTITIES, mortar_part
from .scene import SuspensionScene

UNITS = {
    "smallest_gap": "1",
    "aggregate_height": "m",
    "coupled_error": "1",
    "aggregates_inside": "1",
    "aggregates_passed": "1",
    "mortar_passed": "1",
}
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
        test = self.scene.test
        if test and test.ring:
            row |= self._passed(test.ring(self.scene.dimensions))
        return super().measured() | row

    def _passed(self, ring: float) -> dict[str, float]:
        """Return the fractions of the volumes of aggregates and mortar outside a ring of bars with a radius [m].

        An aggregate counts as outside if its centre is.
        """
        bodies = self.flow.aggregates
        centre, volume = bodies.bodies.centre.numpy(), bodies.radius**3
        passed = float(volume[np.hypot(centre[:, 0], centre[:, 1]) > ring].sum() / volume.sum())
        mortar = mortar_part(beyond(self.flow, ring), passed, self.fraction)
        return {"aggregates_passed": passed, "mortar_passed": mortar}

    @property
    def fraction(self) -> float:
        """Volume of the placed aggregates divided by the volume of the concrete."""
        return 4 / 3 * np.pi * float(np.sum(self.flow.aggregates.radius**3)) / self.volume

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
        found = {"count": self.flow.aggregates.count, "fraction": self.fraction}
        return super().sizes() | {"aggregates": found}

    def outcome(self, series: dict[str, np.ndarray]) -> tuple[dict[str, Any], dict[str, Table]]:
        """Return the entries of the result that follow from the time series and the surface; there are no tables."""
        result, tables = super().outcome(series)
        return result | results_of(QUANTITIES, RunData(self.scene, series, self.volume)), tables
