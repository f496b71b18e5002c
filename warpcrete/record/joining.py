"""Joining of the parts of a Rerun recording into one file."""

import os
import re
import subprocess
from collections.abc import Sequence
from pathlib import Path

from ..core.run.files import cannot_write, partial_of
from ..core.run.processes import killed_with_parent
from ..core.run.viewer import rerun_tool


def join(parts: Sequence[Path], path: Path) -> None:
    """Join the parts of a recording into the file `path`, which is also the first part, and remove the other parts.

    Rerun's own tool joins the parts. If a killed run left a part incomplete, the tool keeps the complete chunks of this
    part; a chunk is Rerun's unit of stored data. If an earlier attempt to join the parts was killed, some chunks may
    occur in two parts; the tool stores them only once. Raises :class:`RunFolderError` if joining fails; the parts then
    remain.
    """
    parts = [part for part in parts if part.is_file()]
    partial = partial_of(path)
    command = [rerun_tool(), "rrd", "merge", "--continue-on-error", *map(str, parts), "-o", str(partial)]
    done = subprocess.run(
        killed_with_parent(command), capture_output=True, text=True, encoding="utf-8", errors="replace"
    )
    if done.returncode != 0 or not partial.is_file():
        partial.unlink(missing_ok=True)
        number = re.search(r"os error (\d+)", done.stderr)
        last = (done.stderr.strip().splitlines() or ["no error message"])[-1]
        cause = (
            OSError(int(number[1]), os.strerror(int(number[1])))
            if number
            else OSError(f"Rerun could not join the parts of the recording: {last}")
        )
        raise cannot_write(path, cause)
    partial.replace(path)
    for part in parts:
        if part != path:
            part.unlink()
