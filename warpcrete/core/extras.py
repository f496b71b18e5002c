"""Packages that only some of the work needs."""

from __future__ import annotations

from importlib.util import find_spec

from .errors import WarpcreteError


def needs_extra(extra: str, *packages: str) -> None:
    """Raise :class:`WarpcreteError` where a package of an extra is not installed."""
    for package in packages:
        if find_spec(package) is None:
            raise WarpcreteError(f"{extra}: needs the package {package}; run pip install 'warpcrete[{extra}]'")
