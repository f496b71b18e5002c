"""Functions that return the versions of installed packages."""

import functools
from importlib.metadata import PackageNotFoundError, version


@functools.cache
def version_of(package: str) -> str:
    """Return the version of an installed package; if it is not installed, return a text that says so."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "source tree, not installed"
