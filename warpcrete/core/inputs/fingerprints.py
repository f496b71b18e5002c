"""Fingerprints of scenes and their parts: equal contents have equal fingerprints in every process."""

import dataclasses
import hashlib
from collections.abc import Callable
from numbers import Integral
from types import BuiltinFunctionType, FunctionType
from typing import SupportsFloat

import numpy as np

from ..narrowing import is_host_array, is_list_or_tuple, is_mapping, is_number


def fingerprint(value: object) -> str:
    """Return the SHA-256 of a scene or of any part of a scene.

    The scene's field `parameters` is left out. It holds the arguments from which the scene was made, and the other
    fields already contain everything that follows from them.
    """
    digest = hashlib.sha256()
    _feed(digest.update, value)
    return digest.hexdigest()


class EqualByContent:
    """Base of dataclasses with arrays: objects are equal if they have the same class and the same contents.

    The comparison that Python adds to dataclasses fails for arrays, so derived classes need `eq=False`.
    """

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and fingerprint(other) == fingerprint(self)

    def __hash__(self) -> int:
        return hash(fingerprint(self))


def _feed(update: Callable[[bytes], None], value: object) -> None:
    """Pass the bytes of a value, piece by piece, to the function `update` of a hash."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        update(_name(value))
        for field in dataclasses.fields(value):
            if field.name != "parameters":
                update(field.name.encode())
                _feed(update, getattr(value, field.name))
    elif is_host_array(value):
        update(f"{value.dtype}{value.shape}".encode() + np.ascontiguousarray(value).tobytes())
    elif is_mapping(value):
        # Do not sort the entries. Their order determines the numbers of the kinds of bonds, so another order must give
        # another fingerprint.
        for key, item in value.items():
            _feed(update, key)
            _feed(update, item)
    elif is_list_or_tuple(value):
        update(f"[{len(value)}".encode())
        for item in value:
            _feed(update, item)
    elif isinstance(value, bool) or is_number(value):
        update(_number(value))
    elif isinstance(value, type | FunctionType | BuiltinFunctionType):
        update(_named(value))
    elif isinstance(value, str | None):
        update(repr(value).encode())
    elif hasattr(value, "vertices") and hasattr(value, "faces"):
        # Hash only the vertices and faces of a trimesh mesh: its attributes refer to each other in a cycle.
        _feed(update, [np.asarray(getattr(value, name)) for name in ("vertices", "faces")])
    else:
        update(_name(value))
        _feed(update, {k: v for k, v in vars(value).items() if not k.startswith("_")})


def _number(value: SupportsFloat) -> bytes:
    """Return bytes that represent a number exactly.

    A whole number is written as a float if that is exact, because 1 and 1.0 are equal and need the same fingerprint.
    """
    if isinstance(value, Integral):
        try:
            if int(float(value)) != int(value):
                return f"i{int(value):x}".encode()
        except OverflowError:
            return f"i{int(value):x}".encode()
    return float(value).hex().encode()


def _name(value: object) -> bytes:
    """Return the full name of a value's type, because classes in different modules may share a class name."""
    return _named(type(value))


def _named(value: type | FunctionType | BuiltinFunctionType) -> bytes:
    return f"{value.__module__}.{value.__qualname__}".encode()
