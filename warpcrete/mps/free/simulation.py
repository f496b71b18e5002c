"""Simulation of concrete with a free surface, from a scene to a finished run.

The module `core/run/run_loop.py` contains the loop common to all runs.
"""

import math

import numpy as np

from ...core.errors import InstabilityError
from ...core.records import Record
from ...core.run.method import results_of
from ...core.run.tables import Table
from ...core.units import quantity
from ...standards.standard_test import is_at_rest
from ..common.run import FlowRun
from ..grid.flow import GridFlow
from ..grid.state import GridState, check_memory
from .display import FreeDisplay
from .layout import free_cells, free_layout
from .probes import UNITS, bases, measured, reach, surface
from .quantities import RunData, quantities, whole_volume
from .scene import FreeScene

STARTS = 0.2
"""Time after the opening of the gate in which concrete never counts as at rest, however slow it is [s].

In this time the concrete may be slow because it has only begun to flow.
"""


class FreeSimulation(FlowRun):
    """Simulation of a free-surface flow; :class:`warpcrete.Simulation` explains its parameters and errors."""

    scene_type = FreeScene
    scene: FreeScene
    columns = UNITS
    drawn_by = FreeDisplay
    goal = "at_rest"

    def unit(self, column: str) -> str:
        return self.columns.get(column) or self.scene.test.columns[column]  # type: ignore[union-attr]

    def place_flow(self) -> GridFlow:
        """Return the flow at its start, with its particles and its grid."""
        check_memory(free_cells(self.scene), self.device, self.precision)
        layout = free_layout(self.scene)
        self.volume = float(np.sum(layout.mass)) * layout.volume
        """Initial volume of the concrete [m3]; in plane flow per metre of depth, in axisymmetric flow per radian."""
        return GridFlow(GridState(self.scene, layout, self.device, self.precision), threads=self.threads)

    def measured(self) -> dict[str, float]:
        """Measure the flow and return the results as a row of the time series."""
        return measured(self.flow, self.volume)

    def watch_row(self, row: dict[str, float]) -> None:
        """Raise :class:`InstabilityError` if a number is not finite, or if concrete has reached the plate's edge."""
        super().watch_row(row)
        room = self.scene.width - 2 * self.flow.state.layout.spacing
        if self.scene.test and self.scene.test.on_plate and self.flow.steps and reach(self.flow) > room:
            raise InstabilityError(
                f"the concrete has reached the edge of the plate, {self.scene.width:g} m from its middle",
                time=row["time"],
                cure="a larger plate ('plate_radius')",
            )

    @property
    def lift_end(self) -> float:
        """Time at which the gate stops holding the concrete back [s]; 0 without a gate."""
        scene = self.scene
        return max(y for _, y in scene.gate) / scene.lift_speed if scene.gate else 0.0

    def ended_early(self) -> bool:
        """Return True if the concrete is at rest, or if a vessel that empties, such as a funnel, is empty."""
        if self.scene.test and self.scene.test.is_over(self._rows[-1]):
            return True
        self.steady = is_at_rest(self._rows, self.lift_end + STARTS, self.scene.rest_speed)
        return self.steady

    def why_ended(self) -> tuple[str, str]:
        time = self.flow.time
        if self.scene.test and self.scene.test.is_over(self._rows[-1]):
            return "empty", f"the concrete had flowed out at t = {time:.4g} s"
        if self.steady:
            return "rest", f"the concrete came to rest at t = {time:.4g} s"
        return super().why_ended()

    def sizes(self) -> Record:
        """Return sizes of the model, such as the number of cells, for the run's result."""
        scene, layout = self.scene, self.flow.state.layout
        volume = whole_volume(scene, self.volume)
        return {
            "cells": math.prod(layout.cells),
            "spacing": quantity(layout.spacing, "m"),
            "volume": quantity(volume, "m3" if scene.axial or scene.depth else "m2"),
        }

    def outcome(self, series: dict[str, np.ndarray]) -> tuple[Record, dict[str, Table]]:
        """Return entries for the run's result, computed from the time series and the surface; there are no tables."""
        result = results_of(quantities(), RunData(self.scene, series, self.volume))
        across, height = surface(self.flow)
        result["surface"] = {
            "place": {"value": across.tolist(), "unit": "m"},
            "base": {"value": bases(self.flow).tolist(), "unit": "m"},
            "height": {"value": height.tolist(), "unit": "m"},
        }
        return result, {}
