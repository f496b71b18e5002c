"""Run folders: each has one writer at a time, and a refused run leaves none behind."""

import errno
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner
from pumping import TINY
from run_folders import flow, same

from warpcrete import RunFolderError, Simulation, scenes
from warpcrete.cli.main import cli
from warpcrete.core.errors import SceneError
from warpcrete.core.run import folders
from warpcrete.core.run.files import LOCK, write_json
from warpcrete.core.run.folders import FolderLock, make_folder, new_folder
from warpcrete.core.run.recorder import Recorder
from warpcrete.dem.batch_run import run_batch
from warpcrete.record.loading import is_finished
from warpcrete.record.output import SETTINGS
from warpcrete.record.run_folder import TableRecorder, _difference
from warpcrete.studies.calibration.calibrate import resume_calibration
from warpcrete.studies.reproduction.reproduce import resume_reproduction

HOLDING = """
import sys, time
from pathlib import Path
from warpcrete.core.run.folders import FolderLock
hold = FolderLock(Path(sys.argv[1]))
print("held", flush=True)
time.sleep(60)
"""


def test_a_folder_has_one_owner_whose_name_the_next_one_reads(tmp_path, monkeypatch):
    monkeypatch.setattr(folders, "KILL_GRACE", 0.0)
    hold = FolderLock(tmp_path)
    with pytest.raises(RunFolderError, match=rf"': is in use by process {os.getpid()} on \S+ since \d+-\d+-\d+ "):
        FolderLock(tmp_path)
    copy = shutil.copytree(tmp_path, tmp_path.with_name("copy"))
    FolderLock(copy).release()  # a copy is free
    hold.release()
    hold.release()
    assert not list(tmp_path.iterdir()) and not list(copy.iterdir())
    FolderLock(tmp_path).release()


def test_the_lock_of_a_killed_process_holds_nobody_up(tmp_path, monkeypatch):
    process = subprocess.Popen([sys.executable, "-c", HOLDING, str(tmp_path)], stdout=subprocess.PIPE, encoding="utf-8")
    try:
        assert process.stdout.readline() == "held\n"
        monkeypatch.setattr(folders, "KILL_GRACE", 0.0)
        with pytest.raises(RunFolderError, match=f"in use by process {process.pid} on"):
            FolderLock(tmp_path)
    finally:
        process.kill()
        process.communicate()
    assert (tmp_path / LOCK).is_file()
    (tmp_path / ".warpcrete-partial-run.rrd").write_bytes(b"half")
    FolderLock(tmp_path).release()
    assert not list(tmp_path.iterdir())


def test_files_of_the_user_stay(tmp_path):
    """Whatever their names: in a folder that is taken for a run's, and in one that a run is asked to fill."""
    (tmp_path / "partial-thesis.pdf").write_bytes(b"years")
    with pytest.raises(RunFolderError, match=r"holds no reproduction\.json; give"):
        resume_reproduction(tmp_path)
    with pytest.raises(RunFolderError, match="exists already"):
        make_folder(tmp_path)
    FolderLock(tmp_path).release()
    assert [path.name for path in tmp_path.iterdir()] == ["partial-thesis.pdf"]
    for resume in (resume_reproduction, lambda folder: resume_calibration(folder, {})):
        with pytest.raises(RunFolderError, match=r"/nope': is not a folder; give"):
            resume(tmp_path / "nope")


def test_a_new_folder_is_new(tmp_path):
    with new_folder(tmp_path / "a" / "b"):
        assert [path.name for path in (tmp_path / "a" / "b").iterdir()] == [LOCK]
    make_folder(tmp_path / "a" / "b").release()  # nothing was written: as a killed process leaves it
    (tmp_path / "a" / "b" / "file").touch()
    with pytest.raises(RunFolderError, match="exists already"):
        make_folder(tmp_path / "a" / "b")


def test_a_new_folder_that_another_run_fills_before_it_is_locked_is_refused(tmp_path, monkeypatch):
    usual = FolderLock.__init__

    def wait(self, where):
        usual(self, where)
        (where / "result.json").touch()

    monkeypatch.setattr(FolderLock, "__init__", wait)
    with pytest.raises(RunFolderError, match="exists already"):
        make_folder(tmp_path / "run")
    assert [path.name for path in (tmp_path / "run").iterdir()] == ["result.json"]  # the lock is released


def test_what_another_run_did_while_one_waited_for_the_folder_counts(tmp_path, monkeypatch, undisturbed_folder):
    """It may have ended, or written a checkpoint; without one, the record becomes that of the run that begins anew."""
    folder = shutil.copytree(undisturbed_folder, tmp_path / "run")
    (folder / "result.json").unlink()
    recorded = (folder / "scene.json").read_bytes()
    usual = FolderLock.__init__

    def late(*names):
        def wait(self, where):
            usual(self, where)
            for name in names:
                shutil.copyfile(undisturbed_folder / name, folder / name)

        monkeypatch.setattr(FolderLock, "__init__", wait)

    late("result.json")
    with pytest.raises(RunFolderError, match=r"exists already and contains a finished run"):
        flow(folder, going_on=True).begin(folder / "checkpoint.npz")
    (folder / "result.json").unlink()
    late()
    (folder / "scene.json").write_text('{"scene": "old"}', encoding="utf-8")
    begun = flow(folder, going_on=True)
    begun.begin(folder / "checkpoint.npz")
    assert json.loads((folder / "scene.json").read_text(encoding="utf-8"))["scene"] == "channel"
    begun.save(folder / "checkpoint.npz")
    begun.abandon()
    (folder / "checkpoint.npz").replace(undisturbed_folder.parent / "other.npz")

    def checkpointed(self, where):
        usual(self, where)
        shutil.copyfile(undisturbed_folder.parent / "other.npz", folder / "checkpoint.npz")

    monkeypatch.setattr(FolderLock, "__init__", checkpointed)
    (folder / "scene.json").write_bytes(recorded)
    again = flow(folder, going_on=True)
    again.begin(folder / "checkpoint.npz")
    assert again.resumes and (folder / "scene.json").read_bytes() == recorded
    again.abandon()
    record = json.loads(recorded)
    again = flow(folder, going_on=True)
    again.recorders[0].again = True
    (folder / "scene.json").write_text(json.dumps(record | {"files": {"bore.stl": "0"}}), encoding="utf-8")
    with pytest.raises(RunFolderError, match=r"another run \(its file 'bore.stl' differs\)"):
        again.begin(folder / "checkpoint.npz")
    assert _difference({"files": None, "scene": "tube"}, {"files": {}, "scene": "tube"}) == ""


def test_runs_may_differ_in_the_time_between_checkpoints_alone():
    there = {"scene": "tube", "files": {"a.stl": "0"}, "command": {"frames": 25.0, "checkpoint_every": 60.0}}

    def difference(**changes):
        return _difference(there, there | changes)

    assert difference() == difference(command={"frames": 25.0, "checkpoint_every": 5.0}) == ""
    assert difference(command={"frames": 50.0, "checkpoint_every": 5.0}) == "its frames is 25.0 instead of 50.0"
    assert difference(scene="pipe") == 'its scene is "tube" instead of "pipe"'
    assert difference(files={"a.stl": "0", "b.stl": "1"}) == "its file 'b.stl' differs"
    assert difference(device="cpu") == 'its device is null instead of "cpu"'


def test_a_run_that_never_began_leaves_an_empty_folder_empty(tmp_path):
    begun = flow(tmp_path)
    begun.claim()
    assert (tmp_path / "scene.json").is_file()
    begun.abandon()
    assert not list(tmp_path.iterdir())


def test_two_runs_into_one_folder_are_one_too_many(tmp_path, monkeypatch, undisturbed_folder):
    """A second run is refused, whether it begins or resumes. The command does so in one line, with exit code 2."""
    monkeypatch.setattr(folders, "KILL_GRACE", 0.0)
    seen = []

    class Second(Recorder):
        def sample(self, simulation, row):
            if len(simulation.rows) == 2:
                for other in (flow(tmp_path / "run"), flow(tmp_path / "run", going_on=True)):
                    with pytest.raises(RunFolderError) as refused:
                        other.run()
                    seen.append(str(refused.value))
                seen.append(str(CliRunner().invoke(cli, ["run", "--resume", str(tmp_path / "run")]).exception))
                assert is_finished(tmp_path / "run") is False  # readers need no lock

    first = flow(tmp_path / "run", Second())
    first.recorders[0].command = {key: {"threads": 1, "checkpoint_every": 1.0}.get(key) for key in SETTINGS}
    first.run()
    assert "exists already" in seen[0]
    assert f"is in use by process {os.getpid()}" in seen[1] and "is in use by process" in seen[2]
    assert same(tmp_path / "run", undisturbed_folder)


@pytest.mark.parametrize(
    "words", [("reproduce", "zhan"), ("study", "channel", "--flow", "1e-3", "2e-3"), ("line", "{}", "--simulate"),
              ("trade", "tube"), ("run", "channel"), ("calibrate", "{}")], ids=lambda words: words[0],
)  # fmt: skip
def test_a_device_that_there_is_not_leaves_no_folder(tmp_path, words):
    texts = {
        "line": "diameter: 125 mm\nflow: 20 m3/h\nconcrete: no1\nparts:\n  - straight: 10 m\n",
        "calibrate": "vary: {viscosity: [10, 100]}\ntargets:\n  - {scene: slump, parameters: {concrete: own, density: "
        "2350, yield_stress: 80}, quantity: spread, value: 0.5, uncertainty: 5%}\n",
    }
    file = tmp_path / "in.yaml"
    file.write_text(texts.get(words[0], ""), encoding="utf-8")
    out = tmp_path / "a" / "b"
    call = [word.format(file) for word in words]
    done = CliRunner().invoke(cli, [*call, "--device", "nope", "--out", str(out), "--quiet"])
    assert "nope" in str(done.exception), done.output
    assert [path.name for path in tmp_path.iterdir()] == ["in.yaml"]


def test_a_scene_that_is_refused_after_packing_leaves_no_folder(tmp_path):
    folder = tmp_path / "a" / "run"
    scene = scenes.pipe(**TINY | dict(time_step=0.01))
    for run in (lambda s: s.run(), lambda s: run_batch([s])):
        simulation = Simulation(scene, device="cpu", recorders=[TableRecorder(folder)])
        try:
            (outcome,) = run(simulation)
        except SceneError as error:
            outcome = error
        assert isinstance(outcome, SceneError) and not list(tmp_path.iterdir())


class WindowsLocks:
    """Python's module `msvcrt`, as far as locks need it, built on the locks of POSIX."""

    LK_NBLCK = 2

    def locking(self, file, mode, count):
        import fcntl

        assert (mode, count) == (self.LK_NBLCK, 1)
        assert os.lseek(file, 0, os.SEEK_CUR) > 10_000, "no other process could read a locked byte of the owner's name"
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


@pytest.fixture
def windows(monkeypatch):
    """Work with Python's library of Windows, which has `msvcrt` instead of `fcntl` and fewer flags of files."""
    monkeypatch.setattr(folders, "fcntl", None)
    monkeypatch.setattr(folders, "msvcrt", WindowsLocks(), raising=False)
    monkeypatch.setattr(folders, "KILL_GRACE", 0.2)
    monkeypatch.delattr(os, "O_CLOEXEC", raising=False)


@pytest.mark.posix
def test_a_folder_is_released_on_windows(windows, tmp_path, monkeypatch):
    lock, unlink = FolderLock(tmp_path), Path.unlink

    def unlink_closed(path, missing_ok=False):
        if lock._file >= 0:
            raise PermissionError("Windows removes only files that are closed")
        unlink(path, missing_ok)

    monkeypatch.setattr(Path, "unlink", unlink_closed)
    assert (tmp_path / LOCK).is_file()
    lock.release()
    assert not (tmp_path / LOCK).exists()


@pytest.mark.posix
def test_a_folder_has_one_writer_on_windows(windows, tmp_path):
    """A second writer learns the owner's name; a file that a killed process leaves behind blocks nobody."""
    lock = FolderLock(tmp_path)
    with pytest.raises(RunFolderError, match=rf"is in use by process {os.getpid()} on .*; wait until it ends"):
        FolderLock(tmp_path)
    os.close(lock._file)  # The system does so when a process ends.
    lock._file = -1
    assert (tmp_path / LOCK).is_file()
    FolderLock(tmp_path).release()
    assert not (tmp_path / LOCK).exists()


@pytest.mark.posix
def test_a_lock_file_that_is_being_removed_is_tried_again_on_windows(windows, tmp_path, monkeypatch):
    refusals, opened = iter([True, True, False]), os.open

    def open_later(path, *rest):
        if Path(path).name == LOCK and next(refusals, True):
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return opened(path, *rest)

    monkeypatch.setattr(os, "open", open_later)
    FolderLock(tmp_path).release()
    with pytest.raises(RunFolderError, match="cannot be written"):
        FolderLock(tmp_path)


def test_a_write_that_fails_leaves_the_file_as_it_was(tmp_path, monkeypatch):
    """A reader finds the old contents until the new ones are complete, and no partial file remains."""
    path = tmp_path / "result.json"
    write_json(path, {"a": 1})
    write = Path.write_text

    def half(self, text, **settings):
        assert json.loads(path.read_text(encoding="utf-8")) == {"a": 1}
        write(self, text[: len(text) // 2], **settings)
        raise OSError(errno.ENOSPC, "full")

    monkeypatch.setattr(Path, "write_text", half)
    with pytest.raises((OSError, RunFolderError)):
        write_json(path, {"a": 2, "b": [3, 4]})
    monkeypatch.undo()
    assert json.loads(path.read_text(encoding="utf-8")) == {"a": 1} and list(tmp_path.iterdir()) == [path]
    write_json(path, {"a": 2, "b": [3, 4]})
    assert json.loads(path.read_text(encoding="utf-8")) == {"a": 2, "b": [3, 4]}


def test_a_folder_is_finished_if_its_result_says_so_and_no_checkpoint_is_left(tmp_path):
    """A checkpoint remains until all files are written, so a folder that has one must be completed."""
    assert not is_finished(tmp_path)
    write_json(tmp_path / "result.json", {"finished": False})
    assert not is_finished(tmp_path)
    write_json(tmp_path / "result.json", {"finished": True})
    assert is_finished(tmp_path)
    (tmp_path / "checkpoint.npz").touch()
    assert not is_finished(tmp_path)
