"""State of a flow: its particles on a device, and the places they start from."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from .fluid import FluidScene
from .grains import Grains, scatter
from .kernels.mps_types import FLAGS, fluid_struct, mps_types
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
        self.grain_arrays = self._grain_arrays(t)

    @property
    def mass(self) -> float:
        """Of all fluid particles [kg], or [kg/m] in two dimensions."""
        if self.grains is None:
            return self.scene.concrete.density * self.layout.volume * self.count
        return float(self.density.numpy().sum(dtype=float)) * self.layout.volume

    def _grain_arrays(self, t) -> dict[str, Any]:
        grains = self.grains
        if grains is None:
            return {}
        device, d = self.device, self.scene.dimensions
        place = self.position.numpy().astype(float)
        middle = np.stack([place[a:b].mean(0) for a, b in zip(grains.first[:-1], grains.first[1:])])
        offset = place[: grains.first[-1]] - middle[grains.group[: grains.first[-1]]]
        return {
            "count": grains.count,
            "first": wp.array(grains.first, dtype=wp.int32, device=device),
            "offset": wp.array(offset, dtype=t.vec, device=device),
            "middle": wp.array(middle, dtype=t.vec, device=device),
            "middle_rounding": wp.zeros(grains.count, dtype=t.vec, device=device),
            "step": wp.zeros(grains.count, dtype=t.vec, device=device),
            "spin": wp.zeros(grains.count, dtype=wp.vec3d if self.scalar is wp.float64 else wp.vec3f, device=device),
            "turn": wp.array(np.tile(np.eye(d), (grains.count, 1, 1)), dtype=t.mat, device=device),
        }


def flow_numbers(state: FluidState, *, skin: float, correction: float):
    """Struct of a flow's numbers for the kernels; `skin` of the lists over the spacing, `correction` the share of the
    density's error that a step takes away.
    """
    scene = state.scene
    flow = fluid_struct(state.scalar)()
    layout = state.layout
    l0 = layout.spacing
    fluid = scene.aggregates.mortar if scene.aggregates is not None else scene.concrete
    values = dict(
        count=state.count,
        spacing=l0,
        cutoff=CUTOFF * l0,
        wide=WIDE * l0,
        lattice_number=_sum_at_start(layout, CUTOFF, _weight),
        lattice_density=_sum_at_start(layout, WIDE, _density_weight) + 1.0,
        radius=scene.radius,
        piston_speed=scene.velocity,
        gravity=scene.gravity,
        dt=scene.time_step,
        density=scene.concrete.density,
        viscosity=fluid.viscosity,
        yield_stress=fluid.yield_stress,
        regularisation=scene.regularisation,
        slip_viscosity=scene.concrete.slip_viscosity,
        slip_yield=scene.concrete.slip_yield,
        aggregate_viscosity=scene.aggregates.viscosity if scene.aggregates is not None else 0.0,
        correction=correction,
        skin=skin * l0,
    )
    for name, value in values.items():
        setattr(flow, name, value)
    return flow


def lattice_number(dimensions: int, reach: float) -> float:
    """Sum of weights of a particle inside a square or cubic lattice; `reach` over its spacing."""
    size = np.arange(-math.ceil(reach), math.ceil(reach) + 1.0)
    r = np.linalg.norm(np.stack(np.meshgrid(*[size] * dimensions), -1).reshape(-1, dimensions), axis=1)
    r = r[(r > 0) & (r < reach)]
    return float(np.sum(reach / r - 1))


def _weight(q: np.ndarray) -> np.ndarray:
    return 1 / q - 1


def _density_weight(q: np.ndarray) -> np.ndarray:
    return (1 - q) ** 4 * (4 * q + 1)


def _sum_at_start(layout: Layout, reach: float, weight: Callable[[np.ndarray], np.ndarray]) -> float:
    """Mean over a layer amid the column of the weights of all others within `reach` spacings."""
    everything = np.concatenate([layout.fluid, layout.wall])
    middle = layout.fluid[np.argmin(np.abs(layout.fluid[:, -1] - 0.5 * layout.height)), -1]
    layer = layout.fluid[np.abs(layout.fluid[:, -1] - middle) < 1e-6 * layout.spacing]
    layer = layer[:: -(-len(layer) // 1000)]
    near = everything[np.abs(everything[:, -1] - middle) < reach * layout.spacing]
    parts = np.array_split(layer, -(-len(layer) // 50))
    q = np.concatenate([np.linalg.norm(part[:, None] - near, axis=2).ravel() for part in parts])
    q = q[(q > 0) & (q < reach * layout.spacing)] / (reach * layout.spacing)
    return float(np.sum(weight(q))) / len(layer)
