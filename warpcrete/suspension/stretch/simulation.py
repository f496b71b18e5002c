"""Simulation of mortar with aggregates in a stretch of pipe, from a scene to a finished run."""

import math

import numpy as np

from ...core.records import Record
from ...core.run.method import results_of
from ...core.run.tables import Table
from ...core.units import quantity
from ...mps.grid.state import GridState, check_memory
from ..flow import SuspensionFlow
from ..runs import SOLVE_BYTES, AggregateRun
from ..runs import UNITS as SHARED_UNITS
from .display import StretchDisplay
from .layout import stretch_layout, stretch_room
from .probes import UNITS, fraction_profile, measured, velocity_profile
from .quantities import QUANTITIES, RunData
from .scene import STEADY, StretchScene


class StretchSimulation(AggregateRun):
    """Simulation of a stretch of pipe; :class:`warpcrete.Simulation` explains its parameters and errors."""

    scene_type = StretchScene
    scene: StretchScene
    columns = UNITS | SHARED_UNITS
    drawn_by = StretchDisplay
    cure = "a smaller 'courant'"

    @property
    def may_end_early(self) -> bool:
        """False, because a run always lasts as long as the scene states."""
        return False

    def place_flow(self) -> SuspensionFlow:
        """Return the flow in its initial state, with particles, aggregates and grid."""
        check_memory(stretch_room(self.scene).cells, self.device, self.precision, more=SOLVE_BYTES)
        layout, aggregates = stretch_layout(self.scene)
        return SuspensionFlow(
            GridState(self.scene, layout, self.device, self.precision),
            aggregates,
            roughness=self.scene.roughness,
            friction=self.scene.friction,
        )

    def measured(self) -> dict[str, float]:
        return measured(self.flow) | self.aggregate_columns()

    def ended_early(self) -> bool:
        """Update the attribute `steady`, and return False, because a run always lasts as long as the scene states."""
        name = "flow" if self.scene.mean_velocity is None else "gradient"
        time, flow = (np.array([row[column] for row in self._rows]) for column in ("time", name))
        late = flow[time >= 0.75 * time[-1]]
        self.steady = len(late) > 1 and float(np.ptp(late)) <= STEADY * abs(float(late[-1]))
        return False

    def sizes(self) -> Record:
        """Return sizes of the model, such as the numbers of cells and aggregates, for the run's result."""
        layout = self.flow.state.layout
        sizes = {"cells": math.prod(layout.cells), "spacing": quantity(layout.spacing, "m")}
        return sizes | self.aggregate_sizes()

    def outcome(self, series: dict[str, np.ndarray]) -> tuple[Record, dict[str, Table]]:
        """Return entries for the run's result, from the time series and the present state. A stretch has no tables."""
        result = results_of(QUANTITIES, RunData(self.scene, series, self.fraction))
        radius, velocity = velocity_profile(self.flow)
        result["profile"] = {
            "radius": {"value": radius.tolist(), "unit": "m"},
            "velocity": {"value": velocity.tolist(), "unit": "m/s"},
            "velocity_alone": {"value": self.scene.velocity_alone(radius).tolist(), "unit": "m/s"},
            "fraction": {"value": fraction_profile(self.flow).tolist(), "unit": "1"},
        }
        return result, {}
