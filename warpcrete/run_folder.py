"""The folder that a run fills: scene.json, series.csv, result.json, pressure.png, run.rrd, scene.usdc."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any, TextIO

from .errors import RunFolderError
from .simulation import Run, Simulation, scene_record, unit_of, write_json


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


class TableRecorder:
    """Makes the folder; writes scene.json at the start, series.csv row by row, result.json at the end.

    Rows are flushed as they come, so an interrupted or killed run keeps all that it sampled.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._file: TextIO | None = None

    def start(self, simulation: Simulation) -> None:
        """Create the folder and scene.json."""
        check_new(self.folder)
        record = scene_record(simulation)
        try:
            self.folder.mkdir(parents=True)
        except OSError as error:
            raise RunFolderError(f"out = '{self.folder}': cannot be created ({error.strerror})") from error
        write_json(self.folder / "scene.json", record)
        self._file = (self.folder / "series.csv").open("w", newline="")
        self._writer: Any = None

    def sample(self, simulation: Simulation, row: dict[str, float]) -> None:
        """Append a row; the header names each column's unit."""
        if self._file is None:
            return
        if self._writer is None:
            self._writer = csv.writer(self._file)
            self._writer.writerow([f"{name} [{unit_of(name)}]" for name in row])
        self._writer.writerow([f"{value:.9g}" for value in row.values()])
        self._file.flush()

    def frame(self, simulation: Simulation) -> None:
        """Nothing: frames go to the pictures."""

    def finish(self, simulation: Simulation, run: Run) -> None:
        """Close series.csv and write result.json."""
        if self._file is None:
            return
        self._file.close()
        run.folder = self.folder
        write_json(self.folder / "result.json", run.result)
