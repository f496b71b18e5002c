"""Studies and trades on several GPUs or machines: Dask's scheduler and workers, one a GPU or a core.

Folders are those of one machine, which all workers must see under the same path, and so are the bits. When a worker is
lost, another one goes on with what it had, of a study from the last checkpoints.
"""

from __future__ import annotations

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

from ..core.device import default_threads, find_device
from ..core.errors import WarpcreteError, between, refuse, warn_in_one_line
from ..core.interrupts import StopAtSample, leave_to_parent
from ..core.provenance import processor, provenance
from ..core.viewer import LOOPBACK
from .cases import Case
from .running import Book, kept, run_cases

SCHEDULERS = ("local", "slurm")
"""What can be started; anything else is the address of one that runs."""
LOCAL = {"host": LOOPBACK, "port": 0, "dashboard": False, "dashboard_address": f"{LOOPBACK}:0"}
"""Options of a scheduler for one machine: nobody else can reach it."""
LOOK = 1.0
"""From one question whether to stop to the next [s]."""
CONNECT = 20.0
"""Time for a scheduler to answer, and for a worker to be there [s]."""
T = TypeVar("T")
_job = threading.Lock()


class WorkerLost(WarpcreteError):
    """A worker has died of every try of a job, or failed of what nobody foresaw."""


def check_scheduler(scheduler: str | None, workers: int | None, processes: int | None = None) -> None:
    """Refuse settings that contradict each other, and Dask that is missing."""
    if scheduler is None:
        if workers is not None:
            refuse("workers", workers, "need a scheduler", "give a scheduler, too")
        return
    if processes is not None:
        refuse("processes", processes, "cannot be combined with a scheduler", "use workers instead")
    if workers is not None:
        between("workers", workers, 1, 1e5)
        if scheduler not in SCHEDULERS:
            refuse("workers", workers, f"cannot be set for '{scheduler}', which has its own workers", "leave them out")
    if scheduler not in SCHEDULERS and ":" not in scheduler:
        refuse("scheduler", scheduler, f"must be {', '.join(SCHEDULERS)} or an address such as tcp://node1:8786")
    try:
        import dask.distributed  # noqa: F401

        if scheduler == "slurm":
            import dask_jobqueue  # noqa: F401
    except ImportError as error:
        raise WarpcreteError(
            f"scheduler = {scheduler!r}: needs the package {error.name}; run pip install 'warpcrete[cluster]'"
        ) from error


class Cluster:
    """Workers that cases run on."""

    def __init__(self, client: Any, scheduler: str, workers: int | None) -> None:
        self._client, self._scheduler, self._workers = client, scheduler, workers

    @property
    def count(self) -> int:
        """Workers that there are now, at least 1."""
        return max(1, len(self._client.scheduler_info(n_workers=-1)["workers"]))

    def device(self, wanted: str | None) -> str | None:
        """Name of a device, as a worker finds it; a job of SLURM has a GPU only where one was asked for."""
        return "cpu" if wanted is None and self._scheduler == "slurm" else unnumbered(wanted)

    def ask(self, function: Callable[..., T], *arguments: Any) -> T:
        """What a function returns on a worker."""
        found = _outcome(self._client.submit(function, *arguments, pure=False))
        if isinstance(found, Exception):
            raise found
        return found

    def machine(self, device: str | None, precision: str, seed: int) -> tuple[str, dict[str, Any]]:
        """Device that a worker takes for `device`, and its provenance."""
        return self.ask(_machine, self.device(device), precision, seed)

    def hardware(self, device: str | None) -> str:
        """What all workers that there are compute on; raises :class:`WarpcreteError` if that is not the same."""
        found = sorted(set(self._client.run(hardware, self.device(device)).values()))
        if len(found) > 1:
            raise WarpcreteError(
                f"scheduler = {self._scheduler!r}: has different kinds of workers ({', '.join(found)}), whose times "
                "cannot be compared; use workers of one kind"
            )
        return found[0]

    def run(self, record: dict[str, Any], module: Any, folder: Path, pending: list[Case], book: Book) -> None:
        """Run cases: one a job on CPUs; on GPUs a part of all for each worker, which it runs as a batch."""
        parts = [[case] for case in pending]
        if record["device"].startswith("cuda"):
            count = self._workers or self.count
            parts = [part for k in range(count) if (part := pending[k::count])]

        def booked(part: list[Case], found: Any) -> None:
            for case, outcome in zip(part, [found] * len(part) if isinstance(found, Exception) else found):
                book(case, outcome)

        with StopAtSample([]) as gap:
            self.each(_run_part, (record, module, folder), zip(parts, parts), booked, gap)

    def each(
        self,
        function: Callable[..., Any],
        where: tuple[dict[str, Any], Any, Path],
        jobs: Iterator[tuple[T, Any]],
        book: Callable[[T, Any], None],
        gap: StopAtSample,
        *,
        lazily: bool = False,
    ) -> None:
        """Have workers do jobs, `function(record, module, folder, job, asked)` of each; `where` is the first three.

        `jobs` come with a tag, by which `book` is told what was returned or raised. `lazily`, as many are taken as
        there are workers, and another when one is done. When `gap` hears a Ctrl-C, `asked` says so to those that run,
        and what has not begun is left.
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
                    running[self._client.submit(_do, function, *common, job, name, pure=False)] = tag
                if gap.asked and not stopping:
                    stopping = True
                    stop.set()  # those that run end at their next sample
                    with_workers = {key for keys in self._client.processing().values() for key in keys}
                    for future in [future for future in running if future.key not in with_workers]:
                        future.cancel()
                        del running[future]
                if not running:
                    return
                try:
                    with self._client.as_current():
                        ended: Any = wait(list(running), timeout=LOOK, return_when="FIRST_COMPLETED")
                except NotYet:
                    continue
                for future in ended.done:
                    book(running.pop(future), _outcome(future))
        except WarpcreteError:
            stop.set()  # nobody waits for the others
            raise
        except Exception as lost:
            raise WarpcreteError(
                f"scheduler = {self._scheduler!r}: the connection was lost ({type(lost).__name__}); "
                "resume when it is back"
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
    """Workers by the name or the address of a scheduler; None without one.

    `local` starts processes here, as many as `workers` or one a GPU, or on a CPU one for so many cores as a run has
    `threads`; `slurm` submits `workers` jobs (default 1) as Dask's configuration describes them, for GPUs if `device`
    names one. Raises :class:`SceneError` for settings that cannot be, :class:`WarpcreteError` where no scheduler
    answers.
    """
    if scheduler is None:
        yield None
        return
    with _without_main() if scheduler == "local" else nullcontext():
        yield from _opened(scheduler, workers, device, threads)


@contextmanager
def _without_main() -> Iterator[None]:
    """Hide the caller's script: processes that Dask starts, also in place of lost ones, would run it as they start."""
    main = vars(sys.modules["__main__"])
    hidden = {name: main.pop(name) for name in ("__file__", "__spec__") if name in main}
    main["__spec__"] = None
    try:
        yield
    finally:
        main.update(hidden)


def _opened(scheduler: str, workers: int | None, device: str | None, threads: int) -> Iterator[Cluster]:
    from dask.distributed import Client

    made = None
    try:
        if scheduler == "local":
            made = local_cluster(workers, device, threads)
            workers = len(made.worker_spec)
        elif scheduler == "slurm":
            if shutil.which("sbatch") is None:
                raise WarpcreteError(
                    "scheduler = 'slurm': the command sbatch is missing on this machine; start on a machine that "
                    "submits jobs"
                )
            made, workers = slurm_cluster(device, threads), workers or 1
            made.scale(jobs=workers)
        try:
            client = Client(made or scheduler, timeout=CONNECT, set_as_default=False)
        except (OSError, ValueError) as error:
            raise WarpcreteError(f"scheduler = {scheduler!r}: does not answer: {error}; check the address") from error
        with client:
            try:
                # A job may wait for long, and who started it knows.
                client.wait_for_workers(1, timeout=None if scheduler == "slurm" else CONNECT)
            except TimeoutError as error:
                raise WarpcreteError(f"scheduler = {scheduler!r}: has no workers; start some") from error
            yield Cluster(client, scheduler, workers)
    finally:
        if made is not None:
            made.close()


def local_cluster(workers: int | None, device: str | None, threads: int = 1) -> Any:
    """Worker processes on this machine, each for one run at a time; of GPUs each sees its own alone."""
    from dask.distributed import Nanny, Scheduler, SpecCluster

    environments: list[dict[str, str]]
    found = find_device(device)
    if found.is_cuda:
        visible = os.environ.get("CUDA_VISIBLE_DEVICES")
        numbers = visible.split(",") if visible else [str(k) for k in range(wp.get_cuda_device_count())]
        if device != unnumbered(device):
            numbers = [numbers[found.ordinal]]
        if workers is not None and workers > len(numbers):
            refuse(
                "workers",
                workers,
                f"must be at most the {len(numbers)} GPUs of this machine",
                "use at most one per GPU",
            )
        environments = [{"CUDA_VISIBLE_DEVICES": number} for number in numbers[: workers or len(numbers)]]
    else:
        environments = [{} for _ in range(workers or max(1, default_threads() // threads))]
    # The variables are set when a worker's process begins, before Warp looks for devices.
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
        scheduler={"cls": Scheduler, "options": LOCAL},
        silence_logs=logging.CRITICAL,
    )


def slurm_cluster(device: str | None, threads: int = 1) -> Any:
    """Jobs of SLURM by `jobqueue.slurm` of Dask's configuration; what that leaves open is a core for each thread of a
    run, 4 GB and one GPU.
    """
    import dask.config
    from dask_jobqueue.slurm import SLURMCluster

    given = dask.config.get("jobqueue.slurm", {})
    on_gpu = (device or "cpu").startswith("cuda")
    cores = given.get("cores") or (1 if on_gpu else threads)
    if not on_gpu and threads > cores:
        refuse(
            "threads",
            threads,
            f"must be at most the {cores} cores of a job",
            "see jobqueue.slurm.cores in Dask's configuration",
        )
    gpu = ("--gres", "--gpus", "-G")
    directives = list(given.get("job-extra-directives") or [])
    if on_gpu and not any(each.strip().startswith(gpu) for each in directives):
        directives.append("--gres=gpu:1")
    # A worker has one thread, as a process does one job at a time, whatever threads its run has.
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
    """A device as a worker calls it, which sees one GPU at most."""
    return "cuda" if device is not None and device.startswith("cuda") else device


def dask_setup(worker: Any) -> None:
    """Called by Dask in a local worker, as it is preloaded: Ctrl-C is for the study to hear."""
    warn_in_one_line()
    leave_to_parent()


def _machine(device: str | None, precision: str, seed: int) -> tuple[str, dict[str, Any]]:
    found = find_device(device)
    return str(found), provenance(found, precision, seed)


def hardware(device: str | None) -> str:
    """What computes there: a GPU or a CPU, by its model."""
    found = find_device(device)
    return found.name if found.is_cuda else processor()


def _do(function: Callable[..., T], record: dict[str, Any], module_name: str, folder: str, job: Any, stop: str) -> T:
    """A job, on a worker; one at a time, whatever threads it has: to capture launches a process has one place."""
    with _job:
        return function(record, importlib.import_module(module_name), Path(folder), job, _asked(stop))


def _run_part(
    record: dict[str, Any], module: Any, folder: Path, cases: list[Case], asked: Callable[[], bool]
) -> list[Any]:
    """Cases of a study; those that this worker, or one that was lost, has finished before are not run again."""
    found = {case.name: kept(folder / case.name) for case in cases}
    left = [case for case in cases if found[case.name] is None]
    found |= dict(zip((case.name for case in left), run_cases(record, module, folder, left, asked)))
    return [found[case.name] for case in cases]


def _asked(name: str) -> Callable[[], bool]:
    """Whether an event is set, asked once in a while."""
    from dask.distributed import Event, get_client

    event, looked, answer = Event(name, client=get_client()), -LOOK, False

    def ask() -> bool:
        nonlocal looked, answer
        if not answer and time.monotonic() - looked >= LOOK:
            looked, answer = time.monotonic(), bool(event.is_set())
        return answer

    return ask
