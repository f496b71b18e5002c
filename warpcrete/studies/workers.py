"""Worker processes that run cases of a study.

A worker imports only this package, never the caller's script. Studies therefore also work in a notebook, in a script
that is read from standard input, and in a script without the condition ``if __name__ == "__main__"``. If a worker dies,
whatever the cause, only its current case is affected.
"""

from __future__ import annotations

import importlib
import json
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
import warnings
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from ..core.errors import PlausibilityWarning, WarpcreteError, warn_in_one_line

# The parent process handles Ctrl-C and the end of the terminal, and tells its workers to stop. Each worker therefore
# ignores these signals, even before it imports the package.
START_CODE = """\
import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)
if hasattr(signal, "SIGHUP"): signal.signal(signal.SIGHUP, signal.SIG_IGN)
import json, sys; sys.path[:] = json.loads(sys.argv[1])
from warpcrete.studies.workers import serve; serve()
"""
READY, STOP = "ready", "stop"


class WorkerDied(WarpcreteError):
    """Error raised when a worker process ends before its case does."""


class WorkerTerminated(WorkerDied):
    """Error raised when SIGTERM ends a worker process before its case ends."""


class NoWorker(WarpcreteError):
    """Error raised when no worker process can be started."""


class WorkerPool:
    """Pool of worker processes, which start when they are needed. Several threads may call :meth:`run` at once."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._workers: list[_Worker] = []
        self._idle: list[_Worker] = []
        self.stopping = False
        """True after the pool has told its workers to end their cases the next time they take measurements."""
        self.terminated = False
        """True if a worker has received SIGTERM, and the pool was stopped for this reason."""

    def __enter__(self) -> WorkerPool:
        return self

    def __exit__(self, *unused: object) -> None:
        """End all workers immediately, including those that run a case."""
        for worker in self._workers:
            worker.end()

    def stop(self) -> None:
        """Tell all workers to end their cases the next time they take measurements."""
        with self._lock:
            self.stopping = True
            for worker in self._workers:
                worker.send(STOP)

    def run(self, *job: object) -> Any:
        """Run a job (a function and its arguments) in a worker process; return its result or the exception it raised.

        If the worker receives SIGTERM, all workers are told to stop, as after a Ctrl-C; the result is None if SIGTERM
        ended the worker before its job was complete. Raises :class:`WorkerDied` if the worker process ends during the
        job for another reason, and :class:`NoWorker` if no worker process can be started.
        """
        try:
            found, terminated = self._answer_of(*job)
        except WorkerTerminated:
            found, terminated = None, True
        if terminated and not self.stopping:
            self.terminated = True
            self.stop()
        return found

    def _answer_of(self, *job: object) -> tuple[Any, bool]:
        """Return the outcome of a job, and whether its worker has received SIGTERM."""
        with self._lock:
            worker = self._idle.pop() if self._idle else _Worker()
            if worker not in self._workers:
                self._workers.append(worker)
            if self.stopping:
                worker.send(STOP)
        try:
            worker.wait_until_ready()
        except WorkerTerminated:
            raise
        except WorkerDied as error:
            with self._lock:
                worker.failed = True
                none = all(each.failed for each in self._workers)
            if none:
                raise NoWorker(
                    f"no worker process can be started: {error}; the messages above state the reason"
                ) from error
            raise
        try:
            worker.send(job)
        except Exception:  # The job cannot be pickled. The worker has not received it, so it is still idle.
            with self._lock:
                self._idle.append(worker)
            raise
        found, terminated = worker.receive()
        if not terminated:  # A worker that has received SIGTERM ends after its answer.
            with self._lock:
                self._idle.append(worker)
        return found, terminated


class _Worker:
    def __init__(self) -> None:
        self._ready = False
        self.failed = False
        """True if the worker process died while it was starting, before it could run jobs."""
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-c", START_CODE, json.dumps([str(path) for path in sys.path])],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
            )
        except OSError as error:
            raise NoWorker(
                f"no worker process can be started: {error}; run without worker processes, with 'processes' = 1"
            ) from error

    def send(self, message: object) -> None:
        """Send a message to the worker. If the worker is dead, this is detected only when its answer is read."""
        assert self._process.stdin is not None
        data = pickle.dumps(message)
        with suppress(OSError):
            self._process.stdin.write(data)
            self._process.stdin.flush()

    def receive(self) -> Any:
        """Wait for the worker's answer and return it; raise :class:`WorkerDied` if the worker has ended."""
        assert self._process.stdout is not None
        try:
            return pickle.load(self._process.stdout)
        except EOFError:
            kind = WorkerTerminated if self._process.wait() == -signal.SIGTERM else WorkerDied
            raise kind(f"its process {self._end()}") from None
        except Exception as error:  # Catch everything, because a damaged answer may raise any exception.
            raise WorkerDied(f"its process failed: {type(error).__name__}: {error}") from error

    def wait_until_ready(self) -> None:
        """Wait until the worker process has imported its modules and is ready for jobs."""
        if not self._ready:
            self._ready = self.receive() == (READY,)

    def _end(self) -> str:
        code = self._process.wait()
        if code >= 0:
            return f"ended with exit code {code}"
        known = {each.value: each.name for each in signal.Signals}
        name = known.get(-code, f"signal {-code}")
        return f"was killed by {name}" + ("; the memory may be full: use fewer processes" if name == "SIGKILL" else "")

    def end(self) -> None:
        """Close the pipe that the worker reads from; the worker process then ends."""
        assert self._process.stdin is not None and self._process.stdout is not None
        with suppress(OSError):
            self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()


def serve() -> None:
    """Run jobs from standard input and write the answers to standard output until the parent process ends.

    After a SIGTERM, the job ends the next time it takes measurements, and this process ends after its answer. A second
    SIGTERM ends the process at once.
    """
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # Redirect printed text to stderr, because stdout is the channel for the answers.
    warn_in_one_line()
    # Ignore warnings about unlikely values, because the parent process has shown them already.
    warnings.simplefilter("ignore", PlausibilityWarning)
    terminated: list[int] = []

    def terminate(signum: int, frame: object) -> None:
        terminated.append(signum)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)

    signal.signal(signal.SIGTERM, terminate)
    inbox: queue.Queue[Any] = queue.Queue()
    stop = threading.Event()
    threading.Thread(target=_listen, args=(inbox, stop), daemon=True).start()
    _answer(answers, READY)
    ended = False
    while not ended:
        outcome = _outcome(*inbox.get(), lambda: stop.is_set() or bool(terminated))
        # A SIGTERM that arrives after this line is reported with the answer to the next job.
        ended = bool(terminated)
        _answer(answers, outcome, ended)


def _listen(inbox: queue.Queue[Any], stop: threading.Event) -> None:
    """Receive messages from the parent process until the pipe closes, then end this process.

    Jobs are put into `inbox`, and the message to stop sets `stop`. The pipe closes when the parent process has ended.
    """
    with open(0, "rb", closefd=False) as messages:
        while True:
            try:
                message = pickle.load(messages)
            except BaseException:
                os._exit(1)
            if message == STOP:
                stop.set()
            else:
                inbox.put(message)


def _answer(answers: Any, *message: Any) -> None:
    """Send a message of one or several values to the parent process."""
    try:
        data = pickle.dumps(message)
    except Exception:  # Some exceptions cannot be pickled. Send the text of such an exception instead.
        error, *others = message
        data = pickle.dumps((WarpcreteError(f"{type(error).__name__}: {error}"), *others))
    answers.write(data)
    answers.flush()


def _outcome(function: tuple[str, str], arguments: tuple[object, ...], stop_requested: Callable[[], bool]) -> Any:
    """Return the result of a function that is named by its module and name, or the exception that it raises.

    The function receives `stop_requested` as its last argument.
    """
    try:
        return getattr(importlib.import_module(function[0]), function[1])(*arguments, stop_requested)
    except Exception as error:
        return error
