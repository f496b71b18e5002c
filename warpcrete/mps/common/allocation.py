"""Allocation of the device arrays that are members of the kernels' structs."""

from typing import Any

import numpy as np
import warp as wp


def allocate(struct: Any, device: wp.Device | str | None, into: object = None, **values: object) -> Any:
    """Fill members of a kernel struct with new device arrays, and return the struct.

    The struct is `into`, or a new instance of `struct` if `into` is None. Each keyword argument names a member. Its
    value is either host data to copy to the device, or a number of elements, for an array of zeros.
    """
    filled_struct = struct() if into is None else into
    for name, value in values.items():
        make = wp.zeros if np.ndim(value) == 0 else wp.array
        setattr(filled_struct, name, make(value, dtype=struct.vars[name].type.dtype, device=device))
    return filled_struct
