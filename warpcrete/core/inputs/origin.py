"""Origin of a scene: arguments of its scene function, files that were read, and whether the scene was changed since.

A frozen scene can still be changed, because `dataclasses.replace` copies it with other fields and arrays are mutable.
The record of a changed scene must not claim that the arguments describe the scene.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any

from ..errors import RunFolderError, refuse
from ..narrowing import is_host_array, is_list_or_tuple, is_mapping, is_numpy_number
from .fingerprints import fingerprint

LONGEST_LIST = 20
"""Maximum number of elements of an array or list that is recorded in full; a larger array or list is recorded as a
hash."""

PACKAGE = Path(__file__).resolve().parents[2]

_files: ContextVar[dict[str, str] | None] = ContextVar("files", default=None)


@contextmanager
def files_read() -> Generator[dict[str, str]]:
    """Collect the SHA-256 of every input file that is read inside the `with` block, by absolute path."""
    found: dict[str, str] = {}
    token = _files.set(found)
    try:
        yield found
    finally:
        _files.reset(token)
        if (outer := _files.get()) is not None:
            outer.update(found)


def note_file(path: Path) -> None:
    """Add the input file at `path` to the files that the enclosing :func:`files_read` block collects.

    Files of this package are left out, because the package's version identifies their content.
    """
    found, whole = _files.get(), path.resolve()
    if found is not None and PACKAGE not in whole.parents:
        found[str(whole)] = digest_of(whole)


def digest_of(path: Path) -> str:
    """Return the SHA-256 of a file, or an empty text if the file cannot be read."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return ""


def changed_files(files: Mapping[str, str]) -> list[str]:
    """Return the paths of files that are missing or do not match their SHA-256."""
    return [path for path, digest in files.items() if digest_of(Path(path)) != digest]


def check_files(where: Path, files: Mapping[str, str]) -> None:
    """Raise :class:`RunFolderError` if an input file of a scene changed after the file `where` was written.

    `where` is the record of the scene. `files` maps the path of each input file to its SHA-256 in the record.
    """
    if changed := changed_files(files):
        gone = not Path(changed[0]).is_file()
        raise RunFolderError(
            f"'{where}': its scene was made with '{changed[0]}', which {'is missing' if gone else 'has changed'}; "
            "restore this file, or start a new run"
        )


class Arguments(dict[str, Any]):
    """Arguments of a scene function by name, with fingerprints of the scene that the function made.

    `function` is the name of the scene function. `fields` maps each field of the scene to a fingerprint of its value.
    `files` maps the path of each file that the function read to its SHA-256. `unwritable` holds the names of the
    arguments whose values cannot be written as text.
    """

    function: str = ""
    fields: Mapping[str, str] = {}
    files: Mapping[str, str] = {}
    unwritable: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        scene: object,
        function: str,
        values: Mapping[str, object],
        files: Mapping[str, str],
        unwritable: tuple[str, ...],
    ) -> Arguments:
        """Return the arguments `values`, with fingerprints of the `scene` that was made from these arguments.

        The fingerprints show later whether the scene was changed. `function`, `files` and `unwritable` are attributes
        of the result, which the docstring of the class explains.
        """
        made = cls(values)
        made.function, made.files, made.unwritable = function, dict(files), unwritable
        made.fields = {"parameters": fingerprint(values), **_fingerprints(scene)}
        return made


def _fingerprints(scene: Any) -> dict[str, str]:
    return {f.name: fingerprint(getattr(scene, f.name)) for f in dataclasses.fields(scene) if f.name != "parameters"}


def changed_fields(scene: Any) -> list[str]:
    """Return the names of fields in which a scene differs from what its scene function made.

    For a scene that was built by hand, without a scene function, return the names of all fields.
    """
    made = scene.parameters
    now = _fingerprints(scene)
    if not isinstance(made, Arguments) or not made.function:
        return list(now)
    now["parameters"] = fingerprint(dict(made))
    return list(
        dict.fromkeys([*made.unwritable, *(name for name, value in now.items() if made.fields.get(name) != value)])
    )


def arguments_of(scene: Any) -> Mapping[str, Any]:
    """Return arguments with which the scene function makes a scene equal to this one.

    The mapping is empty if the scene was built without a scene function, or changed after the function had made it.
    """
    return {} if changed_fields(scene) else scene.parameters


def check_named(scene: Any) -> None:
    """Refuse a scene with an object, such as a contact law, that other processes cannot create from its class name."""
    made = scene.parameters
    hidden = [name for name, value in made.items() if isinstance(value, str) and value.startswith("__main__:")]
    for name in (*made.unwritable, *hidden):
        hint = "define the class of this object in a module file, and declare all its fields there"
        refuse(name, made[name], "cannot be rebuilt in another run or process", hint)


def readable(value: object) -> object:
    """Return a value as readable JSON: dataclasses as their fields, large arrays as shape and digest."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {f.name: readable(getattr(value, f.name)) for f in dataclasses.fields(value)}
        return {"type": f"{type(value).__module__}:{type(value).__qualname__}", **fields}
    if is_numpy_number(value):
        item: object = value.item()
        return item
    if isinstance(value, str | int | float | None):
        return value
    if is_host_array(value):
        if value.size <= LONGEST_LIST and value.dtype != object:
            return value.tolist()
        return f"array {value.dtype} {value.shape}, SHA-256 {fingerprint(value)[:16]}"
    if is_mapping(value):
        return {str(key): readable(item) for key, item in value.items()}
    if is_list_or_tuple(value):
        if len(value) <= LONGEST_LIST:
            return [readable(item) for item in value]
        return f"{len(value)} entries, SHA-256 {fingerprint(value)[:16]}"
    return f"{type(value).__module__}:{type(value).__qualname__}, SHA-256 {fingerprint(value)[:16]}"
