"""Times that standard tests are judged by, interpolated between the rows of a made-up series."""

import numpy as np
import pytest
from made_runs import ROWS, RUNS

from warpcrete.core.run.method import passage_time
from warpcrete.standards.standard_test import is_at_rest

TIMES = {
    "slump": {"t500": ("spread", 0.5, 0.2, 0.6)},
    "funnel": {"funnel_time": ("screen", 0.5, 1.0, 0.1)},
    "lbox": {"t200": ("front", 0.2, 0.0, 0.5), "t400": ("front", 0.4, 0.0, 0.5)},
}
"""Column, value that the column must pass, and the column's values at start and end, for each test and quantity."""


@pytest.mark.parametrize("method", ["", "-dem"], ids=["flow", "elements"])
@pytest.mark.parametrize(("test", "quantity"), [(test, name) for test, found in TIMES.items() for name in found])
def test_times_lie_between_rows(test, quantity, method):
    """A column that changes evenly passes a value when a straight line does; a bend between other rows is nothing."""
    column, value, begin, end = TIMES[test][quantity]
    made = RUNS[test + method]()
    time = made.series["time"] = np.linspace(0, 1, ROWS) ** 2 * 3.7  # rows need not be evenly apart
    made.series[column] = begin + (end - begin) * time / time[-1]
    exact = time[-1] * (value - begin) / (end - begin)
    assert np.abs(time - exact).min() > 0.01  # no row lies there
    assert made.run()[quantity] == pytest.approx(exact, rel=1e-12)
    made.series[column] = np.where(time > exact, end, begin + (end - begin) * time / time[-1])
    later = time[time > exact][0]
    before = time[time < exact][-1]
    reached = made.series[column][time == before][0]
    assert made.run()[quantity] == pytest.approx(before + (later - before) * (value - reached) / (end - reached))
    made.series[column][:] = begin
    assert quantity not in made.run().result


def test_a_box_is_at_rest_when_most_of_its_concrete_is_slow():
    """A film on a wall that slides down does not count; without the speed of most concrete, the fastest counts."""
    rows = [{"time": t, "fastest": 0.06, "speed_of_most": 5e-4} for t in (1.0, 1.5, 2.0)]
    assert is_at_rest(rows, 1.0, 1e-3) and not is_at_rest(rows, 1.0, 4e-4) and not is_at_rest(rows, 1.5, 1e-3)
    assert not is_at_rest([{**row, "speed_of_most": 2e-3} for row in rows[:1]] + rows[1:], 0.0, 1e-3)
    assert not is_at_rest([{"time": row["time"], "fastest": row["fastest"]} for row in rows], 1.0, 1e-3)


@pytest.mark.parametrize(
    ("column", "time"),
    [
        ([0.0, 1.0, 2.0, 4.0], 3.0),
        ([0.0, 1.0, 3.0, 4.0], 2.0),
        ([0.0, 4.0, 1.0, 4.0], 0.75),  # The first passage counts.
        ([0.0, 1.0, 2.0, 2.9], None),
        ([3.0, 4.0, 5.0, 6.0], None),
        ([4.0, 1.0, 0.0, 5.0], None),
        ([3.0], None),
    ],
)
def test_a_passage_needs_a_row_before_it(column, time):
    """A column that is at the value or beyond it from the start never reaches it, whatever it does later."""
    series = {"time": np.array([0.0, 1.0, 2.0, 4.0])[: len(column)], "front": np.array(column)}
    fallen = series | {"front": -series["front"]}
    assert passage_time(series, "front", 3.0) == passage_time(fallen, "front", -3.0, True) == time
