"""Where a run comes from, and whether two are the same: versions, processor, fingerprints, hashes."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import platform
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from .version import version_of


def provenance(device: Any, precision: str, seed: int) -> dict[str, Any]:
    """Versions, device and settings that a run depends on."""
    return {
        **versions(),
        "numpy": np.__version__,
        "python": platform.python_version(),
        "machine": platform.machine(),
        "device": str(device),
        "device_name": device.name,
        "processor": processor(),
        "compiler_flags": None if device.is_cuda else wp.config.cpu_compiler_flags,
        "precision": precision,
        "seed": seed,
    }


def versions() -> dict[str, str]:
    """Of the packages that compute."""
    return {"warpcrete": version_of("warpcrete"), "warp": version_of("warp-lang")}


@functools.cache
def processor() -> str:
    """Model of the CPU. Kernels of the CPU are compiled for it (Warp's `-march=native`), so their bits belong to it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    model = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")
    return model or platform.processor() or platform.machine()


def fingerprint(value: Any) -> str:
    """SHA-256 of a scene or any part of one: equal for equal contents, whatever the process.

    Only the arguments of the scene function are left out: what they made is all there.
    """
    digest = hashlib.sha256()
    _feed(digest, value)
    return digest.hexdigest()


def _feed(digest: Any, value: Any) -> None:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        digest.update(type(value).__qualname__.encode())
        for field in dataclasses.fields(value):
            if field.name != "parameters":
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
    elif hasattr(value, "vertices") and hasattr(value, "faces"):  # a mesh of trimesh, whose parts refer to each other
        _feed(digest, [np.asarray(getattr(value, name)) for name in ("vertices", "faces")])
    else:
        digest.update(type(value).__qualname__.encode())
        _feed(digest, {k: v for k, v in vars(value).items() if not k.startswith("_")})


def arrays_hash(arrays: Mapping[str, np.ndarray]) -> str:
    """SHA-256 of named arrays, in the order of their names."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        digest.update(name.encode() + np.ascontiguousarray(arrays[name]).tobytes())
    return digest.hexdigest()
