"""Statistics of a trade: differences with their intervals, the front of what nothing beats, settings by promise."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

STUDENT = (12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228)
"""Two-sided 95 % quantiles of Student's t for 1 to 10 degrees of freedom."""


@dataclass(frozen=True)
class Error:
    """Relative difference of a quantity from its reference."""

    quantity: str
    shift: float
    """With its sign."""
    interval: float
    """Half width of its 95 % confidence interval; 0 where nothing is random, NaN where one run says nothing of it."""

    @property
    def size(self) -> float:
        return abs(self.shift)

    @property
    def bound(self) -> float:
        """What the error is at most, interval included."""
        return self.size + (math.inf if math.isnan(self.interval) else self.interval)

    @property
    def within_scatter(self) -> bool:
        """Seeds alone explain it."""
        return math.isfinite(self.interval) and 0 < self.size <= self.interval


def student(freedom: float) -> float:
    """Two-sided 95 % quantile of Student's t; a fraction of degrees of freedom counts as the whole ones below."""
    whole = max(int(freedom), 1)
    if whole <= len(STUDENT):
        return STUDENT[whole - 1]
    # The quantile's expansion in 1/n about the normal one (Abramowitz & Stegun 26.7.5).
    return 1.960 + 2.372 / whole + 2.823 / whole**2 + 2.556 / whole**3


def difference(quantity: str, values: Sequence[float], reference: Sequence[float], size: float | None = None) -> Error:
    """Difference of two means over `size` (default: the reference's mean), with Welch's interval.

    One value each is taken as exact, as flows without randomness are; one value beside several has no interval (NaN).
    """
    a, b = np.asarray(values, float), np.asarray(reference, float)
    size = abs(float(b.mean()) if size is None else size) or math.nan
    shift = float(a.mean() - b.mean()) / size
    if len(a) == 1 and len(b) == 1:
        return Error(quantity, shift, 0.0)
    if len(a) == 1 or len(b) == 1:
        return Error(quantity, shift, math.nan)
    if np.array_equal(a, b):  # the same runs
        return Error(quantity, 0.0, student(len(b) - 1) * float(b.std(ddof=1)) / math.sqrt(len(b)) / size)
    parts = np.array([a.var(ddof=1) / len(a), b.var(ddof=1) / len(b)])
    spread = float(parts.sum())
    if spread == 0.0:
        return Error(quantity, shift, 0.0)
    freedom = spread**2 / float((parts**2 / (np.array([len(a), len(b)]) - 1)).sum())
    return Error(quantity, shift, student(freedom) * math.sqrt(spread) / size)


def next_within(shifts: Sequence[float]) -> float:
    """Size that the next of such errors stays within with 95 %, if they are normal; one alone bounds itself."""
    values = np.asarray(shifts, float)
    if len(values) < 2:
        return float(np.abs(values).max(initial=0.0))
    spread = float(values.std(ddof=1)) * math.sqrt(1 + 1 / len(values))
    return abs(float(values.mean())) + student(len(values) - 1) * spread


def front(points: Sequence[tuple[float, float]]) -> list[int]:
    """Places of the (cost, error) pairs that no other one beats in both, by rising cost."""
    order = sorted(range(len(points)), key=lambda k: points[k])
    best, found = math.inf, []
    for k in order:
        if points[k][1] < best:
            best = points[k][1]
            found.append(k)
    return found


def cheapest_within(
    knobs: Mapping[str, Sequence[tuple[float, float]]], target: float, limit: int = 2_000_000
) -> dict[str, int] | None:
    """Levels by knob, with the least product of cost factors whose errors together stay within `target`.

    `knobs` has (cost factor, error) for the levels of each; errors are added up, since signs that cancel in one scene
    do not in the next. None where even the least errors are more than that. Raises ValueError beyond `limit`
    combinations, which no scene comes near.
    """
    names = list(knobs)
    if math.prod(len(knobs[name]) for name in names) > limit:
        raise ValueError(f"more than {limit} combinations")
    best: tuple[float, dict[str, int]] | None = None
    for choice in itertools.product(*(range(len(knobs[name])) for name in names)):
        pairs = [knobs[name][k] for name, k in zip(names, choice)]
        if sum(error for _, error in pairs) > target:
            continue
        cost = math.prod(factor for factor, _ in pairs)
        if best is None or cost < best[0]:
            best = cost, dict(zip(names, choice))
    return None if best is None else best[1]


def worst(errors: Sequence[Error]) -> Error | None:
    """The largest of the errors, by what they are at most."""
    return max(errors, key=lambda each: each.bound, default=None)
