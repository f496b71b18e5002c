"""Uncertainty bands: several independent causes combined into one band, with the contribution of each cause."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Band:
    """Value with the band in which the true value is expected, and the causes of the band."""

    value: float
    low: float
    high: float
    shares: Mapping[str, float] = field(default_factory=dict)
    """Fraction that each cause contributes to the squared width of the band, by cause; the fractions add up to 1."""

    @property
    def factor(self) -> float:
        """Factor f that expresses the uncertainty of the value.

        The true value is expected between value / f and value * f. The factor is infinite if the band's lower end is 0
        or less.
        """
        return math.sqrt(self.high / self.low) if self.low > 0 else math.inf

    def contains(self, value: float) -> bool:
        """Return whether a value lies in the band."""
        return self.low <= value <= self.high


def combined(value: float, ends: Mapping[str, tuple[float, float]]) -> Band:
    """Combine independent causes of uncertainty into one band.

    `ends` gives, for each cause, the two values that result if only this cause is at one end of its own band. If all
    values are positive, their deviations are measured as logarithms of ratios, because an uncertainty by a factor of
    three means division or multiplication by three. Deviations to one side are added in squares, as for independent
    errors.
    """
    logarithmic = value > 0 and all(end > 0 for pair in ends.values() for end in pair)
    below, above = 0.0, 0.0
    widths = {}
    for cause, pair in ends.items():
        moves = [math.log(end / value) if logarithmic else end - value for end in pair]
        down, up = max(0.0, *(-move for move in moves)), max(0.0, *moves)
        below, above = below + down * down, above + up * up
        widths[cause] = (down + up) ** 2
    total = sum(widths.values())
    shares = {cause: width / total for cause, width in widths.items()} if total > 0 else {}
    down, up = math.sqrt(below), math.sqrt(above)
    if logarithmic:
        return Band(value, value * math.exp(-down), value * math.exp(up), shares)
    return Band(value, value - down, value + up, shares)


def wilson_interval(hits: int, count: int, deviations: float = 1.959964) -> tuple[float, float]:
    """Return the confidence interval of a probability from `hits` among `count` independent trials.

    The interval is that of Wilson (J. Am. Stat. Assoc. 22 (1927) 209), which stays inside 0 to 1 and is meaningful for
    no hits at all. The confidence is 95 % for 1.96 `deviations` of a normal distribution.
    """
    share, squared = hits / count, deviations**2
    middle = (share + squared / (2 * count)) / (1 + squared / count)
    half = deviations * math.sqrt(share * (1 - share) / count + squared / (4 * count**2)) / (1 + squared / count)
    return max(middle - half, 0.0) if hits else 0.0, min(middle + half, 1.0) if hits < count else 1.0
