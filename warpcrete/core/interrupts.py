"""Ctrl-C, and SIGTERM where the program takes it as such: put off until a piece of work is whole, or taken as the wish
that runs end at their next sample."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM)


def _handled() -> list[tuple[int, Any]]:
    """Return the signals that a Python function handles, and that function."""
    return [(number, found) for number in SIGNALS if callable(found := signal.getsignal(number))]


def _in_main_thread() -> bool:
    """Only the main thread gets signals, and only it may say what they do."""
    return threading.current_thread() is threading.main_thread()


@contextmanager
def put_off() -> Iterator[None]:
    """Let a Ctrl-C wait until the block is left. Outside the main thread it does nothing."""
    if not _in_main_thread():
        yield
        return
    caught: list[tuple] = []
    before = _handled()
    for number, _ in before:
        signal.signal(number, lambda *arguments: caught.append(arguments))
    try:
        yield
    finally:
        for number, handler in before:
            signal.signal(number, handler)
        for number, handler in before:
            if caught and caught[0][0] == number:
                handler(*caught[0])


class StopAtSample:
    """While it is entered, a first Ctrl-C ends every one of `simulations` at its next sample, a second one at once.

    One that is writing its results is not disturbed. Outside the main thread it does nothing.
    """

    def __init__(self, simulations: Sequence[Any]) -> None:
        self.simulations, self.asked = simulations, False
        self._previous: list[tuple[int, Any]] = []

    def __enter__(self) -> StopAtSample:
        if _in_main_thread():
            self._previous = _handled()
            for number, _ in self._previous:
                signal.signal(number, self._stop)
        return self

    def _stop(self, signum: int, frame: Any) -> None:
        writing = bool(self.simulations) and all(simulation.finishing for simulation in self.simulations)
        if self.asked and not writing:
            raise KeyboardInterrupt
        self.asked = True
        if writing:
            return
        for simulation in self.simulations:
            simulation.stop_requested = True

    def __exit__(self, *unused: Any) -> None:
        if _in_main_thread():
            for number, handler in self._previous:
                signal.signal(number, handler)


def leave_to_parent() -> None:
    """Ignore Ctrl-C in a worker process: its parent hears it, too, and says what is to be done."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
