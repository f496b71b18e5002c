"""Discrete elements from a scene to a finished run. Read this file first, then `spine.py`, which it continues.

simulation = Simulation(scenes.pipe(unit="vertical"))
run = simulation.run()
run.series["pressure"]
"""

from __future__ import annotations

import time as wall_clock
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from . import checkpoint
from .errors import WarpcreteError, refuse
from .kernels.wall_motion import FIXED, PRESCRIBED
from .memory import check_memory
from .model import build_model
from .packing import PackingReport, pack
from .probes import body_sums, contact_sums
from .provenance import provenance, state_hash
from .scene import Scene
from .series import STORED, Sampler, energy_balance, momentum_balance, pressure_figures, quantity, unit_of
from .spine import Run, Spine
from .state import BodyTable, State, placed_bodies
from .stepper import Course, Stepper, drive_one
from .watch import Watch

QUIET = 1e-5  # kinetic over elastic energy at which a state counts as settled


class Simulation(Spine):
    """Discrete elements; parameters and errors are those of :class:`warpcrete.spine.Spine`."""

    scene: Scene

    def _set_up(self) -> None:
        if not isinstance(self.scene, Scene):
            kind = type(self.scene).__name__
            refuse("scene", kind, "is no scene of discrete elements", "flows take a FluidSimulation")
        self.model = build_model(self.scene, self.device, self.precision)
        self.packing: PackingReport | None = None

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
        self._recall_clocks(memory)
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
                **self._clocks(),
                "stepper": self.stepper.memory(),
                "sampler": self.sampler.memory(),
                "watch": {"least": self.watch.least, "scale": self.watch.scale},
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
