"""Advice in refusals: the number that a message recommends is accepted, although it is rounded."""

import re

import pytest

from warpcrete import SceneError, scenes
from warpcrete.core.errors import at_least, at_most

THIRD = 0.0123456
"""Number that three digits do not represent."""


def test_limits_are_rounded_to_the_side_that_is_allowed():
    assert (at_least(THIRD), at_most(THIRD)) == ("0.0124", "0.0123")
    assert (at_least(0.0125), at_most(0.0125), at_most(0.0125, 2)) == ("0.0125", "0.0125", "0.012")
    for value in (3 * 0.1, 0.7 * 0.05, 123456.0, 1e-300, 1e300, 0.0, -THIRD):
        assert float(at_most(value)) <= value <= float(at_least(value))


@pytest.mark.parametrize(
    "name, given",
    [
        ("stretch", {"length": 0.02, "spacing": 0.0035, "aggregate_largest": THIRD, "aggregate_smallest": THIRD}),
        ("stretch", {"spacing": 0.005, "diameter": 0.03333, "length": 0.1, "gradient": 1e5, "aggregate_fraction": 0.1,
                     "aggregate_smallest": 0.016, "aggregate_largest": 0.016}),
        ("slump", {"aggregate_largest": 0.04, "aggregate_fraction": 0.1, "lift_time": 0.0, "spacing": 0.008,
                   "aggregate_smallest": 0.03}),
        ("jring", {"plate_radius": 0.1, "ring_diameter": 0.3003}),
        ("jring", {"ring_diameter": 0.2, "bar_diameter": 0.0181234, "bars": 8}),
        ("jring-dem", {"ring_diameter": 0.2, "bar_diameter": 0.0181234, "bars": 8}),
        ("lbox", {"opening": 0.01, "spacing": 0.01237}),
        ("lbox", {"spacing": 0.02, "bars": 3, "bar_diameter": 0.01237}),
        ("lbox", {"width": 0.1, "bars": 3, "bar_diameter": THIRD, "spacing": 0.005}),
    ],
)  # fmt: skip
def test_the_recommended_number_is_accepted(name, given):
    make = scenes.modules()[name].scene
    with pytest.raises(SceneError) as why:
        make(**given)
    field, number = re.match(r"(\w+) = .*; use (\S+) m", str(why.value)).groups()
    assert field in given
    make(**given | {field: float(number)})
