"""Batch as its parts see it; the parts cannot name its class, because the batch imports them."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import warp as wp

from ...core.device.arrays import DeviceArray, Kernel, Scalar
from ...core.device.launching import Size, Stage
from .model import Features, Model
from .state import State
from .struct_types import Pairs


class BatchArrays(Protocol):
    """Scenes of a batch, and the sizes of their joint arrays."""

    models: list[Model]
    states: list[State]
    features: Features
    """Features that all scenes of the batch have in common."""
    scalar: Scalar
    """Scalar type of the kernels, `wp.float32` or `wp.float64`."""
    device: wp.Device
    """Warp device of all arrays."""
    parallel: bool
    """True if kernels are written for a GPU, with one thread for each row."""
    threads: int
    """Number of CPU threads that share the work."""
    count: int
    """Number of scenes."""
    body_count: int
    sphere_count: int
    capacity: np.ndarray
    """Allocated number of entries of each scene's pair arrays, shape (scenes,)."""
    rows: np.ndarray
    """Host copy of the parameters of all scenes."""
    wall_parameters: DeviceArray
    """Parameters of the contact laws of bodies with walls, for all scenes end to end."""
    pairs: Pairs
    """Neighbour lists of all scenes, a struct `Pairs`."""


class SceneBatch(BatchArrays, Protocol):
    """Batch with its kernel launches."""

    def stage(
        self, kernel: Kernel, dim: Size, *, on_side_stream: bool = False, joins_side_stream: bool = False,
        every: int = 1, block: int | None = None, **named: object,
    ) -> Stage:  # fmt: skip
        """Return a recorded launch of `kernel` over `dim` tasks."""
        ...

    def barrier(self) -> list[Stage]:
        """Return the stage at which CPU threads wait for one another, or no stage if there is one thread."""
        ...

    def invalidate_graphs(self) -> None:
        """Discard recorded launches, because arrays have been replaced."""
