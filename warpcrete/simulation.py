"""The spine: from a scene to a finished run. Read this file first.

simulation = Simulation(scenes.pipe(unit="vertical"))
run = simulation.run()
run.series["pressure"]
"""

from __future__ import annotations

import json
import platform
import time as wall_clock
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from .errors import RunFolderError, WarpcreteError, positive
from .kernels.wall_motion import FIXED, PRESCRIBED
from .model import build_model, find_device
from .packing import PackingReport, pack
from .probes import body_sums, contact_sums
from .progress import ProgressBar
from .scene import PlaneWall, Scene
from .state import BodyTable, State, placed_bodies, rotate
from .stepper import Stepper

Progress = Callable[[str, float, dict[str, Any]], None]
"""Called with the phase (`packing`, `settling`, `running`), the share done and a few current figures."""

QUIET = 1e-5  # kinetic over elastic energy at which a state counts as settled

UNITS = {
    "time": "s",
    "travel": "m",
    "pressure": "Pa",
    "kinetic_energy": "J",
    "potential_energy": "J",
    "elastic_energy": "J",
    "bond_energy": "J",
    "wall_work": "J",
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
    "time_step": "s",
}


class Recorder(Protocol):
    """Where a run goes. Methods are called in this order; `finish` also after an interruption or an error."""

    def start(self, simulation: Simulation) -> None: ...
    def sample(self, simulation: Simulation, row: dict[str, float]) -> None: ...
    def frame(self, simulation: Simulation) -> None: ...
    def finish(self, simulation: Simulation, run: Run) -> None: ...


@dataclass
class Run:
    """A finished (or interrupted) run."""

    scene: Scene
    series: dict[str, np.ndarray]
    """One array a column, one entry a sample."""
    units: dict[str, str]
    """Unit of each column."""
    result: dict[str, Any]
    """Figures of the whole run; those with a unit are `{"value", "unit"}`."""
    packing: PackingReport | None
    finished: bool
    folder: Path | None = None
    bodies: BodyTable = field(default_factory=BodyTable.empty)
    """Bodies at the end."""


class Simulation:
    """A scene on a device, with recorders.

    Parameters: `scene`; `device` as Warp names it, None for a GPU if there is one, else the CPU; `precision`
    `float32` or `float64`; `recorders`; `frame_interval` simulated seconds between recorded frames;
    `progress` True for a bar, or a callback. Raises :class:`SceneError`, :class:`DeviceError`; a run may raise
    :class:`InstabilityError`.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        device: str | None = None,
        precision: str = "float32",
        recorders: Sequence[Recorder] = (),
        frame_interval: float = 0.04,
        progress: Progress | bool = False,
    ) -> None:
        positive("frame_interval", frame_interval, "s")
        self.scene = scene
        self.device = find_device(device)
        self.precision = precision
        self.model = build_model(scene, self.device, precision)
        self.recorders = list(recorders)
        self.frame_interval = frame_interval
        self.packing: PackingReport | None = None
        self.rows: list[dict[str, float]] = []
        self.stop_requested = False
        self.finishing = False
        if progress is True:
            progress = ProgressBar()
        self._progress = progress or (lambda phase, share, figures: None)
        self._last_impulse: np.ndarray | None = None
        self._spent: dict[str, float] = {}

    def prepare(self) -> None:
        """Pack, place, bond groups, settle, bond: everything up to t = 0."""
        scene, model = self.scene, self.model
        started = wall_clock.perf_counter()
        self._tell("packing", 0.0)
        table = BodyTable.empty()
        if scene.fill is not None:
            table, self.packing = pack(
                scene.fill,
                contact=scene.contact,
                seed=scene.seed,
                device=self.device,
                precision=self.precision,
                progress=lambda share: self._tell("packing", share),
            )
        self._tell("packing", 1.0)
        self._spent["packing"] = wall_clock.perf_counter() - started
        self.state = State(model, table.joined(placed_bodies(scene)))
        damping = scene.settle.local_damping if scene.settle else scene.local_damping
        self.stepper = Stepper(model, self.state, scene.time_step, local_damping=damping)
        first_group_kind = 1 + (scene.bonds is not None) + (scene.hydration is not None)
        for number, (group, bonds) in enumerate(scene.group_bonds.items()):
            self.stepper.bond(bonds, first_group_kind + number, model.groups.index(group))
        self.stepper.choose_dt()  # refuses an unstable fixed step before anything is written

        started = wall_clock.perf_counter()
        if scene.settle and scene.settle.duration > 0:
            self._settle(scene.settle.duration)
            self.stepper.change(local_damping=scene.local_damping)
        self._spent["settling"] = wall_clock.perf_counter() - started
        self.stepper.restart_clock()
        if scene.bonds is not None and scene.bonds.healing:
            # Contacts that healed while settling carry its loads: all of the scene's bonds start anew at t = 0.
            kinds = self.state.pair_bond.numpy()
            self.state.pair_bond.assign(np.where(kinds <= 1, 0, kinds).astype(np.int32))
        self.bond()
        self.stepper.choose_dt()
        self.stepper.running = True

    def bond(self) -> None:
        """Bond the scene's contacts as they are now, and hydrate a share of them."""
        scene = self.scene
        if scene.bonds is None:
            return
        self.stepper.bond(scene.bonds, 1)
        if scene.hydration is not None:
            self.stepper.hydrate(1, 2, scene.hydration.share, scene.seed)

    def run(self) -> Run:
        """Prepare and run to the end of the scene's duration, or until `stop_requested` or Ctrl-C."""
        if self.rows:
            raise WarpcreteError("this simulation has run; make a new Simulation for another run")
        if not hasattr(self, "state"):
            self.prepare()
        started = wall_clock.perf_counter()
        begun: list[Recorder] = []
        finished = False
        try:
            try:
                for recorder in self.recorders:
                    begun.append(recorder)
                    recorder.start(self)
                finished = self._loop(started)
            except KeyboardInterrupt:
                pass
        finally:
            self._spent["running"] = wall_clock.perf_counter() - started
            self.finishing = True
            run = self._result(finished)
            failures = []
            for recorder in begun:
                try:
                    recorder.finish(self, run)
                except Exception as error:  # one broken output must not cost the others
                    failures.append(error)
            if isinstance(self._progress, ProgressBar):
                self._progress.close()
        if failures:
            raise failures[0]
        return run

    def _loop(self, started: float) -> bool:
        scene, stepper = self.scene, self.stepper
        self._sample()
        for recorder in self.recorders:
            recorder.frame(self)
        samples = max(1, int(np.ceil(scene.duration / scene.sample_interval - 1e-9)))
        next_frame = self.frame_interval
        for number in range(1, samples + 1):
            if self.stop_requested:
                return False
            until = min(number * scene.sample_interval, scene.duration)
            stepper.advance(until)
            self._sample()
            if stepper.time >= next_frame - 1e-9 or number == samples:
                for recorder in self.recorders:
                    recorder.frame(self)
                next_frame = self.frame_interval * (np.floor(stepper.time / self.frame_interval + 1e-9) + 1)
            spent = wall_clock.perf_counter() - started
            self._tell(
                "running",
                number / samples,
                steps_per_s=stepper.steps / max(spent, 1e-9),
                **({"pressure": self.rows[-1]["pressure"]} if "pressure" in self.rows[-1] else {}),
            )
        return True

    def _settle(self, duration: float) -> None:
        # Walls that will move stand still: their motion starts with the clock of the run proper.
        walls = self.model.wall_table.numpy().copy()
        still = walls.copy()
        prescribed = still["motion"] == int(PRESCRIBED)
        still["motion"][prescribed] = int(FIXED)
        self.model.wall_table.assign(still)
        parts = 50
        for part in range(parts):
            self.stepper.advance(duration * (part + 1) / parts)
            self._tell("settling", (part + 1) / parts)
            kinetic = body_sums(self.model, self.state).kinetic_energy
            if part > 2 and kinetic < QUIET * contact_sums(self.model, self.state).elastic_energy:
                break
        self._tell("settling", 1.0)
        self.model.wall_table.assign(walls)

    def _tell(self, phase: str, share: float, **figures: Any) -> None:
        self._progress(phase, share, figures)

    def _sample(self) -> None:
        model, state, stepper = self.model, self.state, self.stepper
        bodies, contacts = body_sums(model, state), contact_sums(model, state)
        flags = state.flags.numpy()
        now = stepper.time
        row = {"time": now}
        pushes = [state.wall_impulse.numpy(), state.wall_angular_impulse.numpy()]
        impulse = np.concatenate([push.reshape(-1, 3) for push in pushes], axis=1)
        # Forces have acted up to the middle of the last step.
        half_time = now - 0.5 * float(state.clock.numpy()[2])
        if self._last_impulse is None:
            loads = [state.wall_force.numpy(), state.wall_moment.numpy()]
            mean = np.concatenate([load.reshape(-1, 3) for load in loads], axis=1)
        elif half_time <= self._last_half_time:
            mean = self._last_mean  # no step since the last sample
        else:
            mean = (impulse - self._last_impulse) / max(half_time - self._last_half_time, 1e-300)
        self._last_impulse, self._last_half_time, self._last_mean = impulse, half_time, mean
        probe = self.scene.notes.get("pressure_wall")
        for number, wall in enumerate(model.walls):
            if wall.name == probe and isinstance(wall, PlaneWall):
                row["travel"] = float(state.wall_travel.numpy()[number])
                turn = state.wall_orientation.numpy().reshape(-1, 4)[number].astype(float)
                normal = rotate(turn[None], np.array([wall.normal]))[0]
                row["pressure"] = float(-mean[number, :3] @ normal / self.scene.notes["pressure_area"])
        row |= {
            "kinetic_energy": bodies.kinetic_energy,
            "potential_energy": bodies.potential_energy,
            "elastic_energy": contacts.elastic_energy,
            "bond_energy": contacts.bond_energy,
            "wall_work": float(state.wall_work.numpy().sum()),
            "contacts": contacts.contacts,
            "bonds": contacts.bonded,
            "hydrated_bonds": contacts.hydrated if self.scene.hydration else 0,
            "broken_tension": int(flags[4]),
            "broken_shear": int(flags[5]),
            "mean_overlap": contacts.mean_overlap,
            "largest_overlap": contacts.largest_overlap,
            "time_step": stepper.dt,
        }
        for axis, letter in enumerate("xyz"):
            row[f"momentum_{letter}"] = float(bodies.momentum[axis])
            row[f"drive_{letter}"] = float(bodies.drive_force[axis])
            for number, wall in enumerate(model.walls):
                row[f"{wall.name}_force_{letter}"] = float(mean[number, axis])
                row[f"{wall.name}_moment_{letter}"] = float(mean[number, 3 + axis])
                row[f"{wall.name}_impulse_{letter}"] = float(impulse[number, axis])
        self.rows.append(row)
        for recorder in self.recorders:
            recorder.sample(self, row)

    def _result(self, finished: bool) -> Run:
        series = {name: np.array([row[name] for row in self.rows]) for name in (self.rows[0] if self.rows else ())}
        units = {name: unit_of(name) for name in series}
        steps = self.stepper.steps
        running = self._spent.get("running", 0.0)
        result: dict[str, Any] = {
            "scene": self.scene.name,
            "finished": finished,
            "simulated_time": quantity(self.stepper.time, "s"),
            "steps": steps,
            "bodies": self.state.body_count,
            "spheres": self.state.sphere_count,
        }
        if "concrete_length" in self.scene.notes:
            result["unit"] = self.scene.notes["unit"]
            result["concrete_length"] = quantity(self.scene.notes["concrete_length"], "m")
        if self.packing is not None:
            result["packing"] = asdict(self.packing)
        if self.rows:
            contacts = contact_sums(self.model, self.state, coordination=True)
            last = self.rows[-1]
            result |= pressure_figures(series)
            result["energies_at_end"] = {
                name: quantity(last[name], "J")
                for name in ("kinetic_energy", "potential_energy", "elastic_energy", "bond_energy", "wall_work")
            }
            result["coordination_number"] = contacts.coordination_number
            result["largest_overlap"] = float(series["largest_overlap"].max())
            result["momentum_balance_error"] = momentum_balance(self.scene, self.model.walls, series, self.state)
        result["speed"] = {
            "wall_time": quantity(running, "s"),
            "packing_time": quantity(self._spent.get("packing", 0.0), "s"),
            "settling_time": quantity(self._spent.get("settling", 0.0), "s"),
            "steps_per_second": quantity(steps / max(running, 1e-9), "1/s"),
            "sphere_steps_per_second": quantity(steps * self.state.sphere_count / max(running, 1e-9), "1/s"),
        }
        result["provenance"] = provenance(self)
        return Run(self.scene, series, units, result, self.packing, finished, bodies=self.state.table())


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


def momentum_balance(scene: Scene, walls: Sequence, series: dict[str, np.ndarray], state: State) -> float:
    """Impulse of all walls, drives and gravity less the change of momentum, over the impulse of gravity or walls.

    Taken over the second half of the run.
    """
    if len(series["time"]) < 4:
        return float("nan")
    first, last = len(series["time"]) // 2, len(series["time"]) - 1
    span = series["time"][last] - series["time"][first]
    mass = float(state.body_mass.numpy().sum(dtype=float))
    residual, size = np.zeros(3), np.zeros(3)
    for axis, letter in enumerate("xyz"):
        drive = np.trapezoid(series[f"drive_{letter}"][first:], series["time"][first:])
        wall = [-np.diff(series[f"{w.name}_impulse_{letter}"][[first, last]])[0] for w in walls]
        gravity = mass * scene.gravity[axis] * span
        change = series[f"momentum_{letter}"][last] - series[f"momentum_{letter}"][first]
        residual[axis] = gravity + drive + sum(wall) - change
        size[axis] = max([abs(gravity), abs(drive), *map(abs, wall)])
    return float(np.linalg.norm(residual) / max(np.linalg.norm(size), 1e-300))


def provenance(simulation: Simulation) -> dict[str, Any]:
    """Versions, device and settings that a run depends on."""
    return {
        "warpcrete": _version("warpcrete"),
        "warp": _version("warp-lang"),
        "numpy": np.__version__,
        "python": platform.python_version(),
        "machine": platform.machine(),
        "device": str(simulation.device),
        "device_name": simulation.device.name,
        "precision": simulation.precision,
        "seed": simulation.scene.seed,
    }


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "source tree, not installed"


def scene_record(simulation: Simulation) -> dict[str, Any]:
    """What scene.json holds: the scene function's name and every argument, and how the run was set up."""
    scene = simulation.scene
    if not scene.parameters:
        raise RunFolderError(f"scene {scene.name!r} has no parameters to save; make it with a scene function")
    return {
        "scene": scene.name,
        "parameters": dict(scene.parameters),
        "device": str(simulation.device),
        "precision": simulation.precision,
        "provenance": provenance(simulation),
    }


def _finite(data: Any) -> Any:
    # JSON has no word for NaN: what was not measured is null.
    if isinstance(data, dict):
        return {key: _finite(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_finite(value) for value in data]
    if isinstance(data, float) and not np.isfinite(data):
        return None
    return data


def write_json(path: Path, data: Any) -> None:
    """Write beside, then rename: a reader never sees half a file."""
    partial = path.with_name(path.name + ".partial")
    partial.write_text(json.dumps(_finite(data), indent=2, allow_nan=False) + "\n")
    partial.replace(path)
