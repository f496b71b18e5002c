"""Initial positions of the particles of a flow."""

import math
from dataclasses import dataclass

import numpy as np

from .scene import FluidScene

LAYERS = 4
"""Number of layers of dummy particles behind a wall. In all sums over neighbours, they stand for fluid that the wall
cuts off.
"""


@dataclass(frozen=True)
class Layout:
    """Initial positions of the particles relative to the centre of the piston; the last axis runs along the pipe."""

    spacing: float
    """Distance between neighbouring particles at the start [m]."""
    volume: float
    """Volume of a particle [m3]; in two dimensions its area [m2]."""
    fluid: np.ndarray
    """Positions of fluid particles [m], shape (n, dimensions), layer by layer from the piston."""
    wall: np.ndarray
    """Positions of wall particles [m], shape (m, dimensions)."""
    height: float
    """Height of the column of concrete [m]."""


def layout(scene: FluidScene) -> Layout:
    """Return the initial positions of a column's particles, in rows along a channel or in rings in a tube.

    Particles are half a spacing away from the wall, and in a tube half a spacing away from the axis.
    """
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
    # Choose the distance between layers such that the column has exactly the length that the scene states.
    step = scene.length / layers
    height = (np.arange(layers) + 0.5) * step
    beneath = (np.arange(-LAYERS, 0) + 0.5) * step
    # The front bulges while the concrete flows, so the wall particles continue above the column.
    above = (np.arange(-LAYERS, layers + math.ceil(0.3 * layers) + 2 * LAYERS) + 0.5) * step
    wall = np.concatenate([_stacked(inside, beneath), _stacked(outside, above)])
    fluid = _stacked(inside, height)
    return Layout(spacing, area * scene.length / len(fluid), fluid, wall, scene.length)


def _ring(number: int, spacing: float) -> np.ndarray:
    count = round(2 * math.pi * (number + 0.5))
    # Turn each ring by the golden angle relative to the next inner one, so that their particles are not aligned.
    angle = 2 * math.pi * np.arange(count) / count + 2.39996 * number
    return (number + 0.5) * spacing * np.stack([np.cos(angle), np.sin(angle)], 1)


def _stacked(across: np.ndarray, heights: np.ndarray) -> np.ndarray:
    return np.concatenate([np.column_stack([across, np.full(len(across), h)]) for h in heights])
