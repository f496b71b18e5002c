"""Allocation of the device arrays that are members of the kernels' structs."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp


def allocate(struct: Any, device: Any, into: Any = None, **values: Any) -> Any:
    """Set members of a kernel struct to new device arrays, and return the struct.

    `into` is the instance to change; without it a new instance is created. For each member, the value is either host
    data, which is copied to the device, or the size of an array of zeros.
    """
    made = struct() if into is None else into
    for name, value in values.items():
        make = wp.zeros if np.ndim(value) == 0 else wp.array
        setattr(made, name, make(value, dtype=struct.vars[name].type.dtype, device=device))
    return made
