"""Detection of core contention: threads that wait for one another lose time if other processes use their cores.

Threads of a run meet at barriers many times per step. If another process occupies the core of one thread, that thread
arrives late by a time slice of the scheduler (milliseconds), and all other threads wait for it. A single thread that
does the work of all threads is then faster and gives the same results. If there are as many threads as cores, each
thread is pinned to a core of its own.
"""

import contextlib
import os
import threading
import time
from collections.abc import Callable
from pathlib import Path

WINDOW = 0.01
"""Length of a measuring window [s]. After each window of this wall time, the run checks whether other processes
occupied the cores of its threads (core contention)."""
CONTENTION_FRACTION = 0.4
"""Largest acceptable value of a ratio: the time that all threads together waited for a core, divided by the wall time
of the steps. A larger ratio counts as contention."""
BACKOFF_TIMES = 0.5, 8.0
"""Shortest and longest backoff time [s]. If other processes occupied the cores of a run, one thread does all work for
this time; then several threads are tried again."""


def thread_pinner(threads: int) -> Callable[[], None]:
    """Return a function that pins the calling thread to a core, if there are as many cores as threads.

    Each thread calls this function once when it starts. Without pinning, the system may wake two threads on one core
    and move one of them to another core only milliseconds later. With fewer threads than cores, the system chooses free
    cores.
    """
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
    places = iter(cores)

    def pin_to_core() -> None:
        if len(cores) == threads:
            with contextlib.suppress(OSError):  # If the system no longer allows this core, leave the thread unpinned.
                os.sched_setaffinity(0, {next(places)})  # The process id 0 stands for the calling thread.

    return pin_to_core


def core_waiting_time(thread: int) -> float:
    """Return how long a thread has been ready to run without a core, in total since its start [s]; 0 if unknown.

    `thread` is the native id of a thread of this process. Linux reports the time in
    `/proc/self/task/THREAD/schedstat`.
    """
    try:
        return 1e-9 * int(Path(f"/proc/self/task/{thread}/schedstat").read_text(encoding="utf-8").split()[1])
    except (OSError, ValueError, IndexError):
        return 0.0


class CoreContention:
    """Monitor of core contention, which means that other processes use the cores of the run's threads.

    The monitor decides whether one thread should do the work of all threads. Two successive windows of time in which
    threads waited too long for cores count as contention. One thread then does all work for some time. This time lies
    within `BACKOFF_TIMES` and doubles after each failed attempt with several threads.
    """

    def __init__(self) -> None:
        self.contended = False
        self._threads: set[int] = set()
        self._window_time = self._waited_before = 0.0
        self._backoff_end = 0.0
        self._backoff_time = BACKOFF_TIMES[0]
        self._cores_suffice = self._suspected = False

    def register_thread(self) -> None:
        """Register the calling thread, so that the time it waits for a core is monitored."""
        self._threads.add(threading.get_native_id())

    @property
    def is_uncertain(self) -> bool:
        """True as long as it is not known whether the threads have enough cores; the caller should then check often."""
        return not self.contended and not self._cores_suffice

    def use_one_thread(self) -> bool:
        """Return whether one thread should do the next steps for all threads."""
        if self.contended and time.monotonic() > self._backoff_end:
            self.contended = self._cores_suffice = False
            self._window_time, self._waited_before = 0.0, sum(map(core_waiting_time, self._threads))
        return self.contended

    def add_step_time(self, seconds: float) -> None:
        """Add `seconds`, the wall time of steps that used all threads, to the current measuring window.

        When the window has reached the length `WINDOW`, check whether the threads waited too long for a core, and start
        a new window. No thread may be running during this call.
        """
        self._window_time += seconds
        if self._window_time < WINDOW:
            return
        waited_time = sum(map(core_waiting_time, self._threads))
        if waited_time - self._waited_before <= CONTENTION_FRACTION * self._window_time:
            self._cores_suffice, self._suspected, self._backoff_time = True, False, BACKOFF_TIMES[0]
        elif not self._suspected:
            # A single window with long waits may be a coincidence, so react only if the next window has long waits,
            # too.
            self._cores_suffice, self._suspected = False, True
        else:
            self.contended, self._suspected = True, False
            self._backoff_end = time.monotonic() + self._backoff_time
            # Each failed attempt with several threads doubles the time until the next attempt.
            self._backoff_time = min(2 * self._backoff_time, BACKOFF_TIMES[1])
        self._window_time, self._waited_before = 0.0, waited_time
