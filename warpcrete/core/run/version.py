"""Functions that return the versions of installed packages."""

import functools
from importlib.metadata import PackageNotFoundError, version


@functools.cache
def version_of(package: str) -> str:
    """Return the version of a package, or the text "source tree, not installed"."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "source tree, not installed"
