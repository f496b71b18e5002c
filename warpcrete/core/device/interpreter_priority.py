"""Priority for Python's interpreter lock: a run comes before its recorders, which write its output.

Each call of a run into the device's driver releases the interpreter lock. If a recorder's thread takes the lock during
such a call, the thread keeps it for milliseconds, and the run cannot give the device new work. Recorders therefore work
only while the run waits for the device.
"""

import threading
from collections.abc import Generator
from contextlib import contextmanager

LONGEST_YIELD = 5e-3
"""Longest time [s] for which a thread that writes a run's output waits in one call of :func:`yield_to_run`. The thread
waits until the run is itself waiting for the device and therefore leaves Python's interpreter free. After this time,
the thread goes on even if the run is busy."""

_run_waits = threading.Event()
_count_lock, _waiting_runs = threading.Lock(), 0
"""Lock, and the number of waiting runs of this process, which may be changed only under the lock.

A run waits for its device or for its recorders, which write its output. While any run waits, the recorders of all runs
may work, so that a busy run does not block the recorders of other runs.
"""


@contextmanager
def run_is_waiting() -> Generator[None]:
    """Mark a run as waiting inside the `with` block, so that the threads that write output may work meanwhile."""
    global _waiting_runs
    with _count_lock:
        _waiting_runs += 1
        _run_waits.set()
    try:
        yield
    finally:
        with _count_lock:
            _waiting_runs -= 1
            if _waiting_runs == 0:
                _run_waits.clear()


def yield_to_run() -> None:
    """Wait until a run waits for its device, but not longer than the time `LONGEST_YIELD`."""
    _run_waits.wait(LONGEST_YIELD)
