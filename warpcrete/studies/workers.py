"""Worker processes that run cases. They import this package alone, never the caller's script, and die one by one.

So they work from a plain script without a main guard, from standard input, from a notebook and from a session, and
the death of one, whatever its cause, costs the case that it had.
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

# Ctrl-C is for the parent to hear, from the first moment on: it says what is to be done.
BOOT = """\
import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)
import json, sys; sys.path[:] = json.loads(sys.argv[1])
from warpcrete.studies.workers import serve; serve()
"""
READY, STOP = "ready", "stop"


class WorkerDied(WarpcreteError):
    """A worker process ended before its case did."""


class NoWorker(WarpcreteError):
    """No worker process starts at all."""


class Crew:
    """Worker processes, started as they are needed; any thread may give them work."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._all: list[_Worker] = []
        self._idle: list[_Worker] = []
        self.stopping = False
        """Whether the workers were told to end their cases at the next sample."""

    def __enter__(self) -> Crew:
        return self

    def __exit__(self, *unused: Any) -> None:
        """End all workers, those with a case at once."""
        for worker in self._all:
            worker.end()

    def stop(self) -> None:
        """Tell all workers to end their cases at the next sample."""
        with self._lock:
            self.stopping = True
            for worker in self._all:
                worker.tell(STOP)

    def run(self, *job: Any) -> Any:
        """Return what :func:`_outcome` returns for a job in a worker process; raise :class:`WorkerDied` if it dies."""
        with self._lock:
            worker = self._idle.pop() if self._idle else _Worker()
            if worker not in self._all:
                self._all.append(worker)
            if self.stopping:
                worker.tell(STOP)
        try:
            worker.wait_until_ready()
        except WorkerDied as error:
            with self._lock:
                worker.failed = True
                none = all(each.failed for each in self._all)
            if none:
                raise NoWorker(f"no worker process can be started: {error}; the messages above say why") from error
            raise
        try:
            worker.tell(job)
        except Exception:  # a job that no pickle holds
            with self._lock:
                self._idle.append(worker)
            raise
        found = worker.hear()
        with self._lock:
            self._idle.append(worker)
        return found


class _Worker:
    def __init__(self) -> None:
        self._ready = False
        self.failed = False
        """It ended before it was ready."""
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-c", BOOT, json.dumps([str(path) for path in sys.path])],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            )  # fmt: skip
        except OSError as error:
            raise NoWorker(f"no worker process can be started: {error}; use processes = 1") from error

    def tell(self, message: Any) -> None:
        """Send a message; a worker that has died is found out when its answer is awaited."""
        assert self._process.stdin is not None
        data = pickle.dumps(message)
        with suppress(OSError):
            self._process.stdin.write(data)
            self._process.stdin.flush()

    def hear(self) -> Any:
        """Wait for an answer."""
        assert self._process.stdout is not None
        try:
            return pickle.load(self._process.stdout)
        except EOFError:
            raise WorkerDied(f"its process {self._end()}") from None
        except Exception as error:  # the answer itself cannot be read
            raise WorkerDied(f"its process failed: {type(error).__name__}: {error}") from error

    def wait_until_ready(self) -> None:
        """Wait until the worker has imported what it needs."""
        if not self._ready:
            self._ready = self.hear() == READY

    def _end(self) -> str:
        code = self._process.wait()
        if code >= 0:
            return f"ended with exit code {code}"
        known = {each.value: each.name for each in signal.Signals}
        name = known.get(-code, f"signal {-code}")
        return f"was killed by {name}" + ("; the memory may be full: use fewer processes" if name == "SIGKILL" else "")

    def end(self) -> None:
        """Close the pipe that the worker listens to, which ends it."""
        assert self._process.stdin is not None and self._process.stdout is not None
        with suppress(OSError):
            self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()


def serve() -> None:
    """Run the jobs that come on standard input, and answer on standard output, until the parent has gone."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever is printed must not get among the answers
    warn_in_one_line()
    warnings.simplefilter("ignore", PlausibilityWarning)  # the parent has given them
    inbox: queue.Queue[Any] = queue.Queue()
    stop = threading.Event()
    threading.Thread(target=_listen, args=(inbox, stop), daemon=True).start()
    _answer(answers, READY)
    while True:
        _answer(answers, _outcome(*inbox.get(), stop.is_set))


def _listen(inbox: queue.Queue[Any], stop: threading.Event) -> None:
    """Take messages; at their end the parent is gone, whatever it died of, and nobody is left to run cases for."""
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


def _answer(answers: Any, message: Any) -> None:
    try:
        data = pickle.dumps(message)
    except Exception:  # an error with contents that no pickle holds
        data = pickle.dumps(WarpcreteError(f"{type(message).__name__}: {message}"))
    answers.write(data)
    answers.flush()


def _outcome(function: tuple[str, str], arguments: tuple[Any, ...], asked: Callable[[], bool]) -> Any:
    """Return what a function of a module returns, or the exception that it raises."""
    try:
        return getattr(importlib.import_module(function[0]), function[1])(*arguments, asked)
    except Exception as error:
        return error
