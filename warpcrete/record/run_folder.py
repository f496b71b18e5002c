"""The folder that a run fills: scene.json, series.csv, result.json, and what other recorders write."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any, TextIO

from ..core.errors import RunFolderError
from ..core.files import cannot_write, check_new, whole_file, write_json
from ..core.provenance import provenance
from ..core.run import Table
from ..core.run_loop import Recorder, Run, Simulation


def scene_record(simulation: Simulation, command: dict[str, Any] | None = None) -> dict[str, Any]:
    """What scene.json holds: the scene function's name and every argument, and how the run was set up."""
    scene = simulation.scene
    if not scene.parameters:
        raise RunFolderError(f"scene {scene.name!r} has no parameters to save; make it with a scene function")
    return {
        "scene": scene.name,
        "parameters": dict(scene.parameters),
        "device": str(simulation.device),
        "precision": simulation.precision,
        "command": command or {},
        "provenance": provenance(simulation.device, simulation.precision, scene.seed),
    }


class TableRecorder(Recorder):
    """Makes the folder; writes scene.json at the start, series.csv row by row, result.json at the end.

    Rows are flushed as they come, so an interrupted or killed run keeps all that it sampled. `command` are settings
    to keep in scene.json for a resumed run.
    """

    rows_alone = True

    def __init__(self, folder: Path, command: dict[str, Any] | None = None) -> None:
        self.folder, self.command = folder, command
        self._file: TextIO | None = None
        self._writer: Any = None

    @property
    def _series(self) -> Path:
        return self.folder / "series.csv"

    def start(self, simulation: Simulation) -> None:
        """Create the folder and scene.json."""
        check_new(self.folder)
        record = scene_record(simulation, self.command)
        try:
            self.folder.mkdir(parents=True)
        except OSError as error:
            raise RunFolderError(f"out = '{self.folder}': cannot be made ({error.strerror})") from error
        write_json(self.folder / "scene.json", record)
        self._file = self._series.open("w", newline="", encoding="utf-8")

    def resume(self, simulation: Simulation, state: dict[str, Any]) -> None:
        """Write series.csv as it was at the checkpoint, which holds every row."""
        with whole_file(self._series) as partial:
            self._file = partial.open("w", newline="", encoding="utf-8")
            for row in simulation.rows:
                self._write(simulation, row)
            self._file.close()
        self._file = self._series.open("a", newline="", encoding="utf-8")
        if self._writer is not None:
            self._writer = csv.writer(self._file)

    def sample(self, simulation: Simulation, row: dict[str, float]) -> None:
        """Append a row; the header names each column's unit."""
        assert self._file is not None
        try:
            self._write(simulation, row)
            self._file.flush()
        except OSError as error:
            raise cannot_write(self._series, error) from error

    def _write(self, simulation: Simulation, row: dict[str, float]) -> None:
        if self._writer is None:
            self._writer = csv.writer(self._file)
            self._writer.writerow([f"{name} [{simulation.unit(name)}]" for name in row])
        self._writer.writerow([f"{value:.9g}" for value in row.values()])

    def finish(self, simulation: Simulation, run: Run) -> None:
        """Close series.csv and write result.json."""
        if self._file is None:
            return
        run.folder = self.folder
        try:
            self._file.close()
        except OSError as error:
            raise cannot_write(self._series, error) from error
        finally:
            write_json(self.folder / "result.json", run.result)
        for name, table in run.tables.items():
            _write_table(self.folder / f"{name}.csv", table)


def _write_table(path: Path, table: Table) -> None:
    """A table as series.csv has its rows."""
    with whole_file(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow([f"{name} [{table.units[name]}]" for name in table.columns])
        writer.writerows([[f"{value:.9g}" for value in row] for row in zip(*table.columns.values(), strict=True)])
