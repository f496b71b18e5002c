"""Jobs on the workers of a cluster that is made up: their order, results, losses and interruptions.

`test_cluster.py` uses real workers of Dask.
"""

import os
from types import SimpleNamespace

import dask.distributed
import pytest

from warpcrete.core.errors import SceneError, WarpcreteError
from warpcrete.studies import cluster
from warpcrete.studies.cases import Case
from warpcrete.studies.cluster import Cluster, WorkerLost, check_scheduler, local_cluster, open_cluster, slurm_cluster


class Future:
    def __init__(self, key, call, arguments):
        self.key, self.call, self.arguments, self.cancelled = key, call, arguments, False

    def result(self):
        return self.call(*self.arguments)

    def cancel(self):
        self.cancelled = True


class Client:
    """Client of workers, each of which does one job at a time, in the order of submission."""

    def __init__(self, workers):
        self.workers, self.futures, self.models = workers, [], {"a": "one", "b": "one"}

    def scheduler_info(self, n_workers):
        assert n_workers == -1
        return {"workers": dict.fromkeys(range(self.workers))}

    def submit(self, function, *arguments, pure):
        assert not pure
        self.futures.append(Future(len(self.futures), function, arguments))
        return self.futures[-1]

    def run(self, function, device):
        self.asked = function.__name__, device
        return self.models

    def processing(self):
        return {"a": (0,), "b": (1,)}

    def as_current(self):
        return self

    def __enter__(self):
        return self

    def __exit__(self, *unused):
        self.closed = True

    def wait_for_workers(self, count, timeout):
        self.waited = count, timeout


@pytest.fixture
def jobs(monkeypatch):
    """Function that runs jobs on so many workers; returns what was stored, the futures, and whether jobs should end."""
    stops, waits = [], []
    monkeypatch.setattr(dask.distributed, "Event", lambda name, client: SimpleNamespace(set=lambda: stops.append(name)))
    monkeypatch.setattr(cluster, "_run_job", lambda function, *rest: function(*rest[:-1], lambda: bool(stops)))

    def wait(futures, timeout, return_when):
        assert (timeout, return_when) == (cluster.STOP_POLL_INTERVAL, "FIRST_COMPLETED")
        waits.append(len(futures))
        return SimpleNamespace(done=futures[:1])

    monkeypatch.setattr(dask.distributed, "wait", wait)

    def run(function, given, workers=2, gap=None, **settings):
        client, stored = Client(workers), []
        where = {"device": "cuda:3", "threads": 1}, SimpleNamespace(__name__="a.module"), SimpleNamespace(
            resolve=lambda: "/folder"
        )  # fmt: skip
        gap = gap or SimpleNamespace(requested=False)
        try:
            Cluster(client, "local", workers).each(
                function, where, iter(given), lambda tag, found: stored.append((tag, found)), gap, **settings
            )
        finally:
            run.stored, run.futures, run.stops, run.waits = stored, client.futures, stops, waits
        return stored

    return run


def test_jobs_get_the_study_and_their_results_come_back(jobs):
    seen = []

    def function(record, module, folder, job, asked):
        seen.append((record, module, folder, job, asked()))
        if job == 2:
            raise SceneError("x = 2: is wrong")
        if job == 3:
            raise ValueError("broken")
        return 10 * job

    stored = jobs(function, [(f"job {k}", k) for k in range(1, 5)])
    assert [tag for tag, _ in stored] == ["job 1", "job 2", "job 3", "job 4"]
    assert stored[0][1] == 10 and isinstance(stored[1][1], SceneError) and stored[3][1] == 40
    assert isinstance(stored[2][1], WorkerLost) and str(stored[2][1]) == "its worker failed: ValueError: broken"
    assert seen[0] == ({"device": "cuda", "threads": 1}, "a.module", "/folder", 1, False)
    assert jobs.waits == [4, 3, 2, 1] and not jobs.stops


def test_lazy_jobs_are_taken_when_a_worker_is_free(jobs):
    taken = []

    def given():
        for k in range(5):
            taken.append((k, len(jobs.seen)))
            yield k, k

    jobs.seen = []
    jobs(lambda *rest: jobs.seen.append(rest[3]), given(), lazily=True)
    assert taken == [(0, 0), (1, 0), (2, 1), (3, 2), (4, 3)] and max(jobs.waits) == 2


def test_an_interruption_ends_running_jobs_and_cancels_the_others(jobs):
    gap = SimpleNamespace(requested=False)

    def function(record, module, folder, job, asked):
        gap.requested = True
        return asked()

    assert jobs(function, [(k, k) for k in range(4)], gap=gap) == [(0, False), (1, True)]
    assert [future.cancelled for future in jobs.futures] == [False, False, True, True] and len(jobs.stops) == 1


def test_an_error_of_a_result_ends_the_other_jobs(jobs, monkeypatch):
    def store(tag, found):
        raise WarpcreteError("disk is full")

    client = Client(2)
    where = {"device": "cpu"}, SimpleNamespace(__name__="m"), SimpleNamespace(resolve=lambda: "/f")
    with pytest.raises(WarpcreteError, match="disk is full"):
        Cluster(client, "local", 2).each(
            lambda *rest: 1, where, iter([(1, 1)]), store, SimpleNamespace(requested=False)
        )
    jobs(lambda *rest: 1, [])
    assert len(jobs.stops) == 1 and str(os.getpid()) in jobs.stops[0]

    def lost(*rest, **settings):
        raise OSError("gone")

    monkeypatch.setattr(dask.distributed, "wait", lost)
    with pytest.raises(WarpcreteError, match=r"scheduler = 'local': the connection was lost \(OSError\)"):
        jobs(lambda *rest: 1, [(1, 1)])


def test_waiting_goes_on_until_a_job_has_ended(jobs, monkeypatch):
    wait, times = dask.distributed.wait, []

    def patient(futures, **settings):
        times.append(1)
        if len(times) < 3:
            raise dask.distributed.TimeoutError
        return wait(futures, **settings)

    monkeypatch.setattr(dask.distributed, "wait", patient)
    assert jobs(lambda *rest: "found", [(1, 1)]) == [(1, "found")] and len(times) == 3


@pytest.mark.parametrize(
    ("device", "workers", "parts"), [("cpu", None, [[0], [1], [2]]), ("cuda:0", 2, [[0, 2], [1]]),
                                     ("cuda", None, [[0], [1], [2]])],
)  # fmt: skip
def test_cases_of_a_study_are_shared_out(device, workers, parts, monkeypatch):
    """On GPUs each worker gets a batch; the cases of a batch whose worker is lost all have this outcome."""
    given, stored = [], {}

    def each(self, function, where, jobs, store, gap, *, lazily=False):
        assert function is cluster._run_part and where == ({"device": device}, "module", "folder") and not lazily
        for number, (tag, job) in enumerate(jobs):
            assert tag is job
            given.append([case.name for case in job])
            store(tag, WorkerLost("gone") if number == 0 else [f"result {case.name}" for case in job])

    monkeypatch.setattr(Cluster, "each", each)
    cases = [Case(k, {}, {}) for k in range(3)]
    Cluster(Client(3), "local", workers).run(
        {"device": device}, "module", "folder", cases, lambda case, outcome: stored.update({case.name: outcome})
    )
    assert given == parts and set(stored) == {0, 1, 2}
    for name, outcome in stored.items():
        assert isinstance(outcome, WorkerLost) if name in parts[0] else outcome == f"result {name}"


def test_workers_answer_for_their_machines():
    client = Client(0)
    here, queued = Cluster(client, "local", None), Cluster(client, "slurm", None)
    assert here.count == 1 and Cluster(Client(3), "local", None).count == 3
    assert [here.device(each) for each in (None, "cuda:2", "cpu")] == [None, "cuda", "cpu"]
    assert [queued.device(each) for each in (None, "cuda:2")] == ["cpu", "cuda"]
    assert here.hardware("cuda:1") == "one" and client.asked == ("hardware", "cuda")
    client.models = {"a": "one", "b": "another"}
    with pytest.raises(WarpcreteError, match=r"has workers with different processors \(another, one\)"):
        here.hardware(None)
    assert here.ask(lambda a, b: a + b, 1, 2) == 3
    with pytest.raises(SceneError, match="is wrong"):
        here.ask(lambda: (_ for _ in ()).throw(SceneError("x = 1: is wrong")))


def test_settings_of_schedulers_that_contradict_each_other_are_refused():
    for given, said in (
        ((None, 2), "workers = 2: has no effect without a scheduler"),
        (("local", None, 2), "processes = 2: cannot be combined with a scheduler"),
        (("local", 0), "workers = 0"),
        (("tcp://node1:8786", 2), "workers = 2: cannot be set for the running scheduler 'tcp://node1:8786'"),
        (("lokal", None), "scheduler = 'lokal': must be one of local, slurm, or an address"),
    ):
        with pytest.raises(SceneError, match=said):
            check_scheduler(*given)
    check_scheduler(None, None, 4)
    check_scheduler("tcp://node1:8786", None)


@pytest.fixture
def started(monkeypatch):
    """Keep the arguments with which clusters and clients are made."""
    made = {}

    class Made:
        def __init__(self, **given):
            made.update(given)
            self.worker_spec = given.get("workers", {})

        def scale(self, jobs):
            made["jobs"] = jobs

        def close(self):
            made["closed"] = True

    def client(target, timeout, set_as_default):
        made["client"], made["target"] = Client(1), target
        assert timeout == cluster.CONNECT_TIMEOUT and not set_as_default
        return made["client"]

    monkeypatch.setattr(dask.distributed, "SpecCluster", Made)
    monkeypatch.setattr(dask.distributed, "Client", client)
    monkeypatch.setattr(cluster, "default_threads", lambda: 7)
    return made


def test_workers_of_this_machine(started, monkeypatch):
    """One for so many cores or one for each GPU, which is the only one that it sees; no port is open to others."""
    local_cluster(None, "cpu", 2)
    assert [each["options"]["env"] for each in started["workers"].values()] == [{}] * 3
    options = started["workers"][0]["options"]
    assert options["host"] == started["scheduler"]["options"]["host"] == "127.0.0.1" and options["nthreads"] == 1
    assert options["memory_limit"] == 0 and options["preload"] == ["warpcrete.studies.cluster"]
    assert started["scheduler"]["options"]["dashboard"] is False and options["dashboard"] is False
    local_cluster(2, "cpu", 1)
    assert len(started["workers"]) == 2
    local_cluster(None, "cpu", 9)
    assert len(started["workers"]) == 1
    monkeypatch.setattr(cluster, "find_device", lambda device: SimpleNamespace(is_cuda=True, ordinal=1))
    monkeypatch.setattr(cluster.wp, "get_cuda_device_count", lambda: 3)
    for visible, device, workers, numbers in (
        ("", "cuda", None, "012"), ("4,5", "cuda", None, "45"), ("4,5", "cuda:1", None, "5"), ("", "cuda", 2, "01"),
    ):  # fmt: skip
        monkeypatch.setenv("CUDA_VISIBLE_DEVICES", visible)
        local_cluster(workers, device, 1)
        seen = [each["options"]["env"]["CUDA_VISIBLE_DEVICES"] for each in started["workers"].values()]
        assert "".join(seen) == numbers
    with pytest.raises(SceneError, match="workers = 4: must be at most the 3 GPUs"):
        local_cluster(4, "cuda", 1)


def test_a_cluster_is_opened_and_closed(started, monkeypatch):
    with open_cluster(None, None, None) as nothing:
        assert nothing is None
    with open_cluster("local", 2, "cpu") as here:
        assert here._workers == 2 and started["client"].waited == (1, cluster.CONNECT_TIMEOUT)
        assert "closed" not in started
    assert started["closed"] and started["client"].closed
    monkeypatch.setattr(cluster.shutil, "which", lambda name: None)
    with pytest.raises(WarpcreteError, match="the command sbatch is missing"), open_cluster("slurm", 3, None):
        pass
    monkeypatch.setattr(cluster.shutil, "which", lambda name: name)
    monkeypatch.setattr(cluster, "slurm_cluster", lambda device, threads: dask.distributed.SpecCluster())
    with open_cluster("slurm", 3, None) as queued:
        assert queued._workers == 3 and started["jobs"] == 3 and started["client"].waited == (1, None)
    with open_cluster("tcp://node1:8786", None, None) as far:
        assert started["target"] == "tcp://node1:8786" and far._workers is None

    def late(self, count, timeout):
        raise TimeoutError

    monkeypatch.setattr(Client, "wait_for_workers", late)
    for scheduler, hint in (("local", "try again"), ("tcp://n:1", "start workers with 'dask worker tcp://n:1'")):
        with pytest.raises(WarpcreteError, match=f"has no workers; {hint}"), open_cluster(scheduler, None, "cpu"):
            pass


def test_jobs_of_slurm_ask_for_what_a_run_needs(monkeypatch):
    import dask.config
    import dask_jobqueue.slurm

    made, given = {}, {}
    monkeypatch.setattr(dask_jobqueue.slurm, "SLURMCluster", lambda **settings: made.update(settings))
    monkeypatch.setattr(dask.config, "get", lambda key, default: given)
    slurm_cluster(None, 4)
    assert (made["cores"], made["processes"]) == (1, 1) and not made["job_extra_directives"]
    slurm_cluster("cuda", 1)
    assert made["job_extra_directives"] == ["--gres=gpu:1"] and made["processes"] == 1
    given.update({"cores": 8, "job-extra-directives": [" --gpus=2", "--mem=1"]})
    slurm_cluster("cuda", 1)
    assert made["job_extra_directives"] == [" --gpus=2", "--mem=1"] and made["processes"] == 1
    slurm_cluster("cpu", 3)
    assert made["processes"] == 2
    with pytest.raises(SceneError, match="threads = 9: must be at most the 8 cores of a job"):
        slurm_cluster("cpu", 9)


def test_a_worker_runs_only_cases_without_an_outcome(tmp_path, monkeypatch):
    known, ran = {"b": {"finished": True}}, []

    def run_cases(record, module, folder, cases, asked):
        ran.append(([case.name for case in cases], record, module, folder, asked()))
        return [f"result {case.name}" for case in cases]

    monkeypatch.setattr(cluster, "previous_outcome", lambda folder: known.get(folder.name))
    monkeypatch.setattr(cluster, "run_cases", run_cases)
    cases = [Case(name, {}, {}) for name in "abc"]
    found = cluster._run_part({"x": 1}, "module", tmp_path, cases, lambda: False)
    assert found == ["result a", {"finished": True}, "result c"]
    assert ran == [(["a", "c"], {"x": 1}, "module", tmp_path, False)]


def test_a_job_asks_now_and_then_whether_to_stop(tmp_path, monkeypatch):
    clock, looked, answers = [100.0], [], [False, True]
    event = SimpleNamespace(is_set=lambda: looked.append(clock[0]) or answers[len(looked) - 1])
    monkeypatch.setattr(dask.distributed, "Event", lambda name, client: event)
    monkeypatch.setattr(dask.distributed, "get_client", lambda: None)
    monkeypatch.setattr(cluster, "time", SimpleNamespace(monotonic=lambda: clock[0]))

    def function(record, module, folder, job, asked):
        found = []
        for step in (0.0, 0.5, 0.6, 0.1, 9.0):
            clock[0] += step
            found.append(asked())
        return record, module.__name__, folder, job, found

    found = cluster._run_job(function, {"x": 1}, "json", str(tmp_path), "job", "stop")
    assert found == ({"x": 1}, "json", tmp_path, "job", [False, False, True, True, True])
    assert looked == pytest.approx([100.0, 101.1])
