"""Amounts as text in metric units, followed by customary US units if the user's inputs have such units."""

from collections.abc import Sequence

from .amounts import FOOT, INCH, POUND, PSI, YARD

CUSTOMARY_SIZES = {"in": INCH, "ft": FOOT, "yd3": YARD**3, "yd3/h": YARD**3 / 3600, "psi": PSI, "psi/ft": PSI / FOOT,
                   "lb/yd3": POUND / YARD**3, "ft3/yd3": 1 / 27, "hp": 550 * FOOT * POUND * 9.80665}  # fmt: skip
"""SI values of the customary US units in which results are given in addition to metric units."""
METRIC_SIZES = {"mm": (1e-3, "in"), "m": (1.0, "ft"), "kg/m3": (1.0, "lb/yd3"), "l/m3": (1e-3, "ft3/yd3"),
                "bar": (1e5, "psi"), "kPa": (1e3, "psi"), "MPa": (1e6, "psi"), "kPa/m": (1e3, "psi/ft")}  # fmt: skip
"""Metric units of :func:`both`, each with its SI value and the customary US unit for the same quantity."""


def beside(shown: bool, unit: str, *values: float, digits: int = 4) -> str:
    """Return an addition to a metric amount, such as " (5 in)" or " (5 to 6 in)"; empty if `shown` is false.

    `values` are one value, or the two ends of a range, in SI units. The customary US unit `unit` is a key of
    :data:`CUSTOMARY_SIZES`, and the numbers have `digits` significant digits.
    """
    return f" ({_span(values, CUSTOMARY_SIZES[unit], digits)} {unit})" if shown else ""


def both(customary: bool, unit: str, *values: float, digits: int = 4) -> str:
    """Return an amount such as "127 mm", or "127 mm (5 in)" if `customary` is true.

    `values` are one value, or the two ends of a range, in SI units. The metric unit `unit` is a key of
    :data:`METRIC_SIZES`, and the numbers have `digits` significant digits.
    """
    size, other = METRIC_SIZES[unit]
    return f"{_span(values, size, digits)} {unit}{beside(customary, other, *values, digits=digits)}"


def _span(values: Sequence[float], size: float, digits: int) -> str:
    return " to ".join(f"{value / size:.{digits}g}" for value in values)
