"""Provenance of a run, such as versions and processor, and hashes that show whether two results are identical."""

import functools
import hashlib
import platform
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import warp as wp

from .version import version_of

CPU_INFO = Path("/proc/cpuinfo")
"""File in which Linux describes the CPU."""


def provenance(device: wp.Device, precision: str, seed: int, threads: int | None = None) -> dict[str, object]:
    """Return the versions, the device and the settings on which the results of a run depend.

    The entry `threads` is left out if `threads` is None, and the entry `processor_features` is left out if the features
    are not known.
    """
    features = processor_features()
    return {
        **versions(),
        "numpy": np.__version__,
        "python": platform.python_version(),
        "machine": platform.machine(),
        "device": str(device),
        "device_name": device.name,  # pyright: ignore[reportUnknownMemberType]
        "processor": processor(),
        **({"processor_features": features} if features else {}),
        **({"threads": threads} if threads is not None else {}),
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
    return _cpu_entry("model name") or platform.processor() or platform.machine()


@functools.cache
def processor_features() -> str:
    """Return a short hash of the CPU's features, or an empty text if the system does not list them.

    Different CPU models may share one name, for example in a virtual machine. Warp compiles CPU kernels for these
    features.
    """
    features = _cpu_entry("flags") or _cpu_entry("Features")  # On ARM, Linux lists the features under "Features".
    return hashlib.sha256(" ".join(sorted(features.split())).encode()).hexdigest()[:16] if features else ""


def _cpu_entry(name: str) -> str:
    """Return the entry `name` of the first CPU in /proc/cpuinfo, or an empty text if there is no such entry."""
    try:
        lines = CPU_INFO.read_text(encoding="utf-8").splitlines()
    except OSError:
        return ""
    pairs = (line.partition(":") for line in lines)
    return next((value.strip() for key, _, value in pairs if key.strip() == name), "")


def arrays_hash(arrays: Mapping[str, np.ndarray]) -> str:
    """Return the SHA-256 of named arrays, in the order of their names."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        digest.update(name.encode() + np.ascontiguousarray(arrays[name]).tobytes())
    return digest.hexdigest()
