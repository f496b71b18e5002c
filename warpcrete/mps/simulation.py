"""Simulation of a pipe flow, from a scene to a finished run.

The module `core/run/run_loop.py` contains the loop common to all runs.
"""

import numpy as np

from ..core.records import Record
from ..core.run.method import results_of
from ..core.run.tables import Table
from ..core.units import quantity
from ..theory.pipe import velocity
from . import grid_probes, probes
from .common.run import FlowRun
from .display import FlowDisplay
from .grid.flow import GridFlow
from .grid.state import GridState, check_memory
from .particles import MovingParticles
from .pipe_grid import pipe_cells, pipe_layout
from .probes import UNITS
from .quantities import QUANTITIES, RunData
from .scene import FluidScene
from .state import FluidState
from .watch import WatchedFlow

MAX_DURATION = 2.0  # Maximum simulated time of a flow that does not become steady [s].
TYPICAL_DURATION = 0.03
"""Typical simulated time until a flow is steady [s]."""
PROFILE_HEIGHTS = (0.2, 0.5, 0.8)
"""Heights of the result's velocity profiles, as fractions of the column's height (Xu et al. 2021, Fig. 18)."""
MAX_BREAKDOWN_TIMES = 6.0
"""Longest simulated time that a run waits until slip has broken the thixotropic structure of the slip layer, divided by
the time in which the structure decays to 1/e."""
MIN_SLIP_RATIO = 0.1
"""Ratio of slip velocity to mean velocity above which a run continues until the thixotropic structure of the slip layer
is broken."""
MAX_STRUCTURE_LEFT = 0.01
"""Maximum fraction of the yield stress gained at rest that the slip layer may still have in a flow that counts as
steady."""
COMPARISON_INTERVAL = 5e-3
"""Simulated time between two rows of the time series [s]. In a steady flow, the values in these rows must agree."""


class FluidSimulation(FlowRun):
    """Simulation of a pipe flow; :class:`warpcrete.Simulation` explains its parameters and errors.

    A solve that does not converge raises :class:`ConvergenceError`.
    """

    scene_type = FluidScene
    scene: FluidScene
    columns = UNITS
    drawn_by = FlowDisplay

    def set_up(self) -> None:
        """Start with an empty time series, create the monitor of the flow, and choose the module that measures it."""
        super().set_up()
        self._watch = WatchedFlow(self.scene)
        self._periodic = self.scene.ends == "periodic"
        self._probes = grid_probes if self._periodic else probes

    @property
    def top_speed(self) -> float:
        """Highest speed of the steady flow by theory [m/s]."""
        return self._watch.top_speed

    @property
    def duration(self) -> float:
        if self.scene.duration is not None:
            return self.scene.duration
        breaking = (
            MAX_BREAKDOWN_TIMES * self.scene.breakdown / self.scene.theory().slip_velocity
            if self._structure_breaks
            else 0.0
        )
        return max(MAX_DURATION, breaking)

    @property
    def _structure_breaks(self) -> bool:
        """True if slip will break the thixotropic structure of the slip layer before the flow counts as steady."""
        scene = self.scene
        return (
            bool(scene.gained)
            and not scene.rebuild_rate
            and scene.theory().slip_velocity > MIN_SLIP_RATIO * scene.velocity
        )

    @property
    def expected_duration(self) -> float:
        """Expected simulated time of the run [s]."""
        return TYPICAL_DURATION if self.scene.duration is None else self.scene.duration

    @property
    def frame_step(self) -> float:
        """Length of the time steps [s] if all are equal (column on a piston); infinite for flows on a grid."""
        return np.inf if self.scene.ends == "periodic" else self.scene.time_step

    def unit(self, column: str) -> str:
        """Return the unit of a column of the time series."""
        # The momentum of a channel is stated per metre of depth.
        return "kg/s" if column == "momentum" and self.scene.dimensions == 2 else super().unit(column)

    def place_flow(self) -> MovingParticles | GridFlow:
        """Return the flow at its start: a grid with particles for a periodic pipe, else particles only."""
        if self._periodic:
            check_memory(pipe_cells(self.scene), self.device, self.precision)
            return GridFlow(
                GridState(self.scene, pipe_layout(self.scene), self.device, self.precision), threads=self.threads
            )
        return MovingParticles(FluidState(self.scene, self.device, self.precision), threads=self.threads)

    def measured(self) -> dict[str, float]:
        """Measure the flow and return the results as a row of the time series."""
        return self._probes.measured(self.flow, self._rows[-1] if self._rows else None)

    def watch_row(self, row: dict[str, float]) -> None:
        """Raise :class:`InstabilityError` if a row of the time series shows that the flow has become unstable."""
        self._watch(row)

    @property
    def may_end_early(self) -> bool:
        """True if the run ends when the flow is steady; False if the scene states a duration."""
        return self.scene.duration is None

    def ended_early(self) -> bool:
        """Return True if the flow is steady; always False if the scene states a duration."""
        now, part = self._rows[-1], self.scene.steadiness
        if self._structure_breaks and now["layer_gained"] > MAX_STRUCTURE_LEFT * self.scene.gained:
            # Slip still breaks the thixotropic structure of the slip layer, so the flow is not steady, even if the
            # structure breaks so slowly that all other quantities look steady.
            return False
        earlier = []
        for moment in (now["time"] - COMPARISON_INTERVAL, now["time"] - 2 * COMPARISON_INTERVAL):
            # The first row of the time series is not compared, because the slip layer is not computed before the first
            # step. Two earlier rows must agree with the last one, because one row may agree by chance.
            rows_before = [row for row in self._rows[1:] if row["time"] <= moment + 1e-9]
            if not rows_before:
                return False
            earlier.append(rows_before[-1])
        scale = {name: abs(now[name]) for name in ("pressure", "wall_stress")} | {"slip_velocity": self.scene.velocity}
        # The unsheared plug in the middle of the pipe may still grow while the wall stress is steady, so compare the
        # highest speed as well.
        if self._periodic:
            scale["fastest"] = self.scene.velocity
        self.steady = all(abs(row[name] - now[name]) <= part * size for row in earlier for name, size in scale.items())
        return self.steady and self.scene.duration is None

    def sizes(self) -> Record:
        layout, grains = self.flow.state.layout, self.flow.state.grains
        model_sizes: Record = {
            "spacing": quantity(layout.spacing, "m"),
            "column_height": quantity(layout.height, "m"),
        }
        if grains is not None:
            model_sizes["aggregates"] = {
                "grains": grains.count,
                "fraction": float(np.mean(grains.group >= 0)),
                "smallest": quantity(grains.size.min(), "m"),
                "largest": quantity(grains.size.max(), "m"),
            }
        return model_sizes

    def outcome(self, series: dict[str, np.ndarray]) -> tuple[Record, dict[str, Table]]:
        """Return entries for the run's result, computed from the time series. A pipe flow has no tables."""
        result = results_of(QUANTITIES, RunData(self.scene, series, self.scene.theory()))
        result["theory"] = self.scene.form
        result["profiles"] = [self._profile(part) for part in PROFILE_HEIGHTS]
        outcomes = {what: float(series[f"{what}_iterations"][1:].mean()) for what in ("viscosity", "pressure")}
        result["iterations"] = outcomes
        return result, {}

    def _profile(self, part: float) -> Record:
        height = part * self.flow.state.layout.height
        radius, mean = self._probes.profile(self.flow, height)
        if isinstance(self.flow, GridFlow):
            theory = grid_probes.theory_profile(self.scene, self.flow.state.layout)
        else:
            places = np.minimum(radius, self.scene.radius)
            theory = velocity(self.scene.concrete, self.scene.line, self.scene.theory(), places)
        return {
            "height": quantity(height, "m"),
            "radius": {"value": radius.tolist(), "unit": "m"},
            "velocity": {"value": mean.tolist(), "unit": "m/s"},
            "theory": {"value": theory.tolist(), "unit": "m/s"},
        }
