"""Cells of a grid, what fills them at the start, and the walls around."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from ..scene import FluidScene
from ..theory import steady

ABREAST = 2
"""Particles of a cell across it, and as many along it, in a pipe."""
NONE, PLATE, AXIS, GATE = 0, 1, 2, 3
"""Numbers of walls: of a pipe or vessel, of an axis or frame that nothing rubs on, of what will open."""


@dataclass(frozen=True)
class GridLayout:
    """A grid at the start. Places are counted from the middle or axis, and from the lower side."""

    cells: tuple[int, int]
    """Across and along."""
    spacing: float
    """Width of a cell [m]."""
    step: float
    """Height of a cell [m]."""
    left: float
    """Place of the left side [m]."""
    axial: bool
    """About an axis, which is the left side."""
    periodic: bool
    """Goes on below as it ends above; else there is a free surface."""
    solid: np.ndarray
    """Number of the wall that fills a cell, NONE in the open, frame included, shape (nz + 2, nx + 2)."""
    fluid: np.ndarray
    """Particles, shape (n, 2) [m]."""
    mass: np.ndarray
    """Of each over the mean, shape (n,)."""
    mark_spacing: float
    """Distance of particles [m]."""
    slip: tuple[float, float]
    """Viscosity [Pa s/m] and yield stress [Pa] of the layer on walls."""
    speed: float
    """That flows of this kind have [m/s]: what errors of solves are judged by."""
    length: float
    """Over which it changes [m]."""
    frame: float = 0.0
    """Velocity of the grid along z [m/s]; mean velocity of a periodic pipe."""
    drive: float = 0.0
    """Force per volume at the start [N/m3]."""
    resistance: float = 0.0
    """By how much a periodic pipe's wall answers a faster mean [kg/m3/s]."""
    opens: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """When a cell of a gate opens [s], shape as `solid`; empty without gates."""

    @property
    def height(self) -> float:
        """Of the grid [m]."""
        return self.cells[1] * self.step

    @property
    def shape(self) -> tuple[int, int]:
        """Of arrays over the cells, frame included."""
        return self.cells[1] + 2, self.cells[0] + 2

    @property
    def volume(self) -> float:
        """Of the mean particle, of a metre's depth or a radian."""
        radius = float(self.fluid[:, 0].mean()) if self.axial else 1.0
        return self.mark_spacing * self.mark_spacing * (self.step / self.spacing) * radius


def pipe_cells(scene: FluidScene) -> tuple[int, int]:
    """Cells across and along, of the width nearest to the wanted spacing that divides a channel, or a tube's radius."""
    across = scene.radius if scene.dimensions == 3 else 2 * scene.radius
    nx = max(2, round(across / scene.spacing))
    return nx, max(2, round(scene.length * nx / across))


def pipe_layout(scene: FluidScene) -> GridLayout:
    """A periodic pipe: cells from wall to wall, or from the axis to the wall."""
    axial = scene.dimensions == 3
    nx, nz = pipe_cells(scene)
    dx, dz = (scene.radius if axial else 2 * scene.radius) / nx, scene.length / nz
    left = 0.0 if axial else -scene.radius
    solid = np.zeros((nz + 2, nx + 2), np.int32)
    solid[:, 0] = AXIS if axial else PLATE
    solid[:, -1] = PLATE
    i, k = np.meshgrid((np.arange(nx * ABREAST) + 0.5) / ABREAST, (np.arange(nz * ABREAST) + 0.5) / ABREAST)
    fluid = np.stack([left + i.ravel() * dx, k.ravel() * dz], 1)
    concrete = scene.concrete
    return GridLayout(
        cells=(nx, nz),
        spacing=dx,
        step=dz,
        left=left,
        axial=axial,
        periodic=True,
        solid=solid,
        fluid=fluid,
        mass=fluid[:, 0] / fluid[:, 0].mean() if axial else np.ones(len(fluid)),
        mark_spacing=dx / ABREAST,
        slip=(concrete.slip_viscosity, concrete.slip_yield),
        speed=scene.velocity,
        length=scene.radius,
        frame=scene.velocity,
        drive=concrete.density * scene.gravity,
        resistance=_resistance(scene),
    )


def _resistance(scene: FluidScene) -> float:
    """By how much the wall's force per volume grows with the mean velocity in the steady state [kg/m3/s]."""
    little, flow = 1e-3, math.pi * scene.radius**2 * scene.velocity
    now, more = (steady(scene.concrete, scene.line, flow * (1 + part), scene.form) for part in (0.0, little))
    return (more.pressure - now.pressure) / (scene.length * little * scene.velocity)
