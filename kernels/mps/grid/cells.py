"""Parameters and arrays of a staggered grid, which is plane, axisymmetric or three-dimensional.

Cells are counted from the lowest cell, (0, 0) or (0, 0, 0); the last coordinate runs upwards or along the pipe. A frame
one cell wide surrounds the grid, and `slots` is the number of cells including this frame. Cells, faces and edges share
one numbering. Face c of axis a is the lower side of cell c along that axis; its index in arrays of faces is
c + a * slots. Edge c of the pair of axes a and b is the lowest edge of cell c that is perpendicular to both axes; its
index in arrays of edges is c + (a + b - 1) * slots. In a plane an edge is a corner, and edge c is the lower left corner
of cell c. Velocities are relative to the vessel or pipe at rest. Volumes and areas are per metre of depth in plane
flow, and per radian in axisymmetric flow.

Walls coincide with sides of cells or, if `GridKind.cut`, pass through cells (cut cells). Then each face stores its
distance from the nearest wall and the open part of its area, and cells and edges store the fraction of their volume
free of wall. Concrete flows in and out of a cell through the open parts of its faces (Ng, Min & Gibou 2009). Shear and
stretch are weighted with the open volumes of edges and cells (Batty & Bridson 2008). Shear and stretch beside a wall
also depend on some faces inside the wall, called ghost faces, whose velocities are unknowns as well. The friction of
the wall acts on the velocity at the wall itself, which is interpolated between a ghost face and the next face in the
concrete.
"""

import functools
from types import SimpleNamespace
from typing import NamedTuple

import warp as wp

from ...common.types import types
from ..flow_laws import BINGHAM
from ..structs import mps_types

# The array `solid` tells which wall fills each cell. OPEN is its value for a cell that concrete may fill; any other
# value is the number that identifies a wall.
OPEN = wp.constant(0)
SMOOTH = wp.constant(2)  # Value of `solid` in cells beyond an axis or plane of symmetry, a wall without friction.
GATE = wp.constant(3)  # Value of `solid` in cells inside the gate, a wall that opens at given times.

# The next constants are the five kinds of faces between two cells: AIR, LIQUID, FIXED, INSIDE and GHOST. Only ROUGH,
# which stands between them, is not a kind of face but a value of the array `solid`.

AIR = wp.constant(0)  # Kind of a face without concrete on either side.

# LIQUID is the kind of a face through which concrete on at least one of its sides can flow. Its velocity is an unknown.
LIQUID = wp.constant(1)
FIXED = wp.constant(2)  # Kind of a face that is the side of a wall; its velocity is the wall's velocity normal to it.
INSIDE = wp.constant(3)  # Kind of a face inside a wall, unless its velocity is an unknown (see GHOST).

# Value of `solid` in cells inside a rough wall, to which concrete sticks; higher values stand for moving walls.
ROUGH = wp.constant(4)
# GHOST is the kind of a face inside a wall if the shear or stretch of the nearby concrete depends on the velocity of
# the face.
GHOST = wp.constant(4)
# The following constants are indices of the array `drive`, which holds the force that drives the flow of a periodic
# pipe.
FORCE = wp.constant(0)  # Entry of `drive`: driving force per volume at the start of the next step [N/m3].
LAST_FORCE = wp.constant(1)  # Entry of `drive`: driving force per volume that acted in the completed step [N/m3].

# Entry of `drive`: velocity that is added to all faces along the pipe at the end of a step [m/s].
VELOCITY_CORRECTION = wp.constant(2)
DRIVE = 3
# The following constants are indices of the array `clock`, which holds the time and the variables of the step control.
DT = wp.constant(0)  # Entry of `clock`: time step [s].
NOW = wp.constant(1)  # Entry of `clock`: present simulated time [s].
UNTIL = wp.constant(2)  # Entry of `clock`: simulated time at which the present series of steps must end [s].

# Entry of `clock`: time step that error and Courant number allow [s]. A step that ends at a given time may be shorter.
WANTED = wp.constant(3)
SPEED = wp.constant(4)  # Entry of `clock`: root mean square speed of the concrete [m/s].

# Entry of `clock`: number of cells that the fastest concrete crosses per second [1/s].
CELLS_PER_SECOND = wp.constant(5)
BEFORE = wp.constant(6)  # Entry of `clock`: root mean square speed of the concrete in the previous step [m/s].
RATE = wp.constant(7)  # Entry of `clock`: rate of change of the root mean square speed in the previous step [m/s2].
LAST = wp.constant(8)  # Entry of `clock`: previous time step [s].

# Entry of `clock`: root mean square of the velocities that were transferred from particles to faces in this step [m/s].
GATHERED = wp.constant(9)
CLOCK = 10
STRIP = wp.constant(64)
"""Number of successive cells, faces or particles that one thread of a CPU processes at once."""


@wp.func
def item(task: wp.int32, worker: wp.int32, workers: wp.int32) -> wp.int32:
    """Return the number of the cell, face or particle that a task processes.

    Items are divided into strips of `STRIP` items, and the strips are dealt out to `workers` threads in turn, so that
    all threads get about the same amount of concrete. `worker` is the number of the thread. On a GPU there is one
    worker.
    """
    return (task / STRIP * workers + worker) * STRIP + task % STRIP


@wp.func
def first(pair: wp.int32) -> wp.int32:
    """Return the first axis of a pair of axes; the pairs are numbered xy, xz and yz."""
    return wp.where(pair == 2, 1, 0)


@wp.func
def second(pair: wp.int32) -> wp.int32:
    """Return the second axis of a pair of axes."""
    return wp.where(pair == 0, 1, 2)


class GridKind(NamedTuple):
    """Properties of a grid for which its kernels are specialised."""

    dimensions: int = 2
    axial: bool = False
    """True for an axisymmetric flow; the left side of the grid is the axis."""
    periodic: bool = False
    """True if the grid repeats itself along the last axis and is full of concrete; otherwise surfaces may be free."""
    cut: bool = False
    """True if walls may pass through cells (cut cells)."""
    thixotropic: bool = False
    """True if the concrete of a periodic pipe has gained thixotropic structure at rest, which the flow breaks down."""
    rebuilding: bool = False
    """True if the thixotropic structure of the concrete also builds up again while the concrete flows."""
    law: str = BINGHAM
    """Flow law of the concrete, a name in `flow_laws`."""
    slip_law: str = BINGHAM
    """Flow law of the slip layer."""

    @property
    def plain(self) -> bool:
        """Return whether concrete and slip layer both obey Bingham's law."""
        return self.law == self.slip_law == BINGHAM

    @property
    def pairs(self) -> int:
        """Return the number of pairs of axes: 1 in two dimensions, 3 in three."""
        return 1 if self.dimensions == 2 else 3

    @property
    def velocity_neighbours(self) -> int:
        """Return the maximum number of faces with which a face is coupled by viscosity."""
        return 2 + 6 * (self.dimensions - 1)

    @property
    def pressure_neighbours(self) -> int:
        """Return the maximum number of cells with which a cell is coupled by the pressure."""
        return 2 * self.dimensions


@functools.cache
def grid_parameters_struct(scalar, dimensions: int):
    """Build the struct with the parameters of a grid and of the flow on it."""
    t = mps_types(scalar, dimensions)

    @wp.struct
    class Grid:
        n: t.whole  # Number of cells along each axis.
        slots: wp.int32  # Number of cells including the frame around the grid.
        width: t.vec  # Width of a cell along each axis [m].
        origin: t.vec  # Position of the grid's lowest corner [m].

        # Velocity of the grid along its last axis [m/s]. In a periodic pipe this is the mean velocity of the concrete.
        frame: scalar
        gravity: t.vec  # Gravitational acceleration [m/s2].
        density: scalar  # Density of the concrete [kg/m3].
        viscosity: scalar  # Plastic viscosity of the Bingham law [Pa s], or consistency k of another law [Pa s^n].
        flow_index: scalar  # Flow index n; 1 except for the Herschel-Bulkley law.
        quadratic_viscosity: scalar  # Coefficient c of the modified Bingham law [Pa s2], else 0.
        yield_stress: scalar  # Yield stress of the concrete [Pa].
        regularisation: scalar  # Regularisation time beta of the flow law [s].
        volume: scalar  # Mean volume of a particle [m3], in plane flow [m3/m], in axisymmetric flow [m3/rad].
        inflow: t.vec  # Velocity of particles that re-enter the grid after they have left it [m/s].

        # Derivative of the wall's braking force per volume with respect to the mean velocity [kg/m3/s].
        resistance: wp.float64

    return Grid


@functools.cache
def grid_structs(scalar, dimensions: int) -> SimpleNamespace:
    """Build the structs `Particles`, `Fields` (arrays on the grid), `Geometry` (position of walls) and `Walls`.

    In the shapes of arrays, `cells` is the number of cells including the frame around the grid, `axes` the number of
    axes of the grid, and n the number of particles. `pairs` is the number of pairs of axes: 1 in a plane, 3 in space.
    Areas, volumes and forces are per metre of depth in plane flow, and per radian in axisymmetric flow.
    """
    t = mps_types(scalar, dimensions)
    vec3 = types(scalar).vec3

    @wp.struct
    class Particles:
        position: wp.array(dtype=t.vec)  # Position of each particle [m], shape (n,).
        velocity: wp.array(dtype=t.vec)  # Velocity of each particle [m/s], shape (n,).
        gradient: wp.array(dtype=t.mat)  # Velocity gradient at each particle [1/s], shape (n,).
        pressure: wp.array(dtype=scalar)  # Pressure at each particle [Pa], shape (n,).

        # Mass of each particle divided by the mean mass of particles, shape (n,); 0 if the particle has left the grid.
        mass: wp.array(dtype=scalar)

    @wp.struct
    class Fields:
        solid: wp.array(dtype=wp.int32)  # Number of the wall that fills each cell, or OPEN, shape (cells,).
        liquid: wp.array(dtype=wp.int32)  # 1 for cells with concrete that can flow, else 0, shape (cells,).

        # Density of particles around each cell's centre, divided by the density in full cells, shape (cells,).
        particle_density: wp.array(dtype=scalar)
        fill: wp.array(dtype=scalar)  # Fraction of a cell's volume outside walls that concrete fills, shape (cells,).
        count: wp.array(dtype=wp.int32)  # Number of particles in each cell, shape (cells,).
        begin: wp.array(dtype=wp.int32)  # Index of each cell's first particle in `sorted_particles`, shape (cells,).

        # Number of entries of `sorted_particles` that cells have reserved so far, shape (1,).
        reserved_places: wp.array(dtype=wp.int32)
        cell_of_particle: wp.array(dtype=wp.int32)  # Cell of each particle, -1 if it has left the grid, shape (n,).
        place: wp.array(dtype=wp.int32)  # Rank of each particle among the particles of its cell, shape (n,).
        sorted_particles: wp.array(dtype=wp.int32)  # Numbers of the particles, sorted by cell, shape (n,).
        # Position [m] and, as the last number, relative mass of each particle, in the order of `sorted_particles`. In
        # two dimensions, the third number is unused. Shape (n,); empty on a CPU.
        sorted_place: wp.array(dtype=types(scalar).vec4)
        # Velocity gradient [1/s] and velocity [m/s] of each particle, in the order of `sorted_particles`, shape (axes *
        # n,); empty on a CPU. The entry axes * k + a holds row a of the gradient of particle k and, as the last number,
        # component a of its velocity.
        sorted_motion: wp.array(dtype=types(scalar).vec4)

        # Relative mass, position, velocity and velocity gradient of the particles, on a CPU only. The array consists of
        # columns, one after the other. A column holds one number of all particles, such as one component of their
        # velocities, in the order of `sorted_particles` (see `columns.py`).
        columns: wp.array(dtype=scalar)

        # Kind of each cell face: AIR, LIQUID, FIXED, INSIDE or GHOST. There is one face for each axis and cell, shape
        # (axes * cells,).
        kind: wp.array(dtype=wp.int32)
        velocity: wp.array(dtype=scalar)  # Velocity across each face [m/s], shape (axes * cells,).

        # Velocity across each face at the start of the implicit solve [m/s], shape (axes * cells,).
        start: wp.array(dtype=scalar)
        volume: wp.array(dtype=scalar)  # Volume of concrete around each face [m3], shape (axes * cells,).

        # Area of the pipe's wall beside each face [m2], shape (axes * cells,); 0 for faces away from walls.
        wall_area: wp.array(dtype=scalar)
        # Shear stress between the pipe's wall and the concrete at each face [Pa], with the sign of the concrete's
        # velocity relative to the wall, shape (axes * cells,).
        traction: wp.array(dtype=scalar)
        # Derivative of the wall's shear stress (`traction`) with respect to the face's velocity [Pa s/m], same shape.
        traction_slope: wp.array(dtype=scalar)
        # Velocity of the concrete at the pipe's wall beside each face; without a wall, the velocity of the face [m/s].
        # Shape (axes * cells,).
        slip: wp.array(dtype=scalar)
        # Friction force of a wall that passes between two neighbouring faces, divided by the velocity of the concrete
        # relative to the wall [N s/m]. Both faces are perpendicular to axis a; the second face follows the first one
        # along axis b. Shape (axes^2 * cells,); the index is (a * axes + b) * slots + c, where c is the cell of the
        # first face.
        wall_stiffness: wp.array(dtype=scalar)
        # Friction force of a wall at the present velocity of the concrete [N], with the same indices as
        # `wall_stiffness`.
        wall_force: wp.array(dtype=scalar)
        # The velocity at a wall that passes between two neighbouring faces is interpolated from the velocities of both
        # faces. `wall_weight` is the weight of the second face, with the same indices as `wall_stiffness`.
        wall_weight: wp.array(dtype=scalar)
        shift: wp.array(dtype=scalar)  # Velocity across each face, to disperse particles [m/s], shape (axes * cells,).
        pressure: wp.array(dtype=scalar)  # Pressure in each cell [Pa], shape (cells,).
        increment: wp.array(dtype=scalar)  # Change of the pressure in each cell in this step [Pa], shape (cells,).
        # Change of the pressure in each cell in the last step [Pa], shape (cells,); empty if the grid is always full.
        pressure_change: wp.array(dtype=scalar)

        # Potential whose gradient moves particles out of crowded regions, as a pressure gradient would [Pa], shape
        # (cells,).
        potential: wp.array(dtype=scalar)
        in_cell: wp.array(dtype=scalar)  # Apparent viscosity in each cell [Pa s], shape (cells,).
        # Apparent viscosity at each cell edge [Pa s]. There is one edge for each pair of axes and cell, shape
        # (pairs * cells,).
        in_corner: wp.array(dtype=scalar)

        # Shear stress at each corner of a pipe's cells in the previous step [Pa]; on a wall, the wall stress. Shape
        # (cells,).
        stress: wp.array(dtype=scalar)
        strain: wp.array(dtype=scalar)  # Square of each cell's shear rate [1/s2], shape (cells,).

        # Square of each cell's shear rate without the contribution of one pair of axes [1/s2], shape (pairs * cells,).
        strain_without_pair: wp.array(dtype=scalar)
        # Yield stress gained at rest in each cell [Pa], shape (cells,); empty without thixotropy.
        gained: wp.array(dtype=scalar)
        # Yield stress that the slip layer gained at rest [Pa], shape (axes * cells,); empty without thixotropy.
        layer: wp.array(dtype=scalar)
        # Driving force of a periodic pipe and related values, at the indices FORCE to VELOCITY_CORRECTION, shape
        # (DRIVE,).
        drive: wp.array(dtype=wp.float64)
        # Time and variables of the step control, at the indices DT to GATHERED, shape (CLOCK,).
        clock: wp.array(dtype=wp.float64)

    @wp.struct
    class Geometry:
        # Distance from the nearest wall, negative inside it [m], at 2^axes points of each cell: a quarter and three
        # quarters of the cell along each axis. Shape (cells * 2^axes,), in which the first axis varies fastest.
        depth: wp.array(dtype=scalar)
        room: wp.array(dtype=scalar)  # Fraction of each cell's volume that is free of wall, shape (cells,).

        # Fraction of each quarter of a cell that is free of wall. For each pair of axes, a cell is halved along both
        # axes, which gives four quarters. Shape (cells * pairs * 4,), in which the position along the pair's first axis
        # varies fastest.
        quarter_fraction: wp.array(dtype=scalar)
        # Volume around each cell's centre that is free of wall [m3], shape (cells,). Its parts have the same weight as
        # a particle at their distance from the centre.
        weighted_volume: wp.array(dtype=scalar)
        opens: wp.array(dtype=scalar)  # Time at which the gate in a cell opens [s], shape (cells,); empty without gate.

        # Positions at which particles that have left the grid enter again [m], shape (positions,); empty if no particle
        # enters again.
        inlet: wp.array(dtype=t.vec)
        # Distance of each face's centre from the nearest wall, negative inside a wall [m], shape (axes * cells,).
        gap: wp.array(dtype=scalar)
        part: wp.array(dtype=scalar)  # Fraction of each face's area free of wall, shape (axes * cells,).

        # Kind that each cell face has if a wall closes it entirely: FIXED or INSIDE. The values of other faces are not
        # used. There is one face for each axis and cell, shape (axes * cells,).
        shut: wp.array(dtype=wp.int32)
        # Number of the wall nearest to each cell face. There is one face for each axis and cell, shape (axes * cells,).
        surface: wp.array(dtype=wp.int32)
        # Fraction of each face's area that moving walls close, without the parts that walls at rest close too, shape
        # (axes * cells,); empty if no wall moves.
        swept: wp.array(dtype=scalar)

    @wp.struct
    class Walls:
        # Velocity of each wall [m/s]. The index of this array and of the next arrays is the number of the wall; index 0
        # is unused.
        velocity: wp.array(dtype=t.vec)
        spin: wp.array(dtype=vec3)  # Angular velocity of each wall about `pivot` [rad/s]; in plane flow about y.
        pivot: wp.array(dtype=t.vec)  # Point about which each wall rotates [m].

        # Viscous constant of each wall's slip layer [Pa s/m]; negative if the wall is frictionless.
        slip_viscosity: wp.array(dtype=scalar)
        slip_yield: wp.array(dtype=scalar)  # Yield stress of a wall's slip layer [Pa].
        slip_index: wp.array(dtype=scalar)  # Flow index n of the law of a wall's slip layer.
        slip_quadratic: wp.array(dtype=scalar)  # Coefficient of the squared slip velocity at a wall [Pa s2/m2].

    return SimpleNamespace(Particles=Particles, Fields=Fields, Geometry=Geometry, Walls=Walls)
