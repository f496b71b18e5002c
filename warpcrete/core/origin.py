"""What a scene was made from: the arguments of its scene function, the files it read, and whether it was changed since.

A frozen scene can still be changed: `dataclasses.replace` copies it with other fields, and arrays are mutable. Its
record must not claim then that the arguments describe it.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any

import numpy as np

from .errors import RunFolderError, refuse
from .fingerprints import fingerprint

LONGEST_LIST = 20
"""Numbers of an array, or entries of a list, that a record still shows."""

PACKAGE = Path(__file__).resolve().parents[1]

_files: ContextVar[dict[str, str] | None] = ContextVar("files", default=None)


@contextmanager
def files_read() -> Iterator[dict[str, str]]:
    """Collect the SHA-256 of every input file that is read inside the block, by its absolute path."""
    found: dict[str, str] = {}
    token = _files.set(found)
    try:
        yield found
    finally:
        _files.reset(token)
        if (outer := _files.get()) is not None:
            outer.update(found)


def note_file(path: Path) -> None:
    """Tell :func:`files_read` that an input file is read; those of this package belong to its version."""
    found, whole = _files.get(), path.resolve()
    if found is not None and PACKAGE not in whole.parents:
        found[str(whole)] = digest_of(whole)


def digest_of(path: Path) -> str:
    """Return the SHA-256 of a file; empty if the file cannot be read."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return ""


def changed_files(files: Mapping[str, str]) -> list[str]:
    """Return the paths whose files are gone or hold something else than their digests say."""
    return [path for path, digest in files.items() if digest_of(Path(path)) != digest]


def check_files(where: Path, files: Mapping[str, str]) -> None:
    """Refuse to go on with the record `where` if an input file of its scene has changed since."""
    if changed := changed_files(files):
        gone = not Path(changed[0]).is_file()
        raise RunFolderError(
            f"'{where}': its scene was made with '{changed[0]}', which {'is missing' if gone else 'has changed'}; "
            "restore the file, or start a new run"
        )


class Arguments(dict[str, Any]):
    """Arguments of a scene function by name, with fingerprints of what the function made of them.

    `function` names the scene function, `fields` has the fingerprint of each field of the scene, `files` the SHA-256 of
    each file that the function read, and `lost` names arguments whose values cannot be written as text.
    """

    function: str = ""
    fields: Mapping[str, str] = {}
    files: Mapping[str, str] = {}
    lost: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, scene: Any, function: str, values: Mapping[str, Any], files: Mapping[str, str], lost: tuple[str, ...]
    ) -> Arguments:
        """Return the arguments `values` of a scene that was just made of them."""
        made = cls(values)
        made.function, made.files, made.lost = function, dict(files), lost
        made.fields = {"parameters": fingerprint(values), **_fingerprints(scene)}
        return made


def _fingerprints(scene: Any) -> dict[str, str]:
    return {f.name: fingerprint(getattr(scene, f.name)) for f in dataclasses.fields(scene) if f.name != "parameters"}


def changed_fields(scene: Any) -> list[str]:
    """Return the names of the fields that differ from what the scene function made.

    A scene that was built by hand has no function: all its fields are returned.
    """
    made = scene.parameters
    now = _fingerprints(scene)
    if not isinstance(made, Arguments) or not made.function:
        return list(now)
    now["parameters"] = fingerprint(dict(made))
    return list(dict.fromkeys([*made.lost, *(name for name, value in now.items() if made.fields.get(name) != value)]))


def arguments_of(scene: Any) -> Mapping[str, Any]:
    """Return the arguments that make this very scene again; empty if it was changed or built by hand."""
    return {} if changed_fields(scene) else scene.parameters


def check_named(scene: Any) -> None:
    """Refuse a scene with an object, such as a contact law, that its name does not lead other processes to."""
    made = scene.parameters
    hidden = [name for name, value in made.items() if isinstance(value, str) and value.startswith("__main__:")]
    for name in (*made.lost, *hidden):
        refuse(name, made[name], "cannot be recreated in another run or process",
               "define its class in a module file, and declare all its fields")  # fmt: skip


def readable(value: Any) -> Any:
    """Return a value as JSON that people can read: dataclasses by their fields, large arrays by shape and digest."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {f.name: readable(getattr(value, f.name)) for f in dataclasses.fields(value)}
        return {"type": f"{type(value).__module__}:{type(value).__qualname__}", **fields}
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, str | int | float | None):
        return value
    if isinstance(value, np.ndarray):
        if value.size <= LONGEST_LIST and value.dtype != object:
            return value.tolist()
        return f"array {value.dtype} {value.shape}, SHA-256 {fingerprint(value)[:16]}"
    if isinstance(value, Mapping):
        return {str(key): readable(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        if len(value) <= LONGEST_LIST:
            return [readable(item) for item in value]
        return f"{len(value)} entries, SHA-256 {fingerprint(value)[:16]}"
    return f"{type(value).__module__}:{type(value).__qualname__}, SHA-256 {fingerprint(value)[:16]}"
