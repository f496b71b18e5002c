"""Measures of one setting of a trade-off study: cost, work, memory, failure and suspicious results of its runs."""

import math
from itertools import permutations
from types import SimpleNamespace
from typing import Any

from warpcrete.core.errors import InstabilityError
from warpcrete.core.units import quantity
from warpcrete.studies.tradeoffs.fronts import Error
from warpcrete.studies.tradeoffs.points import WANTED_ERRORS, Setting
from warpcrete.studies.tradeoffs.state import Trade
from warpcrete.studies.tradeoffs.trade import _find_promises


def result(wall, packing=None, steps=10, failed=(), **counts):
    """Return the contents of a result.json with the given times [s]."""
    speed = {"wall_time": quantity(wall, "s"), "memory": quantity(1e6 * wall, "B")}
    if packing is not None:
        speed |= {"packing_time": quantity(packing, "s"), "settling_time": quantity(0.5, "s")}
    checks = {name: {"passed": name not in failed, "found": ""} for name in ("volume", "energy")}
    return {"speed": speed, "steps": steps, "checks": checks, **counts}


def test_costs_are_medians_of_whole_runs():
    """Packing and settling count; the work is steps times spheres, or times particles of a flow."""
    point = Setting("size", {}, {}, {
        1: result(4.0, 2.0, steps=10, spheres=7), 2: result(1.0, 1.0, steps=30, spheres=5),
        5: result(9.0, 9.0, steps=20, spheres=6, failed=("volume",)),
    })  # fmt: skip
    assert point.cost == 6.5 and point.work == 120.0 and point.memory == 4e6
    flow = Setting("size", {}, {}, {0: result(3.0, steps=4, particles=25)})
    assert flow.cost == 3.0 and flow.work == 100.0
    none = Setting("size", {}, {})
    assert all(math.isnan(each) for each in (none.cost, none.work, none.memory))


def test_a_failure_is_that_of_the_lowest_seed():
    """Runs end in any order; the answer must not depend on it."""
    point = Setting("size", {}, {}, failures={7: "later", 3: "first", 5: "between"}, left_out="too slow")
    assert point.failure == "first"
    assert Setting("size", {}, {}, left_out="too slow").failure == "too slow" and not Setting("size", {}, {}).failure


def test_a_setting_is_suspect_if_any_of_its_runs_fails_a_check():
    point = Setting("size", {}, {}, {1: result(1.0), 2: result(1.0, failed=("volume",)),
                                     3: result(1.0, failed=("volume", "energy"))})  # fmt: skip
    assert point.suspect == ["energy", "volume"]
    assert Setting("size", {}, {}, {1: result(1.0)}).suspect == []


def test_a_promise_is_the_cheapest_setting_that_is_neither_suspect_nor_failed_nor_too_inaccurate():
    """Settings that are suspect already are not run with new seeds; one of them becomes suspect in these runs."""
    bounds = {"suspect": 0.01, "estimated": 0.01, "later": 0.01, "rough": 0.08, "good": 0.04, "dear": 0.005}
    settings = {name: Setting(name, {}, {}, {0: result(1.0 + k, failed=("volume",) if name == "suspect" else ())})
                for k, name in enumerate(bounds)}  # fmt: skip
    settings["estimated"].timed = False
    ran: list[str] = []

    def run(point: Setting, seeds: list[int], tell: Any) -> bool:
        ran.append(point.origin)
        if point.origin == "later":
            point.results[seeds[0]] = result(1.0, failed=("energy",))
        return True

    trade: Any = SimpleNamespace(
        exact=False, reference=None, has_seeds=True, chosen_knobs=[], seeds=[0], measured=list(settings.values()),
        promised=lambda point: bounds[point.origin], promises=[], run=run,
        errors_of=lambda point, seeds: [Error("pressure", 0.001, 0.0)],
    )  # fmt: skip
    _find_promises(trade, lambda *told: None)
    found = {promise.target: promise.point and promise.point.origin for promise in trade.promises}
    assert found == dict(zip(WANTED_ERRORS, ("rough", "rough", "good", "dear", "dear"), strict=True))
    assert set(ran) == {"later", "rough", "good", "dear"}


def test_workers_that_end_in_any_order_leave_the_results_before_the_first_failure(tmp_path, monkeypatch):
    """Seeds 2 and 4 fail; only the result of seed 1 counts, whether seed 3 ended before or after them."""
    outcomes = {1: result(1.0) | {"finished": True}, 2: InstabilityError("of seed 2"),
                3: result(3.0) | {"finished": True}, 4: InstabilityError("of seed 4")}  # fmt: skip
    monkeypatch.setattr(Trade, "parameters_of", lambda trade, point, seed: {})
    monkeypatch.setattr(Trade, "folder_of", lambda trade, point, seed: tmp_path / f"seed={seed}")
    monkeypatch.setattr(Trade, "hardware", "here")
    for order in permutations(outcomes):
        trade = object.__new__(Trade)
        trade.spent, trade.device, trade.threads, trade.record = 0.0, "cpu", 1, {}
        trade.module, trade.folder, trade.gap = None, tmp_path, 0.0
        point = Setting("size", {}, {})

        def each(work, where, jobs, store, gap, lazily):
            for job, _ in jobs:
                store(job, [outcomes[seed] for seed in job[1]])

        trade._run_on(SimpleNamespace(each=each), iter([(point, [seed], 10.0) for seed in order]))
        assert point.results == {1: outcomes[1]} and sorted(point.failures) == [2, 4]
        assert point.failure == "failed: of seed 2"
