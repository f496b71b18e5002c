"""Runs that are killed or interrupted, and how they go on."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys

import psutil
import pytest
from click.testing import CliRunner
from pumping import TINY, alive, wait_until
from run_folders import FLOW, Killed, flow, same

from warpcrete import Simulation, scenes
from warpcrete.cli.main import cli
from warpcrete.core.device.interrupts import StopAtSample, defer_interrupts
from warpcrete.core.run import checkpoint
from warpcrete.core.run.files import LOCK
from warpcrete.core.run.folders import locked_folder
from warpcrete.core.run.processes import killed_with_parent
from warpcrete.core.run.recorder import Recorder
from warpcrete.dem.batch_run import run_batch
from warpcrete.record.loading import is_finished
from warpcrete.record.rerun import RerunRecorder
from warpcrete.record.run_folder import TableRecorder


def test_a_kill_while_a_recording_is_joined_is_made_good(tmp_path, undisturbed_folder, monkeypatch):
    """The run recovers from a kill before the joined file is in place, and from one after some parts are deleted."""
    folder = tmp_path / "run"

    def cut(parts, path):
        path.with_name(".warpcrete-partial-run.rrd").write_bytes(b"half")
        raise Killed

    with monkeypatch.context() as patch:
        patch.setattr("warpcrete.record.rerun_stream.join", cut)
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
    assert same(folder, undisturbed_folder)


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
    """The same command and --resume both go on with the run; another scene is refused."""
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
        assert re.search(
            r"exists already and contains another run \(its flow is .* instead of 0\.002\)", str(other.exception)
        )
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


class RaiseTerminate(Recorder):
    """Send SIGTERM to this process at the third row."""

    def sample(self, simulation, row):
        if len(simulation.rows) == 3:
            signal.raise_signal(signal.SIGTERM)


def test_sigterm_in_a_python_script_interrupts_the_run_and_says_so(tmp_path, capsys, undisturbed_folder):
    folder, before = tmp_path / "run", signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        settings = dict(device="cpu", threads=1, out=folder)
        run = Simulation(scenes.channel(**FLOW), **settings, recorders=[RaiseTerminate()]).run()
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    finally:
        signal.signal(signal.SIGTERM, before)
    assert run.interrupted and not run.finished and not (folder / LOCK).exists()
    (line,) = (line for line in capsys.readouterr().err.splitlines() if line.startswith("interrupted"))
    time = run["simulated_time"]
    assert line == (
        f"interrupted at t = {time:.3f} s; run() returns the results so far, which are saved in '{folder}'; run the "
        "same lines again to go on from the checkpoint at t = 0.000 s"
    )
    again = Simulation(scenes.channel(**FLOW), **settings).run()
    uncut = json.loads((undisturbed_folder / "result.json").read_text(encoding="utf-8"))
    assert again.finished and again.result["state_hash"] == uncut["state_hash"]


class TerminateAtTheEnd(Recorder):
    """Send SIGTERM to this process while the results are written."""

    def finish(self, simulation, run):
        os.kill(os.getpid(), signal.SIGTERM)


@pytest.mark.posix
def test_sigterm_while_results_are_written_ends_the_program_after_them(tmp_path, monkeypatch):
    folder, before, raised = tmp_path / "run", signal.signal(signal.SIGTERM, signal.SIG_DFL), []
    monkeypatch.setattr(signal, "raise_signal", raised.append)
    try:
        run = Simulation(
            scenes.channel(**FLOW), device="cpu", threads=1, out=folder, recorders=[TerminateAtTheEnd()]
        ).run()
    finally:
        signal.signal(signal.SIGTERM, before)
    assert run.finished and raised == [signal.SIGTERM]
    assert json.loads((folder / "result.json").read_text(encoding="utf-8"))["state_hash"] == run.result["state_hash"]


def test_a_handler_of_the_program_for_sigterm_stays_in_force(capsys):
    heard = []

    def own(number, frame):
        heard.append(number)

    before = signal.signal(signal.SIGTERM, own)
    try:
        run = flow(None, RaiseTerminate()).run()
        assert signal.getsignal(signal.SIGTERM) is own
    finally:
        signal.signal(signal.SIGTERM, before)
    assert heard == [signal.SIGTERM] and run.finished and "interrupted" not in capsys.readouterr().err
