"""Folder of a simulated pump line, with one run for each kind of part. An interrupted simulation continues there."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from ...core.errors import refuse
from ...core.run.files import read_json
from ...methods import Simulation
from ...record.checks import CheckRecorder
from ...record.run_folder import TableRecorder
from .line_folder import PARTS


def check_known(known: Path | None) -> None:
    """Raise an error unless the folder `known` contains the simulated parts of an earlier pump line.

    The runs in such a folder can be reused. If `known` is None, no folder was given, and there is nothing to check.
    """
    if known is not None and not (known / PARTS).is_dir():
        hint = "give the folder of an earlier 'warpcrete line', which contains a folder 'parts'"
        refuse("known", str(known), "is not the folder of a line with simulated parts", hint)


def previous_run(lines: Sequence[Path | None], scene: Any, digest: str = "") -> Path | None:
    """Return the folder of a finished run of the scene `scene`, or None if there is none.

    The folders of several pump `lines` are searched. If the simulated part has a mesh, `digest` is the checksum of the
    mesh file, and only folders whose name contains this checksum are considered.
    """
    parts = [line / PARTS for line in lines if line is not None]
    return next((path for each in parts for path, finished in _same(each, scene, digest) if finished), None)


def part_simulation(
    scene: Any, check: object, out: Path | None, called: str, digest: str = "", **settings: object
) -> tuple[Simulation, Path | None]:
    """Return the simulation of a part of a pump line, and the path of the checkpoint from which it continues, or None.

    If the folder `out` of the line holds an interrupted run of the same scene, the simulation continues this run in the
    folder of the run. Otherwise, it starts in a new folder with the name `called`. If the part has a mesh, `digest` is
    the checksum of the mesh file. The function `check` checks the finished run, and `settings` are further arguments of
    :class:`Simulation`.
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
    """Yield the path of each run of the given scene in `folder`, and whether the run is complete.

    If the simulated part has a mesh, `digest` is the checksum of the mesh file, which the name of the run's folder
    contains.
    """
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
    """Return the path `folder`, or this path with a number appended if it exists.

    A folder's name contains rounded dimensions of a part of a pump line, so similar parts may have the same name.
    """
    count, free = 1, folder
    while free.exists():
        count += 1
        free = folder.with_name(f"{folder.name}-{count}")
    return free
