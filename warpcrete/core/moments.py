"""What recorders draw, taken from a run that goes on: read once for all of them, and from a GPU while it works on."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import warp as wp

LONGEST = 60.0
"""That copies from a device may take to arrive [s]."""
GLANCE = 1e-3
"""Between looks whether they have [s]: each takes the interpreter from the run."""


def on_host(found: Any) -> Any:
    """An array of a device as a NumPy array of its own; anything else as it is."""
    if not isinstance(found, wp.array):
        return found
    # On a CPU `numpy` gives the array itself, which the run goes on with.
    return found.numpy() if _is_on_gpu(found) else found.numpy().copy()


def _is_on_gpu(array: wp.array) -> bool:
    return bool(wp.get_device(array.device).is_cuda)


class Pool:
    """Page-locked memory, which a GPU writes to while the host goes on, kept for the next time: it is slow to get."""

    def __init__(self) -> None:
        self._free: dict[Any, deque[wp.array]] = {}
        self._one: wp.array | None = None

    def one(self, device: Any) -> wp.array:
        """A 1 on a device, shape (1,)."""
        if self._one is None:
            self._one = wp.ones(1, dtype=wp.int32, device=device)
        return self._one

    def take(self, like: wp.array) -> wp.array:
        """Memory for a copy of an array."""
        free = self._free.setdefault((like.shape, like.dtype), deque())
        # Other threads give back; one alone takes.
        return free.pop() if free else wp.empty(like.shape, dtype=like.dtype, device="cpu", pinned=True)

    def give(self, array: wp.array) -> None:
        """Back, for others to write to."""
        self._free[array.shape, array.dtype].append(array)


class Arriving:
    """Copies of arrays that a GPU makes in the order of its work, after what it was told before and before what it is
    told next. The last of them is a flag, so that who waits asks nothing of the driver, which refuses while the run
    captures a graph. Their memory goes back to the pool when nobody has this any more.
    """

    def __init__(self, arrays: Mapping[str, wp.array], pool: Pool) -> None:
        self._pool = pool
        self._copies: dict[str, wp.array] = {}
        for name, array in arrays.items():
            self._copies[name] = copy = pool.take(array)
            wp.copy(copy, array)
        raised = pool.one(next(iter(arrays.values())).device)
        self._flag = pool.take(raised)
        self._flag.numpy()[0] = 0
        wp.copy(self._flag, raised)

    def __del__(self) -> None:
        # Memory that the device may still write to is nobody else's.
        if hasattr(self, "_flag") and self._flag.numpy()[0] == 1:
            for array in (*self._copies.values(), self._flag):
                self._pool.give(array)

    def __getitem__(self, name: str) -> np.ndarray:
        """A copy once it is there, to be read as long as this is held."""
        flag, begun = self._flag.numpy(), time.monotonic()
        while flag[0] == 0:
            if time.monotonic() - begun > LONGEST:
                raise RuntimeError(f"copies of what is drawn have not come from the device within {LONGEST:g} s")
            time.sleep(GLANCE)
        return self._copies[name].numpy()


@dataclass(frozen=True)
class Moment:
    """What was taken of a run."""

    time: float
    """Simulated [s]."""
    steps: int
    found: dict[str, Any]
    """By the name that it is read by; of what is on its way the copies that have it."""

    def read(self, name: str) -> Any:
        """What was found under a name, once it is there."""
        found = self.found[name]
        return found[name] if isinstance(found, Arriving) else found


class _Latest:
    """The last moment of a simulation that was taken, and memory for the next."""

    def __init__(self) -> None:
        self.moment = Moment(float("nan"), -1, {})
        self.pool = Pool()


_latest: WeakKeyDictionary[Any, _Latest] = WeakKeyDictionary()


def moment_of(simulation: Any, sources: Mapping[str, Callable[[], Any]]) -> Moment:
    """What `sources` give now, by their names, each read once for all who ask for it at this moment."""
    latest = _latest.setdefault(simulation, _Latest())
    time, steps = simulation.stepper.time, simulation.stepper.steps
    if (latest.moment.time, latest.moment.steps) != (time, steps):
        latest.moment = Moment(time, steps, {})
    found = latest.moment.found
    new = {name: source() for name, source in sources.items() if name not in found}
    arrays = {name: value for name, value in new.items()
              if isinstance(value, wp.array) and value.size and _is_on_gpu(value)}  # fmt: skip
    found |= {name: on_host(value) for name, value in new.items() if name not in arrays}
    if arrays:
        found |= dict.fromkeys(arrays, Arriving(arrays, latest.pool))
    # Others may add to it while this one is drawn.
    return Moment(time, steps, {name: found[name] for name in sources})
