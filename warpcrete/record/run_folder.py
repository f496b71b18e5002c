"""Recorder of the run folder: scene.json, series.csv and result.json."""

import csv
import json
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal, TextIO

from ..core.errors import RunFolderError
from ..core.inputs.by_name import trust_option
from ..core.inputs.origin import Arguments, changed_fields, readable
from ..core.records import Record, SavedState
from ..core.run.ending import Ending
from ..core.run.files import atomic_file, cannot_write, read_json, write_json
from ..core.run.folders import FolderLock, make_folder
from ..core.run.provenance import provenance
from ..core.run.recorder import Recorder
from ..core.run.run import Run
from ..core.run.simulation_base import SimulationBase
from ..core.run.tables import Table
from .loading import is_finished

SAME_RUN = ("scene", "parameters", "files", "device", "precision", "command")
"""Entries of scene.json that must be equal in an existing folder and in the simulation that continues its run."""


def scene_record(simulation: SimulationBase, command: Record | None = None) -> Record:
    """Return the contents of scene.json: the name and arguments of the scene function, and the settings of the run.

    `command` holds settings that are stored for a resumed run. If the scene was modified after its function had built
    it, or was built by hand, the fields that the function would build differently are stored under `modified`. The run
    cannot be repeated from such a scene.json.
    """
    scene = simulation.scene
    arguments = scene.parameters if isinstance(scene.parameters, Arguments) else Arguments()
    changed = changed_fields(scene)
    return {
        "scene": arguments.function or scene.name,
        "parameters": dict(arguments),
        **({"modified": {name: readable(getattr(scene, name)) for name in changed}} if changed else {}),
        "files": dict(arguments.files),
        "device": str(simulation.device),
        "precision": simulation.precision,
        "command": command or {},
        "provenance": provenance(simulation.device, simulation.precision, scene.seed, simulation.threads),
    }


class TableRecorder(Recorder):
    """Recorder that creates the run folder and writes the tables into it.

    The recorder writes scene.json at the start, appends rows to series.csv, and writes result.json at checkpoints and
    at the end. Every row is flushed at once, so that an interrupted or killed run keeps all its samples. `command`
    holds settings that are stored in scene.json for a resumed run. If `going_on` is true, the folder must belong to the
    same run, which was interrupted. If `again` is true, the scene.json of an existing folder must describe exactly this
    run.
    """

    def __init__(
        self, folder: Path, command: Record | None = None, *, going_on: bool = False, again: bool = False
    ) -> None:
        self.folder, self.command, self.going_on, self.again = folder, command, going_on, again
        self._folder_hold: FolderLock | None = None
        self._is_new = False  # True if this recorder created the folder.
        self._file: TextIO | None = None
        self._writer: Any = None

    @property
    def _series(self) -> Path:
        return self.folder / "series.csv"

    def claim(self, simulation: SimulationBase) -> None:
        """Create the run folder with scene.json, or reuse the folder of an interrupted run, and lock the folder."""
        if self._folder_hold is not None:
            return
        record = scene_record(simulation, self.command)
        path = self.folder / "scene.json"
        if (self.going_on or simulation.resumes) and path.is_file():
            self._folder_hold = FolderLock(self.folder)
            # Check only after locking the folder: another process may have finished the run in the meantime.
            if is_finished(self.folder):
                raise RunFolderError(
                    f"out = '{self.folder}': exists already and contains a finished run; choose a new folder (runs are "
                    "never overwritten), or read this run with warpcrete.load"
                )
            if self.again and path.is_file():
                _check_same_run(path, record)
            if simulation.resumes or (self.folder / "checkpoint.npz").is_file():
                return
        else:
            self._folder_hold = make_folder(self.folder)
            self._is_new = True
        write_json(path, record)

    def abandon(self, simulation: SimulationBase) -> None:
        """Release the folder, and remove it if this recorder created it.

        The folder is kept if it has a checkpoint, or if the run became unstable before its first row. The file
        result.json then says why the run ended.
        """
        has_checkpoint = (self.folder / "checkpoint.npz").exists()
        ending = simulation.ending
        if (
            self._folder_hold is not None
            and self._is_new
            and not has_checkpoint
            and (ending is None or ending.reason not in ("unstable", "unconverged"))
        ):
            with suppress(OSError):
                (self.folder / "scene.json").unlink(missing_ok=True)
            self._folder_hold.remove()
        elif self._folder_hold is not None and ending is not None:
            with suppress(OSError, RunFolderError):
                self._write_early_end(simulation, ending)
        self.close(simulation)

    def _write_early_end(self, simulation: SimulationBase, ending: Ending) -> None:
        """Write the result.json of a run that ended before its first row of the time series, with the reason `ending`.

        If the folder already has a result.json with results, keep that file.
        """
        path = self.folder / "result.json"
        if path.is_file() and "steps" in read_json(path):
            return
        scene = simulation.scene
        write_json(path, {
            "scene": scene.name,
            "finished": False,
            "ended": ending.entry(),
            "provenance": provenance(simulation.device, simulation.precision, scene.seed, simulation.threads),
        })  # fmt: skip

    def start(self, simulation: SimulationBase) -> None:
        """Open series.csv in the folder created by `claim`."""
        self.claim(simulation)
        self._file = self._opened("w")

    def _opened(self, mode: Literal["w", "a"]) -> TextIO:
        try:
            return self._series.open(mode, newline="", encoding="utf-8")
        except OSError as error:
            raise cannot_write(self._series, error) from error

    def resume(self, simulation: SimulationBase, state: SavedState) -> None:
        """Rewrite series.csv with the rows up to the checkpoint, and open the file for further rows."""
        self.claim(simulation)
        with atomic_file(self._series) as partial:
            self._file = partial.open("w", newline="", encoding="utf-8")
            for row in simulation.rows:
                self._write(simulation, row)
            self._file.close()
        self._file = self._opened("a")
        if self._writer is not None:
            self._writer = csv.writer(self._file)

    def sample(self, simulation: SimulationBase, row: dict[str, float]) -> None:
        """Append the sampled values to series.csv as a new row.

        The header of the file states the unit of each column.
        """
        assert self._file is not None
        try:
            self._write(simulation, row)
            self._file.flush()
        except OSError as error:
            raise cannot_write(self._series, error) from error

    def _write(self, simulation: SimulationBase, row: dict[str, float]) -> None:
        if self._writer is None:
            self._writer = csv.writer(self._file)
            self._writer.writerow([f"{name} [{simulation.unit(name)}]" for name in row])
        self._writer.writerow([f"{value:.9g}" for value in row.values()])

    def write(self, simulation: SimulationBase) -> None:
        """Write result.json of an unfinished run; the rows of series.csv are already on disk."""
        result = simulation.result(False).result
        if simulation.ending is not None:
            result["ended"] = simulation.ending.entry()
        write_json(self.folder / "result.json", result)

    def finish(self, simulation: SimulationBase, run: Run) -> None:
        """Write result.json and the tables, and close series.csv."""
        if self._file is None:
            return
        run.folder = self.folder
        try:
            write_json(self.folder / "result.json", run.result)
        finally:
            try:
                self._file.close()
            except OSError as error:
                raise cannot_write(self._series, error) from error
        for name, table in run.tables.items():
            _write_table(self.folder / f"{name}.csv", table)

    def close(self, simulation: SimulationBase) -> None:
        if self._folder_hold is not None:
            self._folder_hold.release()
            self._folder_hold = None


def _check_same_run(path: Path, record: Record) -> None:
    """Raise :class:`RunFolderError` unless the scene.json at `path` describes the same run as `record`."""
    there, here = read_json(path), json.loads(json.dumps(record))
    difference = _difference({name: there.get(name) for name in SAME_RUN}, {name: here[name] for name in SAME_RUN})
    if difference:
        raise RunFolderError(
            f"out = '{path.parent}': exists already and contains another run ({difference}); choose a new "
            f"folder, or continue the other run with 'warpcrete {trust_option(there)}run --resume {path.parent}'"
        )


def _difference(there: Mapping[str, Any], here: Mapping[str, Any]) -> str:
    """Return a text on the first entry that differs between two records, with both values; empty if the records agree.

    `there` is the saved record, and `here` is the record of the present run. A difference in the time between
    checkpoints is ignored, because this time has no effect on results.
    """
    for name in dict.fromkeys([*there, *here]):
        old, new = there.get(name), here.get(name)
        if old == new or name == "checkpoint_every":
            continue
        if name == "files":
            before, after = old or {}, new or {}
            changed = [file for file in dict.fromkeys([*before, *after]) if before.get(file) != after.get(file)]
            if not changed:  # A missing entry for files means the same as an empty one.
                continue
            return f"its file '{changed[0]}' differs"
        if not isinstance(old, dict) or not isinstance(new, dict):
            return f"its {name} is {json.dumps(old)} instead of {json.dumps(new)}"
        if difference := _difference(old, new):
            return difference
    return ""


def _write_table(path: Path, table: Table) -> None:
    """Write a table in the format of series.csv."""
    with atomic_file(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow([f"{name} [{table.units[name]}]" for name in table.columns])
        writer.writerows([[f"{value:.9g}" for value in row] for row in zip(*table.columns.values(), strict=True)])
