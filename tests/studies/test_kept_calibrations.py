"""Reports, records and rounds of calibrations, made of made-up results, kept (see `kept`)."""

import importlib
import json
from types import SimpleNamespace

import kept
import numpy as np
import pytest
from made_studies import FAILED, printed

from warpcrete.cli.calibrate import report as print_calibration
from warpcrete.core.units import quantity
from warpcrete.scenes import modules
from warpcrete.studies.calibration.calibration import Calibration, Trial
from warpcrete.studies.calibration.posterior import Posterior, confounded_pairs, insensitive_targets
from warpcrete.studies.calibration.report import answer, concrete_of, report
from warpcrete.studies.calibration.report import draw as draw_calibration
from warpcrete.studies.calibration.targets import Target, task_of
from warpcrete.studies.study_result import Study


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
