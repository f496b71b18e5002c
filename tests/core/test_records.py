"""Records of runs: a scene that its arguments do not make again, or whose files have changed, is not repeated."""

import copy
import dataclasses
import hashlib
import importlib
import json
from pathlib import Path
from types import SimpleNamespace

import pytest
from click.testing import CliRunner
from pumping import open_tube

import warpcrete
from warpcrete import RunFolderError, Simulation, scenes
from warpcrete.cli import cli
from warpcrete.core.device.device import find_device
from warpcrete.core.inputs import origin
from warpcrete.core.inputs.fingerprints import fingerprint
from warpcrete.core.inputs.origin import arguments_of, changed_fields
from warpcrete.core.run.files import write_json
from warpcrete.record.loading import repeatable_scene
from warpcrete.record.run_folder import TableRecorder, scene_record
from warpcrete.studies import study as studies
from warpcrete.studies.lines.folder import previous_run

QUICK = dict(spacing=0.02, duration=0.012, sample_interval=4e-3)
EVERY = sorted(scenes.modules())


def saved(scene, folder):
    """Path of the record of a run of a scene, without the run."""
    folder.mkdir(exist_ok=True)
    simulation = SimpleNamespace(scene=scene, device=find_device("cpu"), precision=scene.precision, threads=None)
    write_json(folder / "scene.json", scene_record(simulation))
    return folder / "scene.json"


def refused(*words):
    """The one line that the command ends with for bad input."""
    done = CliRunner().invoke(cli, list(map(str, words)))
    assert isinstance(done.exception, warpcrete.WarpcreteError), done
    assert "\n" not in str(done.exception)
    return str(done.exception)


@pytest.mark.parametrize("name", EVERY)
def test_every_field_of_every_scene_is_watched(name, tmp_path):
    scene = scenes.modules()[name].scene()
    assert changed_fields(scene) == [] and arguments_of(scene) == scene.parameters
    record = json.loads(saved(scene, tmp_path).read_text(encoding="utf-8"))
    assert "modified" not in record and record["scene"] == name
    again, module = repeatable_scene(tmp_path / "scene.json", scenes.modules())
    assert fingerprint(module.scene(**again["parameters"])) == fingerprint(scene)
    for field in dataclasses.fields(scene):
        other = copy.copy(scene)
        object.__setattr__(other, field.name, {"another": 1})
        every = [f.name for f in dataclasses.fields(scene) if f.name != "parameters"]
        assert changed_fields(other) == (every if field.name == "parameters" else [field.name]), field.name
        assert arguments_of(other) == {}
    by_hand = json.loads(saved(dataclasses.replace(scene, parameters={}), tmp_path).read_text(encoding="utf-8"))
    assert list(by_hand["modified"]) == every and by_hand["parameters"] == {} and by_hand["files"] == {}


def test_arrays_and_arguments_changed_in_place_are_seen():
    scene = scenes.pipe()
    scene.bodies[0].positions[0] += 1e-3
    assert changed_fields(scene) == ["bodies"]
    scene = scenes.channel()
    scene.parameters["flow"] = 2e-3
    assert changed_fields(scene) == ["parameters"]
    assert "changed after" in scene._repr_html_() and "changed after" not in scenes.channel()._repr_html_()


def test_a_law_of_the_same_name_from_elsewhere_is_another():
    from warpcrete.dem.laws import Contact

    other = dataclasses.make_dataclass("Contact", [], bases=(Contact,), frozen=True, kw_only=True)
    scene = scenes.pipe()
    assert changed_fields(dataclasses.replace(scene, contact=Contact(**vars(scene.contact)))) == []
    assert changed_fields(dataclasses.replace(scene, contact=other(**vars(scene.contact)))) == ["contact"]


def test_changed_and_hand_built_scenes_are_recorded_loaded_and_not_repeated(tmp_path):
    made = scenes.channel(**QUICK)
    changed = dataclasses.replace(made, velocity=0.1, tolerance=1e-3)
    by_hand = dataclasses.replace(made, name="mine", parameters={})
    for name, scene in (("made", made), ("changed", changed), ("by-hand", by_hand)):
        run = Simulation(scene, device="cpu", recorders=[TableRecorder(tmp_path / name)]).run()
        back = warpcrete.load(tmp_path / name)
        assert back["pressure"] == run["pressure"] and back.scene.name == scene.name, name
    record = json.loads((tmp_path / "changed" / "scene.json").read_text(encoding="utf-8"))
    assert record["modified"] == {"velocity": 0.1, "tolerance": 1e-3} and record["scene"] == "channel"
    assert warpcrete.load(tmp_path / "changed").scene.modified == record["modified"]
    assert isinstance(warpcrete.load(tmp_path / "made").scene, type(made))
    record = json.loads((tmp_path / "by-hand" / "scene.json").read_text(encoding="utf-8"))
    assert record["modified"]["velocity"] == made.velocity and record["modified"]["concrete"]["name"] == "no1"
    for words in (["run", tmp_path / "changed" / "scene.json", "--out", tmp_path / "out"],
                  ["run", "--resume", tmp_path / "changed"]):  # fmt: skip
        assert (
            "the scene was changed in Python (tolerance, velocity) after a function such as scenes.pipe() had built it"
            in refused(*words)
        )
    for words in (["run", tmp_path / "by-hand" / "scene.json", "--out", tmp_path / "out"],
                  ["run", "--resume", tmp_path / "by-hand"]):  # fmt: skip
        assert "its scene was built in Python" in refused(*words)
    assert not (tmp_path / "out").exists()


def test_a_changed_scene_goes_on_in_python_from_its_own_checkpoint_alone(tmp_path):
    made = scenes.channel(**QUICK)
    changed = dataclasses.replace(made, velocity=0.1)
    path = tmp_path / "run" / "checkpoint.npz"

    def simulation(scene):
        return Simulation(scene, device="cpu", recorders=[TableRecorder(tmp_path / "run")], checkpoint_path=path)

    cut = simulation(changed)
    cut.stop_requested = True
    assert not cut.run().finished and path.is_file()
    with pytest.raises(RunFolderError, match="belongs to another scene"):
        simulation(made).resume(path)
    again = simulation(changed)
    again.resume(path)
    assert again.run().finished
    assert "the scene was changed in Python (velocity) after" in refused("run", "--resume", tmp_path / "run")


def test_a_mesh_that_changed_or_went_is_not_taken_for_the_one_of_the_run(tmp_path):
    mesh = open_tube(tmp_path / "tube.stl", hole=False)
    scene = scenes.pipe(wall=str(mesh), diameter=0.08, length=0.1, ramp=0.01, travel=0.02)
    record = saved(scene, tmp_path / "run")
    assert list(json.loads(record.read_text(encoding="utf-8"))["files"]) == [str(mesh)]
    repeatable_scene(record, scenes.modules())
    before = mesh.read_bytes()
    mesh.write_bytes(before + b" ")
    assert "tube.stl', which has changed" in refused("run", record, "--out", tmp_path / "out")
    assert isinstance(warpcrete.load(tmp_path / "run").scene, SimpleNamespace)
    mesh.unlink()
    assert "tube.stl', which is missing" in refused("run", record, "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()
    mesh.write_bytes(before)
    assert isinstance(warpcrete.load(tmp_path / "run").scene, type(scene))


def test_a_line_file_that_changed_is_not_taken_for_the_one_of_the_run(tmp_path):
    line = tmp_path / "line.yaml"
    line.write_text(
        "diameter: 0.1\nparts:\n  - straight: 0.3\n  - bend: {to: up, radius: 0.25}\n  - straight: 0.3\n",
        encoding="utf-8",
    )
    record = saved(scenes.part(line=str(line)), tmp_path / "run")
    assert list(json.loads(record.read_text(encoding="utf-8"))["files"]) == [str(line)]
    line.write_text(line.read_text(encoding="utf-8").replace("0.25", "0.3"), encoding="utf-8")
    assert "line.yaml', which has changed" in refused("run", record, "--out", tmp_path / "out")


@pytest.mark.parametrize("name, section, scene", [
    ("elements", "friction: 0.2", "pipe"), ("flow", "viscosity: 30", "channel"), ("flow", "viscosity: 30", "slump"),
    ("elements", "friction: 0.2", "part-dem"),
])  # fmt: skip
def test_a_concrete_is_recorded_by_value_so_its_file_may_change_and_go(name, section, scene, tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text(f"base: {'zhan' if name == 'elements' else 'no1'}\n{name}:\n  {section}\n", encoding="utf-8")
    made = scenes.modules()[scene].scene(concrete=str(file))
    record = saved(made, tmp_path / "run")
    for change in (lambda: file.write_text("base: no2\n", encoding="utf-8"), file.unlink):
        change()
        again, module = repeatable_scene(record, scenes.modules())
        assert fingerprint(module.scene(**again["parameters"])) == fingerprint(made)


def test_a_study_does_not_go_on_with_a_file_that_changed(tmp_path, monkeypatch):
    mesh = open_tube(tmp_path / "tube.stl", hole=False)
    given = dict(wall=str(mesh), diameter=0.08, length=0.1, ramp=0.01, travel=0.02)
    module = importlib.import_module("warpcrete.scenes.pipe")
    monkeypatch.setattr(studies, "run_in_processes", lambda *rest: None)
    begun = studies.run_study("pipe", module, {"velocity": [0.1, 0.2]}, base=given, out=tmp_path / "s", device="cpu")
    assert not begun.finished
    mesh.write_bytes(mesh.read_bytes() + b" ")
    with pytest.raises(RunFolderError, match=r"study\.json': its scene was made with '.*tube\.stl', which has changed"):
        studies.resume_study(tmp_path / "s", module)


def test_a_line_takes_no_run_of_a_changed_scene_for_its_own(tmp_path):
    made = scenes.channel(**QUICK)
    for name, scene in (("made", made), ("changed", dataclasses.replace(made, velocity=0.1))):
        parts = tmp_path / name / "parts"
        parts.mkdir(parents=True)
        saved(scene, parts / "run")
        write_json(parts / "run" / "result.json", {"finished": True})
        assert (previous_run([tmp_path / name], made) is not None) == (name == "made")


def test_files_of_the_package_are_not_recorded_and_those_beside_it_are(tmp_path):
    """The version of the package identifies its own files; a user's file may lie in the same folder as the package."""
    beside, inside = Path(__file__), Path(warpcrete.__file__).parent / "measured" / "tube.json"
    own = tmp_path / "own.yaml"
    own.write_text("x: 1", encoding="utf-8")
    with origin.files_read() as found:
        for path in (beside, inside, own):
            origin.note_file(path)
    assert set(found) == {str(beside.resolve()), str(own.resolve())}
    assert found[str(own.resolve())] == hashlib.sha256(b"x: 1").hexdigest()
