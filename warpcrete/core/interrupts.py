"""Ctrl-C: put off until a piece of work is whole, or taken as the wish that runs end at their next sample."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any


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
    before = signal.signal(signal.SIGINT, lambda *arguments: caught.append(arguments))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        if caught:
            if callable(before):
                before(*caught[0])
            elif before != signal.SIG_IGN:
                raise KeyboardInterrupt


class StopAtSample:
    """While it is entered, a first Ctrl-C ends every one of `simulations` at its next sample, a second one at once.

    One that is writing its results is not disturbed. Outside the main thread it does nothing.
    """

    def __init__(self, simulations: Sequence[Any]) -> None:
        self.simulations, self.asked = simulations, False
        self._previous: Any = None

    def __enter__(self) -> StopAtSample:
        if _in_main_thread():
            self._previous = signal.signal(signal.SIGINT, self._stop)
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
            signal.signal(signal.SIGINT, self._previous)


def leave_to_parent() -> None:
    """Ignore Ctrl-C in a worker process: its parent hears it, too, and says what is to be done."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
