"""Recorder thread: it does the work of recorders, which write a run's output, in parallel with the simulation."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable

from .device import default_threads, parallel
from .interpreter_priority import run_is_waiting, yield_to_run
from .simulation_protocol import SimulationOnDevice

MAXIMUM_JOBS = 8
"""Maximum number of jobs that wait for the thread that writes a run's output (recorder thread). If the run adds more
jobs, the run itself waits, so that no job is lost and memory stays bounded."""


class RecorderThread:
    """Queue of jobs that write a run's output; the jobs run one after the other.

    If `in_thread` is true, they run in a thread of their own; otherwise the caller runs each job at once. After a job
    fails, every call raises the job's error, and no other job runs. If `yields_to_run` is true, the thread lets the run
    use Python's interpreter first: see :mod:`.interpreter_priority`.
    """

    def __init__(self, in_thread: bool, yields_to_run: bool = False) -> None:
        self.in_thread = in_thread
        self._yields_to_run = yields_to_run
        self._jobs: queue.Queue[Callable[[], None] | None] = queue.Queue(MAXIMUM_JOBS)
        self._thread: threading.Thread | None = None
        self._error: BaseException | None = None

    @classmethod
    def for_simulation(cls, simulation: SimulationOnDevice) -> RecorderThread:
        """Return a queue of jobs that write the output of `simulation`.

        The queue has its own thread if the run uses a GPU or leaves a CPU core free. Threads of a run that wait for one
        another at barriers need a core each, so the recorder thread must not share these cores.
        """
        spare = not simulation.shares_cores and simulation.threads < default_threads()
        return cls(parallel(simulation.device) or spare, simulation.device.is_cuda)

    def submit(self, job: Callable[[], None]) -> None:
        """Append a job that writes output to the queue; if the queue has no thread, run the job at once."""
        self._raise_error()
        if not self.in_thread:
            job()
            return
        if self._thread is None:
            self._thread = threading.Thread(target=self._work, name="recorder", daemon=True)
            self._thread.start()
        with run_is_waiting():
            self._jobs.put(job)

    def wait(self) -> None:
        """Wait until all jobs in the queue are done."""
        with run_is_waiting():
            self._jobs.join()
        self._raise_error()

    def yield_to_run(self) -> None:
        """Pause a job that writes output for a moment, so that the run gets Python's interpreter first.

        The method does nothing outside the recorder thread.
        """
        if self._yields_to_run and threading.current_thread() is self._thread:
            yield_to_run()

    def close(self) -> None:
        """Wait until all jobs in the queue are done, then end the thread that writes output.

        If a job failed, raise its error.
        """
        if self._thread is not None:
            with run_is_waiting():
                self._jobs.put(None)
                self._thread.join()
            self._thread = None
        self._raise_error()

    def _raise_error(self) -> None:
        if self._error is not None:
            raise self._error

    def _work(self) -> None:
        while True:
            job = self._jobs.get()
            try:
                if job is None:
                    return
                if self._error is None:
                    self.yield_to_run()
                    job()
            except BaseException as error:
                self._error = error
            finally:
                self._jobs.task_done()
