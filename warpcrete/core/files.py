"""Files that are whole or not there, and folders that can be made."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from .errors import RunFolderError
from .text_files import saved_json


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
    return path.with_name(f"partial-{path.name}")


def cannot_write(path: Path, error: Exception) -> RunFolderError:
    """The error of a file that cannot be written."""
    reason = getattr(error, "strerror", None) or " ".join(str(error).split()) or type(error).__name__
    return RunFolderError(f"'{path}': cannot be written ({reason}); what is on disk so far is kept")


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


def check_new(folder: Path) -> None:
    """Refuse a folder that exists or cannot be made and written to; leaves nothing behind."""
    try:
        there = folder.exists() or folder.is_symlink()
    except OSError as error:
        raise RunFolderError(f"out = '{folder}': cannot be a folder ({error.strerror})") from error
    if there:
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
        raise RunFolderError(f"out = '{folder}': cannot be made ({error.strerror}); choose another place") from error
    finally:
        with suppress(OSError):
            probe.unlink(missing_ok=True)
        for path in reversed(made):
            with suppress(OSError):
                path.rmdir()


def next_folder(name: str, root: Path = Path("runs")) -> Path:
    """First free `runs/NAME-NNN`."""
    number = 1
    while (root / f"{name}-{number:03d}").exists():
        number += 1
    return root / f"{name}-{number:03d}"
