"""Parameter studies: cases, table, figure, resumption, failures."""

import importlib
import itertools
import json
import shutil
from types import SimpleNamespace

import click
import numpy as np
import pytest
from command_ends import assert_ended
from pumping import command
from test_batch import SMALL

import warpcrete
from warpcrete import scenes
from warpcrete.cli.study import parameter_values
from warpcrete.core.errors import RunFolderError, SceneError
from warpcrete.core.run.run import Run
from warpcrete.scenes import modules as scene_modules
from warpcrete.studies import running
from warpcrete.studies import study as studies
from warpcrete.studies.cases import Case, is_random
from warpcrete.studies.study import cases_of, resume_study, run_study

pipe_module = importlib.import_module("warpcrete.scenes.pipe")  # the package gives the scene function that name
BASE = SMALL | dict(length=0.1, travel=0.012, ramp=0.008, settle=0.0)


def test_cases_are_all_combinations_or_one_parameter_at_a_time():
    cases = cases_of({"seed": 3}, {"velocity": [0.1, 0.2], "diameter": [0.1, 0.15, 0.2]}, repeat=2)
    assert len(cases) == 12 and len({c.name for c in cases}) == 12
    assert {c.parameters["seed"] for c in cases} == {3, 4}
    cases = cases_of({}, {"velocity": [0.1, 0.2], "diameter": [0.1, 0.15, 0.2]}, one_at_a_time=True)
    assert len(cases) == 5 and all(c.varied.keys() == {"velocity", "diameter"} for c in cases)
    # A point that both share, the baseline, is run once, and every case says what the held parameter is.
    cases = cases_of({}, {"velocity": [0.1, 0.2], "diameter": [0.1, 0.15]}, one_at_a_time=True,
                     defaults={"velocity": 0.1, "diameter": 0.15})  # fmt: skip
    assert [tuple(c.varied.values()) for c in cases] == [(0.1, 0.15), (0.2, 0.15), (0.1, 0.1)]
    with pytest.raises(SceneError, match="velocity"):
        cases_of({}, {"velocity": [0.1, 0.1]})
    with pytest.raises(SceneError, match="repeat"):
        cases_of({}, {"velocity": [0.1]}, repeat=0)


def check_ways_to_run(study, tmp_path):
    """Run cases as a GPU does, in groups, and as a worker process does: both give the results of the study."""
    channel = importlib.import_module("warpcrete.scenes.channel")
    record = json.loads((study.folder / "study.json").read_text(encoding="utf-8"))
    wrong = Case("wrong", {}, {"spacing": -1.0})
    outcomes, told = {}, []
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(running, "CASES_TOGETHER", 1)
        running.run_on_gpu(
            record, channel, tmp_path / "a", [*study.cases, wrong],
            lambda case, outcome: outcomes.update({case.name: outcome}), lambda *each: told.append(each),
        )  # fmt: skip
    assert isinstance(outcomes.pop("wrong"), SceneError)
    assert [phase for phase, *_ in told] == ["running"] * len(told) and told[-1][1] == 1.0
    assert all(0 < one[1] <= other[1] for one, other in itertools.pairwise(told))
    results = running.run_cases(record, channel, tmp_path / "b", [*study.cases, wrong], lambda: False)
    assert isinstance(results.pop(), SceneError)
    for case, other in zip(study.cases, results, strict=True):
        hashes = {each["state_hash"] for each in (study.results[case.name], outcomes[case.name].result, other)}
        assert len(hashes) == 1 and (tmp_path / "a" / case.name / "result.json").is_file()
    assert running.run_cases(record, channel, tmp_path / "c", study.cases, lambda: True) == [None, None]
    assert running.run_cases(record, channel, tmp_path / "c", [], lambda: False) == [] and not (tmp_path / "c").exists()


@pytest.mark.parametrize("gpu", [False, True])
def test_failed_cases_count_as_done(gpu, tmp_path, monkeypatch):
    """Progress counts cases that failed, on a GPU as well, where each run reports its own progress."""
    channel, told, asked = importlib.import_module("warpcrete.scenes.channel"), [], []

    def run_them(record, module, folder, pending, processes, store):
        for case in pending[:-1]:
            store(case, RuntimeError("broken"))

    def group(record, module, folder, cases, store, progress_of, progress):
        asked.append([case.name for case in cases])
        store(cases[0], RuntimeError("broken"))
        progress_of(cases[1])("running", 0.5, {})
        return True

    def told_of(phase, fraction, figures):
        told.append((phase, round(fraction, 6)))

    monkeypatch.setattr(studies, "run_in_processes", run_them)
    monkeypatch.setattr(running, "_run_group", group)
    found = run_study("channel", channel, {"flow": [0.001, 0.002, 0.003, 0.004]}, out=tmp_path / "s", device="cpu",
                      progress=told_of)  # fmt: skip
    assert len(found.failures) == 3 and told == [("running", k / 4) for k in range(4)]
    told.clear()
    (tmp_path / "s" / found.cases[0].name).mkdir(exist_ok=True)
    (tmp_path / "s" / found.cases[0].name / running.FAILED).write_text("unstable", encoding="utf-8")
    if gpu:
        monkeypatch.setattr(studies, "find_device", lambda name: SimpleNamespace(is_cuda=True))
    resume_study(tmp_path / "s", channel, progress=told_of)
    assert told == [("running", each) for each in ((0.25, 0.5, 0.625) if gpu else (0.25, 0.5, 0.75))]
    assert asked == ([[case.name for case in found.cases[1:]]] if gpu else [])


def test_progress_of_a_gpu_study_counts_runs_that_end_early(monkeypatch):
    """A run that ends early counts as complete; an interrupted run does not."""
    told, cases = [], [Case(str(k), {}, {}) for k in range(4)]

    def group(record, module, folder, cases, store, progress_of, progress):
        for case, finished in zip(cases, (True, True, False)):
            progress_of(case)("running", 0.25, {})
            store(case, Run(SimpleNamespace(), {}, {}, {}, finished))
        store(cases[3], KeyboardInterrupt())

    monkeypatch.setattr(running, "_run_group", group)
    running.run_on_gpu({}, None, None, cases, lambda *_: None, lambda phase, fraction, _: told.append(fraction))
    assert told == [0.0625, 0.25, 0.3125, 0.5, 0.5625]


def test_a_study_ends_when_it_is_asked_to():
    """Runs end at their next sample; whatever comes before is interrupted, and nothing is while kernels compile."""
    one, asked = SimpleNamespace(stop_requested=False), []
    tell = running.stop_callback(lambda: bool(asked), [one])
    tell("packing", 0.5, {})
    assert not one.stop_requested
    asked.append(True)
    tell("compiling", 0.5, {})
    assert one.stop_requested
    one.stop_requested = False
    with pytest.raises(KeyboardInterrupt):
        tell("packing", 0.5, {})
    assert not one.stop_requested
    tell("running", 0.5, {})
    assert one.stop_requested


def test_a_study_from_python(tmp_path, capsys):
    flow = dict(spacing=0.02, duration=0.012, sample_interval=4e-3, device="cpu", processes=1)
    study = warpcrete.study(scenes.channel, vary={"flow": [1e-3, 2e-3]}, out=tmp_path / "study", quiet=False, **flow)
    line = "running; the first cases compile kernels that are missing in the cache"
    assert capsys.readouterr().err.splitlines().count(line) == 1
    assert study.finished and list(study.table()["flow"]) == [1e-3, 2e-3]
    assert warpcrete.load(tmp_path / "study").scene == "channel"
    check_ways_to_run(study, tmp_path)
    assert line not in capsys.readouterr().err  # Standard error is no terminal.
    with pytest.raises(SceneError, match="must be a scene function"):
        warpcrete.study("channel", vary={"flow": [1e-3]}, out=tmp_path / "other")
    for vary, message in (({"flow": 1e-3}, "flow = 0.001: must be a list"), ({"ends": "open"}, "ends = 'open'"),
                          ([("flow", [1e-3])], "vary = .*must map each parameter")):  # fmt: skip
        with pytest.raises(SceneError, match=message):
            warpcrete.study(scenes.channel, vary=vary, out=tmp_path / "other")
    with pytest.raises(SceneError, match="flaw"):
        warpcrete.study(scenes.channel, vary={"flaw": [1e-3]}, out=tmp_path / "other")
    assert not (tmp_path / "other").exists()


@pytest.mark.thorough
def test_a_study_runs_and_never_repeats_a_finished_case(device, tmp_path):
    out = tmp_path / "study"
    study = run_study(
        "pipe", pipe_module, {"velocity": [0.3, 0.6]}, base=BASE, out=out, repeat=2, device=device, processes=2
    )
    assert study.finished and not study.failures and len(study.results) == 4
    assert {p.name for p in out.iterdir() if p.is_file()} == {"study.json", "study.csv", "study.md", "study.png",
                                                           "study.parquet"}  # fmt: skip
    rows = study.rows()
    assert [row["velocity"] for row in rows] == [0.3, 0.6] and all(row["runs"] == 2 for row in rows)
    seeds = [study.results[c.name]["peak_pressure"]["value"] for c in study.cases if c.varied == {"velocity": 0.3}]
    assert rows[0]["peak_pressure"] == pytest.approx(np.mean(seeds))
    assert rows[0]["peak_pressure_scatter"] == pytest.approx(np.std(seeds, ddof=1))
    # A case holds the bits of the same scene run alone.
    from warpcrete import Simulation

    case = study.cases[2]
    single = Simulation(scenes.pipe(**case.parameters), device=device, threads=1).run()
    assert single.result["state_hash"] == study.results[case.name]["state_hash"]
    # One case was cut before its first checkpoint; the others must not run again.
    times = {c.name: (out / c.name / "result.json").stat().st_mtime_ns for c in study.cases}
    (out / case.name / "result.json").unlink()
    again = resume_study(out, pipe_module, processes=1)
    assert again.finished and again.results[case.name]["state_hash"] == single.result["state_hash"]
    for other in study.cases:
        same = (out / other.name / "result.json").stat().st_mtime_ns == times[other.name]
        assert same == (other.name != case.name)


@pytest.mark.thorough
def test_a_failing_case_is_reported_and_kept(device, tmp_path):
    out = tmp_path / "study"
    study = run_study(
        "pipe", pipe_module, {"overlap_limit": [0.0, 1e-6]}, base=BASE, out=out, device=device, processes=2
    )
    assert study.finished and len(study.results) == 1 and len(study.failures) == 1
    (name,) = study.failures
    assert "overlap" in study.failures[name] and "overlap_limit=1e-06" in name
    again = resume_study(out, pipe_module)
    assert again.failures == study.failures


def test_bad_studies_write_nothing(tmp_path):
    out = tmp_path / "study"
    with pytest.raises(SceneError, match="velocity"):
        run_study("pipe", pipe_module, {"velocity": [0.3, -1.0]}, base=BASE, out=out, device="cpu")
    assert not out.exists()
    out.mkdir()
    (out / "study.json").write_text("{}", encoding="utf-8")
    with pytest.raises(RunFolderError, match="is not the record of a study"):
        resume_study(out, pipe_module)
    shutil.rmtree(out)


def test_words_for_flags():
    words = {"true": True, "yes": True, "1": True, "True": True, "false": False, "no": False, "0": False, "NO": False}
    found = parameter_values(pipe_module, {"bonds": list(words)})["bonds"]
    assert found == list(words.values()) and all(isinstance(value, bool) for value in found)
    for options, expected in (({"bonds": []}, [True]), ({"no-bonds": []}, [False])):
        assert parameter_values(pipe_module, options) == {"bonds": expected}
    for wrong in ("2", "", "on", "-1"):
        with pytest.raises(click.UsageError, match="must be true or false"):
            parameter_values(pipe_module, {"bonds": ["1", wrong]})
    with pytest.raises(click.UsageError, match="--no-bonds: takes no value"):
        parameter_values(pipe_module, {"no-bonds": ["1"]})


@pytest.mark.thorough
def test_the_study_command_says_at_once_that_it_runs(tmp_path):
    words = ("--flow", "1e-3", "--spacing", "0.02", "--duration", "0.012", "--device", "cpu", "--out")
    done = command("study", "channel", *words, str(tmp_path / "study"))
    line = "running; the first cases compile kernels that are missing in the cache"
    assert_ended(done, "slip velocity")  # The column is coarse.
    assert done.stderr.splitlines().count(line) == 1, done.stderr
    assert line not in command("study", "--resume", str(tmp_path / "study")).stderr  # no case is left
    assert line not in command("study", "chanel", "--flow", "1").stderr


def test_the_study_command(tmp_path):
    out = tmp_path / "study"
    options = [w for name, value in BASE.items() for w in (f"--{name.replace('_', '-')}", str(value))]
    done = command(
        "study",
        "pipe",
        "--velocity",
        "0.3",
        "0.6",
        *options,
        "--processes",
        "1",
        "--device",
        "cpu",
        "--out",
        str(out),
        "--quiet",
    )
    assert done.returncode == 0, done.stderr
    assert "| velocity [m/s] | peak [kPa] | end [kPa] | runs | failed | suspect |" in done.stdout
    assert "note: a case has a value of plateau only if the piston moves at its final speed" in done.stdout
    assert "2 of 2 cases done" in done.stdout
    record = json.loads((out / "study.json").read_text(encoding="utf-8"))
    assert [c["varied"] for c in record["cases"]] == [{"velocity": 0.3}, {"velocity": 0.6}]
    again = command("study", "--resume", str(out), "--quiet")
    assert again.returncode == 0 and "2 of 2 cases done" in again.stdout
    for words, complaint in (
        (["pipe", "--speed", "1"], "--speed: is not a parameter"),
        (["pipe", "--velocity", "fast"], "must be a number"),
        (["chute", "--velocity", "1"], "scene = 'chute'"),
        (["pipe", "--velocity", "0.3", "--repeat", "0"], "repeat = 0"),
        (["--resume", str(tmp_path)], "is not the folder of a study"),
    ):
        wrong = command("study", *words, "--quiet")
        assert wrong.returncode == 2 and complaint in wrong.stderr, (words, wrong.stderr)
        assert "Traceback" not in wrong.stderr


@pytest.mark.filterwarnings("ignore:aggregate_density")
def test_a_study_of_a_parameter_without_effect_is_refused(tmp_path):
    """Without aggregates, their density only gives a warning. All cases of a study of it would be the same run."""
    tube = importlib.import_module("warpcrete.scenes.tube")
    says = "aggregate_density = 2500.0: is varied, but has no effect in any case of the study.*only if 'aggregate_f"
    with pytest.raises(SceneError, match=says):
        run_study("tube", tube, {"aggregate_density": [2500.0, 2700.0]}, out=tmp_path / "study")
    assert not (tmp_path / "study").exists()


def test_what_means_nothing_in_a_case_is_left_out_with_all_that_hangs_on_it(tmp_path):
    """Without bonds there is no hydration, and so no modulus of it; what means nothing anywhere is refused."""
    scene = pipe_module.scene
    given = dict(bonds=False, hydration=0.1, hydration_modulus=1e8, bond_modulus=1e4)
    assert scene.effective_values(given) == {"bonds": False}
    assert scene.effective_values(given | {"bonds": True}) == given | {"bonds": True}
    with pytest.raises(SceneError, match="facets = 32: has no effect unless 'wall' is mesh"):
        run_study("pipe", pipe_module, {"velocity": [0.3, 0.6]}, base=BASE | {"facets": 32}, out=tmp_path / "s")
    with pytest.raises(SceneError, match="hydration = 'x': must be a number"):
        run_study("pipe", pipe_module, {"hydration": [0.1, "x"]}, base=BASE | {"hydration_modulus": 1e7},
                  out=tmp_path / "s", device="cpu")  # fmt: skip
    assert not list(tmp_path.iterdir())


def test_a_parameter_is_held_or_varied(tmp_path):
    tube = importlib.import_module("warpcrete.scenes.tube")
    with pytest.raises(SceneError, match=r"diameter = .*: cannot be both given and varied"):
        run_study("tube", tube, {"diameter": [0.1, 0.2]}, base={"diameter": 0.14}, out=tmp_path / "s", device="cpu")
    with pytest.raises(SceneError, match="repeat = 2: must be 1, because nothing in this scene depends on a seed"):
        cases_of({}, {"velocity": [0.1]}, repeat=2, seeded=False)
    assert cases_of({}, {"velocity": [0.1]}, seeded=False)[0].parameters == {"velocity": 0.1}


def test_idle_parameters_are_left_out_of_repeated_cases(tmp_path, monkeypatch):
    """A parameter that has no effect in some cases is left out of these, also if the cases are repeated."""
    monkeypatch.setattr("warpcrete.studies.study.run_listed", lambda name, module, cases, **rest: cases)
    pipe, varied = scene_modules()["pipe"], {"bonds": [False, True], "hydration": [0.1, 0.2]}
    for repeat in (1, 2):
        cases = run_study("pipe", pipe, varied, base=BASE, out=tmp_path / "out", repeat=repeat, device="cpu")
        assert {"hydration" in case.parameters for case in cases if not case.varied["bonds"]} == {False}
        assert all("hydration" in case.parameters for case in cases if case.varied["bonds"])


def test_a_flow_without_aggregates_is_not_repeated_with_other_seeds(tmp_path):
    """Such a scene has a seed, but equal results for every seed, which would look like a scatter of zero."""
    slump = scene_modules()["slump"]
    with pytest.raises(SceneError, match="repeat = 3: must be 1, because nothing in this scene is random"):
        run_study("slump", slump, {"yield_stress": [50.0, 100.0]}, out=tmp_path / "out", repeat=3, device="cpu")
    assert not (tmp_path / "out").exists()
    assert is_random(scenes.slump(aggregate_fraction=0.2, lift_time=0.0)) and not is_random(scenes.slump())


@pytest.mark.thorough
def test_a_case_that_was_cut_before_its_checks_is_run_again(tmp_path):
    """Its result is whole, but nobody has said that it may be trusted."""
    out = tmp_path / "study"
    study = run_study("pipe", pipe_module, {"velocity": [0.3]}, base=BASE, out=out, device="cpu", processes=1)
    (name,) = study.results
    path = out / name / "result.json"
    result = json.loads(path.read_text(encoding="utf-8"))
    assert set(result["checks"]) >= {"finished", "momentum balance"}
    del result["checks"]
    path.write_text(json.dumps(result), encoding="utf-8")
    again = resume_study(out, pipe_module, processes=1)
    assert "checks" in again.results[name] and "checks" in json.loads(path.read_text(encoding="utf-8"))


def test_a_study_without_cases_or_settings_is_none(tmp_path):
    case = {"name": "a", "varied": {}, "parameters": {}}
    whole = {"scene": "pipe", "cases": [case], "command": {}, "device": "cpu", "precision": "float32"}
    for record in (whole | {"cases": []}, {key: value for key, value in whole.items() if key != "precision"}):
        (tmp_path / "study.json").write_text(json.dumps(record), encoding="utf-8")
        with pytest.raises(RunFolderError, match="is not the record of a study"):
            resume_study(tmp_path, pipe_module)


@pytest.mark.parametrize("name", ["contact", "wall_contact"])
def test_parameters_of_a_contact_law_can_be_varied(name):
    """A study knows the parameters of a law as soon as an option names it, whatever the words of the option."""
    option = name.replace("_", "-")
    found = parameter_values(pipe_module, {option: ["lubrication"], f"{option}-viscosity": ["3", "5.5"]})
    assert found == {name: ["lubrication"], f"{name}_viscosity": [3.0, 5.5]}
    with pytest.raises(click.UsageError, match=f"--{option}-viscosity: is not a parameter of this scene"):
        parameter_values(pipe_module, {f"{option}-viscosity": ["3"]})


def test_a_study_of_a_file_that_has_changed_is_not_continued(tmp_path, monkeypatch):
    """The record of a study names the files that its scenes read, with fingerprints of their contents."""
    line = tmp_path / "line.yaml"
    line.write_text("diameter: 100 mm\nparts: [{straight: 0.4}, {bend: up}, {straight: 0.4}]\n", encoding="utf-8")
    study, module = importlib.import_module("warpcrete.studies.study"), importlib.import_module("warpcrete.scenes.part")
    monkeypatch.setattr(study, "_continue", lambda *given: "continued")
    folder, base = tmp_path / "study", {"line": str(line)}
    assert run_study("part", module, {"flow": [1e-3, 2e-3]}, base=base, out=folder, device="cpu") == "continued"
    assert list(json.loads((folder / "study.json").read_text(encoding="utf-8"))["files"]) == [str(line)]
    assert resume_study(folder, module) == "continued"
    line.write_text(line.read_text(encoding="utf-8").replace("0.4", "0.5"), encoding="utf-8")
    with pytest.raises(RunFolderError, match="which has changed"):
        resume_study(folder, module)
