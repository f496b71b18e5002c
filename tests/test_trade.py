"""Speed against accuracy: statistics, choices, and trades of small scenes."""

import csv
import importlib
import json
import math
import shutil
from dataclasses import replace

import numpy as np
import pytest
from conftest import devices
from pumping import command

from warpcrete.core.errors import RunFolderError, SceneError
from warpcrete.core.units import number
from warpcrete.methods import method_of
from warpcrete.scenes import modules
from warpcrete.studies.advice import SHIPPED, advise, compact, shipped
from warpcrete.studies.fronts import Error, cheapest_within, difference, front, next_within, student, worst
from warpcrete.studies.trade import resume_trade, run_trade
from warpcrete.studies.trading import COMBINED, GIVEN, REFERENCE, Point, Trade

channel, pipe = (importlib.import_module(f"warpcrete.scenes.{name}") for name in ("channel", "pipe"))
COARSE = dict(spacing=0.02)
PIPE = dict(
    diameter=0.08, length=0.1, travel=0.02, ramp=0.01, settle=0.05, size_min=8e-3, size_max=16e-3, sample_interval=0.002
)
QUANTILES = {1: 12.706, 2: 4.303, 10: 2.228, 11: 2.201, 15: 2.131, 30: 2.042, 120: 1.980}
FURTHER = {"channel": {"aggregates": True}, "pipe": {"shapes": "reference", "wall": "mesh"}}


def test_quantiles_of_student():
    # Of published tables, to the digits that they have.
    for freedom, quantile in QUANTILES.items():
        assert student(freedom) == pytest.approx(quantile, abs=1.5e-3)


def test_intervals_hold_the_true_difference_as_often_as_they_say():
    random = np.random.default_rng(1)
    held = []
    for _ in range(4000):
        a, b = random.normal(1.1, 0.02, 3), random.normal(1.0, 0.05, 4)
        error = difference("x", a, b, size=1.0)
        held.append(abs(error.shift - 0.1) <= error.interval)
    assert 0.94 <= np.mean(held) <= 0.98  # Welch's interval is a little wide for so few


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
        held.append(abs(errors[-1]) <= next_within(errors[:-1]))
    # |mean| + t s sqrt(1 + 1/n) bounds the next one on either side, and so a little more than 95 % of them.
    assert 0.945 <= np.mean(held) <= 0.99
    assert next_within([-0.03]) == 0.03 and next_within([0.01, 0.01]) == pytest.approx(0.01)


def test_variants_of_a_flow_are_other_scenes_that_can_be_made():
    given = channel.scene.parameters()
    variants = channel.trading.variants(given)
    assert {"twice the flow", "a concrete that shears", "concrete no2", "concrete no3"} <= set(variants)
    made = {name: channel.scene(**changes) for name, changes in variants.items()}
    assert len({(s.concrete, s.radius, s.velocity) for s in made.values()}) == len(made)
    sheared = made["a concrete that shears"]
    theory = sheared.theory()
    assert theory.slip_velocity / sheared.velocity == pytest.approx(0.72, abs=0.02)
    assert channel.trading.variants(channel.scene.parameters(aggregates=True)) == {}


def test_pressures_of_a_shorter_unit_count_by_its_length(tmp_path):
    record = {"scene": "pipe", "parameters": {}, "quantities": ["plateau_pressure"], "knobs": ["length"], "repeat": 1,
              "seeded": True, "device": "cpu", "threads": 1, "provenance": {}}  # fmt: skip
    trade = Trade(tmp_path, pipe, record)
    assert not trade.chosen_knobs
    half = trade.point("length", {"length": 1})
    half.results[0] = {"plateau_pressure": {"value": 11e3, "unit": "Pa"}}
    assert half.parameters["length"] == 0.5
    assert half.values("plateau_pressure", [0]) == [1e3 + 2 * 10e3]  # the plug's 1 kPa stays what it is
    assert not any(k.name == "length" for k in pipe.trading.knobs(pipe.scene.parameters(unit="D")))


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


@pytest.mark.parametrize("name", sorted(modules()))
def test_every_level_of_every_knob_makes_another_scene(name):
    module = modules()[name]
    for base in ({}, FURTHER.get(name, {})):
        given = module.scene.parameters(**base)
        for knob in module.trading.knobs(given):
            assert len(knob.levels) > 1 and len({level.label for level in knob.levels}) == len(knob.levels)
            made = [module.scene(**module.scene.meaningful(base | dict(level.changes))) for level in knob.levels]
            texts = [json.dumps(scene.parameters, sort_keys=True, default=str) for scene in made]
            assert len(set(texts)) == len(texts), knob.name
            own = json.dumps(module.scene(**base).parameters, sort_keys=True, default=str)
            assert own in texts, f"{knob.name}: no level is the scene as given"
        known = {each.name for each in method_of(module.scene(**base)).quantities}
        assert set(module.trading.quantities) <= known


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
                     knobs=["time step", "regularisation"])  # fmt: skip


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
    # What is promised is measured, and what its knobs err by alone.
    for promise in trade.promises:
        if promise.point is not None:
            assert trade.promised(promise.point) <= promise.target
            cheaper = [p for p in trade.measured if p.cost < promise.point.cost and not p.suspect]
            for other in cheaper:  # it errs by more, here or in a variant
                tried = [p for p in trade.tried if p.levels == other.levels and p.results]
                assert max(trade.promised(other), trade.carried_bound(other, tried)) > promise.target
            assert set(promise.carried) == set(VARIANTS) and all(promise.carried.values())
            sizes = [abs(error.shift) for error in promise.carried.values()]
            assert max(sizes) <= promise.bound <= promise.target
    assert trade.promises[0].point is not None


def test_what_a_trade_writes(flow_trade):
    folder = flow_trade.folder
    assert {p.name for p in folder.iterdir()} == {"trade.json", "trade.md", "trade.csv", "trade.png", "runs"}
    rows = list(csv.DictReader((folder / "trade.csv").open()))
    assert len(rows) == len(flow_trade.points) and float(rows[0]["pressure_error"]) == flow_trade.given.errors[0].shift
    text = (folder / "trade.md").read_text()
    assert "against the closed form" in text and "time step 0.002 s" in text
    record = json.loads((folder / "trade.json").read_text())
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
    assert all({2, 3, 4} <= set(promise.point.results) for promise in tried)


def test_what_a_budget_leaves_out_is_said_and_run_later(tmp_path, monkeypatch):
    with monkeypatch.context() as patched:
        patched.setattr(Trade, "expected", lambda self, point: 1e9)
        trade = run_trade("channel", channel, base=COARSE, out=tmp_path / "t", budget=600.0, device="cpu", threads=1,
                          knobs=["spacing"])  # fmt: skip
    left_out = [p for p in trade.points if not p.results]
    assert len(left_out) == len(trade.points) - 1 > 0
    assert all(p.failure.startswith("not run: takes some 1e+09 s") for p in left_out)
    assert "not run" in (tmp_path / "t" / "trade.md").read_text()
    again = resume_trade(tmp_path / "t", channel, budget=600.0)
    assert all(p.results for p in again.points)


@pytest.mark.parametrize(
    "settings, match",
    [
        (dict(quantities=["presure"]), "quantity = 'presure': must be among"),
        (dict(knobs=["spacings"]), "knob = 'spacings': must be among spacing"),
        (dict(repeat=2), "repeat = 2: goes by seeds, and nothing is random"),
        (dict(repeat=0), "repeat = 0: must be 1"),
        (
            dict(quantities=["volume_error"]),
            "quantity = 'volume_error': has no closed form to be compared with; take pressure or",
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
    with pytest.raises(SceneError, match=r"is too short for a pair of runs.*one takes"):
        run_trade("channel", channel, base=COARSE, out=tmp_path / "t", budget=1e-3, device="cpu", threads=1)


def test_a_quantity_that_the_scene_does_not_come_to_is_refused(tmp_path):
    with pytest.raises(SceneError, match="quantity = 'plateau_pressure': is nothing that the scene as given comes to"):
        run_trade(
            "pipe", pipe, base=PIPE | dict(travel=0.005), out=tmp_path / "t", device="cpu", repeat=2, budget=600.0
        )


def test_folders_that_hold_no_trade_of_this_version_are_refused(flow_trade, tmp_path):
    record = json.loads((flow_trade.folder / "trade.json").read_text())
    (tmp_path / "trade.json").write_text(json.dumps(record | {"provenance": {"warpcrete": "0.0.1"}}))
    with pytest.raises(RunFolderError, match=r"was made by version 0\.0\.1"):
        resume_trade(tmp_path, channel)
    (tmp_path / "trade.json").write_text("{}")
    with pytest.raises(RunFolderError, match="holds no trade"):
        resume_trade(tmp_path, channel)


def test_the_command(tmp_path):
    done = command("trade", "channel", "--spacing", "0.02", "--knob", "tolerance", "--budget", "60s", "--quiet",
                   "--threads", "1", "--device", "cpu", "--out", tmp_path / "t")  # fmt: skip
    assert done.returncode == 0 and "| error wanted |" in done.stdout and (tmp_path / "t" / "trade.png").is_file()
    for words, message in (
        (("trade", "channel", "--budget", "5 apples"), "must be a time such as 90s, 20min or 2h"),
        (("trade", "chanel"), "scene = 'chanel': must be one of"),
        (("trade", "channel", "--spacing", "0.01", "0.02"), "takes one value"),
        (("trade", "--resume", tmp_path), "is no trade's folder"),
        (("trade", "channel", "--resume", tmp_path / "t"), "goes on as the trade began"),
    ):
        done = command(*words)
        assert done.returncode == 2 and message in done.stderr and len(done.stderr.strip().splitlines()) == 1


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
    # What somebody chose stays; where the scene is another one, that is said.
    advice = advise(flow_trade.folder, "channel", channel, COARSE | dict(time_step=3e-4, flow=1e-3), 0.2)
    assert "time_step" not in advice.changes and set(advice.outside) == {
        "time_step 0.0003 for 0.0005",
        "flow 0.001 for None",
    }
    with pytest.raises(SceneError, match=r"accuracy = .0\.0001 %.: was not reached: that trade promises"):
        advise(flow_trade.folder, "channel", channel, COARSE, 1e-6)
    with pytest.raises(RunFolderError, match="is of the scene 'channel', not 'pipe'"):
        advise(flow_trade.folder, "pipe", pipe, {}, 0.1)


def test_coarser_aggregate_is_that_of_the_scene(tmp_path):
    levels = {"coarse-graining": "x 2", "time step": "x 1.5"}
    promise = {"setting": "x", "levels": levels, "promised": 0.04, "ratio": 0.3}
    record = {"scene": "pipe", "parameters": {}, "quantities": ["plateau_pressure"], "promises": [promise]}
    (tmp_path / "trade.json").write_text(json.dumps(record))
    advice = advise(tmp_path, "pipe", pipe, {"size_max": 0.012, "size_min": 0.006, "diameter": 0.1}, 0.05)
    assert advice.changes == pytest.approx({"size_min": 0.012, "size_max": 0.024, "safety": 1.2})
    assert not advice.left_out
    advice = advise(tmp_path, "pipe", pipe, {"safety": 0.5}, 0.05)
    assert "safety" not in advice.changes and advice.changes["size_max"] == pytest.approx(0.04)
    assert advice.left_out == ("time step 0.75, for what is given",)
    # A pipe too narrow for that: the level is none of its own, and no other one takes its place.
    advice = advise(tmp_path, "pipe", pipe, {"diameter": 0.08}, 0.05)
    assert advice.changes == pytest.approx({"safety": 1.2})
    assert advice.left_out == ("coarse-graining x 2, which this scene has not",)


def test_what_only_repeats_the_measured_scene_is_not_kept_from_being_set(flow_trade):
    (promise,) = [p for p in flow_trade.promises if p.target == 0.2]
    default = channel.scene.parameters().time_step
    advice = advise(flow_trade.folder, "channel", channel, COARSE, 0.2)
    if "time step" in promise.point.levels:  # chosen by somebody, and so it stays
        assert advise(flow_trade.folder, "channel", channel, COARSE | {"time_step": 3e-4}, 0.2).left_out
    assert advice.changes.get("time_step", default) == promise.point.parameters.get("time_step", default)


@pytest.mark.slow
def test_an_interrupted_trade_keeps_its_reference(element_trade, tmp_path, monkeypatch):
    shutil.copytree(element_trade, tmp_path / "t")
    trade = resume_trade(tmp_path / "t", pipe)
    before = json.loads((tmp_path / "t" / "trade.json").read_text())
    (gone,) = [p for p in trade.points if p.levels == {"time step": 1}]
    for seed in trade.seeds:
        (trade._folder(gone, seed) / "result.json").unlink()

    def interrupted(self, point, seed, folder):
        self.interrupted = True

    monkeypatch.setattr(Trade, "_run", interrupted)
    again = resume_trade(tmp_path / "t", pipe, budget=600.0)
    assert again.interrupted and again.reference.levels == trade.reference.levels == {"time step": 4}
    assert again.given.errors == trade.given.errors
    after = json.loads((tmp_path / "t" / "trade.json").read_text())
    assert after["finest"] == before["finest"]
    # Runs of some of the seeds promise nothing.
    partial = Point("x", {}, {}, {trade.seeds[0]: trade.given.results[trade.seeds[0]]})
    again.points.append(partial)
    again.judge()
    assert partial.errors and partial not in again.measured and math.isinf(again.promised(partial))


@pytest.mark.slow
def test_a_setting_whose_fresh_seeds_fail_gives_way(element_trade, tmp_path, monkeypatch):
    shutil.copytree(element_trade, tmp_path / "t")
    trade = resume_trade(tmp_path / "t", pipe)
    from warpcrete.studies import trade as phases

    monkeypatch.setattr(type(trade), "promised", lambda self, point: 0.01)
    cheapest = min(trade.measured, key=lambda p: p.cost)
    for seed in (2, 3, 4):
        folder = trade._folder(cheapest, seed)
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "failed.txt").write_text("failed: exploded")
        cheapest.results.pop(seed, None)
    trade.promises.clear()
    phases._promise(trade, lambda *_: None)
    assert cheapest.failure and all(p.point is not None and p.point is not cheapest for p in trade.promises)


def test_a_run_for_an_accuracy(flow_trade, tmp_path):
    folder = flow_trade.folder
    bare = ("--no-rerun", "--no-usd", "--quiet", "--device", "cpu", "--threads", "1")
    wanted = ("--accuracy", "20%", "--trade", folder)
    done = command("run", "channel", "--spacing", "0.02", *wanted, "--out", tmp_path / "r", *bare)
    assert done.returncode in (0, 3) and "note: " in done.stderr and " within " in done.stderr
    made = json.loads((tmp_path / "r" / "scene.json").read_text())["parameters"]
    advice = advise(folder, "channel", channel, COARSE, 0.2)
    assert {name: made[name] for name in advice.changes} == advice.changes
    for words, message in (
        (("--trade", folder), "means nothing without --accuracy"),
        (("--accuracy", "much", "--trade", folder), "must be per cent"),
        (("--accuracy", "5%", "--trade", tmp_path), "is no trade's folder"),
    ):
        done = command("run", "channel", *words, *bare)
        assert done.returncode == 2 and message in done.stderr and len(done.stderr.strip().splitlines()) == 1


@pytest.mark.parametrize("path", sorted(SHIPPED.glob("*.json")), ids=lambda path: path.stem)
def test_shipped_trades_are_of_scenes_of_this_version(path):
    record = json.loads(path.read_text())
    module = modules()[record["scene"]]
    scene = module.scene(**record["parameters"])  # refuses what it does not know
    assert set(record["quantities"]) <= {each.name for each in method_of(scene).quantities}
    reached = [p for p in record["promises"] if p["setting"]]
    assert reached and all(p["promised"] <= p["target"] for p in reached) and record["machine"]
    for promise in reached:
        advice = advise(path, record["scene"], module, record["parameters"], promise["target"])
        assert not advice.left_out and not advice.outside and advice.promised <= promise["target"]
        module.scene(**module.scene.meaningful({**record["parameters"], **advice.changes}))


def test_the_nearest_shipped_trade_is_taken():
    pipes, channels = modules()["pipe"], modules()["channel"]
    assert shipped("pipe", pipes, {}, True).stem == "pipe-vertical"
    assert shipped("pipe", pipes, {"unit": "D", "velocity": 0.4}, True).stem == "pipe-bend"
    near = {"diameter": 0.1, "length": 0.5, "ramp": 0.15, "travel": 0.25}
    assert shipped("pipe", pipes, near, False).stem == "pipe-narrow"
    assert shipped("channel", channels, {"concrete": "no2"}, True).stem == "channel"
    assert shipped("channel", channels, {"aggregates": True, "duration": 0.2}, False).stem == "two-phases"
    assert shipped("channel", channels, {"aggregates": True}, True).stem == "two-phases"
    # By letters, too; a straight unit goes by a straight one, one without hydrated bonds by one without.
    for unit, trade in zip("ABCD", ("pipe-vertical", "pipe-vertical", "pipe-bend", "pipe-bend"), strict=True):
        assert shipped("pipe", pipes, {"unit": unit}, True).stem == trade
    assert not advise(SHIPPED / "pipe-bend.json", "pipe", pipes, {"unit": "D"}, 0.2).outside
    assert shipped("pipe", pipes, {"length": 0.4, "ramp": 0.1, "travel": 0.2}, True).stem == "pipe-vertical"
    assert shipped("pipe", pipes, {"hydration": 0.1}, True).stem == "pipe-hydrated"
    assert shipped("nothing", pipes, {}, False) is None


def test_what_a_setting_makes_meaningless_is_left_out(tmp_path):
    bare = ("--no-rerun", "--no-usd", "--quiet", "--device", "cpu", "--threads", "1")
    done = command("run", "channel", "--aggregates", "--aggregate-fraction", "0.2", "--duration", "0.02", "--accuracy",
                   "20%", "--out", tmp_path / "r", *bare)  # fmt: skip
    assert done.returncode in (0, 3) and "phases one phase" in done.stderr, done.stderr
    # What is chosen by hand stays, and is said to be missing from the setting.
    done = command("run", "channel", "--precision", "float32", "--accuracy", "5%", "--out", tmp_path / "s", *bare)
    setting = json.loads((SHIPPED / "channel.json").read_text())["promises"][2]["levels"]
    assert ("without precision float64" in done.stderr) is (setting.get("precision") == "float64")


def test_a_run_for_an_accuracy_by_a_shipped_trade(tmp_path):
    bare = ("--no-rerun", "--no-usd", "--quiet", "--device", "cpu", "--threads", "1")
    done = command("run", "channel", "--accuracy", "10%", "--flow", "0.002", "--out", tmp_path / "r", *bare)
    assert done.returncode == 0, done.stdout + done.stderr
    for words in ("by the shipped trade 'channel', measured on", "within", "twice the flow", "flow 0.002 for None"):
        assert words in done.stderr
    made = json.loads((tmp_path / "r" / "scene.json").read_text())["parameters"]
    assert made["tolerated_error"] == pytest.approx(0.1)
    result = json.loads((tmp_path / "r" / "result.json").read_text())
    advice = advise(SHIPPED / "channel.json", "channel", modules()["channel"], {"flow": 0.002}, 0.1)
    assert max(abs(result["pressure_error"]), abs(result["slip_velocity_error"])) <= advice.promised <= 0.1


def test_what_is_shipped_of_a_trade(flow_trade):
    record = json.loads((flow_trade.folder / "trade.json").read_text())
    kept = compact(record)
    assert kept["promises"] == record["promises"] and len(kept["points"]) == len(record["points"])
    assert "provenance" not in kept and "knobs" not in kept and kept["machine"] == record["machine"]
