"""Protocols that declare members of the class `Batch`, for modules that cannot import it without a circular import."""

from typing import Protocol

import numpy as np
import warp as wp

from ...core.device.arrays import DeviceArray, Kernel, Scalar
from ...core.device.launching import Size, Stage
from .model import Features, Model
from .state import State
from .struct_types import Pairs


class BatchArrays(Protocol):
    """Protocol of a batch, for modules that need only the batch's scenes and the sizes of their joint arrays."""

    models: list[Model]
    states: list[State]
    features: Features
    """Features (contact laws, clumps, bonds and others) that all scenes of the batch have in common."""
    scalar: Scalar
    """Scalar type of the kernels, `wp.float32` or `wp.float64`."""
    device: wp.Device
    """Warp device on which all arrays of the batch are stored."""
    parallel: bool
    """True if kernels for GPUs are used, which compute each sphere or body in a thread of its own."""
    threads: int
    """Number of CPU threads that share the work of a step."""
    count: int
    """Number of scenes in the batch."""
    body_count: int
    sphere_count: int
    capacity: np.ndarray
    """Number of neighbour list entries for which each scene has memory, shape (scenes,)."""
    rows: np.ndarray
    """Copy on the host of the parameters of all scenes, as a structured array of shape (scenes,)."""
    wall_parameters: DeviceArray
    """Parameters of the contact laws between bodies and walls, one row for each ordered pair of materials, shape
    (rows,). The rows of all scenes are joined end to end."""
    pairs: Pairs
    """Neighbour lists of all scenes, in a struct `Pairs` of arrays."""


class SceneBatch(BatchArrays, Protocol):
    """Protocol of a batch, for modules that need its scenes and arrays and also record launches of kernels."""

    def stage(
        self, kernel: Kernel, dim: Size, *, on_side_stream: bool = False, joins_side_stream: bool = False,
        every: int = 1, block: int | None = None, **named: object,
    ) -> Stage:  # fmt: skip
        """Return a recorded launch of `kernel` over `dim` tasks; `named` gives arguments by parameter name.

        :class:`Stage` describes the remaining options.
        """
        ...

    def barrier(self) -> list[Stage]:
        """Return a list with the barrier at which CPU threads wait for one another; it is empty for a single thread."""
        ...

    def invalidate_graphs(self) -> None:
        """Discard recorded kernel launches, because they refer to arrays that have been replaced."""
