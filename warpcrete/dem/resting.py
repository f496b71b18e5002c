"""Concrete that has stood: bonds and the layer on the walls, grown by a law instead of by steps (Roussel 2006)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp

from ..core.launching import Stage
from ..kernels.dem.structure import wear_kernel
from .laws import LubricationLayer
from .scene import Bonds, Scene


def grown_bonds(scene: Scene) -> Bonds | None:
    """The scene's bonds after its rest; None if it has no bonds, or never rests."""
    if scene.rest is None or scene.bonds is None:
        return None
    gained = scene.rest.gained
    return replace(
        scene.bonds, tensile_strength=scene.bonds.tensile_strength + gained, cohesion=scene.bonds.cohesion + gained
    )


def has_layer(scene: Scene, law: type) -> bool:
    """Whether a layer on the walls, their contact `law`, grows."""
    return scene.rest is not None and issubclass(law, LubricationLayer)


class Structure:
    """What the layers of a batch's scenes have gained, and the stage that wears it off."""

    def __init__(self, batch: Any) -> None:
        """`batch` is a :class:`Batch` of scenes that all have a layer that grows."""
        self.batch = batch
        batch.wall_parameters = wp.clone(batch.wall_parameters)  # those of a model never change
        own = [law["yield_stress"] for law in batch.wall_parameters.numpy()]
        self._own_yield = wp.array(np.array(own, dtype=float), dtype=batch.scalar, device=batch.device)
        walls = [
            int(batch.rows["walls"][s]) + next(k for k, w in enumerate(m.walls) if w.name == m.scene.rest.wall)
            for s, m in enumerate(batch.models)
        ]
        self._slip_wall = wp.array(walls, dtype=wp.int32, device=batch.device)
        self._breakdown = self._numbers([m.scene.rest.breakdown for m in batch.models])
        self._gained, self._begun = np.zeros(batch.count), np.zeros(batch.count)
        self._device_gained, self._device_begun = self._numbers(self._gained), self._numbers(self._begun)

    def _numbers(self, values: Any) -> wp.array:
        return wp.array(np.asarray(values, dtype=float), dtype=wp.float64, device=self.batch.device)

    def stage(self) -> Stage:
        """Yield stresses for the next step; one thread a scene."""
        b = self.batch
        return b.stage(
            wear_kernel(b.scalar, b.features.wall_law), b.count, own_yield=self._own_yield,
            gained=self._device_gained, breakdown=self._breakdown, begun=self._device_begun, slip_wall=self._slip_wall,
        )  # fmt: skip

    def grow(self, s: int, begun: float) -> None:
        """Let the layer of a scene have what it gained at rest, less what slip since a travel of `begun` [m] took."""
        self._set(s, self.batch.models[s].scene.rest.layer_gained, begun)

    def take(self, s: int, other: Structure, index: int) -> None:
        """Go on with the layer that scene `index` of another batch has."""
        self._set(s, other._gained[index], other._begun[index])

    def _set(self, s: int, gained: float, begun: float) -> None:
        self._gained[s], self._begun[s] = gained, begun
        self._device_gained.assign(self._gained)
        self._device_begun.assign(self._begun)
        self.stage()()
