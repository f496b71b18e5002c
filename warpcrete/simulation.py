"""The spine: from a scene to a finished run. Read this file first.

simulation = Simulation(scenes.pipe(unit="vertical"))
run = simulation.run()
run.series["pressure"]
"""

from __future__ import annotations

import math
import os
import time as wall_clock
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from . import checkpoint
from .batch import default_threads
from .errors import WarpcreteError, between, positive, refuse
from .kernels.wall_motion import FIXED, PRESCRIBED
from .memory import check_memory
from .model import build_model, find_device
from .packing import PackingReport, pack
from .probes import body_sums, contact_sums
from .progress import ProgressBar
from .provenance import provenance, state_hash
from .scene import Scene
from .series import STORED, Sampler, energy_balance, momentum_balance, pressure_figures, quantity, unit_of
from .state import BodyTable, State, placed_bodies
from .stepper import Course, Stepper, drive_one
from .watch import Watch

Progress = Callable[[str, float, dict[str, Any]], None]
"""Called with the phase (`packing`, `settling`, `running`), the share done and a few current figures."""

QUIET = 1e-5  # kinetic over elastic energy at which a state counts as settled


class Recorder:
    """Where a run goes; subclasses override what they need.

    Methods are called in this order; `finish` also after an interruption or an error.
    """

    def start(self, simulation: Simulation) -> None:
        """The run is about to begin."""

    def resume(self, simulation: Simulation, memory: dict[str, Any]) -> None:
        """Instead of `start`, when a run goes on from the checkpoint at which `checkpoint` returned `memory`.

        Whatever was recorded after it must go.
        """
        self.start(simulation)

    def sample(self, simulation: Simulation, row: dict[str, float]) -> None:
        """A row of the series."""

    def frame(self, simulation: Simulation) -> None:
        """A picture is due."""

    def checkpoint(self, simulation: Simulation) -> dict[str, Any]:
        """Put on disk what is there so far; returns what `resume` will need."""
        return {}

    def finish(self, simulation: Simulation, run: Run) -> None:
        """The run has ended: put everything on disk. The last recorder finishes first."""

    def tidy(self, simulation: Simulation, run: Run) -> None:
        """The run is complete and its checkpoint gone: what only a resumed run needs may go."""


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
    interrupted: bool = False
    """Cut at once by an interruption (Ctrl-C), not at a sample."""
    folder: Path | None = None
    bodies: BodyTable = field(default_factory=BodyTable.empty)
    """Bodies at the end."""


class Simulation:
    """A scene on a device, with recorders.

    Parameters: `scene`; `device` as Warp names it, None for a GPU if there is one, else the CPU; `precision`
    `float32` or `float64`, None for the scene's own; `threads` on a CPU, None for all its cores (a run is the same to
    the bit for a given number of them); `recorders`; `frame_interval` simulated seconds between two
    recorded frames;
    `progress` True for a bar, or a callback; `checkpoint_path` of a file that is written at the start, then every
    `checkpoint_every` seconds of wall time (0: at every sample) and at an interruption, and removed at the end.
    Recorders of a run with checkpoints are of different classes, by which a resumed run knows them. Raises
    :class:`SceneError`, :class:`DeviceError`; a run may raise :class:`InstabilityError`.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        device: str | None = None,
        precision: str | None = None,
        threads: int | None = None,
        recorders: Sequence[Recorder] = (),
        frame_interval: float = 0.04,
        progress: Progress | bool = False,
        checkpoint_path: Path | None = None,
        checkpoint_every: float = 60.0,
    ) -> None:
        positive("frame_interval", frame_interval, "s")
        between("checkpoint_every", checkpoint_every, 0, math.inf, "s")
        self.scene = scene
        self.device = find_device(device)
        self.precision = precision or scene.precision
        self.threads = default_threads() if threads is None else threads
        cores = os.cpu_count() or 1
        if not 1 <= self.threads <= cores:
            refuse("threads", threads, f"must be in [1, {cores}], the cores of this machine")
        self.model = build_model(scene, self.device, self.precision)
        self.recorders = list(recorders)
        self.frame_interval = frame_interval
        self.checkpoint_path, self.checkpoint_every = checkpoint_path, checkpoint_every
        self.packing: PackingReport | None = None
        self.stop_requested = False
        self.finishing = False
        if progress is True:
            progress = ProgressBar()
        self._progress = progress or (lambda phase, share, figures: None)
        self._spent: dict[str, float] = {}
        self._ran = False
        self._ran_before = 0.0  # wall time before the checkpoint that this run goes on from [s]
        self._samples = 0  # rows after the one at t = 0
        self._next_frame = frame_interval
        self._resumed: dict[str, Any] | None = None

    @property
    def rows(self) -> list[dict[str, float]]:
        """Rows of the series so far."""
        return self.sampler.rows

    def prepare(self) -> None:
        """Pack, place, bond groups, settle, bond: everything up to t = 0."""
        scene = self.scene
        started = wall_clock.perf_counter()
        self._tell("packing", 0.0)
        packed = None
        if scene.fill is not None:
            packed = pack(
                scene.fill,
                contact=scene.contact,
                seed=scene.seed,
                device=self.device,
                precision=self.precision,
                progress=lambda share: self._tell("packing", share),
                threads=self.threads,
            )
        self.place(packed, wall_clock.perf_counter() - started)
        self.join(Stepper(self.model, self.state, scene.time_step, threads=self.threads))
        drive_one(self.stepper, self.preparing())

    def place(self, packed: tuple[BodyTable, PackingReport] | None, took: float) -> None:
        """Make the state from what packing returned, which `took` so long [s], and the bodies that the scene places."""
        table = BodyTable.empty()
        if packed is not None:
            table, self.packing = packed
        self._tell("packing", 1.0)
        self._spent["packing"] = took
        table = table.joined(placed_bodies(self.scene))
        check_memory(self.model, table)
        self.state = State(self.model, table)

    def join(self, stepper: Stepper) -> None:
        """Take the stepper that will carry the state, alone or in a batch."""
        self.stepper = stepper
        if self._resumed is None:
            damping = self.scene.settle.local_damping if self.scene.settle else self.scene.local_damping
        else:
            damping = self.scene.local_damping
        stepper.change(local_damping=damping)

    def release(self) -> None:
        """Let go of the device's memory; the run's results stay."""
        self.stepper.batch.states.clear()
        del self.state, self.stepper, self.sampler, self.watch

    def preparing(self) -> Course:
        """Course: from placed bodies to t = 0."""
        scene, model = self.scene, self.model
        first_group_kind = 1 + (scene.bonds is not None) + (scene.hydration is not None)
        for number, (group, bonds) in enumerate(scene.group_bonds.items()):
            self.stepper.bond(bonds, first_group_kind + number, model.groups.index(group))
        self.stepper.choose_dt()  # refuses an unstable fixed step before anything is written

        started = wall_clock.perf_counter()
        if scene.settle and scene.settle.duration > 0:
            yield from self._settling(scene.settle.duration)
            self.stepper.change(local_damping=scene.local_damping)
        self._spent["settling"] = wall_clock.perf_counter() - started
        self.stepper.restart_clock()
        if scene.bonds is not None and scene.bonds.healing:
            # Contacts that healed while settling carry its loads: all of the scene's bonds start anew at t = 0.
            kinds = self.state.pair_bond.numpy()
            self.state.pair_bond.assign(np.where(kinds <= 1, 0, kinds).astype(np.int32))
        self.bond()
        self.stepper.choose_dt()
        self._begin()

    def resume(self, path: Path) -> None:
        """Go on from a checkpoint of the same scene, device and precision, in place of `prepare`.

        The run then holds the same bits as one that was never cut. Raises :class:`RunFolderError` for a file that
        is no whole checkpoint of this simulation.
        """
        memory = self.restore(path)["stepper"]
        self.join(Stepper(self.model, self.state, self.scene.time_step, threads=self.threads, memory=memory))
        self.recall()

    def restore(self, path: Path) -> dict[str, Any]:
        """Load the state of a checkpoint; returns its memory. `join` and `recall` complete a resumption."""
        self.state, self._resumed = checkpoint.load(path, self.model, self.precision)
        return self._resumed

    def recall(self) -> None:
        """Bring sampler, watch and clocks to where they were at the checkpoint."""
        assert self._resumed is not None
        memory = self._resumed
        self._begin()
        self.sampler.recall(memory["sampler"])
        self.watch.least, self.watch.scale = memory["watch"]["least"], memory["watch"]["scale"]
        self._samples, self._next_frame = memory["samples"], memory["next_frame"]
        self._spent = memory["spent"]
        self._ran_before = self._spent["running"]
        if memory["packing"] is not None:
            self.packing = PackingReport(**memory["packing"])

    def _begin(self) -> None:
        self.stepper.running = True
        self.sampler = Sampler(self.model, self.state)
        self.watch = Watch(self.model, self.state)

    def save(self, path: Path) -> None:
        """Write a checkpoint of the state as it is now, recorders included."""
        self.stepper.batch.changed()
        checkpoint.save(
            path,
            self.model,
            self.state,
            self.precision,
            {
                "recorders": {_kind(r): r.checkpoint(self) for r in self.recorders} if self._ran else {},
                "stepper": self.stepper.memory(),
                "sampler": self.sampler.memory(),
                "watch": {"least": self.watch.least, "scale": self.watch.scale},
                "samples": self._samples,
                "next_frame": self._next_frame,
                "spent": self._spent | {"running": self._running()},
                "packing": asdict(self.packing) if self.packing else None,
            },
        )

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
        if self._ran:
            raise WarpcreteError("this simulation has run; make a new Simulation for another run")
        if not hasattr(self, "state"):
            self.prepare()
        return drive_one(self.stepper, self.running())

    def running(self) -> Course:
        """Course: from t = 0, or a checkpoint, to the end; returns the :class:`Run`."""
        self._ran = True
        self._started = wall_clock.perf_counter()
        begun: list[Recorder] = []
        finished = interrupted = False
        try:
            try:
                for recorder in self.recorders:
                    begun.append(recorder)
                    memory = (self._resumed or {}).get("recorders", {}).get(_kind(recorder))
                    if memory is None:
                        recorder.start(self)
                    else:
                        recorder.resume(self, memory)
                finished = yield from self._loop()
            except KeyboardInterrupt:
                interrupted = True
        finally:
            self._spent["running"] = self._running()
            self.finishing = True
            run = self._result(finished)
            run.interrupted = interrupted
            failures = []
            for recorder in reversed(begun):
                try:
                    recorder.finish(self, run)
                except Exception as error:  # one broken output must not cost the others
                    failures.append(error)
            if finished and not failures:
                if self.checkpoint_path is not None:
                    checkpoint.remove(self.checkpoint_path)
                for recorder in begun:
                    recorder.tidy(self, run)
            if isinstance(self._progress, ProgressBar):
                self._progress.close()
        if failures:
            raise failures[0]
        return run

    def _loop(self) -> Course:
        scene, stepper = self.scene, self.stepper
        if not self.rows:
            self._sample()
            for recorder in self.recorders:
                recorder.frame(self)
            self._checkpoint()
        else:
            self._saved = wall_clock.perf_counter()
        samples = max(1, int(np.ceil(scene.duration / scene.sample_interval - 1e-9)))
        for number in range(self._samples + 1, samples + 1):
            if self.stop_requested:
                self._checkpoint()
                return False
            until = min(number * scene.sample_interval, scene.duration)
            yield from stepper.advancing(until)
            self._samples = number
            row = self._sample()
            if stepper.time >= self._next_frame - 1e-9 or number == samples:
                for recorder in self.recorders:
                    recorder.frame(self)
                self._next_frame = self.frame_interval * (np.floor(stepper.time / self.frame_interval + 1e-9) + 1)
            if number < samples and wall_clock.perf_counter() - self._saved >= self.checkpoint_every:
                self._checkpoint()
            self._tell(
                "running",
                number / samples,
                steps_per_s=stepper.steps / max(self._running(), 1e-9),
                **({"pressure": row["pressure"]} if "pressure" in row else {}),
            )
        return True

    def _checkpoint(self) -> None:
        if self.checkpoint_path is not None:
            try:
                self.save(self.checkpoint_path)
            except OSError as error:  # a full disk must not end the run; the checkpoint before is still there
                warnings.warn(f"'{self.checkpoint_path}': no checkpoint was written: {error}", stacklevel=2)
        self._saved = wall_clock.perf_counter()

    def _running(self) -> float:
        return self._ran_before + (wall_clock.perf_counter() - self._started if self._ran else 0.0)

    def _sample(self) -> dict[str, float]:
        row = self.sampler.sample()
        for recorder in self.recorders:
            recorder.sample(self, row)
        self.watch(row)
        return row

    def _settling(self, duration: float) -> Course:
        # Walls that will move stand still: their motion starts with the clock of the run proper.
        walls = self.model.wall_table.numpy().copy()
        still = walls.copy()
        prescribed = still["motion"] == int(PRESCRIBED)
        still["motion"][prescribed] = int(FIXED)
        self.model.wall_table.assign(still)
        parts = 50
        for part in range(parts):
            if self.stop_requested:
                raise KeyboardInterrupt
            yield from self.stepper.advancing(duration * (part + 1) / parts)
            self._tell("settling", (part + 1) / parts)
            kinetic = body_sums(self.model, self.state).kinetic_energy
            if part > 2 and kinetic < QUIET * contact_sums(self.model, self.state).elastic_energy:
                break
        self._tell("settling", 1.0)
        self.model.wall_table.assign(walls)

    def _tell(self, phase: str, share: float, **figures: Any) -> None:
        self._progress(phase, share, figures)

    def _result(self, finished: bool) -> Run:
        series = self.sampler.series()
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
                for name in (*STORED, "wall_work", "drive_work", "dissipated_energy")
                if name in last
            }
            result["coordination_number"] = contacts.coordination_number
            result["largest_overlap"] = float(series["largest_overlap"].max())
            mass = float(self.state.body_mass.numpy().sum(dtype=float))
            result["momentum_balance_error"] = momentum_balance(self.scene, self.model.walls, series, mass)
            if self.model.features.losses:
                result["energy_balance_error"] = energy_balance(series)
        result["speed"] = {
            "wall_time": quantity(running, "s"),
            "packing_time": quantity(self._spent.get("packing", 0.0), "s"),
            "settling_time": quantity(self._spent.get("settling", 0.0), "s"),
            "steps_per_second": quantity(steps / max(running, 1e-9), "1/s"),
            "sphere_steps_per_second": quantity(steps * self.state.sphere_count / max(running, 1e-9), "1/s"),
        }
        result["state_hash"] = state_hash(self.state)
        result["provenance"] = provenance(self.device, self.precision, self.scene.seed)
        return Run(self.scene, series, units, result, self.packing, finished, bodies=self.state.table())


def _kind(recorder: Recorder) -> str:
    return type(recorder).__name__
