"""Numbers with their units, as files hold them and as people read them."""

from __future__ import annotations

from typing import Any

SHOWN = {"Pa": (1e-3, "kPa"), "m/s": (100.0, "cm/s"), "m": (1e3, "mm"), "1": (100.0, "%")}
"""Factor and unit by which people read a quantity in SI units."""


def quantity(value: float, unit: str) -> dict[str, Any]:
    """A number with its unit, as it stands in result.json."""
    return {"value": float(value), "unit": unit}


def number(entry: Any) -> float:
    """The number of an entry of result.json: pure numbers stand there plain, others with their unit."""
    return float(entry["value"] if isinstance(entry, dict) else entry)


def shown(unit: str) -> tuple[float, str]:
    """Factor and unit in which people read a quantity; those that have no other are read as they are."""
    return SHOWN.get(unit, (1.0, unit))
