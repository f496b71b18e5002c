"""Functions that write files so that no file is ever incomplete, read JSON records, and check new folders."""

import errno
import json
import os
import shutil
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NoReturn, cast

import numpy as np

from ..errors import DiskFullError, RunFolderError, is_full, quoted, refuse
from ..inputs.text_files import read_json
from ..narrowing import is_dict, is_list_or_tuple
from ..records import Record

PARTIAL = ".warpcrete-partial-"
"""Prefix of the name of a file that is not complete yet; no other program uses this prefix."""
PROBE_SIZE = 1 << 16
"""Size of the test file that is written to find out whether the disk of a folder is full [B]."""
SPACE_MARGIN = 1 << 20
"""Free disk space that must be left after a file of the expected size has been written [B]."""


@contextmanager
def atomic_file(path: Path) -> Generator[Path]:
    """Yield a temporary path next to `path`; the file written there replaces `path` at the end of the `with` block.

    If the block fails, the temporary file is removed. An error of the operating system becomes a
    :class:`RunFolderError` that names the file.
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
    """Return the temporary path at which a file is written until it is complete."""
    return path.with_name(f"{PARTIAL}{path.name}")


def cannot_write(path: Path, error: Exception) -> RunFolderError:
    """Return the error to raise for a file that cannot be written; a :class:`DiskFullError` if there is no space.

    If `error` comes from a library that does not report the cause, a test file shows whether the folder has free space.
    """
    known = isinstance(error, OSError) and error.errno is not None
    needed = SPACE_MARGIN + (2 * path.stat().st_size if path.exists() else 0)
    cause = error if known else space_error(path.parent, needed) or error
    reason = getattr(cause, "strerror", None) or " ".join(str(cause).split()) or type(cause).__name__
    kind = DiskFullError if is_full(cause) else RunFolderError
    return kind(f"'{path}': cannot be written ({reason}); files written so far are kept")


def space_error(folder: Path, needed: int = 0) -> OSError | None:
    """Return the system's error if a folder lacks space for a small file or for `needed` bytes, otherwise None."""
    probe = partial_of(folder / "probe")
    try:
        with probe.open("wb") as file:
            file.write(bytes(PROBE_SIZE))
            if shutil.disk_usage(folder).free < needed:
                return OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    except OSError as error:
        return error
    finally:
        with suppress(OSError):
            probe.unlink(missing_ok=True)
    return None


def write_json(path: Path, data: object) -> None:
    """Write `data` as JSON to a file, which other processes never see incomplete. NaN and infinity become null."""
    with atomic_file(path) as partial:
        partial.write_text(json.dumps(_finite(data), indent=2, allow_nan=False) + "\n", encoding="utf-8")


def _finite(data: object) -> object:
    # JSON has no NaN and no infinity, so a value that was not measured becomes null.
    if is_dict(data):
        return {key: _finite(value) for key, value in data.items()}
    if is_list_or_tuple(data):
        return [_finite(value) for value in data]
    if isinstance(data, float) and not np.isfinite(data):
        return None
    return data


RECORD_KINDS: dict[str, type] = {
    "scene": str, "parameters": dict, "files": dict, "device": str, "precision": str, "command": dict, "modified": dict,
    "threads": int, "cases": list, "name": str, "varied": dict, "quantities": list, "knobs": list, "repeat": int,
    "provenance": dict, "finest": dict, "points": list, "paper": str, "columns": list, "rows": list, "targets": dict,
    "settings": dict, "rounds": list, "units": dict,
}  # fmt: skip
"""Required types of the entries in a record, which is the JSON file that stores the request for a run, study,
trade-off, calibration or reproduction."""


NULLABLE_ENTRIES = {"device", "precision", "threads", "columns", "rows"}
"""Entries that may be null in a record (the JSON file of a request), because the user left them at their defaults."""
NEVER_NULL = {"scene.json": {"threads"}, "trade.json": {"device", "threads"}}
"""Entries that must not be null in some files although `NULLABLE_ENTRIES` contains them, by name of the file. The
program always fills in these entries when it writes the file."""


def read_record(path: Path) -> Record:
    """Return the record of a run, study or calibration from its JSON file.

    Raises :class:`RunFolderError` if the file cannot be read or an entry has the wrong type.
    """
    record = read_json(path)
    cases = record.get("cases")
    nullable = NULLABLE_ENTRIES - NEVER_NULL.get(path.name, set())
    within: list[object] = [record, record.get("command"), *(cases if is_list_or_tuple(cases) else [])]
    for place, part in enumerate(within):
        if not is_dict(part):
            if place == 1 and "command" not in record:
                continue
            _refuse_entry(path, "command" if place == 1 else "cases", part)
        for name, kind in RECORD_KINDS.items():
            null = name in part and part[name] is None and name in nullable
            if name in part and not isinstance(part[name], kind) and not null:
                _refuse_entry(path, name, part[name])
    return record


def _refuse_entry(path: Path, name: str, value: object) -> NoReturn:
    raise RunFolderError(
        f"'{path}': is damaged: its entry {name!r} has the wrong value {quoted(value)}; "
        "restore the file, or start again in a new folder"
    )


def folder_path(field: str, value: object) -> Path:
    """Return the path of a folder; raises :class:`SceneError` about `field` if `value` cannot be a path."""
    path: object = os.fspath(cast(os.PathLike[str], value)) if isinstance(value, os.PathLike) else value
    if not isinstance(path, str):
        refuse(field, cast(object, value), "must be the path of a folder, as text or a pathlib.Path")
    if "\0" in path:
        refuse(field, path, "contains a NUL character", "remove this character")
    return Path(path)


def check_new(folder: Path) -> None:
    """Raise :class:`RunFolderError` for an output folder that is not empty, or cannot be created or written to.

    The check creates the folder for a moment, with a test file in it, and removes both.
    """
    try:
        existing = folder.exists() or folder.is_symlink()
    except OSError as error:
        raise RunFolderError(
            f"out = '{folder}': cannot be used as a folder ({error.strerror}); choose another path"
        ) from error
    if existing and not is_empty(folder):
        kept = "choose a new folder (runs are never overwritten)"
        if (folder / "study.json").is_file():
            kept += f", read its study with warpcrete.load, or continue it with 'warpcrete study --resume {folder}'"
        raise RunFolderError(f"out = '{folder}': exists already; {kept}")
    created: list[Path] = []
    probe = folder / "probe"
    try:
        for parent in reversed([folder, *folder.absolute().parents]):
            if not parent.exists():
                parent.mkdir()
                created.append(parent)
        probe.touch()
    except OSError as error:
        raise RunFolderError(f"out = '{folder}': cannot be created ({error.strerror}); choose another path") from error
    finally:
        with suppress(OSError):
            probe.unlink(missing_ok=True)
        for path in reversed(created):
            with suppress(OSError):
                path.rmdir()


LOCK = ".lock"
"""Name of the lock file, which the process that writes into a folder keeps locked."""


def is_empty(folder: Path) -> bool:
    """Return whether a folder is empty, apart from a lock file or partial files of a killed process."""
    return folder.is_dir() and all(path.name == LOCK or path.name.startswith(PARTIAL) for path in folder.iterdir())


def remove_partial(folder: Path) -> None:
    """Remove the incomplete files that a killed process left in a folder."""
    for path in folder.glob(f"{PARTIAL}*"):
        if not path.is_dir():
            path.unlink(missing_ok=True)


def output_folder(out: object, name: str) -> Path:
    """Return the path `out` or, if `out` is None, the first folder name `runs/NAME-NNN` that does not exist yet."""
    return next_folder(name) if out is None else folder_path("out", out)


def next_folder(name: str) -> Path:
    """Return the first folder name `runs/NAME-NNN` that does not exist yet."""
    number = 1
    while (folder := Path("runs") / f"{name}-{number:03d}").exists():
        number += 1
    return folder
