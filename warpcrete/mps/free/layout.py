"""Cells of a vessel, and the concrete in it at the start."""

from __future__ import annotations

import numpy as np

from ..grid.layout import AXIS, GATE, NONE, PLATE, GridLayout
from .scene import FreeScene, Points

ABREAST = 3
"""Particles of a cell across it, and as many along it: a surface needs more than a pipe does."""
PARTS = 8
"""Places across a cell, and as many along it, by which a polygon's part of it is found."""
STICKS = 1e8
"""Viscosity of a slip layer that hardly slips [Pa s/m]."""


def free_cells(scene: FreeScene) -> tuple[int, int]:
    """Cells across and up."""
    nx = max(4, round(scene.width / scene.spacing))
    return nx, max(4, round(scene.height * nx / scene.width))


def free_layout(scene: FreeScene) -> GridLayout:
    """A vessel: plate below, a gate where something is lifted, air above and around."""
    nx, nz = free_cells(scene)
    h, step = scene.width / nx, scene.height / nz
    middles = np.stack(np.meshgrid((np.arange(nx) + 0.5) * h, (np.arange(nz) + 0.5) * step), -1)
    solid = np.full((nz + 2, nx + 2), NONE, np.int32)
    inner = solid[1:-1, 1:-1]
    i, k = np.meshgrid((np.arange(nx * ABREAST) + 0.5) / ABREAST, (np.arange(nz * ABREAST) + 0.5) / ABREAST)
    places = np.stack([i.ravel() * h, k.ravel() * step], 1)
    opens = np.zeros(0)
    if scene.gate:
        # Behind a gate, which is made of cells, so is the concrete.
        filled = _filled(scene, h, step, nx, nz)
        gate = _inside(scene.gate, middles) & ~filled
        inner[gate] = GATE
        opens = np.zeros(solid.shape)
        opens[1:-1, 1:-1] = np.where(gate, middles[..., 1] / scene.lift_speed, 0.0)
        at = (places / [h, step]).astype(int)
        places = places[filled[at[:, 1], at[:, 0]]]
    else:
        places = places[_inside(scene.outline, places)]
    solid[0], solid[:, 0], solid[:, -1] = PLATE, AXIS if scene.axial else PLATE, PLATE
    slip = (scene.concrete.slip_viscosity, scene.concrete.slip_yield) if scene.plate_slips else (STICKS, 0.0)
    size = float(np.ptp(np.array(scene.outline), axis=0).min())
    return GridLayout(
        cells=(nx, nz),
        spacing=h,
        step=step,
        left=0.0,
        axial=scene.axial,
        periodic=False,
        solid=solid,
        fluid=places,
        mass=places[:, 0] / places[:, 0].mean() if scene.axial else np.ones(len(places)),
        mark_spacing=h / ABREAST,
        slip=slip,
        speed=0.1 * float(np.sqrt(scene.gravity * size)),
        length=size,
        opens=opens,
    )


def _inside(points: Points, places: np.ndarray) -> np.ndarray:
    """Which places lie in a polygon."""
    from matplotlib.path import Path

    return Path(points).contains_points(places.reshape(-1, 2)).reshape(places.shape[:-1])


def _filled(scene: FreeScene, h: float, step: float, nx: int, nz: int) -> np.ndarray:
    """Whole cells that stand for the outline: those of which it covers more than half. Each row of a cone of them is as
    wide as the one above or wider, so that nothing rests on a ledge."""
    fine = np.stack(
        np.meshgrid((np.arange(nx * PARTS) + 0.5) * h / PARTS, (np.arange(nz * PARTS) + 0.5) * step / PARTS), -1
    )
    return _inside(scene.outline, fine).reshape(nz, PARTS, nx, PARTS).mean((1, 3)) > 0.5
