"""Folder of a simulated line: it holds one run for each kind of part, and an interrupted line continues in it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ...core.errors import RunFolderError
from ...core.run.files import read_json, write_json
from ...core.run.folders import locked_folder, new_folder
from ...methods import Simulation
from ...record.checks import CheckRecorder
from ...record.run_folder import TableRecorder

LINE_RECORD = "asked.json"
"""Name of the file that describes the folder's line until all its runs are finished."""
PARTS = "parts"


@contextmanager
def line_folder(out: Path | None, asked: Mapping[str, Any]) -> Iterator[None]:
    """Lock the folder of a line during a `with` block: a new folder, or that of the same interrupted line.

    `asked` holds everything on which the line's runs depend, as JSON; `out` may be None for no folder. A block that
    fails before any run leaves no folder. Raises :class:`RunFolderError` if the folder exists and is complete or
    belongs to another line.
    """
    if out is None:
        yield
        return
    record = out / LINE_RECORD
    known = json.loads(json.dumps(asked))
    if record.is_file() and read_json(record) != known:
        raise RunFolderError(f"out = '{out}': contains another, unfinished line; choose a new folder")
    with locked_folder(out, LINE_RECORD) if record.is_file() else new_folder(out):
        if not record.is_file():
            write_json(record, known)
        try:
            yield
        except BaseException:
            if not (out / PARTS).exists():
                record.unlink()
            raise
        record.unlink()


def previous_run(lines: Sequence[Path | None], scene: Any, digest: str = "") -> Path | None:
    """Return the folder of a finished run of the same scene in the folders of several lines; None if there is none.

    `digest` identifies a mesh file and must be part of the folder's name.
    """
    parts = [line / PARTS for line in lines if line is not None]
    return next((path for each in parts for path, finished in _same(each, scene, digest) if finished), None)


def part_simulation(
    scene: Any, check: Any, out: Path | None, called: str, digest: str = "", **settings: Any
) -> tuple[Simulation, Path | None]:
    """Return the simulation of a part and the checkpoint from which it continues; the checkpoint may be None.

    The run folder is the interrupted one of the same scene in `out`, or else a new one called `called`.
    """
    if out is None:
        return Simulation(scene, recorders=[CheckRecorder(check)], **settings), None
    begun = next((path for path, finished in _same(out / PARTS, scene, digest) if not finished), None)
    folder = begun or _free_folder(out / PARTS / called)
    checkpoint = folder / "checkpoint.npz"
    recorders = [TableRecorder(folder, going_on=begun is not None), CheckRecorder(check)]
    simulation = Simulation(scene, recorders=recorders, checkpoint_path=checkpoint, **settings)
    return simulation, checkpoint if checkpoint.is_file() else None


def _same(folder: Path, scene: Any, digest: str) -> Iterator[tuple[Path, bool]]:
    """Yield each folder with a run of the same scene, and whether that run is complete."""
    for here in sorted(folder.iterdir()) if folder.is_dir() else ():
        record, result = here / "scene.json", here / "result.json"
        if digest not in here.name or not record.is_file():
            continue
        there, files = read_json(record), scene.parameters.files
        same = there.get("parameters") == json.loads(json.dumps(dict(scene.parameters)))
        if same and "modified" not in there and there.get("files", files) == files:
            complete = result.is_file() and not (here / "checkpoint.npz").exists()
            yield here, bool(complete and read_json(result).get("finished"))


def _free_folder(folder: Path) -> Path:
    """Return `folder`, or a numbered variant of it if it exists; names of similar parts may agree after rounding."""
    count, free = 1, folder
    while free.exists():
        count += 1
        free = folder.with_name(f"{folder.name}-{count}")
    return free
