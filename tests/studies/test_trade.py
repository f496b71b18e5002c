"""Speed against accuracy: trades of small scenes, their choices, and the files that they leave."""

import csv
import importlib
import json
import math
import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import devices
from pumping import command

from warpcrete.core.errors import RunFolderError, SceneError
from warpcrete.core.units import number
from warpcrete.studies.tradeoffs.advice import advise, compact
from warpcrete.studies.tradeoffs.points import COMBINED, GIVEN, REFERENCE, Setting
from warpcrete.studies.tradeoffs.state import Trade
from warpcrete.studies.tradeoffs.trade import resume_trade, run_trade

channel, pipe, slump = (importlib.import_module(f"warpcrete.scenes.{name}") for name in ("channel", "pipe", "slump"))
COARSE = dict(spacing=0.02)
PIPE = dict(diameter=0.08, length=0.1, travel=0.02, ramp=0.01, settle=0.05, size_min=8e-3, size_max=16e-3,
            sample_interval=0.002, solid_fraction=0.55)  # fmt: skip


VARIANTS = {"twice the flow": {"flow": 3e-3}, "concrete no2": {"concrete": "no2"}}


@pytest.fixture(scope="module")
def flow_trade(tmp_path_factory):
    out = tmp_path_factory.mktemp("trade") / "channel"
    monkeypatch = pytest.MonkeyPatch()
    monkeypatch.setattr(channel, "trading", replace(channel.trading, variants=lambda given: VARIANTS))
    try:
        yield _flow_trade(out)
    finally:
        monkeypatch.undo()


def _flow_trade(out):
    return run_trade("channel", channel, base=COARSE, out=out, budget=300.0, device="cpu", threads=1,
                     knobs=["time-step", "regularisation"])  # fmt: skip


@pytest.mark.thorough
def test_a_trade_of_a_flow_goes_by_the_closed_form(flow_trade):
    trade = flow_trade
    assert trade.exact and trade.reference is None and not trade.has_seeds
    assert [p.origin for p in trade.points[:1]] == [GIVEN]
    assert {p.origin for p in trade.points} <= {GIVEN, "time step", "regularisation", COMBINED}
    for point in trade.points:
        result = point.results[0]
        assert point.cost == pytest.approx(sum(number(result["speed"][k]) for k in ("packing_time", "wall_time")))
        assert point.work == result["steps"] * result["particles"]
        errors = {e.quantity: e.shift for e in point.errors}
        assert errors == {name: result[f"{name}_error"] for name in ("pressure", "slip_velocity")}
        assert point.worst.size == max(map(abs, errors.values()))
    # Every promise was measured, and so was the error of each of its knobs alone.
    for promise in trade.promises:
        if promise.point is not None:
            assert trade.promised(promise.point) <= promise.target
            cheaper = [p for p in trade.measured if p.cost < promise.point.cost and not p.suspect]
            for other in cheaper:  # it errs by more, here or in a variant
                tried = [p for p in trade.tried if p.levels == other.levels and p.results]
                assert max(trade.promised(other), trade.bound_in_variants(other, tried)) > promise.target
            assert set(promise.carried) == set(VARIANTS) and all(promise.carried.values())
            sizes = [abs(error.shift) for error in promise.carried.values()]
            assert max(sizes) <= promise.bound <= promise.target
    assert trade.promises[0].point is not None


def test_what_a_trade_writes(flow_trade):
    folder = flow_trade.folder
    assert {p.name for p in folder.iterdir()} == {"trade.json", "trade.md", "trade.csv", "trade.png", "runs"}
    rows = list(csv.DictReader((folder / "trade.csv").open(encoding="utf-8")))
    assert len(rows) == len(flow_trade.points) and float(rows[0]["pressure_error"]) == flow_trade.given.errors[0].shift
    text = (folder / "trade.md").read_text(encoding="utf-8")
    assert "against the closed form" in text and "time step 0.002 s" in text
    record = json.loads((folder / "trade.json").read_text(encoding="utf-8"))
    assert len(record["points"]) == len(flow_trade.points) and any(p["front"] for p in record["points"])


def test_a_trade_that_is_started_again_uses_its_runs(flow_trade):
    times = {path: path.stat().st_mtime_ns for path in flow_trade.folder.rglob("result.json")}
    again = resume_trade(flow_trade.folder, channel, budget=1e-3)
    assert again.spent == 0.0 and len(again.points) == len(flow_trade.points)
    assert {path: path.stat().st_mtime_ns for path in flow_trade.folder.rglob("result.json")} == times


@pytest.fixture(scope="module", params=devices())
def element_trade(request, tmp_path_factory):
    out = tmp_path_factory.mktemp("trade") / "pipe"
    run_trade("pipe", pipe, base=PIPE, out=out, knobs=["time step", "coarse-graining"], budget=600.0,
              device=request.param, threads=1, repeat=2, quantities=["end_pressure"])  # fmt: skip
    return out


@pytest.mark.thorough
def test_a_trade_of_elements_goes_by_the_finest_setting_and_its_seeds(element_trade, tmp_path):
    shutil.copytree(element_trade, tmp_path / "t")
    trade = resume_trade(tmp_path / "t", pipe)
    assert trade.seeds == [0, 1] and not trade.exact
    finest = trade.reference
    assert finest.origin == REFERENCE and finest.levels == {"time step": 4}
    given, fine = (point.values("end_pressure", trade.seeds) for point in (trade.given, finest))
    assert len(given) == len(fine) == 2 and given[0] != given[1] and fine[0] != fine[1]
    expected = np.mean(given) / np.mean(fine) - 1
    assert trade.given.errors[0].shift == pytest.approx(expected) and trade.given.errors[0].interval > 0
    assert finest.errors[0].shift == 0 and finest.errors[0].interval > 0
    # Gone on with, however little time there is, it goes by the same.
    again = resume_trade(tmp_path / "t", pipe, budget=1e-3)
    assert again.spent == 0 and again.reference.levels == finest.levels
    assert [p.errors for p in again.points] == [p.errors for p in trade.points]
    # Coarser aggregate is cheaper, which no machine changes.
    (coarse,) = [p for p in trade.points if p.levels == {"coarse-graining": 0}]
    assert coarse.work < 0.5 * trade.given.work
    # Promises are tried with seeds that no other run had.
    tried = [promise for promise in trade.promises if promise.found is not None]
    assert tried and all({2, 3, 4} <= set(promise.point.results) for promise in tried)


@pytest.mark.thorough
def test_what_a_budget_leaves_out_is_said_and_run_later(tmp_path, monkeypatch):
    with monkeypatch.context() as patched:
        patched.setattr(Trade, "expected", lambda self, point: 1e9)
        trade = run_trade("channel", channel, base=COARSE, out=tmp_path / "t", budget=600.0, device="cpu", threads=1,
                          knobs=["spacing"])  # fmt: skip
    left_out = [p for p in trade.points if not p.results]
    assert len(left_out) == len(trade.points) - 1 > 0
    assert all(p.failure.startswith("not run: needs about 1e+09 s") for p in left_out)
    assert "not run" in (tmp_path / "t" / "trade.md").read_text(encoding="utf-8")
    again = resume_trade(tmp_path / "t", channel, budget=600.0)
    assert all(p.results for p in again.points)


@pytest.mark.parametrize(
    "settings, match",
    [
        (dict(quantities=["presure"]), "quantity = 'presure': must be one of"),
        (dict(knobs=["spacings"]), "knob = 'spacings': must be one of spacing"),
        (dict(repeat=2), "repeat = 2: must be 1, because nothing in this scene is random"),
        (dict(repeat=0), "repeat = 0: must be a whole number from 1"),
        (
            dict(quantities=["volume_error"]),
            "quantity = 'volume_error': has no exact solution for comparison; use pressure or",
        ),
        (dict(threads=-1), "threads"),
        (dict(budget=0.0), "budget = 0.0: must be"),
        (dict(budget=math.nan), "budget = nan: must be"),
        (dict(base={"spacing": -1.0}), "spacing"),
    ],
)
def test_what_makes_no_trade_is_refused_before_anything_is_written(tmp_path, settings, match):
    with pytest.raises(SceneError, match=match):
        run_trade("channel", channel, out=tmp_path / "t", device="cpu", **(dict(base=COARSE) | settings))
    assert not (tmp_path / "t").exists()


def test_a_budget_too_short_for_a_pair_of_runs_is_refused(tmp_path):
    with pytest.raises(SceneError, match=r"is too short for two runs.*one run takes"):
        run_trade("channel", channel, base=COARSE, out=tmp_path / "t", budget=1e-3, device="cpu", threads=1)


def test_a_quantity_that_the_scene_does_not_come_to_is_refused(tmp_path):
    with pytest.raises(
        SceneError, match="quantity = 'plateau_pressure': is missing in the result of the scene with the given"
    ):
        run_trade(
            "pipe", pipe, base=PIPE | dict(travel=0.005), out=tmp_path / "t", device="cpu", repeat=2, budget=600.0
        )


def test_folders_that_hold_no_trade_of_this_version_are_refused(flow_trade, tmp_path):
    record = json.loads((flow_trade.folder / "trade.json").read_text(encoding="utf-8"))
    (tmp_path / "trade.json").write_text(json.dumps(record | {"provenance": {"warpcrete": "0.0.1"}}), encoding="utf-8")
    with pytest.raises(RunFolderError, match=r"was measured with version 0\.0\.1"):
        resume_trade(tmp_path, channel)
    (tmp_path / "trade.json").write_text("{}", encoding="utf-8")
    with pytest.raises(RunFolderError, match="is not the record of a trade-off study"):
        resume_trade(tmp_path, channel)


@pytest.mark.thorough
def test_the_command(tmp_path):
    done = command("trade", "channel", "--spacing", "0.02", "--knob", "tolerance", "--budget", "60s", "--quiet",
                   "--threads", "1", "--device", "cpu", "--out", tmp_path / "t")  # fmt: skip
    assert done.returncode == 0 and "| error wanted |" in done.stdout and (tmp_path / "t" / "trade.png").is_file()
    for words, message in (
        (("trade", "channel", "--budget", "5 apples"), "must be a time such as 90s, 20min or 2h"),
        (("trade", "chanel"), "scene = 'chanel': must be one of"),
        (("trade", "channel", "--spacing", "0.01", "0.02"), "must be a single value"),
        (("trade", "--resume", tmp_path), "is not the folder of a trade-off study"),
        (("trade", "channel", "--resume", tmp_path / "t"), "continues with the settings with which it began"),
    ):
        done = command(*words)
        assert done.returncode == 2 and message in done.stderr and len(done.stderr.strip().splitlines()) == 1


@pytest.mark.thorough
def test_a_scene_function_is_traded_from_python(tmp_path):
    import warpcrete

    trade = warpcrete.trade(
        warpcrete.scenes.channel,
        out=tmp_path / "t",
        budget=60.0,
        knobs=["tolerance"],
        device="cpu",
        threads=1,
        **COARSE,
    )
    assert trade.scene_name == "channel" and trade.given.results
    assert trade.base == COARSE | {"tolerated_error": 0.2} and trade.record["parameters"].items() >= COARSE.items()
    with pytest.raises(SceneError, match="must be a scene function"):
        warpcrete.trade(lambda: None)


def test_settings_for_an_accuracy(flow_trade):
    best = {p.target: p.bound for p in flow_trade.promises if p.point is not None}
    advice = advise(flow_trade.folder, "channel", channel, COARSE, 0.2)
    (promise,) = [p for p in flow_trade.promises if p.target == 0.2]
    changed = {k: v for k, v in promise.point.parameters.items() if COARSE.get(k) != v}
    assert {k: v for k, v in advice.changes.items() if channel.scene.parameters().__dict__[k] != v} == changed
    assert advice.changes["tolerated_error"] == 0.2 and "twice the flow" in advice.tried
    assert advice.promised == best[0.2] <= 0.2 and advice.outside == () and advice.quantities[0] == "pressure"
    assert advice.ratio == pytest.approx(promise.point.cost / flow_trade.given.cost)
    # A value that the user chose stays. The advice names parameters in which the scene differs from the trade.
    advice = advise(flow_trade.folder, "channel", channel, COARSE | dict(time_step=3e-4, flow=1e-3), 0.2)
    assert "time_step" not in advice.changes and set(advice.outside) == {
        "time_step 0.0003 instead of 0.0005",
        "flow 0.001 instead of the default",
    }
    with pytest.raises(SceneError, match=r"accuracy = .0\.0001 %.: was not reached: this trade-off study guarantees"):
        advise(flow_trade.folder, "channel", channel, COARSE, 1e-6)
    with pytest.raises(RunFolderError, match="measures the scene 'channel', not 'pipe'"):
        advise(flow_trade.folder, "pipe", pipe, {}, 0.1)


@pytest.mark.slow
def test_an_interrupted_trade_keeps_its_reference(element_trade, tmp_path, monkeypatch):
    shutil.copytree(element_trade, tmp_path / "t")
    trade = resume_trade(tmp_path / "t", pipe)
    before = json.loads((tmp_path / "t" / "trade.json").read_text(encoding="utf-8"))
    (gone,) = [p for p in trade.points if p.levels == {"time step": 1}]
    for seed in trade.seeds:
        (trade.folder_of(gone, seed) / "result.json").unlink()

    def interrupted(self, point, seed, folder):
        self.interrupted = True

    monkeypatch.setattr(Trade, "_run", interrupted)
    again = resume_trade(tmp_path / "t", pipe, budget=600.0)
    assert again.interrupted and again.reference.levels == trade.reference.levels == {"time step": 4}
    assert again.given.errors == trade.given.errors
    after = json.loads((tmp_path / "t" / "trade.json").read_text(encoding="utf-8"))
    assert after["finest"] == before["finest"]
    # Runs of some of the seeds promise nothing.
    partial = Setting("x", {}, {}, {trade.seeds[0]: trade.given.results[trade.seeds[0]]})
    again.points.append(partial)
    again.judge()
    assert partial.errors and partial not in again.measured and math.isinf(again.promised(partial))


@pytest.mark.slow
def test_a_setting_whose_fresh_seeds_fail_gives_way(element_trade, tmp_path, monkeypatch):
    shutil.copytree(element_trade, tmp_path / "t")
    trade = resume_trade(tmp_path / "t", pipe)
    from warpcrete.studies.tradeoffs import trade as phases

    monkeypatch.setattr(type(trade), "promised", lambda self, point: 0.01)
    cheapest = min(trade.measured, key=lambda p: p.cost)
    for seed in (2, 3, 4):
        folder = trade.folder_of(cheapest, seed)
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "failed.txt").write_text("failed: exploded", encoding="utf-8")
        cheapest.results.pop(seed, None)
    trade.promises.clear()
    phases._find_promises(trade, lambda *_: None)
    assert cheapest.failure and all(p.point is not None and p.point is not cheapest for p in trade.promises)


@pytest.mark.thorough
def test_a_run_for_an_accuracy(flow_trade, tmp_path):
    folder = flow_trade.folder
    bare = ("--no-rerun", "--no-usd", "--quiet", "--device", "cpu", "--threads", "1")
    wanted = ("--accuracy", "20%", "--trade", folder)
    done = command("run", "channel", "--spacing", "0.02", *wanted, "--out", tmp_path / "r", *bare)
    assert done.returncode == 0 and "note: " in done.stderr and " within " in done.stderr  # its checks accept 20 %
    made = json.loads((tmp_path / "r" / "scene.json").read_text(encoding="utf-8"))["parameters"]
    advice = advise(folder, "channel", channel, COARSE, 0.2)
    assert {name: made[name] for name in advice.changes} == advice.changes
    for words, message in (
        (("--trade", folder), "has no effect without --accuracy"),
        (("--accuracy", "much", "--trade", folder), "must be a percentage"),
        (("--accuracy", "5%", "--trade", tmp_path), "is not the folder of a trade-off study"),
    ):
        done = command("run", "channel", *words, *bare)
        assert done.returncode == 2 and message in done.stderr and len(done.stderr.strip().splitlines()) == 1


def test_what_is_shipped_of_a_trade(flow_trade):
    record = json.loads((flow_trade.folder / "trade.json").read_text(encoding="utf-8"))
    kept = compact(record)
    assert kept["promises"] == record["promises"] and len(kept["points"]) == len(record["points"])
    assert "provenance" not in kept and "knobs" not in kept and kept["machine"] == record["machine"]


def test_the_reference_is_as_fine_as_the_budget_allows():
    """Costs double with each level of `a` and triple with each of `b`; what saves most for its error gives way.

    From the finest levels, (2, 2), the ratios of saving to error are 34 for `a` and 27 for `b`, then 7 and 27, 7 and
    22, and 7 at last. The costs are 36, 18, 6, 2 and 1 times that of the scene as given, 10 s in two rounds of seeds.
    """
    phases = importlib.import_module("warpcrete.studies.tradeoffs.trade")
    knobs = [SimpleNamespace(name=name, levels=(0, 1, 2)) for name in "ab"]
    costs, errors = {"a": 2.0, "b": 3.0}, {"a": (0.1, 0.02, 0.0), "b": (0.05, 0.04, 0.0)}

    def reference(allowed, spent=5.0, **changes):
        found = []
        trade = SimpleNamespace(**{
            "knobs": knobs, "chosen_knobs": knobs, "level_as_given": lambda knob: 0, "seeds": (1, 2), "points": [],
            "given": SimpleNamespace(cost=10.0), "spent": spent, "budget": (allowed + spent) / phases.FINEST_UNTIL,
            "ratio": lambda knob, level: costs[knob.name] ** level, "rounds": lambda runs: runs, "record": {"kept": 1},
            "shift": lambda knob, level: errors[knob.name][level], "run": lambda *rest: True,
            "point": lambda origin, levels: found.append(dict(levels)) or SimpleNamespace(origin=origin),
        } | changes)  # fmt: skip
        phases._run_reference(trade, print)
        return tuple(found[0].values()), trade.record.get("finest")

    for cost, levels in ((36, (2, 2)), (18, (1, 2)), (6, (1, 1)), (2, (1, 0)), (1, (0, 0))):
        assert reference(20 * cost * 1.001) == (levels, {"a": levels[0], "b": levels[1]})
        assert reference(20 * cost * 0.999) != (levels, {"a": levels[0], "b": levels[1]}) or levels == (0, 0)
    assert reference(0.0)[0] == (0, 0) and reference(60.0, level_as_given=lambda knob: 1)[0] == (1, 1)
    assert reference(0.0, record={"finest": {"a": 1, "b": 2}})[0] == (1, 2)
    assert reference(1e9, shift=lambda knob, level: math.inf if level == 2 else 0.01)[0] == (1, 1)
    assert reference(1e9, run=lambda *rest: False)[1] is None
