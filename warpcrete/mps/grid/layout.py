"""Cells of a grid, what fills them at the start, and the walls around."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from ...kernels.mps.grid.cells import Kind
from ...theory.pipe import steady
from ..scene import FluidScene
from .geometry import BARE, MIRROR, PLATE, SMOOTH, STICKS, WALL, Geometry, Room

ABREAST = 2
"""Particles of a cell across it, and as many along it, in a pipe."""


@dataclass(frozen=True)
class GridLayout:
    """A grid at the start."""

    kind: Kind
    room: Room
    solid: np.ndarray
    """Number of the wall that fills a cell, NONE in the open, frame included, the last axis first."""
    fluid: np.ndarray
    """Particles, shape (n, axes) [m]."""
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
    """Velocity of the grid along the last axis [m/s]; mean velocity of a periodic pipe."""
    drive: float = 0.0
    """Force per volume at the start [N/m3]."""
    held: bool = True
    """In a periodic pipe that force changes so that the mean velocity stays that of the frame; else it stays."""
    resistance: float = 0.0
    """By how much a periodic pipe's wall answers a faster mean [kg/m3/s]."""
    geometry: Geometry | None = None
    """Of walls that cut cells."""
    opened: Geometry | None = None
    """The same, once what opens has opened."""
    opens: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """When each cell takes what is in `opened` [s], shape as `solid`; empty where nothing opens."""
    full: bool = False
    """To the brim, and for ever: there is no surface, though it is not periodic."""
    rough: tuple[float, float] = (STICKS, 0.0)
    """As `slip`, of walls of the number ROUGH: concrete sticks to them unless told otherwise."""
    weightless: bool = False
    """Weight is left out: where there is no surface, all that it does is to press."""
    motions: tuple[Motion, ...] = ()
    """Of walls with the numbers after ROUGH."""
    inlet: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    """Places at which particles come in again that have left, shape (n, axes) [m]; none: they are gone for good."""
    gained: float = 0.0
    """By yield stresses of bulk and slip layer, at rest before the start [Pa]."""
    inflow: tuple[float, ...] | None = None
    """Their velocity then [m/s]."""

    @property
    def cells(self) -> tuple[int, ...]:
        """Along each axis."""
        return self.room.cells

    @property
    def axes(self) -> int:
        """2 or 3."""
        return len(self.room.cells)

    @property
    def axial(self) -> bool:
        """About an axis, which is the left side."""
        return self.kind.axial

    @property
    def periodic(self) -> bool:
        """Goes on below as it ends above; else there is a free surface."""
        return self.kind.periodic

    @property
    def spacing(self) -> float:
        """Width of a cell [m]."""
        return self.room.width[0]

    @property
    def step(self) -> float:
        """Height of a cell [m]."""
        return self.room.width[-1]

    @property
    def left(self) -> float:
        """Place of the left side [m]."""
        return self.room.origin[0]

    @property
    def height(self) -> float:
        """Of the grid [m]."""
        return self.cells[-1] * self.step

    @property
    def shape(self) -> tuple[int, ...]:
        """Of arrays over the cells, frame included, the last axis first."""
        return tuple(n + 2 for n in reversed(self.cells))

    @property
    def volume(self) -> float:
        """Of the mean particle; in a plane of a metre's depth, about an axis of a radian."""
        radius = float(self.fluid[:, 0].mean()) if self.axial else 1.0
        return radius * float(np.prod([self.mark_spacing * h / self.spacing for h in self.room.width]))


@dataclass(frozen=True)
class Motion:
    """Of a wall along itself: a rigid body's."""

    velocity: tuple[float, ...]
    """[m/s]"""
    spin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """[rad/s]; in a plane, whose second axis is the third of space, the middle one counts."""
    pivot: tuple[float, ...] | None = None
    """Point that the spin is about [m]; none: the origin."""
    smooth: bool = False
    """Nothing rubs on it; else concrete sticks to it."""


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
    solid[:, 0] = SMOOTH if axial else PLATE
    solid[:, -1] = PLATE
    i, k = np.meshgrid((np.arange(nx * ABREAST) + 0.5) / ABREAST, (np.arange(nz * ABREAST) + 0.5) / ABREAST)
    fluid = np.stack([left + i.ravel() * dx, k.ravel() * dz], 1)
    concrete = scene.concrete
    return GridLayout(
        kind=Kind(axial=axial, periodic=True, thixotropic=scene.gained > 0),
        gained=scene.gained,
        room=Room((nx, nz), (dx, dz), (left, 0.0), ((MIRROR if axial else WALL, WALL), (BARE, BARE))),
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
