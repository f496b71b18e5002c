"""Another contact law in scenes of elements: by object, by name, on the command line, in records and studies."""

import importlib
import json
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import pytest
from click.testing import CliRunner
from command_ends import assert_ended
from pumping import command_process, small_options
from test_laws import Toy
from test_records import refused, saved

from warpcrete import SceneError, scenes
from warpcrete.cli import cli
from warpcrete.cli.run import report
from warpcrete.core.inputs.fingerprints import fingerprint
from warpcrete.core.inputs.origin import changed_fields
from warpcrete.core.inputs.parameters import Above
from warpcrete.core.run.files import write_json
from warpcrete.core.units import quantity
from warpcrete.dem.laws import Contact, HertzMindlin, LubricationLayer, RollingResistance
from warpcrete.dem.simulation import ElementRun
from warpcrete.record.loading import load, repeatable_scene
from warpcrete.studies import study as studies
from warpcrete.studies.tradeoffs.trade import run_trade

TAKING = ("pipe", "part-dem", "slump-dem", "funnel-dem", "lbox-dem", "jring-dem", "lcpc-dem")
TOY = dict(contact="test_laws:Toy", contact_push=0.25)
HERTZ = HertzMindlin(effective_modulus=1e6, effective_shear_modulus=4e5)
pipe_module = importlib.import_module("warpcrete.scenes.pipe")


@dataclass(frozen=True, kw_only=True)
class Hidden(Toy):
    """A law with a field that nothing declares."""

    secret: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Around(Toy):
    """A law round another one."""

    inner: Annotated[HertzMindlin, "inside"]
    depth: Annotated[float, "[m]", Above()] = 1.0


@pytest.mark.parametrize("name", TAKING)
def test_what_a_trade_may_change_without_a_law_and_with_one(name):
    """A law has its own stiffness, and a step or a law that is given leaves nothing of it to choose."""
    module = scenes.modules()[name]

    def names(**more):
        return [knob.name for knob in module.trading.knobs(module.scene.parameters(**more))]

    usual = names()
    assert {"time step", "precision", "stiffness"} <= set(usual)
    assert names(contact=HERTZ) == [knob for knob in usual if knob != "stiffness"]
    assert names(time_step=1e-5) == [knob for knob in usual if knob != "time step"]


@pytest.mark.parametrize("name", TAKING)
@pytest.mark.parametrize("law", [Toy(push=0.25), HERTZ, RollingResistance(contact=Contact(friction=0.3))])
def test_a_scene_takes_a_law_records_it_by_name_and_makes_it_again(name, law, tmp_path):
    module = scenes.modules()[name]
    scene = module.scene(contact=law)
    assert scene.contact == law and changed_fields(scene) == []
    record = saved(scene, tmp_path)
    again, _ = repeatable_scene(record, scenes.modules())
    named = again["parameters"]
    assert named["contact"] == {Toy: "test_laws:Toy", HertzMindlin: "hertz-mindlin"}.get(type(law), "rolling")
    assert all(isinstance(value, str | int | float | None) for value in named.values())
    assert fingerprint(module.scene(**named)) == fingerprint(scene)
    assert fingerprint(module.scene(**module.scene.plain(scene, {"contact": law}))) == fingerprint(scene)


def test_a_law_is_given_by_object_by_name_or_by_both():
    assert scenes.pipe(**TOY).contact == scenes.pipe(contact=Toy(push=0.25)).contact == Toy(push=0.25)
    assert scenes.pipe(contact=Toy(push=1.0), contact_push=0.25).contact == Toy(push=0.25)
    scene = scenes.pipe(contact=f"{__name__}:Around", contact_push=1.0, contact_inner_effective_modulus=1e6,
                        contact_inner_effective_shear_modulus=4e5)  # fmt: skip
    assert scene.contact == Around(push=1.0, inner=HERTZ)
    assert scenes.pipe(contact=Around(push=1.0, inner=HERTZ), contact_inner_friction=0.7).contact.inner.friction == 0.7


def test_walls_follow_the_law_or_one_of_their_own():
    own = scenes.pipe()
    assert isinstance(own.contact, Contact) and isinstance(own.contacts["aggregate", "wall"], LubricationLayer)
    assert scenes.pipe(contact=HERTZ).contacts == {}
    wall = scenes.pipe(wall_contact="lubrication", wall_contact_yield_stress=5.0, friction=0.3)
    assert wall.contact.friction == 0.3
    assert wall.contacts == {("aggregate", "wall"): LubricationLayer(yield_stress=5.0)}
    both = scenes.part_dem(contact=HERTZ, wall_contact=LubricationLayer(viscosity=9.0))
    assert both.contact == HERTZ and both.contacts == {("aggregate", "wall"): LubricationLayer(viscosity=9.0)}
    assert any("contact HertzMindlin acts between aggregates and on the wall" in line for line in scenes.pipe(
        contact=HERTZ).remarks)  # fmt: skip
    assert not any("calibrated" in line for line in wall.remarks) and any("calibrated" in line for line in own.remarks)
    # The bonds of the plug and the pressure of the packing follow from the stiffness of the law.
    assert scenes.pipe(contact=HERTZ).group_bonds["plug"].effective_modulus == 2e6
    assert scenes.pipe(contact=HERTZ, plug_pressure=1.0).fill.pressure == 2e3


def test_vessels_grip_by_what_a_law_has():
    slump = scenes.slump_dem(contact=HERTZ, plate_grip=3.0, mould_grip=0.5)
    assert slump.contacts["aggregate", "plate"].friction == pytest.approx(0.9)
    assert slump.contacts["aggregate", "mould"].friction == pytest.approx(0.15)
    layer = LubricationLayer(contact=Contact(friction=0.1), yield_stress=4.0, viscosity=6.0)
    assert layer.gripped(0.5) == LubricationLayer(contact=Contact(friction=0.05), yield_stress=2.0, viscosity=3.0)
    toy = scenes.slump_dem(**TOY)
    assert set(toy.contacts.values()) == {Toy(push=0.25)} and "Toy has no parameter for friction" in toy.remarks[0]
    with pytest.raises(SceneError, match=r"plate_grip = 1\.0: has no effect with contact Toy"):
        scenes.slump_dem(**TOY, plate_grip=1.0)


@pytest.mark.parametrize("given, message", [
    (dict(contact="test_laws:Toy"), "contact_push = None: is required by contact Toy: whatever the overlap"),
    (TOY | dict(contact_push="much"), "contact_push = 'much': must be a number"),
    (TOY | dict(contact_pull=1.0), "contact_pull = 1.0: has no effect with contact = .*; the parameters of .* are"),
    (dict(contact_push=1.0), "contact_push = 1.0: has no effect with contact = None"),
    (dict(contact="test_laws:Tou"), "contact = 'test_laws:Tou': the module 'test_laws' has no 'Tou'"),
    (dict(contact="nowhere:Toy"), "contact = 'nowhere:Toy': there is no module 'nowhere' on .* set PYTHONPATH"),
    (dict(contact="nowhere.deep:Toy"), "there is no module 'nowhere' on Python's path"),
    (dict(contact="__main__:Toy"), "move the class to a module file of its own"),
    (dict(contact="os:path"), "must be a frozen dataclass that derives from warpcrete.dem.laws.base:ContactLaw"),
    (dict(contact="warpcrete.dem.laws:ContactLaw"), "must be a frozen dataclass|does not define device_functions"),
    (dict(contact="hertz"), "contact = 'hertz': must be one of linear, hertz-mindlin, .* or 'module:Class'"),
    (dict(contact="a b:Toy"), "must be one of linear"),
    (dict(contact=7), "contact = 7: must be one of linear, .* or an object of a class derived from ContactLaw"),
    (dict(contact=Toy), "must be one of linear"),
    (dict(contact="linear", contact_friction=-1.0), "contact_friction = -1.0: must be finite and at least 0"),
    (dict(contact="rolling", contact_contact_friction=-1.0), "contact_contact_friction = -1.0: must be"),
    (TOY | dict(friction=0.2), "friction = 0.2: has no effect unless 'contact' is left out .its parameters are"),
    (dict(contact="linear", friction=0.1), "leave out 'friction', or give 'contact_friction' instead$"),
    (TOY | dict(modulus=2e5), "modulus = 200000.0: has no effect unless 'contact'"),
    (TOY | dict(layer_yield=2.0), "layer_yield = 2.0: has no effect unless 'contact'"),
    (dict(wall_contact="linear", wall_friction=0.2), "wall_friction = 0.2: has no effect unless 'wall_contact'"),
])  # fmt: skip
def test_what_names_no_law_or_means_nothing_beside_one_is_refused(given, message):
    with pytest.raises(SceneError, match=message) as found:
        scenes.pipe(**given)
    assert "\n" not in str(found.value)


def test_a_vessels_own_law_means_nothing_beside_another():
    for name, value in (("law", "bonds"), ("modulus", 2e5), ("friction", 0.2), ("rolling_friction", 0.4)):
        with pytest.raises(SceneError, match=f"{name} = .*: has no effect unless 'contact' is left out"):
            scenes.slump_dem(**TOY, **{name: value})


def test_a_law_that_text_does_not_tell_whole_is_recorded_but_not_repeated(tmp_path):
    class Local(Toy):
        """Nobody else finds it."""

    for law in (Hidden(push=1.0, secret=2.0), Local(push=1.0)):
        scene = scenes.pipe(contact=law)
        assert scene.contact == law and changed_fields(scene) == ["contact"]
        record = saved(scene, tmp_path)
        assert json.loads(record.read_text(encoding="utf-8"))["modified"]["contact"]["push"] == 1.0
        assert "the scene was changed in Python (contact) after" in refused("run", record, "--out", tmp_path / "out")
        with pytest.raises(SceneError, match="cannot be rebuilt in another run or process"):
            run_trade("pipe", pipe_module, base={"contact": law}, out=tmp_path / "out", budget=1.0, device="cpu")
        with pytest.raises(SceneError, match="cannot be rebuilt in another run or process"):
            studies.run_study("pipe", pipe_module, {"velocity": [0.1, 0.2]}, base={"contact": law},
                              out=tmp_path / "out", device="cpu")  # fmt: skip
    assert changed_fields(scenes.pipe(contact=Hidden(push=1.0))) == []


def test_a_study_varies_laws_and_their_parameters(tmp_path, monkeypatch):
    monkeypatch.setattr(studies, "run_in_processes", lambda *rest: None)

    def cases(varied, **base):
        out = tmp_path / f"{len(list(tmp_path.iterdir()))}"
        study = studies.run_study("pipe", pipe_module, varied, base=base, out=out, device="cpu")
        return study, [case.parameters for case in study.cases]

    study, found = cases({"contact_push": [0.1, 0.2]}, contact="test_laws:Toy")
    assert [pipe_module.scene(**each).contact.push for each in found] == [0.1, 0.2]
    assert study.heading("contact_push") == "contact_push [N]"
    study, found = cases({"velocity": [0.1, 0.2]}, contact=Toy(push=0.3))
    assert [pipe_module.scene(**each).contact for each in found] == 2 * [Toy(push=0.3)]
    study, found = cases({"contact": ["test_laws:Toy", "linear"]}, contact_push=0.4)
    assert [pipe_module.scene(**each).contact for each in found] == [Toy(push=0.4), Contact()]
    with pytest.raises(SceneError, match=r"contact = Toy.*: is an object, but only names"):
        cases({"contact": [Toy(push=0.1), Toy(push=0.2)]})


def test_a_law_file_that_changed_is_not_taken_for_the_one_of_the_run(tmp_path, monkeypatch):
    file = tmp_path / "my_law.py"
    file.write_text("from test_laws import Toy\nfrom dataclasses import dataclass\n"
                    "@dataclass(frozen=True, kw_only=True)\nclass Mine(Toy):\n    pass\n",
                    encoding="utf-8")  # fmt: skip
    monkeypatch.syspath_prepend(tmp_path)
    record = saved(scenes.pipe(contact="my_law:Mine", contact_push=1.0), tmp_path / "run")
    assert list(json.loads(record.read_text(encoding="utf-8"))["files"]) == [str(file)]
    file.write_text(file.read_text(encoding="utf-8") + "\n# another\n", encoding="utf-8")
    assert "my_law.py', which has changed" in refused("run", record, "--out", tmp_path / "out")
    monkeypatch.delitem(sys.modules, "my_law")
    file.unlink()
    assert "my_law.py', which is missing" in refused("run", record, "--out", tmp_path / "out")


def test_a_file_that_names_a_law_does_not_import_it(tmp_path, monkeypatch):
    """Unless it is imported already, or the command is told to trust the file."""
    file = tmp_path / "evil_law.py"
    file.write_text("from test_laws import Toy\nfrom dataclasses import dataclass\nfrom pathlib import Path\n"
                    f"Path({str(tmp_path)!r}, 'ran').touch()\n"
                    "@dataclass(frozen=True, kw_only=True)\nclass Evil(Toy):\n    pass\n",
                    encoding="utf-8")  # fmt: skip
    monkeypatch.chdir(tmp_path)
    parameters = dict(contact="evil_law:Evil", contact_push=1.0)
    targets = tmp_path / "targets.yaml"
    targets.write_text("vary: {velocity: [0.1, 0.2]}\ntargets:\n- {scene: pipe, quantity: plateau_pressure, value: 1e4,"
                       f" uncertainty: 1e3, parameters: {json.dumps(parameters)}}}\n", encoding="utf-8")  # fmt: skip
    (tmp_path / "run").mkdir()
    write_json(tmp_path / "run" / "scene.json", {"scene": "pipe", "parameters": parameters})
    case = {"name": "001", "varied": {}, "parameters": parameters}
    study = dict(scene="pipe", command={}, device="cpu", precision="float32", cases=[case])
    write_json(tmp_path / "run" / "study.json", study)
    path = list(sys.path)
    for words in (["calibrate", targets], ["run", "run/scene.json"], ["run", "--resume", "run"]):
        assert "contact = 'evil_law:Evil': comes from a file" in refused(*words)
    with pytest.raises(SceneError, match=r"comes from a file.* use .warpcrete --trust"):
        studies.load_study(tmp_path / "run")
    assert load(tmp_path / "run").scene.parameters == parameters  # without the scene itself
    assert not (tmp_path / "ran").exists() and "evil_law" not in sys.modules
    assert "belongs to a run that was not started with 'warpcrete run'" in refused("--trust", "run", "--resume", "run")
    assert (tmp_path / "ran").exists() and sys.path == path
    assert studies.load_study(tmp_path / "run").scene == "pipe"  # the module is there now
    monkeypatch.delitem(sys.modules, "evil_law")
    with pytest.raises(SceneError, match="comes from a file"):  # trust ends with the command
        studies.load_study(tmp_path / "run")


def test_the_command_lists_and_checks_a_laws_options(tmp_path, monkeypatch):
    run = CliRunner().invoke
    helped = run(cli, ["run", "pipe", "--contact", "test_laws:Toy", "--help"]).output
    assert "Parameters of contact Toy:" in helped
    assert re.search(r"--contact-push NUMBER +whatever the overlap \[N\]  \[required\]", helped)
    assert "--contact-push" not in run(cli, ["run", "pipe", "--help"]).output
    vessel = run(cli, ["run", "slump-dem", "--contact=hertz-mindlin", "--help"]).output
    assert "--contact-unloading [rescale|hold]" in vessel
    assert "contact_push = None" in refused("run", "pipe", "--contact", "test_laws:Toy")
    assert "there is no module 'nowhere'" in refused("run", "pipe", "--contact", "nowhere:Toy", "--contact-push", "1")
    assert "contact_push = None" in refused("explain", "pipe", "--contact", "test_laws:Toy")
    wrong = run(cli, ["study", "pipe", "--contact", "test_laws:Toy", "--contact-pull", "1", "2"])
    assert wrong.exit_code == 2 and "--contact-pull: is not a parameter of this scene" in wrong.output
    monkeypatch.setattr(studies, "run_in_processes", lambda *rest: None)
    run(cli, ["study", "pipe", "--contact", "test_laws:Toy", "--contact-push", "1", "2", "--device", "cpu", "--out",
              str(tmp_path / "study")])  # fmt: skip
    record = json.loads((tmp_path / "study" / "study.json").read_text(encoding="utf-8"))
    assert [case["varied"] for case in record["cases"]] == [{"contact_push": 1.0}, {"contact_push": 2.0}]


def guide(folder, page, sign, name="sticky.py"):
    """Save the only block of code in a guide that contains `sign`."""
    text = (Path(__file__).parents[2] / "notebooks" / "how-to" / page).read_text(encoding="utf-8")
    (block,) = [each for each in re.findall(r"```python\n(.*?)```", text, re.S) if sign in each]
    (folder / name).write_text(block, encoding="utf-8")


def guide_law(folder):
    """Save the law that the guide shows as it says."""
    guide(folder, "own-contact-law.md", "class Sticky")


def test_a_file_in_the_folder_that_one_is_in_hides_no_installed_module(tmp_path, monkeypatch):
    for name in ("installed", "here"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "twice_there.py").write_text(f"WHERE = {name!r}\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path / "installed")
    monkeypatch.chdir(tmp_path / "here")
    with pytest.raises(SceneError, match=r"the module 'twice_there' has no 'Law'"):
        scenes.pipe(contact="twice_there:Law")
    assert sys.modules.pop("twice_there").WHERE == "installed" and str(tmp_path / "here") not in sys.path


def test_the_guides_law_is_found_in_the_folder_that_one_is_in(tmp_path, monkeypatch):
    guide_law(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path])
    with pytest.raises(SceneError, match=r"must be a number in N/m\^1\.5; a number without a unit is in N/m\^1\.5$"):
        scenes.pipe(contact="sticky:Sticky", contact_stiffness="50 %")
    for pull in ("0.02 N", "20 mN", "2e-5 kN"):
        scene = scenes.pipe(contact="sticky:Sticky", contact_stiffness="5000 N/m^1.5", contact_pull=pull)
        assert scene.contact.stiffness == 5000.0 and scene.contact.pull == pytest.approx(0.02, rel=1e-15)
    with pytest.raises(SceneError, match=r"^contact_pull = '2 %': must be a number with one of the units N, mN, kN"):
        scenes.pipe(contact="sticky:Sticky", contact_pull="2 %")
    scene = scenes.pipe(contact="sticky:Sticky", contact_pull=0.01)
    assert "contact law Sticky" in scene.caption and "concrete" not in scene.caption
    assert scene.contact.pull == 0.01 and scene.contact.frictionless().pull == 0.0
    assert scene.parameters["contact_stiffness"] == 1e4
    monkeypatch.delitem(sys.modules, "sticky")


def test_an_interrupted_run_with_an_own_law_is_told_to_be_trusted(tmp_path, monkeypatch, capsys):
    guide_law(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "checkpoint.npz").touch()
    speed = {"steps_per_second": quantity(1.0, "1/s")}
    result = {"speed": speed, "steps": 1, "provenance": {"device": "cpu"}, "simulated_time": quantity(1.0, "s")}
    for law, words in (("sticky:Sticky", "warpcrete --trust run"), ("mortar", "warpcrete run")):
        report(ElementRun(scenes.pipe(contact=law), {"time": np.zeros(0)}, {}, result, False, folder=tmp_path))
        assert f"continue with        {words} --resume {tmp_path}\n" in capsys.readouterr().out
    monkeypatch.delitem(sys.modules, "sticky")


@pytest.mark.thorough
def test_the_guides_tests_of_the_law_pass(tmp_path):
    """One process runs the tests of both pages, which load the same kernels."""
    guide_law(tmp_path)
    guide(tmp_path, "own-contact-law.md", "def test_a_stone_rests_on_a_wall", "test_sticky.py")
    guide(tmp_path, "test-in-ci.md", "contact=Sticky", "test_sticky_pump.py")
    words = ["-m", "pytest", "-v", "-p", "no:cacheprovider", "test_sticky.py", "test_sticky_pump.py"]
    done = subprocess.run([sys.executable, *words], cwd=tmp_path, capture_output=True, encoding="utf-8", timeout=600)
    assert done.returncode == 0, done.stdout
    assert "test_sticky.py::test_" in done.stdout and "test_sticky_pump.py::test_" in done.stdout


@pytest.mark.thorough
def test_a_run_with_the_guides_law_is_repeated_to_the_bit(tmp_path):
    guide_law(tmp_path)
    options = small_options(travel=0.01, ramp=0.008, settle=0.1, solid_fraction=0.5)
    words = ["--device", "cpu", "--threads", "2", "--no-rerun", "--no-usd", "--quiet"]
    done = command_process("run", "pipe", "--contact", "sticky:Sticky", "--contact-pull", "0.002", *options, *words,
                           "--out", "one", cwd=tmp_path)  # fmt: skip
    assert_ended(done)
    again = command_process("--trust", "run", "one/scene.json", *words, "--out", "two", cwd=tmp_path)
    assert again.returncode == done.returncode, again.stderr
    other = command_process(
        "run", "pipe", "--contact", "sticky:Sticky", *options, *words, "--out", "three", cwd=tmp_path
    )
    assert_ended(other)
    one, two, three = (
        json.loads((tmp_path / name / "result.json").read_text(encoding="utf-8")) for name in ("one", "two", "three")
    )
    assert one["state_hash"] == two["state_hash"] != three["state_hash"]
    assert one["momentum_balance_error"] < 0.01
    lost = command_process(
        "--trust", "run", tmp_path / "one" / "scene.json", *words, "--out", tmp_path / "four", cwd="/"
    )
    assert lost.returncode == 2 and len(lost.stderr.splitlines()) == 1
    assert "there is no module 'sticky' on Python's path" in lost.stderr and "PYTHONPATH" in lost.stderr
