"""Studies and trade-off studies on several GPUs or machines, with Dask's scheduler and workers.

Each worker uses one GPU, or as many CPU cores as a run has threads. All workers must see the run folders under the same
path. Folders and results are bit for bit the same as for a study on one machine. When a worker is lost, another worker
continues its work; the cases of a study continue from their last checkpoints.
"""

import importlib
import logging
import os
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

import warp as wp

from ..core.device.device import default_threads, find_device
from ..core.device.interrupts import StopAtSample, ignore_interrupts
from ..core.errors import WarpcreteError, refuse, warn_in_one_line, whole
from ..core.records import Record
from ..core.run.provenance import processor, provenance
from ..core.run.scene_module import SceneModule
from ..core.run.viewer import LOOPBACK
from .cases import Case
from .running import OutcomeCallback, previous_outcome, run_cases

SCHEDULERS = ("local", "slurm")
"""Kinds of Dask schedulers that the program itself can start. Any other text that the user states as the scheduler is
the address of a running scheduler."""
LOCAL_SCHEDULER_OPTIONS = {"host": LOOPBACK, "port": 0, "dashboard": False, "dashboard_address": f"{LOOPBACK}:0"}
"""Options of a scheduler that only processes on this machine can reach."""
STOP_POLL_INTERVAL = 1.0
"""Interval at which a worker checks whether the user wants to stop [s]."""
CONNECT_TIMEOUT = 20.0
"""Time limit for a scheduler to answer and for the first worker to connect [s]."""
T = TypeVar("T")
_job = threading.Lock()


class WorkerLost(WarpcreteError):
    """Error raised when every worker that tried a job died, or the job raised an unexpected exception."""


def check_scheduler(scheduler: str | None, workers: int | None, processes: int | None = None) -> None:
    """Raise an error if scheduler settings contradict each other or if the package Dask is missing."""
    if processes is not None:
        whole("processes", processes, 1)
    if scheduler is None:
        if workers is not None:
            problem = "has no effect without a scheduler"
            refuse("workers", workers, problem, "give 'scheduler' as well, or leave out 'workers'")
        return
    if not isinstance(scheduler, str):
        refuse(
            "scheduler", scheduler, f"must be one of {', '.join(SCHEDULERS)}, or an address such as tcp://node1:8786"
        )
    if processes is not None:
        refuse("processes", processes, "cannot be combined with a scheduler", "set 'workers' instead")
    if workers is not None:
        whole("workers", workers, 1, 100_000)
        if scheduler not in SCHEDULERS:
            problem = f"cannot be set for the running scheduler '{scheduler}', which has its own workers"
            refuse("workers", workers, problem, "leave out 'workers'")
    if scheduler not in SCHEDULERS and ":" not in scheduler:
        refuse(
            "scheduler", scheduler, f"must be one of {', '.join(SCHEDULERS)}, or an address such as tcp://node1:8786"
        )
    try:
        import dask.distributed  # noqa: F401

        if scheduler == "slurm":
            import dask_jobqueue  # noqa: F401
    except ImportError as error:
        raise WarpcreteError(
            f"scheduler = {scheduler!r}: needs the package {error.name}; run pip install 'warpcrete[cluster]'"
        ) from error


class Cluster:
    """Dask workers on which the cases of a study run."""

    def __init__(self, client: Any, scheduler: str, workers: int | None) -> None:
        self._client, self._scheduler, self._workers = client, scheduler, workers

    @property
    def count(self) -> int:
        """Number of connected workers, at least 1."""
        return max(1, len(self._client.scheduler_info(n_workers=-1)["workers"]))

    def device(self, wanted: str | None) -> str | None:
        """Return the device name with which a worker is started if the user requests the device `wanted`.

        The name has no GPU number, because a worker sees only one GPU. If `wanted` is None, the result is "cpu" on
        SLURM, because a SLURM job has a GPU only if one was requested. For other schedulers it is None, so that each
        worker uses its default device.
        """
        return "cpu" if wanted is None and self._scheduler == "slurm" else unnumbered(wanted)

    def ask(self, function: Callable[..., T], *arguments: Any) -> T:
        """Run a function on a worker and return its result; raise the exception that it raised."""
        outcome = _outcome(self._client.submit(function, *arguments, pure=False))
        if isinstance(outcome, Exception):
            raise outcome
        return outcome

    def machine(self, device: str | None, precision: str, seed: int) -> tuple[str, Record]:
        """Return the device that a worker uses if the user requests `device`, and a record of device and software."""
        return self.ask(_machine, self.device(device), precision, seed)

    def hardware(self, device: str | None) -> str:
        """Return the model of the GPU or CPU of all workers; raise :class:`WarpcreteError` if the models differ."""
        models = sorted(set(self._client.run(hardware, self.device(device)).values()))
        if len(models) > 1:
            raise WarpcreteError(
                f"scheduler = {self._scheduler!r}: has workers with different processors ({', '.join(models)}), so the "
                "wall times of runs cannot be compared; use workers with the same processor"
            )
        return models[0]

    def run(
        self, record: Record, module: SceneModule, folder: Path, pending: list[Case], store_outcome: OutcomeCallback
    ) -> None:
        """Run the `pending` cases of a study, and call `store_outcome` for each case.

        On CPUs, each case is a separate job. On GPUs, the cases are split into one batch for each worker.
        """
        parts = [[case] for case in pending]
        if record["device"].startswith("cuda"):
            count = self._workers or self.count
            parts = [part for k in range(count) if (part := pending[k::count])]

        def store_part(part: list[Case], found: object) -> None:
            for case, outcome in zip(part, [found] * len(part) if isinstance(found, Exception) else found):
                store_outcome(case, outcome)

        with StopAtSample([]) as gap:
            self.each(_run_part, (record, module, folder), zip(parts, parts), store_part, gap)

    def each(
        self,
        function: Callable[..., Any],
        where: tuple[dict[str, Any], Any, Path],
        jobs: Iterator[tuple[T, Any]],
        store_outcome: Callable[[T, Any], None],
        gap: StopAtSample,
        *,
        lazily: bool = False,
    ) -> None:
        """Run a function on the workers, once for every job.

        The call is `function(record, module, folder, job, stop_requested)`. `where` holds the study's record, the
        module of its scene and its folder. `jobs` yields pairs of a tag, which identifies the job for the caller, and
        the job itself. When a job has ended, `store_outcome` is called with the tag and the result or exception. With
        `lazily`, the next job is read from `jobs` only when a worker is free. `gap` tells whether the user has pressed
        Ctrl-C. In that case, waiting jobs are cancelled, and the callback `stop_requested` returns True. Running jobs
        call this callback regularly, and end early if it returns True.
        """
        from dask.distributed import Event, wait
        from dask.distributed import TimeoutError as NotYet

        name = f"stop-{os.getpid()}-{time.time_ns()}"
        stop, stopping = Event(name, client=self._client), False
        record, module, folder = where
        common = record | {"device": unnumbered(record["device"])}, module.__name__, str(folder.resolve())
        running: dict[Any, T] = {}
        try:
            while True:
                for tag, job in islice(jobs, max(0, self.count - len(running)) if lazily else None):
                    running[self._client.submit(_run_job, function, *common, job, name, pure=False)] = tag
                if gap.requested and not stopping:
                    stopping = True
                    stop.set()  # Running jobs check this event at every measurement, and end if it is set.
                    with_workers = {key for keys in self._client.processing().values() for key in keys}
                    for future in [future for future in running if future.key not in with_workers]:
                        future.cancel()
                        del running[future]
                if not running:
                    return
                try:
                    with self._client.as_current():
                        ended: Any = wait(list(running), timeout=STOP_POLL_INTERVAL, return_when="FIRST_COMPLETED")
                except NotYet:
                    continue
                for future in ended.done:
                    store_outcome(running.pop(future), _outcome(future))
        except WarpcreteError:
            stop.set()  # `jobs` or `store_outcome` failed, so no more results can be stored. Stop the running jobs.
            raise
        except Exception as lost:
            raise WarpcreteError(
                f"scheduler = {self._scheduler!r}: the connection was lost ({type(lost).__name__}); "
                "use --resume when the scheduler can be reached again"
            ) from lost


def _outcome(future: Any) -> Any:
    try:
        return future.result()
    except WarpcreteError as error:
        return error
    except Exception as broken:
        return WorkerLost(f"its worker failed: {type(broken).__name__}: {broken}")


@contextmanager
def open_cluster(
    scheduler: str | None, workers: int | None, device: str | None, threads: int = 1
) -> Iterator[Cluster | None]:
    """Yield the workers of a scheduler, given by its name or address; yield None if `scheduler` is None.

    The scheduler `local` starts `workers` processes on this machine; the default is one per GPU, or on a CPU one for
    every `threads` cores. The scheduler `slurm` submits `workers` jobs (default 1), which Dask's configuration
    describes; they request GPUs if `device` is a GPU. Raises :class:`SceneError` for impossible settings, and
    :class:`WarpcreteError` if no scheduler answers.
    """
    if scheduler is None:
        yield None
        return
    with _without_main() if scheduler == "local" else nullcontext():
        yield from _start_cluster(scheduler, workers, device, threads)


@contextmanager
def _without_main() -> Iterator[None]:
    """Hide the caller's script from Dask within a `with` block.

    Without this, every worker process that Dask starts would run the script.
    """
    main = vars(sys.modules["__main__"])
    hidden = {name: main.pop(name) for name in ("__file__", "__spec__") if name in main}
    main["__spec__"] = None
    try:
        yield
    finally:
        main.update(hidden)


def _start_cluster(scheduler: str, workers: int | None, device: str | None, threads: int) -> Iterator[Cluster]:
    from dask.distributed import Client

    dask_cluster = None
    try:
        if scheduler == "local":
            dask_cluster = local_cluster(workers, device, threads)
            workers = len(dask_cluster.worker_spec)
        elif scheduler == "slurm":
            if shutil.which("sbatch") is None:
                raise WarpcreteError(
                    "scheduler = 'slurm': the command sbatch is missing on this machine; start the study on a machine "
                    "that can submit SLURM jobs"
                )
            dask_cluster, workers = slurm_cluster(device, threads), workers or 1
            dask_cluster.scale(jobs=workers)
        try:
            client = Client(dask_cluster or scheduler, timeout=CONNECT_TIMEOUT, set_as_default=False)
        except (OSError, ValueError) as error:
            raise WarpcreteError(f"scheduler = {scheduler!r}: does not answer: {error}; check the address") from error
        with client:
            try:
                # Set no time limit for SLURM, because users expect that a job may wait in the queue for hours.
                client.wait_for_workers(1, timeout=None if scheduler == "slurm" else CONNECT_TIMEOUT)
            except TimeoutError as error:
                hint = "try again" if scheduler == "local" else f"start workers with 'dask worker {scheduler}'"
                raise WarpcreteError(f"scheduler = {scheduler!r}: has no workers; {hint}") from error
            yield Cluster(client, scheduler, workers)
    finally:
        if dask_cluster is not None:
            dask_cluster.close()


def local_cluster(workers: int | None, device: str | None, threads: int = 1) -> Any:
    """Start worker processes on this machine, each for one run at a time; a GPU worker sees only its own GPU."""
    from dask.distributed import Nanny, Scheduler, SpecCluster

    environments: list[dict[str, str]]
    selected_device = find_device(device)
    if selected_device.is_cuda:
        visible = os.environ.get("CUDA_VISIBLE_DEVICES")
        numbers = visible.split(",") if visible else [str(k) for k in range(wp.get_cuda_device_count())]
        if device != unnumbered(device):
            numbers = [numbers[selected_device.ordinal]]
        if workers is not None and workers > len(numbers):
            problem = f"must be at most the {len(numbers)} GPUs of this machine"
            refuse("workers", workers, problem, "use at most one per GPU")
        environments = [{"CUDA_VISIBLE_DEVICES": number} for number in numbers[: workers or len(numbers)]]
    else:
        environments = [{} for _ in range(workers or max(1, default_threads() // threads))]
    # Dask sets CUDA_VISIBLE_DEVICES in the environment of each worker process before Warp looks for devices in that
    # process.
    options = {
        "nthreads": 1,
        "memory_limit": 0,
        "silence_logs": logging.CRITICAL,
        "host": LOOPBACK,
        "dashboard": False,
        "dashboard_address": f"{LOOPBACK}:0",
        "preload": [__name__],
    }
    return SpecCluster(
        workers={k: {"cls": Nanny, "options": options | {"env": env}} for k, env in enumerate(environments)},
        scheduler={"cls": Scheduler, "options": LOCAL_SCHEDULER_OPTIONS},
        silence_logs=logging.CRITICAL,
    )


def slurm_cluster(device: str | None, threads: int = 1) -> Any:
    """Create a cluster of SLURM jobs from the section `jobqueue.slurm` of Dask's configuration.

    If the section lacks an entry, a job has one core for each thread of a run, 4 GB of memory, and one GPU if `device`
    is a GPU.
    """
    import dask.config
    from dask_jobqueue.slurm import SLURMCluster

    given = dask.config.get("jobqueue.slurm", {})
    on_gpu = (device or "cpu").startswith("cuda")
    cores = given.get("cores") or (1 if on_gpu else threads)
    if not on_gpu and threads > cores:
        hint = "use fewer threads, or increase jobqueue.slurm.cores in the configuration of Dask"
        refuse("threads", threads, f"must be at most the {cores} cores of a job", hint)
    gpu = ("--gres", "--gpus", "-G")
    directives = list(given.get("job-extra-directives") or [])
    if on_gpu and not any(each.strip().startswith(gpu) for each in directives):
        directives.append("--gres=gpu:1")
    # A worker process has a single Dask thread because it runs one job at a time. A simulation may use more threads.
    processes = 1 if on_gpu else cores // threads
    return SLURMCluster(
        cores=processes,
        processes=processes,
        job_cpu=given.get("job-cpu") or cores,
        memory=given.get("memory") or "4 GB",
        job_extra_directives=directives,
        python=given.get("python") or sys.executable,
    )


def unnumbered(device: str | None) -> str | None:
    """Return a device's name without the GPU number, because a worker sees at most one GPU."""
    return "cuda" if device is not None and device.startswith("cuda") else device


def dask_setup(worker: object) -> None:
    """Make a worker process on this machine ignore Ctrl-C, which the parent process handles.

    Dask calls this function when it preloads this module in the worker process.
    """
    warn_in_one_line()
    ignore_interrupts()


def _machine(device: str | None, precision: str, seed: int) -> tuple[str, Record]:
    selected_device = find_device(device)
    return str(selected_device), provenance(selected_device, precision, seed)


def hardware(device: str | None) -> str:
    """Return the model name of the GPU or CPU that the device name `device` stands for."""
    selected_device = find_device(device)
    return selected_device.name if selected_device.is_cuda else processor()


def _run_job(function: Callable[..., T], record: Record, module_name: str, folder: str, job: object, stop: str) -> T:
    """Run one job on a worker.

    A lock prevents two jobs from running at the same time, because a process can capture the kernel launches of only
    one simulation at a time. `stop` is the name of the Dask event that is set when the user wants to stop.
    """
    with _job:
        return function(record, importlib.import_module(module_name), Path(folder), job, _stop_requested(stop))


def _run_part(
    record: Record, module: SceneModule, folder: Path, cases: list[Case], stop_requested: Callable[[], bool]
) -> list[Any]:
    """Run cases of a study on a worker, and return the outcomes of all `cases` in their order.

    A case whose folder already contains an outcome, for example from a worker that was lost, is not run again.
    """
    outcomes = {case.name: previous_outcome(folder / case.name) for case in cases}
    left = [case for case in cases if outcomes[case.name] is None]
    outcomes |= dict(zip((case.name for case in left), run_cases(record, module, folder, left, stop_requested)))
    return [outcomes[case.name] for case in cases]


def _stop_requested(name: str) -> Callable[[], bool]:
    """Return a function that tells whether the Dask event `name` is set.

    The function asks the scheduler at most once per `STOP_POLL_INTERVAL`, and otherwise repeats the last answer.
    """
    from dask.distributed import Event, get_client

    event, looked, answer = Event(name, client=get_client()), -STOP_POLL_INTERVAL, False

    def ask() -> bool:
        nonlocal looked, answer
        if not answer and time.monotonic() - looked >= STOP_POLL_INTERVAL:
            looked, answer = time.monotonic(), bool(event.is_set())
        return answer

    return ask
