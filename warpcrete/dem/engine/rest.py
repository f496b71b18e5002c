"""Growth of bonds and of the wall layer while concrete rests, by a law instead of time steps (Roussel 2006)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp

from ...core.device.launching import Stage
from ...kernels.dem.structure import breakdown_kernel
from ..laws import LubricationLayer
from ..scene.scene import Bonds, Scene


def bonds_after_rest(scene: Scene) -> Bonds | None:
    """Return the scene's bonds after its rest; None if it has no bonds, or never rests."""
    if scene.rest is None or scene.bonds is None:
        return None
    gained = scene.rest.gained
    return replace(
        scene.bonds, tensile_strength=scene.bonds.tensile_strength + gained, cohesion=scene.bonds.cohesion + gained
    )


def has_layer(scene: Scene, law: type) -> bool:
    """Return whether the scene rests and the walls' contact `law` has a layer, whose yield stress grows at rest."""
    return scene.rest is not None and issubclass(law, LubricationLayer)


class Structure:
    """Yield stress that the lubrication layers of a batch's scenes gained at rest; slip along the wall wears it off.

    The gain decays as gained * exp(-slip / breakdown), where slip is the travel of `Rest.wall` since the rest.
    """

    def __init__(self, batch: Any) -> None:
        """Set up the wall layers of a :class:`Batch`, all of whose scenes have a layer that gains strength at rest."""
        self.batch = batch
        # The model's parameters are constant, so the batch stores the changing yield stress in a copy of them.
        batch.wall_parameters = wp.clone(batch.wall_parameters)
        own = [law["yield_stress"] for law in batch.wall_parameters.numpy()]
        self._own_yield = wp.array(np.array(own, dtype=float), dtype=batch.scalar, device=batch.device)
        walls = [
            int(batch.rows["walls"][s]) + next(k for k, w in enumerate(m.walls) if w.name == m.scene.rest.wall)
            for s, m in enumerate(batch.models)
        ]
        self._slip_wall = wp.array(walls, dtype=wp.int32, device=batch.device)
        self._breakdown = self._numbers([m.scene.rest.breakdown for m in batch.models])
        self._gained, self._travel_at_rest = np.zeros(batch.count), np.zeros(batch.count)
        self._device_gained, self._device_begun = self._numbers(self._gained), self._numbers(self._travel_at_rest)

    def _numbers(self, values: Any) -> wp.array:
        return wp.array(np.asarray(values, dtype=float), dtype=wp.float64, device=self.batch.device)

    def stage(self) -> Stage:
        """Return the launch that computes the yield stress of each scene's layer for the next step."""
        b = self.batch
        return b.stage(
            breakdown_kernel(b.scalar, b.features.wall_law), b.count, own_yield=self._own_yield,
            gained=self._device_gained, breakdown=self._breakdown, begun=self._device_begun, slip_wall=self._slip_wall,
        )  # fmt: skip

    def grow(self, s: int, begun: float) -> None:
        """Add the gain at rest to the yield stress of the layer of scene `s`, minus the part that slip has worn off.

        Slip is the travel of the wall beyond `begun` [m], its travel at the rest.
        """
        self._set(s, self.batch.models[s].scene.rest.layer_gained, begun)

    def take(self, s: int, other: Structure, index: int) -> None:
        """Copy the gain and the slip of the layer of scene `index` of another batch to scene `s` of this batch."""
        self._set(s, other._gained[index], other._travel_at_rest[index])

    def _set(self, s: int, gained: float, begun: float) -> None:
        self._gained[s], self._travel_at_rest[s] = gained, begun
        self._device_gained.assign(self._gained)
        self._device_begun.assign(self._travel_at_rest)
        self.stage()()
