"""Devices of a run: their memory and cores, the two floating-point precisions, and how work is divided on them."""

import ctypes
import os
import sys
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import warp as wp

from ..errors import DeviceError, one_of, quoted, refuse
from ..narrowing import is_number
from .arrays import Scalar
from .kernel_files import kernel_cache_errors

PRECISIONS = ("float32", "float64")
SCALARS: dict[str, Scalar] = dict(zip(PRECISIONS, (wp.float32, wp.float64), strict=True))
MEMORY_FRACTION = 0.9
"""Fraction of the free memory that a run may use."""

_every_device_parallel = False


def parallel(device: wp.Device) -> bool:
    """Return whether work on a device is divided as on a GPU: into one independent task per body.

    If the result is False, a few tasks on a CPU loop over many bodies each. The result also decides which kind of
    neighbour lists and which solver a run uses, how large its kernel launches are, and how its launch graphs are built.
    """
    return bool(device.is_cuda) or _every_device_parallel


@contextmanager
def divide_work_like_gpu() -> Generator[None]:
    """Make the CPU divide work as a GPU does, as far as the CPU can, inside the `with` block.

    In this way, tests can run the GPU's code on a machine without a GPU, but slowly.
    """
    global _every_device_parallel
    before, blocks = _every_device_parallel, wp.config.enable_cpu_blocks
    _every_device_parallel = wp.config.enable_cpu_blocks = True
    try:
        yield
    finally:
        _every_device_parallel, wp.config.enable_cpu_blocks = before, blocks


def find_device(name: str | None) -> wp.Device:
    """Return the Warp device that `name` selects (`cpu`, `cuda`, `cuda:0`); None selects a GPU if there is one.

    Raises :class:`DeviceError` if there is no such device.
    """
    if not _is_text_or_none(name):
        raise DeviceError(f"device = {quoted(name)}: must be text, such as 'cpu' or 'cuda:0', or None")
    quiet_init()
    available = [str(device) for device in wp.get_devices()]
    if name is None:
        return wp.get_device("cuda:0" if wp.is_cuda_available() else "cpu")
    if name.startswith("cuda") and not wp.is_cuda_available():
        raise DeviceError(
            f"device = {name!r}: no usable CUDA GPU was found on this machine; use one of {', '.join(available)}"
        )
    try:
        return wp.get_device(name)
    except ValueError as error:
        raise DeviceError(f"device = {name!r}: must be one of {', '.join(available)}") from error


def _is_text_or_none(value: object) -> bool:
    return value is None or isinstance(value, str)


def quiet_init() -> None:
    """Start Warp without its banner, its compile messages and its warning about a missing NVIDIA driver."""
    wp.config.log_level = wp.LOG_ERROR
    try:
        ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
        saved_stderr = None
    except OSError:
        saved_stderr = _copy_of_stderr()
    if saved_stderr is None:
        _init()
        return
    # Warp's native code writes its driver warning directly to the process's standard error, regardless of settings, so
    # redirect standard error for a moment.
    sink = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(sink, 2)
        _init()
    finally:
        os.dup2(saved_stderr, 2)
        os.close(saved_stderr)
        os.close(sink)


def _copy_of_stderr() -> int | None:
    """Return a new file descriptor for standard error, or None if the program has no standard error."""
    if sys.stderr is not None:
        sys.stderr.flush()
    try:
        return os.dup(2)
    except OSError:
        return None


def _init() -> None:
    with kernel_cache_errors():
        wp.init()


def scalar_of(precision: str) -> Scalar:
    """Return Warp's scalar type for a precision; raises :class:`SceneError` for an unknown precision."""
    one_of("precision", precision, PRECISIONS)
    return SCALARS[precision]


def default_threads() -> int:
    """Return the number of CPU cores that this process may use, given its CPU affinity and its container's quota."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    try:
        quota, period = Path("/sys/fs/cgroup/cpu.max").read_text(encoding="utf-8").split()
        cores = min(cores, max(1, int(quota) // int(period)))
    except (OSError, ValueError):  # No CPU quota is set.
        pass
    return cores


def checked_threads(threads: int | None) -> int:
    """Return `threads`, or the number of usable cores if `threads` is None.

    Raises :class:`SceneError` if `threads` is below 1 or exceeds the number of cores of the machine.
    """
    if threads is None:
        return default_threads()
    cores = os.cpu_count() or 1
    if not is_number(threads) or not 1 <= threads <= cores or int(threads) != threads:
        refuse("threads", threads, f"must be a whole number from 1 to {cores}, the number of cores of this machine")
    return int(threads)


def memory_free(device: wp.Device) -> float:
    """Return the free memory of a device [B].

    For a CPU, this is the available main memory. If the system does not report it, return the total main memory or, if
    this is unknown too, infinity.
    """
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
