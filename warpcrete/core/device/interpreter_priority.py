"""Priority of a run over its recorders in the use of Python's interpreter lock.

Each call of a run into the device's driver releases the interpreter lock. If a recorder's thread takes the lock then,
it keeps the lock for milliseconds, in which the device has no work. Recorders therefore work only while the run waits
for the device.
"""

from __future__ import annotations

import threading
from collections.abc import Generator
from contextlib import contextmanager

LONGEST_YIELD = 5e-3
"""Longest time of a single wait of a recorder for the run [s], so that a busy run cannot block the recorder."""

_run_waits = threading.Event()
_count_lock, _waiting_runs = threading.Lock(), 0
"""Lock, and number of runs of this process that are waiting. If one run waits, all recorders may work: a busy run must
not block the recorders of another run."""


@contextmanager
def run_is_waiting() -> Generator[None]:
    """Mark a run as waiting for its device or its recorders while the block runs, so that recorders may work."""
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
