"""Simulation of mortar with aggregates that flows through a part of a pump line."""

import numpy as np

from ...core.records import Record, SavedState
from ...core.run.method import results_of
from ...core.run.run_loop import Simulation
from ...core.run.tables import Table
from ...mps.grid.state import GridState, check_memory
from ...mps.part.layout import part_layout, part_room
from ...mps.part.simulation import PartSimulation
from ..flow import SuspensionFlow
from ..runs import SOLVE_BYTES, AggregateRun
from ..runs import UNITS as SHARED_UNITS
from .blockage import blocked_place, is_blocked
from .display import PartSuspensionDisplay
from .layout import placed_entering
from .probes import UNITS, Census, measured
from .quantities import QUANTITIES, SuspensionData, late_rows
from .scene import PartSuspensionScene

STEADINESS = 0.05
"""Largest relative difference of the mean frictional pressures in the third and the last quarter of a steady run."""


class PartSuspensionSimulation(AggregateRun, PartSimulation):  # pyright: ignore[reportIncompatibleVariableOverride]
    """Simulation of mortar with aggregates in a part of a pump line.

    :class:`warpcrete.Simulation` explains its parameters and errors.
    """

    scene_type = PartSuspensionScene
    scene: PartSuspensionScene  # pyright: ignore[reportIncompatibleVariableOverride]
    columns = UNITS | SHARED_UNITS
    drawn_by = PartSuspensionDisplay

    def set_up(self) -> None:
        """Start with an empty time series."""
        super().set_up()
        # `_profiles` holds one array for each row of the time series: the arc lengths of stations along the part, and
        # the pressure loss and the fraction of aggregates at each station. `_places` holds the arc lengths of the
        # aggregates at the last row.
        self._profiles: list[np.ndarray] = []
        self._places = np.zeros(0)

    def place_flow(self) -> SuspensionFlow:
        """Return the flow in its initial state, with particles, aggregates and grid."""
        scene = self.scene
        check_memory(part_room(scene).cells, self.device, self.precision, more=SOLVE_BYTES)
        layout = part_layout(scene)
        aggregates, entrance = placed_entering(scene, layout)
        self.entering = entrance.enters
        """Time at which each aggregate has entered entirely [s], shape (n,)."""
        return SuspensionFlow(
            GridState(scene, layout, self.device, self.precision), aggregates, roughness=scene.roughness,
            friction=scene.friction, entrance=entrance,
        )  # fmt: skip

    def measured(self) -> dict[str, float]:
        census = Census(self.flow, self.entering)
        travel = self.scene.velocity * (self.flow.time - self._rows[-1]["time"]) if self._rows else 0.0
        row, profiles = measured(census, self._places, travel)
        self._places = census.place
        self._profiles.append(profiles)
        return row | self.aggregate_columns()

    def ended_early(self) -> bool:
        """Update the attribute `steady`, and return whether the part is blocked, which ends the run."""
        rows, scene = self._rows, self.scene
        time, pressure = (np.array([row[name] for row in rows]) for name in ("time", "pressure"))
        pressure = pressure - scene.density * scene.gravity * scene.rise
        last, third = time >= 0.75 * time[-1], (time >= 0.5 * time[-1]) & (time < 0.75 * time[-1])
        if third.any():
            now, before = pressure[last].mean(), pressure[third].mean()
            self.steady = bool(abs(now - before) <= STEADINESS * abs(now))
        return len(rows) > 1 and is_blocked(scene, rows)

    def why_ended(self) -> tuple[str, str]:
        if len(self._rows) > 1 and is_blocked(self.scene, self._rows):
            return "blocked", f"the part was blocked at t = {self.flow.time:.4g} s"
        # The run lasts as long as the scene states, even if the flow is steady.
        return Simulation.why_ended(self)

    @property
    def fraction(self) -> float:
        """Volume fraction of the placed aggregates in the concrete, in the part and in the pipe upstream of it."""
        return self.scene.simulated_fraction

    def sizes(self) -> Record:
        """Return the number of cells and other sizes of this run, for its results."""
        return super().sizes() | self.aggregate_sizes()

    def friction_profile(self) -> tuple[np.ndarray, np.ndarray]:
        """Return arc lengths [m], and the mean frictional loss from each arc length to the end of the part [Pa]."""
        place, friction, _ = self._late()
        return place, friction

    def _late(self) -> np.ndarray:
        """Return mean profiles along the part over the last half of the run, shape (3, stations).

        The rows are the arc length of each station [m], the frictional loss from the station to the end of the part
        [Pa], and the volume fraction of aggregates around the station.
        """
        late = late_rows(np.array([row["time"] for row in self._rows]))
        return np.mean(np.array(self._profiles)[late], axis=0)

    def outcome(self, series: dict[str, np.ndarray]) -> tuple[Record, dict[str, Table]]:
        """Return the entries of the result, and a table with mean pressure and aggregate fraction along the part."""
        result, tables = super().outcome(series)
        place = blocked_place(self.scene, *self._profiles[-1][:2])
        result |= results_of(QUANTITIES, SuspensionData(self.scene, series, place))
        fraction = self._late()[2]
        result["profile"]["fraction"] = {"value": fraction.tolist(), "unit": "1"}
        stations = tables["stations"]
        with_fraction = Table({**stations.columns, "fraction": fraction}, {**stations.units, "fraction": "1"})
        return result, tables | {"stations": with_fraction}

    def state_dict(self) -> SavedState:
        """Return the state of the flow, all rows of the time series, and all profiles measured along the part.

        The arc lengths of the aggregates at the last measurement [m] are included.
        """
        return super().state_dict() | {"profiles": np.array(self._profiles), "places": self._places}

    def load_state_dict(self, state: SavedState) -> None:
        """Restore a run from a `state_dict`."""
        super().load_state_dict(state)
        self._profiles, self._places = list(state["profiles"]), np.array(state["places"])
