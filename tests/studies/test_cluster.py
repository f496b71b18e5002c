"""Studies on workers of Dask: same folders and bits, lost workers, interruptions, jobs of SLURM."""

import importlib
import os
import signal
import subprocess
import sys
from dataclasses import replace

import dask.config
import psutil
import pytest
from dask.distributed import Scheduler, SpecCluster
from pumping import INTERRUPTIBLE, wait_until
from test_study import BASE

from warpcrete import Simulation, scenes
from warpcrete.core.errors import SceneError, WarpcreteError
from warpcrete.dem.simulation import ElementSimulation
from warpcrete.studies import running
from warpcrete.studies.cluster import LOCAL_SCHEDULER_OPTIONS, check_scheduler, local_cluster, slurm_cluster
from warpcrete.studies.running import previous_outcome, run_cases, run_on_gpu
from warpcrete.studies.study import cases_of, resume_study, run_study

pytestmark = pytest.mark.thorough

pipe_module = importlib.import_module("warpcrete.scenes.pipe")  # the package gives the scene function that name
LONG = BASE | dict(travel=0.3, sample_interval=0.005)


def hashes(study):
    return {name: result["state_hash"] for name, result in study.results.items()}


def begun(out, **changes):
    """A study of two cases on two workers, as a command in a process group of its own."""
    options = [f"--{name.replace('_', '-')}={value}" for name, value in (LONG | changes).items()]
    return subprocess.Popen(
        [sys.executable, "-c", INTERRUPTIBLE, "study", "pipe", "--velocity", "0.3", "0.31",
         *options, "--out", str(out), "--device", "cpu", "--scheduler", "local", "--workers", "2",
         "--checkpoint-every", "0.2", "--quiet"],
        start_new_session=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, encoding="utf-8",
    )  # fmt: skip


def when_running(process, out):
    """Wait until every case has left a checkpoint."""
    assert wait_until(lambda: process.poll() is not None or len(list(out.glob("*/checkpoint.npz"))) == 2, 120)
    assert process.poll() is None, process.communicate()[0]


def test_workers_make_the_same_folders_and_bits(device, tmp_path):
    varied = {"velocity": [0.3, 0.6], "overlap_limit": [0.0, 1e-6]}
    alone = run_study("pipe", pipe_module, varied, base=BASE, out=tmp_path / "alone", device=device, processes=1)
    workers = None if device.startswith("cuda") else 2
    told = []
    study = run_study(
        "pipe", pipe_module, varied, base=BASE, out=tmp_path / "dask", device=device, scheduler="local",
        workers=workers, progress=lambda phase, fraction, figures: told.append(fraction),
    )  # fmt: skip
    assert study.finished and len(study.results) == 2 and len(study.failures) == 2 and told[-1] == 1.0
    assert hashes(study) == hashes(alone) and study.failures == alone.failures
    files = [sorted(p.relative_to(s.folder) for p in s.folder.rglob("*")) for s in (study, alone)]
    assert files[0] == files[1]
    # It goes on elsewhere, with what is missing alone.
    name = next(iter(study.results))
    previous_outcome = {n: (study.folder / n / "result.json").stat().st_mtime_ns for n in study.results if n != name}
    (study.folder / name / "result.json").unlink()
    again = resume_study(study.folder, pipe_module, scheduler="local", workers=1)
    assert hashes(again) == hashes(alone) and again.failures == alone.failures
    assert all((study.folder / n / "result.json").stat().st_mtime_ns == t for n, t in previous_outcome.items())


def test_a_local_cluster_listens_to_this_machine_alone():
    """Scheduler, workers and their pages; and all of them end with the cluster."""
    with local_cluster(1, "cpu"):
        me = psutil.Process()
        every = [me, *me.children(recursive=True)]
        listening = {
            c.laddr.ip for each in every for c in each.net_connections("inet") if c.status == psutil.CONN_LISTEN
        }
    assert listening == {"127.0.0.1"}


def test_a_lost_worker_loses_no_case(tmp_path):
    out = tmp_path / "study"
    process = begun(out)
    when_running(process, out)
    workers = [p for p in psutil.Process(process.pid).children() if "spawn_main" in " ".join(p.cmdline())]
    assert len(workers) == 2
    workers[0].kill()
    output = process.communicate(timeout=240)[0]
    assert process.returncode == 0, output
    found = resume_study(out, pipe_module)
    alone = {case.name: Simulation(scenes.pipe(**case.parameters), device="cpu", threads=1) for case in found.cases}
    assert len(alone) == 2
    assert hashes(found) == {name: simulation.run().result["state_hash"] for name, simulation in alone.items()}


def test_a_case_that_was_cut_goes_on_from_its_checkpoint(tmp_path, monkeypatch):
    """A worker that takes over the part of a lost worker finds such a case: unfinished, with a checkpoint."""
    case = cases_of(LONG, {}, seeded=True)[0]
    record = {"device": "cpu", "precision": "float32", "command": {"frames": 25.0, "checkpoint_every": 0.01}}
    path = tmp_path / case.name / "checkpoint.npz"
    cut = run_cases(record, pipe_module, tmp_path, [case], path.is_file)[0]
    assert not cut["finished"] and previous_outcome(path.parent) is None and path.is_file()
    read, restored = ElementSimulation.read_checkpoint, []
    monkeypatch.setattr(ElementSimulation, "read_checkpoint", lambda self, p: restored.append(p) or read(self, p))
    done = run_cases(record, pipe_module, tmp_path, [case], lambda: False)[0]
    assert restored == [path] and previous_outcome(path.parent)["state_hash"] == done["state_hash"]
    alone = Simulation(scenes.pipe(**case.parameters), device="cpu", threads=1).run()
    assert done["state_hash"] == alone.result["state_hash"]


def part_of_a_worker(record, folder, cases):
    return run_cases(record, pipe_module, folder, cases, lambda: False)


def batch_of_a_gpu(record, folder, cases):
    found = {}

    def book(case, outcome):
        found[case.name] = outcome

    run_on_gpu(record, pipe_module, folder, cases, book, lambda *_: None)
    return [getattr(found[case.name], "result", found[case.name]) for case in cases if case.name in found]


@pytest.mark.parametrize("run", [part_of_a_worker, batch_of_a_gpu])
def test_one_case_of_a_part_that_cannot_begin_leaves_the_others(run, tmp_path):
    wrong, sound = cases_of(BASE, {"velocity": [0.3, 0.6]})
    record = {"device": "cpu", "precision": "float32", "command": {"frames": 25.0, "checkpoint_every": 0.0}}
    wrong = replace(wrong, parameters=wrong.parameters | {"velocity": -1.0})
    found = run(record, tmp_path, [wrong, sound])
    assert isinstance(found[0], SceneError) and found[1]["finished"]
    # The traceback of an outcome would keep the arrays of its run, and Dask would free them in another thread.
    assert run is batch_of_a_gpu or found[0].__traceback__ is None
    assert isinstance(run(record, tmp_path, [wrong])[0], SceneError)


def test_a_gpu_runs_and_stores_the_cases_group_by_group(tmp_path, monkeypatch):
    """Run five cases in groups of two: two are stored before the next begin, and Ctrl-C there starts no third group."""
    cases = cases_of(BASE, {"velocity": [0.3, 0.45, 0.6, 0.75, 0.9]})
    record = {"device": "cpu", "precision": "float32", "figure": False,
              "command": {"frames": 25.0, "checkpoint_every": 0.0}}  # fmt: skip
    monkeypatch.setattr(running, "CASES_TOGETHER", 2)
    together, run = [], running._outcomes

    def noting(by_name, progress):
        together.append(list(by_name))
        if len(together) == 2:
            return dict.fromkeys(by_name, KeyboardInterrupt())
        return run(by_name, progress)

    monkeypatch.setattr(running, "_outcomes", noting)
    found = batch_of_a_gpu(record, tmp_path, cases)
    names = [case.name for case in cases]
    assert together == [names[:2], names[2:4]]
    assert [isinstance(outcome, KeyboardInterrupt) for outcome in found] == [False, False, True, True]
    alone = Simulation(scenes.pipe(**cases[1].parameters), device="cpu", threads=1).run()
    assert found[1]["state_hash"] == alone.result["state_hash"]
    assert (tmp_path / names[0] / "result.json").is_file() and not list(tmp_path.rglob("*.png"))


@pytest.mark.posix
def test_an_interrupted_study_stops_at_the_next_samples(tmp_path):
    out = tmp_path / "study"
    process = begun(out, travel=3.0)  # for longer than anybody waits
    when_running(process, out)
    os.killpg(process.pid, signal.SIGINT)
    output = process.communicate(timeout=60)[0]
    assert process.returncode == 130 and "continue with: warpcrete study --resume" in output, output
    assert len(list(out.glob("*/checkpoint.npz"))) == 2 and "Traceback" not in output
    assert (out / "study.md").is_file()


def test_a_job_of_slurm_is_what_dask_is_told(tmp_path):
    with slurm_cluster("cuda") as cluster:
        script = cluster.job_script()
    assert "#SBATCH --gres=gpu:1" in script and "#SBATCH --cpus-per-task=1" in script
    assert f"{sys.executable} -m distributed.cli.dask_worker" in script and "--nthreads 1" in script
    told = {"cores": 8, "memory": "16 GB", "queue": "night", "walltime": "02:00:00",
            "job-extra-directives": ["--account=concrete"]}  # fmt: skip
    with dask.config.set({"jobqueue.slurm": dask.config.get("jobqueue.slurm") | told}), slurm_cluster(None) as cluster:
        script = cluster.job_script()
    for line in ("-p night", "-t 02:00:00", "--account=concrete", "--cpus-per-task=8"):
        assert f"#SBATCH {line}" in script
    assert "--nworkers 8" in script and "--nthreads 1" in script and "gres" not in script
    told["job-extra-directives"] = ["--partition=gpu"]
    with (
        dask.config.set({"jobqueue.slurm": dask.config.get("jobqueue.slurm") | told}),
        slurm_cluster("cuda:0") as cluster,
    ):
        script = cluster.job_script()
    assert "#SBATCH --gres=gpu:1" in script and "#SBATCH --cpus-per-task=8" in script
    assert "--nworkers" not in script and "--nthreads 1" in script  # one worker, whatever cores a job has


@pytest.mark.parametrize(
    ("given", "text"),
    [(("moon", None), "scheduler = 'moon': must be one of local, slurm, or an address"), ((None, 2), "workers = 2"),
     (("local", 0), "workers = 0"), (("local", 2, 2), "processes = 2"),
     (("tcp://node1:8786", 2), "workers = 2: cannot be set for the running scheduler 'tcp://node1:8786'")],
)  # fmt: skip
def test_what_it_refuses(given, text):
    with pytest.raises(SceneError, match=text):
        check_scheduler(*given)


def test_what_cannot_be_reached_or_is_not_there_leaves_nothing(tmp_path, monkeypatch):
    out = tmp_path / "study"
    monkeypatch.setattr("warpcrete.studies.cluster.CONNECT_TIMEOUT", 0.5)
    with pytest.raises(WarpcreteError, match=r"scheduler = 'tcp://127\.0\.0\.1:9': does not answer"):
        run_study("pipe", pipe_module, {"velocity": [0.3]}, base=BASE, out=out, scheduler="tcp://127.0.0.1:9")
    with (
        SpecCluster(workers={}, scheduler={"cls": Scheduler, "options": LOCAL_SCHEDULER_OPTIONS}) as empty,
        pytest.raises(WarpcreteError, match="has no workers"),
    ):
        run_study("pipe", pipe_module, {"velocity": [0.3]}, base=BASE, out=out, scheduler=empty.scheduler_address)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(WarpcreteError, match="scheduler = 'slurm': the command sbatch is missing"):
        run_study("pipe", pipe_module, {"velocity": [0.3]}, base=BASE, out=out, scheduler="slurm")
    monkeypatch.setitem(sys.modules, "dask_jobqueue", None)
    with pytest.raises(
        WarpcreteError, match=r"needs the package dask_jobqueue; run pip install 'warpcrete\[cluster\]'"
    ):
        run_study("pipe", pipe_module, {"velocity": [0.3]}, base=BASE, out=out, scheduler="slurm")
    assert not out.exists()
