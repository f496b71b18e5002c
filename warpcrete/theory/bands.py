"""Uncertainty bands of results: combination of several independent causes of uncertainty into one band."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Band:
    """Value with an uncertainty band, in which the true value is expected, and the contribution of each cause to it."""

    value: float
    low: float
    high: float
    shares: Mapping[str, float] = field(default_factory=dict)
    """Fraction of the squared width of the band that each cause contributes, by name of the cause; the sum is 1."""

    @property
    def factor(self) -> float:
        """Factor f such that the true value is expected between value / f and value * f.

        For a band that is not symmetrical in this sense, f is the square root of the ratio of its upper end to its
        lower end. It is infinite if the lower end is 0 or less.
        """
        return math.sqrt(self.high / self.low) if self.low > 0 else math.inf

    def contains(self, value: float) -> bool:
        """Return whether a value lies in the band."""
        return self.low <= value <= self.high


LOGARITHMIC = 4.0
"""Factor up to which a deviation from a positive value is measured as the logarithm of a ratio. Larger deviations grow
in proportion to the difference from the value. They occur if the value is a small difference of large numbers, such as
the pump pressure of a line that leads downhill."""


def combined(value: float, ends: Mapping[str, tuple[float, float]]) -> Band:
    """Combine independent causes of uncertainty into one band.

    `ends` gives, for each cause, the results if this cause alone is at the lower or upper end of its own band. The
    total deviation to each side is the square root of the sum of the squared deviations, as for independent errors.

    For a positive value, deviations up to a factor of :data:`LOGARITHMIC` are measured as logarithms of ratios, because
    an uncertainty by a factor of three means division or multiplication by three. Beyond this factor they grow
    linearly, because the logarithm of a ratio tends to infinity for results near zero: the band would become wider than
    the sum of all deviations. For a value of zero or below, all deviations are differences. If no result is negative,
    the lower end of the band is not negative either.
    """
    below, above = 0.0, 0.0
    widths = {}
    for cause, pair in ends.items():
        down, up = (max(0.0, *(sign * (end - value) for end in pair)) for sign in (-1, 1))
        if value > 0:
            down, up = _measured_down(down / value), _measured_up(up / value)
        below, above = below + down * down, above + up * up
        widths[cause] = (down + up) ** 2
    total = sum(widths.values())
    shares = {cause: width / total for cause, width in widths.items()} if total > 0 else {}
    down, up = math.sqrt(below), math.sqrt(above)
    if value > 0:
        down, up = value * _relative_down(down), value * _relative_up(up)
    low = value - down
    if value >= 0 and all(end >= 0 for pair in ends.values() for end in pair):
        low = max(low, 0.0)
    return Band(value, low, value + up, shares)


def _measured_up(relative: float) -> float:
    """Return the measure of a deviation upwards: ln(1 + x) up to :data:`LOGARITHMIC`, continued by its tangent.

    The `relative` deviation x is the difference from the value, divided by the value.
    """
    if relative < LOGARITHMIC - 1:
        return math.log1p(relative)
    return math.log(LOGARITHMIC) + (1 + relative) / LOGARITHMIC - 1


def _relative_up(measure: float) -> float:
    """Return the relative deviation upwards with a given measure, the inverse of :func:`_measured_up`."""
    beyond = measure - math.log(LOGARITHMIC)
    return math.expm1(measure) if beyond < 0 else LOGARITHMIC * (1 + beyond) - 1


def _measured_down(relative: float) -> float:
    """Return the measure of a deviation downwards: -ln(1 - x) up to :data:`LOGARITHMIC`, continued by its tangent.

    The `relative` deviation x is the positive difference from the value, divided by the value.
    """
    if relative < 1 - 1 / LOGARITHMIC:
        return -math.log1p(-relative)
    return math.log(LOGARITHMIC) + 1 - LOGARITHMIC * (1 - relative)


def _relative_down(measure: float) -> float:
    """Return the relative deviation downwards with a given measure, the inverse of :func:`_measured_down`."""
    beyond = measure - math.log(LOGARITHMIC)
    return -math.expm1(-measure) if beyond < 0 else 1 - (1 - beyond) / LOGARITHMIC


def wilson_interval(hits: int, count: int, deviations: float = 1.959964) -> tuple[float, float]:
    """Return the confidence interval of a probability that is estimated from `hits` among `count` independent trials.

    The interval was derived by Wilson (J. Am. Stat. Assoc. 22 (1927) 209). It stays between 0 and 1, and is meaningful
    even for no hits at all. `deviations` is the number of standard deviations of a normal distribution; 1.96 gives a
    confidence of 95 %.
    """
    share, squared = hits / count, deviations**2
    middle = (share + squared / (2 * count)) / (1 + squared / count)
    half = deviations * math.sqrt(share * (1 - share) / count + squared / (4 * count**2)) / (1 + squared / count)
    return max(middle - half, 0.0) if hits else 0.0, min(middle + half, 1.0) if hits < count else 1.0
