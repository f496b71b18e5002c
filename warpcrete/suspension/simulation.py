"""Simulation of a mortar with aggregates in a vessel, from a scene to a finished run."""

import numpy as np

from ..core.records import Record
from ..core.run.method import results_of
from ..core.run.tables import Table
from ..mps.free.layout import free_cells, free_layout
from ..mps.free.probes import UNITS as FREE_UNITS
from ..mps.free.probes import beyond
from ..mps.free.quantities import RunData
from ..mps.free.simulation import FreeSimulation
from ..mps.grid.state import GridState, check_memory
from .display import SuspensionDisplay
from .flow import SuspensionFlow
from .placing import placed_aggregates
from .quantities import QUANTITIES, mortar_part
from .runs import SOLVE_BYTES, AggregateRun
from .runs import UNITS as SHARED_UNITS
from .scene import SuspensionScene

UNITS = SHARED_UNITS | {
    "aggregate_height": "m",
    "aggregates_inside": "1",
    "aggregates_passed": "1",
    "mortar_passed": "1",
}
"""Units of the columns of the time series that describe the aggregates."""


class SuspensionSimulation(AggregateRun, FreeSimulation):  # pyright: ignore[reportIncompatibleVariableOverride]
    """Simulation of a mortar with aggregates; :class:`warpcrete.Simulation` explains its parameters and errors."""

    scene_type = SuspensionScene
    scene: SuspensionScene  # pyright: ignore[reportIncompatibleVariableOverride]
    columns = FREE_UNITS | UNITS
    drawn_by = SuspensionDisplay

    def place_flow(self) -> SuspensionFlow:
        """Return the flow in its initial state, with particles, aggregates and grid."""
        scene = self.scene
        check_memory(free_cells(scene), self.device, self.precision, more=SOLVE_BYTES)
        layout = free_layout(scene)
        self.volume = float(np.sum(layout.mass)) * layout.volume
        return SuspensionFlow(
            GridState(scene, layout, self.device, self.precision),
            placed_aggregates(scene, layout),
            roughness=scene.roughness,
            friction=scene.friction,
        )

    def measured(self) -> dict[str, float]:
        """Measure the flow and return the results as a row of the time series."""
        flow = self.flow
        inside = flow.aggregates.inside
        heights = flow.aggregates.bodies.centre.numpy()[inside, 2]
        row = self.aggregate_columns() | {"aggregate_height": float(heights.mean()) if len(heights) else 0.0}
        if flow.opens:
            row["aggregates_inside"] = flow.aggregates.volume_inside(flow.opens)
        test = self.scene.test
        if test and test.ring:
            row |= self._passed(test.ring(self.scene.dimensions))
        return super().measured() | row

    def _passed(self, ring: float) -> dict[str, float]:
        """Return the fractions of all aggregates and of all mortar outside a ring of bars with the radius `ring` [m].

        An aggregate counts as outside if its centre is outside.
        """
        bodies = self.flow.aggregates
        centre, volume = bodies.bodies.centre.numpy(), bodies.radius**3
        passed = float(volume[np.hypot(centre[:, 0], centre[:, 1]) > ring].sum() / volume.sum())
        mortar = mortar_part(beyond(self.flow, ring), passed, self.fraction)
        return {"aggregates_passed": passed, "mortar_passed": mortar}

    def sizes(self) -> Record:
        """Return sizes of the model, such as the number of aggregates, for the run's result."""
        return super().sizes() | self.aggregate_sizes()

    def outcome(self, series: dict[str, np.ndarray]) -> tuple[Record, dict[str, Table]]:
        """Return the entries of the result, which follow from the time series and the free surface, and the tables."""
        result, tables = super().outcome(series)
        return result | results_of(QUANTITIES, RunData(self.scene, series, self.volume)), tables
