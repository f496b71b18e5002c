"""Simulation of concrete that flows through a part of a pump line, from a scene to a finished run.

The module `core/run/run_loop.py` contains the loop common to all runs.
"""

import math

import numpy as np

from ...core.records import Record
from ...core.run.method import results_of
from ...core.run.tables import Table
from ...core.units import quantity
from ..common.run import FlowRun
from ..grid.flow import GridFlow
from ..grid.state import GridState, check_memory
from .display import PartDisplay
from .layout import part_layout, part_room
from .probes import UNITS, friction_ahead, losses, measured, stations_of
from .quantities import QUANTITIES, RunData
from .scene import PartScene

SAMPLES = 10
"""Length of a period, divided by the longest allowed time step. A flow counts as steady if its pressure hardly changes
in each of two successive periods."""


class PartSimulation(FlowRun):
    """Simulation of a flow through a part of a pump line.

    :class:`warpcrete.Simulation` explains its parameters and errors.
    """

    scene_type = PartScene
    scene: PartScene
    columns = UNITS
    drawn_by = PartDisplay
    cure = "a smaller time step, or longer straight pipes at the two ends ('straight')"

    def place_flow(self) -> GridFlow:
        """Return the flow at its start, with its particles and its grid."""
        check_memory(part_room(self.scene).cells, self.device, self.precision)
        return GridFlow(
            GridState(self.scene, part_layout(self.scene), self.device, self.precision), threads=self.threads
        )

    def measured(self) -> dict[str, float]:
        return measured(self.flow)

    def ended_early(self) -> bool:
        """Return whether the frictional pressure changed by less than `steadiness` in each of two successive periods.

        The length of a period is `SAMPLES` times the longest allowed time step.
        """
        scene, rows = self.scene, [row for row in self._rows if row["time"] > 0]
        apart = max(1, math.ceil(SAMPLES * scene.time_step / scene.sample_interval - 1e-9))
        if len(rows) <= 2 * apart:
            return False
        # Subtract the hydrostatic pressure, which does not depend on the flow, so that only the relative
        # change of the frictional pressure is tested.
        weight = scene.density * scene.gravity * scene.rise
        now, before, long_before = (rows[-1 - n * apart]["pressure"] - weight for n in range(3))
        least = scene.steadiness * abs(now)
        self.steady = abs(now - before) < least and abs(before - long_before) < least
        return self.steady

    def sizes(self) -> Record:
        """Return the number of cells and other sizes of this run, for its results."""
        scene, layout = self.scene, self.flow.state.layout
        return {
            "cells": math.prod(layout.cells),
            "spacing": quantity(layout.spacing, "m"),
            "length": quantity(scene.axis.length, "m"),
            "rise": quantity(scene.rise, "m"),
            "flow": quantity(scene.flow, "m3/s"),
        }

    def friction_profile(self) -> tuple[np.ndarray, np.ndarray]:
        """Return arc lengths [m] and the frictional loss from each arc length to the end [Pa], for the run's result."""
        return friction_ahead(self.flow)

    def outcome(self, series: dict[str, np.ndarray]) -> tuple[Record, dict[str, Table]]:
        """Return the entries of the result, and a table of the pressure along the part of the pump line.

        The entries follow from the time series and from the current pressure along the part.
        """
        scene = self.scene
        result = results_of(QUANTITIES, RunData(scene, series))
        s, pressure = self.friction_profile()
        result["profile"] = {
            "place": {"value": s.tolist(), "unit": "m"},
            "friction_ahead": {"value": pressure.tolist(), "unit": "Pa"},
        }
        result["parts"] = [
            {
                "what": section.label,
                "begin": quantity(section.begin, "m"),
                "end": quantity(section.end, "m"),
                "loss": quantity(loss, "Pa"),
                "loss_theory": quantity(scene.friction_loss(section.begin, section.end), "Pa"),
            }
            for section, loss in zip(scene.sections, losses(scene, s, pressure), strict=True)
        ]
        return result, {"stations": stations_of(scene, s, pressure)}
