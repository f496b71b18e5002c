"""Initial layout of a flow on a grid: its cells, the walls around them, and the concrete in them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ...kernels.mps.grid.cells import GridKind
from .geometry import NO_SLIP_VISCOSITY, Geometry, Room


@dataclass(frozen=True)
class GridLayout:
    """Grid, walls and particles of a flow at the start.

    Arrays of cells include one layer of cells around the grid.
    """

    kind: GridKind
    room: Room
    solid: np.ndarray
    """Number of the kind of wall that fills each cell, NONE for open cells; last axis first, shape `shape`."""
    fluid: np.ndarray
    """Positions of the particles [m], shape (n, axes)."""
    mass: np.ndarray
    """Mass of each particle, divided by the mean mass, shape (n,)."""
    particle_spacing: float
    """Initial distance between neighbouring particles [m]."""
    slip: tuple[float, float]
    """Viscosity [Pa s/m] and yield stress [Pa] of the slip layer on walls."""
    speed: float
    """Typical speed of the flow [m/s]. Linear solves stop when the errors of the velocities are small compared with
    it."""
    length: float
    """Length over which the velocity typically varies [m], such as the radius of a pipe."""
    frame: float = 0.0
    """Velocity of the grid along its last axis [m/s]. In a periodic pipe it is the mean velocity of the concrete."""
    drive: float = 0.0
    """Driving force per volume of concrete in a periodic pipe at the start [N/m3]."""
    mean_velocity_fixed: bool = True
    """True if the driving force of a periodic pipe adapts to keep the mean velocity; False if the force is constant."""
    resistance: float = 0.0
    """Derivative of the wall's friction force per volume with respect to the mean velocity, in a periodic pipe
    [kg/m3/s]."""
    geometry: Geometry | None = None
    """Geometry of walls that cut cells; None if walls are sides of cells."""
    opened: Geometry | None = None
    """Geometry of the walls after the gate has opened; None without a gate."""
    opens: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """Time at which the gate in each cell opens, so that the cell takes its geometry from `opened` [s]; shape as
    `solid`, empty without a gate."""
    full: bool = False
    """True if concrete fills the grid at all times. If False, concrete may have a free surface, except in a periodic
    flow."""
    rough: tuple[float, float] = (NO_SLIP_VISCOSITY, 0.0)
    """Viscosity [Pa s/m] and yield stress [Pa] of the slip layer on walls of the kind ROUGH; by default concrete sticks
    to them."""
    slips: bool = True
    """True if the slip layer `slip` obeys the slip law of the concrete; False if its stress grows linearly with the
    slip velocity."""
    rough_slips: bool = False
    """True if the slip layer `rough` on walls of the kind ROUGH obeys the slip law of the concrete; False if its stress
    grows linearly with the slip velocity."""
    weightless: bool = False
    """True if weight is left out; without a free surface it would only add hydrostatic pressure."""
    motions: tuple[Motion, ...] = ()
    """Motions of the moving walls, in the order of their kind numbers ROUGH + 1, ROUGH + 2, ..."""
    inlet: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    """Positions at which particles that have left the grid enter again [m], shape (n, axes).

    If the array is empty, particles that have left do not enter again.
    """
    gained: float = 0.0
    """Increase of the yield stresses of bulk and slip layer during a rest before the start [Pa]."""
    inflow: tuple[float, ...] | None = None
    """Velocity with which particles re-enter the grid after they have left it [m/s]; None for zero."""

    def __post_init__(self) -> None:
        """Raise :class:`ValueError` if the grid has both a gate and moving walls.

        The member `swept` of the geometry contains the parts of faces that only moving walls close. It is computed with
        the gate as a standing wall, and does not change when the gate opens. A moving wall behind the gate would
        therefore displace no concrete after the gate has opened.
        """
        if self.opened is not None and self.motions:
            raise ValueError(
                "a grid cannot have both a gate ('opened') and moving walls ('motions'), because faces that the gate "
                "covered would stay closed to the motion of the walls; leave out one of them"
            )

    @property
    def cells(self) -> tuple[int, ...]:
        """Number of cells of the grid along each axis."""
        return self.room.cells

    @property
    def axes(self) -> int:
        """Number of axes of the grid, 2 or 3."""
        return len(self.room.cells)

    @property
    def axial(self) -> bool:
        """True for an axisymmetric flow, whose axis is the left side of the grid."""
        return self.kind.axial

    @property
    def periodic(self) -> bool:
        """True if the upper and lower ends of the grid are periodic boundaries."""
        return self.kind.periodic

    @property
    def spacing(self) -> float:
        """Width of a cell of the grid along the first axis [m]."""
        return self.room.width[0]

    @property
    def step(self) -> float:
        """Height of a cell [m], which is the distance from one cell to the next along the last axis."""
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
        """Number of cells along each axis, last axis first, with one additional cell at each end of the axis."""
        return tuple(n + 2 for n in reversed(self.cells))

    @property
    def volume(self) -> float:
        """Mean initial volume of a particle [m3]; in plane flow per metre of depth, in axisymmetric flow per radian."""
        radius = float(self.fluid[:, 0].mean()) if self.axial else 1.0
        return radius * float(np.prod([self.particle_spacing * h / self.spacing for h in self.room.width]))


@dataclass(frozen=True)
class Motion:
    """Rigid motion of a wall. Its velocity acts on the concrete, but its position on the grid does not change."""

    velocity: tuple[float, ...]
    """Velocity of the wall [m/s]."""
    spin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Angular velocity of the wall about x, y and z [rad/s]. In a plane flow, which lies in the plane of x and z, only
    the component about y counts."""
    pivot: tuple[float, ...] | None = None
    """Point about which the wall spins [m]; None for the origin."""
    smooth: bool = False
    """True if the wall has no friction; otherwise concrete sticks to it."""
