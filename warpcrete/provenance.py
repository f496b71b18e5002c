"""Where a run comes from, and whether two are the same: versions, fingerprints, hashes, JSON files."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import platform
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from .probes import listed_pairs
from .state import State


def provenance(device, precision: str, seed: int) -> dict[str, Any]:
    """Versions, device and settings that a run depends on."""
    return {
        **versions(),
        "numpy": np.__version__,
        "python": platform.python_version(),
        "machine": platform.machine(),
        "device": str(device),
        "device_name": device.name,
        "precision": precision,
        "seed": seed,
    }


def versions() -> dict[str, str]:
    """Of the packages that compute."""
    return {"warpcrete": _version("warpcrete"), "warp": _version("warp-lang")}


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "source tree, not installed"


def fingerprint(value: Any) -> str:
    """SHA-256 of a scene or any part of one: equal for equal contents, whatever the process."""
    digest = hashlib.sha256()
    _feed(digest, value)
    return digest.hexdigest()


def _feed(digest, value: Any) -> None:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        law = getattr(value, "law", "")  # of a contact law: a file's name, or a function
        digest.update(f"{type(value).__qualname__}{getattr(law, '__qualname__', law)}".encode())
        for field in dataclasses.fields(value):
            if field.name not in ("notes", "parameters"):
                digest.update(field.name.encode())
                _feed(digest, getattr(value, field.name))
    elif isinstance(value, np.ndarray):
        digest.update(f"{value.dtype}{value.shape}".encode() + np.ascontiguousarray(value).tobytes())
    elif isinstance(value, Mapping):
        for key, item in value.items():  # in their order, which numbers the kinds of bonds
            _feed(digest, key)
            _feed(digest, item)
    elif isinstance(value, list | tuple):
        digest.update(f"[{len(value)}".encode())
        for item in value:
            _feed(digest, item)
    elif isinstance(value, int | float | np.integer | np.floating):
        digest.update(float(value).hex().encode())
    elif isinstance(value, str | None):
        digest.update(repr(value).encode())
    else:
        digest.update(type(value).__qualname__.encode())
        _feed(digest, {k: v for k, v in vars(value).items() if not k.startswith("_")})


def state_hash(state: State) -> str:
    """SHA-256 of bodies, contacts, bonds, walls and clock, in the order of permanent numbers.

    Two states with the same hash hold the same bits in all that moves them, however their bodies lie in memory.
    """
    digest = hashlib.sha256()
    order = np.argsort(state.body_id.numpy())
    for name in ("position", "rounding", "velocity", "spin", "orientation", "angular_momentum", "size", "mass"):
        digest.update(np.ascontiguousarray(getattr(state, f"body_{name}").numpy()[order]).tobytes())
    i, j, place = listed_pairs(state)
    ids = state.sphere_id.numpy()
    position = state.sphere_position.numpy()
    reach = position[i, 3] + position[j, 3]
    kept = np.linalg.norm(position[i, :3] - position[j, :3], axis=1) < reach
    if state.model.features.bonds:
        kept |= state.pair_bond.numpy()[place] != 0
    low, high = np.minimum(ids[i], ids[j])[kept], np.maximum(ids[i], ids[j])[kept]
    ranks = np.lexsort([high, low])
    digest.update(np.stack([low, high])[:, ranks].astype(np.int32).tobytes())
    chosen = place[kept][ranks]
    if state.model.features.history:
        digest.update(state.pair_history.numpy()[chosen].tobytes())
    if state.model.features.bonds:
        for array in (state.pair_bond, state.pair_bond_force, state.pair_bond_moment):
            digest.update(array.numpy()[chosen].tobytes())
    by_sphere = np.argsort(ids)
    for array in (state.slot_history, state.slot_normal, state.slot_overlap, state.slot_wall):
        if len(array) == 0:
            continue
        digest.update(np.ascontiguousarray(array.numpy()[by_sphere]).tobytes())
    for array in (
        state.wall_position_exact, state.wall_velocity_exact, state.wall_orientation, state.wall_spin,
        state.wall_impulse, state.wall_travel, state.wall_work,
    ):  # fmt: skip
        digest.update(array.numpy().tobytes())
    digest.update(state.clock.numpy()[0, :3].tobytes())  # time and step sizes
    return digest.hexdigest()


def arrays_hash(arrays: Mapping[str, np.ndarray]) -> str:
    """SHA-256 of named arrays, in the order of their names."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        digest.update(name.encode() + np.ascontiguousarray(arrays[name]).tobytes())
    return digest.hexdigest()


def write_json(path: Path, data: Any) -> None:
    """Write beside, then rename: a reader never sees half a file."""
    partial = path.with_name(path.name + ".partial")
    partial.write_text(json.dumps(_finite(data), indent=2, allow_nan=False) + "\n")
    partial.replace(path)


def _finite(data: Any) -> Any:
    # JSON has no word for NaN: what was not measured is null.
    if isinstance(data, dict):
        return {key: _finite(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_finite(value) for value in data]
    if isinstance(data, float) and not np.isfinite(data):
        return None
    return data
