"""Recording for the Rerun viewer: to a file, to a viewer, or both."""

from __future__ import annotations

import subprocess
import sys
import uuid
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from .drawing import body_values, colour_limit, colours, view, wall_mesh, wall_pose
from .errors import RunFolderError, one_of, refuse
from .simulation import Simulation
from .spine import Recorder, Run

FLUSH_TIME = 10.0  # [s] that a live viewer gets to take the rest
WALL_COLOURS = {"pipe": (150, 165, 180, 22), "piston": (190, 110, 60, 255)}


class RerunRecorder(Recorder):
    """Aggregates (every clump drawn by its own spheres), moving walls, pressure and energies on one timeline.

    Parameters: `path` of the .rrd file or None; `live` True to open a viewer, or the URL of a running one
    (`rerun+http://127.0.0.1:9876/proxy`); `colouring` `speed`, `size` or `force`; `network` also draws the
    touching pairs (grey) and the bonds (orange).

    Every checkpoint closes a part of the recording, `run.rrd`, `run-0001.rrd` and so on, so that a run that is
    resumed goes on after a whole part. At the end they become one file.
    """

    COLOURINGS = ("speed", "size", "force")

    def __init__(
        self, path: Path | None, *, live: bool | str = False, colouring: str = "speed", network: bool = False
    ) -> None:
        one_of("colour", colouring, self.COLOURINGS)
        self.path, self.live, self.colouring, self.network = path, live, colouring, network
        self._recording: Any = None
        import rerun as rr

        self._rr = rr
        if isinstance(live, str):
            try:
                rr.GrpcSink(live)
            except (RuntimeError, ValueError) as error:
                refuse("live", live, f"is no viewer's URL ({error})", "for example rerun+http://127.0.0.1:9876/proxy")

    def start(self, simulation: Simulation) -> None:
        """Open the sinks, send the blueprint and everything that does not change."""
        self._open(simulation, str(uuid.uuid4()), 0, self._blueprint(simulation))
        self._describe(simulation)

    def _describe(self, simulation: Simulation) -> None:
        """Everything that does not change."""
        rr, recording = self._rr, self._recording
        recording.log("scene", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        state = simulation.state
        radius = state.sphere_position.numpy()[np.argsort(state.sphere_id.numpy()), 3]
        recording.log("scene/aggregates", rr.Points3D.from_fields(radii=radius), static=True)
        for number, wall in enumerate(simulation.model.walls):
            mesh = wall_mesh(wall)
            if mesh is None:
                continue
            colour = WALL_COLOURS.get(wall.name, (150, 165, 180, 120))
            recording.log(
                f"scene/walls/{wall.name}",
                rr.Mesh3D(vertex_positions=mesh[0], triangle_indices=mesh[1], albedo_factor=colour),
                static=True,
            )
            if wall.motion is None:
                self._log_pose(simulation, number, static=True)
        recording.log(
            "pressure/piston", rr.SeriesLines(names="piston pressure [kPa]", colors=[215, 95, 30]), static=True
        )
        names = {"kinetic_energy": "kinetic [J]", "elastic_energy": "elastic [J]", "bond_energy": "bonds [J]"}
        for column, name in names.items():
            recording.log(f"energy/{column}", rr.SeriesLines(names=name), static=True)

    def resume(self, simulation: Simulation, memory: dict[str, Any]) -> None:
        """Drop the parts after the checkpoint and open the next."""
        if self.path is not None:
            for number in range(memory["parts"]):
                if not self._part(number).is_file():
                    raise RunFolderError(f"'{self._part(number)}': is missing; the run cannot be resumed")
            for path in self._later_parts(memory["parts"]):
                path.unlink()
        self._open(
            simulation, memory["recording_id"], memory["parts"], self._blueprint(simulation) if self.live else None
        )
        if self.live:
            self._describe(simulation)

    def checkpoint(self, simulation: Simulation) -> dict[str, Any]:
        """Close the part and open the next."""
        if self.path is not None:
            self._flush()
            self._parts += 1
            self._recording.set_sinks(*self._sinks())
        return {"recording_id": self._id, "parts": self._parts}

    def _open(self, simulation: Simulation, recording_id: str, part: int, blueprint) -> None:
        rr = self._rr
        self._recording = rr.RecordingStream("warpcrete", recording_id=recording_id)
        self._id, self._parts = recording_id, part
        self._upper = self._limit(simulation)
        if self.live is True:
            rr.spawn(connect=False, recording=self._recording)
        self._recording.set_sinks(*self._sinks(), default_blueprint=blueprint)

    def _limit(self, simulation: Simulation) -> float:
        """Value at the top of the colour scale."""
        return colour_limit(simulation, self.colouring)

    def _flush(self) -> None:
        try:
            self._recording.flush(timeout_sec=FLUSH_TIME if self.live else 1e9)
        except (RuntimeError, ValueError) as error:
            # A viewer that is not there must not hold up the run; the file has everything.
            taker = "viewer" if self.live else f"file {self.path}"
            warnings.warn(f"the Rerun {taker} did not take the whole recording: {error}", stacklevel=2)
            self.live = False

    def _sinks(self) -> list[Any]:
        rr = self._rr
        sinks: list[Any] = []
        if self.path is not None:
            sinks.append(rr.FileSink(str(self._part(self._parts))))
        if self.live:
            sinks.append(rr.GrpcSink() if self.live is True else rr.GrpcSink(str(self.live)))
        return sinks

    def _part(self, number: int) -> Path:
        assert self.path is not None
        return self.path if number == 0 else self.path.with_name(f"{self.path.stem}-{number:04d}{self.path.suffix}")

    def _later_parts(self, first: int) -> list[Path]:
        assert self.path is not None
        numbered = self.path.parent.glob(f"{self.path.stem}-[0-9][0-9][0-9][0-9]*{self.path.suffix}")
        later = [path for path in numbered if int(path.stem[len(self.path.stem) + 1 :]) >= first]
        return ([self.path] if first == 0 else []) + later

    def _join(self) -> None:
        """One file of all parts, by Rerun's own tool."""
        assert self.path is not None
        parts = [self._part(number) for number in range(self._parts + 1)]
        partial = self.path.with_name("partial-" + self.path.name)
        command = [sys.executable, "-m", "rerun", "rrd", "merge", *map(str, parts), "-o", str(partial)]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode != 0 or not partial.is_file():
            last = (done.stderr.strip().splitlines() or ["no message"])[-1]
            warnings.warn(f"the parts of {self.path} stay apart, joining them failed: {last}", stacklevel=2)
            return
        partial.replace(self.path)
        for path in parts[1:]:
            path.unlink()

    def sample(self, simulation: Simulation, row: dict[str, float]) -> None:
        """Scalars of one row."""
        rr, recording = self._rr, self._recording
        self._set_time(simulation)
        if "pressure" in row:
            recording.log("pressure/piston", rr.Scalars(row["pressure"] / 1e3))
        for column in ("kinetic_energy", "elastic_energy", "bond_energy"):
            recording.log(f"energy/{column}", rr.Scalars(row[column]))

    def frame(self, simulation: Simulation) -> None:
        """Aggregates, moving walls and, if asked for, the contact network."""
        rr, recording, state = self._rr, self._recording, simulation.state
        self._set_time(simulation)
        order = np.argsort(state.sphere_id.numpy())
        body = state.body_id.numpy()[state.sphere_body.numpy()[order]]
        tint = colours(body_values(simulation, self.colouring), self._upper)[body]
        position = state.sphere_position.numpy()[order, :3]
        recording.log("scene/aggregates", rr.Points3D.from_fields(positions=position, colors=tint))
        for number, wall in enumerate(simulation.model.walls):
            if wall.motion is not None and wall_mesh(wall) is not None:
                self._log_pose(simulation, number)
        if self.network:
            self._log_network(simulation)

    def finish(self, simulation: Simulation, run: Run) -> None:
        """Flush and close."""
        if self._recording is not None:
            self._flush()
            self._recording.disconnect()

    def tidy(self, simulation: Simulation, run: Run) -> None:
        """Make one file of the parts."""
        if self.path is not None and self._parts > 0:
            self._join()

    def _set_time(self, simulation: Simulation) -> None:
        self._recording.set_time("time", duration=simulation.stepper.time)
        self._recording.set_time("step", sequence=simulation.stepper.steps)

    def _log_pose(self, simulation: Simulation, number: int, static: bool = False) -> None:
        rr = self._rr
        position, orientation = wall_pose(simulation, number)
        self._recording.log(
            f"scene/walls/{simulation.model.walls[number].name}",
            rr.Transform3D(translation=position, quaternion=rr.Quaternion(xyzw=orientation)),
            static=static,
        )

    def _log_network(self, simulation: Simulation) -> None:
        from .probes import listed_pairs

        rr, state = self._rr, simulation.state
        i, j, place = listed_pairs(state)
        position = state.sphere_position.numpy()
        reach = position[i, 3] + position[j, 3]
        touching = np.linalg.norm(position[i, :3] - position[j, :3], axis=1) < reach
        bonded = np.zeros_like(touching)
        if simulation.model.features.bonds:
            bonded = state.pair_bond.numpy()[place] > 0
        for name, chosen, colour in (
            ("contacts", touching & ~bonded, (130, 130, 130)),
            ("bonds", bonded, (230, 140, 30)),
        ):
            lines = np.stack([position[i[chosen], :3], position[j[chosen], :3]], axis=1)
            self._recording.log(f"scene/network/{name}", rr.LineStrips3D(lines, colors=[colour], radii=4e-4))

    def _blueprint(self, simulation: Simulation):
        import rerun.blueprint as rrb

        eye, target = view(simulation, 1.2)
        scene = rrb.Spatial3DView(
            name=f"Aggregates by {self.colouring}",
            origin="scene",
            eye_controls=rrb.EyeControls3D(position=eye, look_target=target, eye_up=(0, 0, 1)),
            line_grid=rrb.LineGrid3D(visible=False),
            background=(250, 250, 250),
        )
        plots = rrb.Vertical(
            rrb.TimeSeriesView(name="Pressure on the piston", origin="pressure"),
            rrb.TimeSeriesView(name="Energy", origin="energy"),
        )
        return rrb.Blueprint(rrb.Horizontal(scene, plots, column_shares=[2, 1]), collapse_panels=True)
