"""Where a run computes: devices, their memory and cores, the two precisions, and the two ways of sharing out work."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import warp as wp

from .errors import DeviceError, one_of, refuse

PRECISIONS = ("float32", "float64")
SCALARS = dict(zip(PRECISIONS, (wp.float32, wp.float64), strict=True))
MEMORY_FRACTION = 0.9
"""Of the memory that is free, what a run may take."""

_every_device_parallel = False


def parallel(device: Any) -> bool:
    """Whether work on a device is shared out as on a GPU: a task for each body, which no other task may wait for.

    Otherwise, on a CPU, a few tasks go through many bodies each. Full neighbour lists, launch sizes, graphs and the
    parallel solver all follow from this.
    """
    return bool(device.is_cuda) or _every_device_parallel


@contextmanager
def share_out_like_a_gpu() -> Iterator[None]:
    """Let a CPU take every way that a GPU takes, as far as it can: slow, for tests where there is no GPU."""
    global _every_device_parallel
    before, blocks = _every_device_parallel, wp.config.enable_cpu_blocks
    _every_device_parallel = wp.config.enable_cpu_blocks = True
    try:
        yield
    finally:
        _every_device_parallel, wp.config.enable_cpu_blocks = before, blocks


def find_device(name: str | None) -> Any:
    """Warp device by name (`cpu`, `cuda`, `cuda:0`), or :class:`DeviceError`; None takes a GPU if there is one."""
    quiet_init()
    available = [str(device) for device in wp.get_devices()]
    if name is None:
        return wp.get_device("cuda:0" if wp.is_cuda_available() else "cpu")
    if name.startswith("cuda") and not wp.is_cuda_available():
        raise DeviceError(f"device = {name!r}: no usable CUDA GPU was found; use one of {', '.join(available)}")
    try:
        return wp.get_device(name)
    except ValueError as error:
        raise DeviceError(f"device = {name!r}: must be one of {', '.join(available)}") from error


def quiet_init() -> None:
    """Start Warp without its banner, its compile notes and, where there is no NVIDIA driver, its warning of that."""
    wp.config.log_level = wp.LOG_ERROR
    try:
        ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
        wp.init()
        return
    except OSError:
        pass
    # Warp's native code writes that warning to the process's standard error, whatever its settings.
    sys.stderr.flush()
    kept, sink = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(sink, 2)
        wp.init()
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(sink)


def scalar_of(precision: str) -> Any:
    """Warp's scalar type of a precision, or :class:`SceneError`."""
    one_of("precision", precision, PRECISIONS)
    return SCALARS[precision]


def default_threads() -> int:
    """CPU cores that this process may use, by its affinity and its container's quota."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    try:
        quota, period = Path("/sys/fs/cgroup/cpu.max").read_text(encoding="utf-8").split()
        cores = min(cores, max(1, int(quota) // int(period)))
    except (OSError, ValueError):  # no such file, or no quota
        pass
    return cores


def checked_threads(threads: int | None) -> int:
    """A number of threads that this machine has cores for; None takes all of them."""
    if threads is None:
        return default_threads()
    cores = os.cpu_count() or 1
    if not 1 <= threads <= cores:
        refuse("threads", threads, f"must be in [1, {cores}], the number of cores of this machine")
    return threads


def memory_free(device: Any) -> float:
    """Memory that is free on a device [B]."""
    if device.is_cuda:
        return float(device.free_memory)
    try:
        with open("/proc/meminfo", encoding="utf-8") as file:
            for line in file:
                if line.startswith("MemAvailable"):
                    return 1024.0 * float(line.split()[1])
    except OSError:
        pass
    try:
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, ValueError, OSError):
        return float("inf")
