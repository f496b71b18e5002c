"""Amounts as people write them, `30 m3/h` or `125 mm`, in SI units."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np

from .errors import refuse

LARGEST = 1e300
"""Beyond any amount."""

UNITS = {
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "km": 1e3, "in": 0.0254, "ft": 0.3048},
    "m3/s": {"m3/s": 1.0, "m3/h": 1 / 3600, "m³/h": 1 / 3600, "l/s": 1e-3, "L/s": 1e-3, "l/min": 1e-3 / 60,
             "L/min": 1e-3 / 60},
    "Pa": {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "bar": 1e5},
    "degrees": {"degrees": 1.0, "deg": 1.0, "°": 1.0, "rad": 180 / math.pi},
}  # fmt: skip
"""By the unit in which the program has an amount, what one of each unit that people write is in it."""


def amount(field: str, given: Any, unit: str) -> float:
    """A number in `unit`, one of :data:`UNITS`, or a text of a number and a unit of the same kind, in `unit`.

    Raises :class:`SceneError` for anything else.
    """
    known = UNITS[unit]
    if isinstance(given, str):
        found = re.fullmatch(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S*)\s*", given)
        if found is None or (found[2] and found[2] not in known):
            refuse(field, given, f"must be a number with one of {', '.join(known)}", f"without one it is in {unit}")
        return float(found[1]) * known[found[2] or unit]
    numbers = int | float | np.integer | np.floating
    if isinstance(given, bool) or not isinstance(given, numbers) or not abs(given) < LARGEST:
        refuse(field, given, f"must be a number with one of {', '.join(known)}", f"without one it is in {unit}")
    return float(given)
