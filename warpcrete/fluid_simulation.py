"""Flow of a Bingham fluid from a scene to a finished run; goes on in `spine.py`, as discrete elements do."""

from __future__ import annotations

import time as wall_clock
from pathlib import Path
from typing import Any

import numpy as np

from . import checkpoint
from .errors import WarpcreteError, refuse
from .fluid import FluidScene
from .fluid_probes import figures, profile
from .fluid_state import FluidState
from .mps import MovingParticles
from .provenance import arrays_hash, provenance
from .series import quantity, unit_of
from .spine import Run, Spine, to_end
from .theory import velocity

LONGEST = 2.0  # simulated seconds after which a flow that does not become steady ends all the same
PROFILES = (0.2, 0.5, 0.8)
"""Heights of the velocity profiles in the result, in shares of the column's (Xu et al. 2021, Fig. 18)."""
LAST = 0.2
"""Part of a run of given duration, at its end, whose means are the run's figures; else the last row's are."""
APART = 5e-3
"""Simulated time between the rows that must agree in a steady flow [s]."""


class FluidSimulation(Spine):
    """A flow; parameters and errors are those of :class:`warpcrete.spine.Spine`. A solve that does not converge raises
    :class:`ConvergenceError`.
    """

    scene: FluidScene

    def _set_up(self) -> None:
        if not isinstance(self.scene, FluidScene):
            refuse("scene", type(self.scene).__name__, "is no flow", "discrete elements take a Simulation")
        self.steady = False
        self._rows: list[dict[str, float]] = []

    @property
    def rows(self) -> list[dict[str, float]]:
        """Rows of the series so far."""
        return self._rows

    @property
    def duration(self) -> float:
        """Simulated time of the whole run, at most [s]."""
        return LONGEST if self.scene.duration is None else self.scene.duration

    def prepare(self) -> None:
        """Place the particles."""
        started = wall_clock.perf_counter()
        self._tell("packing", 0.0)
        self.flow = MovingParticles(FluidState(self.scene, self.device, self.precision), threads=self.threads)
        self.stepper = self.flow
        self._tell("packing", 1.0)
        self._spent["packing"] = wall_clock.perf_counter() - started

    @property
    def state(self) -> FluidState:
        """The particles."""
        return self.flow.state

    def resume(self, path: Path) -> None:
        """Go on from a checkpoint of the same scene, device and precision, in place of `prepare`."""
        arrays, numbers, memory = checkpoint.read(path, self.scene, self.device, self.precision)
        self.prepare()
        self.flow.restore(arrays, numbers)
        self._resumed = memory
        self._rows = [dict(zip(memory["columns"], map(float, row))) for row in memory["rows"]]
        self._recall_clocks(memory)

    def save(self, path: Path) -> None:
        """Write a checkpoint of the state as it is now, recorders included."""
        arrays, numbers = self.flow.memory()
        memory = self._clocks() | {
            "columns": list(self._rows[0]) if self._rows else [],
            "rows": np.array([list(row.values()) for row in self._rows]),
        }
        checkpoint.write(path, self.scene, self.device, self.precision, arrays, numbers, memory)

    def run(self) -> Run:
        """Prepare and run: to the end of the duration, or until steady, or until `stop_requested` or Ctrl-C."""
        if self._ran:
            raise WarpcreteError("this simulation has run; make a new FluidSimulation for another run")
        if not hasattr(self, "flow"):
            self.prepare()
        return to_end(self.running())

    def _sample(self) -> dict[str, float]:
        row = figures(self.flow, self._rows[-1] if self._rows else None)
        self._rows.append(row)
        for recorder in self.recorders:
            recorder.sample(self, row)
        return row

    def _enough(self) -> bool:
        now, share = self._rows[-1], self.scene.steadiness
        earlier = []
        for wanted in (now["time"] - APART, now["time"] - 2 * APART):
            # The first row holds no slip layer yet; one agreement may be chance.
            found = [row for row in self._rows[1:] if row["time"] <= wanted + 1e-9]
            if not found:
                return False
            earlier.append(found[-1])
        scale = {name: abs(now[name]) for name in ("pressure", "wall_stress")} | {"slip_velocity": self.scene.velocity}
        self.steady = all(abs(row[name] - now[name]) <= share * size for row in earlier for name, size in scale.items())
        return self.steady and self.scene.duration is None

    def _result(self, finished: bool) -> Run:
        scene, flow, rows = self.scene, self.flow, self._rows
        series = {name: np.array([row[name] for row in rows]) for name in (rows[0] if rows else ())}
        theory = flow.theory
        running = self._spent.get("running", 0.0)
        result: dict[str, Any] = {
            "scene": scene.name,
            "finished": finished,
            "steady": self.steady,
            "simulated_time": quantity(flow.time, "s"),
            "steps": flow.steps,
            "particles": flow.state.count,
            "spacing": quantity(flow.state.layout.spacing, "m"),
            "column_height": quantity(flow.state.layout.height, "m"),
        }
        if flow.state.grains is not None:
            grains = flow.state.grains
            result["aggregates"] = {
                "grains": grains.count,
                "share": float(np.mean(grains.group >= 0)),
                "smallest": quantity(grains.size.min(), "m"),
                "largest": quantity(grains.size.max(), "m"),
            }
        if len(rows) > 1:
            chosen = np.arange(len(rows)) == len(rows) - 1
            if scene.duration is not None:
                chosen = series["time"] >= series["time"][-1] * (1 - LAST)
            for name, wanted in (
                ("pressure", theory.pressure), ("slip_velocity", theory.slip_velocity),
                ("wall_stress", theory.wall_stress),
            ):  # fmt: skip
                mean = float(series[name][chosen].mean())
                result[name] = quantity(mean, unit_of(name))
                result[f"{name}_theory"] = quantity(wanted, unit_of(name))
                # A flow may be all shear: slip is judged by the mean velocity.
                size = scene.velocity if name == "slip_velocity" else wanted
                result[f"{name}_error"] = (mean - wanted) / size
            result["profile_error"] = float(series["profile_deviation"][chosen].mean()) / scene.velocity
            result["volume_error"] = float(series["volume_error"][np.argmax(np.abs(series["volume_error"]))])
            result["force_balance_error"] = float(series["force_balance_error"][chosen].mean())
            result["theory"] = theory.form
            result["profiles"] = [self._profile(share) for share in PROFILES]
            outcomes = {what: float(series[f"{what}_iterations"][1:].mean()) for what in ("viscosity", "pressure")}
            result["iterations"] = outcomes
        result["speed"] = {
            "wall_time": quantity(running, "s"),
            "packing_time": quantity(self._spent.get("packing", 0.0), "s"),
            "steps_per_second": quantity(flow.steps / max(running, 1e-9), "1/s"),
            "particle_steps_per_second": quantity(flow.steps * flow.state.count / max(running, 1e-9), "1/s"),
        }
        result["state_hash"] = arrays_hash(flow.memory()[0])
        result["provenance"] = provenance(self.device, self.precision, scene.seed)
        return Run(scene, series, {name: unit_of(name) for name in series}, result, None, finished)

    def _profile(self, share: float) -> dict[str, Any]:
        height = share * self.flow.state.layout.height
        radius, mean = profile(self.flow, height)
        theory = velocity(self.scene.concrete, self.scene.line, self.flow.theory, np.minimum(radius, self.scene.radius))
        return {
            "height": quantity(height, "m"),
            "radius": {"value": radius.tolist(), "unit": "m"},
            "velocity": {"value": mean.tolist(), "unit": "m/s"},
            "theory": {"value": theory.tolist(), "unit": "m/s"},
        }

    def release(self) -> None:
        """Let go of the device's memory; the run's results stay."""
        del self.flow, self.stepper
