"""Provenance of a run, such as versions and processor, and hashes that show whether two results are identical."""

from __future__ import annotations

import functools
import hashlib
import platform
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import warp as wp

from .version import version_of


def provenance(device: wp.Device, precision: str, seed: int) -> dict[str, object]:
    """Return the versions, the device and the settings on which the results of a run depend."""
    return {
        **versions(),
        "numpy": np.__version__,
        "python": platform.python_version(),
        "machine": platform.machine(),
        "device": str(device),
        "device_name": device.name,  # pyright: ignore[reportUnknownMemberType]
        "processor": processor(),
        "compiler_flags": None if device.is_cuda else wp.config.cpu_compiler_flags,
        "precision": precision,
        "seed": seed,
    }


def versions() -> dict[str, str]:
    """Return the versions of the packages that compute the results, warpcrete and Warp."""
    return {"warpcrete": version_of("warpcrete"), "warp": version_of("warp-lang")}


@functools.cache
def processor() -> str:
    """Return the model name of the CPU.

    Warp compiles CPU kernels for this model (`-march=native`), so the last bits of results depend on it.
    """
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    model = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")
    return model or platform.processor() or platform.machine()


def arrays_hash(arrays: Mapping[str, np.ndarray]) -> str:
    """Return the SHA-256 of named arrays, in the order of their names."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        digest.update(name.encode() + np.ascontiguousarray(arrays[name]).tobytes())
    return digest.hexdigest()
