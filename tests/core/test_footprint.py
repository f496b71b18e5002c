"""Memory is that of arrays that own it, counted once."""

from types import SimpleNamespace

import numpy as np
import warp as wp

from warpcrete.core.device.device import quiet_init
from warpcrete.core.device.footprint import footprint


def test_views_and_foreign_memory_count_for_their_owners():
    quiet_init()
    own, other = (wp.zeros(count, dtype=wp.float64, device="cpu") for count in (100, 50))
    numbers = np.zeros(1000)
    foreign = wp.array(numbers, dtype=wp.float64, device="cpu", copy=False)
    address = wp.array(ptr=numbers.ctypes.data, shape=1000, capacity=8000, dtype=wp.float64, device="cpu")
    found = footprint(
        first=[own, own[:10], {"x": (foreign, address)}],
        second={"again": own, "other": other},
        third=[other[5:], wp.zeros(0, dtype=float, device="cpu")],
        fourth=SimpleNamespace(x=own),
    )
    assert found == {"first": own.capacity, "second": other.capacity, "third": 0, "fourth": 0}
    assert footprint(view=[other[5:]]) == {"view": other.capacity}
