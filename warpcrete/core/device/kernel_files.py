"""Files of compiled kernels: which ones a block of code uses, errors in using them, and the time to make them."""

import errno
import threading
import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import warp as wp

from ..errors import DeviceError, DiskFullError, is_full
from .arrays import KernelModule

_open_blocks: list[set[KernelModule]] = []
"""Modules that were loaded or launched so far, in one set for each open `with` block of :func:`kernel_files`."""


@contextmanager
def kernel_files() -> Generator[set[Path]]:
    """Collect the files of all compiled kernels that the `with` block uses, whether or not it has compiled them.

    The set is complete at the end of the block.
    """
    files: set[Path] = set()
    modules: set[KernelModule] = set()
    _open_blocks.append(modules)
    try:
        yield files
    finally:
        _open_blocks[:] = [each for each in _open_blocks if each is not modules]
        files |= {Path(code.binary_path) for each in modules for code in each.execs.values() if code.binary_path}


class _Loading(threading.local):
    seconds = 0.0
    """Wall time in which this thread has compiled or loaded kernels [s]."""


_loading = _Loading()


def run_clock() -> float:
    """Return a reading of the wall clock [s] that stands still while this thread compiles or loads kernels."""
    return time.perf_counter() - _loading.seconds


@contextmanager
def stop_run_clock() -> Generator[None]:
    """Stop the clock of this thread, :func:`run_clock`, inside the `with` block, which compiles or loads kernels."""
    begun = run_clock()
    try:
        yield
    finally:
        _loading.seconds += run_clock() - begun


@contextmanager
def kernel_cache_errors() -> Generator[None]:
    """Raise :class:`DeviceError` if the `with` block cannot read or write Warp's files of compiled kernels.

    If the disk is full, raise :class:`DiskFullError` instead, so that the run reports a full disk as its reason to end.
    """
    try:
        yield
    except OSError as error:
        raise (DiskFullError if is_full(error) else DeviceError)(kernel_cache_problem(error)) from error


def kernel_cache_problem(error: OSError) -> str:
    """Return the message for an `error` in reading or writing Warp's files of compiled kernels."""
    verb = "written" if is_full(error) or error.errno == errno.EROFS else "used"
    return (
        f"kernel cache = '{error.filename or wp.config.kernel_cache_dir}': cannot be {verb} "
        f"({error.strerror or error}); set the environment variable WARP_CACHE_PATH to a folder in which files can "
        "be written"
    )


def in_kernel_cache(error: OSError) -> bool:
    """Return whether an error concerns one of Warp's files of compiled kernels."""
    folder = wp.config.kernel_cache_dir
    return bool(folder and error.filename) and str(error.filename).startswith(str(folder))


def note_use(module: KernelModule) -> None:
    """Register `module`, whose kernels are loaded or launched, in all open :func:`kernel_files` blocks."""
    for modules in _open_blocks:
        modules.add(module)
