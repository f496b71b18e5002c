"""Calibration: known answers come back, what data cannot tell is said, wrong targets are refused, nothing is lost."""

import dataclasses
import json
import math
from types import SimpleNamespace

import numpy as np
import pytest
from calibrations import FUNNEL, RANGES, SEARCH, SLUMP, asked, by_closed_form, one_pressure, task, truth_of, tube
from pumping import command

from warpcrete import SceneError, WarpcreteError, scenes
from warpcrete.core.inputs.yaml_files import yaml_text
from warpcrete.methods import method_of
from warpcrete.scenes import modules
from warpcrete.studies.calibration.calibrate import calibrate, resume_calibration
from warpcrete.studies.calibration.posterior import (
    Posterior,
    confounded_pairs,
    posterior,
)
from warpcrete.studies.calibration.report import concrete_of
from warpcrete.studies.calibration.starts import START_CANDIDATES, closed_form_start, closed_forms
from warpcrete.studies.calibration.targets import FreeParameter, Target, Task, read_task, task_of
from warpcrete.theory.pipe import CONCRETES


@pytest.mark.slow
def test_known_answers_come_back(tmp_path, monkeypatch):
    """Slump, V-funnel and two pressures of ten concretes chosen at random, measured with errors: the region holds
    the truth as often as it says, 95 % of 40 numbers, of which 36 or more are 97 % of such draws."""
    monkeypatch.setattr(SEARCH, "run_round", by_closed_form(0.01))
    all_free = ("viscosity", "yield_stress")
    held, cases = 0, 0
    for number in range(10):
        random = np.random.default_rng(number)
        raw = task(RANGES, asked(SLUMP, "spread", 1.0), asked(FUNNEL, "funnel_time", 1.0),
                   asked(tube(5e-4, free=all_free), "pressure", 1.0),
                   asked(tube(2e-3, free=all_free), "pressure", 1.0))  # fmt: skip
        truth = {name: float(low + random.uniform(0.15, 0.85) * (high - low)) for name, (low, high) in RANGES.items()}
        for target, value in zip(raw["targets"], truth_of(raw, truth), strict=True):
            target["value"] = value * (1 + 0.03 * random.normal())
        found = calibrate(raw, out=tmp_path / f"case-{number}", device="cpu", repeat=0, seed=number, trials=30)
        within = [
            low <= truth[free.name] <= high
            for free, (low, high) in ((free, found.posterior.interval(k)) for k, free in enumerate(found.task.free))
        ]
        held += sum(within)
        cases += all(within)
    assert held >= 36
    assert cases >= 7


@pytest.mark.thorough
def test_what_data_cannot_tell_apart_is_said(tmp_path, monkeypatch):
    """One pressure fixes a sum of the layer's yield stress and viscosity; a second flow tells them apart."""
    monkeypatch.setattr(SEARCH, "run_round", by_closed_form(0.0))
    one = task(("slip_viscosity", "slip_yield"), asked(tube(1.5e-3), "pressure", 9000.0, "1%"))
    found = calibrate(one, out=tmp_path / "one", device="cpu", repeat=0, trials=16)
    ((first, second, correlation),) = confounded_pairs(found.posterior)
    assert (first, second) == ("slip_viscosity", "slip_yield") and correlation < -0.9
    assert any("cannot distinguish slip_viscosity from slip_yield" in said for said in found.findings)
    values = truth_of(two := task(("slip_viscosity", "slip_yield"), asked(tube(2e-4), "pressure", 1.0, "0.3%"),
                                  asked(tube(2e-3), "pressure", 1.0, "0.3%")),
                      {"slip_viscosity": 1000.0, "slip_yield": 50.0})  # fmt: skip
    for target, value in zip(two["targets"], values, strict=True):
        target["value"] = value
    found = calibrate(two, out=tmp_path / "two", device="cpu", repeat=0, trials=16)
    assert not [said for said in found.findings if "apart" in said]
    assert found.best["slip_viscosity"] == pytest.approx(1000.0, rel=0.05)
    assert found.best["slip_yield"] == pytest.approx(50.0, abs=10.0)


@pytest.mark.thorough
def test_a_flow_index_comes_back(tmp_path, monkeypatch):
    """Pressures at three flows fix the consistency and the index of concrete that thickens, above and below 1."""
    monkeypatch.setattr(SEARCH, "run_round", by_closed_form(0.0))
    own = {"concrete": "own", "density": 2350.0, "yield_stress": 40.0, "slip_viscosity": 1e5, "slip_yield": 0.0}
    targets = [asked({"scene": "tube", "parameters": own | {"flow": flow}}, "pressure", 1.0, "0.5%")
               for flow in (2e-4, 1e-3, 4e-3)]  # fmt: skip
    raw = {"vary": {"viscosity": [10, 100], "flow_index": [0.6, 1.6]}, "targets": targets}
    truth = {"viscosity": 30.0, "flow_index": 1.3}
    for target, value in zip(raw["targets"], truth_of(raw, truth), strict=True):
        target["value"] = value
    found = calibrate(raw, out=tmp_path / "out", device="cpu", repeat=0, trials=16)
    assert found.best["flow_index"] == pytest.approx(1.3, abs=0.03)
    assert found.best["viscosity"] == pytest.approx(30.0, rel=0.06)
    path = tmp_path / "concrete.yaml"
    path.write_text(yaml_text(concrete_of(found, modules())), encoding="utf-8")
    assert scenes.tube(concrete=path).concrete.flow_index == pytest.approx(found.best["flow_index"], rel=1e-5)


@pytest.mark.thorough
def test_a_target_that_nothing_moves_and_one_that_cannot_be_met(tmp_path, monkeypatch):
    monkeypatch.setattr(SEARCH, "run_round", by_closed_form(0.0))
    raw = task(("slip_viscosity",), asked(SLUMP | {"parameters": {**SLUMP["parameters"], "viscosity": 30.0,
                                                                  "yield_stress": 60.0}}, "spread", 0.4),
               asked(tube(1.5e-3), "pressure", 9000.0), asked(tube(1e-3), "pressure", 5000.0))  # fmt: skip
    raw["targets"][0]["parameters"]["plate"] = "slips"
    raw["targets"][0]["parameters"]["slip_yield"] = 10.0
    raw["targets"][1]["parameters"]["slip_yield"] = raw["targets"][2]["parameters"]["slip_yield"] = 10.0
    found = calibrate(raw, out=tmp_path / "out", device="cpu", repeat=0, trials=12)
    assert any("none of slip_viscosity changes the spread of slump" in said for said in found.findings)
    assert any("no parameters within the ranges fit the pressure" in said for said in found.findings)


def test_a_value_that_stays_below_its_target_is_told_as_one_above(tmp_path, monkeypatch):
    monkeypatch.setattr(SEARCH, "run_round", by_closed_form(0.0))
    found = calibrate(one_pressure(), out=tmp_path / "out", device="cpu", repeat=0, trials=8)
    for off in (-5.0, 5.0):
        monkeypatch.setattr(type(found), "off", lambda self, target, off=off: off)
        assert any("5.0 standard deviations off at best" in said for said in found.findings)


def test_failed_runs_count_as_impossible(tmp_path, monkeypatch):
    def run_round(found, *rest):
        done = by_closed_form(0.0)(found, *rest)
        for trial in rest[2]:
            if found.task.values(trial.units)["slip_viscosity"] > 1000.0:
                trial.values.clear()
                trial.failure = "speed of body 3"
        return done

    monkeypatch.setattr(SEARCH, "run_round", run_round)
    raw = one_pressure()
    found = calibrate(raw, out=tmp_path / "out", device="cpu", repeat=0, trials=12)
    assert any(
        "trials failed and count as impossible; reason in the first: speed of body 3" in said for said in found.findings
    )
    assert found.best["slip_viscosity"] < 1300.0


def test_a_quantity_that_no_run_comes_to(tmp_path, monkeypatch):
    def run_round(found, modules, place, trials, *rest):
        for trial in trials:
            trial.failure = "stopped"
        return True

    monkeypatch.setattr(SEARCH, "run_round", run_round)
    with pytest.raises(WarpcreteError, match="is missing in all 12 runs; reason in the first run: stopped"):
        calibrate(one_pressure(), out=tmp_path / "out", device="cpu")


def test_only_settings_of_a_calibration_are_accepted_as_keywords():
    """The scene modules are a parameter of the function behind `calibrate`, but no setting."""
    for name in ("modules", "trails"):
        with pytest.raises(SceneError, match=f"^setting = '{name}': is not a setting of calibration; ") as refused:
            calibrate(one_pressure(), **{name: {}})
        assert "targets" not in str(refused.value) and "modules," not in str(refused.value)


GOOD = """
vary: {slip_viscosity: [500, 2000]}
targets:
  - {scene: tube, parameters: {concrete: no1}, quantity: pressure, value: 12e3, uncertainty: 2%}
"""


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("[500, 2000]", "[2000, 500]"), "must begin with the lower number"),
        (("[500, 2000]", "[500, 500]"), "= [500.0, 500.0]: is a single value, but must be a range; to keep"),
        (("[500, 2000]", "{low: 0, high: 5, scale: log}"), "must be above 0 for a logarithmic scale"),
        (("[500, 2000]", "much"), "must be two finite numbers"),
        (("[500, 2000]", "{low: 1, to: 3}"), "must have 'low' and 'high'"),
        (("slip_viscosity", "slipviscosity"), "vary = 'slipviscosity': is not a parameter of tube"),
        (("slip_viscosity: [500", "precision: [500"), "only numeric parameters"),
        (("slip_viscosity: [500, 2000]", "length: [-1, 2]"), "vary length = [-1.0, 2.0]: pressure of tube"),
        (("scene: tube", "scene: [tube]"), "target 1 scene = ['tube']: must be one of"),
        (("2%", "1.2.3%"), "uncertainty = '1.2.3%'"),
        (("tube", "tub"), "target 1 scene = 'tub': must be one of"),
        (("quantity: pressure", "quantity: colour"), "quantity = 'colour': is not a result of the scene tube; must"),
        (("quantity: pressure, ", ""), "has no quantity; add the missing entries"),
        (("value: 12e3", "value: .nan"), "line 4: has .nan, which is not a finite number"),
        (("value: 12e3", "value: high"), "target 1 value = 'high'"),
        (("2%", "-2%"), "uncertainty = '-2%': must be a number above 0"),
        (("2%", "0"), "uncertainty = 0: must be a number above 0"),
        (("concrete: no1}", "concrete: no1, slip_viscosity: 900}"), "cannot be both given here and varied"),
        (("concrete: no1}", "concrete: no9}"), "concrete = 'no9': must be one of"),
        (("uncertainty: 2%", "uncertainty: 2%, held_out: true"), "held_out = True: must not be true for all targets"),
        (("uncertainty: 2%", "uncertainty: 2%, held_out: 7"), "held_out = 7: must be true or false"),
        (("uncertainty: 2%", "sigma: 2%"), "is not a key of a target"),
        (("targets:", "goals:"), "is not a key of the file of targets"),
        (("\nvary", "\nbase: nobody\nvary"), "concrete = 'nobody': must be one of"),
    ],
)  # fmt: skip
def test_wrong_targets_are_refused_in_one_line(tmp_path, change, says):
    assert GOOD.count(change[0]) >= 1
    path = tmp_path / "targets.yaml"
    path.write_text(GOOD.replace(*change, 1) if change[0] != "tube" else GOOD.replace(*change), encoding="utf-8")
    with pytest.raises(SceneError) as refused:
        read_task(path, modules())
    assert says in str(refused.value) and "\n" not in str(refused.value)


def test_values_that_contradict_one_another_are_refused():
    one = asked(tube(1e-3), "pressure", 9000.0, "1%")
    raw = {"vary": {"slip_viscosity": [500, 2000]}, "targets": [one, one | {"value": 9500.0}]}
    for target in raw["targets"]:
        target["parameters"]["slip_yield"] = 5.0
    with pytest.raises(SceneError, match="contradict each other: both state the pressure of tube"):
        task_of(raw, modules())
    raw["targets"][1] = one | {"value": 9100.0}
    assert len(task_of(raw, modules()).targets) == 2


@pytest.mark.thorough
def test_runs_of_a_flow_are_calibrated_and_gone_on_with(tmp_path, whole_pictures):
    """The command calibrates with real runs and stops after its first round of 4 trials.

    The calibration is then resumed up to 7 trials. The concrete that the calibration found is used in a scene.
    """
    path = tmp_path / "targets.yaml"
    path.write_text(
        "vary: {slip_viscosity: [500, 2000]}\ntargets:\n"
        "  - {scene: channel, parameters: {concrete: no1, spacing: 0.02, length: 0.2, flow: 1e-3}, quantity: pressure,"
        " value: 6000, uncertainty: 1%}\n"
        "  - {scene: channel, parameters: {concrete: no1, spacing: 0.02, length: 0.2, flow: 2e-3}, quantity: pressure,"
        " value: 6700, uncertainty: 1%, held_out: true}\n",
        encoding="utf-8",
    )
    out = tmp_path / "out"
    done = command("calibrate", path, "--out", out, "--device", "cpu", "--trials", "4", "--batch", "4", "--repeat", "1",
                   "--quiet")  # fmt: skip
    assert done.returncode == 0, done.stderr
    answer = json.loads((out / "answer.json").read_text(encoding="utf-8"))
    fitted, held = answer["targets"]
    assert abs(fitted["off"]) < 1 and held["held_out"] and held["runs"] and answer["trials"] == 4
    assert (out / "calibration.png").stat().st_size > 5000
    # The concrete that was found is the one that was run.
    best = answer["parameters"]["slip_viscosity"]["likeliest"]
    mixed = scenes.channel(concrete=out / "concrete.yaml").concrete
    assert mixed.slip_viscosity == pytest.approx(best, rel=1e-5)
    assert dataclasses.replace(mixed, name="no1", slip_viscosity=893.0) == CONCRETES["no1"]
    before = {path: path.stat().st_mtime_ns for path in out.rglob("result.json")}
    again = resume_calibration(out, modules())
    assert again.finished and {path: path.stat().st_mtime_ns for path in out.rglob("result.json")} == before
    assert again.best["slip_viscosity"] == best
    with pytest.raises(SceneError, match="trials = 2: must be a whole number from 4 to 10000"):
        resume_calibration(out, modules(), trials=2)
    more = resume_calibration(out, modules(), trials=7)
    assert more.finished and all(path.stat().st_mtime_ns == stamp for path, stamp in before.items())
    assert not again.settled and len(more.searched) == 7
    # Every trial has the values of its own parameters: pressure grows evenly with the layer's viscosity.
    (target, _) = more.task.targets
    layers = [more.task.values(trial.units)["slip_viscosity"] for trial in more.trials]
    pressures = [trial.values[target] for trial in more.trials]
    line = np.polyfit(layers, pressures, 1)
    assert np.abs(np.polyval(line, layers) - pressures).max() < 5e-3 * np.mean(pressures)
    assert line[0] > 0


def test_what_is_held_out_is_not_fitted(tmp_path, monkeypatch):
    """Not by its value, and not by being there for some trials only."""

    def run_round(found, *rest):
        done = by_closed_form(0.0)(found, *rest)
        held = found.task.targets[-1]
        for trial in rest[2]:
            if held.held_out and found.task.values(trial.units)["slip_viscosity"] > 600.0:
                trial.values.pop(held)
        return done

    monkeypatch.setattr(SEARCH, "run_round", run_round)
    plain = one_pressure()
    other = asked(tube(1e-3), "pressure", 3000.0, held_out=True)
    other["parameters"]["slip_yield"] = 10.0
    both = plain | {"targets": [*plain["targets"], other]}
    alone, beside = (
        calibrate(raw, out=tmp_path / name, device="cpu", repeat=0, trials=10)
        for name, raw in (("alone", plain), ("beside", both))
    )
    assert beside.best == alone.best and not [said for said in beside.findings if "failed" in said]
    assert np.array_equal(beside.posterior.samples, alone.posterior.samples)


def test_files_are_meant_from_the_targets_folder(tmp_path):
    (tmp_path / "mine.yaml").write_text("base: no1\nflow: {density: 2400}", encoding="utf-8")
    path = tmp_path / "targets.yaml"
    path.write_text(GOOD.replace("no1", "mine.yaml"), encoding="utf-8")
    task, raw = read_task(path, modules())
    assert raw["targets"][0]["parameters"]["concrete"] == str(tmp_path / "mine.yaml")
    assert task.targets[0].parameters["concrete"] == str(tmp_path / "mine.yaml")


def test_the_file_of_a_pipes_concrete_holds_all_that_it_had(tmp_path):
    """Also what the scene's default concrete brought along."""
    raw = {"vary": {"friction": [0.0, 0.3]}, "targets": [
        {"scene": "pipe", "quantity": "peak_pressure", "value": 3e4, "uncertainty": "5%"}]}  # fmt: skip
    task = task_of(raw, modules())
    found = SimpleNamespace(task=task, best={"friction": 0.123})
    path = tmp_path / "concrete.yaml"
    path.write_text(yaml_text(concrete_of(found, modules())), encoding="utf-8")
    ours, theirs = scenes.pipe(concrete=path), scenes.pipe(friction=0.123)
    assert (ours.contact, ours.contacts, ours.bonds) == (theirs.contact, theirs.contacts, theirs.bonds)


def test_too_few_values_are_told(tmp_path, monkeypatch):
    def run_round(found, modules, place, trials, *rest):
        for trial in trials:
            trial.failure = "stopped"
            if trial.number == 0:
                trial.values, trial.failure = {found.task.targets[0]: 9000.0}, ""
        return True

    monkeypatch.setattr(SEARCH, "run_round", run_round)
    with pytest.raises(WarpcreteError, match="was found in only 1 of 8 runs; reason in the first run without it: stop"):
        calibrate(one_pressure(), out=tmp_path / "out", device="cpu", trials=8)


@pytest.mark.thorough
def test_a_posterior_is_as_wide_as_the_measurement_is_uncertain():
    """A quantity 0.3 + 0.4 u, measured as 0.5 +- 0.02, gives u = 0.5 +- 0.05; runs that scatter add little."""
    target = Target("slump", "spread", 0.5, 0.02, {}, False, "m")
    task = Task(None, (FreeParameter("yield_stress", 0.0, 1.0, False, False),), (target,))
    random = np.random.default_rng(3)
    points = random.uniform(0, 1, (24, 1))
    found = posterior(task, points, {target: 0.3 + 0.4 * points[:, 0] + random.normal(0, 0.004, 24)}, seed=1)
    assert found.samples.mean() == pytest.approx(0.5, abs=0.01)  # measured 0.498
    assert found.samples.std() == pytest.approx(0.05, rel=0.15)  # measured 0.051


@pytest.mark.thorough
def test_values_of_runs_that_failed_checks_count_less():
    """A third of the runs yields values that are 0.04 too low; if they are doubtful, the answer is closer to 0.5."""
    target = Target("slump", "spread", 0.5, 0.02, {}, False, "m")
    task = Task(None, (FreeParameter("yield_stress", 0.0, 1.0, False, False),), (target,))
    points = np.random.default_rng(3).uniform(0, 1, (12, 1))
    failed = np.arange(12) % 3 == 0
    values = {target: 0.3 + 0.4 * points[:, 0] - 0.04 * failed}
    trusted, doubted = (posterior(task, points, values, 1, doubt).samples.mean() for doubt in (None, {target: failed}))
    assert abs(doubted - 0.5) < 0.6 * abs(trusted - 0.5)


def test_an_interval_contains_the_likeliest_value():
    task = Task(None, (FreeParameter("yield_stress", 20.0, 150.0, False, False),), ())
    samples = np.linspace(0.0, 0.5, 1001)[:, None]
    found = Posterior(task, {}, samples, np.array([0.0]))
    assert found.interval(0) == pytest.approx((20.0, 20.0 + 130 * 0.4875))
    assert dataclasses.replace(found, best=np.array([0.25])).interval(0)[0] == pytest.approx(20.0 + 130 * 0.0125)


def test_progress_grows_to_the_last_verification_run(tmp_path, monkeypatch):
    parts = []

    def run_round(found, scenes, place, trials, where, tell, part):
        parts.append(part)
        return by_closed_form(0.0)(found, scenes, place, trials, where, tell, part)

    monkeypatch.setattr(SEARCH, "run_round", run_round)
    found = calibrate(one_pressure(), out=tmp_path / "out", trials=8, repeat=3, device="cpu")
    ends = [begun + share for begun, share in parts]
    assert [begun for begun, _ in parts[1:]] == pytest.approx(ends[:-1]) and ends[-1] == pytest.approx(1.0)
    # A flow without aggregates gives the same result for every seed, so a single run verifies it.
    assert len(found.searched) <= 8 and len(found.trials) == len(found.searched) + 1
    # The closed form of the likeliest parameters stands beside the runs, which here come from closed forms as well.
    (target,) = found.task.targets
    assert found.closed_forms[target] == pytest.approx(found.verification_values(target)[0], rel=1e-9)


def test_closed_forms_that_choose_the_start_share_the_scenes_of_their_targets(monkeypatch):
    """Pressure and slip velocity of one flow come from one scene, and a target that is held out needs none."""
    true = {"slip_viscosity": 900.0}
    raw = task(("slip_viscosity",), *(asked(tube(1.5e-3), name, 1.0) for name in ("pressure", "slip_velocity")),
               asked(tube(3e-3), "pressure", 1.0, held_out=True))  # fmt: skip
    for target in raw["targets"]:
        target["parameters"]["slip_yield"] = 10.0
    for target, value in zip(raw["targets"], truth_of(raw, true)):
        target["value"] = value
    here, module, made = task_of(raw, modules()), modules()["tube"], []

    def counted(scene):
        made.append(round(math.pi * scene.radius**2 * scene.velocity, 9))
        return method_of(scene)

    monkeypatch.setattr("warpcrete.studies.calibration.starts.method_of", counted)
    (start,) = closed_form_start(here, {"tube": module})
    assert made == START_CANDIDATES * [1.5e-3]
    # The candidates are evenly spread over the logarithm of the range: the best is one of those next to the truth.
    (best,) = here.places(true)
    assert abs(start[0] - best) < 1 / START_CANDIDATES
    assert [target.held_out for target in closed_forms(here, start, {"tube": module})] == [False, False, True]
    assert made[START_CANDIDATES:] == [1.5e-3, 3e-3]


def test_a_calibrated_concrete_states_only_what_its_scenes_share():
    """Two tubes whose slip viscosities differ: the file of the concrete must not claim one of them."""
    held = {"slip_yield": 10.0}
    raw = task(("viscosity", "yield_stress"), *(
        asked(tube(flow, ("viscosity", "yield_stress")), "pressure", 9000.0) for flow in (1e-3, 2e-3)
    ))  # fmt: skip
    for target, slip in zip(raw["targets"], (700.0, 900.0), strict=True):
        target["parameters"] |= held | {"slip_viscosity": slip}
    found = SimpleNamespace(task=task_of(raw, modules()), best={"viscosity": 33.0, "yield_stress": 44.0})
    section = concrete_of(found, modules())["flow"]
    assert "slip_viscosity" not in section
    shared = {"density": 2350.0, "viscosity": 33.0, "yield_stress": 44.0, "slip_yield": 10.0}
    assert section.items() >= shared.items()
