"""Functions that read saved runs from their run folders."""

import csv
import importlib
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NoReturn

import numpy as np

from ..core.errors import RunFolderError, SceneError
from ..core.inputs.by_name import names_from_file
from ..core.inputs.origin import changed_files, check_files
from ..core.inputs.text_files import saved_text
from ..core.records import Record
from ..core.run.files import read_json, read_record
from ..core.run.output import RunOutput
from ..core.run.run import Run
from ..core.run.scene_module import SceneModule
from ..core.run.tables import Table
from ..scenes import modules

TABLES = ("stations",)
"""Names, without suffix, of further table files that a run folder may hold in addition to series.csv."""
DRAWN = ("scene.usdc", "aggregates.vtkhdf", "bodies.vtkhdf", "run.rrd")
"""Names of the files of a run folder that may hold positions of bodies over time."""


class LoadedRun(Run):
    """Run that was read from a run folder."""

    def save(self, folder: str | Path | RunOutput) -> Path:
        """Copy the run folder, with the recordings that it has, and return the path of the copy."""
        importlib.import_module("warpcrete.record.output")  # This module registers the class of run folders.
        return super().save(folder)

    def __getattr__(self, name: str) -> NoReturn:
        if name != "bodies" or self.result.get("method") not in ("dem", "suspension"):
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        files = [str(path) for path in map(Path(self.folder or "").joinpath, DRAWN) if path.is_file()]
        there = (
            f"their recorded frames are in {' and '.join(files)}" if files else "the folder has no recording of them"
        )
        raise AttributeError(
            f"bodies: a run that was read from a folder has no table of final bodies; {there}; run the scene again "
            "with warpcrete.Simulation(scene).run(), which returns a run with bodies"
        )


def load(folder: Path | str) -> Run:
    """Return the run that a folder contains: its scene, time series and results, if their files have been written.

    Data that exists only during a simulation, such as the table of final `bodies`, is missing. The message of the error
    that `run.bodies` raises names the recordings in the folder that hold the positions of bodies. A killed run may have
    no result, and a run without samples has an empty series. The scene function builds the scene again. The scene
    cannot be built again if it was modified or built in Python, or if a file that it read is missing or has changed.
    The returned scene then has only its name, which is also its caption, and its parameters. Raises
    :class:`RunFolderError` if the folder is not a run folder of this version.
    """
    folder = Path(folder)
    if not (folder / "scene.json").is_file():
        studies = sorted(
            str(path.parent.relative_to(folder))
            for path in [*folder.glob("*/scene.json"), *folder.glob("parts/*/scene.json")]
        )
        raise RunFolderError(
            f"'{folder}': "
            + _not_a_run(folder)
            + (f"; its runs are in {', '.join(studies[:3])}{' ...' * (len(studies) > 3)}" if studies else "")
        )
    record = read_record(folder / "scene.json")
    scene: Any = SimpleNamespace(
        name=record.get("scene"), caption=record.get("scene"), parameters=record.get("parameters")
    )
    if "modified" in record:
        scene.modified = record["modified"]
    else:
        with suppress(SceneError):
            record, module = saved_scene(folder / "scene.json", modules())
            scene_again = module.scene(**record["parameters"])
            scene = scene if changed_files(record.get("files", {})) else scene_again
    path = folder / "result.json"
    result = read_json(path) if path.is_file() else {}
    series, units = _series(folder / "series.csv")
    tables = {name: Table(*_series(folder / f"{name}.csv")) for name in TABLES if (folder / f"{name}.csv").is_file()}
    return LoadedRun(scene, series, units, result, bool(result.get("finished")), folder=folder, tables=tables)


def _not_a_run(folder: Path) -> str:
    if folder.is_dir():
        return "is not the folder of a run (it contains no scene.json)"
    return f"is a file; give its folder '{folder.parent}'" if folder.exists() else "does not exist"


def is_finished(folder: Path) -> bool:
    """Return whether a run folder is complete: its run reached the end, and all its files are written."""
    result = folder / "result.json"
    return result.is_file() and not (folder / "checkpoint.npz").is_file() and bool(read_json(result).get("finished"))


@names_from_file()
def saved_scene(path: Path, known: Mapping[str, SceneModule]) -> tuple[Record, Any]:
    """Return the contents of a run folder's scene.json, and the Python module of the scene that the file names.

    `known` maps the names of all scenes to their modules. Raises :class:`RunFolderError` if it lacks the scene, or if
    the scene does not have a parameter in the file.
    """
    record = read_record(path)
    if record.get("scene") not in list(known) or not isinstance(record.get("parameters"), dict):
        raise RunFolderError(
            f"'{path}': names no scene of this version, which has {', '.join(known)}; read the file "
            "with the version that wrote it"
        )
    module = known[record["scene"]]
    parameters = module.scene.resolved(record["parameters"])
    unknown = sorted(set(parameters) - set(module.scene.fields(parameters)))
    if unknown:
        raise RunFolderError(
            f"'{path}': has parameters that the scene {record['scene']} does not have: {', '.join(unknown)}; remove or "
            "correct them"
        )
    return record, module


def repeatable_scene(path: Path, known: Mapping[str, SceneModule]) -> tuple[Record, Any]:
    """Return the contents of scene.json and the Python module of the scene, for a run that is repeated or continued.

    Raises :class:`RunFolderError` if the scene was modified after its function had built it, if it was built by hand,
    or if files that it reads have changed.
    """
    record = read_record(path)
    _check_unchanged(path, record)
    # Check the scene's input files first, because reading the scene may import one of the files as a Python module.
    check_files(path, record.get("files", {}))
    return saved_scene(path, known)


def _check_unchanged(path: Path, record: Mapping[str, object]) -> None:
    changed = record.get("modified")
    if not changed:
        return
    if not record.get("parameters"):
        raise RunFolderError(
            f"'{path}': its scene was built in Python, not with a scene function; repeat or resume the run in Python"
        )
    raise RunFolderError(
        f"'{path}': the scene was changed in Python ({', '.join(changed)}) after a function such as "
        "scenes.pipe() had built it, so the parameters in this file do not describe it; repeat or "
        "resume the run in Python"
    )


def _series(path: Path) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Return the columns of a table and their units; drop the last row if a killed run left it incomplete."""
    if not path.is_file():
        return {}, {}
    try:
        text = saved_text(path)
        lines = list(csv.reader(text.splitlines() if text.endswith("\n") else text.splitlines()[:-1]))
        if not lines:
            return {}, {}
        if any(len(line) != len(lines[0]) for line in lines):
            raise ValueError("it has rows of different lengths")
        named = [head.removesuffix("]").rsplit(" [", 1) for head in lines[0]]
        rows = np.array(lines[1:], dtype=float).reshape(-1, len(named))
        units = {name: unit for name, unit in named}
    except (ValueError, csv.Error) as error:
        raise RunFolderError(f"'{path}': is not the table of a run's samples ({error}); restore the file") from None
    return {name: rows[:, place] for place, name in enumerate(units)}, units
