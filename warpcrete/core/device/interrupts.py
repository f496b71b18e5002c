"""Handling of Ctrl-C, SIGTERM and SIGHUP: defer them until a block of code has ended, or end runs in an orderly way."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import TypeAlias

from .simulation_protocol import SimulationOnDevice

SIGHUP: signal.Signals | None = getattr(signal, "SIGHUP", None)
"""Signal that tells processes that their terminal has closed; None on Windows."""
SIGNALS = (signal.SIGINT, signal.SIGTERM, *(() if SIGHUP is None else (SIGHUP,)))
Handler: TypeAlias = Callable[[int, FrameType | None], object]


def _handled() -> list[tuple[signal.Signals, Handler]]:
    """Return the interrupt signals that have a handler in Python, each with its handler."""
    return [(number, handler) for number in SIGNALS if callable(handler := signal.getsignal(number))]


def _in_main_thread() -> bool:
    """Return whether this is the main thread, the only one that gets signals and may set their handlers."""
    return threading.current_thread() is threading.main_thread()


@contextmanager
def defer_interrupts() -> Generator[None]:
    """Defer Ctrl-C, SIGTERM and SIGHUP until the `with` block has ended; outside the main thread, do nothing."""
    if not _in_main_thread():
        yield
        return
    caught: list[tuple[int, FrameType | None]] = []
    before = _handled()
    for number, _ in before:
        signal.signal(number, lambda signum, frame: caught.append((signum, frame)))
    try:
        yield
    finally:
        for number, handler in before:
            signal.signal(number, handler)
        for number, handler in before:
            if caught and caught[0][0] == number:
                handler(*caught[0])


@contextmanager
def terminate_as_interrupt(simulation: SimulationOnDevice) -> Generator[None]:
    """Treat SIGTERM like Ctrl-C while `simulation` runs in the `with` block.

    If a SIGTERM arrives while results are written, the program finishes the block first; the signal then ends the
    program. Outside the main thread, and in a program that handles SIGTERM by itself, this context does nothing.
    """
    if not _in_main_thread() or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL:
        yield
        return
    deferred: list[int] = []

    def interrupt(signum: int, frame: FrameType | None) -> None:
        if not simulation.finishing:
            raise KeyboardInterrupt
        deferred.append(signum)

    signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        if deferred:
            signal.raise_signal(signal.SIGTERM)


class StopAtSample:
    """Context in which Ctrl-C ends each of the `simulations` at its next sample, when its time series gets a new row.

    A second Ctrl-C ends the simulations at once. Ctrl-C has no effect while all simulations are writing their results.
    Outside the main thread, this context does nothing.
    """

    def __init__(self, simulations: Sequence[SimulationOnDevice]) -> None:
        self.simulations, self.requested = simulations, False
        self._previous: list[tuple[signal.Signals, Handler]] = []

    def __enter__(self) -> StopAtSample:
        if _in_main_thread():
            self._previous = _handled()
            for number, _ in self._previous:
                signal.signal(number, self._stop)
            _contexts.append(self)
        return self

    @property
    def is_writing(self) -> bool:
        """True while all simulations, if there are any, are writing their results."""
        return bool(self.simulations) and all(simulation.finishing for simulation in self.simulations)

    def _stop(self, signum: int, frame: FrameType | None) -> None:
        if self.requested and signum == SIGHUP:
            return  # Ignore a second SIGHUP: the system and the shell both send it when a terminal closes.
        if self.requested and not self.is_writing:
            raise KeyboardInterrupt
        self.requested = True
        if self.is_writing:
            return
        for simulation in self.simulations:
            simulation.stop_requested = True

    def __exit__(self, *unused: type[BaseException] | BaseException | TracebackType | None) -> None:
        if _in_main_thread():
            _contexts.remove(self)
            for number, handler in self._previous:
                signal.signal(number, handler)


_contexts: list[StopAtSample] = []
"""Active contexts of the main thread, the innermost last."""


def stop_if_requested() -> None:
    """Raise KeyboardInterrupt if Ctrl-C asked the simulations of a :class:`StopAtSample` to end.

    Work that may take long before the next sample calls this function now and then, such as compiling kernels and
    placing aggregates. The function does nothing while results are written, and in other threads than the main one.
    """
    if _in_main_thread() and _contexts:
        context = _contexts[-1]
        if context.requested and context.simulations and not context.is_writing:
            raise KeyboardInterrupt


def ignore_interrupts() -> None:
    """Ignore Ctrl-C and SIGHUP (closed terminal) in a worker process, because its parent process handles them."""
    for number in SIGNALS:
        if number != signal.SIGTERM:
            signal.signal(number, signal.SIG_IGN)
