"""Copies of a run's state for drawing (snapshots).

All recorders share each copied value. A GPU goes on with the simulation while its values are copied.
"""

import time
from collections import deque
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import warp as wp

from ..device.arrays import DeviceArray, host_copy, ones
from ..device.exchange import PinnedBuffers
from ..device.simulation_protocol import DrawnSimulation

COPY_TIMEOUT = 60.0
"""Maximum time that copies from a device may take to arrive before an error is raised [s]."""
POLL_INTERVAL = 1e-3
"""Time between two checks whether the copies have arrived from the device [s]. More frequent checks would slow the
simulation down, because it must wait while a check holds Python's interpreter lock."""


def on_host(found: object) -> object:
    """Return a copy of `found` as a NumPy array if it is a Warp array; return any other object unchanged."""
    return host_copy(found) if isinstance(found, DeviceArray) else found


def _is_on_gpu(array: DeviceArray) -> bool:
    return bool(wp.get_device(array.device).is_cuda)


class PinnedPool:
    """Pool of page-locked memory for asynchronous copies from a GPU; memory is reused because allocation is slow."""

    def __init__(self) -> None:
        self._free: dict[tuple[str, ...], tuple[Sequence[object], deque[PinnedBuffers]]] = {}
        self._outdated_queues: list[deque[PinnedBuffers]] = []
        self._arrival_flag: DeviceArray | None = None

    def arrival_flag(self, device: wp.Device) -> DeviceArray:
        """Return a device array of shape (1,) with the value 1.

        The array is copied to the host after all other arrays. When the 1 has arrived, all other copies have arrived.
        """
        if self._arrival_flag is None:
            self._arrival_flag = ones(1, dtype=wp.int32, device=device)
        return self._arrival_flag

    def take(self, arrays: Mapping[str, DeviceArray], device: wp.Device) -> tuple[PinnedBuffers, deque[PinnedBuffers]]:
        """Return page-locked memory for copies of `arrays`, and the queue into which the caller puts it after use.

        The queue belongs to the pool and contains free memory for these arrays. The pool frees memory that it holds for
        arrays with the same names but other sizes or addresses.
        """
        names, where = tuple(arrays), [(array.ptr, array.shape, array.dtype) for array in arrays.values()]
        if names not in self._free or self._free[names][0] != where:
            if names in self._free:
                self._outdated_queues.append(self._free[names][1])
            self._free[names] = where, deque()
        # Free outdated memory here, in the run's thread, because a recorder's thread must not call the CUDA driver.
        for queue in self._outdated_queues:
            queue.clear()
        free = self._free[names][1]
        # No lock is needed: several threads return memory to this queue, but only one thread takes memory from it.
        return free.pop() if free else PinnedBuffers([*arrays.values()], device), free


class PendingCopies:
    """Asynchronous copies of GPU arrays; they contain the results of all work that was launched before.

    The last copy is a flag, and a reader polls this flag in page-locked memory. The reader therefore makes no call to
    the driver, which refuses calls while the run captures a graph. The page-locked memory returns to the pool when
    this object is deleted.
    """

    def __init__(self, arrays: Mapping[str, DeviceArray], pool: PinnedPool) -> None:
        device = next(iter(arrays.values())).device
        sources_and_flag = {**arrays, "": pool.arrival_flag(device)}
        self._buffers, self._return_queue = pool.take(sources_and_flag, device)
        self._views = dict(zip(sources_and_flag, self._buffers.views))
        self._views[""][0] = 0
        self._buffers.gather([*sources_and_flag.values()])

    def __del__(self) -> None:
        # The page-locked memory must not be reused while the device may still write to it.
        if hasattr(self, "_views") and self._views[""][0] == 1:
            self._return_queue.append(self._buffers)

    def __getitem__(self, name: str) -> np.ndarray:
        """Wait for the copy of the array called `name`, and return the copy, which is valid while this object exists.

        Raises RuntimeError if the copies do not arrive within the time `COPY_TIMEOUT`.
        """
        flag, start = self._views[""], time.monotonic()
        while flag[0] == 0:
            if time.monotonic() - start > COPY_TIMEOUT:
                raise RuntimeError(
                    f"copying the arrays for drawing from the device took longer than {COPY_TIMEOUT:g} s"
                )
            time.sleep(POLL_INTERVAL)
        return self._views[name]


@dataclass(frozen=True)
class Snapshot:
    """State of a run at one time, copied for drawing while the run goes on."""

    time: float
    """Simulated time of the snapshot [s]."""
    steps: int
    values: dict[str, object]
    """Values of the snapshot by name. For a value whose copy to the host is in flight, the entry is the
    :class:`PendingCopies` object that receives the copy."""
    derived: dict[Hashable, Any] = field(default_factory=dict[Hashable, Any])
    """Results computed from values of this snapshot, by name; all views of the simulation share them."""

    def read(self, name: str) -> object:
        """Return the value stored under `name`; if it is a copy in flight, wait until the copy has arrived."""
        value = self.values[name]
        return value[name] if isinstance(value, PendingCopies) else value


class _Latest:
    """Latest snapshot of a simulation, which is a copy of its state, and the memory pool for its next snapshots."""

    def __init__(self) -> None:
        self.snapshot = Snapshot(float("nan"), -1, {})
        self.pool = PinnedPool()


_latest: WeakKeyDictionary[DrawnSimulation, _Latest] = WeakKeyDictionary()


def snapshot_of(simulation: DrawnSimulation, sources: Mapping[str, Callable[[], object]]) -> Snapshot:
    """Return a snapshot of a simulation's state: the result of each function in `sources`, by the function's key.

    If several views of the simulation request the same name at the same step, its function is called only once.
    """
    latest = _latest.setdefault(simulation, _Latest())
    time, steps = simulation.stepper.time, simulation.stepper.steps
    if (latest.snapshot.time, latest.snapshot.steps) != (time, steps):
        latest.snapshot = Snapshot(time, steps, {})
    values = latest.snapshot.values
    new = {name: source() for name, source in sources.items() if name not in values}
    arrays = {name: value for name, value in new.items()
              if isinstance(value, DeviceArray) and value.size and _is_on_gpu(value)}  # fmt: skip
    values |= {name: on_host(value) for name, value in new.items() if name not in arrays}
    if arrays:
        values |= dict.fromkeys(arrays, PendingCopies(arrays, latest.pool))
    # Copy the dictionary, because other displays may add values to it while this snapshot is drawn.
    return Snapshot(time, steps, {name: values[name] for name in sources}, latest.snapshot.derived)
