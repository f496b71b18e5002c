"""Parts of a recording, joined into one file."""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Sequence
from pathlib import Path

from ..core.files import cannot_write, partial_of
from ..core.processes import tied
from ..core.viewer import rerun_tool


def join(parts: Sequence[Path], path: Path) -> None:
    """Join the parts that are there into `path`, the first of them, by Rerun's own tool, and remove the others.

    A part that a killed run did not write to its end is taken as far as it is whole; chunks that two parts have, as
    after a kill during the join, count once. Raises :class:`RunFolderError` where that fails; the parts then stay.
    """
    parts = [part for part in parts if part.is_file()]
    partial = partial_of(path)
    command = [rerun_tool(), "rrd", "merge", "--continue-on-error", *map(str, parts), "-o", str(partial)]
    done = subprocess.run(tied(command), capture_output=True, text=True, encoding="utf-8", errors="replace")
    if done.returncode != 0 or not partial.is_file():
        partial.unlink(missing_ok=True)
        number = re.search(r"os error (\d+)", done.stderr)
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        cause = OSError(int(number[1]), os.strerror(int(number[1]))) if number else OSError(f"not joined: {last}")
        raise cannot_write(path, cause)
    partial.replace(path)
    for part in parts:
        if part != path:
            part.unlink()
