"""What recorders draw, taken from a run that goes on: read once for all of them, and from a GPU while it works on."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import warp as wp

from .exchange import Beside

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
        self._free: dict[tuple[str, ...], tuple[Any, deque[Beside]]] = {}
        self._outdated: list[deque[Beside]] = []
        self._one: wp.array | None = None

    def one(self, device: Any) -> wp.array:
        """A 1 on a device, shape (1,)."""
        if self._one is None:
            self._one = wp.ones(1, dtype=wp.int32, device=device)
        return self._one

    def take(self, arrays: Mapping[str, wp.array], device: Any) -> tuple[Beside, deque[Beside]]:
        """Memory for copies of arrays, and where it is to be put back. What they had when they were of other sizes, or
        at other places, is given up.
        """
        names, where = tuple(arrays), [(array.ptr, array.shape, array.dtype) for array in arrays.values()]
        if names not in self._free or self._free[names][0] != where:
            if names in self._free:
                self._outdated.append(self._free[names][1])
            self._free[names] = where, deque()
        for outdated in self._outdated:  # here, since no recorder's thread is to give memory back to the driver
            outdated.clear()
        free = self._free[names][1]
        # Other threads put back; one alone takes.
        return free.pop() if free else Beside([*arrays.values()], device), free


class Arriving:
    """Copies of arrays that a GPU makes in the order of its work, after what it was told before and before what it is
    told next. The last of them is a flag, so that who waits asks nothing of the driver, which refuses while the run
    captures a graph. Their memory goes back to the pool when nobody has this any more.
    """

    def __init__(self, arrays: Mapping[str, wp.array], pool: Pool) -> None:
        device = next(iter(arrays.values())).device
        wanted = {**arrays, "": pool.one(device)}
        self._beside, self._back = pool.take(wanted, device)
        self._views = dict(zip(wanted, self._beside.views))
        self._views[""][0] = 0
        self._beside.take([*wanted.values()])

    def __del__(self) -> None:
        # Memory that the device may still write to is nobody else's.
        if hasattr(self, "_views") and self._views[""][0] == 1:
            self._back.append(self._beside)

    def __getitem__(self, name: str) -> np.ndarray:
        """A copy once it is there, to be read as long as this is held."""
        flag, begun = self._views[""], time.monotonic()
        while flag[0] == 0:
            if time.monotonic() - begun > LONGEST:
                raise RuntimeError(f"copying the arrays for drawing from the device took longer than {LONGEST:g} s")
            time.sleep(GLANCE)
        return self._views[name]


@dataclass(frozen=True)
class Moment:
    """What was taken of a run."""

    time: float
    """Simulated [s]."""
    steps: int
    found: dict[str, Any]
    """By the name that it is read by; of what is on its way the copies that have it."""
    worked_out: dict[Hashable, Any] = field(default_factory=dict)
    """From that, by names, for all who draw this moment."""

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
    return Moment(time, steps, {name: found[name] for name in sources}, latest.moment.worked_out)
