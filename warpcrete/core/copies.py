"""Arrays of a GPU as they are at one moment, which come to the host while the run goes on."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import warp as wp

LARGEST = 16 * 2**20
"""Of larger arrays there are no copies on the way, of which each of eight moments that wait would have its own [B]."""


@functools.cache
def _side_stream(alias: str) -> Any:
    return wp.Stream(alias)


class Copy:
    """On its way to the host; `read` waits for it, in any thread, once."""

    def __init__(self, buffers: tuple[wp.array, wp.array], home: list[tuple[wp.array, wp.array]], arrived: Any) -> None:
        self._buffers, self._home, self._arrived = buffers, home, arrived

    def read(self) -> np.ndarray:
        """What the array held."""
        wp.synchronize_event(self._arrived)
        values = self._buffers[1].numpy().copy()
        self._home.append(self._buffers)
        return values


class Copies:
    """Makes them, for the run's thread: it asks for all that a GPU has to do, so that no other one needs Warp.

    An array is copied on the device behind the steps that are under way, and from there to the host beside those that
    follow. Buffers are used again.
    """

    def __init__(self) -> None:
        self._free: dict[str, tuple[tuple[int, ...], list[tuple[wp.array, wp.array]]]] = {}

    def take(self, name: str, array: wp.array) -> np.ndarray | Copy:
        """What an array holds now: at once, or on its way where the run would have to wait for it."""
        device: Any = array.device
        if device.is_cpu:
            return array.numpy().copy()  # `numpy` gives the array itself, which the run goes on with
        if array.size == 0 or array.size * wp.types.type_size_in_bytes(array.dtype) > LARGEST:
            return array.numpy()
        shape, home = self._free.get(name, (None, []))
        if shape != array.shape:
            home = []
            self._free[name] = array.shape, home
        if home:
            here, there = home.pop()
        else:
            here = wp.empty_like(array)
            there = wp.empty(array.shape, dtype=array.dtype, device="cpu", pinned=True)
        main, side = device.stream, _side_stream(device.alias)
        wp.copy(here, array)
        side.wait_event(main.record_event())
        wp.copy(there, here, stream=side)
        return Copy((here, there), home, side.record_event())
