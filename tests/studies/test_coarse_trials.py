"""Coarse trials of a calibration: which scenes have them, and what the emulator learns from them."""

import json

import numpy as np
import pytest
from calibrations import SEARCH, SLUMP, asked, by_closed_form, task, truth_of, tube

from warpcrete import scenes
from warpcrete.scenes import modules
from warpcrete.studies.calibration.calibrate import calibrate, resume_calibration
from warpcrete.studies.calibration.coarse import coarse_changes
from warpcrete.studies.calibration.posterior import Emulator, TwoLevelEmulator
from warpcrete.studies.calibration.targets import task_of


def test_standard_tests_as_flows_have_coarse_runs_and_other_scenes_have_none():
    """The cells of a coarse run are twice as wide, or 1.5 times where the scene refuses that."""
    slump = {"scene": "slump", "parameters": {**SLUMP["parameters"], "yield_stress": 60.0}}
    raw = task(("viscosity",), asked(slump, "spread", 0.5), asked(tube(1e-3, free=("viscosity",)), "pressure", 9e3))
    raw["targets"][1]["parameters"] |= {"slip_viscosity": 900.0, "slip_yield": 10.0}
    here = task_of(raw, modules())
    assert coarse_changes(here, modules()) == {here.targets[0].key: {"spacing": 2 * scenes.slump().spacing}}
    for spacing, wide in ((0.012, 0.024), (0.014, 0.021), (0.02, None), (0.016, 0.024)):
        box = {"scene": "lbox", "parameters": {**slump["parameters"], "spacing": spacing}}
        here = task_of(task(("viscosity",), asked(box, "passing_ratio", 0.8)), modules())
        found = coarse_changes(here, modules()).get(here.targets[0].key)
        assert found == (None if wide is None else {"spacing": pytest.approx(wide)})
    slump["parameters"]["viscosity"] = 30.0
    own = task((), asked(slump, "spread", 0.5)) | {"vary": {"spacing": [0.005, 0.01]}}
    assert coarse_changes(task_of(own, modules()), modules()) == {}


def test_coarse_cells_would_change_aggregates():
    slump = {"scene": "slump", "parameters": {"concrete": "own", "density": 2350.0, "yield_stress": 60.0,
                                              "aggregate_fraction": 0.2, "lift_time": 0.0}}  # fmt: skip
    here = task_of(task(("viscosity",), asked(slump, "spread", 0.5)), modules())
    assert coarse_changes(here, modules()) == {}


def test_a_target_that_no_first_full_run_reaches_ends_no_calibration(tmp_path, monkeypatch):
    """Coarse runs reach it, so other full runs may reach it as well, and those are still allowed."""
    by_theory, full = by_closed_form(0.0), []

    def run_round(found, scenes, place, trials, *rest):
        by_theory(found, scenes, place, trials, *rest)
        for trial in trials:
            if not trial.coarse and not trial.proof:
                full.append(trial)
                if len(full) <= 4:
                    trial.values.clear()
        return True

    monkeypatch.setattr(SEARCH, "run_round", run_round)
    raw = task(("yield_stress",), asked(SLUMP, "spread", 1.0, "2%"))
    raw["targets"][0]["parameters"] = {**SLUMP["parameters"], "viscosity": 30.0}
    (raw["targets"][0]["value"],) = truth_of(raw, {"yield_stress": 70.0})
    found = calibrate(raw, out=tmp_path / "out", device="cpu", trials=20)
    assert found.finished and found.best["yield_stress"] == pytest.approx(70.0, rel=0.01)
    record = json.loads((tmp_path / "out" / "calibration.json").read_text(encoding="utf-8"))
    assert record["rounds"][0]["coarse"] == [{"spacing": 2 * scenes.slump().spacing}]
    assert json.loads((tmp_path / "out" / "answer.json").read_text(encoding="utf-8"))["coarse_trials"] == 12


def test_few_full_runs_correct_an_emulator_that_coarse_runs_have_taught():
    """The full result is that of coarse runs plus a plane. Four full runs without coarse ones know much less."""

    def coarse(x):
        return np.exp(x[:, 0]) + 0.5 * x[:, 0] * x[:, 1] ** 2

    def full(x):
        return coarse(x) + 0.3 - 0.2 * x[:, 0] + 0.1 * x[:, 1]

    for seed in range(4):
        random = np.random.default_rng(seed)
        many, few, other = random.random((16, 2)), random.random((4, 2)), random.random((200, 2))
        both = TwoLevelEmulator(Emulator(many, coarse(many), 1e-3), few, full(few), 1e-3, np.zeros(4))
        mean, deviation = both(other)
        error = np.abs(mean - full(other))
        assert np.mean(error < 2 * deviation + 1e-3) > 0.95
        alone = Emulator(few, full(few), 1e-3)(other)[0] - full(other)
        assert np.sqrt(np.mean(alone**2)) > 10 * np.sqrt(np.mean(error**2))


def test_coarse_trials_come_first_and_do_not_shift_the_answer(tmp_path, monkeypatch):
    """Their errors of a tenth are five times the uncertainty of the target, and the answer does not have them."""
    monkeypatch.setattr(SEARCH, "run_round", by_closed_form(0.0))
    raw = task(("yield_stress",), asked(SLUMP, "spread", 1.0, "2%"))
    raw["targets"][0]["parameters"] = {**SLUMP["parameters"], "viscosity": 30.0}
    (raw["targets"][0]["value"],) = truth_of(raw, {"yield_stress": 70.0})
    found = calibrate(raw, out=tmp_path / "out", device="cpu", trials=20)
    assert [trial.coarse for trial in found.trials[:12]] == [True] * 12 and len(found.coarse) == 12
    assert found.settled and len(found.searched) <= 12 and len(found.verifying) == 1
    low, high = found.posterior.interval(0)
    assert low < 70.0 < high and found.best["yield_stress"] == pytest.approx(70.0, rel=0.01)
    assert "coarse trials before them: 12" in (tmp_path / "out" / "calibration.md").read_text(encoding="utf-8")
    again = resume_calibration(tmp_path / "out", modules())
    assert len(again.coarse) == 12 and again.best == found.best
