"""Recorder thread: it runs the jobs of recorders in order, in parallel with the simulation."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from typing import Any

from .device import default_threads, parallel
from .interpreter_priority import give_way, waiting

MOST = 8
"""Maximum number of waiting jobs. If more are added, the run waits, so that no job is lost and memory stays bounded."""


class Later:
    """Queue that runs jobs of recorders one after the other, in a thread of its own if `beside` is set.

    Without `beside`, the caller runs each job at once. After a job fails, every call raises its error, and no other job
    runs. With `gives_way`, the thread lets the run use Python's interpreter first: see :mod:`.interpreter_priority`.
    """

    def __init__(self, beside: bool, gives_way: bool = False) -> None:
        self.beside = beside
        self._gives_way = gives_way
        self._jobs: queue.Queue[Callable[[], None] | None] = queue.Queue(MOST)
        self._thread: threading.Thread | None = None
        self._error: BaseException | None = None

    @classmethod
    def of(cls, simulation: Any) -> Later:
        """Return the queue for a simulation, with a thread of its own on a GPU or if a CPU core is free.

        Threads of a run that wait for one another at barriers need a core each, so the recorder thread must not share
        these.
        """
        spare = not simulation.shares_cores and simulation.threads < default_threads()
        return cls(parallel(simulation.device) or spare, simulation.device.is_cuda)

    def do(self, job: Callable[[], None]) -> None:
        """Run a job, or append it to the queue."""
        self._look()
        if not self.beside:
            job()
            return
        if self._thread is None:
            self._thread = threading.Thread(target=self._work, name="recorder", daemon=True)
            self._thread.start()
        with waiting():
            self._jobs.put(job)

    def wait(self) -> None:
        """Wait until all jobs in the queue are done."""
        with waiting():
            self._jobs.join()
        self._look()

    def give_way(self) -> None:
        """Let the run use Python's interpreter first, between two parts of a recorder's job."""
        if self._gives_way and threading.current_thread() is self._thread:
            give_way()

    def close(self) -> None:
        """Wait until all jobs are done, and end the thread."""
        if self._thread is not None:
            with waiting():
                self._jobs.put(None)
                self._thread.join()
            self._thread = None
        self._look()

    def _look(self) -> None:
        if self._error is not None:
            raise self._error

    def _work(self) -> None:
        while True:
            job = self._jobs.get()
            try:
                if job is None:
                    return
                if self._error is None:
                    self.give_way()
                    job()
            except BaseException as error:
                self._error = error
            finally:
                self._jobs.task_done()
