"""Numbers that follow from a mix: each with its band, from what it follows, and after whom."""

from __future__ import annotations

from dataclasses import dataclass

from ..core.errors import refuse

INSTRUMENTS = 2.0
"""Factor by which instruments may differ about one concrete before they contradict each other: a choice. That
rheometers differ was found by comparing them (Ferraris & Martys 2003; RILEM TC 266-MRP 2023); by how much was not
looked up."""


@dataclass(frozen=True)
class Figure:
    """A number of a concrete."""

    name: str
    value: float
    low: float
    high: float
    """Band in which the true one is thought to lie."""
    unit: str
    way: str
    """From what of the mix it follows."""
    source: str
    """After whom, and how sure that is."""
    instrument: str = "rheometer"
    """That told it: a rheometer, or a cone."""

    def __post_init__(self) -> None:
        assert self.low <= self.value <= self.high, self

    @property
    def span(self) -> str:
        """Value and band in words."""
        band = "" if self.low == self.high else f" ({short(self.low)} to {short(self.high)})"
        return f"{short(self.value)}{band} {self.unit}"


def short(value: float) -> str:
    """Three digits of a number, without an exponent where people use none."""
    return f"{float(f'{value:.3g}'):g}"


def around(name: str, value: float, off: float, unit: str, way: str, source: str) -> Figure:
    """A number that may be off by so much of itself, either way."""
    return Figure(name, value, value * (1 - off), value * (1 + off), unit, way, source)


def agreed(candidates: list[Figure]) -> tuple[Figure, list[str]]:
    """The first of what several ways tell of one number, if all of them can be true together; and what to know of those
    that hardly can.

    Between a rheometer and a cone bands may lie apart by :data:`INSTRUMENTS`.
    """
    first, remarks = candidates[0], []
    for other in candidates[1:]:
        apart = max(other.low / max(first.high, 1e-9), first.low / max(other.high, 1e-9))
        words = f"{first.name}: {first.span} by {first.way}, {other.span} by {other.way}"
        if apart > (INSTRUMENTS if first.instrument != other.instrument else 1.0):
            refuse(f"mix {first.name}", f"{first.span} by {first.way}", f"contradicts {other.span} by {other.way}",
                   "leave out the one that you trust less, or give it its uncertainty")  # fmt: skip
        if apart > 1:
            remarks.append(f"{words}; the former is taken, instruments differ by as much")
    return first, remarks
