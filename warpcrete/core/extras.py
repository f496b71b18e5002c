"""Check for optional packages that only some features need."""

from importlib.util import find_spec

from .errors import WarpcreteError


def needs_extra(extra: str, *packages: str) -> None:
    """Raise :class:`WarpcreteError` if one of the packages of the pip extra `extra` is not installed."""
    for package in packages:
        if find_spec(package) is None:
            raise WarpcreteError(
                f"{extra}: needs the package {package}, which is not installed; run pip install 'warpcrete[{extra}]'"
            )
