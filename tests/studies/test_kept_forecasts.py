"""Forecasts whose measured times are made up, and the words in which they are explained, kept (see `kept`)."""

import itertools
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import kept
import numpy as np
import pytest
from pumping import TINY

from warpcrete import scenes
from warpcrete.core.device.device import find_device
from warpcrete.core.run.forecast import Forecast, median_time
from warpcrete.dem import forecast as of_elements
from warpcrete.scenes import modules
from warpcrete.studies.cases import Case
from warpcrete.studies.tradeoffs import trials
from warpcrete.studies.tradeoffs.explain import Explanation, Saving, _bytes, _knob_savings, _seconds, _time_step_savings

SCENES = {"pipe": lambda: scenes.pipe(**TINY)}
MEASURED = ("memory", "contacts", "governing")
"""Entries that are measured in a few steps, and therefore not compared."""


@pytest.fixture
def clocks(monkeypatch):
    """Pretend that every call takes a millisecond, a step a fifth of that, and a rebuild or a sample twice as long."""
    ticks = itertools.count()
    monkeypatch.setattr(of_elements, "time", SimpleNamespace(perf_counter=lambda: 1e-3 * next(ticks)))
    monkeypatch.setattr(of_elements, "run_clock", lambda: 1e-3 * next(ticks))
    monkeypatch.setattr(of_elements, "median_time", lambda call, device: (call() and 0.0) or 2e-3)
    monkeypatch.setattr(of_elements._ShortenedCopy, "step_time", lambda copy: 2e-4)


@pytest.mark.parametrize("name", SCENES)
def test_a_forecast_of_elements_is_kept(name, clocks, monkeypatch):
    monkeypatch.setattr(of_elements, "MAXIMUM_SPHERES", {True: 150, False: 150})
    scene = SCENES[name]()
    frames = {"rerun": 0.25, "usd": 0.5}
    found = of_elements.forecast(scene, find_device("cpu"), "float32", 1, lambda simulation: frames)
    shown = {key: value for key, value in vars(found).items() if key not in MEASURED}
    shown |= {
        "counts": dict(found.counts) | {"contacts": 0},
        "names": sorted(found.memory),
        "governing": found.governing[:9],
    }
    for label in ("limits", "time_step", "steps"):  # from a packing, in single precision
        shown.pop(label)
    kept.compare(
        f"forecast-{name}", shown | {"limits": sorted(found.limits), "ratio": found.steps * found.time_step}, 2e-2
    )
    assert found.wall_time == sum(found.parts.values()) and found.total_memory == sum(found.memory.values())


def test_median_times_leave_out_the_first_call():
    device, took = find_device("cpu"), iter((9.0, 3.0, 1.0, 2.0, 8.0))
    clock = SimpleNamespace(now=0.0)

    def call():
        clock.now += next(took)

    with pytest.MonkeyPatch.context() as patched:
        module = __import__("warpcrete.core.run.forecast", fromlist=["time"])
        patched.setattr(module, "time", SimpleNamespace(perf_counter=lambda: clock.now))
        assert median_time(call, device) == 2.0
        took = iter((9.0, 3.0, 1.0, 2.0, 8.0))
        assert median_time(call, device, 4) == 2.0


MADE = Forecast(
    "discrete elements",
    "a processor",
    {"bodies": 1200, "spheres": 9600},
    {"clumps": "bodies of several", "bonds": "left out"},
    {"bodies": 3.2e6, "contacts": 4.5e9, "rest": 700.0},
    2e-5,
    {"contacts": 3e-5, "contacts and bonds": 2e-5, "contacts without dashpots": 6e-5, "all together": 2e-5},
    "bonds, which shorten the step",
    5e4,
    {"packing": 12.0, "steps": 4000.0, "samples": 3.0},
    {"rerun": 0.25, "usd": 0.5},
    1.0,
    ("a remark",),
)


def test_words_of_an_explanation_are_kept():
    points = [
        {
            "setting": f"knob {k}",
            "origin": "time step" if k else "as given",
            "time": {"value": 10.0 - 2 * k},
            "errors": {"pressure": {"shift": 0.01 * k, "interval": 0.002}},
            "suspect": [] if k < 4 else ["balance"],
        }
        for k in range(5)
    ]
    savings = (Saving("half the stones", 0.4, "error not measured"), Saving("no bonds", 0.7, "error of pressure +2 %"))
    told = [
        Explanation("pipe", made, savings, source)
        for made, source in (
            (MADE, "some machine"),
            (replace(MADE, parts={"steps": 1e5}, frame={}, remarks=(), duration=0.0), ""),
        )
    ]
    kept.compare(
        "explanation",
        {
            "told": [str(each).splitlines() for each in told],
            "knobs": list(_knob_savings(points, {"time step"})),
            "others": list(_knob_savings(points, {"wall"})),
            "steps": list(_time_step_savings(MADE)),
            "short": list(_time_step_savings(replace(MADE, parts={"steps": 1.0, "packing": 99.0}))),
            "bytes": [_bytes(size) for size in (0, 900, 5e3, 2.5e6, 3e9, 4e12)],
            "seconds": [_seconds(time) for time in (1e-3, 0.5, 59, 61, 3599, 3601, 9e4, 1e7)],
        },
    )


def test_a_worker_warms_up_once_and_stops_in_time(monkeypatch):
    """Kernels are loaded before the first run alone; what is there is read; time left decides on further runs."""
    did, clock = [], SimpleNamespace(now=0.0)
    monkeypatch.setattr(trials, "hardware", lambda device: "a processor")
    monkeypatch.setattr(trials, "time", SimpleNamespace(perf_counter=lambda: clock.now))
    monkeypatch.setattr(
        trials, "previous_outcome", lambda folder: {"finished": True} if folder.name == "there" else None
    )
    monkeypatch.setattr(trials, "simulation_of", lambda *given: (given[3].name, None))
    monkeypatch.setattr(trials, "warm_up", lambda simulation: did.append(f"warm {simulation}"))
    monkeypatch.setattr(trials, "read_json", lambda path: {"finished": True, "read": path.parent.name})

    def run_cases(record, module, folder, cases, asked):
        clock.now += 10.0
        did.append(f"run {cases[0].name}")
        return [{"finished": cases[0].name != "cut"}]

    monkeypatch.setattr(trials, "run_cases", run_cases)

    def done(*names, load=True, left=1e9):
        did.clear()
        job = trials.WorkerJob([Case(name, {}, {}) for name in names], load, left)
        record = {"device": "cpu", "hardware": "a processor"}
        return trials.run_worker_job(record, modules()["channel"], Path("x"), job, lambda: False), list(did)

    assert done("there", "a", "b") == (
        [{"finished": True}, {"finished": True, "read": "a"}, {"finished": True, "read": "b"}],
        ["warm a", "run a", "run b"],
    )
    assert done("a", "b", load=False)[1] == ["run a", "run b"]
    assert done("a", "b", "c", left=20.0)[1] == ["warm a", "run a", "run b"]
    assert done("a", "b", left=19.9)[1] == ["warm a", "run a"] and done("a", left=-1.0)[1] == ["warm a", "run a"]
    assert done("cut", "b") == ([{"finished": False}], ["warm cut", "run cut"])
    with pytest.raises(
        trials.WarpcreteError, match="a worker on a processor, but this trade-off study measured wall times on another"
    ):
        trials.run_worker_job(
            {"device": "cpu", "hardware": "another"}, None, Path("x"), trials.WorkerJob([], True, 1.0), lambda: False
        )
    monkeypatch.setattr(trials, "warm_up", lambda simulation: (_ for _ in ()).throw(KeyboardInterrupt))
    assert done("a", "b") == ([None], [])


def test_rebuilds_without_a_pipe_are_as_frequent_as_in_the_timed_steps(monkeypatch):
    """7 rebuilds in the 100 timed steps are 70 in 1000; the 50 steps and 4 rebuilds before them do not count."""
    stepper = SimpleNamespace(steps=50, time=0.0, dt=1.0, index=0, advance=lambda time: None, rebuild=lambda: None,
                              lists=SimpleNamespace(builds=np.array([4])), skin=1e-3,
                              batch=SimpleNamespace(planner=SimpleNamespace(rebuilds_on_device=False)))  # fmt: skip
    copy = object.__new__(of_elements._ShortenedCopy)
    copy.simulation = SimpleNamespace(measure=lambda: None, rows=[{"contacts": 3.0}])
    copy.stepper, copy.spheres, copy.device = stepper, 12, None
    copy.scene = SimpleNamespace(settle=None, bonds=None, pipe=None)

    def timed():
        stepper.steps += 100
        stepper.lists.builds[0] += 7
        return 2e-4

    copy.step_time = timed
    monkeypatch.setattr(of_elements, "median_time", lambda call, device: 2e-3)
    monkeypatch.setattr(of_elements, "_memory", lambda simulation: {})
    copy._time()
    assert copy.builds(1000) == pytest.approx(70.0, rel=1e-12) and copy.step == 2e-4 and copy.contacts == 3
