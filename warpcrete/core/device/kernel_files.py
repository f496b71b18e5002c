"""Files of the compiled kernels that a block of code uses."""

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

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


def note_use(module: KernelModule) -> None:
    """Note that the kernels of `module` are loaded or launched, for :func:`kernel_files`."""
    for modules in _open_blocks:
        modules.add(module)
