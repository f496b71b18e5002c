"""Trades on workers of Dask: the same errors as without, whatever ends first; lost workers, interruptions, budgets."""

import importlib
import itertools
import json
import math
import os
import random
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import psutil
import pytest
from conftest import devices
from pumping import INTERRUPTIBLE, wait_until
from test_trade import COARSE, PIPE, VARIANTS

from warpcrete.core.errors import InstabilityError, RunFolderError, SceneError, WarpcreteError
from warpcrete.core.run.provenance import processor
from warpcrete.studies.cases import Case
from warpcrete.studies.cluster import Cluster, WorkerLost
from warpcrete.studies.running import previous_outcome
from warpcrete.studies.tradeoffs import trade as phases
from warpcrete.studies.tradeoffs import trials
from warpcrete.studies.tradeoffs.points import GIVEN
from warpcrete.studies.tradeoffs.state import Trade
from warpcrete.studies.tradeoffs.trade import resume_trade, run_trade
from warpcrete.studies.tradeoffs.trials import WorkerJob, run_worker_job

pytestmark = pytest.mark.thorough

channel, pipe = (importlib.import_module(f"warpcrete.scenes.{name}") for name in ("channel", "pipe"))
SETTINGS = {
    "channel": dict(base=COARSE, knobs=["regularisation"]),
    "pipe": dict(base=PIPE, knobs=["coarse-graining"], repeat=2, quantities=["end_pressure"]),
}
TWO = dict(scheduler="local", workers=2)


@pytest.fixture(autouse=True, scope="module")
def small():
    """Few variants and fresh seeds; and two cores, whatever the tests beside this one leave."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(channel, "trading", replace(channel.trading, variants=lambda given: VARIANTS))
        patched.setattr(phases, "FRESH_SEEDS", 1)
        patched.setattr(phases, "default_threads", lambda: 2)
        yield


def traded(name, out, **settings):
    """Trade with a budget that leaves nothing out, even on a GPU that fifteen other tests share.

    A trade catches SIGINT and SIGTERM. If these signals end the whole suite, this test has not failed.
    """
    module = importlib.import_module(f"warpcrete.scenes.{name}")
    trade = run_trade(name, module, out=out, budget=10 * 3600.0, threads=1, **SETTINGS[name], **settings)
    if trade.interrupted:
        raise KeyboardInterrupt
    return trade


@pytest.fixture(scope="module", params=devices())
def alone(request, tmp_path_factory):
    """Trades without workers, by the name of the scene."""
    folder = tmp_path_factory.mktemp("alone")
    return {name: traded(name, folder / name, device=request.param) for name in SETTINGS}


def hashes(folder):
    """Return the state hash of each finished run by the name of the run's folder."""
    results = {
        path.parent.name: json.loads(path.read_text(encoding="utf-8")) for path in folder.glob("runs/*/result.json")
    }
    return {name: result["state_hash"] for name, result in results.items() if "checks" in result and result["finished"]}


def assert_same(trade, other):
    """Wherever both have been, which goes by times, they have found the same."""
    found, wanted = hashes(trade.folder), hashes(other.folder)
    both = found.keys() & wanted.keys()
    assert {key: found[key] for key in both} == {key: wanted[key] for key in both}
    for point in other.points:
        if len(point.levels) == 1 or point.origin == GIVEN:
            (mine,) = [p for p in trade.points if p.full == point.full]
            assert mine.failure == point.failure and mine.errors == point.errors
            assert set(trade.seeds) <= set(mine.results) or point.failure


@pytest.mark.parametrize("name", SETTINGS)
def test_workers_find_the_same_errors(name, alone, tmp_path):
    where = TWO if alone[name].device == "cpu" else dict(scheduler="local")
    trade = traded(name, tmp_path / "t", device=alone[name].device, **where)
    assert_same(trade, alone[name])
    assert all(math.isfinite(p.cost) and p.cost > 0 for p in trade.measured)
    record = json.loads((trade.folder / "trade.json").read_text(encoding="utf-8"))
    most = record["abreast"]
    assert record["threads"] == 1 and trade.machine == alone[name].machine and (most == 2 or where is not TWO)
    said = f"Up to {most} runs were made at the same time, each on its own worker: {trade.machine}."
    assert (said in (trade.folder / "trade.md").read_text(encoding="utf-8")) is (most > 1)
    assert "at the same time" not in (alone[name].folder / "trade.md").read_text(encoding="utf-8")
    if name == "channel":
        tried = [promise for promise in trade.promises if promise.point is not None]
        assert tried and all(set(promise.carried) == set(VARIANTS) for promise in tried)
    # It goes on without workers, with what is there.
    again = resume_trade(trade.folder, importlib.import_module(f"warpcrete.scenes.{name}"), budget=1e-3)
    assert again.spent == 0.0 and (said in (trade.folder / "trade.md").read_text(encoding="utf-8")) is (most > 1)
    assert [p.errors for p in again.points] == [p.errors for p in trade.points]


@pytest.mark.linux
def test_a_lost_worker_and_an_interruption_lose_no_run_that_was_done(alone, tmp_path):
    if alone["pipe"].device != "cpu":
        pytest.skip("needs a CPU, which can have two workers; a GPU has one, and test_cluster covers it")
    out = tmp_path / "t"
    options = [f"--{name.replace('_', '-')}={value}" for name, value in PIPE.items()]
    code = f"import os; os.sched_setaffinity(0, range(os.cpu_count())); {INTERRUPTIBLE}"
    process = subprocess.Popen(
        [sys.executable, "-c", code, "trade", "pipe", *options, "--knob", "coarse-graining", "--quantity",
         "end_pressure", "--repeat", "2", "--device", "cpu", "--scheduler", "local", "--workers", "2", "--out",
         str(out), "--quiet"],
        start_new_session=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, encoding="utf-8",
    )  # fmt: skip

    def wait_for(runs):
        assert wait_until(lambda: process.poll() is not None or len(hashes(out)) >= runs, 120)
        assert process.poll() is None, process.communicate()[0]

    wait_for(1)
    workers = [p for p in psutil.Process(process.pid).children() if "spawn_main" in " ".join(p.cmdline())]
    assert len(workers) == 2
    for worker in workers:  # one of them is about to make the second run
        worker.kill()
    wait_for(3)
    os.killpg(process.pid, signal.SIGINT)
    output = process.communicate(timeout=60)[0]
    assert process.returncode == 130 and "continue with: warpcrete trade --resume" in output, output
    assert "Traceback" not in output and "its worker failed" not in output and (out / "trade.md").is_file()
    times = {path: path.stat().st_mtime_ns for path in (out / "runs" / name / "result.json" for name in hashes(out))}
    assert len(times) >= 3
    again = resume_trade(out, pipe, budget=300.0, **TWO)
    assert not again.interrupted and times == {path: path.stat().st_mtime_ns for path in times}
    assert_same(again, alone["pipe"])


class InAnyOrder:
    """Workers that end in an order of chance; what each brings goes by its case alone."""

    def __init__(self, count, seed):
        self.count, self.chance = count, random.Random(seed)

    def each(self, function, where, jobs, book, gap, *, lazily):
        running = []
        while True:
            running += itertools.islice(jobs, self.count - len(running))
            if not running:
                return
            tag, trial = running.pop(self.chance.randrange(len(running)))
            book(tag, self.outcomes(trial))

    def outcomes(self, trial):
        found = []
        for case in trial.cases:
            if case.parameters["safety"] > 1.0 and case.parameters["seed"] in (1, 2):
                return [*found, InstabilityError(f"of seed {case.parameters['seed']}")]
            speed = {"wall_time": {"value": case.parameters["safety"], "unit": "s"}}
            found.append({"finished": True, "end_pressure": {"value": 1e3 + case.parameters["seed"], "unit": "Pa"},
                          "speed": speed, "steps": 1, "spheres": 1})  # fmt: skip
        return found


RECORD = {"scene": "pipe", "parameters": PIPE | {"safety": 0.8}, "quantities": ["end_pressure"], "knobs": ["time step"],
          "repeat": 4, "seeded": True, "device": "cpu", "threads": 1, "provenance": {}}  # fmt: skip


def ran(trade):
    """Levels of a knob, finest first: each point by its safety of the time step."""
    given = trade.point(GIVEN, {})
    trade.run_all([given], trade.seeds, lambda *_: None)
    levels = [trade.point("time step", {"time step": k}) for k in reversed(range(5))]
    trade.run_all([given, *levels, *levels], trade.seeds, lambda *_: None)
    trade.judge()
    return {round(p.parameters["safety"], 1): p for p in trade.points}


def test_nothing_hangs_on_which_worker_ends_first(tmp_path):
    found = []
    for count, seed in itertools.product((1, 2, 3, 7), range(6)):
        trade = Trade(tmp_path / f"{count}-{seed}", pipe, RECORD)
        trade.cluster, trade.budget = InAnyOrder(count, seed), 1e6
        points = ran(trade)
        found.append({k: (p.failure, sorted(p.results), p.cost, p.errors) for k, p in points.items()})
        assert trade.record["abreast"] == count and trade.rounds(6) == math.ceil(6 / count)
    assert all(each == found[0] for each in found[1:])
    assert {k: each[:2] for k, each in found[0].items()} == {
        **dict.fromkeys((0.2, 0.4, 0.8), ("", trade.seeds)), **dict.fromkeys((1.2, 1.6), ("failed: of seed 1", [0]))
    }  # fmt: skip


def test_what_a_budget_leaves_out_or_no_worker_came_back_with_may_run_later(tmp_path):
    trade = Trade(tmp_path, pipe, RECORD)
    trade.cluster, trade.budget = InAnyOrder(2, 0), 1.0
    points = ran(trade)
    fresh, slow = points[0.8], points[0.2]
    # The given setting takes 0.8 s. The budget counts wall time.
    assert sorted(fresh.results) == trade.seeds and trade.spent < 0.5
    assert slow.failure.startswith("not run: needs about") and not slow.results
    trade._store_outcome(fresh, 0, WorkerLost("its worker failed: KilledWorker"))
    assert fresh.failure == "not run: its worker failed: KilledWorker" and not list(tmp_path.rglob("*-seed=0"))
    with pytest.raises(WarpcreteError, match="full disk"):
        trade._store_outcome(fresh, 0, WarpcreteError("full disk"))
    trade._store_outcome(fresh, 0, None)
    assert trade.interrupted


def test_a_worker_runs_one_case_after_the_other_while_there_is_time(tmp_path, monkeypatch):
    record = {
        "device": "cpu",
        "threads": 1,
        "hardware": processor(),
        "command": {"frames": 25.0, "checkpoint_every": 0},
    }
    cases = [Case(name, {}, COARSE | {"duration": 0.01}) for name in "ab"]

    def ran(folder, given=cases, left=0.0, warm=False, asked=lambda: False):
        return run_worker_job(record, channel, tmp_path / folder, WorkerJob(given, warm, left), asked)

    warmed = []
    monkeypatch.setattr(trials, "warm_up", warmed.append)
    (first,) = ran("short", warm=True)
    assert first == previous_outcome(tmp_path / "short" / "a") and "checks" in first and len(warmed) == 1
    both = ran("short", left=60.0, warm=True)  # as a lost one left it
    assert both[0] == first and both[1]["state_hash"] == first["state_hash"] and len(warmed) == 2
    wrong = replace(cases[0], parameters=COARSE | {"spacing": -1.0})
    (failed,) = ran("wrong", [wrong, cases[1]], left=60.0)
    assert isinstance(failed, SceneError)
    assert ran("stopped", asked=lambda: True) == [None]
    record["hardware"] = "an abacus"
    with pytest.raises(
        WarpcreteError, match=r"has a worker on .*, but this trade-off study measured wall times on an abacus"
    ):
        ran("other")


def test_what_it_refuses(alone, tmp_path):
    for settings, text in (
        (TWO | dict(workers=3), "workers = 3: workers with 1 threads each need more than the 2 cores of"),
        (TWO | dict(threads=0), "threads = 0"),
        (dict(workers=2), "workers = 2: has no effect without a scheduler"),
    ):
        with pytest.raises(SceneError, match=text):
            run_trade("channel", channel, base=COARSE, out=tmp_path / "t", device="cpu", **settings)
    assert not (tmp_path / "t").exists()
    differing = Cluster(SimpleNamespace(run=lambda *_: {"a": "one", "b": "another"}), "tcp://here:1", None)
    with pytest.raises(WarpcreteError, match=r"has workers with different processors \(another, one\)"):
        differing.hardware("cpu")
    shutil.copytree(alone["channel"].folder, tmp_path / "t")
    record = json.loads((tmp_path / "t" / "trade.json").read_text(encoding="utf-8"))
    record["provenance"] |= dict.fromkeys(("processor", "device_name"), "an abacus")
    (tmp_path / "t" / "trade.json").write_text(json.dumps(record), encoding="utf-8")
    with pytest.raises(RunFolderError, match="contains wall times of an abacus, but the workers have"):
        resume_trade(tmp_path / "t", channel, scheduler="local", workers=1)
