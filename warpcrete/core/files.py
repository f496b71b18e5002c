"""Files that are whole or not there, and folders that can be made."""

from __future__ import annotations

import errno
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from .errors import DiskFullError, RunFolderError, quoted
from .text_files import saved_json

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Error numbers of a disk, a quota or a limit of the process that takes no more."""
PARTIAL = ".warpcrete-partial-"
"""Begins the name of a file that is not whole yet; nobody else names files like this."""
PROBE = 1 << 16
"""Bytes that must fit into a folder that has room."""
MARGIN = 1 << 20
"""Bytes that must be left beside a file that may be needed."""


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A path beside `path` to write to; it takes the place of `path` if all goes well and goes away if not.

    What the system refuses becomes a :class:`RunFolderError` that names the file.
    """
    partial = partial_of(path)
    try:
        yield partial
        partial.replace(path)
    except OSError as error:
        raise cannot_write(path, error) from error
    finally:
        with suppress(OSError):
            partial.unlink(missing_ok=True)


def partial_of(path: Path) -> Path:
    """Where a file is written to before it is whole."""
    return path.with_name(f"{PARTIAL}{path.name}")


def cannot_write(path: Path, error: Exception) -> RunFolderError:
    """Return the error of a file that cannot be written: a :class:`DiskFullError` where there is no room for it.

    Libraries that write files themselves do not say why they failed; the folder then shows whether it has room.
    """
    known = isinstance(error, OSError) and error.errno is not None
    needed = MARGIN + (2 * path.stat().st_size if path.exists() else 0)
    cause = error if known else room_in(path.parent, needed) or error
    reason = getattr(cause, "strerror", None) or " ".join(str(cause).split()) or type(cause).__name__
    kind = DiskFullError if is_full(cause) else RunFolderError
    return kind(f"'{path}': cannot be written ({reason}); files written so far are kept")


def is_full(error: BaseException) -> bool:
    """Return whether a disk that takes no more caused an error."""
    return isinstance(error, DiskFullError) or (isinstance(error, OSError) and error.errno in FULL)


def room_in(folder: Path, needed: int = 0) -> OSError | None:
    """Return what the system refuses a small file in a folder with, or one of `needed` bytes; None where it fits."""
    probe = partial_of(folder / "probe")
    try:
        with probe.open("wb") as file:
            file.write(bytes(PROBE))
            if shutil.disk_usage(folder).free < needed:
                return OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    except OSError as error:
        return error
    finally:
        with suppress(OSError):
            probe.unlink(missing_ok=True)
    return None


def write_json(path: Path, data: Any) -> None:
    """Write JSON; a reader never sees half a file."""
    with whole_file(path) as partial:
        partial.write_text(json.dumps(_finite(data), indent=2, allow_nan=False) + "\n", encoding="utf-8")


def _finite(data: Any) -> Any:
    # JSON has no word for NaN: what was not measured is null.
    if isinstance(data, dict):
        return {key: _finite(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_finite(value) for value in data]
    if isinstance(data, float) and not np.isfinite(data):
        return None
    return data


def read_json(path: Path) -> dict[str, Any]:
    """Contents of a JSON file that holds an object, or :class:`RunFolderError`."""
    return saved_json(path)


RECORD_KINDS: dict[str, type] = {
    "scene": str, "parameters": dict, "files": dict, "device": str, "precision": str, "command": dict, "modified": dict,
    "threads": int, "cases": list, "name": str, "varied": dict, "quantities": list, "knobs": list, "repeat": int,
    "provenance": dict, "finest": dict, "points": list, "paper": str, "columns": list, "rows": list, "targets": dict,
    "settings": dict, "rounds": list,
}  # fmt: skip
"""Kinds of the entries of a record of what was asked for: a run, a study, a trade, a calibration or a reproduction."""


LEFT_OUT = {"device", "precision", "threads", "columns", "rows"}
"""Entries that are null where nobody asked for anything."""


def read_record(path: Path) -> dict[str, Any]:
    """Return what :func:`read_json` does, or raise :class:`RunFolderError` for an entry of another kind."""
    record = read_json(path)
    cases = record.get("cases")
    within = [record, record.get("command"), *(cases if isinstance(cases, list) else [])]
    for place, part in enumerate(within):
        if not isinstance(part, dict):
            if place == 1 and "command" not in record:
                continue
            _refuse_entry(path, "command" if place == 1 else "cases", part)
        for name, kind in RECORD_KINDS.items():
            if name in part and not isinstance(part[name], kind) and not (part[name] is None and name in LEFT_OUT):
                _refuse_entry(path, name, part[name])
    return record


def _refuse_entry(path: Path, name: str, value: Any) -> NoReturn:
    raise RunFolderError(f"'{path}': is damaged: its entry {name!r} is {quoted(value)}; restore the file, or "
                         "start again in a new folder")  # fmt: skip


def check_new(folder: Path) -> None:
    """Refuse a folder that exists or cannot be made and written to; leaves nothing behind."""
    try:
        there = folder.exists() or folder.is_symlink()
    except OSError as error:
        raise RunFolderError(
            f"out = '{folder}': cannot be used as a folder ({error.strerror}); choose another path"
        ) from error
    if there and not is_empty(folder):
        raise RunFolderError(f"out = '{folder}': exists already; choose a new folder (runs are never overwritten)")
    made: list[Path] = []
    probe = folder / "probe"
    try:
        for parent in reversed([folder, *folder.absolute().parents]):
            if not parent.exists():
                parent.mkdir()
                made.append(parent)
        probe.touch()
    except OSError as error:
        raise RunFolderError(f"out = '{folder}': cannot be created ({error.strerror}); choose another path") from error
    finally:
        with suppress(OSError):
            probe.unlink(missing_ok=True)
        for path in reversed(made):
            with suppress(OSError):
                path.rmdir()


LOCK = ".lock"
"""File in a folder that its owner holds locked while it writes there."""


def is_empty(folder: Path) -> bool:
    """Return whether a folder holds nothing but what a killed process may leave before its first file is whole."""
    return folder.is_dir() and all(path.name == LOCK or path.name.startswith(PARTIAL) for path in folder.iterdir())


def remove_partial(folder: Path) -> None:
    """Remove files that a killed process did not write to their ends."""
    for path in folder.glob(f"{PARTIAL}*"):
        path.unlink(missing_ok=True)


def next_folder(name: str, root: Path = Path("runs")) -> Path:
    """First free `runs/NAME-NNN`."""
    number = 1
    while (root / f"{name}-{number:03d}").exists():
        number += 1
    return root / f"{name}-{number:03d}"
