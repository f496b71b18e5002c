"""What recorders do beside the run: jobs, in their order, in a thread of their own."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from typing import Any

from .device import default_threads, parallel
from .turns import give_way, waiting

MOST = 8
"""Jobs that may wait; the run waits when there are more, so that none is lost and memory stays bounded."""


class Later:
    """Does jobs one after the other. What one fails with is raised by every call from then on, and no other is done.

    Without `beside` each is done at once, by who asks. A thread that `gives_way` lets the run go first:
    see :mod:`.turns`.
    """

    def __init__(self, beside: bool, gives_way: bool = False) -> None:
        self.beside = beside
        self._gives_way = gives_way
        self._jobs: queue.Queue[Callable[[], None] | None] = queue.Queue(MOST)
        self._thread: threading.Thread | None = None
        self._error: BaseException | None = None

    @classmethod
    def of(cls, simulation: Any) -> Later:
        """Beside the run where there is a core for it: threads of a run that wait for one another need theirs."""
        spare = not simulation.shares_cores and simulation.threads < default_threads()
        return cls(parallel(simulation.device) or spare, simulation.device.is_cuda)

    def do(self, job: Callable[[], None]) -> None:
        """Do a job, or put it in the queue."""
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
        """Until all is done."""
        with waiting():
            self._jobs.join()
        self._look()

    def give_way(self) -> None:
        """Between two parts of a job: let the run go on first."""
        if self._gives_way and threading.current_thread() is self._thread:
            give_way()

    def close(self) -> None:
        """Wait, and end the thread."""
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
