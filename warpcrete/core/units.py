"""Quantities with units: entries of result.json, and units in which quantities are displayed."""

from collections.abc import Mapping
from typing import Any, SupportsFloat, TypedDict

DISPLAY_UNITS = {
    "Pa": (1e-3, "kPa"),
    "m/s": (100.0, "cm/s"),
    "m": (1e3, "mm"),
    "1": (100.0, "%"),
    "m3/s": (3600.0, "m3/h"),
    "Pa/m": (1e-3, "kPa/m"),
}
"""Pair (factor, display unit) for each SI unit that is displayed in another unit. The factor converts a value in the SI
unit to the display unit."""


class Quantified(TypedDict):
    """Number with its unit, as an entry of result.json."""

    value: float
    unit: str


def quantity(value: float, unit: str) -> Quantified:
    """Return a number with its unit as an entry of result.json."""
    return {"value": float(value), "unit": unit}


def number(entry: SupportsFloat | Mapping[str, Any]) -> float:
    """Return the number in an entry of result.json, which may be a plain number or a number with a unit."""
    return float(entry["value"] if isinstance(entry, Mapping) else entry)


def shown(unit: str) -> tuple[float, str]:
    """Return the factor by which a value in `unit` is multiplied for display, and the display unit.

    A unit without an entry in `DISPLAY_UNITS` is displayed unchanged, with the factor 1.
    """
    return DISPLAY_UNITS.get(unit, (1.0, unit))


def rounded(value: float, digits: int = 4) -> str:
    """Return a number as text with at most `digits` significant digits, without zeros at the end.

    Small and large numbers are written with an exponent: numbers below 0.0001, and numbers from 1e6 on (from 10**digits
    on if `digits` exceeds 6).
    """
    return f"{float(f'{value:.{digits}g}'):.{max(digits, 6)}g}"
