"""Statistics of trade-off studies: errors with confidence intervals, the Pareto front, and cheapest settings."""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

STUDENT = (12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228)
"""Two-sided 95 % quantiles of Student's t for 1 to 10 degrees of freedom."""


@dataclass(frozen=True)
class Error:
    """Relative difference between the mean of a quantity over the seeds and its reference value."""

    quantity: str
    shift: float
    """Difference between the mean of the quantity and its reference value, divided by the reference value. It may be
    negative."""
    interval: float
    """Half width of the 95 % confidence interval of `shift`. The value is 0 if the results contain no randomness, and
    NaN if there are too few runs."""

    @property
    def size(self) -> float:
        """Magnitude of the relative error `shift`."""
        return abs(self.shift)

    @property
    def bound(self) -> float:
        """Upper bound of the error's magnitude; infinite if the confidence interval is unknown.

        The bound is the magnitude plus the half width of the interval.
        """
        return self.size + (math.inf if math.isnan(self.interval) else self.interval)

    @property
    def within_scatter(self) -> bool:
        """True if the confidence interval of the error contains 0, so that scatter between seeds may explain it."""
        return math.isfinite(self.interval) and 0 < self.size <= self.interval


def student_quantile(freedom: float) -> float:
    """Return the two-sided 95 % quantile of Student's t distribution; degrees of freedom are rounded down."""
    whole = max(int(freedom), 1)
    if whole <= len(STUDENT):
        return STUDENT[whole - 1]
    # For n > 10 degrees of freedom, use the expansion in powers of 1/n about the quantile of the normal distribution
    # (Abramowitz & Stegun 26.7.5).
    return 1.960 + 2.372 / whole + 2.823 / whole**2 + 2.556 / whole**3


def mean_interval(values: Sequence[float]) -> tuple[float, float]:
    """Return the mean of `values` and the half width of its 95 % confidence interval, by Student's t distribution.

    A single value comes from results without randomness, so its half width is 0.
    """
    a = np.asarray(values, float)
    spread = float(a.std(ddof=1)) / math.sqrt(len(a)) if len(a) > 1 else 0.0
    return float(a.mean()), student_quantile(len(a) - 1) * spread


def difference(quantity: str, values: Sequence[float], reference: Sequence[float], size: float | None = None) -> Error:
    """Return the relative difference between the means of `values` and `reference`, with its confidence interval.

    The difference is divided by `size`, by default the magnitude of the mean of `reference`. The 95 % confidence
    interval follows from Welch's t-test. If both sequences have a single value, as in flows without randomness, the
    difference counts as exact. If only one of them has a single value, the interval is NaN.
    """
    a, b = np.asarray(values, float), np.asarray(reference, float)
    size = abs(float(b.mean()) if size is None else size) or math.nan
    shift = float(a.mean() - b.mean()) / size
    if len(a) == 1 and len(b) == 1:
        return Error(quantity, shift, 0.0)
    if len(a) == 1 or len(b) == 1:
        return Error(quantity, shift, math.nan)
    if np.array_equal(a, b):  # Equal arrays mean that the reference is compared with itself.
        return Error(quantity, 0.0, mean_interval(b)[1] / size)
    parts = np.array([a.var(ddof=1) / len(a), b.var(ddof=1) / len(b)])
    spread = float(parts.sum())
    if spread == 0.0:
        return Error(quantity, shift, 0.0)
    freedom = spread**2 / float((parts**2 / (np.array([len(a), len(b)]) - 1)).sum())
    return Error(quantity, shift, student_quantile(freedom) * math.sqrt(spread) / size)


def prediction_bound(shifts: Sequence[float]) -> float:
    """Return the bound that the next error does not exceed with 95 % probability, for normally distributed errors.

    The bound is |mean| + t s sqrt(1 + 1/n), from the prediction interval of n errors. Here s is their standard
    deviation and t the two-sided 95 % quantile of Student's distribution. The bound of a single error is its magnitude.
    """
    values = np.asarray(shifts, float)
    if len(values) < 2:
        return float(np.abs(values).max(initial=0.0))
    spread = float(values.std(ddof=1)) * math.sqrt(1 + 1 / len(values))
    return abs(float(values.mean())) + student_quantile(len(values) - 1) * spread


def distance_to_limit(widths: Sequence[float], values: Sequence[float], value: float) -> float:
    """Return the relative difference of `value` from the value that is extrapolated to infinitely fine cells.

    The extrapolated value is the value at the width 0 on a straight line, which is fitted to the `values` at the
    `widths` of the cells by least squares. For two widths, this is Richardson's extrapolation of first order. The
    result is infinite for fewer than two widths.
    """
    if len(set(widths)) < 2:
        return math.inf
    limit = float(np.polyfit(widths, values, 1)[1])
    return abs(value - limit) / abs(limit) if limit else math.inf


def front(points: Sequence[tuple[float, float]]) -> list[int]:
    """Return the indices of those (cost, error) pairs that lie on the Pareto front, in the order of rising cost."""
    order = sorted(range(len(points)), key=lambda k: points[k])
    best, indices = math.inf, []
    for k in order:
        if points[k][1] < best:
            best = points[k][1]
            indices.append(k)
    return indices


def cheapest_within(
    knobs: Mapping[str, Sequence[tuple[float, float]]], target: float, limit: int = 2_000_000
) -> dict[str, int] | None:
    """Return the cheapest combination of levels whose errors add up to at most `target`, or None if there is none.

    A knob is a parameter that trades accuracy for run time, and its levels are its possible values. A combination has
    one level of each knob; it is returned as the index of the level, by the name of the knob. `knobs` holds a pair
    (cost factor, magnitude of the error) for each level of each knob. The cost of a combination is the product of the
    cost factors. The errors are added, because errors that cancel in one scene need not cancel in another one. Raises
    ValueError for more than `limit` combinations.
    """
    names = list(knobs)
    if math.prod(len(knobs[name]) for name in names) > limit:
        raise ValueError(f"the knobs have more than {limit} combinations of levels")
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
    """Return the error whose upper bound is the largest; None without errors."""
    return max(errors, key=lambda each: each.bound, default=None)
