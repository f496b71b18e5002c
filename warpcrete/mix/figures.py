"""Properties calculated from a mix, each with an uncertainty band, the input it follows from, and its source."""

from __future__ import annotations

from dataclasses import dataclass

from ..core.errors import refuse

INSTRUMENTS = 2.0
"""Factor by which results of different instruments for one concrete may differ before they count as contradictory. The
factor is a choice: comparisons of rheometers show that results differ (Ferraris & Martys 2003; RILEM TC 266-MRP 2023),
but no figure was taken from them."""


@dataclass(frozen=True)
class Figure:
    """Calculated or measured property of a concrete."""

    name: str
    value: float
    low: float
    high: float
    """Upper end of the band from `low` to `high` in which the true value is expected, in `unit`."""
    unit: str
    way: str
    """Entry of the mix from which the value is calculated."""
    source: str
    """Author of the relation, and how reliable the value is."""
    instrument: str = "rheometer"
    """Instrument from which the value comes: a rheometer or a cone."""

    def __post_init__(self) -> None:
        assert self.low <= self.value <= self.high, self

    @property
    def span(self) -> str:
        """Value, band and unit as text."""
        band = "" if self.low == self.high else f" ({short(self.low)} to {short(self.high)})"
        return f"{short(self.value)}{band} {self.unit}"


def short(value: float) -> str:
    """Format a number with three significant digits, and without an exponent if readers expect none."""
    return f"{float(f'{value:.3g}'):g}"


def around(name: str, value: float, off: float, unit: str, way: str, source: str) -> Figure:
    """Return a property with the relative uncertainty `off` above and below its value."""
    return Figure(name, value, value * (1 - off), value * (1 + off), unit, way, source)


def reconciled(candidates: list[Figure]) -> tuple[Figure, list[str]]:
    """Return the first of several values for one property, and remarks on differences between the values.

    The candidates come from different entries of the mix. Raises :class:`SceneError` if the bands of two candidates
    contradict each other. Between a rheometer and a cone, bands may differ by a factor of :data:`INSTRUMENTS`.
    """
    first, remarks = candidates[0], []
    for other in candidates[1:]:
        apart = max(other.low / max(first.high, 1e-9), first.low / max(other.high, 1e-9))
        words = f"{first.name}: {first.span} from {first.way}, but {other.span} from {other.way}"
        if apart > (INSTRUMENTS if first.instrument != other.instrument else 1.0):
            refuse(f"mix {first.name}", f"{first.span} from {first.way}", f"contradicts {other.span} from {other.way}",
                   "leave out the less reliable one, or state its uncertainty")  # fmt: skip
        if apart > 1:
            remarks.append(f"{words}; the first is used, because instruments often differ by as much")
    return first, remarks
