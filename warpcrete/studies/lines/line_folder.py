"""Lock on the folder of a simulated pump line, which ensures that all runs in the folder belong to the same line."""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from ...core.errors import RunFolderError
from ...core.run.files import read_json, write_json
from ...core.run.folders import locked_folder, new_folder

LINE_RECORD = "asked.json"
"""Name of the file with the inputs of the simulated line; the file exists until all runs of the line are finished."""
PARTS = "parts"
"""Name of the folder that holds the simulation runs of the line's parts."""


@contextmanager
def line_folder(out: Path | None, asked: Mapping[str, object]) -> Iterator[None]:
    """Lock the folder of a line during a `with` block.

    The folder `out` must be new, or must hold an interrupted line with the same inputs, which then continues. `asked`
    holds all inputs on which the line's runs depend; it must be possible to write them as JSON. If `out` is None,
    nothing is locked. A new folder is removed if the block fails before the first run has begun. Raises
    :class:`RunFolderError` if the folder holds a finished line, or an interrupted line with other inputs.
    """
    if out is None:
        yield
        return
    record = out / LINE_RECORD
    known = json.loads(json.dumps(asked))
    if record.is_file() and read_json(record) != known:
        raise RunFolderError(
            f"out = '{out}': contains the unfinished results of a line with other inputs; choose a new folder"
        )
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
