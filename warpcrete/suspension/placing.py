"""Aggregates at the start of a run: spheres at random places in the concrete, without overlaps."""

from __future__ import annotations

import numpy as np

from ..core.errors import refuse
from ..mps.free.layout import free_walls
from ..mps.grid.geometry import MIRROR, nearest_wall, polygon_distance
from ..mps.grid.layout import GridLayout
from .aggregates import Aggregates
from .scene import SuspensionScene

TRIES = 50_000
"""Number of random places that are tried before the fraction is refused."""
CLEARANCE = 0.02
"""Smallest gap at the start, relative to the radius of the sphere that is placed."""


def placed_aggregates(scene: SuspensionScene, layout: GridLayout) -> Aggregates:
    """Return spheres of the scene's fraction and diameters, the largest placed first (random sequential addition).

    Raises :class:`warpcrete.SceneError` if not all of them find a place.
    """
    rng = np.random.default_rng(scene.seed)
    radii = _radii(scene, layout, rng)
    nearest, outline = nearest_wall(layout.room, free_walls(scene)), polygon_distance(scene.outline)
    low, high = layout.fluid.min(0), layout.fluid.max(0)
    mirrors = [(axis, side) for axis, sides in enumerate(layout.room.sides) for side in (0, 1) if sides[side] == MIRROR]
    top = np.array(layout.room.origin) + np.array(layout.room.cells) * np.array(layout.room.width)
    centres, tries = np.zeros((0, 3)), 0
    for radius in radii:
        while True:
            tries += 1
            if tries > TRIES:
                placed = len(centres)
                part = float(np.sum(radii[:placed] ** 3) / np.sum(radii**3))
                refuse(
                    "aggregate_fraction", scene.aggregate_fraction,
                    f"is too large: only {placed} of {len(radii)} aggregates found a place",
                    f"use {0.9 * part * scene.aggregate_fraction:.2g} or less",
                )  # fmt: skip
            x = rng.uniform(low, high)
            room = (1 + CLEARANCE) * radius
            if len(centres) and np.any(np.linalg.norm(centres - x, axis=1) < room + radii[: len(centres)]):
                continue
            if any((x[axis] - layout.room.origin[axis] if side == 0 else top[axis] - x[axis]) < room
                   for axis, side in mirrors):  # fmt: skip
                continue
            if outline(x[None])[0] < -room and nearest(x[None])[0][0] > room:
                centres = np.vstack([centres, x])
                break
    return Aggregates(centres, radii, scene.aggregate_density)


def _radii(scene: SuspensionScene, layout: GridLayout, rng: np.random.Generator) -> np.ndarray:
    """Return radii, largest first, whose volume is nearest to the scene's fraction of the concrete's volume."""
    wanted = scene.aggregate_fraction * float(np.sum(layout.mass)) * layout.volume
    radii, volume = [], 0.0
    while True:
        radius = 0.5 * rng.uniform(*scene.aggregate_diameters)
        own = 4 / 3 * np.pi * radius**3
        if volume + 0.5 * own > wanted and radii:
            return np.sort(np.array(radii))[::-1]
        radii.append(radius)
        volume += own
