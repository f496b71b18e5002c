"""Statistics of a trade: intervals, predictions, the front, the cheapest choice."""

import math

import numpy as np
import pytest

from warpcrete.studies.tradeoffs.fronts import (
    Error,
    cheapest_within,
    difference,
    distance_to_limit,
    front,
    prediction_bound,
    student_quantile,
    worst,
)

QUANTILES = {1: 12.706, 2: 4.303, 10: 2.228, 11: 2.201, 15: 2.131, 30: 2.042, 120: 1.980}


def test_quantiles_of_student():
    # Published tables have the same values, to their digits.
    for freedom, quantile in QUANTILES.items():
        assert student_quantile(freedom) == pytest.approx(quantile, abs=1.5e-3)


def test_intervals_hold_the_true_difference_as_often_as_they_say():
    random = np.random.default_rng(1)
    held = []
    for _ in range(4000):
        a, b = random.normal(1.1, 0.02, 3), random.normal(1.0, 0.05, 4)
        error = difference("x", a, b, size=1.0)
        held.append(abs(error.shift - 0.1) <= error.interval)
    assert 0.94 <= np.mean(held) <= 0.98  # Welch's interval is a little wide for so few


def test_the_degrees_of_freedom_of_an_interval_are_those_of_welch():
    """The squared standard errors are 1 of two runs and 5/3 of four. Welch's formula gives (1 + 5/3)^2 / (1/1 + (5/3)^2
    / 3) = 3.69 degrees, which count as 3."""
    error = difference("x", [1.0, 3.0], [0.0, 2.0, 4.0, 6.0])
    assert error.shift == pytest.approx(-1 / 3)
    assert error.interval == pytest.approx(3.182 * math.sqrt(8 / 3) / 3, rel=1e-3)


def test_differences_without_randomness_are_exact_and_lone_runs_say_nothing_of_scatter():
    assert difference("x", [1.1], [1.0]) == Error("x", pytest.approx(0.1), 0.0)
    assert math.isnan(difference("x", [1.1], [1.0, 1.2]).interval)
    assert not difference("x", [1.1], [1.0]).within_scatter
    error = difference("x", [1.0, 1.1, 1.2], [1.0, 1.1, 1.2])
    assert error.shift == 0 and error.interval == pytest.approx(4.303 * 0.1 / math.sqrt(3) / 1.1, rel=1e-3)
    assert difference("x", [1.01, 1.11, 1.21], [1.0, 1.1, 1.2]).within_scatter
    found = worst([Error("a", -0.2, 0.0), Error("b", 0.1, 0.15), Error("c", math.nan, 0.0)])
    assert found is not None and found.quantity == "b"  # by what it is at most
    assert worst([]) is None


def test_the_next_error_stays_within_what_is_promised():
    random = np.random.default_rng(1)
    held = []
    for _ in range(4000):
        errors = random.normal(0.01, 0.02, 8)
        held.append(abs(errors[-1]) <= prediction_bound(errors[:-1]))
    # |mean| + t s sqrt(1 + 1/n) bounds the next one on either side, and so a little more than 95 % of them.
    assert 0.945 <= np.mean(held) <= 0.99
    assert prediction_bound([-0.03]) == 0.03 and prediction_bound([0.01, 0.01]) == pytest.approx(0.01)
    for shifts in ([-0.03], [-0.03, -0.01], [0.01, -0.04, -0.02]):
        assert prediction_bound(shifts) == prediction_bound([-shift for shift in shifts]) > abs(np.mean(shifts)) - 1e-12


def test_the_limit_of_fine_cells_lies_on_a_line_through_all_widths():
    widths = [0.5, 0.7, 1.0, 1.6]
    values = [2.0 * (1 + 0.03 * width) for width in widths]
    assert distance_to_limit(widths, values, values[1]) == pytest.approx(0.03 * 0.7)
    # Richardson's extrapolation of first order from two widths.
    coarse, fine = 2.6, 2.3
    limit = fine - (coarse - fine) * 0.7 / (1.0 - 0.7)
    assert distance_to_limit([1.0, 0.7], [coarse, fine], fine) == pytest.approx((fine - limit) / limit)
    # A line leaves out the scatter of single values, but the value itself counts as it is.
    scattered = [value * factor for value, factor in zip(values, (1.001, 0.999, 0.999, 1.001), strict=True)]
    assert distance_to_limit(widths, scattered, scattered[0]) == pytest.approx(0.03 * 0.5, abs=3e-3)
    assert distance_to_limit([0.7, 0.7], [1.0, 1.0], 1.0) == math.inf
    assert distance_to_limit([1.0, 0.7], [1.0, 0.7], 0.7) > 1e3  # The limit is 0, up to rounding.


def test_the_front_is_what_nothing_beats():
    points = [(3.0, 0.01), (1.0, 0.2), (2.0, 0.2), (2.5, 0.05), (2.6, 0.06), (4.0, 0.01)]
    assert front(points) == [1, 3, 0]
    assert front([]) == []


def test_the_cheapest_levels_whose_errors_add_up_to_less():
    knobs = {"a": [(0.1, 0.06), (0.5, 0.02), (1.0, 0.0)], "b": [(0.3, 0.04), (1.0, 0.0)]}
    assert cheapest_within(knobs, 0.1) == {"a": 0, "b": 0}
    assert cheapest_within(knobs, 0.06) == {"a": 0, "b": 1}  # 0.1 against 0.15
    assert cheapest_within(knobs, 0.05) == {"a": 2, "b": 0}
    assert cheapest_within(knobs, 0.0) == {"a": 2, "b": 1}
    assert cheapest_within({"a": [(1.0, math.inf)]}, 0.5) is None
