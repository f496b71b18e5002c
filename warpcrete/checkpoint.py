"""Checkpoints: everything that the next step depends on, in one file that is complete or not there."""

from __future__ import annotations

import hashlib
import json
import os
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from .errors import RunFolderError
from .model import Model
from .provenance import fingerprint, versions
from .state import BodyTable, State, placed_bodies

FORMAT = 2
NUMBERS = (
    "body_count",
    "sphere_count",
    "largest_radius",
    "smallest_radius",
    "mean_radius",
    "total_mass",
    "pair_total",
    "chunks",
)
TRANSIENT = ("force", "moment")  # zero between two steps


def save(path: Path, model: Model, state: State, precision: str, memory: dict[str, Any]) -> None:
    """Write a checkpoint beside `path`, then rename it: an interrupted write leaves the one before.

    `memory` holds numbers, text, arrays and dictionaries of them.
    """
    arrays: dict[str, np.ndarray] = {}
    for name, array in vars(state).items():
        if isinstance(array, wp.array) and name not in TRANSIENT:
            arrays[f"state/{name}"] = array.numpy()[: max(state.pair_total, 1)] if _is_pair(name) else array.numpy()
    write(path, model.scene, model.device, precision, arrays, {name: getattr(state, name) for name in NUMBERS}, memory)


def write(
    path: Path, scene: Any, device, precision: str, arrays: dict[str, np.ndarray], numbers: dict[str, Any],
    memory: dict[str, Any],
) -> None:  # fmt: skip
    """Write `arrays`, `numbers` and `memory` of a state, and what they belong to, beside `path`; then rename."""
    text = {
        "warpcrete checkpoint": FORMAT,
        "scene": fingerprint(scene),
        "device": "cuda" if device.is_cuda else "cpu",
        "precision": precision,
        "versions": versions(),
        "state": numbers,
        "memory": _flatten(memory, "memory", arrays),
    }
    arrays["text"] = np.frombuffer(json.dumps(text).encode(), dtype=np.uint8)
    arrays["digest"] = np.frombuffer(_digest(arrays), dtype=np.uint8)
    partial = _partial(path)
    with partial.open("wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)


def load(path: Path, model: Model, precision: str) -> tuple[State, dict[str, Any]]:
    """State and memory of a checkpoint of the same scene, precision and kind of device.

    Raises :class:`RunFolderError` with the reason for any other file.
    """
    arrays, numbers, memory = read(path, model.scene, model.device, precision)
    return _restored(model, arrays, numbers), memory


def read(
    path: Path, scene: Any, device, precision: str
) -> tuple[dict[str, np.ndarray], dict[str, Any], dict[str, Any]]:
    """What :func:`write` was given, if it belongs to the same scene, kind of device, precision and versions."""
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = dict(file)
    except FileNotFoundError:
        raise RunFolderError(f"'{path}': there is no checkpoint") from None
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile, zipfile.LargeZipFile) as error:
        raise RunFolderError(f"'{path}': is damaged or no checkpoint ({error}); start the run anew") from error
    if "text" not in arrays or "digest" not in arrays:
        raise RunFolderError(f"'{path}': is not a checkpoint of warpcrete")
    wanted = arrays.pop("digest").tobytes()
    if _digest(arrays) != wanted:
        raise RunFolderError(f"'{path}': is damaged (its contents do not match its digest); start the run anew")
    text = json.loads(arrays.pop("text").tobytes())
    if text.get("warpcrete checkpoint") != FORMAT:
        found = text.get("warpcrete checkpoint")
        raise RunFolderError(f"'{path}': has checkpoint format {found!r}, this version reads {FORMAT}")
    if text["versions"] != versions():
        raise RunFolderError(
            f"'{path}': was written by {_shown(text['versions'])}, here is {_shown(versions())}; resume with those "
            "versions, or start the run anew"
        )
    for what, found, here in (
        ("precision", text["precision"], precision),
        ("device", text["device"], "cuda" if device.is_cuda else "cpu"),
        ("scene", text["scene"], fingerprint(scene)),
    ):
        if found != here:
            shown = "another scene" if what == "scene" else f"{what} {found!r}, not {here!r}"
            raise RunFolderError(f"'{path}': belongs to {shown}; resume with what the run was started with")
    return arrays, text["state"], _unflatten(text["memory"], arrays)


def _restored(model: Model, arrays: dict[str, np.ndarray], numbers: dict[str, Any]) -> State:
    scene = model.scene
    table = BodyTable.empty()
    if scene.fill is not None:
        table.templates = tuple(scene.fill.templates)
    state = State(model, BodyTable.empty())
    state.templates = table.joined(placed_bodies(scene)).templates
    for name, value in numbers.items():
        setattr(state, name, value)
    for name in [n for n, a in vars(state).items() if isinstance(a, wp.array)]:
        array = getattr(state, name)
        if name in TRANSIENT:
            setattr(state, name, wp.zeros(state.sphere_count, dtype=array.dtype, device=model.device))
            continue
        data = arrays[f"state/{name}"]
        if data.size == 0:
            setattr(state, name, wp.zeros(data.shape[: array.ndim], dtype=array.dtype, device=model.device))
        else:
            setattr(state, name, wp.array(data, dtype=array.dtype, ndim=array.ndim, device=model.device))
    return state


def remove(path: Path) -> None:
    """Remove a checkpoint, and what an interrupted write of one left."""
    path.unlink(missing_ok=True)
    _partial(path).unlink(missing_ok=True)


def _partial(path: Path) -> Path:
    return path.with_name(path.name + ".partial")


def _shown(found: dict[str, str]) -> str:
    return ", ".join(f"{name} {number}" for name, number in found.items())


def _is_pair(name: str) -> bool:
    return name.startswith("pair_") and name != "pair_start"


def _digest(arrays: dict[str, np.ndarray]) -> bytes:
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name}{array.dtype}{array.shape}".encode() + array.tobytes())
    return digest.digest()


def _flatten(value: Any, name: str, arrays: dict[str, np.ndarray]) -> Any:
    """JSON of `value`; arrays in it go to `arrays` and leave their name."""
    if isinstance(value, np.ndarray):
        arrays[name] = value
        return {"array": name}
    if isinstance(value, dict):
        return {"items": {key: _flatten(item, f"{name}/{key}", arrays) for key, item in value.items()}}
    if isinstance(value, np.generic):
        return value.item()
    return value


def _unflatten(value: Any, arrays: dict[str, np.ndarray]) -> Any:
    if isinstance(value, dict):
        if "array" in value:
            return arrays[value["array"]]
        return {key: _unflatten(item, arrays) for key, item in value["items"].items()}
    return value
