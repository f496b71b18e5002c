"""Parts of a line by discrete elements: blockage, segregation and wear where the bore changes."""

from types import SimpleNamespace

import numpy as np
import pytest
from test_part_elements import SMALL

from warpcrete import Simulation, scenes
from warpcrete.dem.measure.blockage_results import blocked_words, not_blocked_words
from warpcrete.dem.measure.quantities import report
from warpcrete.dem.measure.segregation import measured
from warpcrete.geometry.axis import Axis, Line
from warpcrete.geometry.bores import Bores

NARROW = dict(unit="horizontal", taper=0.05, ramp=0.02, friction=0.5, modulus=1e6)


def test_a_narrow_reducer_is_blocked_and_ends_the_run(device):
    """The throat is 2.5 times as wide as the average stone; at 3 and more it is not blocked."""
    scene = scenes.part_dem(**SMALL | NARROW | dict(travel=0.1, outlet_diameter=0.04, stop_when_blocked=True))
    run = Simulation(scene, device=device).run()
    assert run.finished and run["blocked"] == 1 and run.series["travel"][-1] < 0.09
    begin = scene.pipe.travel + 0.1
    assert begin - 0.04 < run["blocked_at"] < begin + 0.09  # the taper, or just ahead of it
    assert "BLOCKED" in dict(report(run)) and "blockage" not in dict(report(run))
    found = scenes.modules()["part-dem"].check(run)
    assert not found["not blocked"][0] and found["finished"][0]


def test_a_part_that_is_not_blocked_says_so(device):
    scene = scenes.part_dem(**SMALL | dict(unit="vertical", outlet_diameter=0.06, taper=0.1, segregation=True))
    run = Simulation(scene, device=device).run()
    assert run["blocked"] == 0 and run["slowest_advance"] > 0.5
    assert "not blocked" in dict(report(run))["blockage"]
    assert all(0 < run.series[name][-1] < 0.8 for name in ("aggregate_inner", "aggregate_outer", "aggregate_front"))


@pytest.mark.slow
def test_the_default_part_passes_its_checks(device):
    """With 1e5 Pa, the default of pipe units, the stones of a part are still being compressed at the end."""
    run = Simulation(scenes.part_dem(), device=device).run()
    assert all(passed for passed, _ in scenes.modules()["part-dem"].check(run).values()) and run["flux_ratio"] > 0.8


def test_a_widening_part_is_not_blocked(device):
    """Where the bore is four times as wide, concrete advances a quarter as far; by volume it keeps up."""
    scene = scenes.part_dem(
        **SMALL | dict(unit="horizontal", diameter=0.06, outlet_diameter=0.12, taper=0.1, travel=0.06)
    )
    run = Simulation(scene, device=device).run()
    assert run["blocked"] == 0 and run["slowest_advance"] > 0.6


def test_a_run_that_is_too_short_to_show_a_blockage_says_so():
    def words(travel, slowest):
        result = {"blockage_window": {"value": 0.08, "unit": "m"}, "slowest_advance": slowest}
        return not_blocked_words(SimpleNamespace(result=result, series={"travel": np.array([0.0, travel])}))

    assert "only 0.1 m" in words(0.1, 0.9)
    assert "at least 0.90 times" in words(0.5, 0.9)
    assert "move the piston further" in words(0.5, 0.1)
    assert "too few aggregates" in words(0.5, None)


@pytest.mark.parametrize("travel, words", [(0.0, "since the piston began to move"),
                                           (0.25, "since a piston travel of 0.25 m")])  # fmt: skip
def test_a_blockage_says_since_when_concrete_stands_still(travel, words):
    names = ("at", "pressure", "pressure_before", "solid_fraction", "chains")
    result = {f"blocked_{name}": 1.0 for name in names} | {"blocked_from_travel": travel}
    assert words in blocked_words(SimpleNamespace(result=result))


def test_segregation_in_a_cone_of_evenly_spread_stones():
    """Small stones placed at random fill inner and outer half alike, and a straight bore gives the radius' values."""
    rng = np.random.default_rng(1)
    axis, bores, length = Axis((0, 0, 0), (1, 0, 0), (Line(1.0),)), Bores((0.2, 0.8), (0.05, 0.03)), 1.0
    place = rng.uniform((0, -0.05, -0.05), (length, 0.05, 0.05), (60_000, 3))
    place = place[np.hypot(place[:, 1], place[:, 2]) < bores.at(place[:, 0])]
    size = rng.uniform(1e-3, 2e-3, len(place))
    stones = place, size / 2, np.pi / 6 * size**3, size
    found = measured(axis, bores, stones)
    overall = stones[2].sum() / bores.volume(0, length)
    for name in ("aggregate_inner", "aggregate_outer", "aggregate_front", "aggregate_rear"):
        assert found[name] == pytest.approx(overall, rel=0.03)
    assert found["large_inner"] == pytest.approx(found["large_outer"], rel=0.03) and found["mixing"] > 0.98
    thin = place[:, 1] ** 2 + place[:, 2] ** 2 < 0.03**2
    core = tuple(each[thin] for each in stones)
    assert measured(axis, Bores((0.0,), (0.03,)), core) == pytest.approx(measured(axis, 0.03, core), rel=1e-12)
