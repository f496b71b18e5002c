"""Studies on several GPUs or machines: Dask's scheduler and workers, one a GPU or a core.

Folders are those of a study on one machine, which all workers must see under the same path, and so are the bits. When a
worker is lost, another one goes on with what it had from the last checkpoints.
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
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import warp as wp

from ..core.device import default_threads, find_device
from ..core.errors import WarpcreteError, between, refuse
from ..core.interrupts import leave_to_parent
from ..core.provenance import provenance
from .cases import Case
from .running import Book, kept, run_cases

SCHEDULERS = ("local", "slurm")
"""What can be started; anything else is the address of one that runs."""
LOCAL = {"host": "127.0.0.1", "port": 0, "dashboard": False, "dashboard_address": "127.0.0.1:0"}
"""Of a scheduler for one machine: nobody else can reach it."""
LOOK = 1.0
"""From one question whether to stop to the next, of a worker [s]."""
CONNECT = 20.0
"""Time for a scheduler to answer, and for a worker to be there [s]."""
_part = threading.Lock()


def check_scheduler(scheduler: str | None, workers: int | None, processes: int | None = None) -> None:
    """Refuse settings that contradict each other, and Dask that is missing."""
    if scheduler is None:
        if workers is not None:
            refuse("workers", workers, "are those of a scheduler", "give one, or take processes")
        return
    if processes is not None:
        refuse("processes", processes, "are those of a study without a scheduler", "take workers")
    if workers is not None:
        between("workers", workers, 1, float("inf"))
        if scheduler not in SCHEDULERS:
            refuse("workers", workers, f"are those that '{scheduler}' has", "leave them out")
    if scheduler not in SCHEDULERS and ":" not in scheduler:
        refuse("scheduler", scheduler, f"must be {', '.join(SCHEDULERS)} or an address such as tcp://node1:8786")
    try:
        import dask.distributed  # noqa: F401

        if scheduler == "slurm":
            import dask_jobqueue  # noqa: F401
    except ImportError as error:
        raise WarpcreteError(
            f"scheduler = {scheduler!r}: needs the package {error.name}; pip install 'warpcrete[cluster]'"
        ) from error


class Cluster:
    """Workers that cases run on."""

    def __init__(self, client: Any, scheduler: str, workers: int | None) -> None:
        self._client, self._scheduler, self._workers = client, scheduler, workers

    def machine(self, device: str | None, precision: str, seed: int) -> tuple[str, dict[str, Any]]:
        """Device that a worker takes for `device`, and its provenance."""
        if self._scheduler == "slurm":
            device = device or "cpu"
        return self._client.submit(_machine, unnumbered(device), precision, seed, pure=False).result()

    def run(self, record: dict[str, Any], module: Any, folder: Path, pending: list[Case], book: Book) -> None:
        """Run cases: one a task on CPUs; on GPUs a part of all for each worker, which it runs as a batch."""
        from dask.distributed import Event, wait

        name = f"stop-{os.getpid()}-{time.time_ns()}"
        stop = Event(name, client=self._client)
        parts = [[case] for case in pending]
        if record["device"].startswith("cuda"):
            count = self._workers or len(self._client.scheduler_info(n_workers=-1)["workers"])
            parts = [part for k in range(count) if (part := pending[k::count])]
        common = record | {"device": unnumbered(record["device"])}, module.__name__, str(folder.resolve())
        running = {self._client.submit(_run_part, *common, part, name, pure=False): part for part in parts}
        while running:
            try:
                with self._client.as_current():
                    ended: Any = wait(list(running), return_when="FIRST_COMPLETED")
                for future in ended.done:
                    part = running.pop(future)
                    try:
                        outcomes = future.result()
                    except Exception as broken:  # a worker that died of every try, or what nobody foresaw
                        outcomes = [WarpcreteError(f"its worker failed: {type(broken).__name__}: {broken}")] * len(part)
                    for case, outcome in zip(part, outcomes):
                        book(case, outcome)
            except KeyboardInterrupt:
                if stop.is_set():
                    raise
                stop.set()  # those that run end at their next sample
                with_workers = {key for keys in self._client.processing().values() for key in keys}
                for future in [future for future in running if future.key not in with_workers]:
                    future.cancel()
                    del running[future]
            except WarpcreteError:
                raise
            except Exception as lost:
                raise WarpcreteError(f"scheduler = {self._scheduler!r}: is lost: {type(lost).__name__}") from lost


@contextmanager
def open_cluster(scheduler: str | None, workers: int | None, device: str | None) -> Iterator[Cluster | None]:
    """Workers by the name or the address of a scheduler; None without one.

    `local` starts processes here, as many as `workers` or one a GPU, or one a core where the device is a CPU; `slurm`
    submits `workers` jobs (default 1) as Dask's configuration describes them, for GPUs if `device` names one. Raises
    :class:`SceneError` for settings that cannot be, :class:`WarpcreteError` where no scheduler answers.
    """
    if scheduler is None:
        yield None
        return
    from dask.distributed import Client

    made = None
    try:
        if scheduler == "local":
            made = local_cluster(workers, device)
            workers = len(made.worker_spec)
        elif scheduler == "slurm":
            if shutil.which("sbatch") is None:
                raise WarpcreteError(
                    "scheduler = 'slurm': there is no sbatch here; begin on a machine that submits jobs"
                )
            made, workers = slurm_cluster(device), workers or 1
            made.scale(jobs=workers)
        try:
            client = Client(made or scheduler, timeout=CONNECT, set_as_default=False)
        except (OSError, ValueError) as error:
            raise WarpcreteError(f"scheduler = {scheduler!r}: does not answer: {error}") from error
        with client:
            try:
                # A job may wait for long, and who started it knows.
                client.wait_for_workers(1, timeout=None if scheduler == "slurm" else CONNECT)
            except TimeoutError as error:
                raise WarpcreteError(f"scheduler = {scheduler!r}: has no workers") from error
            yield Cluster(client, scheduler, workers)
    finally:
        if made is not None:
            made.close()


def local_cluster(workers: int | None, device: str | None) -> Any:
    """Worker processes on this machine, each with one thread; of GPUs each sees its own alone."""
    from dask.distributed import Nanny, Scheduler, SpecCluster

    environments: list[dict[str, str]]
    found = find_device(device)
    if found.is_cuda:
        visible = os.environ.get("CUDA_VISIBLE_DEVICES")
        numbers = visible.split(",") if visible else [str(k) for k in range(wp.get_cuda_device_count())]
        if device != unnumbered(device):
            numbers = [numbers[found.ordinal]]
        if workers is not None and workers > len(numbers):
            refuse("workers", workers, f"are more than there are GPUs here, {len(numbers)}", "take one a GPU")
        environments = [{"CUDA_VISIBLE_DEVICES": number} for number in numbers[: workers or len(numbers)]]
    else:
        environments = [{} for _ in range(workers or default_threads())]
    # The variables are set when a worker's process begins, before Warp looks for devices.
    options = {
        "nthreads": 1,
        "memory_limit": 0,
        "silence_logs": logging.CRITICAL,
        "dashboard": False,
        "preload": [__name__],
    }
    return SpecCluster(
        workers={k: {"cls": Nanny, "options": options | {"env": env}} for k, env in enumerate(environments)},
        scheduler={"cls": Scheduler, "options": LOCAL},
        silence_logs=logging.CRITICAL,
    )


def slurm_cluster(device: str | None) -> Any:
    """Jobs of SLURM by `jobqueue.slurm` of Dask's configuration; what that leaves open is a core, 4 GB and one GPU."""
    import dask.config
    from dask_jobqueue.slurm import SLURMCluster

    given = dask.config.get("jobqueue.slurm", {})
    cores = given.get("cores") or 1
    gpu = ("--gres", "--gpus", "-G")
    directives = list(given.get("job-extra-directives") or [])
    on_gpu = (device or "cpu").startswith("cuda")
    if on_gpu and not any(each.strip().startswith(gpu) for each in directives):
        directives.append("--gres=gpu:1")
    # A worker has one thread, as a process runs one part at a time.
    return SLURMCluster(
        cores=1 if on_gpu else cores,
        processes=1 if on_gpu else cores,
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
    leave_to_parent()


def _machine(device: str | None, precision: str, seed: int) -> tuple[str, dict[str, Any]]:
    found = find_device(device)
    return str(found), provenance(found, precision, seed)


def _run_part(record: dict[str, Any], module_name: str, folder: str, cases: list[Case], stop: str) -> list[Any]:
    """Cases, on a worker; those that it, or one that was lost, has finished before are not run again.

    One part at a time, whatever threads a worker has: to capture launches a process has one place.
    """
    with _part:
        return _run_alone(record, module_name, folder, cases, stop)


def _run_alone(record: dict[str, Any], module_name: str, folder: str, cases: list[Case], stop: str) -> list[Any]:
    module, place = importlib.import_module(module_name), Path(folder)
    found = {case.name: kept(place / case.name) for case in cases}
    left = [case for case in cases if found[case.name] is None]
    found |= dict(zip((case.name for case in left), run_cases(record, module, place, left, _asked(stop))))
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
