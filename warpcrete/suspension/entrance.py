"""Plane through which aggregates enter a pipe, and the times at which they enter."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from ..core.device.arrays import Scalar
from ..kernels.suspension.entering import entrance_struct
from ..mps.common.allocation import allocate


@dataclass(frozen=True)
class Entrance:
    """Plane that moves with the flow and through which aggregates enter, in the coordinates of the grid."""

    velocity: np.ndarray
    """Velocity of the plane and of all aggregates that have not entered entirely [m/s], shape (3,)."""
    appears: np.ndarray
    """Time from which each aggregate is at least partly in the box of cells [s], shape (n,)."""
    enters: np.ndarray
    """Time at which each aggregate has entered entirely [s], shape (n,); 0 for aggregates inside at the start."""
    gravity: np.ndarray
    """Gravitational acceleration [m/s2], shape (3,)."""

    def on_device(self, centre: np.ndarray, scalar: Scalar, device: wp.Device) -> Any:
        """Return the data of the plane and of the entering aggregates as a struct for kernels.

        `centre` holds the aggregates' centres at the start [m], shape (n, 3).
        """
        struct = allocate(entrance_struct(scalar), device, start=centre, appears=self.appears, enters=self.enters)
        struct.velocity, struct.gravity = self.velocity.tolist(), self.gravity.tolist()
        return struct
