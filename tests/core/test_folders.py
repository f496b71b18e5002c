"""Run folders: one writer each, state before all else, failures that cost only themselves, and what a kill leaves."""

import errno
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest
from click.testing import CliRunner
from pumping import TINY, alive, wait_until

from warpcrete import RunFolderError, Simulation, scenes
from warpcrete.cli.main import cli
from warpcrete.cli.run import PipelineRecorder
from warpcrete.core.device.interrupts import StopAtSample, defer_interrupts
from warpcrete.core.errors import DiskFullError, SceneError
from warpcrete.core.run import checkpoint, folders
from warpcrete.core.run.files import LOCK, cannot_write
from warpcrete.core.run.folders import FolderLock, locked_folder, make_folder, new_folder
from warpcrete.core.run.processes import killed_with_parent
from warpcrete.core.run.recorder import Recorder
from warpcrete.dem.batch_run import run_batch
from warpcrete.record.checks import CheckRecorder
from warpcrete.record.loading import is_finished
from warpcrete.record.output import SETTINGS
from warpcrete.record.rerun import RerunRecorder
from warpcrete.record.run_folder import TableRecorder
from warpcrete.studies.calibration.calibrate import resume_calibration
from warpcrete.studies.reproduction.reproduce import resume_reproduction

FLOW = dict(duration=0.02, spacing=0.01, length=0.1)
METHODS = ("start", "sample", "frame", "checkpoint", "write", "finish", "tidy")
HOLDING = """
import sys, time
from pathlib import Path
from warpcrete.core.run.folders import FolderLock
hold = FolderLock(Path(sys.argv[1]))
print("held", flush=True)
time.sleep(60)
"""


def flow(folder=None, *more, every=0.0, going_on=False):
    """A short flow into a folder, with a checkpoint at every sample, and other recorders."""
    table = [] if folder is None else [TableRecorder(folder, going_on=going_on)]
    path = None if folder is None else folder / "checkpoint.npz"
    return Simulation(scenes.channel(**FLOW), device="cpu", threads=1, recorders=[*table, *more], checkpoint_path=path,
                      checkpoint_every=every)  # fmt: skip


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The folder of a flow that nothing disturbed."""
    folder = tmp_path_factory.mktemp("folders") / "whole"
    flow(folder).run()
    return folder


def same(folder, whole) -> bool:
    """Whether a folder is as complete as that of an undisturbed run, with the same bits."""
    results = [json.loads((each / "result.json").read_text(encoding="utf-8")) for each in (folder, whole)]
    names = [sorted(path.name for path in each.iterdir()) for each in (folder, whole)]
    series = [(each / "series.csv").read_bytes() for each in (folder, whole)]
    return (
        names[0] == names[1] and series[0] == series[1] and results[0]["state_hash"] == results[1]["state_hash"]
        and results[0]["finished"] is True
    )  # fmt: skip


# One writer each.


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


def test_what_another_run_did_while_one_waited_for_the_folder_counts(tmp_path, monkeypatch, whole):
    """It may have ended, or written a checkpoint; without one, the record becomes that of the run that begins anew."""
    folder = shutil.copytree(whole, tmp_path / "run")
    (folder / "result.json").unlink()
    recorded = (folder / "scene.json").read_bytes()
    usual = FolderLock.__init__

    def late(*names):
        def wait(self, where):
            usual(self, where)
            for name in names:
                shutil.copyfile(whole / name, folder / name)

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
    (folder / "checkpoint.npz").replace(whole.parent / "other.npz")

    def checkpointed(self, where):
        usual(self, where)
        shutil.copyfile(whole.parent / "other.npz", folder / "checkpoint.npz")

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
    with pytest.raises(RunFolderError, match=r"another run \(its files differs\)"):
        again.begin(folder / "checkpoint.npz")


def test_a_run_that_never_began_leaves_an_empty_folder_empty(tmp_path):
    begun = flow(tmp_path)
    begun.claim()
    assert (tmp_path / "scene.json").is_file()
    begun.abandon()
    assert not list(tmp_path.iterdir())


def test_two_runs_into_one_folder_are_one_too_many(tmp_path, monkeypatch, whole):
    """Whether the second begins or resumes; by command it is one line and exit code 2."""
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
    assert same(tmp_path / "run", whole)


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


# Failures.


class Failing(Recorder):
    """Fails in one of its methods, from a moment on."""

    expendable = True

    def __init__(self, method, error):
        self.closed = 0

        def fail(simulation, *arguments):
            if method not in ("sample", "frame", "checkpoint", "write") or len(simulation.rows) > 2:
                raise error
            return None

        setattr(self, method, fail)

    def close(self, simulation):
        self.closed += 1


@pytest.mark.parametrize("method", METHODS)
def test_a_recording_that_fails_costs_itself_alone(tmp_path, whole, method):
    failing = Failing(method, ValueError("no paint"))
    with pytest.warns(
        UserWarning, match="^Failing failed, and the run continues without its output: no paint$"
    ) as told:
        run = flow(tmp_path / "run", failing).run()
    assert run.finished and same(tmp_path / "run", whole) and len(told) == 1 and failing.closed == 1


@pytest.mark.parametrize("method", METHODS)
def test_a_full_disk_ends_the_run_which_goes_on_when_there_is_room(tmp_path, whole, method):
    full = cannot_write(tmp_path / "run" / "film", OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))
    with pytest.raises(DiskFullError) as told:
        flow(tmp_path / "run", Failing(method, full)).run()
    assert str(told.value).startswith(f"'{tmp_path / 'run' / 'film'}': cannot be written (No space left on device); ")
    kept = float(re.search(r"; the checkpoint at t = (\S+) s is saved; free some space", str(told.value))[1])
    assert not is_finished(tmp_path / "run") and not (tmp_path / "run" / LOCK).exists()
    again = flow(tmp_path / "run")
    again.begin(tmp_path / "run" / "checkpoint.npz")
    assert again.stepper.time == pytest.approx(kept, abs=1e-9) and (kept > 0) == (method != "start")
    assert again.run().finished and same(tmp_path / "run", whole)


def test_every_file_that_could_not_be_written_is_named(tmp_path, monkeypatch):
    """The state is tried first, then the result and the series, then recordings; each is tried whatever came before."""
    tried = []

    def write(path, *given):
        tried.append("state")
        raise cannot_write(path, OSError(errno.ENOSPC, "full"))

    def write_json(path, data):
        tried.append(path.name)
        if path.name == "result.json":
            raise cannot_write(path, OSError(errno.EDQUOT, "quota"))
        path.write_text(json.dumps(data), encoding="utf-8")

    class Film(Recorder):
        expendable = True

        def finish(self, simulation, run):
            tried.append("film")
            raise cannot_write(tmp_path / "film", OSError(errno.EFBIG, "too large"))

    simulation = flow(tmp_path / "run", Film(), every=1e9)
    monkeypatch.setattr(checkpoint, "write_partial", write)
    monkeypatch.setattr("warpcrete.record.run_folder.write_json", write_json)
    monkeypatch.setattr(Simulation, "_checkpoint", lambda self: None)
    with pytest.raises(DiskFullError) as told:
        simulation.run()
    assert tried[:4] == ["scene.json", "state", "result.json", "film"]
    text = str(told.value)
    assert "result.json': cannot be written (quota); neither can" in text and f"'{tmp_path / 'film'}'" in text
    assert "no checkpoint was saved" in text and "\n" not in text


def test_a_checkpoint_writes_state_result_and_recordings_in_this_order(tmp_path, monkeypatch):
    order = []
    monkeypatch.setattr(checkpoint, "write_partial", lambda *given: order.append("state"))
    monkeypatch.setattr(checkpoint, "commit", lambda path: order.append("commit"))
    monkeypatch.setattr(TableRecorder, "write", lambda self, simulation: order.append("result"))

    class Film(Recorder):
        expendable = True

        def write(self, simulation):
            order.append("film")

    flow(tmp_path / "run", Film()).run()
    assert order[:2] == ["state", "commit"] == order[-2:]  # at t = 0 and at the end
    assert order[2:-2] == ["state", "result", "film", "commit"] * (len(order[2:-2]) // 4) and len(order) > 8


# Kills.


class Killed(BaseException):
    """Stands for a kill: nothing handles it."""


def test_a_kill_while_a_recording_is_joined_is_made_good(tmp_path, whole, monkeypatch):
    """Whether it comes before the joined file is in place, or when some parts are gone."""
    folder = tmp_path / "run"

    def cut(parts, path):
        path.with_name(".warpcrete-partial-run.rrd").write_bytes(b"half")
        raise Killed

    with monkeypatch.context() as patch:
        patch.setattr("warpcrete.record.rerun.join", cut)
        with pytest.raises(Killed):
            first = flow(folder, RerunRecorder(folder / "run.rrd"))
            first.run()
    first.recorders[0].close(first)  # the lock of a process that has ended is free
    assert (
        len(list(folder.glob("run-*.rrd"))) > 2
        and json.loads((folder / "result.json").read_text(encoding="utf-8"))["finished"]
    )
    assert not is_finished(folder)
    shutil.copyfile(next(folder.glob("run-0002.rrd")), tmp_path / "part")
    for number in range(2):
        again = flow(folder, RerunRecorder(folder / "run.rrd"), going_on=True)
        again.begin(folder / "checkpoint.npz")
        with monkeypatch.context() as patch:
            if number == 0:
                patch.setattr(checkpoint, "remove", lambda path: None)  # killed when all but this was done
            again.run()
        if number == 0:
            shutil.copyfile(tmp_path / "part", folder / "run-0002.rrd")
            assert not is_finished(folder)
    assert (folder / "run.rrd").stat().st_size > 10_000
    assert sorted(path.name for path in folder.glob("*run*")) == ["run.rrd"]
    (folder / "run.rrd").unlink()
    assert same(folder, whole)


def test_locks_of_killed_runs_go_when_the_folder_around_them_goes_on(tmp_path):
    inner = tmp_path / "study" / "runs" / "001"
    inner.mkdir(parents=True)
    (tmp_path / "study" / "study.json").write_text("{}", encoding="utf-8")
    (inner / LOCK).write_text("process 1 on a machine that is off", encoding="utf-8")
    (inner / ".warpcrete-partial-result.json").write_text("{", encoding="utf-8")
    with locked_folder(tmp_path / "study", "study.json"):
        assert (tmp_path / "study" / LOCK).exists()
    assert [path.name for path in tmp_path.rglob("*") if path.is_file()] == ["study.json"] and inner.is_dir()


@pytest.mark.linux
def test_a_child_ends_with_the_process_that_started_it(tmp_path):
    code = (
        "import subprocess, sys, time; from warpcrete.core.run.processes import killed_with_parent; "
        "subprocess.Popen(killed_with_parent([sys.executable, '-c', 'import time; time.sleep(60)'])); "
        "print('begun', flush=True); "
        "time.sleep(60)"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, encoding="utf-8")
    assert process.stdout.readline() == "begun\n"
    children = psutil.Process(process.pid).children()
    assert len(children) == 1
    process.kill()
    process.communicate()
    assert wait_until(lambda: not any(map(alive, children)), 10)
    assert killed_with_parent(["x"])[-1] == "x"


def test_a_run_that_was_killed_before_its_first_checkpoint_is_begun_again(tmp_path, monkeypatch):
    """By the same command or by --resume; another scene is refused."""
    words = ["run", "channel", *(f"--{name}={value}" for name, value in FLOW.items()), "--device=cpu", "--threads=1",
             "--no-rerun", "--no-usd", "--quiet", f"--out={tmp_path / 'run'}"]  # fmt: skip
    folder = tmp_path / "run"

    def killed(*given):
        raise Killed

    def kill_early():
        with monkeypatch.context() as patch:
            patch.setattr("warpcrete.mps.simulation.FluidSimulation.prepare", killed)
            patch.setattr(TableRecorder, "abandon", TableRecorder.close)
            with pytest.raises(Killed):
                CliRunner().invoke(cli, words)
        assert [path.name for path in folder.iterdir()] == ["scene.json"]

    for again in (words, ["run", "--resume", str(folder), "--quiet"]):
        kill_early()
        other = CliRunner().invoke(cli, [*words, "--flow=0.002"])
        assert "exists already and contains another run (its parameters differs)" in str(other.exception)
        done = CliRunner().invoke(cli, again)
        assert done.exit_code == 3 and is_finished(folder), done.output  # a check fails: it is too short
        assert "exists already" in str(CliRunner().invoke(cli, words).exception)
        shutil.rmtree(folder)


@pytest.mark.parametrize("batched", [False, True])
def test_settling_that_was_cut_goes_on(tmp_path, batched):
    scene = scenes.pipe(**TINY | dict(settle=0.1, travel=0.004, ramp=0.002))
    path = tmp_path / "run" / "checkpoint.npz"

    def created(progress=None, **more):
        recorders = [TableRecorder(tmp_path / "run", going_on=True)]
        return Simulation(scene, device="cpu", threads=1, progress=progress or False, recorders=recorders,
                          checkpoint_path=path, checkpoint_every=0.0)  # fmt: skip

    uncut = Simulation(scene, device="cpu", threads=1).run()
    told = []

    def cut(phase, fraction, figures):
        told.append((phase, fraction))
        if phase == "settling" and fraction > 0.05:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        created(cut).run()
    assert sorted(file.name for file in (tmp_path / "run").iterdir()) == [
        "checkpoint.npz",
        "result.json",
        "scene.json",
    ]
    told.clear()
    again = created(lambda phase, fraction, figures: told.append((phase, fraction)))
    if batched:
        (run,) = run_batch([again], [path])
    else:
        again.begin(path)
        run = again.run()
    assert run.finished and run.result["state_hash"] == uncut.result["state_hash"]
    assert "packing" not in dict(told) and told[0][0] == "settling" and told[0][1] > 0.05
    assert run.result["packing"] == uncut.result["packing"] and not path.exists()


def test_sigterm_is_heard_as_ctrl_c_where_the_program_says_so():
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        simulation = flow()
        with StopAtSample([simulation]):
            signal.raise_signal(signal.SIGTERM)
            assert simulation.stop_requested
        done = []
        with pytest.raises(KeyboardInterrupt), defer_interrupts():
            signal.raise_signal(signal.SIGTERM)
            done.append(True)
        assert done
    finally:
        signal.signal(signal.SIGTERM, before)


def test_checks_finish_before_the_table_that_writes_them(tmp_path):
    folder = tmp_path / "run"
    simulation = flow(folder, CheckRecorder(lambda run: {"any": (True, "found")}))
    simulation.run()
    assert json.loads((folder / "result.json").read_text(encoding="utf-8"))["checks"]["any"]["found"] == "found"


def test_a_pipeline_that_cannot_be_computed_costs_only_itself(tmp_path, monkeypatch):
    def fails(*arguments):
        raise KeyError("concrete_length")

    monkeypatch.setattr("warpcrete.cli.run.pipeline_estimate", fails)
    simulation = flow(tmp_path / "run", PipelineRecorder(10.0, None, {}))
    with pytest.warns(
        UserWarning,
        match=r"the run is complete, but the pipeline's pressure is not known: KeyError\('concrete_length'\)$",
    ):
        run = simulation.run()
    result = json.loads((tmp_path / "run" / "result.json").read_text(encoding="utf-8"))
    assert run.finished and result["finished"] and "pipeline_estimate" not in result
    assert not (tmp_path / "run" / "checkpoint.npz").exists()


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
