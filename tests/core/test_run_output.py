"""Run folders that Python writes: the same files as those of the command, at once or after the run."""

import errno
import json
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner
from pumping import TINY
from test_recordings import columns

import warpcrete
from warpcrete import RunFolder, RunFolderError, SceneError, Simulation, WarpcreteError, scenes
from warpcrete.cli.main import cli
from warpcrete.core.errors import DiskFullError
from warpcrete.core.run import run_loop
from warpcrete.core.run.files import LOCK, check_new
from warpcrete.core.run.folders import FolderLock
from warpcrete.core.run.recorder import Recorder

FLOW = dict(duration=0.02, spacing=0.01, length=0.1)
SETTINGS = dict(device="cpu", threads=1)
SCENES = {"channel": FLOW, "pipe": TINY}


def options(parameters):
    return [text for name, value in parameters.items() for text in (f"--{name.replace('_', '-')}", str(value))]


def contents(folder: Path) -> dict[str, object]:
    """Return scene.json and result.json without times, and the bytes of the tables."""
    found = {path.name: path.read_bytes() for path in folder.glob("*.csv")}
    for name in ("scene.json", "result.json"):
        found[name] = json.loads((folder / name).read_text(encoding="utf-8"))
    del found["result.json"]["speed"]
    return found


def files(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


class Stop(Recorder):
    """Ends a run at its third row."""

    def sample(self, simulation, row):
        simulation.stop_requested = len(simulation.rows) == 3


@pytest.mark.parametrize("name", SCENES)
def test_python_writes_what_the_command_writes(tmp_path, name):
    words = ["run", name, *options(SCENES[name]), "--device", "cpu", "--threads", "1", "--quiet"]
    CliRunner().invoke(cli, [*words, "--out", str(tmp_path / "command")])
    scene = getattr(scenes, name)(**SCENES[name])
    ran = Simulation(scene, **SETTINGS, out=tmp_path / "python").run()
    later = Simulation(scene, **SETTINGS).run()
    before = json.dumps(later.result["state_hash"])
    assert later.folder is None and later.save(str(tmp_path / "saved")) == tmp_path / "saved" == later.folder
    assert ran.save(tmp_path / "copied") == tmp_path / "copied" and ran.folder == tmp_path / "python"
    wanted = contents(tmp_path / "command")
    assert before == json.dumps(wanted["result.json"]["state_hash"])
    for folder in ("python", "saved", "copied"):
        assert files(tmp_path / folder) == files(tmp_path / "command")
        found = contents(tmp_path / folder)
        assert found == wanted, folder
    assert json.loads((tmp_path / "saved" / "result.json").read_text(encoding="utf-8")) == json.loads(
        json.dumps(later.result)
    )


def test_a_saved_recording_has_all_curves_and_the_last_frame(tmp_path):
    scene = scenes.pipe(**TINY)
    ran = Simulation(scene, **SETTINGS, out=tmp_path / "python").run()
    Simulation(scene, **SETTINGS).run().save(tmp_path / "saved")
    whole, saved = (tmp_path / name / "run.rrd" for name in ("python", "saved"))
    wanted, curve = (columns(path, "/energy/kinetic_energy") for path in (whole, saved))
    assert len(curve["time"]) == len(ran.series["time"])
    assert curve.keys() == wanted.keys() and all(curve[name] == wanted[name] for name in curve if name != "step")
    assert curve["step"][-1] == wanted["step"][-1] and not any(curve["step"][:-1])
    frames = [columns(path, "/scene/aggregates") for path in (whole, saved)]
    assert frames[0].keys() == frames[1].keys() and len(frames[0]["time"]) > 1 == len(frames[1]["time"])
    for name, values in frames[1].items():
        assert values == frames[0][name][-1:], name


def test_recordings_and_colours_are_chosen(tmp_path):
    out = RunFolder(tmp_path / "run", recordings="usd", colour="pressure")
    Simulation(scenes.channel(**FLOW), **SETTINGS, out=out, frame_interval=1 / 49).run()
    assert "scene.usdc" in files(out.path) and "run.rrd" not in files(out.path)
    command = json.loads((out.path / "scene.json").read_text(encoding="utf-8"))["command"]
    assert command["colour"] == "pressure" and command["frames"] == 49.0 and not command["rerun"]
    with pytest.raises(SceneError, match=r"^recordings = 'film': must be one of rerun, usd, paraview"):
        RunFolder(tmp_path / "other", recordings=["film"])
    for wrong, says in (({"colour": "force"}, "^colour = 'force': must be one of speed"),
                        ({"network": True}, "^network = True: needs contacts between bodies")):  # fmt: skip
        with pytest.raises(SceneError, match=says):
            Simulation(scenes.channel(**FLOW), **SETTINGS, out=RunFolder(tmp_path / "other", **wrong))
    with pytest.raises(SceneError, match=r"^checkpoint_path = .*: cannot be combined with 'out'"):
        Simulation(scenes.channel(**FLOW), **SETTINGS, out=tmp_path / "other", checkpoint_path=tmp_path / "a.npz")
    with pytest.raises(SceneError, match=r"^out = 3: must be the path of a new folder or a warpcrete.RunFolder"):
        Simulation(scenes.channel(**FLOW), **SETTINGS, out=3)
    assert files(tmp_path) == ["run"]


def test_folders_are_never_overwritten(tmp_path, monkeypatch):
    monkeypatch.setattr("warpcrete.core.run.folders.KILL_GRACE", 0.0)
    scene = scenes.channel(**FLOW)
    run = Simulation(scene, **SETTINGS, out=tmp_path / "run").run()
    before = contents(tmp_path / "run")
    with pytest.raises(RunFolderError, match="contains a finished run; choose a new folder"):
        Simulation(scene, **SETTINGS, out=tmp_path / "run").run()
    other = Simulation(scene, **SETTINGS).run()
    for each in (run, other):
        with pytest.raises(RunFolderError, match=r"run': exists already; choose a new folder"):
            each.save(tmp_path / "run")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(RunFolderError, match=r"mine': exists already"):
        Simulation(scene, **SETTINGS, out=tmp_path / "mine")
    (tmp_path / "mine" / "study.json").write_text("{}", encoding="utf-8")
    with pytest.raises(
        RunFolderError, match=r"read its study with warpcrete\.load, or continue it with 'warpcrete study"
    ):
        check_new(tmp_path / "mine")
    hold = FolderLock(tmp_path / "run")
    with pytest.raises(RunFolderError, match="is in use by process"):
        run.save(tmp_path / "copy")
    hold.release()
    assert contents(tmp_path / "run") == before and not (tmp_path / "copy").exists()
    assert LOCK not in files(tmp_path / "run")


@pytest.mark.parametrize("name", SCENES)
def test_a_run_that_stopped_goes_on_from_either_folder(tmp_path, name):
    """In Python and on the command line; with the bits of an undisturbed run."""
    scene = getattr(scenes, name)(**SCENES[name])
    whole = Simulation(scene, **SETTINGS, out=tmp_path / "whole").run()
    Simulation(scene, **SETTINGS, out=tmp_path / "stopped", recorders=[Stop()]).run()
    stopped = Simulation(scene, **SETTINGS, recorders=[Stop()]).run()
    stopped.save(tmp_path / "saved")
    assert not stopped.finished and len(stopped.series["time"]) == 3
    stopped.save(tmp_path / "again")
    for folder in ("stopped", "saved", "again"):
        assert "checkpoint.npz" in files(tmp_path / folder)
        assert not warpcrete.load(tmp_path / folder).finished
    again = Simulation(scene, **SETTINGS, out=tmp_path / "again").run()
    assert again.finished and again.result["state_hash"] == whole.result["state_hash"]
    for folder in ("stopped", "saved"):
        done = CliRunner().invoke(cli, ["run", "--resume", str(tmp_path / folder), "--quiet"])
        assert done.exception is None or isinstance(done.exception, SystemExit), done.output
    for folder in ("stopped", "saved", "again"):
        assert contents(tmp_path / folder) == contents(tmp_path / "whole")
        assert files(tmp_path / folder) == files(tmp_path / "whole")


def test_an_interrupted_run_is_saved_without_a_checkpoint(tmp_path):
    class Interrupt(Recorder):
        def sample(self, simulation, row):
            if len(simulation.rows) == 3:
                raise KeyboardInterrupt

    run = Simulation(scenes.channel(**FLOW), **SETTINGS, recorders=[Interrupt()]).run()
    run.save(tmp_path / "run")
    assert run.interrupted and "checkpoint.npz" not in files(tmp_path / "run")
    assert len(warpcrete.load(tmp_path / "run").series["time"]) == 3


def test_a_save_that_failed_can_be_repeated(tmp_path, monkeypatch):
    run = Simulation(scenes.channel(**FLOW), **SETTINGS).run()

    def full(recorder, simulation, row):
        raise OSError(errno.ENOSPC, "no space")

    with monkeypatch.context() as patched, pytest.raises(DiskFullError, match=r"no space.*no checkpoint was saved"):
        patched.setattr("warpcrete.record.run_folder.TableRecorder.sample", full)
        run.save(tmp_path / "full")
    assert run.folder is None and run.finished and run.result["finished"]
    run.save(tmp_path / "run")
    assert warpcrete.load(tmp_path / "run").finished and LOCK not in files(tmp_path / "full")


def test_an_interrupted_save_says_so_and_can_be_repeated(tmp_path, monkeypatch):
    run = Simulation(scenes.channel(**FLOW), **SETTINGS).run()

    def interrupt(recorder, simulation, row):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr("warpcrete.record.run_folder.TableRecorder.sample", interrupt)
        run.save(tmp_path / "cut")
    assert run.folder is None and run.finished and run.result["finished"]
    assert not contents(tmp_path / "cut").get("result.json", {"finished": False})["finished"]
    run.save(tmp_path / "run")
    assert warpcrete.load(tmp_path / "run").finished


def test_a_copy_that_fails_leaves_nothing(tmp_path, monkeypatch):
    run = Simulation(scenes.channel(**FLOW), **SETTINGS, out=tmp_path / "run").run()

    def full(source, target):
        if Path(target).name == "series.csv":
            raise OSError(errno.ENOSPC, "no space")
        return copy(source, target)

    copy = shutil.copyfile
    with monkeypatch.context() as patched, pytest.raises(RunFolderError, match=r"series.csv': cannot be written"):
        patched.setattr("shutil.copyfile", full)
        run.save(tmp_path / "copy")
    assert not (tmp_path / "copy").exists()
    run.save(tmp_path / "copy")
    assert warpcrete.load(tmp_path / "copy").finished


def test_a_frame_interval_of_zero_is_refused_with_a_folder_as_well(tmp_path):
    with pytest.raises(SceneError, match="frame_interval = 0"):
        Simulation(scenes.channel(**FLOW), out=tmp_path / "run", frame_interval=0)
    assert not files(tmp_path)


def test_a_run_without_a_state_cannot_be_saved(tmp_path, monkeypatch):
    monkeypatch.setattr(run_loop, "MAX_KEPT_MEMORY", 1.0)
    run = Simulation(scenes.channel(**FLOW), **SETTINGS).run()
    with pytest.raises(WarpcreteError, match=r"'channel' kept no final state.*Simulation\(scene, out=FOLDER\)"):
        run.save(tmp_path / "run")
    assert not files(tmp_path)


def test_a_run_without_a_folder_has_the_checks_that_its_folder_would_have(tmp_path):
    scene = scenes.channel(**FLOW)
    alone = Simulation(scene, **SETTINGS).run()
    written = Simulation(scene, **SETTINGS, out=tmp_path / "run").run()
    assert alone.result["checks"] == written.result["checks"] == contents(tmp_path / "run")["result.json"]["checks"]
    assert alone.result["checks"] and all(set(each) == {"passed", "found"} for each in alone.result["checks"].values())


def test_a_scene_built_by_hand_is_written_without_checks(tmp_path):
    from dataclasses import replace

    scene = replace(scenes.channel(**FLOW), parameters={})
    run = Simulation(scene, **SETTINGS, out=tmp_path / "run").run()
    assert run.finished and "checks" not in run.result and "modified" in contents(tmp_path / "run")["scene.json"]
