"""Yield stress of the lubrication layer, which grows at rest and decreases by slip (Roussel 2006)."""

from __future__ import annotations

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from ...core.device.arrays import DeviceArray, clone
from ...core.device.launching import Stage
from ...kernels.dem.structure import breakdown_kernel
from ..scene.scene import Rest, Scene
from .batch_protocol import SceneBatch


def _rest_of(scene: Scene) -> Rest:
    assert scene.rest is not None
    return scene.rest


class Structure:
    """Yield stress that the lubrication layers on walls have gained while the concrete stood still.

    The layers lose this gain when they slip. Each scene of a batch has its own gain. After the slip s [m], the fraction
    exp(-s / `Rest.breakdown`) of the gain is left. The slip is taken to be the distance that the wall `Rest.wall` has
    travelled since the rest.
    """

    def __init__(self, batch: SceneBatch) -> None:
        """Prepare the layers of a batch in which every scene has a lubrication layer that gains strength at rest."""
        self.batch = batch
        # The yield stress of the layer changes during the run, but the contact parameters in the model must not change.
        # The batch therefore updates the yield stress in a copy of the wall parameters.
        batch.wall_parameters = clone(batch.wall_parameters)
        own = [law["yield_stress"] for law in batch.wall_parameters.numpy()]
        self._own_yield = DeviceArray(np.array(own, dtype=float), dtype=batch.scalar, device=batch.device)
        walls = [
            int(batch.rows["walls"][s]) + next(k for k, w in enumerate(m.walls) if w.name == _rest_of(m.scene).wall)
            for s, m in enumerate(batch.models)
        ]
        self._slip_wall = DeviceArray(walls, dtype=wp.int32, device=batch.device)
        self._breakdown = self._numbers([_rest_of(m.scene).breakdown for m in batch.models])
        self._gained, self._travel_at_rest = np.zeros(batch.count), np.zeros(batch.count)
        self._device_gained, self._device_begun = self._numbers(self._gained), self._numbers(self._travel_at_rest)

    def _numbers(self, values: ArrayLike) -> DeviceArray:
        return DeviceArray(np.asarray(values, dtype=float), dtype=wp.float64, device=self.batch.device)

    def stage(self) -> Stage:
        """Return the launch that computes the current yield stress of each scene's lubrication layer.

        The layer gained yield stress while the concrete was at rest. The more the layer has slipped along the wall
        since the rest, the more of this gain it has lost.
        """
        b = self.batch
        return b.stage(
            breakdown_kernel(b.scalar, b.features.wall_law), b.count, own_yield=self._own_yield,
            gained=self._device_gained, breakdown=self._breakdown, begun=self._device_begun, slip_wall=self._slip_wall,
        )  # fmt: skip

    def grow(self, s: int, begun: float) -> None:
        """Add the yield stress that the lubrication layer of scene `s` gained at rest.

        Slip after the rest reduces this gain again. The slip is the distance [m] that the wall `Rest.wall` has moved
        since the rest. `begun` is the total distance [m] that this wall had moved by the time of the rest.
        """
        self._set(s, _rest_of(self.batch.models[s].scene).layer_gained, begun)

    def take(self, s: int, other: Structure, index: int) -> None:
        """Copy the data of the lubrication layer of a scene that has moved from another batch to this batch.

        The scene had the index `index` in the batch of `other` and has the index `s` in this batch. The copied values
        are the gained yield stress [Pa] and the travel of the wall at the time of the rest [m].
        """
        self._set(s, other._gained[index], other._travel_at_rest[index])

    def _set(self, s: int, gained: float, begun: float) -> None:
        self._gained[s], self._travel_at_rest[s] = gained, begun
        self._device_gained.assign(self._gained)
        self._device_begun.assign(self._travel_at_rest)
        self.stage()()
