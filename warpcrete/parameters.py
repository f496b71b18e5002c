"""Parameters of scene functions: checked against their annotations before anything else sees them."""

from __future__ import annotations

import functools
import inspect
import types
from collections.abc import Callable
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np

from .errors import refuse


def kind_and_help(annotation: Any) -> tuple[Any, bool, str]:
    """Type, whether None is allowed, and help text of `Annotated[type | None, text]`."""
    kind, text = get_args(annotation)
    optional = get_origin(kind) in (Union, types.UnionType)
    if optional:
        kind = next(k for k in get_args(kind) if k is not type(None))
    return kind, optional, text


def checked(function: Callable) -> Callable:
    """Decorator: refuse arguments of another type than annotated; NumPy numbers become Python's, ints floats.

    Every parameter must be annotated as `Annotated[type, help]` or `Annotated[type | None, help]`.
    """
    hints = get_type_hints(function, include_extras=True)
    signature = inspect.signature(function)

    @functools.wraps(function)
    def wrapper(*args: Any, **kwargs: Any) -> Any:
        try:
            bound = signature.bind(*args, **kwargs)
        except TypeError as error:
            refuse("parameters", sorted(kwargs), str(error), f"known are {', '.join(signature.parameters)}")
        for name, value in bound.arguments.items():
            bound.arguments[name] = _converted(name, value, *kind_and_help(hints[name])[:2])
        return function(*bound.args, **bound.kwargs)

    return wrapper


def _converted(name: str, value: Any, kind: Any, optional: bool) -> Any:
    if isinstance(value, np.generic):
        value = value.item()
    if value is None and optional:
        return None
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if kind is str and hasattr(value, "__fspath__"):
        return str(value)
    if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
        words = {float: "a number", int: "a whole number", str: "text", bool: "True or False"}[kind]
        refuse(name, value, f"must be {words}{' or None' if optional else ''}")
    return value
