"""Whether threads that wait for one another many times a step have a core each, on a machine that others use too.

Where another process wants a core, the thread that shares it is late at every barrier by a slice of the scheduler,
milliseconds, and all wait for it. Then one thread had better do the work of all, chunk by chunk: what it computes is
the same. Threads that are as many as the cores take one each.
"""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Callable
from pathlib import Path

WINDOW = 0.01
"""Time of stepping [s] from one look at the threads to the next."""
LATE = 0.4
"""Part of that time that threads may wait for a core."""
HOLD = 0.5, 8.0
"""Shortest and longest time [s] that one thread does the work of all before they are tried again."""


def own_cores(threads: int) -> Callable[[], None]:
    """What each of so many threads does first: it takes a core for itself, where there are as many as threads.

    A system may wake two threads on one core and move one of them only milliseconds later. Where threads are fewer than
    cores it is left to find free ones.
    """
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
    places = iter(cores)

    def take() -> None:
        if len(cores) == threads:
            with contextlib.suppress(OSError):  # a core may be taken from this process meanwhile
                os.sched_setaffinity(0, {next(places)})  # of the thread that calls

    return take


def waited(thread: int) -> float:
    """Time that a thread of this process was ready to run and had no core [s]; 0 where the system does not say."""
    try:
        return 1e-9 * int(Path(f"/proc/self/task/{thread}/schedstat").read_text(encoding="utf-8").split()[1])
    except (OSError, ValueError, IndexError):
        return 0.0


class Crowding:
    """Watches threads, and says whether they had better be one."""

    def __init__(self) -> None:
        self.crowded = False
        self._threads: set[int] = set()
        self._stepped = self._late = 0.0
        self._until = 0.0
        self._hold = HOLD[0]
        self._sure = self._suspected = False

    def enter(self) -> None:
        """To be called by each thread when it sets out."""
        self._threads.add(threading.get_native_id())

    @property
    def on_trial(self) -> bool:
        """Nobody knows yet whether there are cores enough: the next steps had better be few."""
        return not self.crowded and not self._sure

    def look(self) -> bool:
        """Whether one thread is to do the next steps of all."""
        if self.crowded and time.monotonic() > self._until:
            self.crowded = self._sure = False
            self._stepped, self._late = 0.0, sum(map(waited, self._threads))
        return self.crowded

    def stepped(self, seconds: float) -> None:
        """So much time was spent on steps by all threads; none of them runs now."""
        self._stepped += seconds
        if self._stepped < WINDOW:
            return
        late = sum(map(waited, self._threads))
        if late - self._late <= LATE * self._stepped:
            self._sure, self._suspected, self._hold = True, False, HOLD[0]
        elif not self._suspected:
            self._sure, self._suspected = False, True  # one late window may be chance
        else:
            self.crowded, self._suspected = True, False
            self._until = time.monotonic() + self._hold
            self._hold = min(2 * self._hold, HOLD[1])  # each time in vain the next try is later
        self._stepped, self._late = 0.0, late
