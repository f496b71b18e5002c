"""Who has the interpreter first: a run that has work for its device, before recorders that go on beside it.

Each call of a run into the device's driver lets go of the interpreter, and a recorder's thread that takes it keeps it
for milliseconds, in which the device has nothing to do. So recorders work while the run waits for the device.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

PATIENCE = 5e-3
"""For how long a recorder gives way at a time [s]: a run that never waits must not keep it from its work."""

_waits = threading.Event()
_counting, _waiting = threading.Lock(), 0
"""Runs of this process that wait: one that goes on must not keep the recorders of another."""


@contextmanager
def waiting() -> Iterator[None]:
    """A run waits for its device, or for its recorders, until the end of the context."""
    global _waiting
    with _counting:
        _waiting += 1
        _waits.set()
    try:
        yield
    finally:
        with _counting:
            _waiting -= 1
            if _waiting == 0:
                _waits.clear()


def give_way() -> None:
    """Until a run waits."""
    _waits.wait(PATIENCE)
