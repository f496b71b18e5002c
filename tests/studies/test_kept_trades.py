"""Tables, records, figures and courses of trade-offs, made of made-up results, kept (see `kept`)."""

import importlib
import itertools
import json
from types import SimpleNamespace

import kept
import numpy as np
import pytest
from made_studies import made_trade, measured, printed

from warpcrete.cli.calibrate import INTERRUPTED
from warpcrete.cli.trade import report as print_trade
from warpcrete.core.errors import InstabilityError, SceneError
from warpcrete.core.units import quantity
from warpcrete.studies.cluster import WorkerLost
from warpcrete.studies.tradeoffs.fronts import Error
from warpcrete.studies.tradeoffs.points import COMBINED, Promise
from warpcrete.studies.tradeoffs.report import draw as draw_trade
from warpcrete.studies.tradeoffs.report import write as write_trade
from warpcrete.studies.tradeoffs.state import Trade


@pytest.mark.parametrize("kind", ["seeds", "abreast"])
def test_a_trade_is_kept(tmp_path, kind):
    trade = made_trade(tmp_path, **({"abreast": 4} if kind == "abreast" else {}))
    first, second = trade.points[1:3]
    trade.promises = [
        Promise(
            0.2,
            first,
            Error("peak_pressure", -0.03, 0.01),
            {"twice": Error("end_pressure", 0.02, 0.05), "no": None},
            0.15,
        ),
        Promise(0.1, second, bound=0.07),
        Promise(0.05, None),
    ]
    write_trade(trade)
    record = json.loads((tmp_path / "trade.json").read_text(encoding="utf-8"))
    bounds = {trade.label(p): [trade.promised(p), trade.bound_in_variants(p, trade.points[1:3])] for p in trade.points}
    shifts = {knob.name: [trade.shift(knob, level) for level in range(len(knob.levels))] for knob in trade.knobs}
    seeds = [trade.folder_of(point, 2).name for point in trade.points]
    kept.compare(
        f"trade-{kind}",
        {
            "markdown": (tmp_path / "trade.md").read_text(encoding="utf-8").splitlines(),
            "csv": (tmp_path / "trade.csv").read_text(encoding="utf-8").splitlines(),
            "record": record,
            "bounds": bounds,
            "shifts": shifts,
            "folders": seeds,
            "measured": [trade.label(p) for p in trade.measured],
            "ratios": [[trade.ratio(knob, level) for level in range(len(knob.levels))] for knob in trade.knobs],
            "expected": [trade.expected(point) for point in trade.points],
            "repr": repr(trade).partition(", folder")[0],
            "figure": kept.drawn(draw_trade(trade)),
            "printed": printed(print_trade, trade),
        },
    )
    trade.interrupted = True
    *lines, code = printed(print_trade, trade)
    assert "settings not run; continue with: warpcrete trade --resume FOLDER --budget 20min" in lines[-1]
    assert code == INTERRUPTED


@pytest.mark.parametrize("workers", [0, 2])
@pytest.mark.parametrize("budget", [700.0, 300.0])
def test_the_course_of_a_trade_is_kept(budget, workers, tmp_path, monkeypatch):
    """Settings that a trade runs, in order, their reference and promises; runs and their times are made up."""
    state, phases = (importlib.import_module(f"warpcrete.studies.tradeoffs.{name}") for name in ("state", "trade"))
    pipe = importlib.import_module("warpcrete.scenes.pipe")
    clock, ran, told = [0.0], [], []

    def outcome_of(parameters):
        seed, safety = parameters["seed"], parameters.get("safety", 0.8)
        size = parameters.get("size_max", 0.03) / 0.03
        cost = 10 / safety / size**3
        clock[0] += cost
        ran.append([seed, safety, size, clock[0]])
        if size > 2.9:
            return InstabilityError("burst")
        peak = 2e4 * (1 + 0.02 * safety**2 + 0.03 * (size - 1) + 2e-3 * np.sin(seed + 3 * safety))
        return measured(
            seed, peak_pressure=quantity(peak, "Pa"), end_pressure=quantity(0.8 * peak + 20 * seed, "Pa"),
            speed={"packing_time": quantity(0.0, "s"), "wall_time": quantity(cost, "s")},
        )  # fmt: skip

    class Cluster:
        count = workers

        def each(self, function, where, jobs, store, gap, lazily):
            assert function.__name__ == "run_worker_job" and where[1] is pipe and lazily
            told.append([where[0], where[2].name])
            running = list(itertools.islice(jobs, workers))
            while running:
                job, given = running.pop(0)
                told.append([[case.name for case in given.cases], given.load_kernels, given.time_left])
                store(job, [outcome_of(case.parameters) for case in given.cases])
                running += itertools.islice(jobs, 1)

    record = {
        "scene": "pipe", "parameters": {"seed": 2, "bonds": False}, "quantities": ["peak_pressure", "end_pressure"],
        "knobs": ["time step", "coarse-graining"], "repeat": 2, "seeded": True, "device": "cpu", "threads": 1,
        "provenance": {"device_name": "cpu", "processor": "a processor"},
    }  # fmt: skip
    trade = Trade(tmp_path, pipe, record)
    monkeypatch.setattr(Trade, "_run", lambda self, point, seed, folder: self._store_outcome(
        point, seed, outcome_of(self.parameters_of(point, seed))))  # fmt: skip
    monkeypatch.setattr(state, "time", SimpleNamespace(perf_counter=lambda: clock[0]))
    monkeypatch.setattr(phases, "write", lambda trade: None)
    trade.budget, trade.cluster = budget, Cluster() if workers else None
    phases._measure(trade, lambda name, fraction, figures: told.append([name, fraction]))
    points = [
        [p.origin, p.levels, sorted(p.results), {k: str(v) for k, v in p.failures.items()}, p.left_out, p.suspect,
         [[e.quantity, e.shift, e.interval] for e in p.errors]]
        for p in trade.points
    ]  # fmt: skip
    promises = [
        [each.target, each.bound, each.found and each.found.shift, each.point and trade.points.index(each.point)]
        for each in trade.promises
    ]
    kept.compare(
        f"trade-course-{budget:g}-{workers}",
        {"points": points, "promises": promises, "ran": ran, "told": told, "spent": trade.spent,
         "reference": trade.points.index(trade.reference), "finest": trade.record.get("finest"),
         "abreast": trade.record.get("abreast"), "interrupted": trade.interrupted},
    )  # fmt: skip


def test_outcomes_of_a_trades_runs(tmp_path):
    """Only what the scene itself does is its failure; a lost worker leaves a setting out, and an interruption ends."""
    trade = made_trade(tmp_path)
    point = trade.point(COMBINED, {knob.name: 1 for knob in trade.knobs})
    seed = 77
    trade._store_outcome(point, seed, {"finished": False})
    assert trade.interrupted and not point.results
    for outcome in (None, KeyboardInterrupt()):
        trade.interrupted = False
        trade._store_outcome(point, seed, outcome)
        assert trade.interrupted
    trade._store_outcome(point, seed, WorkerLost("gone"))
    assert point.left_out == "not run: gone" and not point.failures
    with pytest.raises(OSError, match="full"):
        trade._store_outcome(point, seed, OSError("full"))
    trade._store_outcome(point, seed, SceneError("x = 1: is wrong"))
    assert point.failures == {seed: "failed: x = 1: is wrong"}
    (path,) = tmp_path.glob("runs/*/failed.txt")
    assert path.parent == trade.folder_of(point, seed) and path.read_text(encoding="utf-8").startswith("failed: x = 1")
    assert trade._take_over(point, [seed]) == [] and str(seed) in path.parent.name
