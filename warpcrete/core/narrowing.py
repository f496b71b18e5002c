"""Functions that check the type of a value, so that type checkers know the type afterwards.

The functions do not check the types of the elements of lists and mappings.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import NDArray


def is_mapping(value: object) -> TypeGuard[Mapping[object, object]]:
    """Return whether a value is a mapping."""
    return isinstance(value, Mapping)


def is_dict(value: object) -> TypeGuard[dict[str, object]]:
    """Return whether a value is a dictionary; its keys are assumed to be texts, as in JSON, YAML and checkpoints."""
    return isinstance(value, dict)


def is_list_or_tuple(value: object) -> TypeGuard[list[object] | tuple[object, ...]]:
    """Return whether a value is a list or a tuple."""
    return isinstance(value, list | tuple)


def is_set(value: object) -> TypeGuard[set[object]]:
    """Return whether a value is a set."""
    return isinstance(value, set)


def is_number(value: object) -> TypeGuard[float]:
    """Return whether a value is a number of Python or NumPy; True and False do not count as numbers."""
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)


def is_host_array(value: object) -> TypeGuard[NDArray[Any]]:
    """Return whether a value is a NumPy array."""
    return isinstance(value, np.ndarray)


def is_numpy_number(value: object) -> TypeGuard[np.generic[Any]]:
    """Return whether a value is a NumPy scalar: a number, a text or a truth value."""
    return isinstance(value, np.generic)
