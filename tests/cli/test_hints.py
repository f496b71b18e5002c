"""Tests of hints in error messages: lists with commas, misspelt names, folders of another kind, entries of a mix."""

import numpy as np
import pytest
from pumping import command

import warpcrete
from warpcrete import RunFolderError, SceneError, scenes
from warpcrete.core.inputs.amounts import amount
from warpcrete.core.run import run as run_module
from warpcrete.core.run.folder_kinds import wrong_folder
from warpcrete.core.run.run import viewer
from warpcrete.core.run.viewer import MAGIC
from warpcrete.core.units import rounded
from warpcrete.mix.mix import mix_of
from warpcrete.studies.cases import cases_of


def refused(make, kind=SceneError):
    """Return the message of the error with which `make` refuses its input."""
    with pytest.raises(kind) as caught:
        make()
    return str(caught.value)


@pytest.mark.parametrize(
    ("option", "word", "values"),
    [("--friction", "0.1,0.1", "0.1 0.1"), ("--velocity", "1e300,0.3", "1e300 0.3"), ("--seed", "1,2", "1 2"),
     ("--concrete", "no1,no2", "no1 no2"), ("--velocity", "[0.1, 0.2]", "0.1 0.2"), ("--bonds", "yes;no", "yes no"),
     ("--diameter", "100 mm,125 mm", "'100 mm' '125 mm'")],
)  # fmt: skip
def test_values_of_a_study_are_separated_by_spaces(option, word, values):
    done = command("study", "pipe", option, word)
    assert done.returncode == 2 and f"{option} = {word!r}: is a list; " in done.stderr
    assert f"separate the values by spaces, as in {option} {values}" in done.stderr


def test_separators_of_thousands_are_no_list():
    for word in ("1.234,5", "1,234,567", "1,234"):
        done = command("study", "pipe", "--velocity", word)
        assert done.returncode == 2 and "thousands" in done.stderr and "list" not in done.stderr
    assert "this is a list of 2 numbers, but must be one number" in refused(lambda: amount("x", "0.1,0.2", "m"))


@pytest.mark.parametrize(
    ("name", "hint"),
    [("Simulaton", "; did you mean 'Simulation'?"), ("simulation", "; did you mean 'Simulation'?"),
     ("read_mixx", "; did you mean 'read_mix'?"), ("slumpp", "; did you mean 'scenes.slump'?"),
     ("slump", "; write warpcrete.scenes.slump"), ("xyz", "no attribute 'xyz'"), ("_loads", "no attribute '_loads'")],
)  # fmt: skip
def test_misspelt_names_of_the_package(name, hint):
    assert refused(lambda: getattr(warpcrete, name), AttributeError).endswith(hint)


def test_a_study_names_the_parameter_that_is_a_list():
    said = refused(lambda: warpcrete.study(scenes.slump, spacing=[0.01, 0.02]))
    assert said.startswith("spacing = [0.01, 0.02]: is a list; ") and said.endswith(
        "write vary={'spacing': [0.01, 0.02]}"
    )
    said = refused(lambda: warpcrete.study(scenes.slump, vary={"viscosity": [10, 20]}, spacing=np.array([0.01, 0.02])))
    assert said.endswith("write vary={'viscosity': [10, 20], 'spacing': [0.01, 0.02]}")
    assert refused(lambda: warpcrete.study(scenes.slump)).startswith("vary: is missing; name the parameters")
    said = refused(lambda: warpcrete.study(scenes.slump, vari={"spacing": [0.01]}))
    assert said.endswith("is not a parameter; did you mean 'vary'?")
    said = refused(lambda: warpcrete.study(scenes.slump, vary={"spacing": [0.01]}, scheduler=4))
    assert said.startswith("scheduler = 4: must be one of ")


def test_settings_of_the_wrong_kind_do_not_count_as_true():
    assert refused(lambda: cases_of({}, {"velocity": [1.0]}, one_at_a_time="x")).startswith(
        "one_at_a_time = 'x': must be"
    )


@pytest.mark.parametrize(
    ("text", "unit", "hint"),
    [("DN125", "m", "write the inner diameter, as in '125 mm'"), ("30 m3", "m3/s", "did you mean 'm3/h'?"),
     ("30 cbm/h", "m3/s", "did you mean 'm3/h'?"), ("5 l/sec", "m3/s", "did you mean 'l/s'?"),
     ("50 N/m2", "Pa", "did you mean 'Pa'?"), ("2.4 g/cm³", "kg/m3", "did you mean 'g/cm3'?"),
     ("2300 kg", "kg/m3", "did you mean 'kg/m3'?"), ("30 Pa", "Pa s", "did you mean 'Pa s'?"),
     ("30 Pa*s", "Pa s", "did you mean 'Pa s'?"), ("90 grad", "degrees", "did you mean 'degrees'?"),
     ("100 Millimeter", "m", "did you mean 'mm'?"), ("10 mins", "s", "did you mean 'min'?"),
     ("30m", "s", "did you mean 'min'?")],
)  # fmt: skip
def test_a_wrong_unit_leads_to_the_unit_that_is_meant(text, unit, hint):
    assert hint in refused(lambda: amount("x", text, unit))


def test_a_scene_function_that_is_not_called():
    for make in (warpcrete.Simulation, warpcrete.explain):
        assert refused(lambda make=make: make(scenes.pipe)).endswith("as in warpcrete.scenes.pipe()")
        assert "call this function" in refused(lambda make=make: make(scenes.tube))
        assert refused(lambda make=make: make("slump")).endswith("as in warpcrete.scenes.slump()")


def test_several_values_of_a_parameter_lead_to_a_study():
    said = refused(lambda: scenes.slump(yield_stress=[50, 60]))
    assert said.endswith("a study simulates several values: warpcrete.study(..., vary={'yield_stress': [...]})")


def test_misspelt_settings_of_studies():
    said = refused(lambda: warpcrete.trade(scenes.tube, knob="spacing"))
    assert said == "parameter = 'knob': is neither a setting nor a parameter of scene tube; did you mean 'knobs'?"
    said = refused(lambda: warpcrete.study(scenes.tube, vary={"flow": [1e-3]}, frame=5))
    assert said.endswith("did you mean 'frames'?")
    assert refused(lambda: warpcrete.study(scenes.tube, vary={"flow": [1e-3]}, frames="5 m")).startswith(
        "frames = '5 m'"
    )
    assert refused(lambda: warpcrete.trade(scenes.tube, budget="5 m")).startswith(
        "budget = '5 m': must be a number with"
    )


@pytest.mark.parametrize(
    ("words", "hint"),
    [(("study", "tube", "--flow", "1e-3:2e-3:5"), "is a range; write every value, separated by spaces"),
     (("study", "tube", "--flow", "1e-3..2e-3"), "is a range; write every value"),
     (("study", "tube", "--flow", "1e-3", "2e-3", "--checkpoint-every", "1 bar"), "checkpoint_every = '1 bar': must"),
     (("run", "tube", "--flow", "5", "m3/h"), "put a value that contains a space in quotes, as in --flow '5 m3/h'"),
     (("run", "site.yaml"), "use the file of a line as 'warpcrete line FILE'"),
     (("trade", "tube", "--knobs", "spacing"), "did you mean --knob?"),
     (("calibrate", "t.yaml", "--trails", "5"), "did you mean '--trials'?"),
     (("theory", "--rise", "45"), "write a height with its unit, as in '45 m'"),
     (("mix", "nowhere.yaml"), "cannot be read (No such file or directory)"),
     (("run", "nowhere/scene.json"), "error: 'nowhere/scene.json': cannot be read (No such file or directory)")],
)  # fmt: skip
def test_hints_of_commands(words, hint):
    done = command(*words)
    assert done.returncode == 2 and hint in done.stderr


@pytest.mark.parametrize("value", [0, -3, -(10**23), 10**23, 10**400])
def test_whole_numbers_are_refused_with_the_range_of_the_parameter(value):
    assert refused(lambda: scenes.pipe(strokes=value)).endswith(": must be in [1, 1000]")


def test_seeds_have_no_upper_limit_in_the_message():
    assert refused(lambda: scenes.pipe(seed=-1)) == "seed = -1: must be at least 0"
    assert refused(lambda: scenes.pipe(strokes=-1e23)) == "strokes = -1e+23: must be a whole number"


def test_rounded_numbers_have_all_digits():
    assert [rounded(123456.789, digits) for digits in (2, 4, 7, 9)] == ["120000", "123500", "123456.8", "123456.789"]
    assert rounded(1234567.0) == "1.235e+06" and rounded(0.1 + 0.2) == "0.3"


def test_a_folder_of_another_kind_is_named(tmp_path):
    study = tmp_path / "study"
    (study / "001-a").mkdir(parents=True)
    (study / "study.json").write_text("{}", encoding="utf-8")
    said = wrong_folder(study, "scene.json")
    assert said == f"is the folder of a study, not of a run; continue it with 'warpcrete study --resume {study}'"
    assert wrong_folder(study, "trade.json", resumed=False) == "is the folder of a study, not of a trade-off study"
    assert wrong_folder(study / "study.json", "scene.json") == "is a file; give the folder of a run"
    assert wrong_folder(tmp_path / "none", "scene.json") == "does not exist; check the path"
    for kind in ("run", "trade", "calibrate", "reproduce"):
        assert "is the folder of a study, not of a " in command(kind, "--resume", study).stderr


def test_the_viewer_names_the_recorded_runs_of_a_study(tmp_path):
    case = tmp_path / "001-a"
    case.mkdir()
    (tmp_path / "study.json").write_text("{}", encoding="utf-8")
    said = refused(lambda: viewer(tmp_path), RunFolderError)
    assert "is the folder of a study without recordings; repeat the study with --rerun" in said
    (case / "run.rrd").write_bytes(b"")
    said = refused(lambda: viewer(tmp_path), RunFolderError)
    assert f"is the folder of a study; view one of its 1 recorded runs, as in 'warpcrete view {case}'" in said
    assert "is not a recording" in refused(lambda: viewer(tmp_path / "study.json"), RunFolderError)
    assert "does not exist" in refused(lambda: viewer(tmp_path / "none"), RunFolderError)
    for content in (b"", b"\0" * 64):
        (case / "run.rrd").write_bytes(content)
        assert "is empty or damaged, so it is not a recording" in refused(lambda: viewer(case), RunFolderError)
        assert "is empty or damaged" in refused(lambda: viewer(case / "run.rrd"), RunFolderError)


def test_the_viewer_names_damaged_files_of_a_recording(tmp_path, monkeypatch):
    shown = []
    monkeypatch.setattr(run_module, "has_screen", lambda: False)
    monkeypatch.setattr(run_module, "web_viewer", lambda recordings, bind: shown.extend(recordings))
    (tmp_path / "run.rrd").write_bytes(MAGIC + b"rest")
    (tmp_path / "run-1.rrd").write_bytes(b"")
    with pytest.warns(UserWarning, match=r"run-1\.rrd: empty or damaged, so the viewer shows only a part of the run"):
        viewer(tmp_path)
    assert shown == [tmp_path / "run.rrd"]


@pytest.mark.parametrize(
    ("key", "value", "hint"),
    [("strength", "C30/37", "leave it out, because the flow of fresh concrete does not follow from it"),
     ("Compressive strength", "40 MPa", "leave it out, because the flow"), ("cement", 340, "below 'parts:'"),
     ("fly ash", 60, "write 'fly ash: 60' below 'parts:', and indent it"), ("flow", "30 m3/h", "it describes a line"),
     ("yield_stress", 50, "it belongs to the entry 'concrete'"), ("temperature", 20, "section 'flow'"),
     ("spred", "600 mm", "did you mean 'spread'?"), ("flow", "600 mm", "is called 'spread' in a mix")],
)  # fmt: skip
def test_entries_that_a_mix_does_not_have(key, value, hint):
    assert hint in refused(lambda: mix_of({"density": 2350, key: value}))
