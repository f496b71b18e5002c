"""The folder that a run fills: scene.json, series.csv, result.json, pressure.png, run.rrd, scene.usdc."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any, TextIO

from .errors import RunFolderError
from .provenance import provenance, write_json
from .series import unit_of
from .simulation import Simulation
from .spine import Recorder, Run


def check_new(folder: Path) -> None:
    """Refuse a path that exists, or that cannot be made."""
    try:
        there = folder.exists() or folder.is_symlink()
    except OSError as error:
        raise RunFolderError(f"out = '{folder}': cannot be a folder ({error.strerror})") from error
    if there:
        raise RunFolderError(f"out = '{folder}': exists already; choose a new folder (runs are never overwritten)")
    parent = folder.absolute().parent
    while not parent.exists():
        parent = parent.parent
    if not parent.is_dir():
        raise RunFolderError(f"out = '{folder}': '{parent}' is not a folder")


def next_folder(scene_name: str, root: Path = Path("runs")) -> Path:
    """First free `runs/NAME-NNN`."""
    number = 1
    while (root / f"{scene_name}-{number:03d}").exists():
        number += 1
    return root / f"{scene_name}-{number:03d}"


def read_json(path: Path) -> dict[str, Any]:
    """Contents of a JSON file of a run folder."""
    try:
        data = json.loads(path.read_text())
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise RunFolderError(f"'{path}': cannot be read ({type(error).__name__}: {error})") from error
    if not isinstance(data, dict):
        raise RunFolderError(f"'{path}': holds no JSON object")
    return data


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
            raise RunFolderError(f"out = '{self.folder}': cannot be created ({error.strerror})") from error
        write_json(self.folder / "scene.json", record)
        self._file = self._series.open("w", newline="")

    def resume(self, simulation: Simulation, memory: dict[str, Any]) -> None:
        """Write series.csv as it was at the checkpoint, which holds every row."""
        partial = self._series.with_name(self._series.name + ".partial")
        self._file = partial.open("w", newline="")
        for row in simulation.rows:
            self._write(row)
        self._file.close()
        partial.replace(self._series)
        self._file = self._series.open("a", newline="")
        if self._writer is not None:
            self._writer = csv.writer(self._file)

    def sample(self, simulation: Simulation, row: dict[str, float]) -> None:
        """Append a row; the header names each column's unit."""
        assert self._file is not None
        self._write(row)
        self._file.flush()

    def _write(self, row: dict[str, float]) -> None:
        if self._writer is None:
            self._writer = csv.writer(self._file)
            self._writer.writerow([f"{name} [{unit_of(name)}]" for name in row])
        self._writer.writerow([f"{value:.9g}" for value in row.values()])

    def finish(self, simulation: Simulation, run: Run) -> None:
        """Close series.csv and write result.json."""
        if self._file is None:
            return
        self._file.close()
        run.folder = self.folder
        write_json(self.folder / "result.json", run.result)
