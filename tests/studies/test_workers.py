"""Processes that run cases: from any kind of script, and each of them may die."""

import json
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import pytest
from command_ends import assert_ended
from pumping import command, wait_until

from warpcrete.core.errors import ConvergenceError, SceneError, WarpcreteError
from warpcrete.studies import running, workers
from warpcrete.studies import study as studies
from warpcrete.studies.calibration import calibrate
from warpcrete.studies.cases import MAX_CASES, Case, cases_of
from warpcrete.studies.study_result import Study
from warpcrete.studies.workers import STOP, WorkerDied, WorkerPool

HERE = "jobs"


@pytest.mark.posix
def test_workers_answer_fail_and_die_without_harm_to_one_another():
    with WorkerPool() as crew:
        assert crew.run((HERE, "add"), (2, 3)) == (5, False)
        assert "no pickle holds" not in str(crew.run((HERE, "unreadable"), ()).args)
        error = crew.run((HERE, "diverge"), ())
        assert isinstance(error, ConvergenceError) and error.iterations == 7
        assert isinstance(crew.run((HERE, "nothing"), ()), AttributeError)
        with pytest.raises(WorkerDied, match=r"^its process ended with exit code 7$"):
            crew.run((HERE, "leave"), (7,))
        with pytest.raises(WorkerDied, match="was killed by SIGKILL; the memory may be full"):
            crew.run((HERE, "kill"), (signal.SIGKILL,))
        with pytest.raises(WorkerDied, match="was killed by SIGSEGV"):
            crew.run((HERE, "kill"), (signal.SIGSEGV,))
        with ThreadPoolExecutor(2) as pool:
            waiting = pool.submit(crew.run, (HERE, "wait_for_stop"), ())
            assert crew.run((HERE, "add"), (1, 1)) == (2, False)
            crew.stop()
            assert waiting.result(timeout=30) == "stopped"
        assert crew.run((HERE, "add"), (1, 1)) == (2, True)
        processes = [worker._process for worker in crew._workers]
    assert all(process.poll() is not None for process in processes)


def test_a_worker_that_begins_after_the_others_were_stopped_is_told_before_its_job(monkeypatch):
    messages = []
    worker = SimpleNamespace(
        send=messages.append, wait_until_ready=lambda: None, receive=lambda: ("done", False), end=lambda: None
    )
    monkeypatch.setattr(workers, "_Worker", lambda: worker)
    with WorkerPool() as crew:
        crew.stop()
        assert crew.run("a job") == "done" and messages == [STOP, ("a job",)]


@pytest.mark.posix
def test_sigterm_in_a_worker_stops_all_workers():
    """A job that hears of it ends with its own result; a worker that is killed while it starts has none."""
    with ThreadPoolExecutor(2) as pool, WorkerPool() as crew:
        assert crew.run((HERE, "add"), (1, 1)) == (2, False)
        (idle,) = crew._workers
        waiting = pool.submit(crew.run, (HERE, "wait_for_stop"), ())
        assert wait_until(lambda: not crew._idle, 30)
        other = pool.submit(crew.run, (HERE, "wait_for_stop"), ())
        assert wait_until(lambda: len(crew._workers) == 2 and crew._workers[1]._ready, 30)
        assert not crew.stopping
        idle._process.terminate()
        assert waiting.result(timeout=30) == other.result(timeout=30) == "stopped"
        assert crew.terminated and crew.stopping and idle._process.wait(timeout=30) == 0
    with ThreadPoolExecutor(1) as pool, WorkerPool() as crew:
        begun = pool.submit(crew.run, (HERE, "add"), (1, 1))
        while not (crew._workers or begun.done()):  # Its imports take longer than the pauses of `wait_until`.
            time.sleep(1e-3)
        crew._workers[0]._process.terminate()
        assert begun.result(timeout=30) is None and crew.terminated
    with ThreadPoolExecutor(1) as pool, WorkerPool() as crew:
        deaf = pool.submit(crew.run, (HERE, "sleep"), ())
        assert wait_until(lambda: crew._workers and crew._workers[0]._ready, 30)
        # The first SIGTERM asks a worker to end, the second one ends it.
        assert wait_until(lambda: deaf.done() or crew._workers[0]._process.terminate(), 30)
        assert deaf.result() is None and crew.terminated and crew._workers[0]._process.wait() == -signal.SIGTERM


@pytest.mark.posix
def test_a_study_ends_after_sigterm_in_a_worker_and_continues(tmp_path):
    """The signal arrives during the first case, as from a batch system that ends all processes of a job."""
    before = """
import threading, time, psutil, pathlib
def end():
    while not any(path.read_text().count("\\n") > 3 for path in pathlib.Path(sys.argv[1]).glob("001-*/series.csv")):
        time.sleep(0.01)
    print(len([child.terminate() for child in psutil.Process().children()]), "processes", flush=True)
threading.Thread(target=end, daemon=True).start()
"""
    out = tmp_path / "study"
    done = script(tmp_path, "file", out, "processes=1", before.strip(), duration=0.4)
    assert "interrupted, because a worker process received SIGTERM\n" in done.stderr, done.stdout + done.stderr
    assert "1 processes" in done.stdout and "0 of 2 cases done" in done.stdout and "Traceback" not in done.stderr
    assert (out / "001-flow=0.001" / "checkpoint.npz").is_file() and not (out / "002-flow=0.002").exists()
    again = command("study", "--resume", out, "--quiet")
    assert_ended(again, "slip velocity")
    assert "2 of 2 cases done;" in again.stdout


def test_a_worker_that_cannot_start_is_no_fault_of_a_case(monkeypatch):
    monkeypatch.setattr(sys, "path", ["/nowhere"])
    with (
        WorkerPool() as crew,
        pytest.raises(WarpcreteError, match="no worker process can be started: its process ended"),
    ):
        crew.run((HERE, "add"), (1, 1))


def test_a_job_that_no_pickle_holds_costs_itself_alone():
    with WorkerPool() as crew:
        with pytest.raises(Exception, match="pickle"):
            crew.run((HERE, "add"), (lambda: 1, 1))
        assert crew.run((HERE, "add"), (1, 1)) == (2, False)


@pytest.mark.posix
def test_a_case_whose_process_dies_is_failed_and_the_others_go_on(tmp_path, monkeypatch):
    outcomes = {"1": WorkerDied("its process was killed by SIGKILL"), "2": {"finished": True, "checks": {}},
                "3": TypeError("no pickle holds it")}  # fmt: skip
    monkeypatch.setattr(WorkerPool, "run", lambda self, function, arguments: _come_to(outcomes[arguments[-1].name]))
    found = {}
    cases = [Case(name, {}, {}) for name in outcomes]
    running.run_in_processes({}, studies, tmp_path, cases, 1, lambda case, outcome: found.update({case.name: outcome}))
    assert found == outcomes
    study = Study(tmp_path, "pipe", cases[:2], results={"2": outcomes["2"]}, failures={"1": str(outcomes["1"])},
                  not_at_fault={"1"})  # fmt: skip
    assert study.lost == ["1"] and study.progress == "1 of 2 cases done, 1 failed" and study.progress in repr(study)


def _come_to(outcome):
    if isinstance(outcome, Exception):
        raise outcome
    return outcome


def test_a_study_has_no_more_cases_than_anybody_reads():
    for given in (dict(varied={"velocity": range(20)}, repeat=MAX_CASES),
                  dict(varied={key: range(100) for key in "abcdef"})):  # fmt: skip
        with pytest.raises(SceneError, match=r"makes [\d,]+ cases, but a study has at most 10,000"):
            cases_of({}, **given)
    assert len(cases_of({}, {"velocity": [0.1]}, repeat=100)) == 100
    assert len(cases_of({}, {key: range(100) for key in "ab"}, one_at_a_time=True)) == 200


SCRIPT = """\
import os, sys
import warpcrete
{before}
study = warpcrete.study(warpcrete.scenes.channel, vary={{"flow": [1e-3, 2e-3]}}, spacing=0.02, duration={duration},
                        sample_interval=4e-3, device="cpu", out=sys.argv[1], {settings})
print(study)
"""


def script(tmp_path, how, out, settings, before="", duration=0.012):
    text = SCRIPT.format(settings=settings, before=before, duration=duration)
    file = tmp_path / "script.py"
    file.write_text(text, encoding="utf-8")
    return subprocess.run(
        [sys.executable, "-" if how == "stdin" else str(file), str(out)], input=text if how == "stdin" else None,
        capture_output=True, encoding="utf-8", timeout=300, cwd=tmp_path,
    )  # fmt: skip


@pytest.mark.thorough
@pytest.mark.parametrize("how, settings", [
    ("file", "processes=2"), ("stdin", "processes=2"), ("file", "scheduler='local', workers=1"),
])  # fmt: skip
def test_a_study_runs_from_a_script_without_a_main_guard(tmp_path, how, settings):
    done = script(tmp_path, how, tmp_path / "study", settings, before="print('once')")
    assert done.returncode == 0, done.stderr
    assert done.stdout == f"once\n<Study of scene 'channel': 2 of 2 cases done, folder '{tmp_path / 'study'}'>\n"
    record = json.loads((tmp_path / "study" / "study.json").read_text(encoding="utf-8"))
    assert all((tmp_path / "study" / case["name"] / "result.json").is_file() for case in record["cases"])


@pytest.mark.thorough
def test_a_killed_process_costs_its_case_and_the_study_goes_on_with_it(tmp_path):
    before = """
import threading, time, psutil, pathlib
def kill():
    while not list(pathlib.Path(sys.argv[1]).glob("001-*/scene.json")):
        time.sleep(0.01)
    [child.kill() for child in psutil.Process().children()]
threading.Thread(target=kill, daemon=True).start()
"""
    out = tmp_path / "study"
    done = script(tmp_path, "file", out, "processes=1, checkpoint_every=0.0", before.strip())
    assert "1 of 2 cases done, 1 failed" in done.stdout, done.stdout + done.stderr
    again = command("study", "--resume", out, "--quiet")
    assert_ended(again, "slip velocity")
    assert "2 of 2 cases done;" in again.stdout


def test_python_dash_m_is_the_command():
    done = subprocess.run([sys.executable, "-m", "warpcrete", "--help"], capture_output=True, encoding="utf-8")
    assert done.returncode == 0 and done.stdout.startswith("Usage: warpcrete [OPTIONS]")
    done = subprocess.run([sys.executable, "-m", "warpcrete", "run", "chute"], capture_output=True, encoding="utf-8")
    assert done.returncode == 2 and done.stderr.startswith("error: scene = 'chute'")


@pytest.mark.posix
def test_a_lost_run_ends_a_calibration_instead_of_counting_as_a_bad_point(tmp_path, monkeypatch):
    cases = [Case("001", {}, {}), Case("002", {}, {})]
    study = Study(
        tmp_path,
        "slump",
        cases,
        results={"001": {}},
        failures={"002": "its process was killed by SIGKILL"},
        not_at_fault={"002"},
    )
    monkeypatch.setattr(calibrate, "_run_group", lambda *rest: study)
    found = SimpleNamespace(folder=tmp_path, task=SimpleNamespace(groups=[[None]]), trials=[])
    lost = "trial 002: its process was killed by SIGKILL; 1 of 2 runs were lost because a process died or the disk was"
    with pytest.raises(WarpcreteError, match=lost):
        calibrate.run_round(found, {}, 0, [], {}, lambda *rest: None, (0.0, 1.0))
    study.not_at_fault.clear()  # as of a case that fails by itself, whatever with
    assert study.lost == []
