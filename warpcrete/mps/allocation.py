"""Allocation of the device arrays in structs of the kernels."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp


def allocate(struct: Any, device: Any, into: Any = None, **values: Any) -> Any:
    """Return an instance of a struct, a new one or `into`, after setting some of its members to device arrays.

    A value is host data, which is copied, or the size of an array of zeros.
    """
    made = struct() if into is None else into
    for name, value in values.items():
        make = wp.zeros if np.ndim(value) == 0 else wp.array
        setattr(made, name, make(value, dtype=struct.vars[name].type.dtype, device=device))
    return made
