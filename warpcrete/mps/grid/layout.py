"""Layout of a grid at the start: its cells, the walls around them, and the concrete in them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from ...kernels.mps.grid.cells import GridKind
from ...theory.pipe import steady
from ..scene import FluidScene
from .geometry import MIRROR, NO_SLIP_VISCOSITY, OPEN_SIDE, PLATE, SMOOTH, WALL, Geometry, Room

PARTICLES_PER_AXIS = 2
"""Number of particles per cell along each axis in a pipe."""


@dataclass(frozen=True)
class GridLayout:
    """Grid, walls and particles of a flow at the start."""

    kind: GridKind
    room: Room
    solid: np.ndarray
    """Wall number of each cell and of the frame of cells around the grid, NONE for open cells; last axis first."""
    fluid: np.ndarray
    """Positions of the particles [m], shape (n, axes)."""
    mass: np.ndarray
    """Mass of each particle, relative to the mean mass, shape (n,)."""
    particle_spacing: float
    """Initial distance between neighbouring particles [m]."""
    slip: tuple[float, float]
    """Viscosity [Pa s/m] and yield stress [Pa] of the slip layer on walls."""
    speed: float
    """Typical speed of the flow [m/s], with which errors of the solves are compared."""
    length: float
    """Length over which the velocity typically varies [m]."""
    frame: float = 0.0
    """Velocity of the grid along its last axis [m/s]; in a periodic pipe it is the concrete's mean velocity."""
    drive: float = 0.0
    """Driving force per volume at the start [N/m3]."""
    mean_velocity_fixed: bool = True
    """True if the driving force of a periodic pipe adapts to keep the mean velocity; False if the force is constant."""
    resistance: float = 0.0
    """Increase of the wall force per volume of a periodic pipe with the mean velocity [kg/m3/s]."""
    geometry: Geometry | None = None
    """Geometry of walls that cut cells; None if walls are sides of cells."""
    opened: Geometry | None = None
    """Geometry of the walls after the gate has opened; None without a gate."""
    opens: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """Time at which each cell takes its geometry from `opened` [s], shape as `solid`; empty if nothing opens."""
    full: bool = False
    """True if concrete fills the room at all times, so that even a room that is not periodic has no free surface."""
    rough: tuple[float, float] = (NO_SLIP_VISCOSITY, 0.0)
    """Viscosity [Pa s/m] and yield stress [Pa] of the layer on walls of number ROUGH; by default concrete sticks."""
    slips: bool = True
    """True if `slip` is the concrete's own slip layer, with its flow law; False if the layer's stress is linear."""
    rough_slips: bool = False
    """True if `rough` is the concrete's own slip layer, so that it obeys that layer's law; otherwise it is linear."""
    weightless: bool = False
    """True if weight is left out; without a free surface it would only add hydrostatic pressure."""
    motions: tuple[Motion, ...] = ()
    """Motions of the walls whose numbers follow ROUGH."""
    inlet: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    """Positions at which particles that have left the grid enter again [m], shape (n, axes).

    If the array is empty, particles that have left are gone for good.
    """
    gained: float = 0.0
    """Increase of the yield stresses of bulk and slip layer during a rest before the start [Pa]."""
    inflow: tuple[float, ...] | None = None
    """Velocity with which particles re-enter the grid after they have left it [m/s]."""

    @property
    def cells(self) -> tuple[int, ...]:
        """Numbers of cells along each axis."""
        return self.room.cells

    @property
    def axes(self) -> int:
        """Number of axes, 2 or 3."""
        return len(self.room.cells)

    @property
    def axial(self) -> bool:
        """True for a flow about an axis, which is the left side of the grid."""
        return self.kind.axial

    @property
    def periodic(self) -> bool:
        """True if the upper and lower ends of the grid are periodic boundaries."""
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
        """Coordinate of the grid's left side along the first axis [m]."""
        return self.room.origin[0]

    @property
    def height(self) -> float:
        """Height of the grid [m]."""
        return self.cells[-1] * self.step

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of arrays over the cells and one layer of cells around them, last axis first."""
        return tuple(n + 2 for n in reversed(self.cells))

    @property
    def volume(self) -> float:
        """Mean volume of a particle [m3]; in plane flow per metre of depth, in axisymmetric flow per radian."""
        radius = float(self.fluid[:, 0].mean()) if self.axial else 1.0
        return radius * float(np.prod([self.particle_spacing * h / self.spacing for h in self.room.width]))


@dataclass(frozen=True)
class Motion:
    """Rigid-body velocity that a wall imposes on the concrete; the wall keeps its place on the grid."""

    velocity: tuple[float, ...]
    """Velocity of the wall [m/s]."""
    spin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Angular velocity of the wall [rad/s]; in a plane, whose axes are x and z of space, only the middle one counts."""
    pivot: tuple[float, ...] | None = None
    """Point about which the wall spins [m]; None for the origin."""
    smooth: bool = False
    """True if the wall has no friction; otherwise concrete sticks to it."""


def pipe_cells(scene: FluidScene) -> tuple[int, int]:
    """Return the number of cells across a pipe and the number of cells along the pipe.

    A whole number of cells must fit into the width of a channel or the radius of a tube. Among the widths for which
    they fit, the cells have the one nearest to the wanted spacing.
    """
    across = scene.radius if scene.dimensions == 3 else 2 * scene.radius
    nx = max(2, round(across / scene.spacing))
    return nx, max(2, round(scene.length * nx / across))


def pipe_layout(scene: FluidScene) -> GridLayout:
    """Return the layout of a periodic pipe, with cells from wall to wall or from the axis to the wall."""
    axial = scene.dimensions == 3
    nx, nz = pipe_cells(scene)
    dx, dz = (scene.radius if axial else 2 * scene.radius) / nx, scene.length / nz
    left = 0.0 if axial else -scene.radius
    solid = np.zeros((nz + 2, nx + 2), np.int32)
    solid[:, 0] = SMOOTH if axial else PLATE
    solid[:, -1] = PLATE
    i, k = np.meshgrid(
        (np.arange(nx * PARTICLES_PER_AXIS) + 0.5) / PARTICLES_PER_AXIS,
        (np.arange(nz * PARTICLES_PER_AXIS) + 0.5) / PARTICLES_PER_AXIS,
    )
    fluid = np.stack([left + i.ravel() * dx, k.ravel() * dz], 1)
    concrete = scene.concrete
    return GridLayout(
        kind=GridKind(
            axial=axial,
            periodic=True,
            thixotropic=scene.is_structured,
            rebuilding=scene.rebuild_rate > 0,
            law=concrete.bulk_law.name,
            slip_law=concrete.layer_law.name,
        ),
        gained=scene.gained,
        room=Room((nx, nz), (dx, dz), (left, 0.0), ((MIRROR if axial else WALL, WALL), (OPEN_SIDE, OPEN_SIDE))),
        solid=solid,
        fluid=fluid,
        mass=fluid[:, 0] / fluid[:, 0].mean() if axial else np.ones(len(fluid)),
        particle_spacing=dx / PARTICLES_PER_AXIS,
        slip=(concrete.slip_viscosity, concrete.slip_yield),
        speed=scene.velocity,
        length=scene.radius,
        frame=scene.velocity,
        drive=concrete.density * scene.gravity,
        resistance=_resistance(scene),
    )


def _resistance(scene: FluidScene) -> float:
    """Return the increase of the wall's force per volume with the mean velocity in the steady state [kg/m3/s].

    The driving force of a periodic pipe uses this slope to anticipate how the wall's force changes with the velocity.
    """
    little, flow = 1e-3, math.pi * scene.radius**2 * scene.velocity
    now, more = (steady(scene.concrete, scene.line, flow * (1 + part), scene.form) for part in (0.0, little))
    return (more.pressure - now.pressure) / (scene.length * little * scene.velocity)
