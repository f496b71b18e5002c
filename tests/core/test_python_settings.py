"""Settings of the Python functions that have a wrong type: every one is refused in one line, and nothing is written."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

import warpcrete
from warpcrete import Run, RunFolder, Simulation, WarpcreteError, scenes
from warpcrete.core.errors import SceneError, refuse
from warpcrete.dem.laws import HertzMindlin

SMALL = dict(spacing=0.025, duration=0.05)
TARGETS = {
    "vary": {"viscosity": [10, 100]},
    "targets": [{"scene": "slump", "parameters": {"concrete": "own", "density": 2350, "yield_stress": 80},
                 "quantity": "spread", "value": 0.5, "uncertainty": 0.03}],
}  # fmt: skip
WRONG = {
    "device": (3, b"cpu", ["cpu"]),
    "threads": ("2", 1.5, 0),
    "progress": (3, "yes"),
    "out": (3, b"x", ["x"], "a\0", "a" * 300),
    "repeat": ("2", 1.5, True, 0.5),
    "processes": (0, -1, "2", 1.5),
    "trials": ("9", 4.5), "batch": ("9", 0), "seed": (0.5, "1"),
    "quantities": (3, "slump"), "knobs": (3, "spacing"),
    "trade": (3, b"x"),
    "recordings": (3,), "colour": (3,), "live": (3, 0.5), "network": ("yes", 1), "bind": (3,),
    **dict.fromkeys(("quiet", "one_at_a_time", "rerun", "cache", "web"), ("x", 1, [])),
    **dict.fromkeys(("energy_balance", "segregation", "rigid_partner"), ("x", 1, [])),
}  # fmt: skip
CALLS = {
    "Simulation": (lambda **given: Simulation(scenes.slump(**SMALL), **given), "device threads progress out"),
    "RunFolder": (lambda **given: RunFolder("run", **given), "recordings colour live network bind"),
    "study": (
        lambda **given: warpcrete.study(scenes.slump, vary={"lift_time": [1, 2]}, **SMALL | given),
        "device progress out repeat processes quiet one_at_a_time rerun",
    ),
    "trade": (
        lambda **given: warpcrete.trade(scenes.slump, **SMALL | given),
        "device threads progress out repeat quantities knobs",
    ),
    "explain": (lambda **given: warpcrete.explain(scenes.slump(**SMALL), **given), "device threads trade cache"),
    "Scene": (lambda **given: replace(scenes.pipe(), **given), "energy_balance segregation"),
    "HertzMindlin": (lambda **given: HertzMindlin.of(1e8, 0.3, **given), "rigid_partner"),
    "view": (lambda **given: Run.view(SimpleNamespace(folder=None), **given), "web"),
    "calibrate": (
        lambda **given: warpcrete.calibrate(TARGETS, **given),
        "device progress out repeat processes trials batch seed",
    ),
}


@pytest.fixture(autouse=True)
def _folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    yield
    assert not list(tmp_path.iterdir()), "files were left"


@pytest.mark.parametrize("function", CALLS)
def test_settings_of_another_type_are_refused(function):
    call, names = CALLS[function]
    if function == "calibrate":
        pytest.importorskip("optuna"), pytest.importorskip("emcee"), pytest.importorskip("sklearn")
    for name in names.split():
        for value in WRONG[name]:
            with pytest.raises(WarpcreteError, match=name) as error:
                call(**{name: value})
            assert str(error.value).isprintable()


@pytest.mark.parametrize("function", ["Simulation", "RunFolder", "study", "trade", "explain", "view", "calibrate"])
def test_a_misspelt_setting_is_refused_with_a_suggestion(function):
    """A setting with one letter too many is refused with the right name, and one that resembles none is refused."""
    call, names = CALLS[function]
    if function == "calibrate":
        pytest.importorskip("optuna"), pytest.importorskip("emcee"), pytest.importorskip("sklearn")
    for name in names.split():
        with pytest.raises(SceneError, match=rf"= '{name}x': is n.*did you mean '{name}'\?$"):
            call(**{f"{name}x": 1})
    with pytest.raises(SceneError, match="= 'qqq': is n"):
        call(qqq=1)


@pytest.mark.parametrize("folder", [None, 3, b"x", "a\0", ""])
def test_what_is_no_folder_cannot_be_loaded(folder):
    with pytest.raises(WarpcreteError):
        warpcrete.load(folder)


@pytest.mark.parametrize("scene", [None, 3, "slump", scenes.slump])
def test_only_scenes_are_explained_and_only_targets_calibrated(scene):
    with pytest.raises(SceneError, match="scene"):
        warpcrete.explain(scene)
    if not isinstance(scene, str):
        pytest.importorskip("optuna")
        with pytest.raises(SceneError, match="targets"):
            warpcrete.calibrate(scene)


@pytest.mark.parametrize("values", [[1, 1.0], [1, "1 s"], ["1 s", "1000 ms"], [0, -0.0], [1, True - 0]])
def test_values_of_a_study_that_are_equal_in_another_form_are_refused(values):
    with pytest.raises(SceneError, match="all different"):
        warpcrete.study(scenes.slump, vary={"lift_time": values}, **SMALL)


def test_one_file_in_two_spellings_is_one_value_of_a_study(tmp_path):
    file = Path("c.yaml")
    file.write_text(
        "density: 2350\nviscosity: 50\nyield_stress: 80\nslip_viscosity: 900\nslip_yield: 20\n", encoding="utf-8"
    )
    try:
        with pytest.raises(SceneError, match="all different"):
            warpcrete.study(scenes.slump, vary={"concrete": ["c.yaml", "./c.yaml"]}, **SMALL)
    finally:
        file.unlink()


def test_names_of_varied_parameters_are_texts():
    with pytest.raises(SceneError, match="vary = 3"):
        warpcrete.study(scenes.slump, vary={3: [1, 2]}, **SMALL)
    # Several values outside of `vary` lead to the lines to write.
    with pytest.raises(SceneError, match=r"is a list; .*; write vary=\{'yield_stress': \[100, 200\]\}"):
        warpcrete.study(scenes.slump, yield_stress=[100, 200])


def test_a_value_that_cannot_be_shown_is_named_by_its_type():
    class Broken:
        def __repr__(self):
            raise RuntimeError

    with pytest.raises(SceneError, match="<Broken>"):
        refuse("field", Broken(), "is wrong")


def test_a_run_and_a_study_are_searched_by_name():
    run = Simulation(scenes.slump(**SMALL), device="cpu").run()
    assert "slump" in run and 3 not in run and "slump" in list(run)
    with pytest.raises(KeyError, match="no quantity 3"):
        run[3]
