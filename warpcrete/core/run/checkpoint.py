"""Checkpoint files, which hold the complete state of a run; an interrupted write never leaves an incomplete file."""

import hashlib
import json
import os
import warnings
import zipfile
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TypedDict

import numpy as np
import warp as wp

from ..errors import RunFolderError
from ..inputs.fingerprints import fingerprint
from ..narrowing import is_dict, is_host_array, is_numpy_number
from ..records import Record, SavedState
from .files import cannot_write, partial_of
from .provenance import processor, versions

FORMAT = 8


class RunRecord(TypedDict):
    """Data in a checkpoint that describe the progress of the run; the simulated state is stored separately."""

    recorders: dict[str, object]
    """Data that each recorder needs to go on recording, by the recorder's class name."""
    next_frame: float
    """Simulated time at which the next picture of the state (frame) is recorded [s]."""
    spent: dict[str, float]
    """Wall time of each phase of the run [s], by the phase's name, such as "packing"."""
    over: bool
    """True if the last step of the run has been taken."""


def write_partial(path: Path, scene: object, device: wp.Device, precision: str, contents: Mapping[str, object]) -> None:
    """Write a checkpoint of a run of `scene` to a partial file next to `path`; :func:`commit` moves it to `path`.

    `contents` holds numbers, texts, arrays and dictionaries of these. The file is a NumPy archive (npz) with a SHA-256
    digest of its contents. The previous checkpoint stays at `path` until `commit`. If a recorder fails to write its
    data in the meantime, the run can therefore go on from the previous checkpoint, for which all recorders have written
    their data. Raises :class:`RunFolderError` if the file cannot be written.
    """
    arrays: dict[str, np.ndarray] = {}
    text = {
        "warpcrete checkpoint": FORMAT,
        "scene": fingerprint(scene),
        "device": _kind(device),
        "precision": precision,
        "processor": processor(),
        "versions": versions(),
        "contents": {key: _flatten(value, key, arrays) for key, value in contents.items()},
    }
    arrays["text"] = np.frombuffer(json.dumps(text).encode(), dtype=np.uint8)
    arrays["digest"] = np.frombuffer(_digest(arrays), dtype=np.uint8)
    try:
        with partial_of(path).open("wb") as file:
            np.savez(file, **arrays)  # type: ignore[arg-type]
            file.flush()
            os.fsync(file.fileno())
    except BaseException as error:
        discard(path)
        if isinstance(error, OSError):
            raise cannot_write(path, error) from error
        raise


def commit(path: Path) -> None:
    """Replace the checkpoint at `path` by the partial file that :func:`write_partial` wrote.

    Raises :class:`RunFolderError` if the system does not allow the replacement.
    """
    try:
        partial_of(path).replace(path)
    except OSError as error:
        raise cannot_write(path, error) from error


def discard(path: Path) -> None:
    """Remove the partial file that :func:`write_partial` wrote; keep the checkpoint at `path`."""
    with suppress(OSError):
        partial_of(path).unlink(missing_ok=True)


def read(path: Path, scene: object, device: wp.Device, precision: str) -> SavedState:
    """Return the contents of the checkpoint at `path`, which must belong to `scene` and to the installed versions.

    The `precision` and the kind of the device (CPU or GPU) must match, too. Raises :class:`RunFolderError` with the
    reason if the file is missing, damaged or does not match. A different processor only causes a warning, because
    results may then differ in the last bits.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = dict(file)
    except FileNotFoundError:
        raise RunFolderError(f"'{path}': does not exist; start the run again") from None
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile, zipfile.LargeZipFile) as error:
        raise RunFolderError(f"'{path}': is damaged or not a checkpoint; start the run again") from error
    if "text" not in arrays or "digest" not in arrays:
        raise RunFolderError(f"'{path}': is not a checkpoint of warpcrete; start the run again")
    wanted = arrays.pop("digest").tobytes()
    if _digest(arrays) != wanted:
        raise RunFolderError(f"'{path}': is damaged (its contents do not match its checksum); start the run again")
    text = json.loads(arrays.pop("text").tobytes())
    if text.get("warpcrete checkpoint") != FORMAT:
        stored = text.get("warpcrete checkpoint")
        raise RunFolderError(
            f"'{path}': has checkpoint format {stored!r}, but this version reads {FORMAT}; start the run again"
        )
    described = {"precision", "device", "scene", "processor"} <= text.keys()
    sections = is_dict(text.get("versions")) and is_dict(text.get("contents"))
    if not described or not sections or "run" not in text["contents"]:
        raise RunFolderError(f"'{path}': lacks data of the run, which another version may have written; start the run "
                             "again")  # fmt: skip
    if text["versions"] != versions():
        raise RunFolderError(
            f"'{path}': was written by {_shown(text['versions'])}, but {_shown(versions())} is installed; resume with "
            "the old versions, or start the run again"
        )
    for what, stored, here in (
        ("precision", text["precision"], precision),
        ("device", text["device"], _kind(device)),
        ("scene", text["scene"], fingerprint(scene)),
    ):
        if stored != here:
            shown = "another scene" if what == "scene" else f"{what} {stored!r}, not {here!r}"
            raise RunFolderError(
                f"'{path}': belongs to {shown}; resume with the settings with which the run was started"
            )
    if text["processor"] != processor():
        warnings.warn(
            f"'{path}': was written on {text['processor']}; the run continues on {processor()}, and results may differ "
            "in the last digits from those of an uninterrupted run",
            stacklevel=2,
        )
    return {key: _unflatten(value, arrays) for key, value in text["contents"].items()}


def remove(path: Path) -> None:
    """Remove the checkpoint at `path`, and the partial file that an interrupted write may have left."""
    path.unlink(missing_ok=True)
    discard(path)


def _kind(device: wp.Device) -> str:
    return "cuda" if device.is_cuda else "cpu"


def _shown(stored: dict[str, str]) -> str:
    return ", ".join(f"{name} {number}" for name, number in stored.items())


def _digest(arrays: dict[str, np.ndarray]) -> bytes:
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name}{array.dtype}{array.shape}".encode() + array.tobytes())
    return digest.digest()


def _flatten(value: object, name: str, arrays: dict[str, np.ndarray]) -> object:
    """Return `value` as JSON data that contains the names of arrays, and store the arrays in `arrays` by name.

    The name of an array is `name`, followed by the keys that lead to the array.
    """
    if is_host_array(value):
        arrays[name] = value
        return {"array": name}
    if is_dict(value):
        return {"items": {key: _flatten(item, f"{name}/{key}", arrays) for key, item in value.items()}}
    if is_numpy_number(value):
        item: object = value.item()
        return item
    return value


def _unflatten(value: object, arrays: dict[str, np.ndarray]) -> object:
    if not is_dict(value):
        return value
    stored: Record = value
    if "array" in stored:
        return arrays[stored["array"]]
    return {key: _unflatten(item, arrays) for key, item in stored["items"].items()}
