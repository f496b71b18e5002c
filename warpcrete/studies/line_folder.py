"""The folder of a line: one run of each kind of part, which the same line takes up again after it was cut."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..core.errors import RunFolderError
from ..core.files import read_json, write_json
from ..core.folders import held, new_folder
from ..methods import Simulation
from ..record.checks import CheckRecorder
from ..record.run_folder import TableRecorder

ASKED = "asked.json"
"""Says what the folder's line is, until it is complete."""
PARTS = "parts"


@contextmanager
def line_folder(out: Path | None, asked: Mapping[str, Any]) -> Iterator[None]:
    """Hold a new folder, or that of the same line that was cut, while the line is simulated; None: no folder.

    `asked` is everything that the line's runs depend on, as JSON. A block that fails before any run leaves no folder.
    Raises :class:`RunFolderError` for a folder of another line, or of one that is complete.
    """
    if out is None:
        yield
        return
    record = out / ASKED
    known = json.loads(json.dumps(asked))
    if record.is_file() and read_json(record) != known:
        raise RunFolderError(f"out = '{out}': contains another, unfinished line; choose a new folder")
    with held(out, ASKED) if record.is_file() else new_folder(out):
        if not record.is_file():
            write_json(record, known)
        try:
            yield
        except BaseException:
            if not (out / PARTS).exists():
                record.unlink()
            raise
        record.unlink()


def known_run(lines: Sequence[Path | None], scene: Any, digest: str = "") -> Path | None:
    """Return the folder of a finished run of that very scene in the folders of some lines.

    A mesh file is known by its `digest` in the name.
    """
    parts = [line / PARTS for line in lines if line is not None]
    return next((path for each in parts for path, finished in _same(each, scene, digest) if finished), None)


def part_simulation(
    scene: Any, check: Any, out: Path | None, called: str, digest: str = "", **settings: Any
) -> tuple[Simulation, Path | None]:
    """Return the simulation of a part and the checkpoint that it goes on from, if there is one.

    It runs into the folder `called` among the parts in `out`, or into that of the same scene that was cut.
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
    """Yield the folders of runs of that very scene, and whether each is complete."""
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
    """Return the folder, or one with a number behind where two kinds of part round to the same name."""
    count, free = 1, folder
    while free.exists():
        count += 1
        free = folder.with_name(f"{folder.name}-{count}")
    return free
