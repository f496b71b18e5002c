"""Tables, records and figures of studies, trade-offs and calibrations, made of made-up results, kept (see `kept`)."""

import contextlib
import importlib
import io
import itertools
import json
from types import SimpleNamespace

import kept
import numpy as np
import pytest

from warpcrete.cli.calibrate import INTERRUPTED
from warpcrete.cli.calibrate import report as print_calibration
from warpcrete.cli.trade import report as print_trade
from warpcrete.core.errors import InstabilityError, SceneError
from warpcrete.core.run.method import Quantity
from warpcrete.core.units import quantity
from warpcrete.scenes import modules
from warpcrete.studies.calibration.calibration import Calibration, Trial
from warpcrete.studies.calibration.posterior import Posterior, confounded_pairs, insensitive_targets
from warpcrete.studies.calibration.report import answer, concrete_of, report
from warpcrete.studies.calibration.report import draw as draw_calibration
from warpcrete.studies.calibration.targets import Target, task_of
from warpcrete.studies.cases import cases_of
from warpcrete.studies.cluster import WorkerLost
from warpcrete.studies.study_result import Study
from warpcrete.studies.study_table import columns_of
from warpcrete.studies.tradeoffs.fronts import Error
from warpcrete.studies.tradeoffs.points import COMBINED, GIVEN, REFERENCE, Promise
from warpcrete.studies.tradeoffs.report import draw as draw_trade
from warpcrete.studies.tradeoffs.report import write as write_trade
from warpcrete.studies.tradeoffs.state import Trade

FAILED = {"balance": {"passed": False, "found": "9 %"}, "finished": {"passed": True, "found": "1 s"}}


def measured(k, **more):
    """Return the content of a result.json that depends only on the number of the run."""
    speed = {
        "packing_time": {"value": 1.0 + k, "unit": "s"},
        "settling_time": {"value": 0.25, "unit": "s"},
        "wall_time": {"value": 10.0 + k**2, "unit": "s"},
        "memory": {"value": 1e7 + 1e6 * k, "unit": "B"},
    }
    pressure = 2e4 + 700 * np.sin(1.0 + k)
    return {
        "finished": True,
        "steps": 1000 + 10 * k,
        "spheres": 50 + k,
        "speed": speed,
        "checks": {},
        "peak_pressure": {"value": pressure, "unit": "Pa"},
        "end_pressure": {"value": 0.8 * pressure, "unit": "Pa"},
        "coordination_number": 5 + 0.1 * k,
    } | more


QUANTITIES = [
    Quantity("peak_pressure", "Pa", lambda known: None, compared=True),
    Quantity("end_pressure", "Pa", lambda known: None, compared=True),
    Quantity("coordination_number", "1", lambda known: None, compared=True),
    Quantity("blocked", "1", lambda known: None, compared=True, rare=True),
    Quantity("never", "s", lambda known: None, compared=True),
]
VARIED = {
    "numbers": dict(varied={"velocity": [0.1, 0.3], "diameter": [0.1, 0.2]}, repeat=2),
    "words": dict(
        varied={"shapes": ["spheres", "reference"], "friction": [0.1, 0.2]},
        one_at_a_time=True,
        defaults={"shapes": "spheres", "friction": 0.1},
        repeat=2,
    ),
    "seeds": dict(varied={}, repeat=3),
}


@pytest.mark.parametrize("kind", VARIED)
def test_a_study_is_kept(tmp_path, kind):
    base = {"unit": "A", "concrete": "zhan", "flow": 0.0053, "seed": 4}
    cases = cases_of(base, **VARIED[kind])
    study = Study(tmp_path, "pipe", cases, QUANTITIES, {"velocity": "m/s", "diameter": "m", "flow": "m3/s"})
    for k, case in enumerate(cases[:-1]):
        study.results[case.name] = measured(k, blocked=float(k == 1), checks=FAILED if k in (0, 3) else {})
    lost = cases[1].name
    study.results.pop(lost)
    study.failures[lost], study.not_at_fault = "the worker died", {lost}
    study.write(figure=False)
    kept.compare(
        f"study-{kind}",
        {
            "cases": [[case.name, case.varied, case.parameters] for case in cases],
            "study": study,
            "rows": study.rows(),
            "table": columns_of(study),
            "csv": (tmp_path / "study.csv").read_text(encoding="utf-8").splitlines(),
            "markdown": (tmp_path / "study.md").read_text(encoding="utf-8").splitlines(),
            "repr": repr(study)[:50],
            "figure": kept.drawn(study.plot()),
        },
    )


def printed(report, found):
    """Return what a report prints, without the name of the folder, and the exit code if it ends the program."""
    code = None
    with contextlib.redirect_stdout(io.StringIO()) as text:
        try:
            report(found)
        except SystemExit as ended:
            code = ended.code
    return [*text.getvalue().replace(str(found.folder), "FOLDER").splitlines(), code]


def made_trade(folder, **more):
    """Return a trade of the pipe with results for the scene as given, single knobs, all knobs, and a failed run."""
    pipe = importlib.import_module("warpcrete.scenes.pipe")
    record = {
        "scene": "pipe",
        "parameters": {"seed": 2},
        "quantities": ["peak_pressure", "end_pressure"],
        "knobs": ["time step", "coarse-graining"],
        "repeat": 3,
        "seeded": True,
        "device": "cpu",
        "threads": 2,
        "provenance": {"device_name": "cpu", "processor": "a processor"},
    } | more
    trade = Trade(folder, pipe, record)
    trade.point(GIVEN, {})
    trade.point(REFERENCE, {knob.name: len(knob.levels) - 1 for knob in trade.knobs})
    for knob in trade.knobs:
        for level in range(len(knob.levels)):
            trade.point(knob.name, {knob.name: level})
    trade.point(COMBINED, {knob.name: 0 for knob in trade.knobs})
    for number, point in enumerate(trade.points):
        for seed in trade.seeds:
            point.results[seed] = measured(3 * number + seed, checks=FAILED if number == 2 else {})
    trade.points[3].results[99] = measured(40)  # a fresh seed, which is no part of the comparison
    failed = trade.points[4]
    failed.failures[3] = "failed: it burst"
    trade.judge()
    return trade


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


class Linear:
    """Emulator of a quantity that is linear in the free parameters."""

    def __init__(self, constant, slopes, scatter):
        self.constant, self.slopes, self.scatter = constant, np.array(slopes), scatter

    def __call__(self, points):
        mean = self.constant + points @ self.slopes
        return mean, 0.01 * abs(mean) * (1 + points[:, 0])


def test_a_calibration_is_kept(tmp_path):
    own = {"concrete": "own", "density": 2350.0, "yield_stress": 60.0}
    raw = {
        "vary": {"viscosity": [10.0, 100.0], "slip_viscosity": [300.0, 3000.0], "slip_yield": [0.0, 100.0]},
        "targets": [
            {
                "scene": "tube",
                "parameters": own | {"flow": 1e-3},
                "quantity": "pressure",
                "value": 9000.0,
                "uncertainty": "3%",
            },
            {
                "scene": "tube",
                "parameters": own | {"flow": 2e-3},
                "quantity": "pressure",
                "value": 12000.0,
                "uncertainty": 200.0,
            },
            {"scene": "slump", "parameters": own, "quantity": "spread", "value": 0.6, "uncertainty": "5%"},
            {
                "scene": "funnel",
                "parameters": own,
                "quantity": "funnel_time",
                "value": 9.0,
                "uncertainty": "5%",
                "held_out": True,
            },
        ],
    }
    task = task_of(raw, modules())
    rng = np.random.default_rng(5)
    samples = rng.uniform(0.2, 0.6, (400, 3)) * [1, 0.05, 1] + [0, 0.6, 0]
    samples[:, 2] = 0.9 - samples[:, 0] + 0.01 * rng.normal(size=400)
    emulators = [
        Linear(8e3, [500, 3e3, 1e3], 50.0),
        Linear(9e3, [900, 5e3, 1e3], 50.0),
        Linear(0.6, [0, 0, 1e-4], 0.01),
        Linear(5.0, [9.0, 0, 0], 0.1),
    ]
    found = Calibration(tmp_path, task, {}, took=12.0)
    found.posterior = Posterior(task, dict(zip(task.targets, emulators)), samples, np.array([0.31, 0.995, 0.6]))
    for number in range(6):
        trial = Trial(number, [0.1 * number, 0.15 * number, 0.9 - 0.1 * number], seed=number, proof=number > 3)
        trial.units = [0.31, 0.995, 0.6] if trial.proof else trial.units
        trial.values = {target: target.value * (1 + 0.01 * number) for target in task.targets[: 4 - number % 2]}
        trial.failure = "it burst" if number == 1 else ""
        trial.suspect = ["balance"] if number in (2, 5) else []
        found.trials.append(trial)
    places = [task.places(task.values(units)) for units in ([0.1, 0.2, 0.3], [1.0, 0.0, 0.5])]
    kept.compare(
        "calibration",
        {
            "report": report(found).splitlines(),
            "answer": answer(found),
            "concrete": concrete_of(found, modules()),
            "task": task,
            "groups": [[target.label for target in group] for group in task.groups],
            "places": places,
            "errors": [found.posterior.emulator_error_ratio(target) for target in task.targets],
            "pairs": confounded_pairs(found.posterior, 0.0),
            "figure": kept.drawn(draw_calibration(found, modules())),
            "repr": repr(found).split(", folder")[0],
            "html": found._repr_html_().replace(str(tmp_path), "FOLDER"),
            "printed": printed(print_calibration, found),
        },
    )
    bare = Calibration(tmp_path, task, {}, found.trials, settled=True)
    assert report(bare).endswith("No answer yet: 6 trials done.") and bare.findings == [] and bare.best == {}


def test_every_setting_of_a_study_reaches_its_runs(tmp_path, monkeypatch):
    """No setting is exchanged with another, dropped, or replaced by its default on the way down."""
    study = importlib.import_module("warpcrete.studies.study")
    running = importlib.import_module("warpcrete.studies.running")
    tube = modules()["tube"]
    got = {}
    monkeypatch.setattr(study, "run_listed", lambda *cases, **settings: got.update(settings, cases=cases))
    given = dict(
        device="cpu",
        precision="float64",
        processes=3,
        frames=7.0,
        checkpoint_every=11.0,
        scheduler=None,
        workers=None,
        progress=print,
        rerun=True,
        usd=False,
    )
    study.run_study("tube", tube, {"flow": [1e-3, 2e-3]}, base={"diameter": 0.1}, out=tmp_path / "s", **given)
    name, module, cases = got.pop("cases")
    assert got == given | {"out": tmp_path / "s", "units": {}} and (name, module) == ("tube", tube)
    assert [case.varied for case in cases] == [{"flow": 1e-3}, {"flow": 2e-3}]
    assert all(case.parameters["precision"] == "float64" and case.parameters["diameter"] == 0.1 for case in cases)
    seeds = dict(base={"seed": 5, "aggregates": True}, out=tmp_path / "s", repeat=3)
    study.run_study("tube", tube, {"flow": [1e-3, 2e-3], "diameter": [0.1, 0.2, 0.3]}, **seeds)
    assert len(got["cases"][2]) == 18 and {case.parameters["seed"] for case in got["cases"][2]} == {5, 6, 7}
    study.run_study("tube", tube, {"flow": [1e-3, 2e-3], "diameter": [0.1, 0.2, 0.3]}, one_at_a_time=True, **seeds)
    assert [tuple(case.varied.values()) for case in got["cases"][2][::3]] == [
        (1e-3, 0.1),
        (2e-3, 0.1),
        (None, 0.1),
        (None, 0.2),
        (None, 0.3),
    ]
    monkeypatch.undo()
    record = {}
    monkeypatch.setattr(
        study,
        "_continue",
        lambda out, module, processes, cluster, progress: record.update(
            json.loads((out / "study.json").read_text(encoding="utf-8")),
            got=(out, module, processes, cluster, progress),
        ),
    )
    study.run_listed("tube", tube, cases, out=tmp_path / "t", figure=False, **given)
    assert record["got"] == (tmp_path / "t", tube, 3, None, print)
    assert record["command"] == {"frames": 7.0, "checkpoint_every": 11.0, "rerun": True, "usd": False}
    assert (record["scene"], record["device"], record["precision"], record["figure"]) == (
        "tube",
        "cpu",
        "float64",
        False,
    )
    assert [case["parameters"]["flow"] for case in record["cases"]] == [1e-3, 2e-3]
    made = {}

    class Recorded(SimpleNamespace):
        def __init__(self, scene, **settings):
            super().__init__(scene=scene, **settings)
            made.update(settings, scene=scene)

    monkeypatch.setattr(running, "Simulation", Recorded)
    for every, frames, threads in ((11.0, 4.0, 2), (0.0, None, None)):
        record["command"] |= {"checkpoint_every": every, "frames": frames}
        record |= {"threads": threads} if threads else {}
        simulation, checkpoint = running.simulation_of(record, tube, tmp_path / "t", cases[1], print)
        assert made["scene"].parameters["flow"] == 2e-3 and made["device"] == "cpu" and made["precision"] == "float64"
        assert made["threads"] == 2 and made["progress"] is print and simulation.shares_cores and checkpoint is None
        assert made["frame_interval"] == (0.25 if frames else None) and made["checkpoint_every"] == every
        file = tmp_path / "t" / cases[1].name / "checkpoint.npz"
        assert made["checkpoint_path"] == (file if every else None)
    file.parent.mkdir()
    file.touch()
    assert running.simulation_of(record, tube, tmp_path / "t", cases[1], print)[1] == file
    del record["threads"]
    running.simulation_of(record, tube, tmp_path / "t", cases[1], print)
    assert made["threads"] == 1


def test_the_rounds_of_a_calibration_are_kept(tmp_path, monkeypatch):
    """Search, posterior, points of the next rounds and repeats at the best ones; results and posterior are made up."""
    search = importlib.import_module("warpcrete.studies.calibration.calibrate")
    own = {"concrete": "own", "density": 2350.0, "yield_stress": 60.0, "viscosity": 30.0}
    raw = {
        "vary": {"slip_viscosity": [300, 3000], "slip_yield": [0, 100]},
        "targets": [
            {"scene": "tube", "parameters": own | {"flow": 1e-3}, "quantity": "pressure", "value": 9e3,
             "uncertainty": "3%"},
        ],
    }  # fmt: skip
    log, posteriors, told = [], [], []

    def run_listed(name, module, cases, *, out, progress, **settings):
        log.append([name, module.__name__, out.name, settings, [[c.name, c.varied, c.parameters] for c in cases]])
        progress("running", 0.5, {})
        results = {
            case.name: {"pressure": quantity(8e3 + 10 * case.parameters["slip_yield"], "Pa"), "checks": {}}
            for case in cases
        }
        if len(log) == 1:
            results[cases[1].name] |= {"checks": FAILED}
            del results[cases[2].name]
            results[cases[3].name].pop("pressure")
        failures = {} if len(log) > 1 else {cases[2].name: "it burst"}
        return Study(out, name, cases, results=results, failures=failures)

    def posterior(task, points, values, seed, doubtful):
        rng = np.random.default_rng(seed)
        found = SimpleNamespace(
            best=np.array([0.3, 0.6]), samples=rng.normal([0.3, 0.6], 0.1 / (1 + len(posteriors)), (300, 2)).clip(0, 1),
            emulator_error_ratio=lambda target: 0.9 if len(posteriors) < 3 else 0.01,
        )  # fmt: skip
        posteriors.append([points, list(values.values()), seed])
        return found

    monkeypatch.setattr(search, "run_listed", run_listed)
    monkeypatch.setattr(search, "posterior", posterior)
    monkeypatch.setattr(search, "write", lambda *rest: None)
    out = tmp_path / "out"
    found = search.calibrate(
        raw, out=out, trials=40, batch=8, repeat=2, seed=3, device="cpu", processes=1,
        progress=lambda phase, fraction, figures: told.append([phase, fraction]),
    )  # fmt: skip
    trials = [
        [trial.number, trial.seed, trial.proof, trial.failure, trial.suspect, list(trial.values.values())]
        for trial in found.trials
    ]
    record = json.loads((out / "calibration.json").read_text(encoding="utf-8"))
    kept.compare(
        "calibration-rounds",
        {"record": record, "log": log, "posteriors": posteriors, "trials": trials, "told": told,
         "finished": found.finished, "settled": found.settled},
    )  # fmt: skip
    again, count = [], len(log)
    monkeypatch.setattr(search, "run_listed", lambda *rest, **settings: pytest.fail("all rounds were run before"))
    for name in {each[2] for each in log}:
        (out / "rounds" / name).mkdir(parents=True)
        (out / "rounds" / name / "study.json").touch()

    def resume_study(folder, module, *, progress, **settings):
        again.append([folder.name, module.__name__, settings])
        done = next(each for each in log if each[2] == folder.name)
        cases = [SimpleNamespace(name=name) for name, _, _ in done[4]]
        return SimpleNamespace(
            finished=len(again) < count, lost=[], cases=cases, failures={},
            results={case.name: {"pressure": quantity(9e3, "Pa"), "checks": {}} for case in cases},
        )  # fmt: skip

    monkeypatch.setattr(search, "resume_study", resume_study)
    posteriors.clear()
    cut = search.resume_calibration(out, modules(), trials=50, processes=3)
    assert not cut.finished and [each[0] for each in again] == [each[2] for each in log]
    assert len(cut.trials) == len(found.trials) - len(log[-1][4]) and again[0][2]["processes"] == 3
    assert json.loads((out / "calibration.json").read_text(encoding="utf-8"))["settings"]["trials"] == 50


def test_a_target_that_parameters_move_less_than_its_uncertainty_or_its_scatter_is_insensitive():
    target = Target("slump", "spread", 0.5, 0.1, {}, False, "m")
    task = SimpleNamespace(free=[None])
    for change, scatter, insensitive in (
        (0.015, 0.0, True),
        (0.03, 0.0, False),
        (0.03, 0.05, True),
        (0.01, 0.05, True),
    ):
        found = Posterior(task, {target: Linear(0.5, [change], scatter)}, np.zeros((1, 1)), np.zeros(1))
        assert (target in insensitive_targets(found, [target])) == insensitive
    low, high = insensitive_targets(found, [target])[target]
    assert low == pytest.approx(0.5, abs=1e-4) and high == pytest.approx(0.51, abs=1e-4)


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
