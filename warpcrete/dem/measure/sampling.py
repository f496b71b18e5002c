"""Time series of a discrete element run: the columns, their units, and the measurement of each row."""

from collections.abc import Sequence

import numpy as np

from ...core.records import SavedState
from ...geometry.rotation import rotate
from ...geometry.walls import Wall
from ...kernels.dem.probes import FORCE, IMPULSE, TRAVEL, TURN, WORK
from ...kernels.dem.structs import DT, DT_PREVIOUS, TIME
from ..engine.model import Model
from ..engine.state import State
from .probes import row_sums
from .segregation import UNITS as SEGREGATION
from .segregation import row_of
from .stations import StationLog
from .vessel_measures import measured, unit_of_column
from .wear import UNITS as WEAR_UNITS
from .wear import WearMap

UNITS = {
    "time": "s",
    "travel": "m",
    "pressure": "Pa",
    "kinetic_energy": "J",
    "potential_energy": "J",
    "elastic_energy": "J",
    "bond_energy": "J",
    "wall_work": "J",
    "drive_work": "J",
    "dissipated_energy": "J",
    "contacts": "1",
    "bonds": "1",
    "hydrated_bonds": "1",
    "broken_tension": "1",
    "broken_shear": "1",
    "mean_overlap": "1",
    "largest_overlap": "1",
    "deepest_overlap": "1",
    "time_step": "s",
    "reach": "m",
    **SEGREGATION,
}
VECTOR_UNITS = {"momentum": "kg m/s", "drive": "N"}
"""Units of the vector columns of the time series, by quantity.

A column is named after the quantity and an axis, for example momentum_x.
"""
WALL_UNITS = {"force": "N", "moment": "N m", "impulse": "N s"}
"""Units of the columns of each wall in the time series, by quantity.

A column is named after the wall, the quantity and an axis, for example piston_force_x.
"""
AXES = "xyz"
STORED = ("kinetic_energy", "potential_energy", "elastic_energy", "bond_energy")
"""Names of the columns of stored energies, which can turn into motion again; dissipated energy cannot."""


def unit_of(column: str, walls: Sequence[Wall]) -> str:
    """Return the unit of a column in the time series of a scene with the given walls.

    Raises KeyError for an unknown column.
    """
    if column in UNITS:
        return UNITS[column]
    if unit := unit_of_column(column):
        return unit
    name, _, axis = column.rpartition("_")
    if axis in AXES and name in VECTOR_UNITS:
        return VECTOR_UNITS[name]
    wall, _, kind = name.rpartition("_")
    if axis in AXES and kind in WALL_UNITS and wall in [w.name for w in walls]:
        return WALL_UNITS[kind]
    for kind, unit in WEAR_UNITS.items():
        if column.removesuffix(f"_{kind}") in [w.name for w in walls]:
            return unit
    raise KeyError(f"column {column!r} has no unit; add it to the units in warpcrete/dem/measure/sampling.py")


class Sampler:
    """Recorder of the time series, row by row; the recorded forces on walls are means since the previous row."""

    def __init__(self, model: Model, state: State) -> None:
        self.model, self.state = model, state
        self.rows: list[dict[str, float]] = []
        stations = model.scene.stations
        self.log = StationLog(stations) if stations is not None and stations.each_row else None
        """Measurements in slices of the pipe, if the scene requests them in every row of the series; otherwise None."""
        self._impulse: np.ndarray | None = None
        self._mean = np.zeros((len(model.walls), 6))
        self._half_time = 0.0
        self._power = 0.0
        self._drive_work = 0.0
        wear = model.scene.wear
        self.wear = WearMap(model.walls, wear) if model.features.wear and wear is not None else None
        """Wear of the walls up to the last row of the time series; None if the scene does not request it."""

    def state_dict(self) -> SavedState:
        """Return all rows of the time series so far and everything on which the next row depends, for a checkpoint."""
        return {
            "columns": list(self.rows[0]) if self.rows else [],
            "rows": np.array([list(row.values()) for row in self.rows]),
            "impulse": self._impulse,
            "mean": self._mean,
            "half_time": self._half_time,
            "power": self._power,
            "drive_work": self._drive_work,
            "wear": self.wear.state_dict() if self.wear is not None else None,
            **({} if self.log is None else {"stations": np.array(self.log.samples)}),
        }

    def load_state_dict(self, state: SavedState) -> None:
        """Restore the sampler from a `state_dict`: the rows of the time series and the data that the next row needs."""
        self.rows = [dict(zip(state["columns"], map(float, row))) for row in state["rows"]]
        self._impulse, self._mean = state["impulse"], state["mean"]
        self._half_time, self._power = float(state["half_time"]), float(state["power"])
        self._drive_work = float(state["drive_work"])
        if self.wear is not None:
            self.wear.load_state_dict(state["wear"])
        if self.log is not None:
            self.log.samples = list(np.asarray(state["stations"], dtype=float))

    def series(self) -> dict[str, np.ndarray]:
        """Return the columns of the time series by name, each of shape (rows,)."""
        return {name: np.array([row[name] for row in self.rows]) for name in (self.rows[0] if self.rows else ())}

    def sample(self) -> dict[str, float]:
        """Measure the current state, append the values as a row to the time series, and return the row."""
        model, state, scene = self.model, self.state, self.model.scene
        clock = state.batch.host_clock()[state.index]
        bodies, contacts, walls = row_sums(model, state)
        impulse = self._forces(clock, walls, bodies.drive_power)
        row = {"time": float(clock[int(TIME)])} | self._pressure(walls)
        row |= {
            "kinetic_energy": bodies.kinetic_energy,
            "potential_energy": bodies.potential_energy,
            "elastic_energy": contacts.elastic_energy,
            "bond_energy": contacts.bond_energy,
            "wall_work": float(walls[:, int(WORK)].sum()),
            "drive_work": self._drive_work,
        }
        if model.features.dissipation:
            by_number = np.argsort(state.spheres.id.numpy())
            row["dissipated_energy"] = float(state.spheres.dissipated_energy.numpy()[by_number].sum())
        row |= {
            "contacts": contacts.contacts,
            "bonds": contacts.bonded,
            "hydrated_bonds": contacts.hydrated if scene.hydration else 0,
            "broken_tension": contacts.broken_tension,
            "broken_shear": contacts.broken_shear,
            "mean_overlap": contacts.mean_overlap,
            "largest_overlap": contacts.largest_overlap,
            "deepest_overlap": contacts.deepest,
            "time_step": float(clock[int(DT)]),
            "reach": bodies.reach,
        }
        if scene.vessel is not None and state.sphere_count:
            row |= measured(scene.vessel, state.spheres.position.numpy(), state.spheres.velocity.numpy())
        if self.log is not None:
            self.log.add(model, state, row.get("travel", 0.0))
        for axis, letter in enumerate(AXES):
            row[f"momentum_{letter}"] = float(bodies.momentum[axis])
            row[f"drive_{letter}"] = float(bodies.drive_force[axis])
            for number, wall in enumerate(model.walls):
                row[f"{wall.name}_force_{letter}"] = float(self._mean[number, axis])
                row[f"{wall.name}_moment_{letter}"] = float(self._mean[number, 3 + axis])
                row[f"{wall.name}_impulse_{letter}"] = float(impulse[number, axis])
        if scene.segregation:
            row |= row_of(model, state)
        if self.wear is not None:
            self.wear.take(state)
            row |= self.wear.columns()
        self.rows.append(row)
        return row

    def _forces(self, clock: np.ndarray, walls: np.ndarray, drive_power: float) -> np.ndarray:
        """Update mean wall forces and the work of driving forces; return the impulses of all walls, shape (walls, 6).

        The columns are the impulse [N s] and the angular impulse [N m s]. `clock` and `walls` contain the times of the
        scene and the values of its walls, and `drive_power` is the power of the driving forces [W].
        """
        impulse = walls[:, int(IMPULSE) : int(IMPULSE) + 6].copy()
        # The impulse on a wall is the sum of its forces over time. In the leapfrog scheme this sum reaches to the
        # middle of the last step, so the time over which the mean wall force is taken also ends there.
        half_time = float(clock[int(TIME)]) - 0.5 * float(clock[int(DT_PREVIOUS)])
        if self._impulse is None:
            self._mean = walls[:, int(FORCE) : int(FORCE) + 6].copy()
        elif half_time > self._half_time:
            span = half_time - self._half_time
            self._mean = (impulse - self._impulse) / span
            self._drive_work += 0.5 * span * (self._power + drive_power)
        self._impulse, self._half_time, self._power = impulse, half_time, drive_power
        return impulse

    def _pressure(self, walls: np.ndarray) -> dict[str, float]:
        """Return the travel [m] of the wall at which the scene measures the pressure, and the pressure on it [Pa]."""
        probe = self.model.scene.pressure
        if probe is None:
            return {}
        number = next(k for k, wall in enumerate(self.model.walls) if wall.name == probe.wall)
        turn = walls[number, int(TURN) : int(TURN) + 4]
        normal = np.array(self.model.walls[number].normal, dtype=float)  # type: ignore[union-attr]
        if turn[:3].any():
            normal = rotate(turn[None], normal[None])[0]
        return {
            "travel": float(walls[number, int(TRAVEL)]),
            "pressure": float(-self._mean[number, :3] @ normal / probe.area),
        }
