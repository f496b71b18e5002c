"""Versions of installed packages."""

from __future__ import annotations

import functools
from importlib.metadata import PackageNotFoundError, version


@functools.cache
def version_of(package: str) -> str:
    """As its metadata have it; words where there are none."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "source tree, not installed"
