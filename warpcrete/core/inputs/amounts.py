"""Parser for amounts with units, such as `30 m3/h` or `125 mm`, which it converts to numbers in SI units."""

from __future__ import annotations

import math
import re
from contextlib import suppress

import numpy as np

from ..errors import refuse, suggested
from ..narrowing import is_number

NUMBERS = (int, float, np.integer, np.floating)
UNITS = {
    "m": {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "km": 1e3, "um": 1e-6, "in": 0.0254, "inch": 0.0254, "inches": 0.0254,
          "ft": 0.3048, "feet": 0.3048, "yd": 0.9144},
    "m2": {"m2": 1.0, "m²": 1.0, "cm2": 1e-4, "mm2": 1e-6},
    "m3/s": {"m3/s": 1.0, "m3/h": 1 / 3600, "m³/h": 1 / 3600, "m³/s": 1.0, "l/s": 1e-3, "L/s": 1e-3,
             "l/min": 1e-3 / 60, "L/min": 1e-3 / 60, "cm3/s": 1e-6, "yd3/h": 0.9144**3 / 3600,
             "yd³/h": 0.9144**3 / 3600, "cy/h": 0.9144**3 / 3600},
    "Pa": {"Pa": 1.0, "bar": 1e5, "kPa": 1e3, "MPa": 1e6, "GPa": 1e9, "mbar": 100.0, "N/mm2": 1e6,
           "psi": 0.45359237 * 9.80665 / 0.0254**2},
    "Pa/s": {"Pa/s": 1.0, "Pa/min": 1 / 60},
    "Pa/m": {"Pa/m": 1.0, "kPa/m": 1e3, "MPa/m": 1e6, "bar/m": 1e5, "MPa/100m": 1e4},
    "degrees": {"degrees": 1.0, "deg": 1.0, "°": 1.0, "rad": 180 / math.pi},
    "kg/m3": {"kg/m3": 1.0, "t/m3": 1e3, "kg/m³": 1.0, "t/m³": 1e3, "g/cm3": 1e3, "kg/l": 1e3, "kg/L": 1e3,
              "lb/ft3": 0.45359237 / 0.3048**3, "lb/yd3": 0.45359237 / 0.9144**3},
    "m3/m3": {"m3/m3": 1.0, "%": 1e-2, "l/m3": 1e-3, "L/m3": 1e-3, "l/m³": 1e-3},
    "1": {"1": 1.0, "%": 1e-2},
    "s": {"s": 1.0, "ms": 1e-3, "min": 60.0, "h": 3600.0},
    "1/s": {"1/s": 1.0, "Hz": 1.0},
    "m/s": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "m/min": 1 / 60, "ft/s": 0.3048},
    "m/s2": {"m/s2": 1.0, "m/s²": 1.0},
    "m2/N": {"m2/N": 1.0, "m²/N": 1.0, "1/Pa": 1.0},
    "Pa s": {"Pa s": 1.0, "Pa.s": 1.0, "Pa·s": 1.0, "Pas": 1.0, "mPa s": 1e-3},
    "Pa s/m": {"Pa s/m": 1.0, "Pa.s/m": 1.0, "Pa·s/m": 1.0},
}  # fmt: skip
"""Accepted unit names, by internal unit: `UNITS[internal][written]` is the factor that converts a value in the written
unit to the internal unit."""


NUMBER = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*)")
"""Pattern of an amount: group 1 is the number, group 2 the unit that follows it (possibly empty)."""
LONGEST = 100
"""Maximum length of the text of an amount, in characters."""


def _split(value: str) -> re.Match[str] | None:
    """Return the match of the pattern `NUMBER` with a text, or None if the text is not an amount."""
    return NUMBER.fullmatch(value.strip()) if len(value) <= LONGEST else None


def bare_number(value: object) -> bool:
    """Return whether `value` is a number, or a text that holds a number without a unit."""
    if not isinstance(value, str):
        return isinstance(value, NUMBERS)
    text = _split(value)
    return text is not None and not text[2]


def amount(field: str, value: object, unit: str) -> float:
    """Return a number or a text such as "125 mm" as a number in `unit`.

    `unit` is a key of :data:`UNITS`, and `field` names the parameter in error messages. A number without a unit counts
    as a number in `unit`. Raises :class:`SceneError` for an unknown unit, or if `value` is not a finite number.
    """
    known = UNITS[unit]
    number, more = math.nan, ""
    if isinstance(value, str):
        text = _split(value)
        if text is not None and (not text[2] or text[2] in known):
            number = float(text[1]) * known[text[2] or unit]
        elif re.match(r"\s*[-+]?\d+,\d", value):
            more = "; write a decimal point instead of a decimal comma, as in 10.3"
        elif text is not None and (meant := suggested(text[2], known)):
            more = f"; {meant}"
    elif is_number(value):
        with suppress(OverflowError):
            number = float(value)
    if not math.isfinite(number):
        units = f"with one of {', '.join(known)}" if unit != "1" else "without a unit, or with %"
        refuse(field, value, f"must be a number {units}{more}",
               f"a number without a unit is in {unit}" if unit != "1" else "")  # fmt: skip
    return number
