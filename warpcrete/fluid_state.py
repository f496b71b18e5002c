"""State of a flow: its particles on a device, and the places they start from."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import warp as wp

from .fluid import FluidScene
from .grains import Grains, scatter
from .kernels.mps_types import FLAGS, mps_types
from .model import SCALARS

LAYERS = 4
"""Of particles behind a wall, which stand in for the fluid there wherever neighbours are counted."""
CUTOFF = 2.1
"""Reach of gradient, divergence and Laplacian over the spacing (Xu et al. 2021: 2.1 and 4.1)."""
WIDE = 3.1
"""Reach of the density over the spacing."""


@dataclass(frozen=True)
class Layout:
    """Places of particles at the start, from the piston's middle; the last coordinate runs along the pipe."""

    spacing: float
    """[m]"""
    volume: float
    """Of a particle [m3], or area [m2] in two dimensions."""
    fluid: np.ndarray
    """Shape (n, dimensions) [m], layer by layer from the piston."""
    wall: np.ndarray
    """Shape (m, dimensions) [m]."""
    height: float
    """Of the column [m]."""


def layout(scene: FluidScene) -> Layout:
    """Rows along a channel, rings in a tube: the first half a spacing from the wall, like the last from the axis."""
    if scene.dimensions == 2:
        across = max(2, round(2 * scene.radius / scene.spacing))
        spacing = 2 * scene.radius / across
        inside = ((np.arange(across) + 0.5) * spacing - scene.radius)[:, None]
        beyond = (np.arange(LAYERS) + 0.5) * spacing + scene.radius
        outside = np.concatenate([-beyond[::-1], beyond])[:, None]
        area = 2 * scene.radius
    else:
        rings = max(2, round(scene.radius / scene.spacing))
        spacing = scene.radius / rings
        inside = np.concatenate([_ring(k, spacing) for k in range(rings)])
        outside = np.concatenate([_ring(k, spacing) for k in range(rings, rings + LAYERS)])
        area = math.pi * scene.radius**2
    layers = round(scene.length / spacing)
    step = scene.length / layers  # so that the column has just its length
    height = (np.arange(layers) + 0.5) * step
    beneath = (np.arange(-LAYERS, 0) + 0.5) * step
    # The front bulges while it flows: room for that.
    above = (np.arange(-LAYERS, layers + math.ceil(0.3 * layers) + 2 * LAYERS) + 0.5) * step
    wall = np.concatenate([_stacked(inside, beneath), _stacked(outside, above)])
    fluid = _stacked(inside, height)
    return Layout(spacing, area * scene.length / len(fluid), fluid, wall, scene.length)


def _ring(number: int, spacing: float) -> np.ndarray:
    count = round(2 * math.pi * (number + 0.5))
    # Turned by the golden angle, so that neighbouring rings are not aligned.
    angle = 2 * math.pi * np.arange(count) / count + 2.39996 * number
    return (number + 0.5) * spacing * np.stack([np.cos(angle), np.sin(angle)], 1)


def _stacked(across: np.ndarray, heights: np.ndarray) -> np.ndarray:
    return np.concatenate([np.column_stack([across, np.full(len(across), h)]) for h in heights])


class FluidState:
    """Everything that changes in a flow, and what follows from the places at its start.

    Arrays have a row for each fluid particle, in an order that never changes; velocities are those of the room,
    places are counted from the piston.
    """

    PARTICLE_ARRAYS = ("position", "rounding", "velocity", "pressure")
    """What the next step depends on; grains have their own."""

    def __init__(self, scene: FluidScene, device, precision: str) -> None:
        scalar = SCALARS[precision]
        self.scene, self.device, self.scalar = scene, device, scalar
        t = mps_types(scalar, scene.dimensions)
        self.layout = layout(scene)
        self.grains: Grains | None = None
        fluid = self.layout.fluid
        if scene.aggregates is not None and scene.aggregates.share > 0:
            self.grains = scatter(scene, self.layout)
            fluid = fluid[self.grains.order]
        n = len(fluid)
        self.count, self.wall_count = n, len(self.layout.wall)
        self.position = wp.array(fluid, dtype=t.vec, device=device)
        self.rounding = wp.zeros(n, dtype=t.vec, device=device)
        start = np.zeros_like(fluid)
        start[:, -1] = scene.velocity
        self.velocity = wp.array(start, dtype=t.vec, device=device)
        head = scene.concrete.density * scene.gravity * (self.layout.height - 0.5 * self.layout.spacing - fluid[:, -1])
        self.pressure = wp.array(head, dtype=scalar, device=device)
        self.wall_position = wp.array(self.layout.wall, dtype=t.vec, device=device)
        if self.grains is None:
            group, density = np.zeros(0, np.int32), np.zeros(0)
        else:
            assert scene.aggregates is not None
            group = self.grains.group
            density = np.where(group >= 0, scene.aggregates.density, scene.aggregates.mortar.density)
        self.group = wp.array(group, dtype=wp.int32, device=device)
        self.density = wp.array(density, dtype=scalar, device=device)
        self.flags = wp.zeros(FLAGS, dtype=wp.int32, device=device)

    @property
    def mass(self) -> float:
        """Of all fluid particles [kg], or [kg/m] in two dimensions."""
        if self.grains is None:
            return self.scene.concrete.density * self.layout.volume * self.count
        return float(self.density.numpy().sum(dtype=float)) * self.layout.volume
