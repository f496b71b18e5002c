"""Fingerprints of scenes and their parts: equal contents have equal fingerprints in every process."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping
from types import BuiltinFunctionType, FunctionType
from typing import Any

import numpy as np


def fingerprint(value: Any) -> str:
    """Return the SHA-256 of a scene or of any part of a scene.

    The field `parameters` is left out, because the scene's other fields contain everything that the scene function made
    of its arguments.
    """
    digest = hashlib.sha256()
    _feed(digest, value)
    return digest.hexdigest()


def _feed(digest: Any, value: Any) -> None:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        digest.update(_name(value))
        for field in dataclasses.fields(value):
            if field.name != "parameters":
                digest.update(field.name.encode())
                _feed(digest, getattr(value, field.name))
    elif isinstance(value, np.ndarray):
        digest.update(f"{value.dtype}{value.shape}".encode() + np.ascontiguousarray(value).tobytes())
    elif isinstance(value, Mapping):
        for key, item in value.items():  # Keep the order: kinds of bonds are numbered by it.
            _feed(digest, key)
            _feed(digest, item)
    elif isinstance(value, list | tuple):
        digest.update(f"[{len(value)}".encode())
        for item in value:
            _feed(digest, item)
    elif isinstance(value, int | float | np.integer | np.floating):
        digest.update(_number(value))
    elif isinstance(value, type | FunctionType | BuiltinFunctionType):
        digest.update(_named(value))
    elif isinstance(value, str | None):
        digest.update(repr(value).encode())
    elif hasattr(value, "vertices") and hasattr(value, "faces"):
        # The parts of a trimesh mesh refer to each other, so hash its vertices and faces only.
        _feed(digest, [np.asarray(getattr(value, name)) for name in ("vertices", "faces")])
    else:
        digest.update(_name(value))
        _feed(digest, {k: v for k, v in vars(value).items() if not k.startswith("_")})


def _number(value: Any) -> bytes:
    """Return bytes that represent a number exactly.

    A whole number is written as a float if that is exact, because 1 and 1.0 are equal and need the same fingerprint.
    """
    if isinstance(value, int | np.integer):
        try:
            if int(float(value)) != int(value):
                return f"i{int(value):x}".encode()
        except OverflowError:
            return f"i{int(value):x}".encode()
    return float(value).hex().encode()


def _name(value: Any) -> bytes:
    """Return the full name of a value's type, because classes in different modules may share a class name."""
    return _named(type(value))


def _named(value: Any) -> bytes:
    return f"{value.__module__}.{value.__qualname__}".encode()
