"""What a run writes down at every sample, and the figures made of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from .kernels.types import DT_PREVIOUS, TIME
from .model import Model
from .probes import body_sums, contact_sums
from .scene import PlaneWall, Scene
from .state import State, rotate

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
    "momentum_x": "kg m/s",
    "momentum_y": "kg m/s",
    "momentum_z": "kg m/s",
    "drive_x": "N",
    "drive_y": "N",
    "drive_z": "N",
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
    "pressure_gradient": "Pa/m",
    "wall_stress": "Pa",
    "slip_velocity": "m/s",
    "profile_deviation": "m/s",
    "volume_error": "1",
    "force_balance_error": "1",
    "front": "m",
    "momentum": "kg m/s",
    "viscosity_iterations": "1",
    "pressure_iterations": "1",
    "aggregate_inner": "1",
    "aggregate_outer": "1",
    "aggregate_front": "1",
    "aggregate_rear": "1",
}
STORED = ("kinetic_energy", "potential_energy", "elastic_energy", "bond_energy")


class Sampler:
    """Makes the rows of the series. Forces on walls are means since the row before."""

    def __init__(self, model: Model, state: State) -> None:
        self.model, self.state = model, state
        self.rows: list[dict[str, float]] = []
        self._impulse: np.ndarray | None = None
        self._mean = np.zeros((len(model.walls), 6))
        self._half_time = 0.0
        self._power = 0.0
        self._drive_work = 0.0

    def memory(self) -> dict[str, Any]:
        """All that the next row depends on, and the rows so far, as arrays and numbers."""
        return {
            "columns": list(self.rows[0]) if self.rows else [],
            "rows": np.array([list(row.values()) for row in self.rows]),
            "impulse": self._impulse,
            "mean": self._mean,
            "half_time": self._half_time,
            "power": self._power,
            "drive_work": self._drive_work,
        }

    def recall(self, memory: dict[str, Any]) -> None:
        """Go on from a `memory`."""
        self.rows = [dict(zip(memory["columns"], map(float, row))) for row in memory["rows"]]
        self._impulse, self._mean = memory["impulse"], memory["mean"]
        self._half_time, self._power = float(memory["half_time"]), float(memory["power"])
        self._drive_work = float(memory["drive_work"])

    def series(self) -> dict[str, np.ndarray]:
        """Columns by name."""
        return {name: np.array([row[name] for row in self.rows]) for name in (self.rows[0] if self.rows else ())}

    def sample(self) -> dict[str, float]:
        """Measure, and append a row."""
        model, state, scene = self.model, self.state, self.model.scene
        bodies, contacts = body_sums(model, state), contact_sums(model, state)
        clock = state.clock.numpy()[0]
        now = float(clock[int(TIME)])
        impulse = _joined(state.wall_impulse, state.wall_angular_impulse)
        # Forces have acted up to the middle of the last step.
        half_time = now - 0.5 * float(clock[int(DT_PREVIOUS)])
        if self._impulse is None:
            self._mean = _joined(state.wall_force, state.wall_moment)
        elif half_time > self._half_time:
            span = half_time - self._half_time
            self._mean = (impulse - self._impulse) / span
            self._drive_work += 0.5 * span * (self._power + bodies.drive_power)
        self._impulse, self._half_time, self._power = impulse, half_time, bodies.drive_power

        row = {"time": now}
        for number, wall in enumerate(model.walls):
            if wall.name == scene.notes.get("pressure_wall") and isinstance(wall, PlaneWall):
                row["travel"] = float(state.wall_travel.numpy()[number])
                turn = state.wall_orientation.numpy().reshape(-1, 4)[number].astype(float)
                normal = rotate(turn[None], np.array([wall.normal]))[0]
                row["pressure"] = float(-self._mean[number, :3] @ normal / scene.notes["pressure_area"])
        row |= {
            "kinetic_energy": bodies.kinetic_energy,
            "potential_energy": bodies.potential_energy,
            "elastic_energy": contacts.elastic_energy,
            "bond_energy": contacts.bond_energy,
            "wall_work": float(state.wall_work.numpy().sum()),
            "drive_work": self._drive_work,
        }
        if model.features.losses:
            row["dissipated_energy"] = float(state.sphere_lost.numpy()[np.argsort(state.sphere_id.numpy())].sum())
        row |= {
            "contacts": contacts.contacts,
            "bonds": contacts.bonded,
            "hydrated_bonds": contacts.hydrated if scene.hydration else 0,
            "broken_tension": contacts.broken_tension,
            "broken_shear": contacts.broken_shear,
            "mean_overlap": contacts.mean_overlap,
            "largest_overlap": contacts.largest_overlap,
            "deepest_overlap": contacts.deepest,
            "time_step": float(clock[1]),
            "reach": bodies.reach,
        }
        for axis, letter in enumerate("xyz"):
            row[f"momentum_{letter}"] = float(bodies.momentum[axis])
            row[f"drive_{letter}"] = float(bodies.drive_force[axis])
            for number, wall in enumerate(model.walls):
                row[f"{wall.name}_force_{letter}"] = float(self._mean[number, axis])
                row[f"{wall.name}_moment_{letter}"] = float(self._mean[number, 3 + axis])
                row[f"{wall.name}_impulse_{letter}"] = float(impulse[number, axis])
        self.rows.append(row)
        return row


def _joined(forces, moments) -> np.ndarray:
    return np.concatenate([forces.numpy().reshape(-1, 3), moments.numpy().reshape(-1, 3)], axis=1)


def quantity(value: float, unit: str) -> dict[str, Any]:
    """A figure with its unit, as it stands in result.json."""
    return {"value": float(value), "unit": unit}


def unit_of(column: str) -> str:
    """Unit of a column of the series."""
    if column in UNITS:
        return UNITS[column]
    return "N s" if "_impulse_" in column else "N m" if "_moment_" in column else "N"


def pressure_figures(series: dict[str, np.ndarray]) -> dict[str, Any]:
    """Peak and plateau of the pumping pressure, and the piston travel at which they occur.

    The plateau is the mean over the last fifth of the travel; the peak is the largest sample.
    """
    if "pressure" not in series or len(series["pressure"]) < 2:
        return {}
    pressure, travel = series["pressure"], series["travel"]
    peak = int(np.argmax(pressure))
    window = travel >= 0.8 * travel[-1]
    return {
        "peak_pressure": quantity(pressure[peak], "Pa"),
        "peak_travel": quantity(travel[peak], "m"),
        "plateau_pressure": quantity(pressure[window].mean(), "Pa"),
        "plateau_scatter": quantity(pressure[window].std(), "Pa"),
        "plateau_from_travel": quantity(travel[window][0], "m"),
    }


def momentum_balance(scene: Scene, walls: Sequence, series: dict[str, np.ndarray], mass: float) -> float:
    """Impulse of all walls, drives and gravity less the change of momentum, over the impulse of gravity or walls.

    Taken over the second half of the run; `mass` is that of all bodies [kg].
    """
    if len(series["time"]) < 4:
        return float("nan")
    first, last = len(series["time"]) // 2, len(series["time"]) - 1
    span = series["time"][last] - series["time"][first]
    residual, size = np.zeros(3), np.zeros(3)
    for axis, letter in enumerate("xyz"):
        drive = np.trapezoid(series[f"drive_{letter}"][first:], series["time"][first:])
        wall = [-np.diff(series[f"{w.name}_impulse_{letter}"][[first, last]])[0] for w in walls]
        gravity = mass * scene.gravity[axis] * span
        change = series[f"momentum_{letter}"][last] - series[f"momentum_{letter}"][first]
        residual[axis] = gravity + drive + sum(wall) - change
        size[axis] = max([abs(gravity), abs(drive), *map(abs, wall)])
    return float(np.linalg.norm(residual) / max(np.linalg.norm(size), 1e-300))


def free_energy(series: dict[str, np.ndarray]) -> np.ndarray:
    """Energy stored in bodies, contacts and bonds less the work of walls and drives [J]; only losses change it."""
    return sum(series[name] for name in STORED) - series["wall_work"] - series["drive_work"]


def energy_balance(series: dict[str, np.ndarray]) -> float:
    """Stored and dissipated energy less work, at the end against the start.

    Over the work, the dissipation or the largest energy of motion and springs, whichever is most. NaN where losses
    were not added up (`Scene.energy_balance`), or nothing ever moved.
    """
    if "dissipated_energy" not in series or len(series["time"]) < 2:
        return float("nan")
    lost = series["dissipated_energy"][-1] - series["dissipated_energy"][0]
    residual = np.diff(free_energy(series)[[0, -1]])[0] + lost
    work = abs(series["wall_work"][-1] + series["drive_work"][-1])
    moving = float(np.max(series["kinetic_energy"] + series["elastic_energy"] + series["bond_energy"]))
    size = max(work, abs(lost), moving)
    return float(residual / size) if size > 0 else float("nan")
