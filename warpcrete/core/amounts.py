"""Amounts as people write them, `30 m3/h` or `125 mm`, in SI units."""

from __future__ import annotations

import math
import re
from contextlib import suppress
from typing import Any

import numpy as np

from .errors import refuse

NUMBERS = (int, float, np.integer, np.floating)
UNITS = {
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "km": 1e3, "in": 0.0254, "ft": 0.3048},
    "m3/s": {"m3/s": 1.0, "m3/h": 1 / 3600, "m³/h": 1 / 3600, "l/s": 1e-3, "L/s": 1e-3, "l/min": 1e-3 / 60,
             "L/min": 1e-3 / 60},
    "Pa": {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "bar": 1e5},
    "degrees": {"degrees": 1.0, "deg": 1.0, "°": 1.0, "rad": 180 / math.pi},
    "kg/m3": {"kg/m3": 1.0, "kg/m³": 1.0, "t/m3": 1e3, "t/m³": 1e3, "g/cm3": 1e3, "kg/l": 1e3, "kg/L": 1e3},
    "m3/m3": {"m3/m3": 1.0, "%": 1e-2, "l/m3": 1e-3, "L/m3": 1e-3, "l/m³": 1e-3},
    "1": {"1": 1.0, "%": 1e-2},
    "s": {"s": 1.0, "min": 60.0},
    "1/s": {"1/s": 1.0},
    "m/s": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3},
    "Pa s": {"Pa s": 1.0, "Pa.s": 1.0, "Pa·s": 1.0, "Pas": 1.0},
    "Pa s/m": {"Pa s/m": 1.0, "Pa.s/m": 1.0, "Pa·s/m": 1.0},
}  # fmt: skip
"""By the unit in which the program has an amount, what one of each unit that people write is in it."""


def amount(field: str, given: Any, unit: str) -> float:
    """A number in `unit`, one of :data:`UNITS`, or a text of a number and a unit of the same kind, in `unit`.

    Raises :class:`SceneError` for anything else.
    """
    known = UNITS[unit]
    found = math.nan
    if isinstance(given, str):
        text = re.fullmatch(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*?)\s*", given)
        if text is not None and (not text[2] or text[2] in known):
            found = float(text[1]) * known[text[2] or unit]
    elif isinstance(given, NUMBERS) and not isinstance(given, bool):
        with suppress(OverflowError):
            found = float(given)
    if not math.isfinite(found):
        refuse(field, given, f"must be a number with one of {', '.join(known)}", f"without one it is in {unit}")
    return found
